"""Each test is the shortest proof of one claim about what differs from the lesson."""

import numpy as np
import pytest

import train
from classroom import deltas
from model import REWARD_SCALE, make_network
from navbot_min import MAX_EPISODE_STEPS
from ppo import Collector


def test_each_delta_differs_from_what_it_is_compared_with_in_one_thing():
    own = {name: (options, environment(1, ["env1"]).max_episode_steps)
           for name, (_, options, environment) in deltas.DELTAS.items()}
    assert own == {deltas.LESSON: ({}, MAX_EPISODE_STEPS), "short": ({}, 40),
                   "lambda": ({"lam": 1.0}, MAX_EPISODE_STEPS),
                   "clipping": ({"clip": 1e9}, MAX_EPISODE_STEPS), "time-limits": ({}, 40)}


@pytest.mark.parametrize("name, bootstraps", [("time-limits", False), ("short", True)])
def test_a_time_limit_that_is_a_failure_leaves_nothing_to_come(name, bootstraps):
    environment = deltas.DELTAS[name][2]
    collector = Collector(environment(2, ["env1"]), make_network(0), REWARD_SCALE, 0, 0)
    collector.env.command = np.zeros_like  # the robots stand
    ended = [collector.step() for _ in range(40)]
    assert not any(ended[:-1])
    assert [episode.last_value != 0 for episode, _ in ended[-1]] == [bootstraps] * 2


def test_what_is_missing_is_trained_once_and_drawn(tmp_path, monkeypatch):
    for name, value in (("RESULT", tmp_path / "deltas.csv"), ("PICTURES", tmp_path),
                        ("STEPS", 3000), ("WINDOW", 20), ("EPISODES", 2), ("SEEDS", ("0",)),
                        ("DELTAS", {"clipping": deltas.DELTAS["clipping"]}),
                        ("COMPARED", {"clipping": "clipping"})):
        monkeypatch.setattr(deltas, name, value)
    monkeypatch.setattr(train, "WINDOW", 20)
    episodes = []
    record = train.Training.record

    def kept(training, row):
        episodes.append(row)
        record(training, row)
    monkeypatch.setattr(train.Training, "record", kept)
    deltas.main([])
    monkeypatch.setattr(deltas, "learn", lambda *_: pytest.fail("it trains again"))
    deltas.main([])
    assert (tmp_path / "delta-clipping.png").exists()
    rows = [row for row in episodes if row["kind"] == "training"]
    windows = [rows[k:k + 20] for k in range(0, len(rows) - 19, 20)]
    [axes] = deltas.draw(deltas.read_table(deltas.RESULT), "clipping").axes
    assert len(windows) > 2 and np.allclose(axes.lines[0].get_xydata(), [
        (window[-1]["steps"], 5 * sum(row["outcome"] == "arrival" for row in window))
        for window in windows])
