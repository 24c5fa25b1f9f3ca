"""Each test is the shortest proof of one claim about evaluation, most against a slow twin."""

import json
import math
import pickle
import shutil
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
import torch

import scenes
from evaluation import (HIDDEN, Planned, Policy, ShortestPaths, assign, evaluate, film_episode,
                        report, rollouts, spl, summarise, table, validation_scene, wilson)
from evaluation.__main__ import main
from evaluation.after_training import evaluate_rooms
from evaluation.planners import PRM, visibility_graph
from evaluation.protocols import assign_all, make_environment
from model import make_network
from navbot_min import MAX_COMMAND, OUTCOMES, NavEnv, NavVecEnv
from scenes.test_scenes import square_room
from sim import ROBOT_RADIUS, SceneError, wrap_angle
from support.weights import load_run, save_model

ROOT = Path(__file__).parent.parent
ENV1 = scenes.load("env1")
ENV2 = scenes.load("env2")
TINY = scenes.parse(square_room(0.5, training_targets=[[0.3, 0.0]], new_targets=[[0.0, 0.3]]),
                    "tiny")
TRAINING_ONLY = scenes.parse(square_room(new_targets=[]), "training only")


def lively_network(memory="stacked"):
    """A random network whose memory shows in its actions."""
    net = make_network(0, memory)
    with torch.random.fork_rng(devices=[]):
        torch.manual_seed(1)
        torch.nn.init.orthogonal_(net.action.weight, 3.0)
    return net


# ---------------------------------------------------------------------------------------- measures


@pytest.mark.parametrize("successes, n, low, high", [
    (81, 100, 0.722, 0.875), (0, 20, 0.0, 0.161), (20, 20, 0.839, 1.0), (0, 0, 0.0, 1.0)])
def test_wilson_intervals_have_their_known_values(successes, n, low, high):
    assert wilson(successes, n) == pytest.approx((low, high), abs=5e-4)


@pytest.mark.parametrize("success, shortest, metres, expected", [
    (True, 2.0, 4.0, 0.5), (True, 2.0, 1.9, 1.0), (False, 2.0, 2.0, 0.0),
    (True, 0.0, 0.1, 1.0), (False, math.inf, 3.0, 0.0)])
def test_spl_on_paths_made_by_hand(success, shortest, metres, expected):
    assert spl(success, shortest, metres) == expected


def test_a_summary_is_that_of_its_episodes_one_by_one():
    traces = rollouts(Planned("random", 0), assign_all("anywhere", [TINY, ENV1], 24), "anywhere")
    found = summarise(traces)
    shares = {name: [trace.outcome for trace in traces].count(name) / 24 for name in OUTCOMES}
    names = ("success", "collision", "timeout", "standing")
    assert [found[name] for name in names] == list(shares.values()) and found["stops"] == 0
    assert 0 < found["success"] < 1 and (found["low"], found["high"]) == wilson(
        round(24 * found["success"]), 24)
    weights = []
    times = []
    for trace in traces:
        if trace.outcome == "arrival":
            _, shortest = visibility_graph(trace.scene).path(trace.start[:2], trace.goal)
            driven = 0.4 * sum(v for v, _ in trace.commands)
            weights.append(1.0 if shortest == 0 else shortest / max(shortest, driven))
            times.append(0.4 * len(trace.commands))
    assert found["spl"] == pytest.approx(sum(weights) / 24)
    assert found["seconds_to_arrive"] == pytest.approx(np.mean(times))
    assert summarise([]) is None


def test_an_evaluation_makes_the_visibility_graph_of_a_scene_once(monkeypatch):
    made = []

    def spy(scene):
        made.append(scene)
        return visibility_graph(scene)
    monkeypatch.setattr("evaluation.measures.visibility_graph", spy)
    paths = ShortestPaths()
    for scene in (ENV1, ENV2, ENV1):
        for goal in scene.targets:
            _, length = visibility_graph(scene).path(scene.start[:2], goal)
            assert paths.metres(scene, scene.start, goal) == length
    assert made == [ENV1, ENV2]


# --------------------------------------------------------------------------------------- protocols


def test_the_protocols_start_and_lead_where_they_say():
    starts = {}
    goals = {}
    for protocol in ("start", "perturbed", "anywhere"):
        env = make_environment(protocol, [ENV1] * 300, [2] * 300)
        env.reset(seed=0)
        starts[protocol] = env.starts
        goals[protocol] = env.goals
        assert ENV1.clearance(env.starts[:, :2]).min() > ROBOT_RADIUS
    assert (starts["start"] == ENV1.start).all() and (goals["start"] == ENV1.targets[2]).all()
    spread = (starts["perturbed"] - ENV1.start).std(0)
    assert spread == pytest.approx([0.05, 0.05, math.radians(10)], rel=0.15)
    spread = (goals["perturbed"] - ENV1.targets[2]).std(0)
    assert spread == pytest.approx([0.05, 0.05], rel=0.15)
    away = starts["anywhere"][:, :2] - goals["anywhere"]
    assert np.hypot(away[:, 0], away[:, 1]).min() >= 1
    assert (np.ptp(goals["anywhere"], axis=0) > (3, 1.5)).all()
    assert np.ptp(starts["anywhere"][:, 2]) > 6


@pytest.mark.parametrize("scene", [ENV1, ENV2], ids=["env1", "env2"])
def test_validation_targets_can_be_reached_and_give_nothing_of_the_exam_away(scene):
    spots = validation_scene(scene).new_targets
    assert len(spots) > 60 and scene.clearance(spots).min() > ROBOT_RADIUS - 0.02
    roadmap = visibility_graph(scene)
    for spot in spots:
        assert min(math.dist(spot, new) for new in scene.new_targets) >= 0.5
        assert math.dist(spot, scene.start[:2]) >= 0.5
        assert min(math.dist(spot, training) for training in scene.training_targets) >= 0.2
        assert roadmap.path(scene.start[:2], spot)[1] < math.inf
    result, traces = evaluate(Planned("straight", 0), [scene], 1, "validation")
    assert result["new"] is None and result["validation"]["n"] == len(spots)
    assert {tuple(trace.goal) for trace in traces} == {*spots, *scene.training_targets}
    kinds = [row["kind"] for row in result["targets"]]
    assert kinds == ["training"] * len(scene.training_targets) + ["validation"] * len(spots)


def test_a_room_under_a_metre_has_an_anywhere_but_no_validation_targets():
    env = make_environment("anywhere", [TINY] * 50, [0] * 50)
    env.reset(seed=0)
    away = env.starts[:, :2] - env.goals
    assert np.hypot(away[:, 0], away[:, 1]).min() > 0.3
    with pytest.raises(SceneError, match="tiny has no room for validation targets"):
        validation_scene(TINY)


@pytest.mark.parametrize("hidden, place, cube", [
    ("", True, True), ("place", False, True), ("cube", True, False), ("both", False, False)])
def test_what_is_hidden_of_a_target_is_not_observed_and_nothing_else_changes(hidden, place, cube):
    room = scenes.parse(square_room(), "room")
    seen = []
    for target, what in ((0, hidden), (0, ""), (1, "")):  # target 1 is to the left, out of view
        env = make_environment("start", [room], [target], what)
        first, _ = env.reset(seed=0)
        seen.append((first, env.step([[0.5, 0.0]])[0]))
    for one, ahead, aside in zip(*seen):  # at the start, and after a step
        assert np.array_equal(one["image"], (ahead if cube else aside)["image"])
        assert not np.array_equal(ahead["image"], aside["image"])
        assert np.array_equal(one["target"], ahead["target"] * place)
        assert all(np.array_equal(one[key], ahead[key]) for key in ("velocity", "last_reward"))


# -------------------------------------------------------------------------------------- evaluation


def test_a_frozen_evaluation_counts_its_quota_and_changes_nothing():
    net = make_network(0)
    before = {name: value.clone() for name, value in net.state_dict().items()}
    result, _ = evaluate(Policy(net, "sampled", 3), [ENV2], 13, seed=3)
    assert [target["n"] for target in result["targets"]] == 3 * [2] + 7 * [1] + [7, 6]
    assert (result["training"]["n"], result["new"]["n"]) == (13, 13)
    for row in (result["training"], result["new"], *result["targets"]):
        assert row["success"] + row["collision"] + row["timeout"] == pytest.approx(1)
    assert all(torch.equal(value, before[name]) for name, value in net.state_dict().items())


def test_a_policys_traces_are_those_of_one_robot_that_drives_one_episode_after_the_other():
    """The twin drives the recorded commands: would it drive its own, rounding would add up."""
    net = lively_network()
    _, traces = evaluate(Policy(net, "mean", 0), [ENV1], 20, "perturbed", actions="mean")
    assert len(traces) == 40 and len({len(trace.commands) for trace in traces}) > 5

    class Same(NavVecEnv):
        """Episodes are those of the traces."""

        def sample_episode(self, r):
            return trace.target, trace.goal, trace.start

    class SameEnv(NavEnv):
        vector_class = Same
    env = SameEnv([ENV1], max_episode_steps=200)
    for trace in traces:
        seen, info = env.reset()
        state = net.initial_state(1)
        poses = [info["pose"]]
        for k, command in enumerate(trace.commands):
            one = {key: value[None] for key, value in seen.items()}
            action, _, _, _, state = net.act(one, state, torch.Generator())
            bounded = action[0].numpy().clip((0, -1), (1, 1))
            assert np.allclose(bounded * MAX_COMMAND, command, atol=1e-3)
            seen, _, terminated, truncated, info = env.step(command / MAX_COMMAND)
            poses.append(info["pose"])
            assert (terminated or truncated) == (k == len(trace.commands) - 1)
        assert np.allclose(poses, trace.poses, atol=1e-6)
        assert (OUTCOMES[info["outcome"]], info["new"]) == (trace.outcome, trace.new)


def test_several_scenes_share_the_episodes_and_each_is_as_if_alone():
    scene_list = [ENV1, TRAINING_ONLY, ENV2]
    result, traces = evaluate(Planned("straight", 0), scene_list, 30)
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
        assert row["spl"] == pytest.approx(own["spl"])
    assert sum(trace.scene is ENV2 for trace in traces) == 25
    everywhere, traces = evaluate(Planned("straight", 0), scene_list, 7, "anywhere")
    assert [sum(trace.scene is scene for trace in traces) for scene in scene_list] == [3, 2, 2]
    assert everywhere["anywhere"]["n"] == 7 and everywhere["targets"] == []
    assert "env2 new (-3, -3.8)" in table(result)


def test_a_room_without_new_targets_evaluates_and_reports_say_so():
    result, traces = evaluate(Planned("straight", 0), [TRAINING_ONLY], 5)
    assert result["new"] is None and result["training"]["success"] == 1 and len(traces) == 5
    lines = table(result).splitlines()
    assert [line.split("  ")[0] for line in lines] == [
        "all training targets", "all new targets", "training (1, 0)"]
    assert lines[1].endswith("there are none")
    result["targets"][0]["mean_action_arrives"] = False
    text = report({"stopped_by_rule": False, "steps": 1000, "episodes": 20, "seconds": 3.2,
                   "rolling_new_success": None, "frozen": result})
    assert "success on new targets: there are none" in text
    assert text.endswith("deterministic (mean) action fails")
    assert film_episode(Planned("straight", 0), TRAINING_ONLY).arrived


@pytest.mark.parametrize("other, words", [
    ([TINY], "success in new rooms: while training no episode"),
    ([], "success in new rooms: there are none\nrooms learnt in")])
def test_level_3_is_evaluated_by_rooms_and_reports_say_so(other, words):
    net = lively_network("none")
    config = SimpleNamespace(seed=3, evaluation_episodes=4, ring=False, reality="")
    rooms = SimpleNamespace(by_kind=lambda: {"training": [ENV1, TRAINING_ONLY], "new": other})
    frozen = evaluate_rooms(net, rooms, config, 1)
    for kind, own in rooms.by_kind().items():
        if own:
            alone, _ = evaluate(Policy(net, "mean", 3), own, 4, "anywhere", 3)
            assert frozen[kind] == alone["anywhere"]
    text = report({"stopped_by_rule": False, "steps": 1000, "episodes": 20, "seconds": 3.2,
                   "rolling_new_success": None, "frozen": frozen})
    assert words in text and text.count("success") == 2 + len(other)


@pytest.mark.parametrize("arguments, words", [
    (dict(protocol="paper"), "protocol is 'paper', it must be one of 'start', 'perturbed'"),
    (dict(hidden="all"), "hidden is 'all', it must be one of '', 'place', 'cube', 'both'"),
    (dict(scenes="env1"), "scenes is 'env1', it must be a list"),
    (dict(scenes=[]), "scenes is \\[\\], it must be a list")])
def test_an_evaluation_that_cannot_be_is_one_sentence(arguments, words):
    with pytest.raises(ValueError, match=words):
        evaluate(Planned("straight", 0), **dict(scenes=[ENV1]) | arguments)


def test_a_policys_actions_are_one_of_two_kinds():
    with pytest.raises(ValueError, match="actions is 'best', it must be one of sampled, mean"):
        Policy(make_network(0), "best", 0)


def test_a_planner_prepares_once_for_a_scene(monkeypatch):
    prepared = []
    prepare = PRM.prepare

    def spy(scene, rng):
        prepared.append(scene.name)
        return prepare(scene, rng)
    monkeypatch.setattr(PRM, "prepare", spy)
    driver = Planned("prm", 0)
    for _ in range(2):
        evaluate(driver, [ENV1, TRAINING_ONLY], 20, "anywhere")
    assert prepared == ["env1", "training only"]


@pytest.mark.parametrize("protocol", ["start", "perturbed", "anywhere", "validation"])
def test_a_films_episode_obeys_the_protocol(protocol):
    trace = film_episode(Planned("straight", 0), ENV1, protocol, seed=2)
    moved = np.abs(trace.start - ENV1.start)
    moved[2] = abs(wrap_angle(trace.start[2] - ENV1.start[2]))
    if protocol == "anywhere":
        assert (moved[:2] > 0.3).any() and tuple(trace.goal) not in set(map(tuple, ENV1.targets))
    else:
        targets = validation_scene(ENV1).targets if protocol == "validation" else ENV1.targets
        assert np.allclose(trace.goal, targets[-1], atol=0.3 if protocol == "perturbed" else 0)
        assert (moved > 1e-6).all() == (protocol == "perturbed") and (moved < 0.5).all()
    assert trace.images.shape == (len(trace.poses), 48, 64, 3)
    assert trace.label == f"protocol {protocol}"


def test_an_environment_of_ones_own_is_evaluated_its_noise_under_a_hidden_cube_included():
    class Noisy(NavVecEnv):
        """Turns every image into one colour."""
        def observe(self, *arguments):
            seen = super().observe(*arguments)
            seen["image"][:] = 77
            return seen

    seen = []

    class Spy:
        label = "stands still, and looks"

        def reset(self, env, robots):
            pass

        def act(self, env, observations):
            seen.append((observations["image"] == 77).all())
            return np.zeros((env.num_envs, 2))
    for protocol in ("start", "perturbed", "anywhere"):
        evaluate(Spy(), [ENV1], 1, protocol, hidden="cube", environment=Noisy)
    assert seen and all(seen)


@pytest.mark.parametrize("hidden", HIDDEN)
def test_an_evaluation_and_its_film_hide_the_same(hidden):
    table = square_room(training_targets=[[0.0, 1.0]], new_targets=[[1.0, 0.0]])
    ahead = scenes.parse(table, "the last target is ahead")
    seen = []

    class Spy(Policy):
        def act(self, env, observations):
            blue = observations["image"][..., 2] > 100 + observations["image"][..., 0]
            seen.append((observations["target"].any(), blue.any()))
            return super().act(env, observations)
    spy = Spy(make_network(0), "mean", 0)
    evaluate(spy, [ahead], 1, hidden=hidden)
    evaluated = np.array(seen)
    seen.clear()
    trace = film_episode(spy, ahead, hidden=hidden)
    for steps in (evaluated, np.array(seen)):
        place, cube = steps.any(0)
        assert (place, cube) == (hidden in ("", "cube"), hidden in ("", "place"))
    assert trace.label == {
        "": "protocol start", "place": "protocol start, target's place hidden",
        "cube": "protocol start, target's cube hidden",
        "both": "protocol start, target's place and cube hidden"}[hidden]


@pytest.mark.parametrize("name", ["env1", "env2"])
def test_the_pretrained_policy_arrives_at_every_target(name):
    net, own_scenes = load_run(ROOT / "pretrained" / f"{name}.pt")
    assert own_scenes == [scenes.load(name)]
    _, traces = evaluate(Policy(net, "mean", 0), own_scenes, 1)
    assert len(traces) == len(own_scenes[0].targets) and all(trace.arrived for trace in traces)


class Constant:
    """A driver of one's own."""

    label = "half speed ahead"

    def reset(self, env, robots):
        self.goals = env.goals[robots]

    def act(self, env, observations):
        return np.tile((0.5, 0.0), (env.num_envs, 1))


def test_a_driver_of_ones_own_is_evaluated_like_the_others():
    trace = rollouts(Constant(), assign(TRAINING_ONLY, 0, 1))[0]
    assert trace.arrived and (trace.commands == MAX_COMMAND * (0.5, 0)).all()
    assert trace.metres == pytest.approx(0.84)  # 0.823 m to the goal's circle, 0.06 m a step


# -------------------------------------------------------------------------------- the command line


@pytest.fixture(scope="module")
def saved(tmp_path_factory):
    """A run folder with untrained weights."""
    folder = tmp_path_factory.mktemp("runs") / "env1-seed0"
    folder.mkdir()
    save_model(folder / "model.pt", make_network(0), [ENV1])
    return folder


def bad_call(capsys, arguments):
    """The one line that a bad command line prints."""
    with pytest.raises(SystemExit) as stop:
        main(arguments)
    printed = capsys.readouterr()
    assert stop.value.code == 2 and printed.out == "" and printed.err.count("\n") == 1
    return printed.err


@pytest.mark.parametrize("arguments, words", [
    (["--planner", "oracle", "--episodes", "0"], "--episodes is 0, it must be a whole number"),
    (["--planner", "teleport"], "'teleport'"), (["--planner", "oracle", "--env", "env9"], "env9"),
    ([], "run"), (["runs/x", "--planner", "bug"], "either"),
    (["--planner", "bug", "--protocol", "mine"], "'mine'"),
    (["--planner", "bug", "--protocol", "paper"], "'start', 'perturbed', 'anywhere', 'validation'"),
    (["--planner", "bug", "--hide", "cube"], "--hide is cube, it must be left out"),
    (["--planner", "bug", "--env", "tiny.toml", "--protocol", "validation"], "no room for")])
def test_bad_input_is_one_line_and_leaves_no_folder(arguments, words, capsys, tmp_path,
                                                    monkeypatch):
    monkeypatch.chdir(tmp_path)
    walls = [dict(material="wall", x=x, y=y, yaw_degrees=angle, length=1.2, thickness=0.1,
                  height=2.5) for x, y, angle in ((0.55, 0, 90), (-0.55, 0, 90), (0, 0.55, 0),
                                                  (0, -0.55, 0))]
    boxes = ", ".join("{" + ", ".join(f"{key} = {json.dumps(value)}" for key, value in box.items())
                      + "}" for box in walls)
    Path("tiny.toml").write_text("start = {x = 0, y = 0, heading_degrees = 0}\n"
                                 "training_targets = [[0.3, 0.0]]\nnew_targets = [[0.0, 0.3]]\n"
                                 f"boxes = [{boxes}]\n")
    assert words in bad_call(capsys, arguments)
    assert [path.name for path in tmp_path.iterdir()] == ["tiny.toml"]


class Code:
    """What unpickles to a call."""
    def __reduce__(self):
        return Path.touch, (Path("executed"),)


def spoilt(tmp_path, good, how):
    """A run that cannot be used."""
    contents = torch.load(good, weights_only=True)
    bad = tmp_path / "bad.pt"
    if how == "missing":
        return tmp_path / "none"
    if how == "empty folder":
        return tmp_path
    if how == "empty":
        bad.touch()
    elif how == "half-written":
        bad.write_bytes(good.read_bytes()[:100_000])
    elif how == "another size":
        contents["weights"]["value.weight"] = torch.zeros(1, 7)
        torch.save(contents, bad)
    elif how == "another kind":
        torch.save([1, 2], bad)
    elif how == "a room that is not closed":
        contents["scenes"][0]["boxes"] = contents["scenes"][0]["boxes"][1:]
        torch.save(contents, bad)
    else:
        bad.write_bytes(pickle.dumps(Code()))
    return bad


@pytest.mark.parametrize("how", ["missing", "empty folder", "empty", "half-written", "another size",
                                 "another kind", "a room that is not closed", "code"])
def test_a_run_that_cannot_be_used_is_one_line_and_nothing_is_executed(
        how, saved, capsys, tmp_path, monkeypatch):
    run = spoilt(tmp_path, saved / "model.pt", how)
    monkeypatch.chdir(tmp_path)
    before = sorted(tmp_path.iterdir())
    bad_call(capsys, [str(run)])
    assert sorted(tmp_path.iterdir()) == before


def test_an_evaluation_prints_and_writes_the_same_and_its_pictures(saved, tmp_path, monkeypatch,
                                                                   capsys):
    monkeypatch.chdir(tmp_path)
    shutil.copytree(saved, "run")
    main(["run", "--episodes", "6", "--json"])
    written = json.loads(Path("run/evaluation.json").read_text())
    assert json.loads(capsys.readouterr().out) == written
    assert list(written) == ["protocol", "actions", "hidden", "training", "new", "targets"]
    main(["run", "--episodes", "6", "--protocol", "anywhere", "--env", "env2"])
    printed = capsys.readouterr().out
    assert "env2, protocol anywhere" in printed and "any free target" in printed
    main(["run", "--episodes", "6", "--hide", "cube"])
    hidden = json.loads(Path("run/evaluation-hidden-cube.json").read_text())
    assert (written["hidden"], hidden["hidden"]) == ("", "cube")
    elsewhere = json.loads(Path("run/evaluation-env2-anywhere.json").read_text())
    assert (written["actions"], elsewhere["actions"]) == ("sampled", "mean")
    kinds = ("evaluation", "trajectories", "episode")
    suffixes = dict(zip(kinds, (".json", ".png", ".gif")))
    names = {f"{kind}{middle}{suffixes[kind]}" for kind in kinds
             for middle in ("", "-env2-anywhere", "-hidden-cube")}
    assert {path.name for path in Path("run").iterdir()} == names | {
        "model.pt", "floor-env2-anywhere.png"}
    assert all(path.stat().st_size > 250 for path in Path("run").iterdir())


def test_a_file_of_weights_and_a_planner_write_into_evaluations(saved, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    shutil.copy(saved / "model.pt", "mine.pt")
    main(["mine.pt", "--episodes", "1", "--env", "env2"])
    main(["--planner", "straight", "--episodes", "1", "--protocol", "perturbed"])
    found = {str(path) for path in Path("evaluations").rglob("*.json")}
    assert found == {str(Path("evaluations/mine-env2/evaluation.json")),
                     str(Path("evaluations/straight-env1/evaluation-perturbed.json"))}
    planned = json.loads(Path("evaluations/straight-env1/evaluation-perturbed.json").read_text())
    assert (planned["protocol"], planned["actions"]) == ("perturbed", "straight")


def test_a_run_of_several_scenes_is_examined_in_each(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    Path("run").mkdir()
    save_model("run/model.pt", make_network(0), [ENV1, ENV2])
    main(["run", "--episodes", "2"])
    assert "in env1, env2, protocol start" in capsys.readouterr().out
    assert {path.name for path in Path("run").iterdir()} == {
        "model.pt", "evaluation.json", "episode.gif", "trajectories-env1.png",
        "trajectories-env2.png"}


@pytest.mark.parametrize("targets, options, file", [
    ("both", [], "evaluation.json"),
    ("both", ["--protocol", "anywhere"], "evaluation-anywhere.json"),
    ("anywhere", [], "evaluation-anywhere.json"),
    ("anywhere", ["--protocol", "start"], "evaluation-start.json")])
def test_an_evaluation_is_by_the_task_of_the_run_and_leaves_trainings_own_at_level_3(
        targets, options, file, tmp_path):
    save_model(tmp_path / "model.pt", lively_network("none"), [ENV1])
    (tmp_path / "config.json").write_text(json.dumps({"targets": targets}))
    (tmp_path / "evaluation.json").write_text("training's own")
    main([str(tmp_path), "--episodes", "2", "--workers", "1", *options])
    protocol = file.removesuffix(".json").partition("-")[2] or "start"
    assert json.loads((tmp_path / file).read_text())["protocol"] == protocol
    kept = (tmp_path / "evaluation.json").read_text() == "training's own"
    assert kept == (file != "evaluation.json")
