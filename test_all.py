"""Quick tests of the lesson, about 30 seconds on a CPU. Some compare the code with a second, slow
and simple implementation; the others check properties or single examples. `make test` also runs the
tests of the other folders."""

import ast
import copy
import csv
import json
import math
import pickle
import re
import subprocess
import sys
import types
import warnings
from dataclasses import replace
from pathlib import Path

import gymnasium as gym
import numpy as np
import pytest
import torch
from gymnasium.utils.env_checker import check_env
from gymnasium.vector import AutoresetMode, VectorEnv

import model
import navbot_min
import ppo
import render
import scenes
import sim
import train
from scenes.test_scenes import box, square_room

ROOT = Path(__file__).parent
ENV1 = scenes.load("env1")
ENV2 = scenes.load("env2")
ONE_TARGET = scenes.parse(square_room(new_targets=[]), "room")
LESSON = ("navbot_min.py", "sim.py", "render.py", "model.py", "ppo.py", "train.py")


# ---------------------------------------------------------------------------------------- the world


@pytest.mark.parametrize("v, w", [(0.3, 0.0), (0.3, 1.0), (0.1, -0.4), (0.0, 1.0)])
def test_constant_velocities_drive_a_circular_arc(v, w):
    world = sim.World([scenes.parse(square_room(4.0), "room")])
    world.place([0], [(0.5, -0.2, 2.0)])
    for _ in range(25):
        assert not world.drive([(v, w)]).any()
    angle = 2.0 + 10 * w
    step = 10 * v * np.array([math.cos(2.0), math.sin(2.0)]) if w == 0 else (
        v / w * np.array([math.sin(angle) - math.sin(2.0), math.cos(2.0) - math.cos(angle)]))
    assert np.allclose(world.poses[0, :2], np.array([0.5, -0.2]) + step, atol=1e-3)
    assert abs(sim.wrap_angle(world.poses[0, 2] - angle)) < 1e-6


@pytest.mark.parametrize("scene", [ENV1, ENV2])
def test_the_mirrored_room_has_mirrored_walls_start_and_targets_but_no_new_targets(scene):
    mirror = scene.mirrored()
    places = np.random.default_rng(4).uniform(*scene.bounds, (5000, 2))
    assert np.allclose(mirror.clearance(places * (-1, 1)), scene.clearance(places))
    assert np.allclose(mirror.training_targets, np.multiply(scene.training_targets, (-1, 1)))
    assert not mirror.new_targets
    x, y, heading = scene.start
    assert mirror.start[:2] == (-x, y)
    assert np.exp(1j * mirror.start[2]) == pytest.approx(-np.exp(-1j * heading))


# --------------------------------------------------------------------------------------- the camera


def photograph(scene, poses, target):
    """Returns camera images of one room from several poses."""
    return render.Camera([scene]).render(np.zeros(len(poses), int), np.array(poses),
                                         np.tile(target, (len(poses), 1)))


def slow_image(scene, pose, target):
    """Returns a camera image by intersecting the ray of each pixel with every face in 3-D."""
    cube = sim.Box("cube", *target, yaw=0.0, length=0.2, thickness=0.2, height=0.2)
    c, s = math.cos(pose[2]), math.sin(pose[2])
    eye = np.array([pose[0] - 0.118 * c, pose[1] - 0.118 * s])
    i, j = np.mgrid[:48, :64]
    left, down = (31.5 - j) / render.FOCAL, (i - 23.5) / render.FOCAL
    x, y = c - s * left, s + c * left  # rays, per metre of depth
    image = np.where(down[..., None] > 0, render.FLOOR, render.SKY).astype(float)
    nearest = np.where(down > 0, 0.281 / np.abs(down), np.inf).clip(max=render.FAR)
    for b in (*scene.boxes, cube):
        for p, q in zip(b.corners, np.roll(b.corners, -1, axis=0)):
            length = np.hypot(*(q - p))
            along = (q - p) / length
            facing = x * along[1] - y * along[0]  # component of the ray along the outward normal
            z = ((p - eye) @ (along[1], -along[0])) / np.where(facing == 0, 1e-9, facing)
            u = (eye[0] + z * x - p[0]) * along[0] + (eye[1] + z * y - p[1]) * along[1]
            height = 0.281 - z * down
            hit = ((facing < 0) & (0 < z) & (z < nearest) & (0 <= u) & (u <= length)
                   & (0 <= height) & (height < b.height))
            bright = render.light((along[1], -along[0], 0))
            if b is cube:
                image[hit] = np.multiply(render.BLUE, bright)
            else:
                texel = (u[hit] // 0.025).astype(int) % 48, (height[hit] // 0.025).astype(int)
                image[hit] = render.texture(b.material, render.ABOVE)[texel] * bright.round(1)
            nearest = np.where(hit, z, nearest)
    z = (0.281 - 0.2) / np.where(down > 0, down, 1e-9)  # the top of the cube
    top = (z < nearest) & (np.abs(eye[0] + z * x - target[0]) < 0.1) & (
        np.abs(eye[1] + z * y - target[1]) < 0.1)
    image[top] = np.multiply(render.BLUE, render.light((0, 0, 1)))
    return image.clip(0, 255).round()


def test_images_equal_those_of_a_slow_raycaster():
    rng, checked = np.random.default_rng(3), []
    low = box(material="wood", x=1.0, y=0.3, yaw_degrees=23, length=0.4, thickness=0.3, height=0.5)
    middle = box(material="brick", x=1.6, y=-0.2, yaw_degrees=-29, length=0.8, thickness=0.2,
                 height=1.1)
    tall = box(x=1.9, y=1.0, yaw_degrees=11, length=0.3, thickness=0.3, height=1.6)
    room = scenes.parse(square_room(3.0, extra=[low, middle, tall], new_targets=[[-1.0, 1.0]],
                                       training_targets=[[-1.0, 0.0]]), "room")
    cases = [(room, (0.0, 0.0, 0.1), (1.9, 0.4)), (room, (0.1, -0.1, 0.2), (0.6, 0.1))]
    for scene in (ENV1, ENV2):
        free = scene.reachable
        for _ in range(10):
            pose = (*free[rng.integers(len(free))], rng.uniform(-np.pi, np.pi))
            cases.append((scene, pose, scene.targets[0]))
    for scene, pose, target in cases:
        with np.errstate(all="raise"):
            fast = photograph(scene, [pose], target)
        off = np.abs(fast[0].astype(float) - slow_image(scene, pose, target)).max(-1) > 1
        checked.append(off.mean())
    assert max(checked) <= 0.005 and np.mean(checked) <= 0.001, checked  # they differ only at edges


def test_images_of_a_wider_camera_are_correct_too(monkeypatch):
    source = (ROOT / "render.py").read_text().replace("np.radians(60)", "np.radians(100)")
    wide = types.ModuleType("wide")
    monkeypatch.setitem(sys.modules, "wide", wide)
    exec(compile(source, "wide", "exec"), wide.__dict__)
    monkeypatch.setitem(globals(), "render", wide)
    assert wide.FOCAL < 27
    hall = scenes.parse(square_room(4.0), "hall")
    for pose in ((-3.5, 0.3, 0.1), (0.0, 3.0, -1.6)):  # up to 8 m of floor
        fast = photograph(hall, [pose], (1.0, 0.0))[0].astype(float)
        assert (np.abs(fast - slow_image(hall, pose, (1.0, 0.0))).max(-1) > 1).mean() < 0.005


def test_a_brick_box_slightly_higher_than_the_camera_is_red_without_a_line_of_sky():
    low = box(material="brick", x=0.5, length=0.2, thickness=3.9, height=0.282)
    scene = scenes.parse(square_room(extra=[low], training_targets=[[-1.0, 0.0]]), "room")
    row = photograph(scene, np.zeros((1, 3)), (-1.0, 0.0))[0, 24]  # first row below the horizon
    assert (row != render.SKY).any(-1).all() and (row != render.FLOOR).any(-1).all()
    red, green, blue = row.mean(0)
    assert red > 1.5 * green and red > 1.5 * blue


def test_images_have_no_gap_at_a_corner_and_no_numerical_warning():
    pillar = sim.Box("wall", x=0.0, y=0.0, yaw=0.7, length=0.2, thickness=0.2, height=2.5)
    scene = sim.Scene("a box in the open", (pillar,), (0, 0, 0), (), ())
    angle = np.linspace(-np.pi, np.pi, 2000)
    poses = np.c_[-1.1 * np.cos(angle), -1.1 * np.sin(angle), angle]  # all around it, facing it
    with np.errstate(all="raise"):
        horizon = photograph(scene, poses, (9.0, 9.0))[:, 23]
        rng, free = np.random.default_rng(5), ENV1.reachable
        anywhere = np.c_[free[rng.integers(len(free), size=500)], rng.uniform(-np.pi, np.pi, 500)]
        anywhere[:8, 2] = np.arange(8) * np.pi / 4
        inside = photograph(ENV1, anywhere, ENV1.targets[0])[:, 23]
    wall = (horizon != render.SKY).any(-1)
    assert (np.abs(np.diff(wall, axis=1)).sum(1) == 2).all()  # one connected wall in each image
    assert (inside != render.SKY).any(-1).all()  # only walls in env1


# ----------------------------------------------------------------------------------------- the task


@pytest.mark.parametrize("before, after, arrived, hit, reward", [
    (2.0, 1.9, False, False, 100 * 0.1 - 0.05), (1.0, 1.0, False, False, -0.05),
    (1.0, 1.1, False, False, -10.05), (0.2, 0.1, True, False, 100), (1.0, 1.0, False, True, -50),
    (0.2, 0.1, True, True, 100)])
def test_rewards_follow_eq_4(before, after, arrived, hit, reward):
    assert navbot_min.rewards(before, after, arrived, hit) == pytest.approx(reward)


def test_a_custom_reward_and_clipped_commands_appear_in_observations_and_returns():
    class Constant(navbot_min.NavVecEnv):
        def reward(self, before, after, arrived, failed):
            return np.full(len(before), 7.0)
    env = Constant(2, max_episode_steps=3)
    env.reset(seed=0)
    for length in (1, 2, 3):
        seen, reward, _, _, infos = env.step(np.full((2, 2), 5.0))
        assert (reward == 7).all() and (seen["last_reward"] == (7 if length < 3 else 0)).all()
    assert (infos["final_info"]["return"] == 21).all()
    assert (infos["final_obs"]["last_reward"] == 7).all()
    assert np.allclose(infos["final_obs"]["velocity"], (0.3, 1.0))  # m/s, rad/s


def test_arrival_takes_precedence_over_a_collision_in_the_same_step():
    scene = scenes.parse(square_room(training_targets=[[1.95, 0.0]]), "room")
    env = navbot_min.NavEnv([scene], targets="training")
    env.reset()
    env.vector.world.place([0], [(1.75, 0.0, 0.0)])  # 0.20 m from the target, 0.25 m from the wall
    hits = env.vector.world.drive([(0.3, 0.0)])
    env.vector.world.place([0], [(1.75, 0.0, 0.0)])
    _, reward, terminated, truncated, info = env.step([1.0, 0.0])
    assert hits[0] and (reward, terminated, truncated) == (100.0, True, False)
    assert info["outcome"] == navbot_min.ARRIVAL


@pytest.mark.parametrize("angle", [np.pi, -np.pi, np.nextafter(np.pi, 4), 1e6, -1e6])
def test_a_wrapped_angle_is_equivalent_and_in_the_range_from_minus_pi_to_pi(angle):
    wrapped = sim.wrap_angle(angle)
    assert -np.pi < wrapped <= np.pi
    assert np.exp(1j * wrapped) == pytest.approx(np.exp(1j * angle), abs=1e-9)


@pytest.mark.parametrize("name, targets", [("env1", "memorize"), ("env2", "both"),
                                           ("env1", "anywhere")])
def test_gymnasium_accepts_the_environment_without_a_warning(name, targets):
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        env = gym.make(f"navbot_min:NavBot-{name}-v1", render_mode="rgb_array", targets=targets)
        check_env(env.unwrapped, skip_render_check=True)  # otherwise it opens a window
        many = gym.make_vec(f"navbot_min:NavBot-{name}-v1", num_envs=3, targets=targets,
                            vectorization_mode="vector_entry_point")
    observations, _ = many.reset(seed=0)
    assert many.observation_space.contains(observations)
    assert many.observation_space.contains(many.step(np.ones((3, 2), np.float32))[0])


@pytest.mark.parametrize("changes, words", [
    ({"scenes": "env1"}, "scenes is 'env1'; it must be a list of 1 to 32 rooms"),
    ({"scenes": ["env1", "env2"], "num_envs": 1}, "it must be a list of 1 to 1 rooms"),
    ({"num_envs": 0}, "num_envs is 0; it must be at least 1"),
    ({"max_episode_steps": 0}, "max_episode_steps is 0; it must be at least 1, or -1"),
    ({"random_starts": 1.5}, "random_starts is 1.5; it must be from 0 to 1"),
    ({"targets": "old"}, "targets is 'old'; it must be one of training, new, both"),
    ({"targets": "new", "scenes": [ONE_TARGET]}, "targets is 'new', but scene 'room' has none"),
    ({"targets": [0]}, "for robot 1 it must hold an index from 0 to 2"),
    ({"targets": [-1] * 32}, "for robot 0 it must hold an index from 0 to 2")])
def test_bad_arguments_give_one_sentence(changes, words):
    with pytest.raises(ValueError, match=re.escape(words)):
        navbot_min.NavVecEnv(**changes)


def test_pictures_show_every_step_of_an_episode_and_so_does_a_window(monkeypatch):
    shown = []

    screen = types.SimpleNamespace(show=lambda frame, fps: shown.append(frame))
    monkeypatch.setattr("support.film.Window", lambda: screen)
    picture, window = [navbot_min.NavEnv(targets=[0], render_mode=mode)
                       for mode in ("rgb_array", "human")]
    for _ in range(2):  # the second episode starts a new trail
        shown.clear()
        for env in (picture, window):
            env.reset(seed=0)
        frames = [picture.render()]
        over = False
        while not over:
            _, _, over, _, info = picture.step([1.0, 0.0])
            frames.append(picture.render())
            window.step([1.0, 0.0])
        assert len(frames) == info["length"] + 1 == len(shown)
        assert all((one == other).all() for one, other in zip(frames, shown))
        assert all((one != other).any() for one, other in zip(frames, frames[1:]))  # it moves


def test_the_vector_environment_equals_many_single_ones():
    actions = np.random.default_rng(2).uniform((0.3, -1), (1, 1), (150, 4, 2))
    targets = [0, 1, 2, 0]
    many = navbot_min.NavVecEnv(4, targets=targets)
    single = [navbot_min.NavEnv(targets=[k], max_episode_steps=200) for k in targets]
    seen, _ = many.reset(seed=0)
    alone = [env.reset(seed=0)[0] for env in single]
    ended = 0
    for action in actions:
        assert all((seen[key][r] == alone[r][key]).all() for r in range(4) for key in seen)
        seen, rewards, terminated, truncated, infos = many.step(action)
        for r, env in enumerate(single):
            alone[r], reward, term, trunc, info = env.step(action[r])
            assert (reward, term, trunc) == (rewards[r], terminated[r], truncated[r])
            assert (info["pose"] == infos["pose"][r]).all()
            if not (term or trunc):
                continue
            ended += 1
            last = {key: value[r] for key, value in infos["final_obs"].items()}
            assert all((last[key] == alone[r][key]).all() for key in last)
            for key in ("outcome", "return", "length", "target_index", "new", "scene"):
                assert infos["final_info"][key][r] == info[key]
            alone[r], _ = env.reset()
            assert not alone[r]["velocity"].any() and not alone[r]["last_reward"].any()
    assert ended > 8


@pytest.mark.parametrize("targets, indices", [
    ("training", {0, 1}), ("new", {2}), ("both", {0, 1, 2})])
def test_episodes_draw_their_targets_from_the_chosen_set(targets, indices):
    env = navbot_min.NavVecEnv(64, targets=targets)
    env.reset(seed=0)
    assert set(map(tuple, env.goals)) == {tuple(ENV1.targets[k]) for k in indices}


def sampled(scene, targets, count=4000):
    """Returns goals (count, 2) and start poses (count, 3) of episodes in a scene."""
    env = navbot_min.NavVecEnv(1, [scene], targets)
    env.reset(seed=0)
    _, goals, starts = zip(*(env.sample_episode(0) for _ in range(count)))
    return np.array(goals), np.array(starts)


def test_level_1_perturbs_the_start_poses_and_the_first_target():
    others = ((-2.0, -3.2, 1.0), (-2.7, -2.8, 3.0))
    goals, starts = sampled(replace(ENV1, other_starts=others), "memorize")
    spread = np.array([0.05, 0.05, math.radians(10)])
    assert (goals - ENV1.targets[0]).std(0) == pytest.approx(spread[:2], rel=0.1)
    assert goals.mean(0) == pytest.approx(ENV1.targets[0], abs=0.005)
    near = np.abs(starts[:, None, :2] - np.array([ENV1.start, *others])[:, :2]).sum(-1).argmin(1)
    assert np.bincount(near).min() > 1200
    for k, pose in enumerate([ENV1.start, *others]):
        moved = starts[near == k] - pose
        assert moved.std(0) == pytest.approx(spread, rel=0.15)
        assert moved.mean(0) == pytest.approx(0, abs=0.015)


def test_level_1_keeps_starts_free_and_targets_in_front_of_thin_walls():
    tight = scenes.parse(square_room(0.25, thickness=0.001, training_targets=[[0.2, 0.0]],
                                     new_targets=[]), "room")
    goals, starts = sampled(tight, "memorize")
    assert sim.ROBOT_RADIUS < tight.clearance(starts[:, :2]).min() < sim.ROBOT_RADIUS + 0.001
    assert 0.05 < tight.clearance(goals).min() < 0.051 and np.abs(goals).max() < 0.25


@pytest.mark.parametrize("scene", [ENV1, scenes.load("random:3")])
def test_level_3_draws_random_starts_headings_and_targets(scene):
    goals, starts = sampled(scene, "anywhere", 2000)
    assert 1 <= np.hypot(*(starts[:, :2] - goals).T).min() < 1.02
    reachable = set(map(tuple, scene.reachable))
    for places in (goals, starts[:, :2]):
        assert set(map(tuple, places)) <= reachable
        apart = scene.reachable[::5, None] - places
        assert np.hypot(apart[..., 0], apart[..., 1]).min(1).max() < 0.3  # [m] from any place
    counts, _ = np.histogram(starts[:, 2], 8, (-np.pi, np.pi))
    assert counts.sum() == 2000 and (np.abs(counts - 250) < 70).all()  # 4.7 standard deviations


def test_reset_starts_the_requested_episode():
    env = navbot_min.NavEnv()
    pose = (-3.0, -2.9, 0.5)
    observation, info = env.reset(seed=0, options={"target": 1, "start": pose})
    assert info["pose"] == pytest.approx(pose)
    expected = navbot_min.polar_targets(np.array([pose]), ENV1.targets[1:2])[0]
    assert observation["target"] == pytest.approx(expected, abs=1e-5)
    assert env.step([0.0, 0.0])[4]["target_index"] == 1
    many = navbot_min.NavVecEnv(3)
    many.reset(seed=0, options={"goal": (-1.0, -2.9)})
    assert (many.goals == (-1.0, -2.9)).all()
    _, infos = many.reset(seed=0, options={"target": [2, 0, 1]})
    assert (many.goals == ENV1.targets[[2, 0, 1]]).all()
    assert np.allclose(infos["pose"][:, :2], ENV1.start[:2])


@pytest.mark.parametrize("options, words", [
    ({"targets": 1}, "options has an unknown key 'targets'; known: target, goal, start"),
    ({"goal": (-9.0, 0.0)}, "options['goal'] is (-9.0, 0.0); it must be a place (x, y) that"),
    ({"target": 3}, "options['target'] is 3; it must be an index into the targets of env1"),
    ({"target": True}, "options['target'] is True"),
    ({"start": (-2.0, np.nan, 0)}, "it must be a pose (x, y, theta), 0.178 m or more from"),
    ({"start": (-4.4, -3.0, 0)}, "from all boxes, inside env1")])
def test_bad_reset_options_are_refused_and_change_nothing(options, words):
    env, twin = navbot_min.NavVecEnv(2), navbot_min.NavVecEnv(2)
    for one in (env, twin):
        one.reset(seed=0)
    with pytest.raises(ValueError, match=re.escape(words)):
        env.reset(options=options)
    assert (env.world.poses == twin.world.poses).all() and (env.goals == twin.goals).all()
    assert env.np_random.random() == twin.np_random.random()


@pytest.mark.parametrize("duplicate", [copy.deepcopy, lambda env: pickle.loads(pickle.dumps(env))])
def test_a_copy_continues_like_the_original(duplicate):
    actions = np.random.default_rng(3).uniform((0.5, -1), (1, 1), (60, 8, 2))
    env = navbot_min.NavVecEnv(8, [ENV1, ENV2], random_starts=0.5)
    env.reset(seed=0)
    for action in actions[:20]:
        env.step(action)
    twin, ended = duplicate(env), 0
    for action in actions[20:]:
        seen, rewards, terminated, _, infos = env.step(action)
        others, other_rewards, _, _, other_infos = twin.step(action)
        ended += terminated.sum()
        assert all((seen[key] == others[key]).all() for key in seen)
        assert (rewards == other_rewards).all()
        assert (infos["pose"] == other_infos["pose"]).all()
    assert ended > 4


@pytest.mark.parametrize("arguments, limit", [({}, 200), ({"max_episode_steps": 210}, 210)])
def test_the_step_limit_is_the_requested_one(arguments, limit):
    name = "navbot_min:NavBot-env1-v1"
    many = gym.make_vec(name, num_envs=1, vectorization_mode="vector_entry_point", **arguments)
    for env, outcome in ((gym.make(name, **arguments), navbot_min.UNDER_WAY),
                         (many, navbot_min.TIMEOUT)):
        env.reset(seed=0)
        for length in range(1, limit + 1):
            _, _, _, truncated, info = env.step(np.zeros(env.action_space.shape))
            assert np.all(truncated) == (length == limit)
        assert info.get("final_info", info)["outcome"] == outcome


@pytest.mark.parametrize("actions, words", [
    (np.zeros((3, 2)), "finite numbers of shape (2, 2)"), (np.zeros(2), "of shape (2, 2)"),
    ([[0, 0], [np.nan, 0]], "they are [[ 0.  0.]")])
def test_bad_actions_are_refused(actions, words):
    env = navbot_min.NavVecEnv(2)
    with pytest.raises(gym.error.ResetNeeded, match="before reset"):
        env.step(np.zeros((2, 2)))
    env.reset(seed=0)
    with pytest.raises(ValueError, match=re.escape(words)):
        env.step(actions)


# -------------------------------------------------------------------------------------- the network


def random_observations(M, T, seed=0):
    rng = np.random.default_rng(seed)
    return {"image": torch.as_tensor(rng.integers(0, 256, (M, T, 48, 64, 3), dtype=np.uint8)),
            "target": torch.as_tensor(rng.normal(size=(M, T, 2)), dtype=torch.float32),
            "velocity": torch.as_tensor(rng.normal(size=(M, T, 2)), dtype=torch.float32),
            "last_reward": torch.as_tensor(rng.normal(size=(M, T, 1)), dtype=torch.float32)}


def random_episodes(lengths, seed=0):
    """Returns episodes of these lengths, as if collected with other weights."""
    rng, episodes = np.random.default_rng(seed), []
    for k, T in enumerate(lengths):
        numbers = rng.normal(size=(T, 5)).astype(np.float32)
        observations = {key: value[0].numpy()
                        for key, value in random_observations(1, T, seed + k).items()}
        episodes.append(ppo.Episode(observations, numbers[:, :2], numbers[:, 2] - 2, numbers[:, 3],
                                    numbers[:, 4], last_value=0.0))
    return episodes


def network(memory="stacked", without=""):
    return model.make_network(0, memory, without)


def test_weights_depend_only_on_the_seed_and_training_does_not_use_torchs_global_generator():
    before = torch.get_rng_state()
    first, second, other = (model.make_network(seed).value_head.weight for seed in (1, 1, 2))
    assert torch.equal(first, second) and not torch.equal(first, other)
    train_on(train.Config(steps=800, robots=8, episodes_per_update=8, random_starts=1.0))
    assert torch.equal(torch.get_rng_state(), before)


def test_the_network_has_the_papers_shapes():
    net, shapes = network(), []
    for layer in net.cnn:
        if isinstance(layer, (torch.nn.Conv2d, torch.nn.MaxPool2d)):
            layer.register_forward_hook(lambda _, __, y: shapes.append(tuple(y.shape[1:])))
    net.see(torch.zeros(1, 48, 64, 3, dtype=torch.uint8))
    assert shapes == [(32, 12, 16), (64, 6, 8), (64, 3, 4), (64, 2, 2)]  # channels, height, width
    counted = sum(p.numel() for name, p in net.named_parameters() if name != "log_std")
    assert counted == 948_931 and net.log_std.numel() == 2


@pytest.mark.parametrize("memory", model.MEMORIES)
def test_a_whole_sequence_equals_the_same_steps_one_by_one(memory):
    net, seen = network(memory), random_observations(3, 7)
    whole, values, last = net(seen, net.initial_state(3))
    state = net.initial_state(3)
    for t in range(7):
        step, value, state = net({key: x[:, t:t + 1] for key, x in seen.items()}, state)
        assert torch.allclose(step.mean, whole.mean[:, t:t + 1], atol=1e-5)
        assert torch.allclose(value, values[:, t:t + 1], atol=1e-5)
    assert torch.allclose(state, last, atol=1e-5)


@pytest.mark.parametrize("without, inputs", [
    ("image", ["image"]), ("target", ["target"]), ("last", ["velocity", "last_reward"])])
def test_a_blanked_input_has_no_effect(without, inputs):
    for blanked, same in ((without, True), ("", False)):
        net, seen = network(without=blanked), random_observations(2, 3)
        values = net(seen, net.initial_state(2))[1]
        seen |= {key: 1 + seen[key] * 3 for key in inputs}
        assert torch.equal(net(seen, net.initial_state(2))[1], values) is same


# -------------------------------------------------------------------------------------- the learner


@pytest.mark.parametrize("last_value", [0.0, 0.7])  # terminated, truncated
def test_advantages_equal_the_double_sum_of_their_definition(last_value):
    rng, gamma, lam = np.random.default_rng(0), 0.9, 0.8
    r, V = rng.normal(size=6), np.append(rng.normal(size=6), last_value)
    expected = [sum((gamma * lam) ** (k - t) * (r[k] + gamma * V[k + 1] - V[k])
                    for k in range(t, 6)) for t in range(6)]
    assert np.allclose(ppo.advantages(r, V[:-1], last_value, gamma, lam), expected)


def slow_losses(net, episodes, A, eps):
    """Returns policy and value loss, computed one step of one episode at a time."""
    policy, value, steps = 0.0, 0.0, sum(len(e) for e in episodes)
    for e, a in zip(episodes, A):
        state = net.initial_state(1)
        for t in range(len(e)):
            one = {key: torch.tensor(x[t])[None, None] for key, x in e.observations.items()}
            distribution, V, state = net(one, state)
            action = torch.tensor(e.actions[t])
            r = (distribution.log_prob(action).sum() - e.log_probs[t]).exp()
            policy = policy - min(r * a[t], r.clamp(1 - eps, 1 + eps) * a[t]) / steps
            value = value + (V[0, 0] - (a[t] + e.values[t])) ** 2 / steps
    return policy, value


def test_padding_does_not_change_losses_and_gradients_which_reach_cnn_and_memory():
    net, episodes = network(), random_episodes([3, 9, 5, 1, 4])
    A = [torch.randn(len(e)).numpy() for e in episodes]
    batch = ppo.make_minibatch(episodes, A)
    assert batch["mask"].shape == (5, 9) and batch["mask"].sum() == 22
    for k in (0, 1):  # policy loss, value loss
        results = []
        for losses in (ppo.losses(net, batch, 0.2), slow_losses(net, episodes, A, 0.2)):
            net.zero_grad()
            losses[k].backward()
            for parameter in (net.cnn[0].weight, *net.memories.parameters()):
                assert parameter.grad.abs().sum() > 0
            gradients = [p.grad for p in net.parameters() if p.grad is not None]
            results.append((losses[k].item(), torch.cat([g.flatten().clone() for g in gradients])))
        (loss, gradient), (expected, slow_gradient) = results
        assert loss == pytest.approx(expected, rel=1e-5)
        assert (gradient - slow_gradient).norm() < 1e-5 * slow_gradient.norm()


def test_the_clipped_loss_follows_eq_3():
    net, episodes = network(), random_episodes([4])
    A = np.float32([1.0, -1.0, 2.0, -0.5])
    seen = {key: torch.tensor(value[None]) for key, value in episodes[0].observations.items()}
    distribution = net(seen, net.initial_state(1))[0]
    log_probs = distribution.log_prob(torch.tensor(episodes[0].actions)).sum(-1)[0].detach()
    log_ratios = torch.tensor([0.5, 0.5, -0.5, 0.05])
    episodes[0].log_probs = (log_probs - log_ratios).numpy()
    expected = -np.mean([1.2 * 1, math.exp(0.5) * -1, math.exp(-0.5) * 2, math.exp(0.05) * -0.5])
    loss = ppo.losses(net, ppo.make_minibatch(episodes, [A]), 0.2)[0].item()
    assert loss == pytest.approx(expected, rel=1e-4)


def collect(collector, least):
    """Returns (Episode, info) pairs as soon as at least `least` episodes have ended."""
    ended = []
    while len(ended) < least:
        ended += collector.step()
    return ended


def test_the_first_minibatch_of_an_update_has_ratio_1_and_kl_0():
    net = network()
    torch.nn.init.orthogonal_(net.action_head.weight)  # so that the memory affects the actions
    collector = ppo.Collector(navbot_min.NavVecEnv(4, max_episode_steps=25), net, 0.01, 0, 0)
    episodes = [episode for episode, _ in collect(collector, 12)]
    batch = ppo.make_minibatch(episodes, [np.zeros(len(e), np.float32) for e in episodes])
    state = net.initial_state(len(batch["mask"]))
    distribution, values, _ = net(batch["observations"], state, batch["mask"])
    r = (distribution.log_prob(batch["actions"]).sum(-1) - batch["log_probs"]).exp()[batch["mask"]]
    assert (r - 1).abs().max() < 1e-4 and len({len(e) for e in episodes}) > 1
    statistics = dict(zip(ppo.STATISTICS, ppo.losses(net, batch, 0.2)[2]))
    assert abs(statistics["kl"]) < 1e-6
    expected = np.concatenate([episode.values for episode in episodes])
    assert np.allclose(values[batch["mask"]].detach(), expected, atol=1e-4)


def test_only_truncated_episodes_bootstrap_from_their_true_last_observation():
    net, last = network(), {}
    env = navbot_min.NavVecEnv(4, max_episode_steps=12)
    collector, step = ppo.Collector(env, net, 0.01, 0, 0), env.step

    def spy(actions):
        result = step(actions)
        for r in np.flatnonzero(result[2] | result[3]):
            info = result[4]
            final_obs = {key: value[r] for key, value in info["final_obs"].items()}
            last[info["final_info"]["return"][r].item()] = final_obs
        return result
    env.step = spy
    outcomes = set()
    for episode, info in collect(collector, 10):
        timeout = info["outcome"] == navbot_min.TIMEOUT
        outcomes.add(timeout)
        final = last[info["return"]]
        whole = {key: torch.tensor(np.concatenate([x, final[key][None]]))[None]
                 for key, x in episode.observations.items()}
        value = net(whole, net.initial_state(1))[1][0, -1].item()
        expected = value if timeout else 0.0
        assert episode.last_value == pytest.approx(expected, abs=1e-4)
        assert episode.rewards.sum() == pytest.approx(0.01 * info["return"], abs=1e-4)
    assert outcomes == {True, False}


class Cue(VectorEnv):
    """Shows a cue only at the first step. The second action, the last, is rewarded by its sign."""
    metadata = {"autoreset_mode": AutoresetMode.SAME_STEP}
    num_envs, max_episode_steps = 32, 2

    def reset(self, *, seed=None, options=None):
        super().reset(seed=seed)
        self.t = 0
        self.cue = self.np_random.choice([-1.0, 1.0], self.num_envs)
        return self.look(), {}

    def look(self):
        target = np.zeros((self.num_envs, 2), np.float32)
        target[:, 1] = 3 * self.cue * (self.t == 0)
        return {"image": np.zeros((self.num_envs, 48, 64, 3), np.uint8), "target": target,
                "velocity": np.zeros((self.num_envs, 2), np.float32),
                "last_reward": np.zeros((self.num_envs, 1), np.float32)}

    def step(self, actions):
        self.t += 1
        done = np.full(self.num_envs, self.t == 2)
        reward = self.cue * np.clip(actions[:, 1], -1, 1) * done
        infos = {"final_info": {"sign": np.sign(reward)}} if done[0] else {}
        observations = self.reset()[0] if done[0] else self.look()
        return observations, reward, done, np.zeros_like(done), infos


def test_the_lstm_learns_to_use_a_cue_from_the_step_before_and_no_memory_does_not():
    config, signs = train.Config(epochs=6, minibatches=1, lam=1.0), {}
    for memory in ("stacked", "none"):
        net, rng = network(memory), np.random.default_rng(0)
        optimizer = torch.optim.Adam(net.parameters(), 2e-3, eps=1e-5)
        collector = ppo.Collector(Cue(), net, 1.0, 0, 0)
        for _ in range(16):
            episodes = [episode for episode, _ in collect(collector, 32)]
            ppo.update(net, optimizer, episodes, config, rng)
        signs[memory] = np.mean([info["sign"] for _, info in collect(collector, 256)])
    assert signs["stacked"] > 0.8 and abs(signs["none"]) < 0.3, signs


# --------------------------------------------------------------------------------------- training


TINY = ["--steps", "600", "--robots", "8", "--episodes-per-update", "8",
        "--evaluation-episodes", "4"]


@pytest.fixture(scope="module")
def runs(tmp_path_factory):
    """The folder and outputs of two tiny runs with the same seed, started as a user starts them."""
    folder, outputs = tmp_path_factory.mktemp("runs"), []
    for _ in range(2):
        outputs.append(subprocess.run(
            [sys.executable, str(ROOT / "train.py"), "--env", "env1", *TINY, "--json"],
            cwd=folder, capture_output=True, text=True))
    return folder / "runs", outputs


def test_training_writes_a_complete_run_folder_and_overwrites_none(runs):
    folder, outputs = runs
    assert [done.returncode for done in outputs] == [0, 0], outputs[0].stderr
    assert sorted(run.name for run in folder.iterdir()) == ["env1-seed0", "env1-seed0-2"]
    for run, done in zip(sorted(folder.iterdir()), outputs):
        assert sorted(file.name for file in run.iterdir()) == [
            "checkpoint.pt", "config.json", "curves.png", "episodes.csv", "evaluation.json",
            "model.safetensors", "room.json", "summary.json", "updates.csv"]
        summary = json.loads((run / "summary.json").read_text())
        assert json.loads(done.stdout) == summary and str(run.name) in done.stderr
        assert list(summary) == ["env", "seed", "steps", "episodes", "seconds", "stopped_by_rule",
                                 "rolling_new_success", "frozen"]
        assert summary["frozen"] == json.loads((run / "evaluation.json").read_text())
        rows = list(csv.DictReader(open(run / "episodes.csv")))
        assert len(rows) == summary["episodes"] and summary["steps"] == 600
        assert int(rows[-1]["steps"]) <= 600
        assert {row["kind"] for row in rows} == {"training", "new"}


def test_the_same_seed_writes_the_same_episodes_and_weights_byte_for_byte(runs):
    first, second = sorted(runs[0].iterdir())
    for name in ("episodes.csv", "model.safetensors"):
        assert (first / name).read_bytes() == (second / name).read_bytes()


def train_on(config):
    """Returns a finished Training in env1. Its folder only keeps the rows of its tables."""
    training = train.Training(config, [ENV1])
    episodes = []
    updates = []
    tables = {"episodes.csv": types.SimpleNamespace(add=episodes.append),
              "updates.csv": types.SimpleNamespace(add=updates.append)}
    training.folder = types.SimpleNamespace(
        episodes=episodes, updates=updates, tables=tables, save_checkpoint=lambda state: None,
        offer_weights=lambda *_, **__: None)
    train.train(training)
    return training


def test_new_targets_never_reach_an_update(monkeypatch):
    distances = []

    def spy(model, optimizer, episodes, *_):
        distances.extend(episode.observations["target"][0, 0].item() for episode in episodes)
        return {}
    monkeypatch.setattr(train, "update", spy)
    training = train_on(train.Config(steps=1200, robots=8, episodes_per_update=8, random_starts=0))
    kinds = {row["kind"] for row in training.folder.episodes}
    assert kinds == {"training", "new"} and len(distances) >= 16
    away = [np.hypot(*np.subtract(t, ENV1.start[:2])) for t in ENV1.training_targets]
    assert all(min(abs(d - a) for a in away) < 1e-4 for d in distances)  # all from the same start


def test_random_starts_are_not_used_for_new_targets_and_exist_in_a_tiny_room():
    env = navbot_min.NavVecEnv(400, random_starts=0.7)
    poses = env.reset(seed=0)[1]["pose"]
    elsewhere = ~np.isclose(poses[:, :2], ENV1.start[:2]).all(1)
    new = (env.goals == ENV1.targets[2]).all(1)
    assert new.any() and not elsewhere[new].any() and 0.6 < elsewhere[~new].mean() < 0.8
    tiny = scenes.parse(square_room(0.5, training_targets=[[0.3, 0.0]], new_targets=[]), "tiny")
    env = navbot_min.NavVecEnv(4, [tiny], "training", random_starts=1.0)  # no place is 1 m away
    assert (env.reset(seed=0)[1]["pose"][:, 0] < 0).all()


def test_weights_stay_finite_with_equal_advantages_and_after_the_budget():
    net = network()
    optimizer = torch.optim.Adam(net.parameters())
    config = train.Config(epochs=1, minibatches=1)
    for episodes in (random_episodes([1], seed) * 3 for seed in range(20)):
        ppo.update(net, optimizer, episodes, config, np.random.default_rng(0))
    config = train.Config(steps=1, robots=200, episodes_per_update=4, random_starts=1.0)
    for weights in (net, train_on(config).model):
        assert all(torch.isfinite(p).all() for p in weights.parameters())


@pytest.mark.parametrize("fixed_budget", [False, True])
def test_the_rule_stops_at_once_unless_the_budget_is_fixed(fixed_budget, monkeypatch):
    monkeypatch.setattr(train, "WINDOW", 1)
    monkeypatch.setattr(train, "SUCCESS_RATE", -1)  # the first test episode meets the rule
    training = train_on(train.Config(steps=400, robots=8, fixed_budget=fixed_budget))
    *earlier, last = [row["kind"] for row in training.folder.episodes]
    if fixed_budget:
        assert "new" in earlier and training.steps == 400
    else:
        assert "new" not in earlier and last == "new"
        assert training.steps == training.folder.episodes[-1]["steps"]


def test_the_standard_deviation_stays_between_its_limits():
    net = network()
    limits = ((0.5, 2, 1), (0.25, 0.5, 0.5), (0.1, 0.8, 0.5), (0.6, 1, 0.6))
    for lowest, highest, expected in limits:
        net.limit_std(lowest, highest)
        assert torch.allclose(net.log_std.exp(), torch.tensor(model.INITIAL_STD) * expected)


@pytest.mark.parametrize("arrivals, failures, met", [
    (61, 139, True), (60, 40, False), (99, 0, False)])
def test_the_rule_needs_more_than_60_arrivals_in_100_test_episodes(arrivals, failures, met):
    training = train.Training(train.Config(), [ENV1])
    for outcome in ["collision"] * failures + ["arrival"] * arrivals:
        training.record({"kind": "new", "outcome": outcome})
        training.record({"kind": "training", "outcome": "arrival"})  # not counted
    assert training.stops_by_rule() is met


def test_learning_rate_and_standard_deviation_decay_with_the_budget(monkeypatch):
    limits = []
    monkeypatch.setattr(train, "update", lambda _, adam, *__: {"lr": adam.param_groups[0]["lr"]})
    monkeypatch.setattr(model.Network, "limit_std", lambda self, *both: limits.append(both))
    training = train_on(train.Config(steps=2000, fixed_budget=True, robots=16, minibatches=1,
                                     episodes_per_update=2))
    steps, rates = zip(*((row["steps"], row["lr"]) for row in training.folder.updates))
    highest = np.interp([*steps, 2000], [0, 1700, 2000], [1, 1, 0.1])
    assert np.allclose(limits, np.stack([highest / 2, highest], -1))
    assert min(steps) < 1700 and sum(1700 < s < 2000 for s in steps) >= 2
    assert rates == pytest.approx(1e-3 * (1 - np.array(steps) / 2000))


def test_the_demo_needs_no_torch_and_writes_its_picture(tmp_path):
    code = (f"import sys, runpy; sys.path.insert(0, r'{ROOT}'); sys.modules['torch'] = None; "
            "import navbot_min; assert 'matplotlib' not in sys.modules; "
            f"del sys.modules['navbot_min']; runpy.run_path(r'{ROOT}/navbot_min.py', "
            "run_name='__main__')")
    done = subprocess.run([sys.executable, "-W", "ignore", "-c", code], cwd=tmp_path,
                          capture_output=True, text=True)
    assert done.returncode == 0 and done.stdout.count("episode ") == 6, done.stderr
    assert (tmp_path / "demo.png").read_bytes().startswith(b"\x89PNG")


def test_the_lesson_is_short():
    sources = {name: (ROOT / name).read_text() for name in LESSON}
    assert sum(len(source.splitlines()) for source in sources.values()) < 1600
    for name, source in sources.items():
        for node in ast.walk(ast.parse(source)):
            if isinstance(node, ast.FunctionDef):
                assert node.end_lineno - node.lineno <= 40, (name, node.name)
        assert max(map(len, source.splitlines())) <= 100, name
