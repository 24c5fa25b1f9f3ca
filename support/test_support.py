"""Each test is the shortest proof of one claim about run folders, processes and range sensors."""

import csv
import json
import pickle
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
import torch

import scenes
import sim
from model import make_network
from scenes.test_scenes import square_room
from support.ranges import range_readings
from support.run_folder import RunError, RunFolder, load_run, new_folder, save_model, write

ROOT = Path(__file__).parent.parent
ENV1 = scenes.load("env1")


# -------------------------------------------------------------------------------------- run folders


def test_a_file_that_fails_while_it_is_written_leaves_the_old_one(tmp_path):
    write(tmp_path / "a.txt", "old")

    def fail(path):
        path.write_text("half")
        raise KeyboardInterrupt
    with pytest.raises(KeyboardInterrupt):
        write(tmp_path / "a.txt", fail)
    assert (tmp_path / "a.txt").read_text() == "old\n"


def test_a_folder_that_exists_is_never_taken(tmp_path):
    name = str(tmp_path / "run")
    for expected in ("run", "run-2", "run-3"):
        folder = RunFolder(new_folder(name), {"seed": 0})
        assert folder.path.name == expected
    with pytest.raises(OSError):
        RunFolder(name, {"seed": 1})
    assert json.loads((tmp_path / "run" / "config.json").read_text()) == {"seed": 0}


@pytest.fixture(scope="module")
def saved(tmp_path_factory):
    """A network, and the file that it is saved in."""
    file = tmp_path_factory.mktemp("saved") / "model.pt"
    net = make_network(3, "single", "target")
    save_model(file, net, [ENV1, scenes.load("env2")])
    return net, file


def test_a_saved_model_comes_back_with_its_scenes(saved):
    net, file = saved
    loaded, rooms = load_run(file)
    assert rooms == [ENV1, scenes.load("env2")]
    assert (loaded.memory, loaded.without) == ("single", "target")
    for name, value in net.state_dict().items():
        assert torch.equal(loaded.state_dict()[name], value)


class Code:
    """What unpickles to a call."""
    def __reduce__(self):
        return Path.touch, (Path("executed"),)


def spoil(content, how, file):
    """Writes a run that cannot be used."""
    if how == "empty":
        file.touch()
    elif how == "half-written":
        file.write_bytes(file.with_name("model.pt").read_bytes()[:100_000])
    elif how == "code":
        file.write_bytes(pickle.dumps(Code()))
    else:
        if how == "another size":
            content["weights"]["value.weight"] = torch.zeros(1, 7)
        elif how == "no scenes":
            del content["scenes"]
        elif how == "another room":
            content["scenes"][0]["start"] = (9.0, 9.0, 0.0)
        elif how == "another kind":
            content = [1, 2]
        torch.save(content, file)


@pytest.mark.parametrize("how", ["empty", "half-written", "code", "another size", "no scenes",
                                 "another room", "another kind"])
def test_a_run_that_cannot_be_used_is_one_line_and_nothing_is_executed(how, saved, monkeypatch):
    _, file = saved
    monkeypatch.chdir(file.parent)
    bad = file.with_name("bad.pt")
    spoil(torch.load(file, weights_only=True), how, bad)
    with pytest.raises(RunError) as error:
        load_run(bad)
    assert str(bad) in str(error.value) and "\n" not in str(error.value)
    assert not Path("executed").exists()
    bad.unlink()


@pytest.mark.parametrize("path", ["none", "."])
def test_a_run_that_is_not_there_is_said(path, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    with pytest.raises(RunError, match="it must be a run folder or a .pt file"):
        load_run(path)


# ---------------------------------------------------------------------------------------- processes


TINY = ["--steps", "600", "--robots", "8", "--episodes-per-update", "8",
        "--evaluation-episodes", "4"]


def start(processes, script, *arguments, cwd):
    """Starts the script in so many processes that share the work; 0 is without torchrun."""
    command = [sys.executable, str(script), *arguments]
    if processes:
        command[1:1] = ["-m", "torch.distributed.run", "--standalone", "--nproc-per-node",
                        str(processes)]
    return subprocess.run(command, cwd=cwd, capture_output=True, text=True)


def test_one_process_under_torchrun_gives_what_no_torchrun_gives_and_two_share_the_work(tmp_path):
    for processes in (0, 1, 2):
        done = start(processes, ROOT / "train.py", "--env", "env1", *TINY, "--out",
                     str(processes), cwd=tmp_path)
        assert done.returncode == 0, done.stderr
    alone = (tmp_path / "0/episodes.csv").read_bytes()
    assert (tmp_path / "1/episodes.csv").read_bytes() == alone
    assert sorted(path.name for path in tmp_path.iterdir()) == ["0", "1", "2"]
    summary = json.loads((tmp_path / "2/summary.json").read_text())
    rows = list(csv.DictReader(open(tmp_path / "2/episodes.csv")))
    assert summary["steps"] == 600 and summary["episodes"] == len(rows) > 20
    assert len(list(csv.reader(open(tmp_path / "2/updates.csv")))) > 1


HALF = """
import torch
import ppo
import test_all
from support.processes import join_processes
processes = join_processes("cpu")
net = test_all.network()
episodes = test_all.random_episodes([3, 9, 5])
mine = episodes[:1] if processes.rank == 0 else episodes[1:]
batch = ppo.make_minibatch(mine, [e.rewards for e in mine])
sum(ppo.losses(net, batch, 0.2)[:2]).backward()
processes.average_gradients(net, int(batch["mask"].sum()))
mean_and_std = ppo.mean_and_std([e.rewards for e in mine], processes)
torch.save(([p.grad for p in net.parameters()], mean_and_std), f"{processes.rank}.pt")
"""


def test_two_processes_have_the_gradients_and_the_advantages_of_one(tmp_path):
    import ppo
    import test_all
    (tmp_path / "half.py").write_text(f"import sys\nsys.path.insert(0, {str(ROOT)!r})\n{HALF}")
    done = start(2, tmp_path / "half.py", cwd=tmp_path)
    assert done.returncode == 0, done.stderr
    net = test_all.network()
    episodes = test_all.random_episodes([3, 9, 5])
    batch = ppo.make_minibatch(episodes, [e.rewards for e in episodes])
    sum(ppo.losses(net, batch, 0.2)[:2]).backward()
    rewards = torch.cat([e.rewards for e in episodes])
    (first, one), (second, other) = (torch.load(tmp_path / f"{rank}.pt") for rank in (0, 1))
    assert one == other == pytest.approx((rewards.mean().item(), rewards.std(correction=0).item()))
    for parameter, a, b in zip(net.parameters(), first, second):
        assert torch.equal(a, b) and torch.allclose(a, parameter.grad, rtol=1e-3, atol=1e-6)


# ------------------------------------------------------------------------------------ range sensors


def test_range_readings_match_the_distances_to_the_walls():
    world = sim.World([scenes.parse(square_room(), "room")])
    world.place([0], [(0.5, 0.25, 0.3)])
    readings = range_readings(world, np.array([0, 0.5, 1, -0.5]) * np.pi - 0.3, 8.0)
    assert np.allclose(readings, [(1.5, 1.75, 2.5, 2.25)])
    assert np.allclose(range_readings(world, [0.0], 1.0), 1.0)  # nothing within range
