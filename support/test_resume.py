"""Tests of runs that are interrupted and resumed."""

import csv
import errno
import json
import os
import re
import shutil
import signal
import subprocess
import sys
import time
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import pytest
import torch

import scenes
import train
from evaluation import after_training
from support import run_folder
from support.parallel import ProcessLost
from support.run_folder import CHECKPOINT, RunError, RunFolder
from support.test_cli import refusal
from support.test_weights import Code
from support.weights import FILE, load_model

ROOT = Path(__file__).parent.parent
ENV1 = scenes.load("env1")
STAGE = 200  # steps of 8 robots
TINY = ["--steps", "800", "--robots", "8", "--episodes-per-update", "4", "--minibatches", "1",
        "--fixed-budget"]
pytestmark = pytest.mark.skipif(os.name != "posix", reason="kills processes by POSIX signals")
TORCHRUN = ["-m", "torch.distributed.run", "--standalone", "--nproc-per-node", "2"]

# train.py with short stages, without the evaluation after training, and with the code of a test.
PROGRAM = f"""
import os, signal, sys
sys.path.insert(0, {str(ROOT)!r})
import train
from evaluation import after_training
from support import parallel, run_folder
train.STAGE = {8 * STAGE}
run_folder.EVERY = 0  # new weights after every update
after_training.finish = lambda *_: None
{{more}}
if __name__ == "__main__":
    train.main()
"""
# The first process is killed before an update.
KILL = """
learn = train.Training.learn
def killed(training, episodes):
    if training.steps > {steps} and parallel.rank() == 0:
        os.kill(os.getpid(), signal.SIGKILL)
    return learn(training, episodes)
train.Training.learn = killed
"""


def start(folder, *options, before=(), more="", **pipes):
    """Starts PROGRAM in a new process group. before: arguments of Python. more: code to insert."""
    program = folder.parent / f"{folder.name}.py"
    program.write_text(PROGRAM.format(more=more))
    pipes = {"stdout": subprocess.DEVNULL, "stderr": subprocess.PIPE} | pipes
    return subprocess.Popen([sys.executable, *before, program, *options], text=True,
                            start_new_session=True, **pipes)


def content(folder):
    """Returns the contents of the files of a run, except its speed."""
    rows = csv.reader((folder / "updates.csv").read_text().splitlines())
    return {"updates": [row[:-1] for row in rows],
            "episodes.csv": (folder / "episodes.csv").read_bytes(),
            FILE: (folder / FILE).read_bytes()}


@pytest.fixture(scope="module")
def whole(tmp_path_factory):
    """Contents of runs that were not interrupted, by number of workers. The reader of their output
    exits after one line, as in `2>&1 | head -1`."""
    contents = {}
    for workers in (1, 2):
        folder = tmp_path_factory.mktemp("whole") / "run"
        process = start(folder, *TINY, "--workers", str(workers), "--out", folder,
                        stdout=subprocess.PIPE, stderr=subprocess.STDOUT)
        assert process.stdout.readline() == f"run folder: {folder}\n"
        process.stdout.close()
        assert process.wait(120) == 0
        contents[workers] = content(folder)
        assert len(contents[workers]["updates"]) > 5
    return contents


@pytest.mark.parametrize("workers, before, cut", [
    (1, [], KILL.format(steps=130)),  # before the first checkpoint
    (1, [], KILL.format(steps=500)),
    (2, [], KILL.format(steps=500)),
    (2, TORCHRUN, KILL.format(steps=600))])
def test_a_killed_run_resumes_and_writes_the_same_bytes(workers, before, cut, whole, tmp_path):
    folder = tmp_path / "run"
    own = [] if before else ["--workers", str(workers)]
    process = start(folder, *TINY, *own, "--out", folder, before=before, more=cut)
    process.communicate(timeout=120)  # until the last of its processes exits: they share the pipe
    assert process.returncode == (1 if before else -signal.SIGKILL)
    load_model(folder)  # the newest weights exist even before the first checkpoint
    starts_again = cut == KILL.format(steps=130)
    assert (folder / CHECKPOINT).exists() != starts_again
    process = start(folder, "--resume", folder, before=before)
    _, printed = process.communicate(timeout=120)
    assert process.returncode == 0, printed
    assert ("no checkpoint yet: the run starts again from the beginning" in printed) == starts_again
    assert content(folder) == whole[workers]


def test_ctrl_c_prints_one_line_with_the_command_to_resume(tmp_path):
    folder = tmp_path / "run"
    process = start(folder, *TINY, "--workers", "2", "--steps", "100000", "--out", folder)
    updates = folder / "updates.csv"
    while not (updates.exists() and updates.stat().st_size):
        assert process.poll() is None, process.communicate()
        time.sleep(0.05)
    os.killpg(process.pid, signal.SIGINT)  # as a terminal does
    _, printed = process.communicate(timeout=60)
    assert process.returncode == 130 and "Traceback" not in printed
    last = printed.splitlines()[-1]
    assert re.fullmatch(f"interrupted; resume with python .*.py --resume {folder}", last)


# ---------------------------------------------------------------------------------- in one process


@pytest.fixture(scope="module")
def finished(tmp_path_factory):
    """The folder of a finished run in a room from a file next to it. Stages are short, and no
    evaluation follows."""
    folder = tmp_path_factory.mktemp("finished") / "run"
    room = folder.with_name("room.toml")
    shutil.copy(ROOT / "scenes" / "env1.toml", room)
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(train, "STAGE", 8 * STAGE)
        patch.setattr(after_training, "finish", lambda *_: None)
        train.main([*TINY, "--epochs", "1", "--workers", "1", "--out", str(folder),
                    "--env", str(room), "--steps", "300"])
        yield folder


@pytest.fixture
def copied(finished, tmp_path):
    """A copy of the finished run."""
    return shutil.copytree(finished, tmp_path / "run")


def test_more_steps_extend_a_finished_run_with_its_own_room_and_options(
        copied, finished, capsys):
    again = ["--resume", str(copied)]
    before = (copied / "episodes.csv").read_bytes()
    config = json.loads((copied / "config.json").read_text())
    (copied / "config.json").write_text(json.dumps(config | {"device": "cuda"}))
    shutil.copy(ROOT / "scenes" / "env2.toml", finished.with_name("room.toml"))
    train.main([*again, "--steps", "400", "--device", "cpu"])
    after = (copied / "episodes.csv").read_bytes()
    assert after.startswith(before) and len(after) > len(before)
    assert json.loads((copied / "config.json").read_text())["steps"] == 400
    [room] = load_model(copied)[1]
    assert (room.name, room.boxes) == ("room", ENV1.boxes)
    for option, words in ((["--seed", "5"], "--seed is 5, but run"),
                          (["--steps", "399"], "--steps is 399; it must be at least 400")):
        assert words in refusal(train.main, again + option, capsys)
    (copied / "config.json").write_text("[]")
    assert "resume a run with the program that started it" in refusal(train.main, again, capsys)


def test_a_damaged_checkpoint_gives_one_sentence_and_nothing_in_it_is_executed(copied, monkeypatch):
    monkeypatch.chdir(copied)
    file = copied / CHECKPOINT
    damaged = bytearray(file.read_bytes())
    damaged[len(damaged) // 2] ^= 1  # one bit in the weights
    folder = RunFolder(copied)
    message = "^'.*' is damaged .*, but its weights can be evaluated$"
    for save in (lambda: file.write_bytes(damaged), lambda: torch.save(Code(), file)):
        save()
        with pytest.raises(RunError, match=message):
            folder.load_checkpoint()
    assert not Path("executed").exists()


def test_a_run_under_way_cannot_be_resumed_by_another_program(copied, capsys):
    under_way = RunFolder(copied)
    message = refusal(train.main, ["--resume", str(copied)], capsys)
    assert message == f"error: run '{under_way.path}' is in use by another program\n"


def test_without_file_locks_a_run_is_not_protected(copied, monkeypatch):
    def flock(descriptor, operation):
        raise OSError(errno.ENOSYS, "Function not implemented")
    monkeypatch.setattr(run_folder.fcntl, "flock", flock)
    with RunFolder(copied) as first, RunFolder(copied) as second:
        first.load_checkpoint()
        second.load_checkpoint()
        assert first.state["steps"] == second.state["steps"] > 0


def test_runs_that_start_at_the_same_time_get_separate_folders(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)

    def make(_):
        config = train.Config()
        run_folder.make_folder(config, "env1")
        return config.out
    with ThreadPoolExecutor(8) as pool:
        made = set(pool.map(make, range(8)))
    assert made == {"runs/env1-seed0", *(f"runs/env1-seed0-{k}" for k in range(2, 9))}


@pytest.mark.parametrize("error, words", [
    (OSError(errno.ENOSPC, "No space left on device"), r".* No space left on device"),
    (FloatingPointError("the gradient is not finite"), "the gradient is not finite"),
    (ProcessLost("another process exited"), "another process exited")])
def test_an_error_that_ends_a_run_is_one_line(error, words, copied, monkeypatch):
    def fail(training, episodes):
        raise error
    monkeypatch.setattr(train.Training, "learn", fail)
    with pytest.raises(SystemExit) as end:
        train.main(["--resume", str(copied), "--steps", "900"])
    assert re.fullmatch(f"\nerror: {words}; resume with .* --resume {copied}", end.value.code)
