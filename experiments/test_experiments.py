"""Tests of what makes the published numbers, and of the house itself: who imports whom, and
whether the pages say what the files say. Each is the shortest proof of one claim."""

import ast
import contextlib
import csv
import functools
import importlib
import io
import json
import multiprocessing
import re
import signal
import subprocess
import sys
import time
from dataclasses import asdict
from pathlib import Path

import numpy as np
import pytest

import train
from evaluation.__main__ import read_command_line
from experiments import benchmark, level2, level3, results, runs, tables
from model import Network
from navbot_min import OUTCOMES
from support.command_line import CommandLine

ROOT = Path(__file__).parent.parent
PAGES = tables.pages()


def cells(table):
    """The rows of a markdown table without its header, as lists of texts."""
    return [[cell.strip() for cell in line.strip("|").split("|")]
            for line in table.splitlines()[2:]]


def numbers(text):
    return [float(number) for number in re.findall(r"\d+(?:\.\d+)?", text)]


def seed_rows(**columns):
    """Five rows as in seeds.csv of each room and way, all alike but for the given columns, which
    hold a value for each of the seeds 0 to 4."""
    rows = []
    for room in tables.ROOMS:
        for way in tables.WAYS:
            for seed in range(5):
                row = {"env": room, "way": way, "seed": str(seed), "mean_action_arrives": "3 of 3"}
                for kind in ("training", "new", "anywhere"):
                    row |= {f"{kind}_{key}": "0.5" for key in ("success", "low", "high", "spl")}
                rows.append(row | {key: str(values[seed]) for key, values in columns.items()})
    return rows


# --------------------------------------------------------------------------------------- the tables


def test_the_table_of_seeds_has_every_run_worst_first_and_their_mean():
    table = cells(tables.seed_by_seed(seed_rows(new_success=(0.9, 0.2, 0.7, 0.4, 0.8))))
    one = [row for row in table if row[:2] == ["env1", "starts anywhere"]]
    assert [row[2] for row in one] == ["1", "3", "2", "4", "0", "**mean**"]
    assert [numbers(row[4])[0] for row in one] == [20, 40, 70, 80, 90, 60]
    assert len(table) == 4 * 6


def test_the_short_summary_has_four_rows_of_means():
    tests = [{"way": way, "room": room, "targets": targets, "success": str(success)}
             for room in tables.ROOMS for targets in ("anywhere", "training", "new")
             for way, success in (("any-room", 0.6), ("any-room", 0.8), ("rooms-4", 0))]
    table = cells(tables.summary_short(seed_rows(new_success=(1, 1, 1, 0.5, 1)), tests))
    assert [row[0] for row in table] == [
        "env1, new targets", "env2, new targets",
        "env1, from anywhere to anywhere", "env2, from anywhere to anywhere"]
    assert [row[1:] for row in table] == [
        ["90.0 %", "90.0 %", "70.0 %"]] * 2 + [["50.0 %", "50.0 %", "70.0 %"]] * 2


def test_the_summary_weighs_seeds_alike_and_says_where_there_is_no_number():
    here = seed_rows(new_success=(0.1, 0.2, 0.3, 0.4, 0.5))
    floor = [{"env": room, "way": way, "seed": str(seed), "success": str(success)}
             for room in tables.ROOMS for way in tables.WAYS
             for seed, successes in enumerate(((0, 1), (1, 1), (1, 1, 1, 0)))
             for success in successes]
    table = {row[0]: row[1:] for row in cells(tables.summary(here, here[:5], floor))}
    assert table["env1, new targets"][1:] == ["30.0 % (10.0 %)"] * 3 + ["-"]
    mean_of_seeds = "75.0 % (50.0 %)"
    assert table["env2, validation targets"] == ["-", mean_of_seeds, "-", mean_of_seeds, "-"]
    assert len(table) == 8


def test_the_table_of_ablations_has_seeds_0_to_2_worst_first_their_mean_and_both_machines():
    rows = [{"env": room, "way": "none", "seed": str(seed)} | {
        f"{kind}_success": success for kind in ("new", "training", "anywhere")}
            for room in tables.ROOMS for seed, success in enumerate((0.5, 0.2, 0.8, 0.9))]
    others = [row | {"new_success": 0.3} for row in rows if row["env"] == "env1"]
    table = [row for row in cells(tables.ablations([], rows, others)) if "none" in row[1]]
    mean = "**50.0**"
    each = f"20, 50, 80: {mean}"
    assert table[0][2:] == [each, "30, 30, 30: **30.0**", mean, mean, each, each]
    assert table[1][2:] == [each, "-", mean, "-", each, "-"]


def test_the_table_of_hidden_targets_has_every_seed_in_order():
    rows = [{"env": room, "way": way, "seed": seed, "hidden": hidden} | {
        f"{kind}_success": (10 * k + int(seed)) / 100 for kind in ("new", "training")}
            for room in tables.ROOMS for way in tables.WAYS for seed in "20143"
            for k, hidden in enumerate(("", "place", "cube", "both"))]
    table = cells(tables.hidden_targets([row for row in rows if row["hidden"]],
                                        [row for row in rows if not row["hidden"]]))
    assert len(table) == 8
    for row in table:
        assert [numbers(cell) for cell in row[3:]] == [
            [0, 1, 2, 3, 4], [10, 11, 12, 13, 14], [20, 21, 22, 23, 24], [30, 31, 32, 33, 34]]


def test_the_table_of_planners_counts_targets_and_sets_the_worst_seed_beside_them():
    planner = {"planner": "bug", "start_n": "12", "start_success": "0.9167", "anywhere_spl": "0.5",
               "anywhere_success": "0.4", "anywhere_low": "0.3", "anywhere_high": "0.6"}
    seeds = seed_rows(anywhere_success=(0.1, 0.2, 0.3, 0.4, 0.5), mean_action_arrives=(
        "10 of 12", "12 of 12", "9 of 12", "12 of 12", "11 of 12"))  # 9 is less than 10 and 11
    table = cells(tables.planner_comparison([planner | {"env": "env1"}, planner | {"env": "env2"}],
                                            seeds))
    reached = "40.0 % [30.0, 60.0], 0.50"
    assert table[0] == ["bug", "11 of 12", "11 of 12", reached, reached]
    learner = "30.0 % (seeds 10.0 to 50.0), 0.50"
    assert table[1] == ["**learner**", "9 of 12", "9 of 12", learner, learner]


def test_the_table_of_learners_has_a_row_a_variant_and_its_seeds_worst_first():
    rows = [{"variant": variant, "seed": str(seed), "steps": "270000", "peak_success": peak,
             "peak_steps": steps, "last_success": "0", "frozen_new": "0.01",
             "frozen_training": training}
            for variant in ("all", "baseline")
            for seed, (peak, steps, training) in enumerate((
                ("0.3", "60000", "1"), ("0.05", "70400", "0.5"), ("0.1", "90000", "1")))]
    table = cells(tables.released_learner(rows))
    assert [row[0] for row in table] == [tables.LEARNERS["baseline"], tables.LEARNERS["all"]]
    assert table[0][1:] == ["5, 10, 30: **15.0**", "70, 90, 60", "0, 0, 0: **0.0**",
                            "1, 1, 1: **1.0**", "50, 100, 100: **83.3**"]


def test_the_table_of_the_benchmark_has_each_number_of_cores_its_roof_and_the_peers():
    one = json.loads((ROOT / "results" / "benchmark.json").read_text())
    one |= {"cores": 1, "train_sps": 1000.0, "roof_sps": 4000.0,
            "peers": {"another": {"sps": 12.3, "ratio": 4.56}}}
    text = tables.benchmark(one | {"all_cores": one | {"cores": 2, "train_sps": 3000.0}})
    assert "| a second | 1 core | 2 cores | share of the roof |" in text
    assert "| training, all told, steps | 1,000 | 3,000 | 25 % / 75 % |" in text
    assert text.endswith("| another | 12 | 4.6 |")
    assert "peer" not in tables.benchmark(one | {"peers": {}})


def test_the_model_of_more_cores_is_amdahls_law():
    assert tables.amdahl(2.0, 2, 8) == pytest.approx(8)  # everything is divided
    assert tables.amdahl(1.0, 2, 8) == pytest.approx(1)  # nothing is
    for measured in (2, 4):
        ratio = 1 / (0.25 + 0.75 / measured)
        for cores in (2, 4, 8):
            whole = 1 / (0.25 + 0.75 / cores)
            assert tables.amdahl(ratio, measured, cores) == pytest.approx(whole)


def test_the_table_of_stops_has_each_run_worst_first():
    rate = {"success": 0.5, "low": 0.25, "high": 0.75}
    runs = [{"seed": seed, "steps": 1234, "episodes": 56, "seconds": 7.8,
             "rolling_new_success": 0.61,
             "frozen": {"training": rate, "new": rate | {"success": success}}}
            for seed, success in enumerate((0.9, 0.7, 0.8))]
    table = cells(tables.stops(*runs))
    assert [row[0] for row in table] == ["1", "2", "0"]
    assert table[0][1:] == ["1,234", "56", "8", "61 %", "70.0 % [25.0, 75.0]",
                            "50.0 % [25.0, 75.0]"]


def test_a_peak_is_the_highest_point_of_a_seeds_curve_to_new_targets():
    rows = [{"env": "env1", "way": way, "seed": seed, "kind": kind, "steps": str(1000 * k),
             "success": success}
            for way, seed, kind, curve in (("one-start", "1", "new", ("0.1", "0.3", "0.02")),
                                           ("one-start", "0", "new", ("0.2", "0.1", "0.0")),
                                           ("one-start", "0", "training", ("0.9", "1.0", "1.0")),
                                           ("varied", "0", "new", ("0.8", "0.9", "1.0")))
            for k, success in enumerate(curve, 1)]
    assert cells(tables.peaks(rows)) == [["0", "20 %", "1,000", "0 %"],
                                         ["1", "30 %", "2,000", "2 %"]]


def test_a_cell_with_a_bar_in_it_stays_one_cell():
    row = {"client": "a", "version": "1", "what": "x | y", "result": "passes"}
    assert tables.clients([row]).splitlines()[-1] == r"| a | 1 | x \| y | passes |"


# ------------------------------------------------------------------------------ tables in the pages


def test_a_page_is_filled_between_its_markers_alone(monkeypatch):
    monkeypatch.setitem(tables.TABLES, "mine", (lambda: "| new |", []))
    page = "before\n<!-- table: mine -->\n{}<!-- end -->\nafter <!-- a comment -->\n"
    assert tables.fill(page.format("| old |\n| old |\n")) == (page.format("| new |\n"), ["mine"])
    assert tables.fill(page.format("")) == tables.fill(page.format("| new |\n"))


@pytest.mark.parametrize("text, words", [
    ("<!-- table: seed -->\n<!-- end -->\n", "an unknown table 'seed', known are summary-short"),
    ("<!-- table: seeds -->\n", "without its <!-- end -->"),
    ("<!-- end -->\n", "without its <!-- end -->"),
    ("<!-- table: seeds -->\n<!-- table: hidden -->\n<!-- end -->\n", "without its <!-- end -->")])
def test_a_wrong_marker_is_one_sentence(text, words):
    with pytest.raises(ValueError, match=re.escape(words)):
        tables.fill(text)


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.name)
def test_the_tables_of_a_page_are_those_of_the_results(page):
    text = page.read_text(encoding="utf-8")
    filled, _ = tables.fill(text)
    assert filled == text, f"{page.name} is out of date: run python -m experiments.tables"


# -------------------------------------------------------------------------------------- the results


def fake_call(calls, fail_at=None):
    """A stand-in for `runs.call`, which writes what the program would: it notes the calls and
    raises at the one with that number."""
    def call(*arguments):
        if len(calls) == fail_at:
            raise InterruptedError
        calls.append([str(argument) for argument in arguments])
        if arguments[0] == "train.py":
            folder = arguments[arguments.index("--out") + 1]
            folder.mkdir(parents=True)
            (folder / "summary.json").write_text(json.dumps({"frozen": {}}))
            return
        name = "evaluation"
        for flag in ("--env", "--protocol", "--hide"):
            if flag in arguments:
                value = arguments[arguments.index(flag) + 1]
                if value != "start" or "level3" in str(arguments[2]):
                    name += f"-hidden-{value}" if flag == "--hide" else f"-{value}"
        name += "-ring" if "--ring" in arguments else ""
        (arguments[2] / f"{name}.json").write_text("{}")
    return call


def test_interrupted_results_go_on_where_they_were_and_make_nothing_twice(tmp_path, monkeypatch):
    monkeypatch.setattr(runs, "RUNS", tmp_path)
    run = level2.Run("env1", "varied", 3)
    run.folder.mkdir()  # of a training that was cut before it began
    (run.folder / "summary.json").write_text('{"frozen": null}')
    calls = []
    monkeypatch.setattr(runs, "call", fake_call(calls, fail_at=3))
    with pytest.raises(InterruptedError):
        run.make()
    monkeypatch.setattr(runs, "call", fake_call(calls))
    run.make()
    assert len(calls) == 11 and len({tuple(call) for call in calls}) == 11
    run.make()
    assert len(calls) == 11


def test_a_run_that_was_made_with_other_options_is_not_taken_for_this_one(tmp_path, monkeypatch,
                                                                          capsys):
    monkeypatch.setattr(runs, "RUNS", tmp_path)
    run = level3.Run("rooms-4", 1)
    run.folder.mkdir()
    config = CommandLine("").read(train.Config, run.command_line)
    file = run.folder / "config.json"
    file.write_text(json.dumps(asdict(config)))
    run.check_options()
    file.write_text(json.dumps(asdict(config) | {"rooms": 5}))
    monkeypatch.setattr(runs, "make_runs", lambda *_: pytest.fail("it trains"))
    with pytest.raises(SystemExit) as end:
        results.main(["--level", "3"])
    assert end.value.code == 2
    said = capsys.readouterr().err
    assert said.endswith("rooms-4-seed1' was made with rooms = 5, now it is 4: move it away\n")


def test_results_pass_a_signal_on_and_say_how_to_go_on(tmp_path):
    waits = tmp_path / "waits.py"  # in the place of a training: it saves when it is asked to end
    waits.write_text("import pathlib, signal, sys, time\n"
                     "def save(*_):\n    pathlib.Path('saved').touch()\n    sys.exit(130)\n"
                     "signal.signal(signal.SIGINT, save)\n"
                     "pathlib.Path('ready').touch()\ntime.sleep(60)\n")
    program = ("from experiments import results, runs\nfrom pathlib import Path\n"
               f"runs.ROOT = runs.RUNS = Path({str(tmp_path)!r})\n"
               "runs.Run.make = lambda run: runs.call('waits.py')\n"
               "results.main(['--jobs', '1'])")
    process = subprocess.Popen([sys.executable, "-c", program], cwd=ROOT, stdout=subprocess.DEVNULL,
                               stderr=subprocess.PIPE, text=True)
    for _ in range(3000):
        if (tmp_path / "ready").exists():
            break
        time.sleep(0.01)
    process.send_signal(signal.SIGINT)
    _, said = process.communicate(timeout=60)
    assert process.returncode == 130 and (tmp_path / "saved").exists()
    assert said.strip() == ("interrupted: the runs under way are saved; the same command goes on")


def test_the_programs_take_the_commands_of_the_results(tmp_path, monkeypatch):
    monkeypatch.setattr(runs, "RUNS", tmp_path)
    calls = []
    monkeypatch.setattr(runs, "call", fake_call(calls))
    wanted = results.wanted_runs(results.Options(ablations=True))
    everything = [run for level_runs in wanted.values() for run in level_runs]
    for run in everything:
        run.make()
    configs = {}
    for call in calls:
        if call[0] == "train.py":
            config = CommandLine("").read(train.Config, call[1:])
            configs[Path(config.out).name] = config
        else:
            assert call[:2] == ["-m", "evaluation"]
            read_command_line(call[2:])
    assert len(configs) == len(everything) == 10 + 20 + 36 + 36 + 24
    assert all(config.fixed_budget and config.workers == 1 for config in configs.values())
    assert all(int(name[-1]) == config.seed for name, config in configs.items())
    one_start = configs["level2-env2-one-start-seed2"]
    assert (one_start.steps, one_start.random_starts, one_start.mirrored) == (400_000, 0, 0)
    assert configs["level2-env1-no-last-seed2"].without == "last"
    assert configs["level1-maze0-seed4"].targets == "memorize"
    assert configs["level3-rooms-16-seed1"].rooms == 16
    assert {config.env for name, config in configs.items() if "level3" in name} == {"random"}
    assert configs["lab-from-env2-300-seed1"].episodes == 300
    assert {config.reality for name, config in configs.items() if "-random-" in name} == {"random"}


def test_a_runs_rows_have_the_columns_of_the_published_tables(tmp_path, monkeypatch):
    monkeypatch.setattr(runs, "RUNS", tmp_path)
    run = level2.Run("env1", "varied", 0)
    run.folder.mkdir()
    rate = {"n": 2, "success": 1 / 3, "low": 0.1, "high": 0.9, "collision": 0.5, "timeout": 0.25,
            "spl": 0.12345, "seconds_to_arrive": None}
    targets = [rate | {"x": 1.0, "y": 2.0, "kind": kind, "mean_action_arrives": arrives}
               for kind, arrives in (("training", True), ("validation", False))]
    frozen = {"training": rate, "new": rate, "targets": targets}
    summary = {"steps": 64, "episodes": 7, "seconds": 1.5, "frozen": frozen}
    for name, content in (("summary", summary), ("evaluation-anywhere", {"anywhere": rate}),
                          ("evaluation-validation", frozen), ("evaluation-hidden-place", frozen),
                          ("evaluation-hidden-cube", frozen), ("evaluation-hidden-both", frozen)):
        (run.folder / f"{name}.json").write_text(json.dumps(content))
    made = {"seeds": [level2.seed_row(run)], "ablations": [level2.seed_row(run)],
            "hidden": level2.hidden_rows(run), "floor": level2.floor_rows(run)}
    for name, rows in made.items():
        published = tables.read_table(ROOT / "results" / f"{name}.csv")
        assert all(list(row) == list(published[0]) for row in rows), name
    assert {"env": "env1", "way": "varied", "seed": 0, "steps": 64, "new_success": 0.3333,
            "anywhere_spl": 0.1235, "mean_action_arrives": "1 of 2"}.items() <= (
                made["seeds"][0].items())
    assert [row["hidden"] for row in made["hidden"]] == ["place", "cube", "both"]
    assert [(row["x"], row["n"]) for row in made["floor"]] == [(1.0, 2)]


def test_a_curves_points_are_means_over_the_last_100_episodes_of_a_kind(tmp_path, monkeypatch):
    monkeypatch.setattr(runs, "RUNS", tmp_path)
    run = level2.Run("env1", "varied", 7)
    run.folder.mkdir()
    rng = np.random.default_rng(0)
    rows = [{"steps": 10 * k, "kind": str(rng.choice(["training", "new"])),
             "outcome": str(rng.choice(OUTCOMES)), "return": rng.normal()} for k in range(400)]
    with open(run.folder / "episodes.csv", "w", newline="") as file:
        csv.DictWriter(file, rows[0]).writeheader()
        csv.DictWriter(file, rows[0]).writerows(rows)
    points = level2.curve_rows(run)
    assert {point["episodes"] for point in points} == {100, 150, 200}
    for point in points:
        last = [row for row in rows if row["kind"] == point["kind"]][:point["episodes"]][-100:]
        assert point["success"] == sum(row["outcome"] == "arrival" for row in last) / 100
        assert point["return"] == round(sum(row["return"] for row in last) / 100, 1)
        assert int(point["steps"]) == last[-1]["steps"]
    assert list(points[0]) == list(tables.read_table(ROOT / "results" / "curves.csv")[0])


def test_a_planners_row_has_the_columns_of_the_published_table():
    row = level2.planner_row("env1", "random")
    published = tables.read_table(ROOT / "results" / "planners.csv")
    assert list(row) == list(published[0])
    assert (row["start_n"], row["anywhere_n"]) == (3, 50)


def test_what_is_to_do_is_said_in_the_minutes_that_it_took(tmp_path, monkeypatch):
    monkeypatch.setattr(runs, "RUNS", tmp_path / "runs")
    monkeypatch.setattr(runs, "RESULTS", tmp_path)
    three = [level2.Run("env1", "varied", seed) for seed in (0, 1, 2)]
    rows = [run.names | {"seconds": seconds} for run, seconds in zip(three, (6000, 240, 480))]
    runs.write_table("seeds.csv", rows[:2])
    runs.write_table("ablations.csv", rows[2:])
    three[0].folder.mkdir(parents=True)
    (three[0].folder / "summary.json").write_text('{"frozen": {}}')
    assert runs.expected(three, 3).startswith(
        "2 of 3 runs are to be trained, which takes about 4 minutes, 3 at a time")


def test_a_run_that_fails_is_one_line_and_no_other_is_begun(tmp_path, monkeypatch, capsys):
    monkeypatch.setattr(runs, "RUNS", tmp_path)
    begun = []

    def call(*arguments):
        begun.append(arguments)
        raise subprocess.CalledProcessError(2, ["python", "train.py"], stderr=b"x\nerror: full\n")

    monkeypatch.setattr(runs, "call", call)
    with pytest.raises(SystemExit) as stop:
        results.main(["--jobs", "1"])
    assert stop.value.code == 2 and len(begun) == 1
    assert capsys.readouterr().err == "error: 'train.py' failed: error: full\n"


# ------------------------------------------------------------------------------------ the benchmark


def test_the_networks_work_is_that_of_the_paper():
    forward, both = benchmark.flops(Network())
    assert forward == pytest.approx(6.1e6, rel=0.02) and both == pytest.approx(16.4e6, rel=0.02)


@pytest.mark.parametrize("boxes", benchmark.BOXES)
def test_the_benchmarks_rooms_have_so_many_boxes(boxes):
    scene = benchmark.make_room(boxes)
    assert len(scene.boxes) == boxes
    assert np.allclose(scene.bounds, [[-6.05, -6.05], [6.05, 6.05]])


def test_a_rate_is_the_best_of_its_timings(monkeypatch):
    clock = iter([0.0, 1.0,  # each timing: its start, and the time after the one call
                  10.0, 10.5, 20.0, 24.0])
    monkeypatch.setattr(benchmark.time, "perf_counter", lambda: next(clock))
    assert benchmark.rate(benchmark.counted(8, lambda: None), 0.1, timings=3) == 16


def count_once(call, seconds, timings=1):
    """A stand-in for `benchmark.rate` that takes every call for one second long."""
    return call()


def test_the_timed_training_is_the_real_one_with_half_of_the_robots_in_the_mirrored_room(
        monkeypatch):
    made = []
    learnt = []

    class Training(train.Training):
        def __init__(self, *arguments):
            super().__init__(*arguments)
            made.append(self)

        def learn(self):
            assert len(self.buffer) >= self.config.episodes_per_update
            learnt.extend(len(episode) for episode in self.buffer)
            return super().learn()

    monkeypatch.setattr(benchmark, "rate", count_once)
    monkeypatch.setattr(benchmark, "Training", Training)
    scene = benchmark.scenes.load("env1")
    steps, share = benchmark.train_sps(scene, 1, seconds=1)
    training, = made
    rooms = [training.env.scenes[k] for k in training.env.scene_of]
    R = training.config.robots
    assert len(rooms) == R and rooms.count(scene) == R // 2
    assert steps == training.record.steps > 0 and share == sum(learnt) / steps


@pytest.mark.parametrize("busy", [False, True])
def test_a_race_is_of_the_same_training_by_one_worker_and_by_several(busy, monkeypatch):
    steps = []

    def count(training, updates):
        steps.append((training.processes.count, updates))
        children = len(multiprocessing.active_children())
        assert children == 1 + busy  # the other worker, and what keeps a core busy
        return 10, 5
    monkeypatch.setattr(benchmark, "ROUNDS", 2)
    monkeypatch.setattr(benchmark, "make_updates", count)
    race = benchmark.race(benchmark.scenes.load("env1"), 2, 7, busy)
    assert steps == [(1, 7), (2, 7)] * 3
    assert race["1"] > 0 and race["2"] > 0 and race["ratio"] > 0


def test_pauses_are_the_median_and_the_slowest_of_what_was_called():
    class Sleeper:
        def sleep(self, seconds):
            time.sleep(seconds)
            return seconds
    sleeper = Sleeper()
    taken = []
    benchmark.note_seconds(sleeper, "sleep", taken)
    assert [sleeper.sleep(seconds) for seconds in (0.01, 0.05)] == [0.01, 0.05]
    assert 0.01 <= taken[0] < 0.05 <= taken[1]


def test_the_workers_of_the_benchmark_train_together():
    training = benchmark.make_training(2, benchmark.scenes.load("env1"))
    steps, learnt = benchmark.make_updates(training, 1)
    training.processes.close()
    assert steps > learnt >= training.config.episodes_per_update


def test_memory_is_that_of_a_command_and_its_children():
    hold = "x = bytearray(60_000_000); import time; time.sleep(1)"
    child = f"import subprocess, sys; subprocess.run([sys.executable, '-c', '{hold}'])"
    assert 60 < benchmark.peak_memory([sys.executable, "-c", child]) < 120


def test_the_benchmark_writes_its_figures_and_their_plot(tmp_path, monkeypatch, capsys):
    monkeypatch.setattr(benchmark, "rate", count_once)
    monkeypatch.setattr(benchmark.os, "sched_setaffinity", lambda *_: None, raising=False)
    monkeypatch.setattr(benchmark.torch, "set_num_threads", lambda _: None)
    monkeypatch.setattr(benchmark, "default_workers", lambda _: 1)
    monkeypatch.setattr(benchmark, "measure_workers", lambda *_: {})
    monkeypatch.setattr(benchmark, "measure_pauses", lambda *_: {})
    monkeypatch.setattr(benchmark, "measure_programs", lambda *_: {
        "start_up_seconds": {}, "seconds": {}, "memory_mb": 1})
    out = tmp_path / "figures.json"
    benchmark.main(["--cores", "1", "--json", "--out", str(out)])
    figures = json.loads(capsys.readouterr().out)
    assert figures == json.loads(out.read_text())
    assert out.with_suffix(".png").stat().st_size > 5000 and figures["cores"] == 1
    robots = {"1": 1, "32": 32, "256": 256, "1024": 1024}  # a call is a step of each
    assert figures["camera_fps"] == figures["env_sps"] == figures["world_sps"] == robots
    assert list(figures["camera_fps_boxes"]) == ["4", "8", "16", "24", "40"]
    assert figures["train_sps"] > 0 and figures["peers"] == {}
    roof = figures["roof_flops"] / figures["flops_per_frame"]["forward"]
    assert figures["roof_fps"]["forward"] == figures["roof_fps"]["act"] == roof
    published = json.loads((ROOT / "results" / "benchmark.json").read_text())
    assert figures.keys() == published.keys() - {"all_cores"}


@pytest.mark.parametrize("main, arguments, words", [
    (benchmark.main, ["--cores", "4096"], "--cores is 4096, it must be at most"),
    (benchmark.main, ["--out", "none/here.json"], "--out is"),
    (benchmark.main, ["--out", "here.png"], "--out is 'here.png', it must be"),
    (benchmark.main, ["--seconds", "inf"], "--seconds is inf, it must be a number from 0.001"),
    (benchmark.main, ["--updates", "9" * 30], "from 1 to 1,000"),
    (results.main, ["--jobs", "0"], "--jobs is 0, it must be a whole number from 1 to 64"),
    (results.main, ["--draw"], "unknown argument '--draw'"),
    (results.main, ["--job", "3"], "the nearest is --jobs"),
    (tables.main, ["--check"], "unknown argument '--check'")])
def test_bad_input_is_one_line(main, arguments, words, capsys):
    with pytest.raises(SystemExit) as stop:
        main(arguments)
    printed = capsys.readouterr()
    assert stop.value.code == 2 and printed.out == "" and printed.err.count("\n") == 1
    assert words in printed.err


# ---------------------------------------------------------------------------------------- the house


LESSON = {"navbot_min", "sim", "render", "model", "ppo", "train"}
WHO_IMPORTS_WHOM = {  # a file of the top level, or a folder: what of ours it may import
    "sim": set(),
    "model": set(),
    "ppo": set(),
    "render": {"sim", "support"},
    "scenes": {"sim"},
    "support": {"sim", "render", "model", "scenes"},
    "navbot_min": {"sim", "render", "scenes", "support"},
    "robot": LESSON - {"ppo", "train"} | {"scenes", "support"},
    "train": LESSON | {"scenes", "support", "robot", "evaluation"},
    "evaluation": LESSON - {"ppo", "train"} | {"scenes", "support", "robot"},
    "experiments": LESSON | {"scenes", "support", "robot", "evaluation"},
    "classroom": LESSON | {"scenes", "support", "evaluation"}}
PROGRAMS = {"scenes/__main__.py": {"render", "support"}}  # what a program may import beside these
NO_TORCH = {"sim", "render", "navbot_min", "scenes"}
NO_PYMUNK = {"model", "ppo"}


def our_files():
    """Every Python file of the project, relative to its folder."""
    found = set(ROOT.glob("*.py"))
    for folder in ROOT.iterdir():
        is_ours = not folder.name.startswith(".") and not (folder / "pyvenv.cfg").exists()
        if folder.is_dir() and is_ours:
            found |= set(folder.rglob("*.py"))
    return sorted(path.relative_to(ROOT) for path in found)


def part(path):
    """The part of the house that a file is: itself, or the folder at the top level."""
    return path.parts[0].removesuffix(".py")


def imports(path):
    """What a file imports: (module, the function that does so or None) for each import."""
    found = []

    def visit(node, function):
        if isinstance(node, (ast.FunctionDef, ast.AsyncFunctionDef)):
            function = node.name
        elif isinstance(node, ast.Import):
            found.extend((alias.name, function) for alias in node.names)
        elif isinstance(node, ast.ImportFrom):
            found.append((part(path) if node.level else node.module, function))
        for child in ast.iter_child_nodes(node):
            visit(child, function)

    visit(ast.parse((ROOT / path).read_text(encoding="utf-8")), None)
    return found


def check_imports(path):
    """Raises AssertionError where a file imports what it may not."""
    ours = {part(file) for file in our_files()}
    assert part(path) in WHO_IMPORTS_WHOM, f"{path} has no rule: who imports whom"
    allowed = WHO_IMPORTS_WHOM[part(path)] | {part(path)} | PROGRAMS.get(path.as_posix(), set())
    for module, function in imports(path):
        top = module.split(".")[0]
        assert top not in ours or top in allowed, f"{path} imports {module}"
        assert not (top == "torch" and part(path) in NO_TORCH), f"{path} imports torch"
        assert not (top == "pymunk" and part(path) in NO_PYMUNK), f"{path} imports pymunk"
        if path.as_posix() == "train.py" and top == "evaluation":
            assert function == "main", f"train.py imports evaluation in {function}"


TESTS = [path for path in our_files() if path.name.startswith(("test_", "conftest"))]


@pytest.mark.parametrize("path", [path for path in our_files() if path not in TESTS], ids=str)
def test_imports_are_those_that_the_house_allows(path):
    check_imports(path)


@pytest.mark.parametrize("path", TESTS, ids=str)
def test_tests_import_no_room_that_nothing_may_import(path):
    for module, _ in imports(path):
        top = module.split(".")[0]
        assert top not in ("experiments", "classroom") or top == part(path)


@pytest.mark.parametrize("modules, kept_out", [
    ("sim, render, scenes, scenes.__main__, navbot_min, support.traces", "torch matplotlib"),
    ("model, ppo", "pymunk matplotlib"), ("evaluation", "torch matplotlib")])
def test_a_half_of_the_house_is_loaded_without_the_others_libraries(modules, kept_out):
    code = f"import sys, {modules}; print(*sys.modules)"
    loaded = subprocess.run([sys.executable, "-c", code], cwd=ROOT, capture_output=True, text=True,
                            check=True).stdout.split()
    assert not set(kept_out.split()) & set(loaded)


def test_no_line_is_longer_than_100_columns():
    long = [f"{path}:{number}" for path in our_files() for number, line in enumerate(
        (ROOT / path).read_text(encoding="utf-8").splitlines(), 1) if len(line) > 100]
    assert not long


# ---------------------------------------------------------------------------------------- the pages


PROGRAM = re.compile(r"(?:python3?|py|torchrun) (?:[^`]*? )?(?:-m ([\w.]+)|([\w/]+\.py))\b")
FILE_NAME = re.compile(r"[\w./-]+\.(?:py|toml|csv|json|png|gif|txt|md|pt|cff)")
MADE = re.compile(  # by the commands, in a run folder or in the working folder
    r"(config|summary|evaluation|episodes|updates|model|checkpoint|curves|trajectories|episode"
    r"|floor|demo|drives|benchmark)(-[\w-]+)?\.(json|csv|pt|png|gif)")
THE_READERS_OWN = {"my_room.toml"}
OUTSIDE = {"pytest", "pip", "venv"}  # programs of others


def code_pieces(text):
    """The pieces of code on a page: lines of its blocks, and what stands between backticks."""
    blocks = re.findall(r"^ *```\w*\n(.*?)^ *```$", text, re.DOTALL | re.MULTILINE)
    text = re.sub(r"^ *```\w*\n.*?^ *```$", "", text, flags=re.DOTALL | re.MULTILINE)
    lines = [line for block in blocks for line in block.splitlines()]
    lines += re.findall(r"^ {4,}(.*)$", text, re.MULTILINE)
    spans = [" ".join(span.split()) for span in re.findall(r"`([^`]+)`", text)]
    return [piece.split(" #")[0].strip() for piece in lines + spans]


@functools.cache
def help_of(program):
    """What a program of ours, `train.py` or `experiments.results`, prints for --help."""
    name = program.removesuffix(".py")
    if (ROOT / name / "__main__.py").is_file():
        name += ".__main__"
    printed = io.StringIO()
    with contextlib.redirect_stdout(printed), contextlib.suppress(SystemExit):
        importlib.import_module(name).main(["--help"])
    return " ".join(printed.getvalue().split())


def check_command(piece):
    """Raises AssertionError where a piece of code is a command with a program or a flag that does
    not exist, or a flag's value that is none of its choices."""
    match = PROGRAM.search(piece)
    if not match or (match[1] or match[2]) in OUTSIDE:
        return
    program = match[1] or match[2]
    path = ROOT / program.removesuffix(".py").replace(".", "/")
    assert path.with_suffix(".py").is_file() or (path / "__main__.py").is_file(), piece
    words = piece[match.end():].split()
    for flag, value in zip(words, [*words[1:], ""]):
        if flag.startswith("--"):
            described = re.search(rf"(?<![\w-]){flag}\b(?: \{{([^}}]*)\}})?(?!-)", help_of(program))
            assert described, f"{program} has no {flag}: {piece}"
            choices = described[1]
            assert choices is None or value in choices.split(","), piece


def exists(name, page):
    """Whether a file that a page names is there, or is made by a command."""
    is_made = MADE.fullmatch(Path(name).name) or name.split("/")[0] in ("runs", "evaluations")
    places = (ROOT, ROOT / "results", page.parent)
    return bool(is_made or name in THE_READERS_OWN
                or any((place / name).exists() for place in places))


def headings(page):
    """The anchors of a page's headings, as GitHub makes them."""
    titles = re.findall(r"^#+ (.*)$", page.read_text(encoding="utf-8"), re.MULTILINE)
    return {re.sub(r"[^\w\- ]", "", title.lower()).replace(" ", "-") for title in titles}


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.name)
def test_the_commands_of_a_page_are_those_of_the_programs(page):
    text = page.read_text(encoding="utf-8")
    makefile = (ROOT / "Makefile").read_text()
    everywhere = " ".join(help_of(program) for program in (
        "train.py", "navbot_min.py", "evaluation", "experiments.results", "experiments.benchmark"))
    for piece in code_pieces(text):
        check_command(piece)
        if piece.startswith("--"):
            for flag in re.findall(r"--[\w-]+", piece):
                assert re.search(rf"{flag}(?![\w-])", everywhere), piece
        if piece.startswith("make "):
            assert re.search(rf"^{piece.split()[1]}:", makefile, re.MULTILINE), piece


@pytest.mark.parametrize("name", ["Makefile", ".ci/run"])
def test_make_and_ci_run_programs_that_exist(name):
    for line in (ROOT / name).read_text().splitlines():
        check_command(line.strip())


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.name)
def test_the_files_that_a_page_names_exist(page):
    text = page.read_text(encoding="utf-8")
    for piece in code_pieces(text):
        for word in re.split(r"[\s,;\"']+", piece):
            if FILE_NAME.fullmatch(word):
                assert exists(word, page), word
    for name, file in re.findall(r"`([\w.]+)` in `([\w/]+\.py)`", text):
        source = (ROOT / file).read_text(encoding="utf-8")
        last = name.split(".")[-1]
        assert re.search(rf"^\s*(?:def|class) {last}\b|^{last} = ", source, re.MULTILINE), name


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.name)
def test_the_links_of_a_page_lead_somewhere(page):
    for target in re.findall(r"\]\(([^)\s]+)\)", page.read_text(encoding="utf-8")):
        if re.match(r"\w+:", target):  # https:, mailto:
            continue
        name, _, anchor = target.partition("#")
        linked = page.parent / name if name else page
        assert linked.exists(), target
        assert not anchor or anchor in headings(linked), target


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.name)
def test_the_python_on_a_page_runs(page, tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    text = page.read_text(encoding="utf-8")
    names = {}
    for block in re.findall(r"^```python\n(.*?)^```$", text, re.DOTALL | re.MULTILINE):
        exec(compile(block, page.name, "exec"), names)
