"""Tests of command lines, and of programs in unusual environments."""

import os
import subprocess
import sys
from dataclasses import dataclass, fields
from functools import partial
from pathlib import Path

import pytest

import evaluation.__main__ as evaluating
import scenes.__main__ as drawing
import train
from navbot_min import NavVecEnv
from support import demo
from support.cli import option, parse

ROOT = Path(__file__).parent.parent
TRAIN, EVALUATE, DRAW = train.main, evaluating.main, drawing.main
DEMO = partial(demo.main, NavVecEnv)


def refusal(main, argv, capsys):
    """Returns the error message of a program for a command line: one sentence."""
    capsys.readouterr()  # discard earlier output
    with pytest.raises(SystemExit) as stop:
        main(argv)
    text = capsys.readouterr().err
    assert stop.value.code == 2 and text.startswith("error: ") and text.count("\n") == 1, text
    return text


@pytest.mark.parametrize("main, line, words", [
    (TRAIN, "--steps 0", "--steps: '0' is not a whole number from 1 to 1,000,000,000"),
    (TRAIN, "--steps=", "--steps: '' is not a whole number"),
    (TRAIN, "--steps --seed 1", "--steps: expected one argument"),
    (TRAIN, "--robots 64.0", "--robots: '64.0' is not a whole number from 1 to 4,096"),
    (TRAIN, "--clip inf", "--clip: 'inf' is not a number from 1e-09 to 1,000,000,000"),
    (TRAIN, "--step 5", "unrecognized arguments: --step 5"),  # not an abbreviation of --steps
    (TRAIN, "--env none.toml", "room file 'none.toml' cannot be used: No such file"),
    (TRAIN, "--env lab", "room 'lab' has a robot's errors; use python -m robot.train"),
    (TRAIN, "--env random:x", "must be random: and a whole number from 0 to 1,000,000,000"),
    (TRAIN, "--rooms 4", "--rooms is 4; it has an effect only with --env random: leave it out"),
    (TRAIN, "--env random --targets both", "with --env random it must be anywhere"),
    (TRAIN, "--workers 9 --robots 8", "it must be at most 4: each needs two robots"),
    (TRAIN, "--resume none", "--resume 'none' is not a run folder: it has no config.json"),
    (TRAIN, "--out .", "--out '.' already exists; it must name a new folder"),
    (TRAIN, "--out evaluations/run", "folder 'evaluations/run' cannot be created: Not a directory"),
    (EVALUATE, "--planner bug", "evaluations"),
    (EVALUATE, "run --planner bug", "give either a run"),
    (EVALUATE, "--planner bug --hide cube", "--hide and --replay need a policy"),
    (EVALUATE, "--planner bug --env lab", "python -m robot.evaluate"),
    (EVALUATE, "--episodes 5 none", "run 'none' does not exist: it must be a run folder or a"),
    (DRAW, "env9", "unknown scene 'env9': it must be one of env1, env2"),
    (DEMO, f"--env {'x' * 5000}.toml", "File name too long")])
def test_a_bad_command_line_gives_one_sentence_and_leaves_no_file(main, line, words, tmp_path,
                                                                  capsys, monkeypatch):
    monkeypatch.chdir(tmp_path)
    Path("evaluations").write_text("a file, not a folder")
    monkeypatch.setattr(train, "Training", None)  # fails if the command line is accepted
    assert words in refusal(main, line.split(), capsys)
    assert len([*tmp_path.iterdir()]) == 1


@dataclass
class Options:
    """Options of every kind."""
    run: str = option("", "a run", positional=True)
    many_steps: int = option(7, "N steps of 100 %", 1, 10)
    share: float = option(0.5, "a fraction", 0.0, 1.0)
    name: str = option("", "a name")
    kind: str = option("one", "a kind", choices=("one", "two"))
    loud: bool = option(False, "print more")


@pytest.mark.parametrize("line, expected", [
    ("", {}), ("there", {"run": "there"}),
    ("--loud there --share=1", {"run": "there", "loud": True, "share": 1.0}),
    ("--share 0 --many-steps 10 --kind two there", {"share": 0.0, "many_steps": 10, "kind": "two",
                                                    "run": "there"}),
    ("--name -x", None), ("--name=-x --many-steps 7", {"name": "-x", "many_steps": 7})])
def test_options_may_precede_or_follow_the_positional_argument(line, expected, capsys):
    def main(argv):
        options, parser = parse(Options, "Try options.", argv)
        assert options == Options(**expected) and parser.given == set(expected)
        assert all(type(getattr(options, item.name)) is item.type for item in fields(options))
    if expected is None:
        assert "--name: expected one argument" in refusal(main, line.split(), capsys)
    else:
        main(line.split())


def test_help_lists_options_and_their_defaults(capsys):
    for main in (TRAIN, EVALUATE, DRAW, DEMO, partial(parse, Options, "Try options.")):
        with pytest.raises(SystemExit):
            main(argv=["--help"])
        text = " ".join(capsys.readouterr().out.split())
        assert text.startswith("usage: python") and "SUPPRESS" not in text and "None" not in text
    for words in ("Try options.", "RUN a run", "--many-steps N N steps of 100 % (default: 7)",
                  "--kind {one,two} a kind (default: one)", "--name NAME a name --"):
        assert words in text, words


ODD = {"LC_ALL": "C", "PYTHONIOENCODING": "ascii", "PYTHONPATH": str(ROOT), "DISPLAY": "",
       "HOME": "/dev/null/none", "XDG_CONFIG_HOME": "", "XDG_CACHE_HOME": "",
       "MPLBACKEND": "module://matplotlib_inline.backend_inline"}  # not installed


@pytest.mark.parametrize("program, written", [
    ([ROOT / "navbot_min.py", "--env", "Stube ß.toml"], "demo.png"),
    (["-m", "evaluation", "--planner", "straight", "--env", "Stube ß.toml", "--episodes", "4"],
     "evaluations/straight-Stube ß/episode.gif")])
def test_programs_work_without_home_display_unicode_or_latex_and_with_python_o(
        program, written, tmp_path):
    folder = tmp_path / "meine Räume 房间"
    folder.mkdir()
    (folder / "Stube ß.toml").write_bytes((ROOT / "scenes" / "env1.toml").read_bytes())
    (folder / "matplotlibrc").write_text("text.usetex: true")  # LaTeX is not installed
    done = subprocess.run([sys.executable, "-O", *map(str, program)], cwd=folder, text=True,
                          capture_output=True, timeout=120, env=os.environ | ODD)
    assert done.returncode == 0 and "Traceback" not in done.stderr, done.stderr
    assert (folder / written).stat().st_size > 1000
