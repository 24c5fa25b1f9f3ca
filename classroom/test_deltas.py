"""Each test is the shortest proof of one claim about the deltas."""

import numpy as np
import pytest

import train
from classroom import deltas


def test_each_delta_changes_one_option_of_the_lesson():
    assert [options for _, options in deltas.DELTAS.values()] == [{}, {"lam": 1.0}, {"clip": 1e9}]


def test_missing_runs_are_trained_once_and_drawn(tmp_path, monkeypatch):
    for name, value in (("RESULT", tmp_path / "deltas.csv"), ("PICTURES", tmp_path),
                        ("STEPS", 3000), ("WINDOW", 20), ("EPISODES", 2), ("SEEDS", ("0",)),
                        ("DELTAS", {"clipping": deltas.DELTAS["clipping"]}),
                        ("LESSON", "clipping"), ("COMPARED", ["clipping"])):
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
