"""Tests of the runs and of the tables that they fill."""

import json
import os
import shutil
import signal
import subprocess
import sys
import time
from dataclasses import replace

import numpy as np
import pandas as pd
import pytest

import evaluation.__main__ as evaluating
import robot.evaluate
import robot.train
import scenes
import train
from experiments import mujoco, results, runs
from experiments.runs import (ANY_ROOM, DELTAS, LAB, LEVEL_1, LEVEL_2, LEVEL_2_ABLATIONS, LEVEL_3,
                              TABLES, Run)
from experiments.tables import ROOT
from robot.test_mujoco import installed  # noqa: F401  a fixture
from scenes.reality import Reality
from support.cli import parse
from support.run_folder import check_config
from support.runs import RunError
from support.weights import load_model

PUBLISHED = set(runs.PRETRAINED.values())
EVERY = [*LEVEL_1, *LEVEL_2, *runs.ANY_TARGET, *runs.BUDGET, *LEVEL_2_ABLATIONS, *DELTAS, *LEVEL_3,
         *LAB, *runs.DRAWN, *runs.STOPS]
RATE = {"n": 2, "success": 1 / 3, "low": 0.1, "high": 0.9, "collision": 0.5, "timeout": 0.25,
        "spl": 0.12345, "standing": 0.1, "stops": 2.0}


@pytest.fixture
def folder(tmp_path, monkeypatch):
    """Folder for runs and tables, with copies of the published tables."""
    shutil.copytree(ROOT / "results", tmp_path, dirs_exist_ok=True)
    monkeypatch.setattr(runs, "RUNS", tmp_path / "runs")
    monkeypatch.setattr(results, "RESULTS", tmp_path)
    monkeypatch.setattr(runs, "PRETRAINED", {})
    return tmp_path


def finish(run):
    """Writes the files of a finished run. Returns its 400 training episodes."""
    run.folder.mkdir(parents=True)
    targets = [RATE | {"x": 1.0, "y": 2.0, "kind": kind, "mean_action_arrives": arrives}
               for kind, arrives in (("training", True), ("validation", False))]
    result = {"training": RATE, "new": RATE, "anywhere": RATE, "targets": targets}
    later = result | {"targets": [  # only the evaluation after training has deterministic actions
        {key: value for key, value in target.items() if key != "mean_action_arrives"}
        for target in targets]}
    files = {f"evaluation-{name}": later for name in run.evaluations} | {"evaluation": result}
    files["summary"] = {"steps": 64, "episodes": 7, "seconds": 1.5, "rolling_new_success": 0.61,
                        "frozen": result}
    for name, content in files.items():
        (run.folder / f"{name}.json").write_text(json.dumps(content))
    rng = np.random.default_rng(0)
    episodes = pd.DataFrame({"steps": 10 * np.arange(400), "return": rng.normal(size=400),
                             "kind": rng.choice(["training", "new"], 400),
                             "outcome": rng.choice(["arrival", "collision"], 400)})
    episodes.to_csv(run.folder / "episodes.csv", index=False)
    return episodes


def test_the_programs_accept_every_command_and_write_the_files_of_the_rows(folder):
    for run in EVERY:
        commands = results.commands(run)
        if not run.weights:
            _, _, program, *arguments = commands.pop(0)
            config_class = {"train": train.Config, "robot.train": robot.train.Config}[program]
            config, parser = parse(config_class, "", arguments)
            check_config(config, parser)
            assert config == config_class(**run.training, out=os.path.relpath(run.folder, ROOT))
        if run.names["seed"] == 0:
            run.folder.mkdir(parents=True)
            shutil.copy(ROOT / "pretrained" / "env1.safetensors", run.folder / results.FILE)
            options = {"targets": "both"} | run.options
            (run.folder / "config.json").write_text(json.dumps(options))
            for name, (_, _, program, *arguments) in zip(run.evaluations, commands, strict=True):
                module = {"evaluation": evaluating, "robot.evaluate": robot.evaluate}[program]
                options, parser = parse(module.Options, "", arguments)
                prepared = evaluating.Examination(options)
                assert (ROOT / prepared.folder).resolve() == run.folder
                assert prepared.suffix == f"-{name}"
    folders = {run.folder.name for run in EVERY}
    assert len(folders) == len(EVERY) == 10 + 20 + 5 + 30 + 36 + 12 + 36 + 26 + 1 + 20
    assert PUBLISHED < folders


@pytest.mark.parametrize("name", TABLES)
def test_rows_have_the_columns_of_the_published_table_and_replace_older_ones(name, folder):
    members, rows_of = TABLES[name]
    run = members[-1]
    finish(run)
    assert rows_of(run)
    if not (folder / name).exists():
        pytest.skip(f"results/{name} is not made yet")
    published = pd.read_csv(folder / name)
    assert list(rows_of(run)[0]) == list(published)
    results.record(run)
    made = pd.read_csv(folder / name)
    keys = list(run.names)
    done = made[keys].drop_duplicates().values.tolist()
    assert done == [names for member in members if (names := list(member.names.values())) in done]
    own, others = [], []
    for rows in (published, made):
        is_own = (rows[keys] == list(run.names.values())).all(axis=1)
        own.append(rows[is_own])
        others.append(rows[~is_own].sort_values(keys, kind="stable").reset_index(drop=True))
    assert len(own[1]) == len(rows_of(run)) and not own[1].equals(own[0])
    pd.testing.assert_frame_equal(*others)


def test_rows_have_the_numbers_of_the_evaluations_and_the_episodes(folder, monkeypatch):
    episodes = finish(LEVEL_2[0])
    [row] = runs.summary_rows(LEVEL_2[0])
    assert {"steps": 64, "new_success": 0.3333, "anywhere_spl": 0.1235,
            "mean_action_arrives": "1 of 2"}.items() <= row.items()
    last = episodes[episodes.kind == "new"][50:150]
    [point] = [point for point in runs.curve_rows(LEVEL_2[0])
               if (point["kind"], point["episodes"]) == ("new", 150)]
    assert point["success"] == (last.outcome == "arrival").sum() / 100
    assert point["return"] == pytest.approx(last["return"].mean(), abs=0.05)
    assert point["steps"] == last.steps.max()
    finish(DELTAS[0])
    last = episodes[episodes.kind == "training"][:100]
    point = runs.delta_rows(DELTAS[0])[0]
    assert (point["steps"], point["frozen"]) == (last.steps.max(), 0.333)
    assert point["success"] == (last.outcome == "arrival").sum() / 100
    finish(ANY_ROOM[0])
    monkeypatch.setattr(runs, "PART", 1000)
    [second] = [row for row in runs.part_rows(ANY_ROOM[0]) if row["steps"] == 2000]
    part = episodes[(episodes.kind == "new") & (episodes.steps > 1000) & (episodes.steps <= 2000)]
    rate = (part.outcome == "arrival").sum() / len(part)
    assert second["validation_success"] == pytest.approx(rate, abs=1e-4)
    finish(LEVEL_1[0])
    assert runs.summary_rows(LEVEL_1[0])[0]["steps_to_stop"] == ""  # half of them arrive
    episodes.outcome = ["timeout"] * 200 + ["arrival"] * 200
    episodes.to_csv(LEVEL_1[0].folder / "episodes.csv")
    assert runs.summary_rows(LEVEL_1[0])[0]["steps_to_stop"] == 10 * (200 + 80)


def test_planners_and_errors_are_measured_in_their_rooms(folder, monkeypatch):
    driven = []
    monkeypatch.setattr(results, "evaluate", lambda driver, rooms, *_, **__: driven.append(rooms)
                        or ({"anywhere": RATE | {"n": len(rooms)}}, []))
    monkeypatch.setattr(results, "summarise", lambda traces: RATE)
    results.write_planners()
    results.write_lab_errors()
    for name in ("planners", "level3-planners", "lab-errors"):
        published = pd.read_csv(ROOT / "results" / f"{name}.csv")
        made = pd.read_csv(folder / f"{name}.csv")
        assert list(made) == list(published)
        keys = list(made)[:2]
        assert set(map(tuple, made[keys].values)) <= set(map(tuple, published[keys].values))
    assert set(made.error) == {"none", "all", *vars(Reality())}
    for error, [room] in zip(made.error, driven[-len(made):]):
        changed = {name for name, value in vars(room.reality).items()
                   if value != getattr(Reality(), name)}
        assert room == scenes.load("lab") if error == "all" else changed == {error} - {"none"}


def test_a_failing_run_gives_one_sentence_and_ends_the_others(folder, monkeypatch):
    codes = ["import time; time.sleep(60)", "raise SystemExit(1)", "print('begun')"]
    wanted = [Run("level2", {"seed": seed}, {}, {}) for seed in range(3)]
    monkeypatch.setattr(results, "commands", lambda run: [
        [sys.executable, "-c", codes[run.names["seed"]]]])
    begun = []
    make_run = results.make_run
    monkeypatch.setattr(results, "make_run", lambda run: (
        begun.append(process) or process for process in make_run(run)))
    with pytest.raises(RunError, match="failed, see '.*seed1.log'$"):
        results.make_runs(wanted, 2)
    assert [process.returncode for process in begun] == [-signal.SIGTERM, 1]


def test_given_weights_are_evaluated_and_weights_of_a_published_run_are_copied(folder,
                                                                                   monkeypatch):
    weights = (ROOT / LAB[0].weights).read_bytes()
    (folder / "pretrained").mkdir()
    (folder / LAB[0].weights).write_bytes(weights)
    monkeypatch.setattr(results, "ROOT", folder)
    monkeypatch.setattr(results, "commands", lambda run: [])
    monkeypatch.setattr(runs, "TABLES", {})
    monkeypatch.setattr(runs, "PRETRAINED", {"mine": LAB[0].folder.name, "other": "other"})
    results.make_runs(LAB[:1], 1)
    assert (folder / "pretrained" / "mine.safetensors").read_bytes() == weights
    assert not (folder / "pretrained" / "other.safetensors").exists()


def test_the_same_command_resumes_an_interrupted_run(folder, monkeypatch):
    run = Run("level2", {"env": "env1", "way": "none", "seed": 2},
              {"env": "env1", "steps": 2000, "robots": 8, "memory": "none",
               "evaluation_episodes": 2}, {"anywhere": {"protocol": "anywhere", "episodes": 2}})
    (folder / "ablations.csv").unlink()
    monkeypatch.setitem(TABLES, "ablations.csv", ([run], runs.summary_rows))
    program = ("from pathlib import Path; from experiments import results, runs\n"
               f"runs.RUNS = Path({str(runs.RUNS)!r})\n"
               f"runs.LEVEL_2 = [runs.Run('level2', {run.names}, {run.options}, {{}})]\n"
               "runs.ANY_TARGET = runs.BUDGET = runs.LEVEL_2_ABLATIONS = runs.DELTAS = []\n"
               "results.main(['--level', '2'])")
    run.folder.mkdir(parents=True)  # left by a command that was interrupted at once
    process = subprocess.Popen([sys.executable, "-c", program], cwd=ROOT, text=True,
                               stdout=subprocess.DEVNULL, stderr=subprocess.PIPE)
    while not (run.folder / "checkpoint.pt").exists():
        assert process.poll() is None
        time.sleep(0.05)
    process.send_signal(signal.SIGINT)
    assert process.communicate(timeout=60)[1] == "\ninterrupted; the same command continues\n"
    assert results.commands(run)[0][2:4] == ["train", "--resume"]
    with pytest.raises(RunError, match="is a run with other options: delete it"):
        results.commands(replace(run, options=run.options | {"robots": 16}))
    results.make_runs([run], 1)
    assert pd.read_csv(folder / "ablations.csv").steps.tolist() == [2000]
    assert results.commands(run) == []


def test_a_run_whose_rows_and_weights_are_published_is_skipped(folder, monkeypatch):
    monkeypatch.setattr(results, "commands", lambda run: pytest.fail(f"it makes {run.folder}"))
    results.make_runs(LEVEL_1, 1)
    monkeypatch.setattr(runs, "PRETRAINED", {"missing": LEVEL_1[0].folder.name})
    assert not results.is_recorded(LEVEL_1[0]) and results.is_recorded(LEVEL_1[1])
    rows = pd.read_csv(folder / "level1.csv")
    rows[1:].to_csv(folder / "level1.csv", index=False)
    monkeypatch.setattr(runs, "PRETRAINED", {})
    assert not results.is_recorded(LEVEL_1[0]) and results.is_recorded(LEVEL_1[1])


def test_a_table_of_mujoco_keeps_cells_with_the_same_weights_and_number_of_episodes(
        folder, monkeypatch):
    monkeypatch.setattr(mujoco, "RESULTS", folder)
    (folder / "mujoco.csv").unlink(missing_ok=True)
    cells = [("any-room", room, "anywhere", "ours", "a1") for room in ("env1", "env2", "maze0")]
    measured = []
    monkeypatch.setattr(mujoco, "cells", lambda: cells)
    monkeypatch.setattr(mujoco, "measure", lambda *cell, n: measured.append(cell) or [
        dict(zip(mujoco.CELL, cell)) | {"targets": "anywhere", "n": n}])
    for again, changed, episodes in (([0, 1, 2], {}, 5), ([1], {1: "b2"}, 5), ([0, 1, 2], {}, 6)):
        measured.clear()
        for k, digest in changed.items():
            cells[k] = (*cells[k][:-1], digest)
        mujoco.write_mujoco(episodes)
        assert measured == [cells[k] for k in again]
        rows = pd.read_csv(folder / "mujoco.csv")
        assert rows[list(mujoco.CELL)].values.tolist() == [list(cell) for cell in cells]
        assert (rows.n == episodes).all()


def test_a_cell_is_measured_with_its_policy_protocol_simulator_and_errors(monkeypatch):
    seen = {}

    def evaluate(driver, rooms, n, protocol, actions, environment, workers):
        seen.update(driver=driver, room=rooms[0], rest=(n, protocol, actions, environment))
        return {"training": RATE, "new": RATE, "anywhere": None}, []

    monkeypatch.setattr(mujoco, "evaluate", evaluate)
    for name, kind, look, delay in (
            ("ours", mujoco.RealVecEnv, None, None), ("MuJoCo", mujoco.MujocoVecEnv, None, None),
            ("MuJoCo with late images", mujoco.MujocoVecEnv, "simulation", 1.0),
            ("ours with the lab's look", mujoco.RealVecEnv, "lab", 0.0),
            ("MuJoCo with the lab's look", mujoco.MujocoVecEnv, "lab", 0.0)):
        rows = mujoco.measure("env2", "maze0", "perturbed", name, "a1", n=7)
        assert seen["rest"] == (7, "perturbed", "mean", kind)
        assert [row["targets"] for row in rows] == ["training", "new"]
        assert seen["room"].boxes == scenes.load("maze0").boxes
        errors = seen["room"].reality
        assert (errors and errors.appearance, errors and errors.image_delay) == (look, delay)
    weights = load_model(ROOT / "pretrained" / "env2.safetensors")[0].state_dict()
    assert all((value == weights[key]).all()
               for key, value in seen["driver"].model.state_dict().items())


@pytest.mark.usefixtures("installed")
def test_each_mixture_of_the_simulations_takes_the_part_that_it_names():
    seen = {}
    for name, environment in (mujoco.WHOLE | mujoco.MIXED).items():
        room = replace(scenes.load("env2"), reality=mujoco.ERRORS.get(name))
        env = environment(1, [room], "training")
        first, _ = env.reset(seed=0, options={"start": env.scenes[0].start, "target": 0})
        observed, *_ = env.step(np.array([[1.0, 0.5]]))
        assert (observed["image"] == first["image"]).all() == (name == "MuJoCo with late images")
        moved = np.hypot(*(env.world.poses[0] - env.starts[0])[:2])
        off = np.abs(env.estimates - env.world.poses).max()
        turned = env.world.poses[0, 2] - env.starts[0][2]
        seen[name] = observed["image"][0].astype(int), round(moved, 2), off > 1e-6
        assert turned == pytest.approx(0.2 if round(moved, 2) == 0.12 else 0.15, abs=0.01)
    assert {name: row[1:] for name, row in seen.items()} == {
        "ours": (0.12, False), "MuJoCo": (0.09, True), "MuJoCo with our images": (0.09, True),
        "MuJoCo with a level camera": (0.09, True), "MuJoCo with the true pose": (0.09, False),
        "MuJoCo with prompt wheels": (0.12, True), "MuJoCo with late images": (0.09, True),
        "ours with MuJoCo's images": (0.12, False)}
    floor = {name: (image == 118).all(-1) for name, (image, *_) in seen.items()}
    smooth = {name: np.abs(np.diff(image, axis=1))[~floor[name][:, 1:]].mean()
              for name, (image, *_) in seen.items()}
    assert all((smooth[name] > smooth["MuJoCo"] + 2) == (name in ("ours", "MuJoCo with our images"))
               for name in smooth), smooth
