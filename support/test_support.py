"""Each test is the shortest proof of one claim about run folders, processes and range sensors."""

import csv
import json
import os
import pickle
import signal
import socket
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pytest
import torch

import ppo
import scenes
import sim
from model import make_network
from scenes.test_scenes import square_room
from support import processes, run_options
from support.adam import Adam
from support.processes import start_workers
from support.ranges import range_readings
from support.record import Record
from support.run_folder import RunError, RunFolder, WriteError, new_folder, write
from support.weights import load_run, save_model
from test_all import random_episodes
from train import Config

ROOT = Path(__file__).parent.parent
ENV1 = scenes.load("env1")


# -------------------------------------------------------------------------------------- run folders


def test_a_file_that_fails_while_it_is_written_leaves_the_old_one(tmp_path):
    write(tmp_path / "a.txt", "old")

    def fail(file):
        file.write(b"half")
        raise KeyboardInterrupt
    with pytest.raises(KeyboardInterrupt):
        write(tmp_path / "a.txt", fail)
    assert (tmp_path / "a.txt").read_text() == "old\n"


def test_a_folder_that_exists_is_never_taken(tmp_path):
    name = str(tmp_path / "run")
    for expected in ("run", "run-2", "run-3"):
        folder = RunFolder(Config(out=str(new_folder(name))), Record())
        assert folder.path.name == expected
    with pytest.raises(WriteError, match="File exists"):
        RunFolder(Config(out=name, seed=1), Record())
    assert json.loads((tmp_path / "run" / "config.json").read_text())["seed"] == 0


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


def run_train(folder, out, *arguments, torchrun=0):
    """Runs train.py, under torchrun in so many processes."""
    command = [sys.executable, str(ROOT / "train.py"), "--env", "env1", *TINY, "--out", out,
               *arguments]
    if torchrun:
        command[1:1] = ["-m", "torch.distributed.run", "--standalone", "--nproc-per-node",
                        str(torchrun)]
    done = subprocess.run(command, cwd=folder, capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    return (folder / out / "episodes.csv").read_bytes()


def test_torchrun_and_workers_share_a_training_and_write_the_same_bytes_again(tmp_path):
    alone = run_train(tmp_path, "alone", "--workers", "1")
    assert run_train(tmp_path, "torchrun-1", torchrun=1) == alone
    shared = run_train(tmp_path, "workers-2", "--workers", "2")
    assert run_train(tmp_path, "again", "--workers", "2") == shared != alone
    assert run_train(tmp_path, "torchrun-2", torchrun=2) == shared
    assert len(list(tmp_path.iterdir())) == 5  # the first process alone writes
    summary = json.loads((tmp_path / "again/summary.json").read_text())
    rows = list(csv.DictReader(open(tmp_path / "again/episodes.csv")))
    assert summary["steps"] == 600 and summary["episodes"] == len(rows) > 20
    assert len(list(csv.reader(open(tmp_path / "again/updates.csv")))) > 1
    assert json.loads((tmp_path / "torchrun-2/config.json").read_text())["workers"] == 2


def test_two_machines_write_what_two_workers_write(tmp_path):
    with socket.socket() as free:
        free.bind(("127.0.0.1", 0))
        port = str(free.getsockname()[1])
    machine = [sys.executable, "-m", "torch.distributed.run", "--nnodes", "2", "--nproc-per-node",
               "1", "--master-addr", "127.0.0.1", "--master-port", port]
    program = [str(ROOT / "train.py"), *TINY, "--out"]
    second = subprocess.Popen([*machine, "--node-rank", "1", *program, "two"], cwd=tmp_path)
    first = subprocess.run([*machine, "--node-rank", "0", *program, "two"], cwd=tmp_path,
                           capture_output=True, text=True, timeout=120)
    assert (first.returncode, second.wait(60)) == (0, 0), first.stderr
    shared = run_train(tmp_path, "workers", "--workers", "2")
    assert (tmp_path / "two" / "episodes.csv").read_bytes() == shared


@pytest.mark.parametrize("cores, options, torchrun, workers", [
    (1, {}, 0, 1), (2, {}, 0, 2), (3, {}, 0, 2), (4, {}, 0, 4), (16, {}, 0, 4),
    (2, {"robots": 7}, 0, 1), (4, {"robots": 9}, 0, 3), (4, {"device": "cuda"}, 0, 1),
    (4, {"episodes_per_update": 8}, 0, 2),  # of which a minibatch has two
    (4, {}, 8, 8)])
def test_there_are_as_many_workers_as_cores_that_can_share_the_robots(
        cores, options, torchrun, workers, monkeypatch):
    monkeypatch.setattr(run_options, "available_cores", lambda: list(range(cores)))
    monkeypatch.setenv("WORLD_SIZE", str(torchrun))
    assert run_options.default_workers(Config(**options)) == workers


def report(work, workers):
    """What a worker does that was started: work, and tell the first one what came of it."""
    workers.gather(work(workers))


def in_workers(count, work):
    """What work(processes) returns in each of so many workers."""
    threads = torch.get_num_threads()
    torch.set_num_threads(1)  # as in training: sums of several threads differ in the last bits
    workers = start_workers(count, report, work)
    results = workers.gather(work(workers))
    workers.close()
    torch.set_num_threads(threads)
    return results


def exchange(workers):
    numbers = torch.arange(processes.SLOT / 3) + 10 ** workers.rank  # more than a slot has room for
    mine = bytes([workers.rank]) * (processes.SLOT * workers.rank)
    return [(workers.gather(mine), workers.sum(numbers)[[0, -1]].tolist(),
             workers.count_all(workers.rank)) for _ in range(3)]


def test_workers_give_each_other_what_they_have_whatever_its_size():
    everyone = [b"", b"\1" * processes.SLOT, b"\2" * 2 * processes.SLOT]  # and some bytes around
    last = float(processes.SLOT // 3)
    expected = [(everyone, [111.0, 111.0 + 3 * last], 3)] * 3
    assert in_workers(3, exchange) == [expected] * 3


def weights_after_an_update(workers):
    net = make_network(0)
    config = Config(minibatches=2, epochs=1)
    ppo.update(net, Adam(net), 1e-3, random_episodes([3, 9, 5, 1, 7, 12, 4]), config,
               np.random.default_rng(0), workers)
    return np.concatenate([parameter.detach().numpy().ravel() for parameter in net.parameters()])


def test_workers_learn_together_what_one_learns_alone():
    alone = weights_after_an_update(processes.OneProcess())
    first, *others = in_workers(3, weights_after_an_update)
    assert all((first == other).all() for other in others)  # to the last bit
    before = np.concatenate([p.detach().numpy().ravel() for p in make_network(0).parameters()])
    assert np.abs(first - alone).max() < 0.01 * np.abs(alone - before).max()


def wait_for_children(pid):
    """The processes that a process has started, as soon as there is one and it has worked."""
    while True:
        children = Path(f"/proc/{pid}/task/{pid}/children").read_text().split()
        if children:
            time.sleep(3)
            return [int(child) for child in children]
        time.sleep(0.1)


@pytest.mark.skipif(not Path("/proc/self/task").exists(), reason="needs Linux")
@pytest.mark.parametrize("killed", ["a worker", "the first"])
def test_where_one_process_is_killed_no_other_waits_for_it(killed, tmp_path):
    training = subprocess.Popen(
        [sys.executable, str(ROOT / "train.py"), "--workers", "2", "--out", "run"], cwd=tmp_path,
        stdout=subprocess.DEVNULL, stderr=subprocess.PIPE, text=True)
    worker, = wait_for_children(training.pid)
    os.kill(worker if killed == "a worker" else training.pid, signal.SIGKILL)
    _, errors = training.communicate(timeout=30)
    if killed == "a worker":
        assert training.returncode == 1
        assert "\nerror: a worker of this training has ended" in errors
        assert "Traceback" not in errors
    while Path(f"/proc/{worker}").exists() and "Z" not in Path(f"/proc/{worker}/stat").read_text():
        time.sleep(0.1)  # the test's time limit: it must end by itself


def test_a_minibatch_is_cut_into_parts_of_nearly_the_same_size():
    lengths = np.array([200, 3, 90, 40, 80, 25, 7, 61])
    chosen = np.array([7, 0, 2, 4, 5, 6])
    parts = []
    for rank in range(3):
        worker = processes.Worker.__new__(processes.Worker)
        worker.rank, worker.count = rank, 3
        parts.append(worker.share(chosen, lengths))
    assert sorted(np.concatenate(parts)) == sorted(chosen)
    assert [lengths[part].sum() for part in parts] == [200, 90 + 25 + 7, 80 + 61]


# ------------------------------------------------------------------------------------------ Adam


def test_adam_changes_the_weights_as_torchs_own():
    net, twin = make_network(0), make_network(0)
    own, torchs = Adam(net), torch.optim.Adam(twin.parameters(), 1e-3, eps=1e-5)
    for seed in range(4):
        gradients = [torch.randn_like(parameter) * seed for parameter in net.parameters()]
        own.step(torch.cat([gradient.flatten() for gradient in gradients]), 1e-3)
        for parameter, gradient in zip(twin.parameters(), gradients):
            parameter.grad = gradient
        torchs.step()
    for one, other in zip(net.parameters(), twin.parameters()):
        assert torch.allclose(one, other, atol=1e-6)


# ------------------------------------------------------------------------------------ range sensors


def test_range_readings_match_the_distances_to_the_walls():
    world = sim.World([scenes.parse(square_room(), "room")])
    world.place([0], [(0.5, 0.25, 0.3)])
    readings = range_readings(world, np.array([0, 0.5, 1, -0.5]) * np.pi - 0.3, 8.0)
    assert np.allclose(readings, [(1.5, 1.75, 2.5, 2.25)])
    assert np.allclose(range_readings(world, [0.0], 1.0), 1.0)  # nothing within range


def test_range_readings_are_those_that_pymunk_finds_ray_by_ray():
    rooms = [scenes.load(name) for name in ("env1", "maze3", "lab", "random:5")]
    world = sim.World([rooms[k % 4] for k in range(12)])
    rng = np.random.default_rng(0)
    places = np.array([scene.any_place(rng) for scene in world.scenes])
    world.place(slice(None), np.column_stack([places, rng.uniform(-3, 3, 12)]))
    angles = np.linspace(0, 2 * np.pi, 17)
    readings = range_readings(world, angles, 2.0)
    for r, (x, y, theta) in enumerate(world.state()[:-1, :3]):  # where pymunk has them
        for angle, reading in zip(angles, readings[r]):
            end = (x + 2.0 * np.cos(theta + angle), y + 2.0 * np.sin(theta + angle))
            hit = world.space.segment_query_first((x, y), end, 0, sim.ROBOT_FILTER)
            assert reading == pytest.approx(2.0 * hit.alpha if hit else 2.0)
    assert (readings < 2).mean() > 0.5 and (readings == 2).any()
