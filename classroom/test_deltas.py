"""Each test is the shortest proof of one claim about what differs from the lesson."""

import re
import shlex
from pathlib import Path

import numpy as np
import pytest

from classroom import deltas
from model import REWARD_SCALE, make_network
from navbot_min import NavVecEnv
from support.command_line import CommandLine
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


def test_a_delta_is_learnt_and_drawn():
    rows = []
    for name in (deltas.LESSON, "lambda"):
        rows += deltas.learn(name, 0, steps=6000)
    assert {row["delta"] for row in rows} == {deltas.LESSON, "lambda"}
    assert all(0 <= row["success"] <= 1 and row["steps"] <= 6000 for row in rows)
    [axes] = deltas.draw([{key: str(value) for key, value in row.items()} for row in rows],
                         "lambda").axes
    drawn = [line.get_ydata() for line in axes.lines if len(line.get_ydata())]
    assert np.allclose(np.concatenate(drawn), [100 * row["success"] for row in rows])
