"""Trainings that are cut: what was there goes on as if nothing had happened, or is refused."""

import contextlib
import copy
import csv
import errno
import json
import math
import os
import random
import resource
import shutil
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest
import torch

import navbot_min
import ppo
import scenes
import train
from scenes import generate
from support import checkpoints, rooms
from support.adam import Adam
from support.checkpoints import Keeper
from support.processes import OneProcess
from support.run_folder import RunError, RunFolder, WriteError
from support.run_options import faults_as_one_line
from train import Config, Training

ROOT = Path(__file__).parent.parent
ENV1 = scenes.load("env1")
SHORT = ["--steps", "3000", "--robots", "8", "--episodes-per-update", "8", "--minibatches", "2",
         "--fixed-budget", "--evaluation-episodes", "8"]
KILLS = int(os.environ.get("KILLS", 3))  # that `test_killed_at_any_moment...` makes; 50 once
TORCHRUN = ["-m", "torch.distributed.run", "--standalone", "--nproc-per-node"]


# train.py with a checkpoint after every update, and what else a test puts in.
PROGRAM = """
import sys
sys.path.insert(0, {root!r})
from support import checkpoints
checkpoints.EVERY = 0
checkpoints.SHARE = 1e9
import train
{more}
if __name__ == "__main__":
    train.main()
"""


def start(folder, *options, processes=1, torchrun=False, more=""):
    """A training in processes of their own, a group."""
    program = folder.parent / f"{folder.name}.py"
    program.write_text(PROGRAM.format(root=str(ROOT), more=more))
    command = [sys.executable, *(TORCHRUN + [str(processes)] if torchrun else []), str(program)]
    return subprocess.Popen(command + list(options), stdout=subprocess.DEVNULL,
                            stderr=subprocess.PIPE, text=True, start_new_session=True)


def begin(folder, processes=1, torchrun=False, more=""):
    """A short training into that folder."""
    workers = [] if torchrun else ["--workers", str(processes)]
    return start(folder, *SHORT, *workers, "--out", str(folder), processes=processes,
                 torchrun=torchrun, more=more)


def go_on(folder, *options, processes=1, torchrun=False, more=""):
    """Resumes a run, and waits for its end."""
    process = start(folder, "--resume", str(folder), *options, processes=processes,
                    torchrun=torchrun, more=more)
    _, said = process.communicate(timeout=120)
    assert process.returncode == 0, said


def updates(folder):
    """How many updates a run has made so far."""
    file = folder / "updates.csv"
    return len(file.read_text().splitlines()) - 1 if file.exists() else 0


def wait_for(condition, process):
    """Waits until the condition holds, a minute at most; the process must not end before."""
    for _ in range(12000):
        if condition():
            return
        assert process.poll() is None, process.communicate()
        time.sleep(0.005)
    raise TimeoutError


def content(folder):
    """All that a finished run's folder holds, by file, but for the time that it took."""
    files = {file.name: file.read_bytes() for file in folder.iterdir()}
    assert all(not name.startswith(".") for name in files)
    for name in (checkpoints.LAST, checkpoints.BEFORE, "config.json"):
        files.pop(name, None)
    summary = json.loads(files["summary.json"])
    del summary["seconds"]
    files["summary.json"] = summary
    rows = list(csv.reader(files["updates.csv"].decode().splitlines()))
    files["updates.csv"] = [row[:-1] for row in rows]  # but for the steps per second
    return files


def run_whole(place, begin_one):
    """The folders of whole runs, by the number of processes. begin_one: begins such a run."""
    folders = {count: place / f"run-{count}" for count in (1, 2)}
    for count, folder in folders.items():
        process = begin_one(folder, count)
        assert process.wait(120) == 0, process.communicate()
    return folders


@pytest.fixture(scope="module")
def whole(tmp_path_factory):
    """What runs hold that were never cut, by the number of processes."""
    folders = run_whole(tmp_path_factory.mktemp("whole"), begin)
    return {count: content(folder) for count, folder in folders.items()}


@pytest.fixture(scope="module")
def seconds(whole, tmp_path_factory):
    """How long such a run takes here and now, from its start to its end."""
    begun = time.monotonic()
    assert begin(tmp_path_factory.mktemp("timed") / "run").wait(120) == 0
    return time.monotonic() - begun


CUTS = [(1, False, signal.SIGINT), (1, False, signal.SIGTERM), (2, False, signal.SIGINT),
        (2, False, signal.SIGTERM), (2, True, signal.SIGINT), (1, False, signal.SIGHUP)]


@pytest.mark.parametrize("processes, torchrun, number", CUTS)
def test_an_interrupted_run_is_saved_and_goes_on_to_the_same_bytes(
        whole, tmp_path, processes, torchrun, number):
    folder = tmp_path / "run"
    process = begin(folder, processes, torchrun)
    wait_for(lambda: updates(folder) >= 2, process)
    os.killpg(process.pid, number)  # as a terminal does
    _, said = process.communicate(timeout=60)
    if not torchrun:  # which has an exit code and words of its own
        assert process.returncode == 128 + number
        assert "Traceback" not in said
    if not torchrun and number != signal.SIGHUP:  # after which nobody could read it
        go = f"interrupted: go on with python train.py --resume {folder}"
        assert said.splitlines()[-1] == go
    assert not (folder / "model.pt").exists()
    go_on(folder, processes=processes, torchrun=torchrun)
    assert content(folder) == whole[processes]


def test_a_run_that_is_killed_at_any_moment_goes_on_to_the_same_bytes(
        whole, seconds, tmp_path):
    rng = random.Random(KILLS)
    for k in range(KILLS):
        folder = tmp_path / f"run{k}"
        processes = 1 + k % 2
        process = begin(folder, processes)
        try:
            process.wait(rng.uniform(0, seconds))
        except subprocess.TimeoutExpired:
            pass
        process.kill()  # the first process alone
        process.communicate()
        wait_for_the_end_of(process.pid)
        if (folder / "config.json").exists():
            go_on(folder, processes=processes)
        else:  # it had hardly begun
            assert not folder.exists()
            assert begin(folder, processes).wait(120) == 0
        assert content(folder) == whole[processes], k


KILL = "import os, signal\ndef kill(*_):\n    os.kill(os.getpid(), signal.SIGKILL)\n"
REPLACE = """
replace = os.replace
calls = []
def cut(source, target):
    calls.append(target)
    now = str(target).endswith({name!r}) and len(calls) > 12
    if now and not {after}:
        kill()
    replace(source, target)
    if now:
        kill()
os.replace = cut
"""
AFTER = "from evaluation import after_training\n"
POINTS = {
    "a checkpoint is moved into its place": REPLACE.format(name="/checkpoint.pt", after=False),
    "the last became the one before": REPLACE.format(name="-before.pt", after=True),
    "curves are drawn": AFTER + "after_training.draw_curves = kill",
    "the policy is evaluated": AFTER + "after_training.evaluate_frozen = kill"}


@pytest.mark.parametrize("point", POINTS)
def test_a_run_that_is_killed_while_it_writes_goes_on_to_the_same_bytes(point, whole, tmp_path):
    folder = tmp_path / "run"
    process = begin(folder, more=KILL + POINTS[point])
    process.communicate(timeout=120)
    assert process.returncode == -signal.SIGKILL
    assert any((folder / name).exists() for name in (checkpoints.LAST, checkpoints.BEFORE))
    go_on(folder)
    assert content(folder) == whole[1]


def wait_for_the_end_of(group):
    """Waits until a group of processes is empty."""
    for _ in range(1000):
        try:
            os.killpg(group, 0)
        except ProcessLookupError:
            return
        time.sleep(0.01)
    raise TimeoutError


@pytest.mark.skipif(not hasattr(resource, "prlimit"), reason="sets a limit of another process")
def test_a_disk_without_room_is_one_line_and_the_last_checkpoint_goes_on(whole, tmp_path):
    folder = tmp_path / "run"
    process = begin(folder)
    wait_for(lambda: updates(folder) >= 3, process)
    resource.prlimit(process.pid, resource.RLIMIT_FSIZE, (1000, 1000))  # bytes of a file
    _, said = process.communicate(timeout=60)
    assert process.returncode == 1 and "Traceback" not in said
    last = said.splitlines()[-1]
    assert last.startswith(f"error: '{folder}/") and "cannot be written: File too large" in last
    go_on(folder)
    assert content(folder) == whole[1]


def test_a_second_signal_ends_a_run_at_once_and_breaks_nothing(whole, tmp_path):
    folder = tmp_path / "run"
    # An update that never ends: only the second signal helps.
    stuck = "import time; learn = train.Training.learn\ntrain.Training.learn = lambda self: (" \
            "time.sleep(600) if len(self.record.updates) == 2 else learn(self))"
    process = begin(folder, 2, more=stuck)
    wait_for(lambda: updates(folder) == 2, process)
    time.sleep(0.5)
    process.send_signal(signal.SIGINT)
    time.sleep(0.5)
    assert process.poll() is None
    process.send_signal(signal.SIGINT)
    assert process.wait(10) == 130
    wait_for_the_end_of(process.pid)
    go_on(folder, processes=2)
    assert content(folder) == whole[2]


@pytest.mark.skipif(not Path("/proc/self/maps").exists(), reason="looks at what is loaded")
def test_ctrl_c_while_torch_loads_is_one_line(tmp_path):
    process = subprocess.Popen([sys.executable, str(ROOT / "train.py"), "--out", "run"],
                               cwd=tmp_path, stderr=subprocess.PIPE, text=True)
    wait_for(lambda: "libtorch" in Path(f"/proc/{process.pid}/maps").read_text(), process)
    process.send_signal(signal.SIGINT)
    _, said = process.communicate(timeout=60)
    assert (process.returncode, said) == (130, "\ninterrupted: nothing was begun\n")
    assert not list(tmp_path.iterdir())


def test_ctrl_c_outside_of_training_is_one_line_and_what_is_missing_is_made(whole, tmp_path):
    folder = tmp_path / "run"
    stuck = "from evaluation import after_training\nimport time\n" \
            "after_training.evaluate_frozen = lambda *_: time.sleep(600)"
    process = begin(folder, more=stuck)
    wait_for((folder / "summary.json").exists, process)
    process.send_signal(signal.SIGINT)
    _, said = process.communicate(timeout=60)
    assert process.returncode == 130 and "Traceback" not in said
    assert said.endswith(f"\ninterrupted: go on with python train.py --resume {folder}\n")
    go_on(folder)
    assert content(folder) == whole[1]


# ----------------------------------------------------------------------------- in random rooms


# Rooms that are made at once, and moves after every 500 steps.
MOVES = """
import scenes
from scenes import generate
from scenes.test_scenes import square_room
from support import rooms
generate.room = lambda seed: scenes.parse(
    square_room(0.6 + seed % 7 / 10, training_targets=[[0.2, 0.0]], new_targets=[]),
    f"random-{seed}")
rooms.EVERY = 2000  # of 64 robots
rooms.VALIDATION_ROOMS = 2
"""


def begin_in_random_rooms(folder, processes):
    """A short training into that folder whose robots move on several times."""
    return start(folder, *SHORT, "--env", "random", "--robots", "16", "--workers", str(processes),
                 "--out", str(folder), more=MOVES)


@pytest.fixture(scope="module")
def in_random_rooms(tmp_path_factory):
    """Runs in random rooms that were never cut, by the number of processes."""
    return run_whole(tmp_path_factory.mktemp("random"), begin_in_random_rooms)


@pytest.mark.parametrize("processes, number", [(1, signal.SIGKILL), (2, signal.SIGINT)])
def test_a_run_in_random_rooms_that_is_cut_goes_on_to_the_same_bytes(
        in_random_rooms, tmp_path, processes, number):
    folder = tmp_path / "run"
    process = begin_in_random_rooms(folder, processes)
    wait_for(lambda: updates(folder) >= 4, process)
    os.killpg(process.pid, number)
    process.communicate(timeout=60)
    wait_for_the_end_of(process.pid)
    rooms_before = rooms_of(folder)
    go_on(folder, processes=processes, more=MOVES)
    assert content(folder) == content(in_random_rooms[processes])
    assert 8 < len(rooms_before) < len(rooms_of(folder)) - 3


def rooms_of(folder):
    """The names of the rooms that a run's episodes were driven in."""
    with open(folder / "episodes.csv", newline="") as file:
        return {row["scene"] for row in csv.DictReader(file)}


def test_wrong_moves_of_a_checkpoint_are_one_sentence_and_make_no_more_rooms(in_random_rooms,
                                                                             monkeypatch):
    file = in_random_rooms[1] / checkpoints.LAST
    config = config_of(in_random_rooms[1])
    whole = checkpoints.read_torch_file(file, checkpoints.LARGEST)
    moves = whole["state"]["rooms"]["moves"]
    made = []
    monkeypatch.setattr(generate, "room", lambda seed: made.append(seed) or ENV1)
    monkeypatch.setattr(rooms, "EVERY", 2000)
    for wrong in [None, -1, True, 2.0, math.inf, "1", [], [1], {}, torch.zeros(1), 10 ** 40,
                  10 ** 6, moves + 2]:
        content = changed(whole, ("state", "rooms", "moves"), wrong)
        monkeypatch.setattr(checkpoints, "read_torch_file", lambda *_: content)
        with pytest.raises(RunError, match="checkpoint.pt' is no whole checkpoint of this run$"):
            checkpoints.read(file, config, Training)
        assert len(made) <= 2 * 15  # to compare with, and for what is read
        made.clear()
    monkeypatch.setattr(checkpoints, "read_torch_file", lambda *_: whole)
    _, [state] = checkpoints.read(file, config, Training)
    assert state["rooms"] == {"moves": moves} and moves >= 4


# ------------------------------------------------------------------------- what is no number


def nan_statistics(monkeypatch):
    losses = ppo.losses
    nothing = torch.full((5,), math.nan)
    monkeypatch.setattr(ppo, "losses", lambda *args: (*losses(*args)[:2], nothing))


def nan_gradient(monkeypatch):
    gradient = ppo.gradient

    def broken(*arguments):
        slope, statistics = gradient(*arguments)
        slope[7] = math.inf
        return slope, statistics
    monkeypatch.setattr(ppo, "gradient", broken)


def inf_weights(monkeypatch):
    step = Adam.step

    def broken(self, *arguments):
        step(self, *arguments)
        self.parameters[0].data[0] = math.inf
    monkeypatch.setattr(Adam, "step", broken)


def nan_observation(monkeypatch):
    observe = navbot_min.NavVecEnv.observe

    def broken(*arguments):
        observation = observe(*arguments)
        observation["velocity"][-1, 0] = math.nan
        return observation
    monkeypatch.setattr(navbot_min.NavVecEnv, "observe", broken)


@pytest.mark.parametrize("place, fault", [
    ("the loss", nan_statistics), ("the gradient", nan_gradient), ("a weight", inf_weights),
    ("an observation or an action", nan_observation)])
def test_what_is_not_finite_ends_a_run_in_words_and_is_never_saved(
        place, fault, tmp_path, monkeypatch):
    config = Config(robots=4, episodes_per_update=4, minibatches=1, epochs=1, workers=1,
                    out=str(tmp_path / "run"))
    training = Training(config, [ENV1], OneProcess())
    monkeypatch.setattr(checkpoints, "EVERY", 0)
    monkeypatch.setattr(checkpoints, "SHARE", 1e9)
    folder = RunFolder(config, training.record)
    learn = Training.learn

    def learn_and_break(self):
        row = learn(self)
        if len(self.record.updates) == 1:  # from the third on
            fault(monkeypatch)
        return row
    monkeypatch.setattr(Training, "learn", learn_and_break)
    with pytest.raises(SystemExit) as end, faults_as_one_line(config, training.record):
        train.train(training, folder, Keeper(folder, [ENV1]))
    assert f"{place} of update 3 is not finite" in end.value.code
    assert "try a new run with a --learning-rate below 0.001" in end.value.code
    monkeypatch.undo()
    scenes_saved, [state] = checkpoints.load(config, Training)
    assert scenes_saved == [ENV1]
    assert len(state["record"]["updates"]) == 2
    assert all(torch.isfinite(value).all() for value in state["model"].values())


def test_what_only_one_process_sees_that_is_not_finite_ends_them_all(tmp_path):
    blind = """
import math, multiprocessing, navbot_min
observe = navbot_min.NavVecEnv.observe
def broken(*arguments):
    observation = observe(*arguments)
    if multiprocessing.parent_process() is not None:
        observation["target"][0] = math.nan
    return observation
navbot_min.NavVecEnv.observe = broken
"""
    process = begin(tmp_path / "run", 2, more=blind)
    _, said = process.communicate(timeout=60)
    assert process.returncode == 1 and "Traceback" not in said
    assert "error: an observation or an action of update 1 is not finite" in said
    wait_for_the_end_of(process.pid)


# --------------------------------------------------------------------------- what is refused


@pytest.fixture(scope="module")
def finished(tmp_path_factory):
    """A finished run's folder."""
    folder = tmp_path_factory.mktemp("finished") / "run"
    assert begin(folder).wait(120) == 0
    return folder


def refused(capsys, *options):
    """What train.py says as it refuses these options."""
    with pytest.raises(SystemExit) as end:
        train.main(list(options))
    said = capsys.readouterr().err
    assert end.value.code == 2 and said.startswith("error: ") and said.count("\n") == 1
    return said


def test_a_run_goes_on_with_its_own_options_alone(finished, capsys, tmp_path):
    run = str(finished)
    assert "--seed is 5, but" in refused(capsys, "--resume", run, "--seed", "5")
    assert "--memory is none, but" in refused(capsys, "--memory", "none", "--resume", run)
    assert "must be at least 3000" in refused(capsys, "--resume", run, "--steps", "2999")
    assert "is no run folder" in refused(capsys, "--resume", str(tmp_path))
    assert "is no run folder" in refused(capsys, "--resume", "")


def test_more_steps_lengthen_a_run(finished, tmp_path):
    folder = shutil.copytree(finished, tmp_path / "run")
    before = (folder / "episodes.csv").read_bytes()
    go_on(folder, "--steps", "4000")
    assert json.loads((folder / "summary.json").read_text())["steps"] == 4000
    assert json.loads((folder / "config.json").read_text())["steps"] == 4000
    after = (folder / "episodes.csv").read_bytes()
    assert after.startswith(before) and len(after) > len(before)


def test_a_damaged_checkpoint_is_passed_over_for_the_one_before_it(finished, tmp_path):
    folder = shutil.copytree(finished, tmp_path / "run")
    damaged = bytearray((folder / checkpoints.LAST).read_bytes())
    del damaged[len(damaged) // 2:]
    (folder / checkpoints.LAST).write_bytes(damaged)
    config = config_of(folder)
    _, [state] = checkpoints.load(config, Training)
    assert 0 < state["record"]["steps"] < 3000
    (folder / checkpoints.BEFORE).write_bytes(damaged)
    with pytest.raises(RunError, match="checkpoint-before.pt' is no whole"):
        checkpoints.load(config, Training)


def test_a_damaged_checkpoint_never_takes_the_place_of_a_whole_one(finished, tmp_path, capsys):
    folder = shutil.copytree(finished, tmp_path / "run")
    before = (folder / checkpoints.BEFORE).read_bytes()
    (folder / checkpoints.LAST).write_bytes(b"damaged")
    config = config_of(folder)
    config.resume = config.out
    _, states = checkpoints.load(config, Training)
    assert "going on from checkpoint-before.pt" in capsys.readouterr().err
    training = Training(config, [ENV1], OneProcess(), states)
    Keeper(RunFolder(config, training.record), [ENV1]).save(training)
    assert (folder / checkpoints.BEFORE).read_bytes() == before
    assert (folder / checkpoints.DAMAGED).read_bytes() == b"damaged"
    checkpoints.load(config, Training)
    assert capsys.readouterr().err == ""


@pytest.mark.parametrize("number", [errno.ENOSPC, errno.EROFS, errno.EDQUOT])
def test_a_disk_that_takes_no_more_leaves_both_checkpoints(number, finished, tmp_path, monkeypatch):
    folder = shutil.copytree(finished, tmp_path / "run")
    (folder / ".notes").touch()  # of somebody else
    config = config_of(folder)
    config.resume = config.out
    training = Training(config, [ENV1], OneProcess())
    run = RunFolder(config, training.record)
    names = (checkpoints.LAST, checkpoints.BEFORE)
    whole = [(folder / name).read_bytes() for name in names]

    def full(*_):
        raise OSError(number, os.strerror(number))
    monkeypatch.setattr(os, "fsync", full)
    with pytest.raises(WriteError, match=f"checkpoint.pt' cannot be.*{os.strerror(number)}"):
        Keeper(run, [ENV1]).save(training)
    assert [(folder / name).read_bytes() for name in names] == whole
    assert [path.name for path in folder.glob(".*")] == [".notes"]


def test_cut_and_flipped_checkpoints_are_refused_in_one_sentence(finished, tmp_path):
    rng = random.Random(0)
    whole = (finished / checkpoints.LAST).read_bytes()
    for _ in range(60):
        spoilt = bytearray(whole)
        for _ in range(rng.choice([1, 3, 100])):
            spoilt[rng.randrange(len(spoilt))] ^= rng.randrange(1, 256)
        if rng.random() < 0.3:
            del spoilt[rng.randrange(len(spoilt)):]
        (tmp_path / checkpoints.LAST).write_bytes(spoilt)
        try:
            checkpoints.read_torch_file(tmp_path / checkpoints.LAST, checkpoints.LARGEST)
        except RunError as error:
            assert len(str(error)) < 200 and str(error).isprintable()


def test_a_run_goes_on_in_the_room_that_it_began_in(tmp_path):
    room = tmp_path / "room.toml"
    room.write_text((ROOT / "scenes" / "env1.toml").read_text())
    config = Config(env=str(room), out=str(tmp_path / "run"), workers=1, robots=4)
    own = scenes.load(str(room))
    training = Training(config, [own], OneProcess())
    Keeper(RunFolder(config, training.record), [own]).save(training)
    room.write_text((ROOT / "scenes" / "env2.toml").read_text())
    saved_scenes, _ = checkpoints.load(config, Training)
    assert saved_scenes == [own] != [scenes.load(str(room))]


def config_of(folder):
    """The Config of a run, in that folder."""
    return Config(**json.loads((folder / "config.json").read_text()) | {"out": str(folder)})


def leaves(content, path=()):
    """The paths to all that is in dicts and lists, of a list its first item."""
    if isinstance(content, dict) and content:
        return [leaf for name in content for leaf in leaves(content[name], (*path, name))]
    if isinstance(content, list) and content:
        return leaves(content[0], (*path, 0))
    return [path]


def changed(content, path, value):
    """A copy of the content with another value at that path."""
    if not path:
        return value(content) if callable(value) else value
    copied = content.copy()
    copied[path[0]] = changed(content[path[0]], path[1:], value)
    return copied


WRONG = [None, "x" * 1000, -1, 10 ** 40, math.nan, -math.inf, [], {}, True, torch.zeros(3),
         lambda old: [old], lambda old: {"a": old}, lambda old: old[:-1], lambda old: old.double(),
         lambda old: old * -10 ** 9, lambda old: old / 0, lambda old: old[None]]


def test_a_checkpoint_with_anything_wrong_in_it_is_one_sentence(finished, monkeypatch):
    config = config_of(finished)
    whole = checkpoints.read_torch_file(finished / checkpoints.LAST, checkpoints.LARGEST)
    training = Training(config, [ENV1], OneProcess())  # one is enough, and so is one room
    clean = copy.deepcopy(training.state())

    def make(*_):
        training.load_state(copy.deepcopy(clean))
        return training
    monkeypatch.setattr(checkpoints, "scenes_of", lambda saved: [ENV1])
    refused = used = 0
    for path in leaves({name: part for name, part in whole.items() if name != "scenes"}):
        for wrong in WRONG:
            try:
                content = changed(whole, path, wrong)
            except (TypeError, AttributeError, RuntimeError, ArithmeticError, LookupError):
                continue  # not to be done to this value
            monkeypatch.setattr(checkpoints, "read_torch_file", lambda *_: content)
            try:
                checkpoints.read(finished / checkpoints.LAST, config, make)
            except RunError as error:
                assert "\n" not in str(error)
                refused += 1
            else:  # a number of a row, a pose or a weight may be any finite one
                with contextlib.suppress(FloatingPointError):
                    training.collector.step()
                used += 1
    assert refused > 700 and used < refused / 4, (refused, used)


def test_two_programs_never_write_to_one_run(tmp_path):
    config = Config(out=str(tmp_path / "run"))
    folder = RunFolder(config, train.Record())
    with pytest.raises(RunError, match="under way in another program"):
        RunFolder(Config(out=config.out, resume=config.out), train.Record())
    shutil.rmtree(folder.path)
    with pytest.raises(WriteError, match="summary.json' cannot be written: No such file"):
        folder.write("summary.json", "{}")
