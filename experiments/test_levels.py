"""Each test is the shortest proof of one claim about the runs, tables, figures of levels 1, 3."""

import csv
import json

import numpy as np
import pytest

import scenes
from experiments import level1, level2, level3, level_figures, level_tables, runs
from scenes.generate import share_blocked
from support.rooms import validation_scenes

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
    released = [scenes.load(name).boxes for name in level3.TEST_ROOMS]
    assert not any(room.boxes in released for room in validation_scenes())
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


def test_the_papers_targets_of_level_3_are_those_of_every_seed_the_worst_first(folder):
    _, tests = rows_of([any_room("any-room", seed, 1, 1, [1] * 5) for seed in (0, 1)])
    tests[17]["success"] = "0.9"
    assert {name: tests[17][name] for name in ("seed", "room", "targets")} == {
        "seed": "1", "room": "env2", "targets": "new"}
    lines = level_tables.level3_targets(tests).splitlines()
    assert lines[0] == "| seed | env1, training | env1, new | env2, training | env2, new |"
    assert lines[2:] == ["| 1 | 12.3 % [40.0, 60.0] | 98.7 % [40.0, 60.0] | 12.3 % [40.0, 60.0] | "
                         "90.0 % [40.0, 60.0] |",
                         "| 0 | 12.3 % [40.0, 60.0] | 98.7 % [40.0, 60.0] | 12.3 % [40.0, 60.0] | "
                         "98.7 % [40.0, 60.0] |"]


def test_success_against_the_number_of_rooms_is_that_of_every_seed(folder):
    made = [any_room(f"rooms-{count}", seed, 1 - count / 1000, count / 1000 + seed / 10,
                     [0.2 + count / 1000] * 5)
            for count in level3.ROOMS for seed in (1, 0)]
    rows = rows_of(made)
    lines = level_tables.rooms_learnt(*rows).splitlines()
    assert lines[3] == "| 4 | 100, 100: **99.6** | 0, 10: **5.4** | 20, 20: **20.4** |"
    assert lines[-1].startswith("| 600 new ones |")
    axes, = level_figures.draw_rooms_learnt(*rows).axes
    assert [text.get_text() for text in axes.get_xticklabels()][-1] == "600 new ones"
    means = [line.get_ydata() for line in axes.lines if len(line.get_ydata()) == 6]
    tenths = np.array(level3.ROOMS) / 10
    expected = [100 - tenths, tenths + 5, tenths + 20]
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


def level_1(env, seed, start, perturbed, first_arrival):
    """A run of level 1 with these success rates, whose episodes from a number on arrive."""
    run = level1.Run(env, seed)
    run.folder.mkdir()
    summary = {"steps": 9, "episodes": 3, "seconds": 60}
    for name, content in (("summary", summary), ("evaluation", {"training": rate(start)}),
                          ("evaluation-perturbed", {"training": rate(perturbed)})):
        (run.folder / f"{name}.json").write_text(json.dumps(content))
    with open(run.folder / "episodes.csv", "w") as file:
        file.write("steps,kind,outcome\n")
        for k in range(200):
            file.write(f"{10 * k},training,{'arrival' if k >= first_arrival else 'timeout'}\n")
    return run


def test_a_table_of_level_1_has_every_seed_of_a_room_the_worst_first(folder):
    made = [level_1("maze0", 0, 0.5, 0.9, 50), level_1("env1", 1, 0.7, 0.8, 0),
            level_1("env1", 0, 0.7, 0.6, 150)]
    runs.write_table("level1.csv", [level1.seed_row(run) for run in made])
    lines = level_tables.level1(runs.read_table(folder / "level1.csv")).splitlines()
    assert lines[2:] == [
        "| env1 | 0 | never | 70.0 % [40.0, 60.0] | 60.0 % [40.0, 60.0] | 0.25 |",
        "| env1 | 1 | 990 | 70.0 % [40.0, 60.0] | 80.0 % [40.0, 60.0] | 0.25 |",
        "| maze0 | 0 | 1,300 | 50.0 % [40.0, 60.0] | 90.0 % [40.0, 60.0] | 0.25 |"]


def test_the_lower_levels_in_short_are_all_seeds_of_each_room(folder):
    one = [{"env": env, "perturbed_success": success, "perturbed_spl": "0.5"}
           for env, success in (("maze0", "0.9"), ("env1", "1"), ("maze0", "0.4"))]
    two = [{"env": "env2", "way": way, "new_success": success, "new_spl": spl}
           for way, success, spl in (("one-start", "0.1", "1"), ("varied", "1", "0.8"),
                                     ("varied", "0.9", "0.6"))]
    assert level_tables.lower_levels(one, two).splitlines()[2:] == [
        "| 1: one target | env1 | 100.0: **100.0** | 0.50 |",
        "| 1: one target | maze0 | 40.0, 90.0: **65.0** | 0.50 |",
        "| 2: new targets | env2 | 90.0, 100.0: **95.0** | 0.70 |"]


def test_ablations_of_level_3_stand_beside_the_network_as_it_is(folder):
    rows = rows_of([any_room("rooms-0", seed, 1, 0.5 + seed / 10, [0.4] * 5) for seed in (0, 1)]
                   + [any_room(way, 0, 1, k / 10, [k / 20] * 5)
                      for k, way in enumerate(level3.ABLATIONS)])
    lines = level_tables.level3_ablations(*rows).splitlines()
    assert lines[2] == "| as it is | 50, 60: **55.0** | 40, 40: **40.0** |"
    assert lines[6] == "| no target position (`no-target`) | 30: **30.0** | 15: **15.0** |"
    assert len(lines) == 2 + 6


def test_what_carries_over_is_a_line_for_each_room_and_kind_of_targets(folder):
    made = [level2.Run(env, "varied", seed) for env in level2.BUDGET for seed in (0, 1)]
    for run in made:
        run.folder.mkdir()
        for file in run.examinations:
            kinds = ("anywhere",) if "anywhere" in file else ("training", "new")
            content = {kind: rate(0.1 * (1 + run.seed) + 0.05 * (kind == "new")) for kind in kinds}
            (run.folder / file).write_text(json.dumps(content))
    runs.write_table("carry-over.csv", [row for run in made for row in level2.carry_over_rows(run)])
    lines = level_tables.carry_over(runs.read_table(folder / "carry-over.csv")).splitlines()
    assert "| env1 | env2 | its new targets | 15, 25: **20.0** |" in lines
    assert "| env2 | maze4 | any place, from anywhere | 10, 20: **15.0** |" in lines
    assert len(lines) == 2 + 2 * (3 + 3)


def test_planners_drive_in_the_same_rooms(monkeypatch):
    asked = []

    def evaluated(driver, rooms, episodes, protocol):
        asked.append([room.name for room in rooms])
        assert (driver.label, episodes, protocol) == ("planner straight", 50, "anywhere")
        return {"anywhere": rate(0.1 * len(asked))}, []
    monkeypatch.setattr(level3, "evaluate", evaluated)
    rows = level3.planner_rows("straight")
    assert asked == [[name] for name in level3.TEST_ROOMS] + [[f"random-{k}" for k in range(16)]]
    rows = [{key: str(value) for key, value in row.items()} for row in rows]
    cells = level_tables.level3_planners(rows).splitlines()[2].split(" | ")
    assert cells[0] == "| straight" and len(cells) == 1 + 6
    assert cells[1] == "10 %, SPL 0.25" and cells[6].startswith("60 %, SPL 0.25")


def test_the_picture_of_rooms_frames_the_released_ones():
    mixed = [scenes.load(name) for name in ("random:0", "env1", "random:1")]
    figure = level_figures.draw_rooms(mixed, ["env1"])
    framed = {axes.get_title() for axes in figure.axes if axes.spines["top"].get_linewidth() > 0
              and axes.get_title()}
    assert framed == {f"env1, {share_blocked(scenes.load('env1')):.0%}"}


@pytest.mark.parametrize("name", level3.TEST_ROOMS)
def test_the_share_of_blocked_lines_is_that_of_lines_looked_along_step_by_step(name):
    room = scenes.load(name)
    rng = np.random.default_rng(7)
    begin, end = room.reachable[rng.integers(len(room.reachable), size=(2, 4000))]
    apart = np.hypot(*(end - begin).T) >= 1
    along = np.linspace(begin[apart], end[apart], 300, axis=1)
    share = (room.clearance(along) <= 0).any(1).mean()
    assert share_blocked(room) == pytest.approx(share, abs=0.025)
