"""Each test is the shortest proof of one claim, against an oracle that is slow and obvious."""

import ast
import csv
import json
import math
import pickle
import re
import shutil
import subprocess
import sys
import warnings
from pathlib import Path

import gymnasium as gym
import networkx
import numpy as np
import pytest
import torch
from gymnasium.utils.env_checker import check_env
from gymnasium.vector import AutoresetMode, VectorEnv

import benchmark
import evaluate
import model
import navbot_min
import pictures
import planners
import ppo
import render
import results
import runs as run_folder
import sim
import train
from scene_file import load_scene, parse_scene

ROOT = Path(__file__).parent
ENV1, ENV2 = load_scene("env1"), load_scene("env2")
LESSON = ("navbot_min.py", "sim.py", "render.py", "model.py", "ppo.py", "train.py")


def square_room(half=2.0, thickness=0.1, extra=(), **changes):
    """A scene file's content: a square room around the origin, `half` metres to each inner wall."""
    side, place = 2 * half + 2 * thickness, half + thickness / 2
    walls = [box(x=place * math.cos(a), y=place * math.sin(a), yaw=a + math.pi / 2, length=side,
                 thickness=thickness) for a in np.arange(4) * math.pi / 2]
    return dict(boxes=walls + list(extra), start=[0.0, 0.0, 0.0], training_targets=[[1.0, 0.0]],
                new_targets=[[0.0, 1.0]]) | changes


def box(**changes):
    return dict(material="wall", x=1.0, y=0.0, yaw=0.0, length=0.2, thickness=0.2,
                height=2.5) | changes


# ---------------------------------------------------------------------------------------- the world


@pytest.mark.parametrize("v, w", [(0.3, 0.0), (0.3, 1.0), (0.1, -0.4), (0.0, 1.0)])
def test_constant_velocities_drive_the_closed_form_arc(v, w):
    world = sim.World([parse_scene(square_room(4.0), "room")])
    world.place([0], [(0.5, -0.2, 2.0)])
    for _ in range(25):
        assert not world.drive([(v, w)]).any()
    angle = 2.0 + 10 * w
    step = 10 * v * np.array([math.cos(2.0), math.sin(2.0)]) if w == 0 else (
        v / w * np.array([math.sin(angle) - math.sin(2.0), math.cos(2.0) - math.cos(angle)]))
    assert np.allclose(world.poses[0, :2], np.array([0.5, -0.2]) + step, atol=1e-3)
    assert abs(sim.wrap_angle(world.poses[0, 2] - angle)) < 1e-6


def test_a_robot_at_full_speed_never_crosses_the_thinnest_wall():
    thin = box(thickness=3.98, length=0.001, x=0.7)
    scene = parse_scene(square_room(extra=[thin], training_targets=[[-1.0, 0.0]]), "room")
    world, hits = sim.World([scene] * 64), 0
    world.place(slice(None), np.c_[np.zeros(64), np.linspace(-1, 1, 64), np.linspace(-1, 1, 64)])
    for _ in range(50):  # 20 s, never reset
        hits += world.drive(np.tile((0.3, 0.0), (64, 1))).sum()
        assert scene.clearance(world.poses[:, :2]).min() >= sim.ROBOT_RADIUS
    assert hits > 64 and world.poses[:, 0].max() < 0.7


def test_a_hit_is_reported_exactly_when_the_disc_would_overlap_a_box():
    rng = np.random.default_rng(0)
    free = ENV1.reachable
    world = sim.World([ENV1] * 200)
    poses = np.c_[free[rng.integers(len(free), size=200)], rng.uniform(-np.pi, np.pi, 200)]
    world.place(slice(None), poses)
    hit = world.drive(np.tile((0.3, 0.0), (200, 1)))
    ahead = np.stack([np.cos(poses[:, 2]), np.sin(poses[:, 2])], -1)
    expected = [min(ENV1.clearance(p + a * 0.03 * k) for k in (1, 2, 3, 4)) < sim.ROBOT_RADIUS
                for p, a in zip(poses[:, :2], ahead)]
    assert hit.tolist() == expected and 10 < hit.sum() < 190


def test_an_episode_is_not_changed_by_a_collision_before_it():
    world, fresh = sim.World([ENV1] * 64), sim.World([ENV1] * 64)
    commands = np.c_[np.linspace(0.1, 0.3, 64), np.linspace(-0.5, 0.5, 64)]
    fresh.drive(commands)  # what the first step of an episode looks like
    hits, hit = 0, np.zeros(64, bool)
    for _ in range(100):
        world.place(np.flatnonzero(hit), np.tile(ENV1.start, (hit.sum(), 1)))
        before, hit = hit, world.drive(commands)
        assert (world.poses[before] == fresh.poses[before]).all()
        hits += hit.sum()
    assert hits > 100


def test_robots_of_many_rooms_and_copies_drive_as_if_alone():
    scenes = [(ENV1, ENV2)[k % 3 // 2] for k in range(100)]  # several copies of both rooms
    commands = np.random.default_rng(1).uniform((0, -1), (0.3, 1), (12, 100, 2))
    world, alone = sim.World(scenes), [sim.World([scene]) for scene in scenes]
    for command in commands:
        hit = world.drive(command)
        assert hit.tolist() == [one.drive(c[None])[0] for one, c in zip(alone, command)]
        assert np.allclose(world.poses, [one.poses[0] for one in alone], atol=1e-9)


@pytest.mark.parametrize("scene", [ENV1, ENV2])
def test_a_robot_in_the_mirrored_room_drives_the_mirrored_way(scene):
    mirrored, rng = scene.mirrored(), np.random.default_rng(4)
    poses = [(*p, rng.uniform(-3, 3)) for p in rng.choice(scene.reachable, 50)] + [scene.start]
    poses = np.array(poses)

    def flip(poses):
        return np.c_[-poses[:, 0], poses[:, 1], sim.wrap_angle(np.pi - poses[:, 2])]
    assert np.allclose(flip(poses)[-1], mirrored.start) and not mirrored.new_targets
    env = navbot_min.NavVecEnv(400, [scene, mirrored])
    env.reset(seed=0)  # tests are in the true room alone
    for room, goals in ((scene, env.goals[::2]), (mirrored, env.goals[1::2])):
        assert set(map(tuple, goals)) == set(map(tuple, room.targets))
    world, twin = sim.World([scene] * 51), sim.World([mirrored] * 51)
    world.place(slice(None), poses)
    twin.place(slice(None), flip(poses))
    for _ in range(20):
        commands = rng.uniform((0, -1), (0.3, 1), (51, 2))
        assert (world.drive(commands) == twin.drive(commands * (1, -1))).all()
    assert np.allclose(flip(world.poses)[:, :2], twin.poses[:, :2], atol=1e-6)


def test_range_readings_match_the_distances_to_the_walls():
    world = sim.World([parse_scene(square_room(), "room")])
    world.place([0], [(0.5, 0.25, 0.3)])
    readings = world.range_readings(np.array([0, 0.5, 1, -0.5]) * np.pi - 0.3, 8.0)
    assert np.allclose(readings, [(1.5, 1.75, 2.5, 2.25)])
    assert np.allclose(world.range_readings([0.0], 1.0), 1.0)  # nothing within range


@pytest.mark.parametrize("scene", [ENV1, ENV2], ids=["env1", "env2"])
def test_rooms_are_the_papers(scene):
    """Facts of the released rooms: 0.28 m of air everywhere, no target straight ahead."""
    places = np.vstack([scene.targets, scene.start[:2]])
    assert scene.clearance(places).min() >= 0.28
    for target in scene.targets:
        line = np.linspace(scene.start[:2], target, 500)
        assert scene.clearance(line).min() < sim.ROBOT_RADIUS


@pytest.mark.parametrize("change, words", [
    (dict(training_targets=[[1.0, 0.0], [2.05, 0.0]]), "training_targets[1] (2.05, 0.0) is inside"),
    (dict(new_targets=[[9.0, 0.0]]), "new_targets[0] (9.0, 0.0) cannot be reached"),
    (dict(new_targets=[]), "new_targets is []"),
    (dict(new_targets=[[math.nan, 0.0]]), "new_targets[0][0] is nan"),
    (dict(new_targets=[[1.0, 0.0]]), "is a training one too"),
    (dict(start=[0.0, 0.0]), "start is [0.0, 0.0], it must be a list of 3"),
    (dict(start=[1.9, 0.0, 0.0]), "start (1.9, 0.0) is nearer to a box"),
    (dict(start=[0.0, 0.0, True]), "start[2] is True, it must be a finite number"),
    (dict(colour="red"), "unknown key 'colour'"),
    (dict(boxes=square_room()["boxes"][:3]), "the room is not closed"),
    (dict(boxes=[box(height=0.2)]), "boxes[0].height is 0.2, it must be above 0.281"),
    (dict(boxes=[box(material="glass")]), "boxes[0].material is 'glass'"),
    (dict(boxes=[*square_room()["boxes"], box(x=1e9)]), "spread over 1000000002.2 m"),
    (dict(boxes=[box(length="long")]), "boxes[0].length is 'long'"),
    (dict(boxes=[{}]), "boxes[0] has no 'material'"),
])
def test_a_bad_scene_is_one_error_that_names_the_item(change, words):
    with pytest.raises(sim.SceneError, match=re.escape(words)):
        parse_scene(square_room() | change, "room")


# --------------------------------------------------------------------------------------- the camera


def photograph(scene, poses, target):
    """What the camera makes of one room, from several poses."""
    return render.Camera([scene]).render(np.zeros(len(poses), int), np.array(poses),
                                         np.tile(target, (len(poses), 1)))


def slow_image(scene, pose, target):
    """The twin of the camera: each pixel's ray is met with every face in 3-D, the nearest wins."""
    cube = sim.Box("cube", *target, yaw=0.0, length=0.2, thickness=0.2, height=0.2)
    c, s = math.cos(pose[2]), math.sin(pose[2])
    eye = np.array([pose[0] - 0.118 * c, pose[1] - 0.118 * s])
    i, j = np.mgrid[:48, :64]
    left, down = (31.5 - j) / render.FOCAL, (i - 23.5) / render.FOCAL
    x, y = c - s * left, s + c * left  # the ray, a unit deep
    image = np.where(down[..., None] > 0, render.FLOOR, render.SKY).astype(float)
    nearest = np.where(down > 0, 0.281 / np.abs(down), np.inf).clip(max=render.FAR)
    for b in (*scene.boxes, cube):
        for p, q in zip(b.corners, np.roll(b.corners, -1, axis=0)):
            length = np.hypot(*(q - p))
            along = (q - p) / length
            facing = x * along[1] - y * along[0]  # the ray along the outward normal
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
                image[hit] = render.texture(b.material)[texel] * bright.round(1)
            nearest = np.where(hit, z, nearest)
    z = (0.281 - 0.2) / np.where(down > 0, down, 1e-9)  # the lid of the cube
    lid = (z < nearest) & (np.abs(eye[0] + z * x - target[0]) < 0.1) & (
        np.abs(eye[1] + z * y - target[1]) < 0.1)
    image[lid] = np.multiply(render.BLUE, render.light((0, 0, 1)))
    return image.clip(0, 255).round()


def test_images_are_those_of_the_slow_raycaster():
    rng, checked = np.random.default_rng(3), []
    low = box(material="wood", x=1.0, y=0.3, yaw=0.4, length=0.4, thickness=0.3, height=0.5)
    middle = box(material="brick", x=1.6, y=-0.2, yaw=-0.5, length=0.8, thickness=0.2, height=1.1)
    tall = box(x=1.9, y=1.0, yaw=0.2, length=0.3, thickness=0.3, height=1.6)
    room = parse_scene(square_room(3.0, extra=[low, middle, tall], new_targets=[[-1.0, 1.0]],
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
    assert max(checked) <= 0.005 and np.mean(checked) <= 0.001, checked  # on edges alone


def test_a_red_wall_seen_head_on_is_flat_and_red():
    wall = box(material="brick", length=0.1, thickness=3.9, height=1.5)
    scene = parse_scene(square_room(extra=[wall], training_targets=[[-1.0, 0.0]]), "room")
    image = photograph(scene, np.zeros((1, 3)), (-1.0, 0.0))[0]
    assert image.shape == (48, 64, 3) and image.dtype == np.uint8
    foot = (image == render.FLOOR).all(-1).argmax(0)  # first row of floor in each column
    distance = 0.95 + 0.118  # from the camera to the wall
    assert set(foot) == {math.ceil(23.5 + 0.281 / distance * render.FOCAL)}  # flat: no fish-eye
    red, green, blue = image[: foot[0]].reshape(-1, 3).mean(0)
    assert red > 1.5 * green and red > 1.5 * blue


def test_no_gap_at_a_shared_corner_and_no_numerical_warning():
    scene = sim.Scene("a box under the sky", (sim.Box(**box(x=0.0, yaw=0.7)),), (0, 0, 0), (), ())
    angle = np.linspace(-np.pi, np.pi, 2000)
    poses = np.c_[-1.1 * np.cos(angle), -1.1 * np.sin(angle), angle]  # all around, facing it
    with np.errstate(all="raise"):
        horizon = photograph(scene, poses, (9.0, 9.0))[:, 23]
        rng, free = np.random.default_rng(5), ENV1.reachable
        anywhere = np.c_[free[rng.integers(len(free), size=500)], rng.uniform(-np.pi, np.pi, 500)]
        anywhere[:8, 2] = np.arange(8) * np.pi / 4
        inside = photograph(ENV1, anywhere, ENV1.targets[0])[:, 23]
    wall = (horizon != render.SKY).any(-1)
    assert (np.abs(np.diff(wall, axis=1)).sum(1) == 2).all()  # one stretch of wall in each image
    assert (inside != render.SKY).any(-1).all()  # and nothing but walls inside a room


# ----------------------------------------------------------------------------------------- the task


@pytest.mark.parametrize("before, after, arrived, hit, paid", [
    (2.0, 1.9, False, False, 100 * 0.1 - 0.05), (1.0, 1.0, False, False, -0.05),
    (1.0, 1.1, False, False, -10.05), (0.2, 0.1, True, False, 100), (1.0, 1.0, False, True, -50),
    (0.2, 0.1, True, True, 100)])
def test_rewards_are_those_of_eq_4(before, after, arrived, hit, paid):
    assert navbot_min.rewards(before, after, arrived, hit) == pytest.approx(paid)


def test_arrival_wins_over_a_collision_in_the_same_step():
    scene = parse_scene(square_room(training_targets=[[1.95, 0.0]]), "room")
    env = navbot_min.NavEnv(scene, targets="training")
    env.reset()
    env.vector.world.place([0], [(1.75, 0.0, 0.0)])  # 0.20 m from the target, 0.25 m from the wall
    hits = env.vector.world.drive([(0.3, 0.0)])
    env.vector.world.place([0], [(1.75, 0.0, 0.0)])
    _, reward, terminated, truncated, info = env.step([1.0, 0.0])
    assert hits[0] and (reward, terminated, truncated) == (100.0, True, False)
    assert info["outcome"] == "arrival"


def test_bearing_is_continuous_through_pi():
    headings = np.linspace(-7, 7, 5001)
    poses = np.c_[np.zeros((5001, 2)), headings]
    polar = navbot_min.polar_targets(poses, np.tile((3.0, 4.0), (5001, 1)))
    assert np.allclose(polar[:, 0], 5) and (np.abs(polar[:, 1]) <= np.pi).all()
    turn = np.diff(polar[:, 1])
    assert np.allclose(np.minimum(np.abs(turn), 2 * np.pi - np.abs(turn)), 14 / 5000)
    seen = navbot_min.polar_targets(np.zeros((1, 3)), np.array([[0.0, 2.0]]))
    assert np.allclose(seen, (2.0, np.pi / 2))  # the target to the left has a positive bearing


@pytest.mark.parametrize("name", ["env1", "env2"])
def test_gymnasium_accepts_the_environment_without_a_warning(name):
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        check_env(gym.make(f"navbot_min:NavBot-{name}-v0").unwrapped)
        many = gym.make_vec(f"navbot_min:NavBot-{name}-v0", num_envs=3,
                            vectorization_mode="vector_entry_point")
    observations, _ = many.reset(seed=0)
    assert many.observation_space.contains(observations)
    assert many.observation_space.contains(many.step(np.ones((3, 2), np.float32))[0])


def test_the_vector_environment_is_many_single_ones():
    actions = np.random.default_rng(2).uniform((0.3, -1), (1, 1), (150, 4, 2))
    targets, many = [0, 1, 2, 0], navbot_min.NavVecEnv(4, targets=[0, 1, 2, 0])
    single = [navbot_min.NavEnv() for _ in range(4)]
    for env, k in zip(single, targets):
        env.vector._choices = [np.array([k])]
    seen, ended = many.reset(seed=0)[0], 0
    alone = [env.reset(seed=0)[0] for env in single]
    for action in actions:
        assert all((seen[key][r] == alone[r][key]).all() for r in range(4) for key in seen)
        seen, rewards, terminated, truncated, infos = many.step(action)
        for r, env in enumerate(single):
            alone[r], reward, term, trunc, info = env.step(action[r])
            assert (reward, term, trunc) == (rewards[r], terminated[r], truncated[r])
            if term or trunc:
                ended += 1
                last, goal = infos["final_obs"][r], ENV1.targets[targets[r:r + 1]]
                assert all((last[key] == alone[r][key]).all() for key in last)
                for pose, target in ((infos["pose"][r], last["target"]),
                                     (ENV1.start, seen["target"][r])):
                    polar = navbot_min.polar_targets(np.array([pose]), goal)[0]
                    assert np.allclose(polar, target, atol=1e-5)
                assert infos["final_info"]["outcome"][r] == info["outcome"]
                alone[r] = env.reset()[0]
                assert not alone[r]["velocity"].any() and not alone[r]["reward"].any()
    assert ended > 8


def test_the_time_limit_truncates_and_reports_the_last_velocity_and_reward():
    env = navbot_min.NavEnv(max_episode_steps=3)
    env.reset(seed=0)
    results = [env.step([0.0, 5.0]) for _ in range(3)]
    assert [(r[2], r[3]) for r in results] == [(False, False), (False, False), (False, True)]
    assert results[-1][4]["outcome"] == "timeout"
    assert results[-1][0]["velocity"].tolist() == [0, 1]  # clipped, in rad/s
    assert results[-1][0]["reward"] == pytest.approx(-0.05)


@pytest.mark.parametrize("targets, indices", [
    ("training", {0, 1}), ("new", {2}), ("both", {0, 1, 2})])
def test_episodes_draw_their_targets_from_the_chosen_set(targets, indices):
    env = navbot_min.NavVecEnv(64, targets=targets)
    env.reset(seed=0)
    assert set(env._target) == indices


@pytest.mark.parametrize("actions, words", [
    (np.zeros((3, 2)), "shape (3, 2), it must be (2, 2)"), (np.zeros(2), "it must be (2, 2)"),
    ([[0, 0], [np.nan, 0]], "robot 1 is not finite")])
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
            "reward": torch.as_tensor(rng.normal(size=(M, T, 1)), dtype=torch.float32)}


def random_episodes(lengths, seed=0):
    """Episodes of those lengths, as if collected with other weights."""
    rng, episodes = np.random.default_rng(seed), []
    for k, T in enumerate(lengths):
        numbers = torch.as_tensor(rng.normal(size=(T, 5)), dtype=torch.float32)
        observations = {key: value[0] for key, value in random_observations(1, T, seed + k).items()}
        episodes.append(ppo.Episode(observations, numbers[:, :2], numbers[:, 2] - 2, numbers[:, 3],
                                    numbers[:, 4], last_value=0.0))
    return episodes


def network(memory="stacked", seed=0, without=""):
    torch.manual_seed(seed)
    return model.Network(memory, without)


def test_the_network_has_the_papers_shapes():
    net, shapes = network(), []
    for layer in net.cnn:
        if isinstance(layer, (torch.nn.Conv2d, torch.nn.MaxPool2d)):
            layer.register_forward_hook(lambda _, __, y: shapes.append(tuple(y.shape[1:])))
    net.see(torch.zeros(1, 48, 64, 3, dtype=torch.uint8))
    assert shapes == [(32, 12, 16), (64, 6, 8), (64, 3, 4), (64, 2, 2)]  # channels, height, width
    counted = sum(p.numel() for name, p in net.named_parameters() if name != "log_std")
    counted -= 2 * 4 * model.HIDDEN  # the columns that clear the memories are no weights
    assert counted == 948_931 and net.log_std.numel() == 2


@pytest.mark.parametrize("memory", model.MEMORIES)
def test_a_sequence_at_once_equals_step_by_step(memory):
    net, seen = network(memory), random_observations(3, 7)
    whole, values, last = net(seen, net.initial_state(3))
    state = net.initial_state(3)
    for t in range(7):
        step, value, state = net({key: x[:, t:t + 1] for key, x in seen.items()}, state)
        assert torch.allclose(step.mean, whole.mean[:, t:t + 1], atol=1e-5)
        assert torch.allclose(value, values[:, t:t + 1], atol=1e-5)
    assert torch.allclose(state, last, atol=1e-5)


def test_one_robots_memory_never_reaches_another():
    net, seen = network(), random_observations(3, 5)
    mean, values, state = net(seen, net.initial_state(3))
    other = {key: x.clone() for key, x in seen.items()}
    other["image"][1], other["target"][1] = 0, 9.0
    mean_2, values_2, state_2 = net(other, net.initial_state(3))
    same = [torch.equal(a[r], b[r]) for r in range(3)
            for a, b in ((mean.mean, mean_2.mean), (values, values_2), (state, state_2))]
    assert same == [True] * 3 + [False] * 3 + [True] * 3


@pytest.mark.parametrize("without, inputs", [
    ("image", ["image"]), ("target", ["target"]), ("last", ["velocity", "reward"])])
def test_a_blanked_input_makes_no_difference(without, inputs):
    for blanked, same in ((without, True), ("", False)):
        net, seen = network(without=blanked), random_observations(2, 3)
        values = net(seen, net.initial_state(2))[1]
        seen |= {key: 1 + seen[key] * 3 for key in inputs}
        assert torch.equal(net(seen, net.initial_state(2))[1], values) is same


def test_gradients_reach_the_first_convolution_and_both_lstms():
    net = network()
    batch = ppo.lay(random_episodes([4, 6]), [torch.ones(4), -torch.ones(6)])
    for k in (0, 1):
        net.zero_grad()
        ppo.losses(net, batch, 0.2)[k].backward()  # the policy loss, then the value loss
        for parameter in (net.cnn[0].weight, *net.memories[0].parameters(),
                          *net.memories[1].parameters()):
            assert parameter.grad.abs().sum() > 0


def test_gradients_reach_the_first_step_from_the_last():
    net, seen = network(), random_observations(1, 12)
    seen["target"].requires_grad_()
    net(seen, net.initial_state(1))[1][0, -1].backward()
    assert (seen["target"].grad[0].abs().sum(-1) > 0).all()


# -------------------------------------------------------------------------------------- the learner


@pytest.mark.parametrize("last_value", [0.0, 0.7])  # terminated, truncated
def test_advantages_are_the_brute_force_double_sum(last_value):
    rng, gamma, lam = np.random.default_rng(0), 0.9, 0.8
    r, V = rng.normal(size=6), np.append(rng.normal(size=6), last_value)
    expected = [sum((gamma * lam) ** (k - t) * (r[k] + gamma * V[k + 1] - V[k])
                    for k in range(t, 6)) for t in range(6)]
    A = ppo.advantages(torch.tensor(r), torch.tensor(V[:-1]), last_value, gamma, lam)
    assert np.allclose(A, expected)


def slow_losses(net, episodes, A, eps):
    """Both losses, one step of one episode at a time."""
    policy, value, steps = 0.0, 0.0, sum(len(e) for e in episodes)
    for e, a in zip(episodes, A):
        state = net.initial_state(1)
        for t in range(len(e)):
            one = {key: x[t][None, None] for key, x in e.observations.items()}
            distribution, V, state = net(one, state)
            r = (distribution.log_prob(e.actions[t]).sum() - e.log_probs[t]).exp()
            policy = policy - min(r * a[t], r.clamp(1 - eps, 1 + eps) * a[t]) / steps
            value = value + (V[0, 0] - (a[t] + e.values[t])) ** 2 / steps
    return policy, value


def test_episodes_end_to_end_have_the_losses_and_gradients_of_each_step_alone():
    net, episodes = network(), random_episodes([3, 9, 5, 1, 4])
    A = [torch.randn(len(e)) for e in episodes]
    batch = ppo.lay(episodes, A)
    assert batch["mask"].shape == (3, 10) and batch["mask"].sum() == 22
    for k in (0, 1):  # policy loss, value loss
        results = []
        for losses in (ppo.losses(net, batch, 0.2), slow_losses(net, episodes, A, 0.2)):
            net.zero_grad()
            losses[k].backward()
            gradients = [p.grad for p in net.parameters() if p.grad is not None]
            results.append((losses[k].item(), torch.cat([g.flatten().clone() for g in gradients])))
        (loss, gradient), (expected, slow_gradient) = results
        assert loss == pytest.approx(expected, rel=1e-5)
        assert (gradient - slow_gradient).norm() < 1e-5 * slow_gradient.norm()


@pytest.mark.parametrize("lengths, rows", [([5], 1), ([9, 3, 5], 2), ([2, 2, 8, 2], 2),
                                           ([4, 4, 4], 3), ([5, 3, 2], 3)])
def test_rows_are_no_longer_than_the_longest_episode_and_hold_each_once(lengths, rows):
    laid = ppo.rows(lengths)
    assert len(laid) == rows and sorted(k for row in laid for k in row) == [*range(len(lengths))]
    assert max(sum(lengths[k] + 1 for k in row) - 1 for row in laid) == max(lengths)


def test_the_clipped_loss_is_that_of_eq_3():
    net, episodes = network(), random_episodes([4])
    A = torch.tensor([1.0, -1.0, 2.0, -0.5])
    seen = {key: value[None] for key, value in episodes[0].observations.items()}
    distribution = net(seen, net.initial_state(1))[0]
    log_probs = distribution.log_prob(episodes[0].actions).sum(-1)[0].detach()
    episodes[0].log_probs = log_probs - torch.tensor([0.5, 0.5, -0.5, 0.05])  # log ratios
    expected = -np.mean([1.2 * 1, math.exp(0.5) * -1, math.exp(-0.5) * 2, math.exp(0.05) * -0.5])
    loss = ppo.losses(net, ppo.lay(episodes, [A]), 0.2)[0].item()
    assert loss == pytest.approx(expected, rel=1e-4)


def collect(collector, least):
    """(Episode, info) pairs, until `least` of them have ended."""
    ended = []
    while len(ended) < least:
        ended += collector.step()
    return ended


def test_the_first_minibatch_between_two_updates_has_ratio_1_and_kl_0():
    net = network()
    torch.nn.init.orthogonal_(net.action.weight)  # so that the memory shows in the actions
    collector = ppo.Collector(navbot_min.NavVecEnv(4, max_episode_steps=25), net, 0.01, seed=0)
    episodes = [episode for episode, _ in collect(collector, 8)]
    batch = ppo.lay(episodes, [torch.zeros(len(e)) for e in episodes])
    state = net.initial_state(len(batch["mask"]))
    distribution, values, _ = net(batch["observations"], state, batch["mask"])
    r = (distribution.log_prob(batch["actions"]).sum(-1) - batch["log_probs"]).exp()[batch["mask"]]
    assert (r - 1).abs().max() < 1e-4 and len({len(e) for e in episodes}) > 1
    assert abs(ppo.losses(net, batch, 0.2)[2]["kl"]) < 1e-6
    order = [k for row in ppo.rows([len(e) for e in episodes]) for k in row]
    expected = torch.cat([episodes[k].values for k in order])  # memory was cleared between episodes
    assert torch.allclose(values[batch["mask"]], expected, atol=1e-4) and len(batch["mask"]) < 8


def test_bootstrapping_is_from_the_true_last_observation_and_only_at_the_time_limit():
    net, last = network(), {}
    env = navbot_min.NavVecEnv(4, max_episode_steps=12)
    collector, step = ppo.Collector(env, net, 0.01, seed=0), env.step

    def spy(actions):
        result = step(actions)
        for r in np.flatnonzero(result[2] | result[3]):
            info = result[4]
            last[info["final_info"]["return"][r].item()] = info["final_obs"][r]
        return result
    env.step = spy
    outcomes = set()
    for episode, info in collect(collector, 10):
        outcomes.add(info["outcome"] == "timeout")
        final = last[info["return"]]
        whole = {key: torch.cat([x, torch.as_tensor(final[key])[None]])[None]
                 for key, x in episode.observations.items()}
        value = net(whole, net.initial_state(1))[1][0, -1].item()
        expected = value if info["outcome"] == "timeout" else 0.0
        assert episode.last_value == pytest.approx(expected, abs=1e-4)
        assert episode.rewards.sum() == pytest.approx(0.01 * info["return"], abs=1e-4)
    assert outcomes == {True, False}


class Cue(VectorEnv):
    """A cue shown at the first step alone; the second and last action is paid by its sign."""
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
                "reward": np.zeros((self.num_envs, 1), np.float32)}

    def step(self, actions):
        self.t += 1
        done = np.full(self.num_envs, self.t == 2)
        reward = self.cue * np.clip(actions[:, 1], -1, 1) * done
        infos = {"final_info": {"outcome": np.sign(reward)}} if done[0] else {}
        observations = self.reset()[0] if done[0] else self.look()
        return observations, reward, done, np.zeros_like(done), infos


def test_a_cue_at_the_first_step_is_learnt_by_the_lstm_and_not_without_memory():
    config, paid = train.Config(epochs=6, minibatches=1, lam=1.0), {}
    for memory in ("stacked", "none"):
        net, rng = network(memory), np.random.default_rng(0)
        optimizer = torch.optim.Adam(net.parameters(), lr=2e-3)
        collector = ppo.Collector(Cue(), net, 1.0, seed=0)
        for _ in range(16):
            ended = collect(collector, 32)
            ppo.update(net, optimizer, [episode for episode, _ in ended], config, rng)
        paid[memory] = np.mean([info["outcome"] for _, info in collect(collector, 256)])
    assert paid["stacked"] > 0.8 and abs(paid["none"]) < 0.3, paid


# ------------------------------------------------------------------------- training and evaluation


TINY = ["--steps", "600", "--robots", "8", "--episodes-per-update", "8",
        "--evaluation-episodes", "4"]


@pytest.fixture(scope="module")
def runs(tmp_path_factory):
    """Two tiny trainings with one seed, in one folder, as a user starts them."""
    folder, outputs = tmp_path_factory.mktemp("runs"), []
    for _ in range(2):
        outputs.append(subprocess.run(
            [sys.executable, str(ROOT / "train.py"), "--env", "env1", *TINY, "--json"],
            cwd=folder, capture_output=True, text=True))
    return folder / "runs", outputs


def test_training_leaves_a_whole_run_folder_and_overwrites_none(runs):
    folder, outputs = runs
    assert [done.returncode for done in outputs] == [0, 0], outputs[0].stderr
    assert sorted(run.name for run in folder.iterdir()) == ["env1-seed0", "env1-seed0-2"]
    for run, done in zip(sorted(folder.iterdir()), outputs):
        assert sorted(file.name for file in run.iterdir()) == [
            "config.json", "curves.png", "episodes.csv", "evaluation.json", "model.pt",
            "summary.json", "updates.csv"]
        summary = json.loads((run / "summary.json").read_text())
        assert json.loads(done.stdout) == summary and str(run.name) in done.stderr
        assert list(summary) == ["env", "seed", "steps", "episodes", "seconds", "stopped_by_rule",
                                 "rolling_new_success", "frozen"]
        assert summary["frozen"] == json.loads((run / "evaluation.json").read_text())
        rows = list(csv.DictReader(open(run / "episodes.csv")))
        assert len(rows) == summary["episodes"] and summary["steps"] == 600
        assert int(rows[-1]["steps"]) <= 600
        assert {row["kind"] for row in rows} == {"training", "new"}


def test_the_same_seed_writes_the_same_episodes_byte_for_byte(runs):
    first, second = [(run / "episodes.csv").read_bytes() for run in sorted(runs[0].iterdir())]
    assert first == second and len(list(csv.reader(first.decode().splitlines()))) > 20


def torchrun(processes, script, *arguments, cwd):
    """Starts the script in so many processes that share the work."""
    command = [sys.executable, "-m", "torch.distributed.run", "--standalone", "--nproc-per-node",
               str(processes), str(script), *arguments]
    return subprocess.run(command, cwd=cwd, capture_output=True, text=True)


def test_one_process_under_torchrun_gives_what_no_torchrun_gives_and_two_share_the_work(
        runs, tmp_path):
    for processes in (1, 2):
        done = torchrun(processes, ROOT / "train.py", "--env", "env1", *TINY, "--out",
                        str(processes), cwd=tmp_path)
        assert done.returncode == 0, done.stderr
    alone = sorted(runs[0].iterdir())[0]
    assert (tmp_path / "1/episodes.csv").read_bytes() == (alone / "episodes.csv").read_bytes()
    assert sorted(path.name for path in tmp_path.iterdir()) == ["1", "2"]
    summary = json.loads((tmp_path / "2/summary.json").read_text())
    rows = list(csv.DictReader(open(tmp_path / "2/episodes.csv")))
    assert summary["steps"] == 600 and summary["episodes"] == len(rows) > 20
    assert len(list(csv.reader(open(tmp_path / "2/updates.csv")))) > 1


def test_two_processes_average_their_gradients_by_real_steps(tmp_path):
    (tmp_path / "half.py").write_text(f"""
import sys
sys.path.insert(0, {str(ROOT)!r})
import torch
from torch import distributed
import ppo, test_all
distributed.init_process_group("gloo")
net, episodes = test_all.network(), test_all.random_episodes([3, 9, 5])
mine = episodes[:1] if distributed.get_rank() == 0 else episodes[1:]
batch = ppo.lay(mine, [e.rewards for e in mine])
sum(ppo.losses(net, batch, 0.2)[:2]).backward()
ppo.average_gradients(net, int(batch["mask"].sum()))
torch.save([p.grad for p in net.parameters()], f"{{distributed.get_rank()}}.pt")
""")
    done = torchrun(2, tmp_path / "half.py", cwd=tmp_path)
    assert done.returncode == 0, done.stderr
    net, episodes = network(), random_episodes([3, 9, 5])
    batch = ppo.lay(episodes, [e.rewards for e in episodes])
    sum(ppo.losses(net, batch, 0.2)[:2]).backward()
    first, second = (torch.load(tmp_path / f"{rank}.pt") for rank in (0, 1))
    for together, a, b in zip(net.parameters(), first, second):
        assert torch.equal(a, b) and torch.allclose(a, together.grad, rtol=1e-3, atol=1e-6)


def test_a_saved_model_acts_as_before(runs):
    folder = sorted(runs[0].iterdir())[0]
    net, scene = evaluate.load_run(folder)
    assert scene == ENV1
    again = evaluate.evaluate(evaluate.Policy(net, "sampled", 0), scene, 4, seed=0)[0]
    written = json.loads((folder / "evaluation.json").read_text())
    for target in written["targets"]:
        target.pop("mean_action_arrives")
    assert again == written


def test_new_targets_never_reach_an_update(monkeypatch):
    learnt, scene = [], ENV1
    monkeypatch.setattr(train, "update", lambda model, optimizer, episodes, *_: (
        learnt.extend(e.observations["target"][0, 0].item() for e in episodes)) or {})

    class Nowhere:
        def add_row(self, name, row):
            pass
    config = train.Config(steps=1200, robots=8, episodes_per_update=8, random_starts=0.0)
    record = train.train(config, scene, Nowhere())[1]
    away = [np.hypot(*(np.array(t) - scene.start[:2])) for t in scene.training_targets]
    assert {row["kind"] for row in record.episodes} == {"training", "new"} and len(learnt) >= 16
    assert all(min(abs(d - a) for a in away) < 1e-4 for d in learnt)  # all from the one start


def test_the_share_of_the_robots_that_was_asked_for_drives_in_the_mirrored_room(monkeypatch):
    class Made(Exception):
        pass

    def make(R, rooms, *_):
        assert R == 8 and rooms == [ENV1] * 6 + [ENV1.mirrored()] * 2
        raise Made
    monkeypatch.setattr(train, "NavVecEnv", make)
    with pytest.raises(Made):
        train.train(train.Config(robots=8, mirrored=0.25), ENV1, None)


def test_random_starts_are_free_far_and_never_on_the_way_to_a_new_target():
    env = navbot_min.NavVecEnv(400, random_starts=0.7)
    poses = env.reset(seed=0)[1]["pose"]
    elsewhere, new = ~np.isclose(poses[:, :2], ENV1.start[:2]).all(1), env._target == 2
    assert new.any() and not elsewhere[new].any() and 0.6 < elsewhere[~new].mean() < 0.8
    assert ENV1.clearance(poses[:, :2]).min() > sim.ROBOT_RADIUS
    assert np.hypot(*(poses[:, :2] - ENV1.targets[env._target]).T).min() >= 1
    assert (np.ptp(poses[elsewhere], axis=0) > (3, 1.5, 5)).all()
    tiny = parse_scene(square_room(0.5, training_targets=[[0.3, 0.0]],
                                       new_targets=[[0.0, 0.3]]), "nowhere 1 m from its target")
    env = navbot_min.NavVecEnv(4, tiny, "training", random_starts=1.0)
    assert (env.reset(seed=0)[1]["pose"][:, 0] < 0).all()
    with pytest.raises(ValueError, match="random_starts is 1.5, it must be from 0 to 1"):
        navbot_min.NavVecEnv(4, random_starts=1.5)


def test_an_update_of_equal_advantages_and_one_past_the_last_step_leave_numbers():
    net = network()
    optimizer = torch.optim.Adam(net.parameters(), 1e-3)
    config = train.Config(epochs=1, minibatches=1)
    for episodes in (random_episodes([1], seed) * 3 for seed in range(20)):
        ppo.update(net, optimizer, episodes, config, np.random.default_rng(0))
    config = train.Config(steps=1, robots=200, episodes_per_update=4, random_starts=1.0)
    trained, record, _ = train.train(config, ENV1, None)
    for weights in (net, trained):
        assert all(torch.isfinite(p).all() for p in weights.parameters())


@pytest.mark.parametrize("fixed_budget, steps", [(False, 8), (True, 200)])
def test_the_rule_stops_nothing_in_a_fixed_budget(fixed_budget, steps, monkeypatch):
    monkeypatch.setattr(train.Record, "rule_is_met", lambda record: record.steps > 0)
    config = train.Config(steps=200, robots=8, fixed_budget=fixed_budget)
    summary = train.train(config, ENV1, None)[2]
    assert summary["steps"] == steps and summary["stopped_by_rule"] is not fixed_budget


def test_the_deviation_is_limited_to_its_share_and_never_raised():
    net = network()
    for share, expected in ((2.0, 1.0), (0.5, 0.5), (0.8, 0.5)):
        net.limit_std(share)
        limited = torch.tensor(model.INITIAL_STD) * expected
        assert torch.allclose(net.log_std.exp(), limited)


@pytest.mark.parametrize("arrivals, misses, met", [(61, 39, True), (60, 40, False), (99, 0, False)])
def test_the_rule_is_more_than_60_of_the_last_100_test_episodes(arrivals, misses, met):
    record = train.Record(ENV1)
    info = {"new": True, "target": 2, "return": 0.0, "length": 5}
    for outcome in ["collision"] * misses + ["arrival"] * arrivals:
        record.add(info | {"outcome": outcome})
        record.add(info | {"outcome": "arrival", "new": False, "target": 0})  # does not count
    assert record.rule_is_met() is met


@pytest.mark.parametrize("successes, n, low, high", [
    (81, 100, 0.722, 0.875), (0, 20, 0.0, 0.161), (20, 20, 0.839, 1.0), (0, 0, 0.0, 1.0)])
def test_wilson_intervals_have_their_known_values(successes, n, low, high):
    assert evaluate.wilson(successes, n) == pytest.approx((low, high), abs=5e-4)


def test_a_frozen_evaluation_counts_its_quota_and_changes_nothing():
    net = network()
    before = {name: value.clone() for name, value in net.state_dict().items()}
    result = evaluate.evaluate(evaluate.Policy(net, "sampled", 3), ENV2, 13, seed=3)[0]
    assert [target["n"] for target in result["targets"]] == 3 * [2] + 7 * [1] + [7, 6]
    assert (result["training"]["n"], result["new"]["n"]) == (13, 13)
    for row in (result["training"], result["new"], *result["targets"]):
        assert row["success"] + row["collision"] + row["timeout"] == pytest.approx(1)
    assert all(torch.equal(value, before[name]) for name, value in net.state_dict().items())


def test_the_protocols_start_and_lead_where_they_say():
    starts, goals = {}, {}
    for protocol in ("paper", "perturbed", "anywhere"):
        exam = evaluate.Exam(ENV1, [2] * 300, protocol)
        exam.reset(seed=0)
        starts[protocol], goals[protocol] = exam.starts, exam.goals
        assert ENV1.clearance(exam.starts[:, :2]).min() > sim.ROBOT_RADIUS
    assert (starts["paper"] == ENV1.start).all() and (goals["paper"] == ENV1.targets[2]).all()
    spread = (starts["perturbed"] - ENV1.start).std(0)
    assert spread == pytest.approx([0.05, 0.05, math.radians(10)], rel=0.15)
    away = np.hypot(*(starts["anywhere"][:, :2] - goals["anywhere"]).T)
    assert away.min() >= 1 and (np.ptp(goals["anywhere"], axis=0) > (3, 1.5)).all()


@pytest.mark.parametrize("scene, least", [(ENV1, 60), (ENV2, 60)])
def test_validation_targets_can_be_reached_and_give_nothing_of_the_exam_away(scene, least):
    spots = evaluate.validation_scene(scene).new_targets
    assert len(spots) > least and scene.clearance(spots).min() > sim.ROBOT_RADIUS - 0.02
    for spot in spots:
        assert min(math.dist(spot, new) for new in scene.new_targets) >= 0.5
        assert math.dist(spot, scene.start[:2]) >= 0.5
        assert min(math.dist(spot, training) for training in scene.training_targets) >= 0.2
        assert planners.visibility_graph(scene).path(scene.start[:2], spot)[1] < math.inf
    result, done = evaluate.evaluate(evaluate.Planned("straight", scene, 0),
                                     evaluate.validation_scene(scene), 1, "validation")
    assert result["new"] is None and result["validation"]["n"] == len(spots)
    assert {tuple(e["goal"]) for e in done} == {*spots, *scene.training_targets}


def test_a_room_under_a_metre_has_an_anywhere_but_no_validation_targets():
    tiny = parse_scene(square_room(0.5, training_targets=[[0.3, 0.0]],
                                   new_targets=[[0.0, 0.3]]), "tiny")
    exam = evaluate.Exam(tiny, [0] * 50, "anywhere")
    exam.reset(seed=0)
    assert np.hypot(*(exam.starts[:, :2] - exam.goals).T).min() > 0.3
    with pytest.raises(sim.SceneError, match="tiny has no room for validation targets"):
        evaluate.validation_scene(tiny)


@pytest.mark.parametrize("hidden, place, cube", [
    ("", True, True), ("place", False, True), ("cube", True, False), ("both", False, False)])
def test_what_is_hidden_of_a_target_is_not_observed_and_nothing_else_changes(hidden, place, cube):
    room, seen = parse_scene(square_room(), "room"), []
    for target, what in ((0, hidden), (0, ""), (1, "")):  # target 1 is to the left, out of view
        exam = evaluate.Exam(room, [target], "paper", what)
        exam.reset(seed=0)
        seen.append(exam.step([[0.5, 0.0]])[0])
    one, ahead, aside = seen
    assert np.array_equal(one["image"], (ahead if cube else aside)["image"])
    assert not np.array_equal(ahead["image"], aside["image"])
    assert np.array_equal(one["target"], ahead["target"] * place)
    assert all(np.array_equal(one[key], ahead[key]) for key in ("velocity", "reward"))


def test_an_evaluation_and_its_film_hide_the_same():
    shown = []

    class Spy(evaluate.Policy):
        def act(self, env, observations):
            shown.append(observations["target"].any())
            return super().act(env, observations)
    spy = Spy(network(), "mean", 0)
    evaluate.evaluate(spy, ENV1, 1, hidden="place")
    evaluate.watch(spy, ENV1, 2, hidden="place")
    assert shown and not any(shown)


@pytest.mark.parametrize("success, shortest, metres, expected", [
    (True, 2.0, 4.0, 0.5), (True, 2.0, 1.9, 1.0), (False, 2.0, 2.0, 0.0),
    (True, 0.0, 0.1, 1.0), (False, math.inf, 3.0, 0.0)])
def test_spl_on_paths_made_by_hand(success, shortest, metres, expected):
    assert evaluate.spl(success, shortest, metres) == expected


# ------------------------------------------------------------------------------------ the planners


def grid_distances(scene, start):
    """Shortest paths [m] from a reachable point over the grid of reachable cells, eight ways."""
    cells = {tuple(cell) for cell in np.round(scene.reachable / 0.025, 3).tolist()}
    graph, steps = networkx.Graph(), [(1, 0), (0, 1), (1, 1), (1, -1)]
    for x, y in cells:
        for dx, dy in steps:
            other = round(x + dx, 3), round(y + dy, 3)
            if other in cells:
                graph.add_edge((x, y), other, weight=0.025 * math.hypot(dx, dy))
    first = tuple(np.round(np.asarray(start) / 0.025, 3).tolist())
    return networkx.single_source_dijkstra_path_length(graph, first)


@pytest.mark.parametrize("scene", [ENV1, ENV2])
def test_shortest_paths_lie_between_the_straight_line_and_the_grids(scene):
    rng, roadmap = np.random.default_rng(0), planners.visibility_graph(scene)
    a = scene.reachable[rng.integers(len(scene.reachable))]
    grid, bent = grid_distances(scene, a), 0
    for b in scene.reachable[rng.integers(len(scene.reachable), size=25)]:
        there, back = (roadmap.path(tuple(p), tuple(q), 1e-6)[1] for p, q in ((a, b), (b, a)))
        straight = math.dist(a, b)
        assert there == pytest.approx(back, abs=1e-4) and there >= straight - 1e-4
        assert there <= grid[tuple(np.round(b / 0.025, 3).tolist())] + 0.01
        bent += there > straight + 0.01
        assert there == pytest.approx(straight, abs=1e-4) or not roadmap.free(tuple(a), tuple(b))
    assert bent > 5


def test_no_path_leads_into_a_closed_chamber():
    walls = [box(x=1.0, y=0.0, length=0.1, thickness=3.9)]
    scene = parse_scene(square_room(extra=walls, training_targets=[[-1.0, 0.5]],
                                    new_targets=[[-1.0, -1.0]]), "room")
    assert planners.visibility_graph(scene).path((0.0, 0.0), (1.5, 0.0)) == (None, math.inf)


@pytest.mark.parametrize("scene", [ENV1, ENV2])
def test_the_oracle_reaches_every_target_by_the_shortest_path(scene):
    for protocol, episodes in (("paper", 1), ("anywhere", 40)):
        driver = evaluate.Planned("oracle", scene, 0)
        result, done = evaluate.evaluate(driver, scene, episodes, protocol)
        for row in result["targets"] or [result["anywhere"]]:
            assert row["success"] == 1 and row["spl"] > 0.9
        assert all(e["metres"] > np.hypot(*(e["goal"] - e["start"][:2])) - 0.2 for e in done)


@pytest.mark.parametrize("name", ["prm", "dstar"])
def test_planners_with_a_map_or_making_one_reach_every_target_of_env1(name):
    result = evaluate.evaluate(evaluate.Planned(name, ENV1, 0), ENV1, 1)[0]
    assert all(target["success"] == 1 and target["spl"] > 0.7 for target in result["targets"])


def test_bug_drives_an_arc_that_ends_at_its_next_point():
    room = parse_scene(square_room(), "room")
    world, bug = sim.World([room]), planners.Bug(room, None)
    for bearing in np.linspace(-0.19, 0.19, 9):
        pose = np.array([0.2, -0.1, 2.5])
        bug.begin(pose, (1.0, 1.0))
        bug.step = pose[:2] + 0.11 * np.array([math.cos(2.5 + bearing), math.sin(2.5 + bearing)])
        point = bug.step
        world.place([0], [pose])
        world.drive([bug.act(pose, None)])
        assert world.poses[0, :2] == pytest.approx(point, abs=1e-3) and bug.step is None


@pytest.mark.parametrize("name, empty, blocked", [
    ("straight", "arrival", "collision"), ("bug", "arrival", "arrival"),
    ("braitenberg", "arrival", None), ("random", None, None)])
def test_reflexes_do_what_they_can(name, empty, blocked):
    for extra, expected in (([], empty), ([box(x=0.9, y=0.0, length=0.2, thickness=0.8)], blocked)):
        room = parse_scene(square_room(extra=extra, start=[0.0, 0.0, 1.0],
                                       training_targets=[[1.6, 0.0]]), "room")
        done = evaluate.rollouts(evaluate.Planned(name, room, 0), room, [1, 0])
        assert expected in (None, done[0]["outcome"])


# ------------------------------------------------------------------------------- what users meet


def bad_call(capsys, main, arguments):
    """The one line that a bad command line prints."""
    with pytest.raises(SystemExit) as stop:
        main(arguments)
    printed = capsys.readouterr()
    assert stop.value.code == 2 and printed.out == "" and printed.err.count("\n") == 1
    return printed.err


@pytest.mark.parametrize("arguments, words", [
    (["--env", "env9"], ["unknown env 'env9'", "env1, env2"]),
    (["--sed", "1"], ["'--sed'", "known are", "--seed"]),
    (["--robots", "0"], ["--robots is 0", "from 1 up"]),
    (["--learning-rate", "-0.1"], ["--learning-rate is -0.1", "from 1e-09 to 1.0"]),
    (["--gamma", "nan"], ["--gamma is nan", "from 0.0 to 1.0"]),
    (["--memory", "elephant"], ["'elephant'", "'stacked', 'single', 'none'"]),
    (["--steps", "many"], ["--steps", "'many'"]),
    (["--out", "taken"], ["--out 'taken' exists already"]),
    (["--env", "bad.toml"], ["bad.toml", "new_targets[0]", "cannot be reached"]),
    (["--env", "broken.toml"], ["broken.toml"])])
def test_bad_input_to_train_is_one_line_and_leaves_no_folder(arguments, words, capsys, tmp_path,
                                                             monkeypatch):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "taken").mkdir()
    text = (ROOT / "scenes" / "env1.toml").read_text()
    (tmp_path / "bad.toml").write_text(text.replace("[[-3.0, -2.2]]", "[[-3.0, 5.0]]"))
    (tmp_path / "broken.toml").write_text("start = [")
    printed = bad_call(capsys, train.main, arguments)
    assert all(word in printed for word in words), printed
    assert not (tmp_path / "runs").exists() and not list((tmp_path / "taken").iterdir())


@pytest.mark.parametrize("arguments, words", [
    (["--env", "env9"], "unknown env 'env9'"), (["--en", "env1"], "unknown argument '--en'"),
    (["--env"], "--env")])
def test_bad_input_to_the_demo_is_one_line(arguments, words, capsys, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    assert words in bad_call(capsys, navbot_min.main, arguments)


def spoilt(tmp_path, runs, how):
    """A run that cannot be used, and why."""
    good = sorted(runs[0].iterdir())[0] / "model.pt"
    saved = torch.load(good, weights_only=True)
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
        saved["weights"]["value.weight"] = torch.zeros(1, 7)
        torch.save(saved, bad)
    elif how == "another kind":
        torch.save([1, 2], bad)
    else:
        bad.write_bytes(pickle.dumps(Code()))
    return bad


class Code:
    """What unpickles to a call."""
    def __reduce__(self):
        return Path.touch, (Path("executed"),)


@pytest.mark.parametrize("how", ["missing", "empty folder", "empty", "half-written", "another size",
                                 "another kind", "code"])
def test_a_run_that_cannot_be_used_is_one_line_and_nothing_is_executed(
        how, runs, capsys, tmp_path, monkeypatch):
    run = spoilt(tmp_path, runs, how)
    monkeypatch.chdir(tmp_path)
    before = sorted(tmp_path.iterdir())
    bad_call(capsys, evaluate.main, [str(run)])
    assert sorted(tmp_path.iterdir()) == before


@pytest.mark.parametrize("arguments, words", [
    (["--planner", "oracle", "--episodes", "0"], "--episodes is 0, it must be from 1 up"),
    (["--planner", "teleport"], "'teleport'"), (["--planner", "oracle", "--env", "env9"], "env9"),
    ([], "run"), (["runs/x", "--planner", "bug"], "either"),
    (["--planner", "bug", "--protocol", "mine"], "'mine'"),
    (["--planner", "bug", "--hide", "cube"], "--hide is cube, it must be left out")])
def test_bad_input_to_an_evaluation_is_one_line(arguments, words, capsys, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    assert words in bad_call(capsys, evaluate.main, arguments) and not any(tmp_path.iterdir())


def test_an_evaluation_prints_and_writes_the_same_and_its_pictures(runs, tmp_path, monkeypatch,
                                                                   capsys):
    monkeypatch.chdir(tmp_path)
    run = shutil.copytree(sorted(runs[0].iterdir())[0], "run")
    evaluate.main([str(run), "--episodes", "6", "--json"])
    written = json.loads(Path("run/evaluation.json").read_text())
    assert json.loads(capsys.readouterr().out) == written
    evaluate.main([str(run), "--episodes", "6", "--protocol", "anywhere", "--env", "env2"])
    assert "any free target" in capsys.readouterr().out
    evaluate.main([str(run), "--episodes", "6", "--hide", "cube"])
    hidden = json.loads(Path("run/evaluation-hidden-cube.json").read_text())
    assert (written["hidden"], hidden["hidden"]) == ("", "cube")
    for name in ("trajectories.png", "episode.gif", "floor-env2-anywhere.png",
                 "evaluation-env2-anywhere.json", "trajectories-hidden-cube.png"):
        assert (Path("run") / name).stat().st_size > 250


def test_the_deviations_shrink_to_a_fifth_in_the_last_15_percent_of_the_steps(monkeypatch):
    shares, steps = [], []

    class Folder:
        def add_row(self, name, row):
            if name == "updates.csv":
                steps.append(row["steps"])
    monkeypatch.setattr(train, "update", lambda *_: {})
    monkeypatch.setattr(train.Network, "limit_std", lambda self, share: shares.append(share))
    train.train(train.Config(steps=2000, fixed_budget=True, episodes_per_update=2, minibatches=1),
                ENV1, Folder())
    assert shares == pytest.approx(np.interp(steps, [0, 1700, 2000], [1, 1, 0.2]))
    assert min(steps) < 1700 and sum(1700 < s < 2000 for s in steps) >= 2


@pytest.mark.parametrize("name", ["env1", "env2"])
def test_the_pretrained_policy_arrives_at_every_target(name):
    net, scene = evaluate.load_run(ROOT / "pretrained" / f"{name}.pt")
    done = evaluate.rollouts(evaluate.Policy(net, "mean", 0), scene, [1] * len(scene.targets))
    assert scene == load_scene(name) and [e["outcome"] for e in done].count("arrival") == len(done)


def test_the_results_table_has_every_seed_worst_first_and_their_mean():
    row = {f"{kind}_{key}": 0.5 for kind in ("training", "new", "anywhere")
           for key in ("success", "low", "high", "spl")}
    row |= {"env": "env1", "way": "varied", "mean_action_arrives": "3 of 3"}
    lines = results.markdown([row | {"seed": seed, "new_success": success}
                              for seed, success in (("0", 0.9), ("1", 0.2), ("2", 0.7))])
    assert re.findall(r"varied \| (\S+) .*?\| \**(\d+\.\d) %\**[ |[].*?(\d+\.\d) %", lines) == [
        ("1", "50.0", "20.0"), ("2", "50.0", "70.0"), ("0", "50.0", "90.0"),
        ("**mean**", "50.0", "60.0")]


def test_the_table_of_ablations_has_seeds_0_to_2_worst_first_their_mean_and_both_machines():
    rows = [{"env": env, "way": "none", "seed": str(seed)} | {
        f"{kind}_success": success for kind in ("new", "training", "anywhere")}
            for env in results.BUDGET for seed, success in enumerate((0.5, 0.2, 0.8, 0.9))]
    tables = (rows, [row | {"new_success": 0.3} for row in rows if row["env"] == "env1"])
    lines = [line for line in results.ablations_markdown(*tables).splitlines() if "none" in line]
    mean = "**50.0**"
    each = f"20, 50, 80: {mean}"
    assert lines == [
        f"| env1 | none | {each} | 30, 30, 30: **30.0** | {mean} | {mean} | {each} | {each} |",
        f"| env2 | none | {each} | - | {mean} | - | {each} | - |"]


def test_the_table_of_hidden_targets_has_every_seed_in_order():
    rows = [{"env": env, "way": way, "seed": seed, "hidden": hidden} | {
        f"{kind}_success": (10 * k + int(seed)) / 100 for kind in ("new", "training")}
            for env in results.BUDGET for way in results.WAYS for seed in "20143"
            for k, hidden in enumerate(evaluate.HIDDEN)]
    table = results.hidden_markdown([row for row in rows if row["hidden"]],
                                    [row for row in rows if not row["hidden"]]).splitlines()
    assert len(table) == 2 + 8
    for line in table[2:]:
        assert re.findall(r"\d+", line.split("|", 3)[3]) == [str(n) for n in (
            *range(0, 5), *range(10, 15), *range(20, 25), *range(30, 35))]


def test_paths_are_drawn_evenly_not_those_that_ended_first():
    episodes = [{"goal": ENV1.targets[2], "outcome": "arrival",
                 "path": np.tile((-1.0, -3.0, 0.0), (k + 2, 1))} for k in range(100)]
    lines = pictures.draw_trajectories(ENV1, episodes, most=20).axes[0].lines
    drawn = {len(line.get_xdata()) for line in lines if len(line.get_xdata()) > 2}
    assert max(drawn) == 101 and 15 < len(drawn) <= 20 and max(np.diff(sorted(drawn))) < 8


def test_a_file_that_fails_while_it_is_written_leaves_the_old_one(tmp_path):
    run_folder.write(tmp_path / "a.txt", "old")

    def fail(path):
        path.write_text("half")
        raise KeyboardInterrupt
    with pytest.raises(KeyboardInterrupt):
        run_folder.write(tmp_path / "a.txt", fail)
    assert (tmp_path / "a.txt").read_text() == "old\n"


def test_a_curves_points_are_means_over_the_last_100_episodes_of_a_kind(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    folder, rng = Path("runs/results/env1-varied-seed7"), np.random.default_rng(0)
    folder.mkdir(parents=True)
    rows = [{"steps": 10 * k, "kind": str(rng.choice(["training", "new"])),
             "outcome": str(rng.choice(navbot_min.OUTCOMES)), "return": rng.normal()}
            for k in range(400)]
    with open(folder / "episodes.csv", "w", newline="") as file:
        csv.DictWriter(file, rows[0]).writeheader()
        csv.DictWriter(file, rows[0]).writerows(rows)
    points = results.curve("env1", "varied", 7)
    assert {point["episodes"] for point in points} == {100, 150, 200}
    for point in points:
        last = [row for row in rows if row["kind"] == point["kind"]][:point["episodes"]][-100:]
        assert point["success"] == sum(row["outcome"] == "arrival" for row in last) / 100
        assert point["return"] == round(sum(row["return"] for row in last) / 100, 1)
        assert int(point["steps"]) == last[-1]["steps"]


def test_the_demo_needs_no_torch_and_writes_its_picture(tmp_path):
    code = (f"import sys; sys.path.insert(0, r'{ROOT}'); sys.modules['torch'] = None; "
            "import navbot_min; navbot_min.main(['--env', 'env2'])")
    done = subprocess.run([sys.executable, "-c", code], cwd=tmp_path, capture_output=True,
                          text=True)
    assert done.returncode == 0 and done.stdout.count("episode ") == 6, done.stderr
    assert (tmp_path / "demo.png").read_bytes().startswith(b"\x89PNG")


def test_the_networks_work_is_that_of_the_paper():
    forward, both = benchmark.flops(network())
    assert forward == pytest.approx(6.1e6, rel=0.02) and both == pytest.approx(16.4e6, rel=0.02)


def test_the_benchmark_writes_its_figures_and_their_plot(tmp_path):
    done = subprocess.run([sys.executable, str(ROOT / "benchmark.py"), "--cores", "1", "--seconds",
                           "0.002", "--json"], cwd=tmp_path, capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    figures = json.loads(done.stdout)
    assert figures == json.loads((tmp_path / "benchmark.json").read_text())
    assert (tmp_path / "benchmark.png").exists() and figures["cores"] == 1
    for key in ("camera_fps", "env_sps", "world_sps"):
        assert list(figures[key]) == ["1", "32", "256", "1024"] and min(figures[key].values()) > 0
    assert figures["train_sps"] > 0 and figures["roof_sps"] > 0 and figures["peers"] == {}


def test_bad_input_to_the_benchmark_is_one_line(capsys):
    assert "--cores is 4096" in bad_call(capsys, benchmark.main, ["--cores", "4096"])


def readme_table(heading):
    """The rows of the README's tables whose header starts with that word."""
    text = (ROOT / "README.md").read_text()
    tables = re.findall(rf"^\| {heading}.*\n\|[-| ]+\n((?:\|.*\n)+)", text, re.M)
    return [[cell.strip() for cell in row.strip("|").split("|")]
            for table in tables for row in table.splitlines()]


def test_imports_are_those_of_the_readmes_table():
    ours = {path.stem for path in ROOT.glob("*.py")}
    listed = readme_table("file")
    assert {name.strip("`") for name, *_ in listed} == {f"{name}.py" for name in ours}
    for name, _, allowed, *_ in listed:
        name = name.strip("`")
        if name == "test_all.py":
            continue
        tree, found = ast.parse((ROOT / name).read_text()), set()
        for node in ast.walk(tree):
            if isinstance(node, ast.Import):
                found |= {alias.name.split(".")[0] for alias in node.names}
            elif isinstance(node, ast.ImportFrom):
                found.add(node.module.split(".")[0])
        assert found & ours == set(re.findall(r"\w+", allowed)), name
        assert not ("torch" in found and "pymunk" in found), name
        if name in ("sim.py", "scene_file.py", "render.py", "navbot_min.py", "command_line.py"):
            assert "torch" not in found


def test_the_readmes_files_and_commands_exist():
    text = (ROOT / "README.md").read_text()
    made = {"curves.png", "demo.png", "episodes.csv", "updates.csv", "evaluation.json",
            "trajectories.png", "floor.png", "floor-validation.png"}  # by the commands
    for name in re.findall(r"`([\w./-]+\.(?:py|toml|csv|json|png|txt|md))`|\]\(([\w./]+)\)", text):
        assert (ROOT / "".join(name)).exists() or "".join(name) in made, name
    for script, flags in re.findall(r"python (\w+\.py)((?: --?[\w-]+(?: [\w./]+)?)*)", text):
        source = (ROOT / script).read_text()
        for flag in re.findall(r"--([\w-]+)", flags):
            field = flag.replace("-", "_")
            assert re.search(rf'"--{flag}"|^    {field}: ', source, re.M), (script, flag)
    makefile = (ROOT / "Makefile").read_text()
    for target in re.findall(r"^ *make (\w+)", text, re.M):
        assert re.search(rf"^{target}:", makefile, re.M), target


def test_the_lesson_stays_short():
    lines = {name: (ROOT / name).read_text().splitlines() for name in LESSON}
    assert sum(len(text) for text in lines.values()) < 1300
    assert all(len(line) <= 100 for path in ROOT.glob("*.py")
               for line in path.read_text().splitlines())
