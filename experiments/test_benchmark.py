"""Tests of the benchmark and of the peers. No test depends on a speed."""

import json
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
import torch

import ppo
from evaluation import evaluate
from experiments import benchmark, clocked, peers
from navbot_min import NavVecEnv

ROOT = Path(__file__).parent.parent
SMALL = peers.Settings(2, 6, 1, 2, 1e-3, 0.2, True)


def test_the_timed_training_runs_train_py(monkeypatch):
    monkeypatch.chdir(ROOT)
    training = benchmark.train(*benchmark.SHORT[:-1], "4000", "--workers", "1")
    seconds = {part: sum(taken) for part, taken in training["seconds"].items()}
    assert training["sps"] > 0
    assert seconds["collecting"] > seconds["acting"] + seconds["environment"]
    assert seconds["training"] > seconds["collecting"] + seconds["gradient"] + seconds["optimizer"]
    assert len(training["seconds"]["acting"]) == 63  # calls with 64 robots, without the evaluation


def test_the_benchmark_writes_the_published_numbers_and_their_plot(tmp_path, monkeypatch):
    speeds = iter([100, 80, 40, 10, 20, 30, 1, 4, 3])  # idle: 3 rounds of 3 runs
    parts = {part: [2.0, 1.0, 4.0] for part, _, _ in clocked.CLOCKS}
    monkeypatch.setattr(benchmark, "train", lambda *options, launcher=(): {
        "sps": next(speeds, 1), "seconds": parts, "memory_mb": 1})
    monkeypatch.setattr(benchmark, "rate", lambda call, count: count)
    monkeypatch.setattr(benchmark, "available_cores", lambda: 2)
    network = benchmark.measure_network
    monkeypatch.setattr(benchmark, "measure_network", lambda: network(M=1, T=1, R=1))
    benchmark.main(["--out", str(tmp_path / "here.json")])
    figures = json.loads((tmp_path / "here.json").read_text())
    assert (tmp_path / "here.png").stat().st_size > 5000
    assert figures["env_sps"] == {"1": 1, "32": 32, "256": 256, "1024": 1024}
    assert figures["workers"]["idle"] == {"1": 10, "2": 20, "ratio": 2}  # not 0.8, 2 or 4
    assert figures["workers"]["torchrun"] == {"1": 10, "2": 30, "ratio": 3}
    published = json.loads((ROOT / "results" / "benchmark.json").read_text())
    assert set(pd.json_normalize(figures)) == set(pd.json_normalize(published))


def test_the_cleanrl_style_loop_has_our_values_and_advantages_in_each_episode():
    learner = peers.CleanRLStyle(SMALL, peers.level_2(2))
    learner.env.max_episode_steps = 3
    steps = learner.collect()
    assert steps["start"][3].all() and learner.seen["start"].all()
    assert torch.allclose(steps["value"], learner.forward(steps, learner.memory)[1], atol=1e-5)
    for r, begin in np.ndindex(2, 2):
        part = {key: value[3 * begin:3 * begin + 3, r] for key, value in steps.items()}
        seen = {key: value[None] for key, value in part.items()}
        _, values, _ = learner.net(seen, learner.net.initial_state(1))
        assert torch.allclose(part["value"], values[0], atol=1e-5)
        A = ppo.advantages(part["reward"].numpy(), part["value"].numpy(), 0.0, 0.99, 0.95)
        assert np.allclose(part["advantage"], A, atol=1e-5)
    learner.learn(30)
    assert learner.num_timesteps == 24  # two updates of two robots


def test_stable_baselines_gets_the_last_observation_and_the_truncation():
    pytest.importorskip("sb3_contrib")
    env = NavVecEnv(2, max_episode_steps=3)
    adapted = peers.StableBaselinesEnv(NavVecEnv(2, max_episode_steps=3))
    env.reset(seed=3)
    adapted.seed(3)
    adapted.reset()
    for _ in range(3):
        observations, rewards, _, _, infos = env.step(np.ones((2, 2)))
        seen, scaled, _, each = adapted.step(np.ones((2, 2)))
    assert np.allclose(scaled, rewards / 100)
    assert np.array_equal(seen["image"], observations["image"])
    for r, info in enumerate(each):
        assert info["TimeLimit.truncated"] and info["episode"]["l"] == 3
        assert (info["terminal_observation"]["image"] == infos["final_obs"]["image"][r]).all()
    adapted.close()
    learner = peers.recurrent_ppo(SMALL, peers.level_2(2))
    learner.learn(24)
    assert learner.lr_schedule(0.25) == 0.25e-3 and learner.num_timesteps == 24
    result, _ = evaluate(peers.driver(learner, "mean"), ["env1"], 2, "anywhere")
    assert result["anywhere"]["n"] == 2
