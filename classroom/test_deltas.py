"""Each test is the shortest proof of one claim about what differs from the lesson."""

import re
import shlex
from pathlib import Path

import numpy as np
import pytest

import scenes
from classroom import deltas
from model import REWARD_SCALE, make_network
from navbot_min import NavVecEnv
from support.command_line import CommandLine
from support.processes import OneProcess
from train import Config

DOCS = Path(__file__).parent.parent / "docs"


@pytest.mark.parametrize("name, is_lesson", [("time-limits", False), (deltas.LESSON, True)])
def test_a_time_limit_that_is_a_failure_leaves_nothing_to_come(name, is_lesson):
    _, _, collector = deltas.DELTAS[name]
    env = NavVecEnv(2, ["env1"], max_episode_steps=3)
    driven = collector(env, make_network(0), REWARD_SCALE, 0, 0)
    ended = [episode for _ in range(3) for episode, _ in driven.step()]
    assert [episode.last_value != 0 for episode in ended] == [is_lesson] * 2


@pytest.mark.parametrize("page", sorted(DOCS.glob("delta-*.md")) + [DOCS / "class.md"],
                         ids=lambda page: page.name)
def test_the_trainings_of_a_page_have_valid_options(page):
    commands = re.findall(r"^ +python train\.py(.*?)(?:#.*)?$", page.read_text(), re.MULTILINE)
    assert commands or page.name == "delta-time-limits.md"
    for command in commands:
        CommandLine("").read(Config, shlex.split(command))


def test_each_delta_differs_from_what_it_is_compared_with_in_one_thing():
    parts = {name: (options, training, collector)
             for name, (options, training, collector) in deltas.DELTAS.items()}
    lesson = parts[deltas.LESSON]
    assert lesson[0] == {} and parts["lambda"] == ({"lam": 1.0}, *lesson[1:])
    assert parts["clipping"] == ({"clip": 1e9}, *lesson[1:])
    assert parts["time-limits"][:2] == parts["short"][:2] != lesson[:2]
    assert parts["short"][2] == lesson[2] != parts["time-limits"][2]
    assert deltas.COMPARED == {"lambda": deltas.LESSON, "clipping": deltas.LESSON,
                               "time-limits": "short"}
    config = Config(env="env1", robots=2)
    env = deltas.ShortTraining(config, [scenes.load("env1")], OneProcess()).make_env(
        [scenes.load("env1")] * 2)
    env.reset(seed=0)
    ends = [env.step(np.tile([0.0, 0.5], (2, 1)))[3].any() for _ in range(deltas.SHORT)]
    assert ends == [False] * (deltas.SHORT - 1) + [True]


def test_a_run_that_is_there_is_drawn_and_not_trained_again(tmp_path, monkeypatch):
    monkeypatch.setattr(deltas, "RESULT", tmp_path / "deltas.csv")
    monkeypatch.setattr(deltas, "PICTURES", tmp_path)
    learnt = []

    def learn(name, seed):
        learnt.append((name, seed))
        return [{"delta": name, "seed": seed, "steps": 9, "success": 0.5, "frozen": 0.5}]
    monkeypatch.setattr(deltas, "learn", learn)
    deltas.main([])
    assert len(learnt) == len(set(learnt)) == len(deltas.DELTAS) * len(deltas.SEEDS)
    deltas.main([])
    assert len(learnt) == len(deltas.DELTAS) * len(deltas.SEEDS)
    assert {file.name for file in tmp_path.glob("*.png")} == {
        f"delta-{name}.png" for name in deltas.COMPARED}


def test_a_delta_is_learnt_and_drawn():
    rows = []
    for name in (deltas.LESSON, "lambda"):
        rows += deltas.learn(name, 0, steps=6000)
    assert {row["delta"] for row in rows} == {deltas.LESSON, "lambda"}
    assert all(0 <= row["success"] <= 1 and row["steps"] < 6000 + 64 for row in rows)  # 64 robots
    [axes] = deltas.draw([{key: str(value) for key, value in row.items()} for row in rows],
                         "lambda").axes
    drawn = [line.get_ydata() for line in axes.lines if len(line.get_ydata())]
    assert np.allclose(np.concatenate(drawn), [100 * row["success"] for row in rows])
