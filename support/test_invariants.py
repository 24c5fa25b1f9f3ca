"""Tests invariants of the task in unusual rooms with random and extreme actions, 14,000 steps.

The steps are driven once. Each test checks one invariant of all steps with an oracle that computes
the result differently from the code.
"""

import functools
import math
from types import SimpleNamespace
from unittest.mock import patch

import numpy as np

import scenes
from navbot_min import ARRIVAL, COLLISION, TIMEOUT, NavVecEnv
from scenes.test_scenes import box, square_room
from support.traces import TurnToTarget

ROBOTS = 72  # more than the camera renders at once
STEPS = 48  # steps of each robot in each room
LIMIT = 24  # step limit of an episode
EXTREMES = np.array([0, -0.0, 1, -1, 1e-300, -1e-9, 1.0001, -2, 7e5, -1e30, 1e308])
PARTS = np.arange(5)[:, None] / 4  # fractions of a control period: times of the collision checks


THIN = square_room(1.0, 0.001, [box(x=0.4, y=0.5, yaw_degrees=25, thickness=0.002)],
                   training_targets=[[0.7, -0.6], [-0.6, 0.6]], new_targets=[])
ROOMS = [scenes.parse(THIN, "thin walls"), *map(scenes.load, ("env2", "maze3", "random:5"))]


def extreme_actions(rng, seen):
    """Returns actions (R, 2). Each robot drives in one of eight ways, chosen by its index."""
    R = len(seen["target"])
    actions = TurnToTarget().act(None, seen).astype(float)
    ways = [rng.uniform((0, -1), (1, 1), (R, 2)), np.tile((1, 0), (R, 1)), np.tile((1, 1), (R, 1)),
            np.tile((0, -1), (R, 1)), rng.choice(EXTREMES, (R, 2)),
            rng.uniform(-1e-7, 1e-7, (R, 2)), np.zeros((R, 2))]
    for k, way in enumerate(ways):
        actions[k::9] = way[k::9]
    return actions


@functools.cache
def drives(left_in_memory=0):
    """Returns a record of each step in each room. left_in_memory: the value of array elements that
    have not been written yet."""
    steps = []

    def empty(shape, dtype=float, order="C"):
        return np.full(shape, left_in_memory, dtype, order)
    with patch.object(np, "empty", empty):
        for seed, scene in enumerate(ROOMS):
            rng = np.random.default_rng(seed)
            env = NavVecEnv(ROBOTS, [scene], random_starts=0.5, max_episode_steps=LIMIT)
            seen, _ = env.reset(seed=seed)
            for _ in range(STEPS):
                step = SimpleNamespace(scene=scene, pose=env.world.poses, goal=env.goals.copy())
                step.action = extreme_actions(rng, seen)
                seen, step.reward, step.terminated, step.truncated, infos = env.step(step.action)
                last = infos.get("final_obs", seen)
                step.led_to = infos["pose"]
                step.seen = last["target"]
                outcome = infos.get("final_info", {"outcome": -1})["outcome"]
                step.outcome = np.where(step.terminated | step.truncated, outcome, -1)
                step.are_valid = [env.observation_space.contains(what) for what in (seen, last)]
                step.pixels = last["image"].astype(np.int64).sum((1, 2, 3))
                steps.append(step)
    return steps


def places(poses):
    """Returns the places of poses (..., 3) as complex numbers."""
    return poses[..., 0] + 1j * poses[..., 1]


def test_robots_drive_arcs_and_collide_exactly_when_their_disc_would_overlap_a_wall():
    counts = np.zeros(4, int)
    for step in drives():
        v, w = (step.action.clip((0, -1), (1, 1)) * (0.3, 1.0)).T
        turned = w * 0.4 * PARTS
        chord = np.where(w == 0, 0.4 * PARTS, np.expm1(1j * turned) / (1j * np.where(w, w, 1)))
        path = places(step.pose) + v * chord * np.exp(1j * step.pose[:, 2])  # (5, R) without walls
        gap = step.scene.clearance(np.stack([path.real, path.imag], -1)) - 0.178
        sure = (np.abs(gap[1:]) > 1e-9).all(0)
        free = np.logical_and.accumulate(gap[1:] > 0).sum(0)  # quarters that are driven
        collided = step.outcome == COLLISION
        assert (collided == (free < 4))[sure & (step.outcome != ARRIVAL)].all()
        robots = np.arange(ROBOTS)
        assert np.abs(path[free, robots] - places(step.led_to))[sure].max() < 1e-9
        heading = np.exp(1j * (step.pose[:, 2] + turned[free, robots]))
        assert np.abs(heading - np.exp(1j * step.led_to[:, 2]))[sure].max() < 1e-9
        assert step.scene.clearance(step.led_to[:, :2]).min() >= 0.178 - 1e-9
        assert (-math.pi < step.led_to[:, 2]).all() and (step.led_to[:, 2] <= math.pi).all()
        counts += np.bincount(step.outcome + 1, minlength=4)
    assert counts.min() > 30  # episodes end with every outcome


def test_observations_are_in_their_space_and_every_pixel_is_rendered():
    for step, other in zip(drives(), drives(left_in_memory=13)):
        assert all(step.are_valid) and (step.pixels == other.pixels).all()


def test_distance_and_bearing_agree_with_the_pose():
    for step in drives():
        ahead = (places(step.goal) - places(step.led_to)) * np.exp(-1j * step.led_to[:, 2])
        seen = step.seen[:, 0] * np.exp(1j * step.seen[:, 1])
        assert np.abs(ahead - seen).max() < 1e-5


def test_rewards_follow_eq_4_and_every_episode_has_one_outcome():
    for step in drives():
        before = np.abs(places(step.goal) - places(step.pose))
        after = np.abs(places(step.goal) - places(step.led_to))
        expected = 100 * (before - after) - 0.05
        expected[step.outcome == COLLISION] = -50
        expected[after < 0.177] = 100
        assert np.abs(expected - step.reward).max() < 1e-9
        assert not (step.terminated & step.truncated).any()
        assert ((step.outcome == ARRIVAL) == (after < 0.177)).all()
        assert ((step.outcome == TIMEOUT) == step.truncated).all()
