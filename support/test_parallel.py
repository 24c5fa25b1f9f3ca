"""Tests of training and other jobs in several processes."""

import json
import os
import socket
import subprocess
import sys
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
import torch

import train
from model import make_network
from ppo import update
from support import parallel
from support.parallel import ProcessLost, gather, in_processes, run_together, total
from test_all import random_episodes

ROOT = Path(__file__).parent.parent
LENGTHS = (3, 9, 5, 1, 7, 12, 4, 2)
SECOND = 3  # number of these episodes that belong to the second process
CONFIG = SimpleNamespace(epochs=1, minibatches=1, gamma=0.99, lam=0.95, clip=0.2)


def gradient_of(episodes):
    """Returns the gradient of one update and its statistics."""
    model = make_network(0)
    optimizer = torch.optim.SGD(model.parameters(), 1.0)
    before = torch.cat([value.detach().flatten() for value in model.parameters()])
    statistics = update(model, optimizer, episodes, CONFIG, np.random.default_rng(0), total)
    after = torch.cat([value.detach().flatten() for value in model.parameters()])
    return (before - after).numpy(), statistics


def learn_together(config):
    """Returns the results of `gradient_of` in all processes, each with its own episodes."""
    episodes = random_episodes(LENGTHS)
    own = episodes[SECOND:] if parallel.rank() == 0 else episodes[:SECOND]
    return gather(gradient_of(own))


def test_processes_compute_the_same_update_as_one_process_with_all_episodes():
    (first, statistics), (second, _) = run_together(learn_together, train.Config(workers=2))
    alone, expected = gradient_of(random_episodes(LENGTHS))
    assert (first == second).all()  # to the last bit
    assert np.abs(first - alone).max() < 1e-4 * np.abs(alone).max()
    assert statistics == pytest.approx(expected, rel=1e-4, abs=1e-6)


def lose_the_second(config):
    """Exits in one process without a message, and waits for it in the other."""
    if parallel.rank() == 1:
        os._exit(9)
    total(torch.zeros(1))


def test_a_lost_process_gives_one_sentence():
    with pytest.raises(ProcessLost, match="^another training process exited unexpectedly"):
        run_together(lose_the_second, train.Config(workers=2))


def power(base, exponent):
    """Returns a power; exits if the base is negative."""
    if base < 0:
        os._exit(9)
    return base ** exponent


def test_results_of_several_processes_are_those_of_a_loop():
    jobs = [(base, 2) for base in range(7)]
    assert list(in_processes(power, jobs, 2)) == [power(*job) for job in jobs]
    assert list(in_processes(power, jobs, 1)) == [power(*job) for job in jobs]
    with pytest.raises(ProcessLost, match="^a worker process exited unexpectedly"):
        list(in_processes(power, [(1, 2), (-1, 2)], 2))


def processes(monkeypatch, torchrun=0, gloo=True, **options):
    """Returns the number of processes of a training run on a machine with a GPU."""
    monkeypatch.setattr(parallel, "has_gloo", lambda: gloo)
    monkeypatch.setattr(torch.cuda, "is_available", lambda: True)
    monkeypatch.setenv("WORLD_SIZE", str(torchrun))
    config = train.Config(**options)
    parallel.check_processes(config, SimpleNamespace(given=options, error=pytest.fail))
    return config.workers


@pytest.mark.parametrize("expected, options", [
    (1, dict()), (5, dict(workers=5)), (8, dict(torchrun=8)), (8, dict(torchrun=8, workers=8)),
    (8, dict(torchrun=8, device="cuda"))])
def test_the_default_is_one_process_or_those_of_torchrun(expected, options, monkeypatch):
    assert processes(monkeypatch, **options) == expected


@pytest.mark.parametrize("words, options", [
    ("--workers is 2, but torchrun started 8 processes", dict(torchrun=8, workers=2)),
    ("--workers is 1, but torchrun started 8 processes", dict(torchrun=8, resume="run")),
    ("it must be 1 unless torchrun starts them", dict(workers=2, device="cuda")),
    ("gloo is missing or fails here; it must be 1", dict(workers=2, gloo=False))])
def test_processes_that_cannot_start_get_one_sentence(words, options, monkeypatch):
    with pytest.raises(pytest.fail.Exception, match=words):
        processes(monkeypatch, **options)


def test_torchrun_trains_on_two_machines(tmp_path):
    with socket.create_server(("localhost", 0)) as server:
        port = server.getsockname()[1]  # a free one
    command = [sys.executable, "-m", "torch.distributed.run", "--nnodes", "2", "--rdzv-backend",
               "c10d", "--rdzv-endpoint", f"localhost:{port}", ROOT / "train.py", "--env", "env1",
               "--steps", "500", "--robots", "8", "--episodes-per-update", "4", "--minibatches",
               "1", "--fixed-budget", "--evaluation-episodes", "2"]
    folders = [tmp_path / name for name in ("first", "second")]
    for folder in folders:
        folder.mkdir()
    machines = [subprocess.Popen(command, cwd=folder) for folder in folders]
    assert [machine.wait(100) for machine in machines] == [0, 0]
    summaries = [summary for folder in folders for summary in folder.rglob("summary.json")]
    assert [json.loads(summary.read_text())["steps"] for summary in summaries] == [504]
