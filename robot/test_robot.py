"""Tests of the robot's errors, of the ring, and of the loop that drives the robot."""

import math
import subprocess
import sys
from dataclasses import replace
from types import SimpleNamespace

import gymnasium
import numpy as np
import pytest

import scenes
from navbot_min import COLLISION_REWARD, STEP_COST, NavVecEnv, polar_targets
from render import FOCAL
from robot import ring
from robot.environment import RandomVecEnv, RealVecEnv, RingVecEnv, environment_of, shift_rows
from robot.lab import LabRobot
from robot.mapping import OccupancyGrid
from robot.robot import drive
from scenes.generate import walls
from scenes.reality import ERRORS, Reality
from sim import CONTROL_PERIOD, ROBOT_RADIUS, Scene, World, wrap_angle

PLAIN = scenes.load("env2")
LAB = scenes.load("lab")
FLOOR = Scene("floor", tuple(walls(12.0, 12.0)), (0.0, 0.0, 0.0), ((3.0, 0.0),), ())


def real(scene=PLAIN, **errors):
    """Returns the room with these errors."""
    return replace(scene, reality=Reality(**errors))


def started(scene, R=4, environment=RealVecEnv):
    """Returns an environment after a reset, and its first observations."""
    env = environment(R, [scene], "training")
    return env, env.reset(seed=0)[0]


def poses_and_readings():
    """Returns reachable poses (150, 3), the first one too close to a wall, and the readings."""
    rng = np.random.default_rng(0)
    places = PLAIN.reachable[rng.integers(len(PLAIN.reachable), size=150)]
    poses = np.column_stack([places, rng.uniform(-3, 3, 150)])
    poses[0] = (1.14 - 0.075 - ROBOT_RADIUS - ring.BLIND / 2, PLAIN.start[1], 0.0)
    world = World([PLAIN] * 150)
    world.place(slice(None), poses)
    return poses, ring.listen(world)


def test_no_errors_give_the_simulation_and_a_late_image_is_one_period_old():
    one, first = started(PLAIN, environment=NavVecEnv)
    other, second = started(PLAIN)
    late, third = started(real(image_delay=1.0))
    before = first["image"]
    for actions in np.random.default_rng(0).uniform((0, -0.5), (0.5, 0.5), (12, 4, 2)):
        assert all(np.array_equal(first[key], second[key]) for key in first)
        assert np.array_equal(third["image"], before)
        before = first["image"]
        first, rewards, *_ = one.step(actions)
        second, others, *_ = other.step(actions)
        third, *_ = late.step(actions)
        assert np.array_equal(rewards, others) and late.is_late.all()
    assert environment_of([PLAIN]) is NavVecEnv and environment_of([PLAIN, LAB]) is RealVecEnv


def test_the_lab_is_registered_with_its_errors_and_needs_no_torch():
    env = gymnasium.make("robot:NavBot-lab-v1")
    env.reset(seed=0)
    assert env.unwrapped.vector.exposure == LAB.reality.exposure
    assert isinstance(gymnasium.make_vec("robot:NavBot-lab-v1", 2), RealVecEnv)
    code = ("import gymnasium, sys; sys.modules['torch'] = None; import robot.robot, robot.policy; "
            "gymnasium.make('robot:NavBot-lab-v1')")
    subprocess.run([sys.executable, "-c", code], check=True)


def test_each_wheel_has_its_gain_and_the_observed_velocity_is_the_commanded_one():
    env, _ = started(real(wheel_gains=(1.1, 0.9)), R=1)
    seen, _, _, _, infos = env.step(np.array([[0.5, 0.7]]))
    assert np.allclose(seen["velocity"], (0.15, 0.7))
    left = 1.1 * (0.15 - 0.7 * 0.23 / 2)
    right = 0.9 * (0.15 + 0.7 * 0.23 / 2)
    assert infos["command"][0] == pytest.approx([(left + right) / 2, (right - left) / 0.23])


def test_odometry_drifts_with_distance_and_angle():
    env, _ = started(real(FLOOR, distance_drift=0.1, turn_drift=0.2), R=2)
    drift = env._drift.copy()
    distance, turn = drift.T
    for _ in range(10):
        seen, *_ = env.step(np.tile([1.0, 0.0], (2, 1)))
    assert np.allclose(env.estimates[:, 0], 10 * 0.3 * CONTROL_PERIOD * (1 + distance))
    assert np.allclose(seen["target"], polar_targets(env.estimates, env.goals), atol=1e-5)
    for _ in range(10):
        env.step(np.tile([0.0, 1.0], (2, 1)))
    assert np.allclose(env.estimates[:, 2], wrap_angle(10 * CONTROL_PERIOD * (1 + turn)))
    env.reset()
    assert np.allclose(env.estimates, env.world.poses) and (env._drift != drift).all()


def test_a_camera_that_is_tilted_up_sees_all_rows_lower():
    images = np.random.default_rng(0).uniform(0, 255, (1, 48, 64, 3)).astype(np.float32)
    [half] = shift_rows(images, np.array([0.5]))
    assert np.allclose(half[1:], (images[0, 1:] + images[0, :-1]) / 2, atol=1e-3)
    _, plain = started(PLAIN, R=1)
    _, seen = started(real(camera_pitch=math.atan(3 / FOCAL)), R=1)
    assert np.abs(seen["image"][:, 3:].astype(int) - plain["image"][:, :-3]).max() <= 1


def test_exposure_white_balance_and_yaw_have_their_nominal_size():
    env, seen = started(real(exposure=0.8, white_balance=(1.1, 1.0, 0.9), camera_yaw=0.1), R=1)
    turned = env.world.poses + (0, 0, 0.1)
    painted = env.camera.render(env.scene_of, turned, env.goals) * 0.8 * np.array([1.1, 1.0, 0.9])
    assert np.abs(seen["image"] - painted).max() <= 0.51


def test_a_different_appearance_has_the_same_shapes():
    plain, lab = [started(real(appearance=name))[1]["image"] for name in ("simulation", "lab")]
    floor = (plain == (118, 118, 118)).all(-1)
    assert np.array_equal(floor, (lab == (134, 112, 84)).all(-1)) and floor.mean() > 0.1
    assert (plain != lab).mean() > 0.9


def test_random_errors_are_valid_and_new_in_every_episode():
    env, seen = started(PLAIN, R=3, environment=RandomVecEnv)
    exposure = env.exposure.copy()
    again, _ = env.reset()
    assert (env.exposure != exposure).all() and (seen["image"] != again["image"]).mean() > 0.9
    drawn = [env.draw_errors(0) for _ in range(300)]
    assert len({errors["appearance"] for errors in drawn}) > 60
    for name, item in ERRORS.items():
        values = np.array([errors[name] for errors in drawn])
        assert values.shape[1:] == np.shape(item.default)
        assert values.min() >= item.metadata["low"] and values.max() <= item.metadata["high"]


def test_the_observed_reward_is_by_odometry_and_a_subclass_may_change_it():
    class TripleReward(RealVecEnv):
        def reward(self, before, after, arrived, failed):
            return 3 * super().reward(before, after, arrived, failed)

    env, seen = started(real(distance_drift=0.3), environment=TripleReward)
    differs = False
    for step in np.tile([1.0, 0.2], (30, 4, 1)):  # into a wall
        before = seen["target"][:, 0].astype(float)
        seen, rewards, ended, _, infos = env.step(step)
        believed = 3 * (100 * (before - seen["target"][:, 0]) - STEP_COST)
        assert np.allclose(seen["last_reward"][~ended, 0], believed[~ended], atol=4e-3)
        differs |= np.abs(rewards - believed)[~ended].max(initial=0) > 0.5
        if ended.any():  # then the true reward is observed
            break
    assert differs and set(infos["final_obs"]["last_reward"][ended, 0]) == {3 * COLLISION_REWARD}


def closest(obstacle, command):
    """Returns the smallest distance [m] between an obstacle and a robot executing a command, in
    many small steps. Positions are complex numbers, x + iy [m]."""
    dt = (CONTROL_PERIOD + ring.LONGER) / 2000
    steps = command[0] * dt * np.exp(1j * command[1] * dt * np.arange(1, 2001))
    return min(abs(obstacle), np.abs(obstacle - steps.cumsum()).min())


@pytest.mark.parametrize("command", [(0.3, 0.0), (0.3, 0.9), (0.3, -0.9), (0.05, 0.5)])
def test_the_ring_blocks_near_obstacles_ahead_and_missing_readings(command):
    for sensor, angle in enumerate(ring.ANGLES):
        for away in (np.nan, -1.0, 0.0, 0.01, 0.03, 0.06, 0.12, 0.2):
            readings = np.full(ring.SENSORS, ring.RANGE)
            readings[sensor] = away
            r = ROBOT_RADIUS + away
            nearest = closest(r * np.exp(1j * angle), command)
            if abs(nearest - ROBOT_RADIUS - ring.BESIDE) < 2e-3 or abs(nearest - r) < 1e-4:
                continue  # too close to a limit for this approximation
            blocks = not away > 0 or nearest < min(ROBOT_RADIUS + ring.BESIDE, r)
            expected = blocks and math.cos(angle) > 1e-9
            assert ring.is_blocked(readings, command) == expected, (sensor, away)


def test_a_reading_is_the_nearest_obstacle_in_the_cone_outside_the_blind_zone():
    poses, all_readings = poses_and_readings()
    assert np.isnan(all_readings[0, 0])
    r = np.linspace(0, ring.RANGE + ROBOT_RADIUS, 2000)
    for pose, readings in zip(poses[:6], all_readings):
        for angle, reading in zip(ring.ANGLES, readings):
            rays = pose[2] + angle + np.linspace(-0.5, 0.5, 3) * ring.CONE
            points = pose[:2] + r[:, None, None] * np.stack([np.cos(rays), np.sin(rays)], -1)
            inside = (PLAIN.clearance(points) < 0).any(1)
            nearest = r[inside.argmax()] if inside.any() else r[-1]
            if nearest - ROBOT_RADIUS > ring.BLIND + 2e-3:
                assert reading == pytest.approx(nearest - ROBOT_RADIUS, abs=2e-3)


def test_the_ring_allows_turns_and_standing_for_ten_seconds_ends_an_episode():
    before_a_wall = (-3.71 + 0.075 + ROBOT_RADIUS + 0.03, -2.9, math.pi)  # 3 cm
    env, _ = started(LAB, R=1, environment=RingVecEnv)
    env.reset(options={"start": before_a_wall, "target": 0})
    for _ in range(24):
        _, _, [terminated], _, _ = env.step(np.array([[1.0, 0.01]]))
        assert not terminated and env.asked.tolist() == [[0.0, 0.01]]
    _, reward, [terminated], _, infos = env.step(np.array([[1.0, 0.01]]))
    assert terminated and reward == COLLISION_REWARD and infos["final_info"]["stops"] == 25
    assert env.outcomes[infos["final_info"]["outcome"][0]] == "standing"


class Ahead:
    """A policy that drives to the target, ignores walls and records its observations."""

    def reset(self):
        self.seen = []

    def act(self, observation):
        self.seen.append(observation)
        bearing = observation["target"][1]
        return np.array([max(math.cos(bearing), 0), np.clip(2 * bearing, -1, 1)])


class Faulty(LabRobot):
    """A LabRobot with a sensor that returns `fault(value, period)`. `sent` records commands."""

    def __init__(self, sensor="image", fault=lambda value, period: value):
        super().__init__(real(LAB, appearance="lab"), 4)
        self.sent = []
        measure = getattr(self, sensor)
        setattr(self, sensor, lambda: fault(measure(), self._periods))

    def send(self, linear, angular):
        self.sent.append((linear, angular))
        super().send(linear, angular)


def test_a_policy_reaches_the_target_and_has_the_observations_of_the_simulation():
    robot = Faulty("image", lambda true, period: true._replace(time=true.time - 0.8))
    policy = Ahead()
    log = drive(robot, policy, robot.goal)
    assert log.outcome == robot.outcome == "arrival" and robot.sent[-1] == (0, 0)
    assert log.waits == 0 and len(log.readings) == len(robot.sent) - 1
    env, _ = started(replace(LAB, reality=None), R=1, environment=NavVecEnv)
    seen, _ = env.reset(options={"target": 4})
    for observation in policy.seen[:6]:
        for key in ("target", "velocity", "last_reward"):
            assert np.allclose(observation[key], seen[key][0], atol=1e-4)
        seen, *_ = env.step(policy.act(observation)[None])


@pytest.mark.parametrize("sensor", ["image", "odometry", "ranges"])
@pytest.mark.parametrize("broken", [
    lambda true: None, lambda true: true._replace(value=true.value * np.nan),
    lambda true: true._replace(time=1e9), lambda true: true._replace(time=true.time - 0.81)])
def test_the_robot_moves_forward_only_with_valid_measurements(sensor, broken):
    robot = Faulty(sensor, lambda true, period: broken(true) if period < 3 else true)
    log = drive(robot, Ahead(), robot.goal, periods=6)
    assert [linear > 0 for linear, _ in robot.sent] == [False] * 3 + [True] * 3 + [False]
    assert (log.stops, log.waits) == ((3, 0) if sensor == "ranges" else (0, 3))
    turns = any(angular != 0 for _, angular in robot.sent[:3])
    assert turns == (sensor == "ranges")  # the ring allows turns


@pytest.mark.parametrize("action, delay", [((1.0, np.nan), 0), ((1.0, 0.0), 3)])
def test_an_invalid_or_late_action_does_not_reach_the_wheels(action, delay):
    def act(_):
        robot._periods += delay  # the policy takes this long
        return np.array(action)

    robot = Faulty()
    log = drive(robot, SimpleNamespace(reset=list, act=act), robot.goal, periods=3)
    assert set(robot.sent) == {(0, 0)} and log.waits == 3


def test_an_invalid_goal_is_refused():
    with pytest.raises(ValueError, match="must be two finite numbers"):
        drive(Faulty(), Ahead(), (np.nan, 0.0))


def test_a_late_robot_does_not_catch_up_and_an_exception_stops_the_wheels():
    def act(_):
        if robot.now() > 3:
            raise KeyboardInterrupt
        robot._periods = max(robot._periods, 5)  # the first action takes five periods
        return np.array([0.3, 0.0])

    robot = Faulty()
    with pytest.raises(KeyboardInterrupt):
        drive(robot, SimpleNamespace(reset=list, act=act), robot.goal)
    assert robot.sent[-1] == (0, 0) and robot.sent[-2] != (0, 0) and len(robot.sent) == 6


def test_the_map_is_free_on_the_floor_and_occupied_at_the_walls():
    grid = OccupancyGrid(PLAIN.bounds)
    for pose, readings in zip(*poses_and_readings()):
        grid.add(pose, readings)
    clearance = PLAIN.clearance(grid.centres)
    known = grid.log_odds != 0
    free = known & (clearance > 0.15)
    assert free.sum() > 500 and (grid.probability[free] < 0.5).mean() > 0.97
    at_face = known & (np.abs(clearance) < 0.03)
    assert (grid.probability[at_face] > 0.5).mean() > 0.6
