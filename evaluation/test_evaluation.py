"""Tests of the evaluation, most of them against a slow implementation."""

import json
import math
import subprocess
import sys
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

import scenes
from evaluation import (Planned, Policy, assign, evaluate, film_episode, report, rollouts, spl,
                        summarise, table, validation_scene, wilson)
from evaluation.__main__ import main
from evaluation.after_training import evaluate_many
from evaluation.planners import visibility_graph
from evaluation.protocols import assign_all, make_environment
from model import make_network
from navbot_min import MAX_COMMAND, NavVecEnv
from scenes.test_scenes import square_room
from sim import ROBOT_RADIUS, SceneError
from support.weights import load_model, save_model

ROOT = Path(__file__).parent.parent
ENV1_POLICY = ROOT / "pretrained" / "env1.safetensors"
ENV1 = scenes.load("env1")
ENV2 = scenes.load("env2")
TINY = scenes.parse(square_room(0.5, training_targets=[[0.3, 0.0]], new_targets=[[0.0, 0.3]]),
                    "tiny")
TRAINING_ONLY = scenes.parse(square_room(new_targets=[]), "training only")
SUMMARY = {"stopped_by_rule": False, "steps": 1000, "episodes": 20, "seconds": 3.2,
           "rolling_new_success": None}


def test_wilson_intervals_and_spl_have_known_values():
    for n, successes, low, high in ((100, 81, 0.722, 0.875), (20, 0, 0.0, 0.161),
                                    (20, 20, 0.839, 1.0), (0, 0, 0.0, 1.0)):
        assert wilson(successes, n) == pytest.approx((low, high), abs=5e-4)
    assert (spl(True, 2.0, 4.0), spl(True, 2.0, 1.9), spl(False, 2.0, 2.0)) == (0.5, 1.0, 0.0)
    assert (spl(True, 0.0, 0.1), spl(False, math.inf, 3.0)) == (1.0, 0.0)


def test_a_summary_agrees_with_its_episodes_one_by_one():
    traces = rollouts(Planned("random", 0), assign_all("anywhere", [TINY, ENV1], 24), "anywhere")
    found = summarise(traces)
    for name, outcome in (("success", "arrival"), ("collision",) * 2, ("timeout",) * 2):
        assert found[name] == [trace.outcome for trace in traces].count(outcome) / 24
    assert found["standing"] == found["stops"] == 0 < found["success"] < 1
    assert (found["low"], found["high"]) == wilson(round(24 * found["success"]), 24)
    arrived = [trace for trace in traces if trace.outcome == "arrival"]
    weights = []
    for trace in arrived:
        _, shortest = visibility_graph(trace.scene).path(trace.start[:2], trace.goal)
        driven = 0.4 * sum(v for v, _ in trace.commands)
        weights.append(1.0 if shortest == 0 else shortest / max(shortest, driven))
    assert found["spl"] == pytest.approx(sum(weights) / 24)
    steps = [len(trace.commands) for trace in arrived]
    assert found["seconds_to_arrive"] == pytest.approx(0.4 * np.mean(steps))
    assert summarise([]) is None


def test_validation_targets_are_reachable_and_away_from_the_new_targets():
    spots = validation_scene(ENV2).new_targets
    assert len(spots) > 60 and ENV2.clearance(spots).min() > ROBOT_RADIUS - 0.02
    roadmap = visibility_graph(ENV2)
    for spot in spots:
        for others, apart in (([ENV2.start[:2], *ENV2.new_targets], 0.5),
                              (ENV2.training_targets, 0.2)):
            assert min(math.dist(spot, other) for other in others) >= apart
        assert roadmap.path(ENV2.start[:2], spot)[1] < math.inf
    result, traces = evaluate(Planned("straight", 0), [ENV2], 1, "validation")
    assert result["new"] is None and result["validation"]["n"] == len(spots)
    assert {tuple(trace.goal) for trace in traces} == {*spots, *ENV2.training_targets}
    with pytest.raises(SceneError, match="tiny has no space for validation targets"):
        validation_scene(TINY)


@pytest.mark.parametrize("hidden, place, cube", [
    ("", True, True), ("place", False, True), ("cube", True, False), ("both", False, False)])
def test_hidden_parts_of_a_target_are_not_observed_and_nothing_else_changes(hidden, place, cube):
    room = scenes.parse(square_room(), "room")
    seen = []
    for target, part in ((0, hidden), (0, ""), (1, "")):  # target 1 is to the left, out of view
        env = make_environment("start", [room], [target], part)
        first, _ = env.reset(seed=0)
        seen.append((first, env.step([[0.5, 0.0]])[0]))
    for one, ahead, aside in zip(*seen):  # at the start and after one step
        assert np.array_equal(one["image"], (ahead if cube else aside)["image"])
        assert not np.array_equal(ahead["image"], aside["image"])
        assert np.array_equal(one["target"], ahead["target"] * place)
        assert all(np.array_equal(one[key], ahead[key]) for key in ("velocity", "last_reward"))


class Grey(NavVecEnv):
    """A custom environment. Its images are grey."""

    def observe(self, *arguments):
        seen = super().observe(*arguments)
        seen["image"][:] = 77
        return seen


class HalfSpeed:
    """A custom driver. `seen` records each step: is the target observed, are all images grey?"""

    def __init__(self):
        self.seen = []

    def reset(self, env, robots):
        pass

    def act(self, env, observations):
        self.seen.append((observations["target"].any(), (observations["image"] == 77).all()))
        return np.tile((0.5, 0.0), (env.num_envs, 1))


def test_a_custom_driver_and_environment_are_evaluated_and_filmed_like_others():
    trace = rollouts(HalfSpeed(), assign(TRAINING_ONLY, 0, 1))[0]
    assert trace.arrived and (trace.commands == MAX_COMMAND * (0.5, 0)).all()
    assert trace.metres == pytest.approx(0.84)  # 0.823 m to the goal's circle, 0.06 m per step
    driver = HalfSpeed()
    evaluate(driver, [TRAINING_ONLY], 1, hidden="both", environment=Grey)
    filmed = film_episode(driver, ENV1, "validation", hidden="both", environment=Grey)
    assert len(driver.seen) > len(filmed.commands) and set(driver.seen) == {(False, True)}
    assert filmed.label == "protocol validation, target's place and cube hidden"
    assert (filmed.goal == validation_scene(ENV1).targets[-1]).all()


def test_the_pretrained_policy_drives_as_in_an_older_version():
    """The numbers are from commit 7a533a4. Rounding can change a pixel, and therefore the steps."""
    net, [room] = load_model(ENV1_POLICY)
    assert room == ENV1
    _, traces = evaluate(Policy(net, "sampled", 1), [room], 1, "perturbed", seed=1)
    expected = [(-3.774875, -3.785693, 44), (-1.444425, -3.984169, 30), (-2.953330, -2.141943, 32)]
    for trace in traces:
        x, y, steps = expected[trace.target]
        assert trace.goal == pytest.approx((x, y), abs=1e-6)
        assert trace.arrived and len(trace.commands) == pytest.approx(steps, abs=2)


def test_several_scenes_share_the_episodes_and_do_not_affect_each_other():
    scene_list = [ENV1, TRAINING_ONLY, ENV2]
    result, _ = evaluate(Planned("straight", 0), scene_list, 30)
    rows = result["targets"]
    assert [row["scene"] for row in rows] == ["env1"] * 3 + ["training only"] + ["env2"] * 12
    assert [row["n"] for row in rows] == [5, 5, 15, 10, *[1] * 10, 8, 7]
    assert (result["training"]["n"], result["new"]["n"]) == (30, 30)
    alone = []
    for scene in scene_list:
        own, _ = evaluate(Planned("straight", 0), [scene], 1)
        alone += own["targets"]
    for row, own in zip(rows, alone):
        assert all(row[key] == own[key] for key in ("x", "y", "kind", "success", "collision"))
    assert "env2 new (-3, -3.8)" in table(result)
    _, traces = evaluate(Planned("straight", 0), scene_list, 7, "anywhere")
    assert [sum(trace.scene == scene for trace in traces) for scene in scene_list] == [3, 2, 2]


def test_a_report_shows_that_a_room_has_no_new_targets():
    result, _ = evaluate(Planned("straight", 0), [TRAINING_ONLY], 5)
    row = ("success 100.0% [56.6%, 100.0%]  collision   0.0%  timeout   0.0%  SPL 0.98  "
           "arrives in 2.8 s  n 5")
    assert table(result) == (f"all training targets  {row}\nall new targets       none\n"
                             f"training (1, 0)       {row}")
    result["targets"][0]["mean_action_arrives"] = False
    text = report(SUMMARY | {"frozen": result})
    assert "success on new targets: none\n" in text
    assert text.endswith("deterministic (mean) action fails")


@pytest.mark.parametrize("other, words", [
    ([TINY], "success in new rooms: no episode during training, frozen"),
    ([], "success in new rooms: none\ntraining rooms")])
def test_level_3_is_evaluated_and_reported_by_kind_of_room(other, words):
    rooms = {"training": [ENV1, TRAINING_ONLY], "new": other}
    training = SimpleNamespace(
        model=make_network(0), environment=NavVecEnv, stage=5,
        config=SimpleNamespace(seed=3, evaluation_episodes=4, device="cuda"),
        rooms=SimpleNamespace(by_kind=lambda stage: rooms if stage == 5 else {}))
    frozen = evaluate_many(training)
    for kind in ("training", "new"):
        policy = Policy(training.model, "mean", 3)
        alone = rooms[kind] and evaluate(policy, rooms[kind], 4, "anywhere", 3)[0]["anywhere"]
        assert frozen[kind] == (alone or None)
    text = report(SUMMARY | {"frozen": frozen})
    assert words in text and text.count("success") == 2 + len(other)


@pytest.fixture
def run(tmp_path, monkeypatch):
    """The folder of a run under way, with untrained weights, in the current folder."""
    monkeypatch.chdir(tmp_path)
    folder = Path("run")
    folder.mkdir()
    save_model(folder / "model.safetensors", make_network(0), [ENV1])
    return folder


def test_an_evaluation_prints_and_writes_its_result_and_writes_pictures(run, capsys):
    main(["run", "--episodes", "3", "--workers", "1", "--json"])
    written = json.loads(Path("run/evaluation.json").read_text())
    assert json.loads(capsys.readouterr().out) == written
    assert list(written) == ["protocol", "actions", "hidden", "training", "new", "targets"]
    assert list(written["new"]) == ["n", "success", "low", "high", "collision", "timeout",
                                    "standing", "stops", "spl", "seconds_to_arrive"]
    main(["run", "--episodes", "3", "--workers", "1", "--protocol", "anywhere", "--env", "env2",
          "--hide", "cube"])
    printed = capsys.readouterr().out
    assert "in env2, protocol anywhere, target's cube hidden; files in run\nrandom" in printed
    suffix = "-env2-anywhere-hidden-cube"
    elsewhere = json.loads(Path(f"run/evaluation{suffix}.json").read_text())
    assert (written["hidden"], elsewhere["hidden"]) == ("", "cube")
    assert (written["actions"], elsewhere["actions"]) == ("sampled", "mean")
    assert {path.name for path in run.iterdir()} == {
        "model.safetensors", "evaluation.json", "trajectories.png", "episode.gif",
        f"evaluation{suffix}.json", f"trajectories{suffix}.png", f"floor{suffix}.png",
        f"episode{suffix}.gif"}


def test_a_weights_file_is_evaluated_into_evaluations_with_a_picture_per_room(run, capsys):
    save_model("mine.safetensors", make_network(0), [ENV1, ENV2])
    main(["mine.safetensors", "--episodes", "1", "--workers", "1"])
    assert "mine, policy, sampled actions, in env1, env2, protocol start" in capsys.readouterr().out
    assert {path.name for path in Path("evaluations/mine").iterdir()} == {
        "evaluation.json", "episode.gif", "trajectories-env1.png", "trajectories-env2.png"}


def test_a_planner_drives_in_one_process_without_torch(tmp_path):
    code = ("import sys; from evaluation.__main__ import main; main(sys.argv[1:]); "
            "assert 'torch' not in sys.modules")
    subprocess.run([sys.executable, "-c", code, "--planner", "straight", "--episodes", "2",
                    "--workers", "2"], cwd=tmp_path, env={"PYTHONPATH": str(ROOT)}, check=True)
    written = tmp_path / "evaluations/straight-env1/evaluation.json"
    assert json.loads(written.read_text())["actions"] == "straight"


def test_the_number_of_processes_does_not_change_the_result(monkeypatch):
    monkeypatch.setattr("evaluation.examine.BLOCK", 2)  # three robots are two blocks
    net, rooms = load_model(ENV1_POLICY)
    one, two = [evaluate(Policy(net, "sampled", 0), rooms, 3, workers=workers)[0]
                for workers in (1, 2)]
    assert one == two


@pytest.mark.parametrize("targets, options, file", [
    ("both", [], "evaluation.json"),
    ("anywhere", [], "evaluation-anywhere.json"),
    ("anywhere", ["--protocol", "start"], "evaluation-start.json")])
def test_the_default_protocol_is_that_of_the_run_and_keeps_level_3_results_of_training(
        targets, options, file, run, monkeypatch):
    monkeypatch.setattr("evaluation.__main__.Examination.show", lambda *_: None)
    (run / "config.json").write_text(json.dumps({"targets": targets}))
    (run / "evaluation.json").write_text("written by training")
    main(["run", "--episodes", "1", "--workers", "1", *options])
    protocol = file.removesuffix(".json").partition("-")[2] or "start"
    written = json.loads((run / file).read_text())
    assert written["protocol"] == protocol
    assert written["actions"] == ("sampled" if protocol == "start" else "mean")
    kept = (run / "evaluation.json").read_text() == "written by training"
    assert kept == (file != "evaluation.json")
