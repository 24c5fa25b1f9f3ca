"""Each test is the shortest proof of one claim about command lines, and the places where programs
begin."""

import ast
import contextlib
import errno
import io
import os
import re
import subprocess
import sys
from dataclasses import fields
from pathlib import Path

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import evaluation.__main__ as evaluating
import navbot_min
import scenes.__main__ as drawing
import train
from support.command_line import CommandLine, flag_of, option
from support.paths import check_new_folder
from support.run_folder import RunError

ROOT = Path(__file__).parent.parent
LONG = "x" * 5000
TRAIN, EVALUATE, DRAW, DEMO = train.main, evaluating.main, drawing.main, navbot_min.main


def check_sentence(said):
    """Checks that what was said is one line for people."""
    line = said.removesuffix("\n")
    assert said.startswith("error: ") and said.endswith("\n") and line.isprintable()
    assert len(line) < 200 and "argument --" not in line and "Errno" not in line, line


def refusal(main, argv):
    """The sentence by which a program refuses a command line, after what it prints."""
    out, err = io.StringIO(), io.StringIO()
    with contextlib.redirect_stdout(out), contextlib.redirect_stderr(err):
        with pytest.raises(SystemExit) as stop:
            main(argv)
    assert stop.value.code == 2
    check_sentence(err.getvalue())
    return err.getvalue()


# ---------------------------------------------------------------------------------- what is refused


BAD = [
    (TRAIN, "--steps 0", "--steps is 0, it must be a whole number from 1 to 1,000,000,000"),
    (TRAIN, "--steps 1000000001", "--steps is 1000000001, it must be"),
    (TRAIN, "--steps 99999999999999999999", "--steps is 99999999999999999999, it must be"),
    (TRAIN, f"--steps {'9' * 4000}", f"--steps is {'9' * 37}..., it must be"),
    (TRAIN, f"--steps {'9' * 5000}", f"--steps is '{'9' * 37}...', it must be"),
    (TRAIN, "--steps 1e6", "--steps is '1e6', it must be a whole number"),
    (TRAIN, "--steps nan", "--steps is 'nan', it must be a whole number"),
    (TRAIN, "--steps=", "--steps is '', it must be a whole number"),
    (TRAIN, "--steps", "--steps has no value"),
    (TRAIN, "--steps --seed 1", "--steps has no value"),
    (TRAIN, "--seed -1", "--seed is -1, it must be a whole number from 0 to 9,223,372,036,854"),
    (TRAIN, "--seed 9223372036854775808", "--seed is 9223372036854775808, it must be"),
    (TRAIN, "--robots 4097", "--robots is 4097, it must be a whole number from 1 to 4,096"),
    (TRAIN, "--robots 64.0", "--robots is '64.0', it must be a whole number"),
    (TRAIN, "--workers 65", "from 0 to 64"), (TRAIN, "--epochs 1001", "from 1 to 1,000"),
    (TRAIN, "--minibatches 0", "from 1 to 4,096"),
    (TRAIN, "--episodes-per-update 4097", "from 1 to 4,096"),
    (TRAIN, "--evaluation-episodes 1000000000", "from 1 to 100,000"),
    *[(TRAIN, f"--{name} {value}", f"--{name} is {value}, it must be a number from {low} to {high}")
      for name, low, high in (("random-starts", 0.0, 1.0), ("mirrored", 0.0, 1.0),
                              ("learning-rate", 1e-9, 1.0), ("gamma", 0.0, 1.0), ("lam", 0.0, 1.0),
                              ("clip", 1e-9, "1,000,000,000.0"))
      for value in ("nan", "inf", "-inf", "1e999", "-0.1")],
    (TRAIN, "--gamma a\x1b[31mred", "--gamma is 'a\\x1b[31mred', it must be a number"),
    (TRAIN, "--memory big", "--memory is 'big', it must be one of 'stacked', 'single', 'none'"),
    (TRAIN, "--without all", "--without is 'all', it must be one of 'image', 'target', 'last'"),
    (TRAIN, "--step 5", "unknown argument '--step', the nearest is --steps; --help lists all"),
    (TRAIN, "--learning_rate=1", "'--learning_rate', the nearest is --learning-rate;"),
    (TRAIN, "--eval 5", "the nearest is --evaluation-episodes"),
    (TRAIN, "-steps 5", "unknown argument '-steps', the nearest is --steps"),
    (TRAIN, f"--{LONG}", "xxx...', --help lists those there are"), (TRAIN, "-", "argument '-'"),
    (TRAIN, "--", "argument '--'"), (TRAIN, "env1", "unknown argument 'env1', at most 0"),
    (TRAIN, "--json=no", "--json is 'no', but it takes no value"),
    (TRAIN, "--out a\0b", "--out is 'a\\x00b', no file can have that name"),
    (TRAIN, f"--out {LONG}", "xxx...', no file can have that name"),
    (TRAIN, f"--env {LONG}.toml", "xxx...', no file can have that name"),
    (TRAIN, f"--resume {LONG}", "xxx...', no file can have that name"),
    (TRAIN, "--env \udc80", "'\\udc80'"),
    *[(main, f"{before}random:{seed}", "must be random: and a whole number from 0 to 1,000,000,000")
      for main, before in ((TRAIN, "--env "), (EVALUATE, "--planner bug --env "), (DRAW, ""),
                           (DEMO, "--env "))
      for seed in ("", "-1", "x", "1000000001", "9" * 200)],
    (TRAIN, "--rooms 4", "--rooms is 4, it goes with --env random alone: leave it out"),
    (TRAIN, "--rooms 4 --env random:7", "--rooms is 4, it goes with --env random alone"),
    (TRAIN, "--rooms 4097 --env random", "--rooms is 4097, it must be a whole number from 0 to"),
    (TRAIN, "--targets none", "--targets is 'none', it must be one of 'memorize', 'both', 'any"),
    (TRAIN, "--targets anywhere --mirrored 0.5",
     "--mirrored is 0.5, it goes with --targets both alone: leave it out"),
    (TRAIN, "--targets memorize --random-starts 0.7",
     "--random-starts is 0.7, it goes with --targets both alone: leave it out"),
    (TRAIN, "--env random --mirrored 0.5", "--mirrored is 0.5, it goes with --targets both alone"),
    *[(TRAIN, f"--env random --targets {targets}",
       f"--targets is {targets}, with --env random it must be anywhere")
      for targets in ("both", "memorize")],
    (EVALUATE, "", "give either a run"),
    (EVALUATE, "--episodes 5", "give either a run"),
    (EVALUATE, "--episodes 5 none", "run 'none' does not exist"),
    (EVALUATE, "none --episodes=5", "run 'none' does not exist"),
    (EVALUATE, "one two", "unknown argument 'two', at most 1"),
    (EVALUATE, f"{LONG}", "RUN is 'xxx"), (EVALUATE, "a\0b", "RUN is 'a\\x00b', no file"),
    (EVALUATE, "--planner bug --episodes 1000000000", "--episodes is 1000000000, it must be"),
    (EVALUATE, "--planner bug --workers 99999999999999999999", "from 0 to 64"),
    (EVALUATE, "--planer bug", "the nearest is --planner"),
    (EVALUATE, "--planner", "--planner has no value"),
    (EVALUATE, "--planner bug --env env1 --protocol sideways", "--protocol is 'sideways'"),
    (DRAW, "", "SCENE is missing, it must be a scene's name"),
    (DRAW, "--size 4 env1", "unknown argument '--size', --help lists"),
    (DRAW, "env1 env2", "unknown argument 'env2', at most 1"),
    (DEMO, "--env", "--env has no value"), (DEMO, "--evn env1", "the nearest is --env"),
    (DEMO, f"--env {LONG}", "xxx")]


@pytest.mark.parametrize("main, line, words", BAD, ids=range(len(BAD)))
def test_a_bad_command_line_is_one_sentence_and_leaves_nothing(main, line, words, tmp_path,
                                                               monkeypatch):
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(train, "Training", None)  # what is not refused fails here
    assert words in refusal(main, line.split(" ") if line else [])
    assert not list(tmp_path.iterdir())


ODD_TEXTS = ["", "0", "1", "-1", "1e-3", "nan", "-inf", "9" * 30, "True", "--", "-h5", "=", LONG,
             "\udcff"]
TEXTS = st.one_of(st.text(max_size=30), st.sampled_from(ODD_TEXTS))


def meant(item):
    """A strategy: a valid value of a field."""
    low, high, choices = (item.metadata[name] for name in ("low", "high", "choices"))
    if item.type is int:
        return st.integers(low, 2 ** 63 - 1 if high is None else high)
    if item.type is float:
        return st.floats(low, high)
    return st.sampled_from(choices) if choices else st.sampled_from(["env1", "a b", "-x", "ü"])


@st.composite
def command_lines(draw, config_class):
    """A command line, and what it says if all of it is valid, else None."""
    argv, said = [], {}
    for item in draw(st.lists(st.sampled_from(fields(config_class)), max_size=6)):
        if item.metadata["positional"]:
            argv.append(draw(TEXTS))
            said = None
        elif item.type is bool:
            argv.append(flag_of(item))
            said = said if said is None else said | {item.name: True}
        else:
            good = draw(st.integers(0, 9)) > 0
            value = draw(meant(item) if good else TEXTS)
            argv += [f"{flag_of(item)}={value}"] if draw(st.booleans()) else [flag_of(item),
                                                                              str(value)]
            said = said | {item.name: value} if good and said is not None else None
    if draw(st.integers(0, 9)) == 0:
        argv.insert(draw(st.integers(0, len(argv))), draw(TEXTS))
        said = None
    return argv, said


@pytest.mark.parametrize("config_class", [train.Config, evaluating.Options])
def test_any_command_line_is_a_valid_configuration_or_one_sentence(config_class):
    seen = {"read": 0, "refused": 0}

    @settings(max_examples=500, derandomize=True, deadline=None)
    @given(command_lines(config_class))
    def check(line):
        argv, said = line
        parser = CommandLine("")
        out, err = io.StringIO(), io.StringIO()
        try:
            with contextlib.redirect_stdout(out), contextlib.redirect_stderr(err):
                config = parser.read(config_class, argv)
        except SystemExit as stop:
            if stop.code == 0:  # a text that asks for help
                assert {"-h", "--help"} & set(argv)
                return
            assert said is None and stop.code == 2
            check_sentence(err.getvalue())
            seen["refused"] += 1
            return
        seen["read"] += 1
        if said is not None:
            assert config == config_class(**said) and parser.given == set(said)
        for item in fields(config_class):
            value = getattr(config, item.name)
            assert type(value) is item.type
            assert item.type not in (int, float) or item.metadata["low"] <= value < 2 ** 63
            assert item.name in parser.given or value == item.default
    check()
    assert min(seen.values()) > 100, seen


def test_given_names_what_was_on_the_command_line_default_or_not():
    parser = CommandLine("")
    parser.read(train.Config, ["--steps=5", "--seed", "0", "--json"])
    assert parser.given == {"steps", "seed", "json"}


@pytest.mark.parametrize("argv", [["there", "--episodes", "5"], ["--episodes", "5", "there"],
                                  ["--json", "there", "--episodes=5"]])
def test_options_may_stand_before_the_run_and_behind_it(argv):
    run, options, _ = evaluating.read_command_line(argv)
    assert run == Path("there") and options.episodes == 5


@pytest.mark.parametrize("main, words", [
    (TRAIN, ["[options]", "--steps N", "by default 500000", "by default runs/<env>-seed<k>"]),
    (EVALUATE, ["[RUN] [options]", "a run's folder such as runs/env1-seed0", "by default none"]),
    (DRAW, ["SCENE [options]", "SCENE a scene's name, or a path"]),
    (DEMO, ["--env ENV", "by default env1"])])
def test_help_says_in_words_what_there_is_and_its_defaults(main, words, capsys):
    with pytest.raises(SystemExit) as stop:
        main(["--help"])
    said = " ".join(capsys.readouterr().out.split())
    assert stop.value.code == 0 and all(word in said for word in words), said
    assert not re.search(r"\(default|by default ?[;.]|None|SUPPRESS", said)


def test_every_number_of_a_program_has_limits():
    for config_class in (train.Config, evaluating.Options):
        for item in fields(config_class):
            assert item.type not in (int, float) or item.metadata["low"] is not None
            assert item.type not in (int, float) or item.name == "seed" or item.metadata["high"]


# --------------------------------------------------------------------------------------- the places


def test_a_folder_that_cannot_be_made_is_known_before_and_nothing_is_left(tmp_path, monkeypatch):
    (tmp_path / "here").mkdir()
    monkeypatch.chdir(tmp_path / "here")
    Path("file").write_text("")
    for path, words in (("file", "exists already"), (".", "exists already"),
                        ("file/run", "'file' is no folder"), ("new/" + 300 * "x", "name too long"),
                        ("a\0b", "it is no path"), ("new/" * 1500, "name too long")):
        with pytest.raises(RunError, match=words):
            check_new_folder(path)
    check_new_folder("new/ä b/../run")
    check_new_folder("new/../../beside/run")
    monkeypatch.setattr(os, "mkdir", fail)
    with pytest.raises(RunError, match="Read-only file system; --out must name one"):
        check_new_folder("new/run")
    assert [path.name for path in tmp_path.rglob("*")] == ["here", "file"]


def fail(*_, **__):
    """What the system does in a folder that can only be read."""
    raise OSError(errno.EROFS, os.strerror(errno.EROFS), "here")


@pytest.mark.parametrize("main, argv", [(DRAW, ["env1"]), (EVALUATE, ["--planner", "straight"])])
def test_a_program_that_cannot_write_says_so_before_it_works(main, argv, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(os, "mkdir", fail)
    assert "cannot be written to: Read-only file system; begin in a folder" in refusal(main, argv)


def test_what_takes_a_folders_place_is_one_sentence(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    Path("evaluations").write_text("mine")
    assert "'evaluations' is no folder" in refusal(EVALUATE, ["--planner", "straight"])
    Path("demo.png").mkdir()
    assert "'demo.png' cannot be used" in refusal(DEMO, [])


ODD = {"LC_ALL": "C", "PYTHONIOENCODING": "ascii", "PYTHONPATH": str(ROOT), "DISPLAY": ""}
HOMELESS = {"HOME": "/dev/null/none", "XDG_CONFIG_HOME": "", "XDG_CACHE_HOME": ""}


def run_odd(folder, *arguments, **environment):
    """Runs python at an odd place: no display, a screen of ASCII letters, warnings that are errors,
    assertions left out."""
    return subprocess.run([sys.executable, "-W", "error", "-O", *map(str, arguments)], cwd=folder,
                          capture_output=True, text=True, timeout=120,
                          env=os.environ | ODD | environment)


@pytest.fixture
def odd_folder(tmp_path):
    """A working folder with spaces and letters of other alphabets, and a room in it."""
    folder = tmp_path / "meine Räume 房间"
    folder.mkdir()
    (folder / "Stube ß.toml").write_bytes((ROOT / "scenes" / "env1.toml").read_bytes())
    return folder


@pytest.mark.parametrize("program, environment, written", [
    ([ROOT / "navbot_min.py", "--env", "Stube ß.toml"], HOMELESS, "demo.png"),
    (["-m", "scenes", "Stube ß.toml"], {}, "Stube ß.png"),
    (["-m", "evaluation", "--planner", "straight", "--env", "Stube ß.toml", "--episodes", "4"], {},
     "evaluations/straight-Stube ß/episode.gif")])
def test_programs_work_at_odd_places(program, environment, written, odd_folder):
    done = run_odd(odd_folder, *program, **environment)
    assert done.returncode == 0 and done.stderr == "", done.stderr
    assert (odd_folder / written).stat().st_size > 1000


def test_a_file_of_ones_own_beside_a_program_is_no_harm_or_is_named(odd_folder):
    (odd_folder / "render.py").write_text("print('mine')")
    done = run_odd(odd_folder, ROOT / "navbot_min.py", "--env", "none.toml")  # finds ours
    assert done.stderr == "error: scene file 'none.toml' does not exist\n"
    for package in ("scenes", "evaluation"):
        done = run_odd(odd_folder, "-m", package, "env1")
        assert done.returncode == 2 and done.stdout == ""
        assert re.fullmatch(r"error: '.*render\.py' hides this project's render: rename it, or "
                            r"begin in another folder\n", done.stderr), done.stderr
    done = run_odd(odd_folder, "-c", "import navbot_min")
    assert done.stderr.splitlines()[-1].startswith("ImportError: '")


def test_no_check_is_lost_with_python_o():
    for path in ROOT.rglob("*.py"):
        parts = path.relative_to(ROOT).parts
        if parts[0].startswith(".") or path.name.startswith("test_") or path.name == "clients.py":
            continue  # the clients' program refuses to begin with -O
        if parts[:2] == ("classroom", "exercises"):
            continue  # an exercise holds its own tests
        tree = ast.parse(path.read_text(encoding="utf-8"))
        assert not any(isinstance(node, ast.Assert) for node in ast.walk(tree)), path
