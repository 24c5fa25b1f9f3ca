"""Each test is the shortest proof of one claim about the runs, tables, figures of levels 1, 3."""

import csv
import json

import numpy as np
import pytest

import scenes
from experiments import level1, level3, level_figures, level_tables, runs
from support.rooms import VALIDATION_ROOMS

RATE = {"n": 100, "success": 0.5, "low": 0.4, "high": 0.6, "collision": 0.3, "timeout": 0.2,
        "spl": 0.25, "seconds_to_arrive": 9.0}


def rate(success):
    """A rate with that success."""
    return RATE | {"success": success}


@pytest.fixture
def folder(tmp_path, monkeypatch):
    """Where the runs and the tables go."""
    monkeypatch.setattr(runs, "RUNS", tmp_path)
    monkeypatch.setattr(runs, "RESULTS", tmp_path)
    return tmp_path


def any_room(way, seed, training, validation, tests):
    """A run of level 3 with these success rates. tests: of each test room."""
    run = level3.Run(way, seed)
    run.folder.mkdir()
    frozen = {"training": rate(training), "new": rate(validation)}
    summary = {"steps": 9, "episodes": 3, "seconds": 3600, "frozen": frozen}
    (run.folder / "summary.json").write_text(json.dumps(summary))
    for room, success in zip(level3.TEST_ROOMS, tests):
        content = json.dumps({"anywhere": rate(success)})
        (run.folder / f"evaluation-{room}-anywhere.json").write_text(content)
    for room in level3.PAPER_ROOMS:  # of `any-room`
        content = json.dumps({"training": rate(0.123), "new": rate(0.987)})
        (run.folder / f"evaluation-{room}-start.json").write_text(content)
    return run


def rows_of(made):
    """The rows of level3.csv and rooms.csv of those runs, as they are read again."""
    runs.write_table("level3.csv", [level3.seed_row(run) for run in made])
    runs.write_table("rooms.csv", [row for run in made for row in level3.test_rows(run)])
    return [runs.read_table(runs.RESULTS / name) for name in ("level3.csv", "rooms.csv")]


def test_the_test_rooms_are_no_rooms_for_validation_or_training():
    assert set(level3.TEST_ROOMS) <= set(scenes.names())
    for run in level3.main_runs():
        assert run.training[:2] == ["--env", "random"]
        assert set(run.examinations) >= {f"evaluation-{room}-anywhere.json"
                                         for room in level3.TEST_ROOMS}


def test_a_table_of_level_3_has_every_room_of_every_seed_the_worst_first(folder):
    rows = rows_of([any_room("any-room", 1, 0.9, 0.7, (1, 1, 1, 1, 0.5)),
                    any_room("any-room", 0, 0.9, 0.8, (1, 0.9, 0.6, 0.7, 0.8)),
                    any_room("rooms-4", 0, 1, 0, (0, 0, 0, 0, 0))])
    lines = level_tables.level3(*rows).splitlines()
    assert len(lines) == 2 + 2
    assert lines[2].startswith("| 0 | 100.0 % [40.0, 60.0] | 90.0 % [40.0, 60.0] | 60.0 % ")
    assert "| **80.0 %** | 0.25 | 80.0 % [40.0, 60.0] | 1.0 |" in lines[2]
    assert "| **90.0 %** |" in lines[3]
    assert len(rows[1]) == 2 * (5 + 2 * 2) + 5


def test_success_against_the_number_of_rooms_is_that_of_every_seed(folder):
    made = [any_room(f"rooms-{count}", seed, 1 - count / 1000, count / 1000 + seed / 10, [0.2] * 5)
            for count in level3.ROOMS for seed in (1, 0)]
    rows = rows_of(made)
    lines = level_tables.rooms_learnt(*rows).splitlines()
    assert lines[3] == "| 4 | 100, 100: **99.6** | 0, 10: **5.4** | 20, 20: **20.0** |"
    assert lines[-1].startswith("| ever new ones |")
    axes, = level_figures.draw_rooms_learnt(*rows).axes
    assert [text.get_text() for text in axes.get_xticklabels()][-1] == "ever new ones"
    means = [line.get_ydata() for line in axes.lines if len(line.get_ydata()) == 6]
    expected = [100 - np.array(level3.ROOMS) / 10, np.array(level3.ROOMS) / 10 + 5, [20] * 6]
    assert np.allclose(means, expected)


def test_the_steps_to_the_records_stop_are_counted_in_training_episodes(folder):
    run = level1.Run("env1", 0)
    run.folder.mkdir()
    rows = [{"steps": 10 * k, "kind": "training" if k % 2 else "new",
             "outcome": "arrival" if k % 2 and k > 100 else "collision"} for k in range(1000)]
    with open(run.folder / "episodes.csv", "w", newline="") as file:
        csv.DictWriter(file, rows[0]).writeheader()
        csv.DictWriter(file, rows[0]).writerows(rows)
    # Training episodes are k = 1, 3, 5, ...; from k = 101 on they arrive, and 81 of them are 162.
    assert level1.steps_to(run, 0.81) == 10 * (101 + 2 * 80)
    assert level1.steps_to(run, 1.01) == ""


def test_planners_drive_in_the_same_rooms(monkeypatch):
    monkeypatch.setattr(level3, "PLANNER_EPISODES", VALIDATION_ROOMS)
    rows = level3.planner_rows("straight")
    assert [row["room"] for row in rows] == [*level3.TEST_ROOMS, level3.VALIDATION]
    assert all(row["n"] == VALIDATION_ROOMS for row in rows)
    rows = [{key: str(value) for key, value in row.items()} for row in rows]
    line = level_tables.level3_planners(rows).splitlines()[2]
    assert line.startswith("| straight | ") and line.count("SPL") == 6


def test_the_picture_of_rooms_frames_the_released_ones():
    rooms = [scenes.load(name) for name in ("random:0", "env1", "random:1")]
    figure = level_figures.draw_rooms(rooms, ["env1"])
    framed = {axes.get_title() for axes in figure.axes if axes.spines["top"].get_linewidth() > 0
              and axes.get_title()}
    assert framed == {"env1"}
