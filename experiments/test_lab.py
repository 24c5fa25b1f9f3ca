"""Each test is the shortest proof of one claim about runs, table and figures of the lab."""

import json

import numpy as np
import pytest

import scenes
from experiments import lab, lab_figures, lab_tables, runs
from model import make_network
from robot.policy import TorchPolicy
from scenes.reality import KNOBS, Reality

RATE = {"n": 100, "success": 0.5, "low": 0.4, "high": 0.6, "collision": 0.3, "timeout": 0.1,
        "standing": 0.1, "stops": 2.0, "spl": 0.25}


@pytest.fixture
def rows(tmp_path, monkeypatch):
    """The rows of lab.csv, as they are read again: seed k arrives at new targets in k tenths of the
    episodes."""
    monkeypatch.setattr(runs, "RUNS", tmp_path)
    monkeypatch.setattr(runs, "RESULTS", tmp_path)
    made = []
    for run in lab.main_runs():
        run.folder.mkdir()
        summary = {"steps": 9000, "episodes": 3, "seconds": 3600}
        by_target = {"training": RATE | {"collision": 0.1},
                     "new": RATE | {"success": run.seed / 10}}
        for file, content in zip(("summary.json", *run.examinations),
                                 (summary, by_target, {"anywhere": RATE})):
            (run.folder / file).write_text(json.dumps(content))
        made.append(lab.seed_row(run))
    columns = lab.measured_columns({"training": RATE, "new": RATE}, {"anywhere": RATE})
    nothing = dict.fromkeys(("steps", "episodes", "seconds", "hours"), 0)
    for name in lab.WEIGHTS:
        made.append({"way": name, "allowed": 0, "seed": 0} | nothing | columns)
    runs.write_table("lab.csv", made)
    return runs.read_table(tmp_path / "lab.csv")


def test_the_table_has_every_policy_and_every_seed_the_worst_first(rows):
    lines = lab_tables.lab(rows).splitlines()
    assert len(lines) == 2 + 2 + 2 + 3 * 2
    # 9,000 steps of 0.4 s are an hour; collisions are the mean of 10 and 30 in 100.
    assert lines[-1] == ("| from any-room's | 3,000 | 1.0 | 0, 10, 20: **10.0** | "
                         "50, 50, 50: **50.0** | 50, 50, 50: **50.0** | 20.0 | 2.0 |")
    assert lines[2] == ("| env2's, as it is | 0 | 0.0 | 50: **50.0** | 50: **50.0** | "
                        "50: **50.0** | 30.0 | 2.0 |")
    assert lines[4].startswith("| learnt in env2, errors drawn | 0 | 0.0 |")


def test_each_error_of_the_lab_is_alone_once_and_the_dearest_stands_first():
    rooms = lab.alone(scenes.load("lab"))
    for name, room in rooms.items():
        other = {knob for knob in ("look", *KNOBS)
                 if getattr(room.reality, knob) != getattr(Reality(), knob)}
        assert name in ("none", "all") or other == {name}
    assert rooms["none"].reality == Reality() and rooms["all"] == scenes.load("lab")
    assert set(rooms) - {"none", "all"} == {
        knob for knob in ("look", *KNOBS) if rooms["all"].reality != rooms["none"].reality
        and getattr(rooms["all"].reality, knob) != getattr(Reality(), knob)}
    rows = [{"weights": weights, "knob": knob, "success": success}
            for weights in lab.WEIGHTS
            for knob, success in (("none", "0.9"), ("blur", "0.8"), ("look", "0.1"),
                                  ("camera_yaw", "0.2"), ("all", "0"))]
    assert lab_tables.knobs(rows).splitlines()[2:] == [
        "| none |  | 90 | 90 |", "| look | lab | 10 | 10 |",
        "| camera yaw | 2 degrees | 20 | 20 |", "| blur | 0.6 | 80 | 80 |", "| all |  | 0 | 0 |"]


def test_frozen_policies_stand_at_the_episodes_that_they_learnt(rows):
    curves = [{"way": way, "seed": str(seed), "episodes": str(count),
               "new_success": str(count / 1000 + seed / 10), "collision": "0.02"}
              for way in lab.STARTS for seed in (0, 2) for count in (300, 350)]
    success, collided, _ = lab_figures.draw_learning(rows, curves).axes
    points = {line.get_label(): sorted(map(tuple, line.get_xydata().round(6).tolist()))
              for line in success.lines}
    learnt = [(count, 10 * seed) for count in lab.EPISODES for seed in lab.SEEDS]
    assert points["from env2's"] == [(0, 50), *learnt]
    assert points["from random weights"] == learnt
    assert np.allclose(success.lines[0].get_xydata(), [(300, 40), (350, 45)])
    assert np.allclose(collided.lines[0].get_ydata(), 2)


def test_a_curve_looks_back_on_the_last_episodes(tmp_path, monkeypatch):
    monkeypatch.setattr(runs, "RUNS", tmp_path)
    run = lab.Run("from-env2", 3000, 0)
    run.folder.mkdir()
    with open(run.folder / "episodes.csv", "w") as file:
        file.write("kind,outcome\n")
        for k in range(400):
            outcome = "arrival" if k >= 300 else "collision"
            file.write(f"{'new' if k % 2 else 'training'},{outcome}\n")
    rows = lab.curve_rows(run)
    assert [row["episodes"] for row in rows] == [300, 350, 400]
    assert [row["new_success"] for row in rows] == [0, pytest.approx(1 / 6, abs=1e-4),
                                                    pytest.approx(1 / 3, abs=1e-4)]
    assert rows[2]["collision"] == pytest.approx(2 / 3, abs=1e-4) and rows[2]["new_n"] == 150


def test_a_run_drives_in_the_lab_only_where_its_episodes_there_are_counted():
    for run in lab.main_runs():
        assert ("lab" in run.training) == ("--episodes" in run.training) == (run.allowed > 0)


def test_a_map_is_made_from_where_odometry_has_the_robot():
    robot, log, grid = lab_figures.driven_map(TorchPolicy(make_network(0)), target=10, seed=0)
    assert len(log.readings) == len(log.poses) > 5
    start = scenes.load("lab").start
    nearest = np.hypot(*(grid.centres - start[:2]).transpose(2, 0, 1)).argmin()
    assert grid.probability.flat[nearest] < 0.5  # the robot stood there
    figure = lab_figures.draw_map_of(robot, log, grid, scenes.load("lab"))
    believed = figure.axes[0].lines[-2].get_xydata()
    assert np.allclose(believed, [pose[:2] for pose in log.poses])
