"""Each test is the shortest proof of one claim about what reality does to a robot, and about what
drives one."""

import math
from dataclasses import replace

import numpy as np
import pytest
import torch

import scenes
from model import make_network
from navbot_min import COLLISION, COLLISION_REWARD, OUTCOMES, NavVecEnv, polar_targets
from render import FOCAL
from robot import lens, ring
from robot.environment import RandomVecEnv, RealVecEnv, RingVecEnv, drawn_knobs, environment_of
from robot.lab import LabRobot
from robot.looks import DRAWN_LOOKS
from robot.mapping import OccupancyGrid
from robot.policy import TorchPolicy
from robot.robot import Stamped, drive, next_period
from scenes.generate import NARROWEST
from scenes.reality import KNOBS, Reality, parse_reality
from sim import (CONTROL_PERIOD, MAX_LINEAR_VELOCITY, ROBOT_RADIUS, Box, Scene, SceneError,
                 wrap_angle)

PLAIN = scenes.load("env2")
LAB = scenes.load("lab")


def real(**knobs):
    """env2 with those knobs."""
    return replace(PLAIN, reality=Reality(**knobs))


def started(scene, R=4, environment=RealVecEnv, seed=0):
    """An environment whose robots stand at the start pose, and what they see."""
    env = environment(R, [scene], "training")
    seen, _ = env.reset(seed=seed)
    return env, seen


def some_actions(R, steps, seed=0):
    """Actions (steps, R, 2)."""
    rng = np.random.default_rng(seed)
    return np.stack([rng.uniform(0, 1, (steps, R)), rng.uniform(-1, 1, (steps, R))], -1)


# ----------------------------------------------------------------------------------- the scene file


def test_a_rooms_knobs_are_those_of_its_file_and_its_weights_bring_them_along():
    from dataclasses import asdict
    assert LAB.reality.camera_yaw == math.radians(2.0)
    assert LAB.reality.white_balance == (1.06, 1.0, 0.9)
    assert all(scenes.load(name).reality is None for name in scenes.names() if name != "lab")
    assert scenes.rebuild(asdict(LAB)) == LAB
    assert scenes.rebuild(asdict(PLAIN)) == PLAIN


@pytest.mark.parametrize("table, words", [
    (3, "reality is 3, it must be a table"),
    ({"nois": 3}, "unknown key 'nois'; known: look, exposure"),
    ({"image_noise": -1}, "reality.image_noise is -1, it must be from 0 to 100"),
    ({"image_noise": float("nan")}, "reality.image_noise is nan"),
    ({"image_noise": "6"}, "reality.image_noise is '6'"),
    ({"look": "moon"}, "reality.look is 'moon', it must be one of simulation, lab"),
    ({"white_balance": [1, 2]}, "reality.white_balance is [1, 2], it must be a list of 3"),
    ({"white_balance": [1, 2, 9]}, "reality.white_balance[2] is 9, it must be from 0.2 to 5"),
    ({"camera_yaw": 0.1}, "unknown key 'camera_yaw'"),
    ({"camera_yaw_degrees": 40}, "reality.camera_yaw_degrees is 40, it must be from -17 to 17")])
def test_a_knob_that_is_not_valid_is_named_with_what_is(table, words):
    with pytest.raises(SceneError) as error:
        parse_reality(table)
    assert words in str(error.value)


# --------------------------------------------------------------------------------------- no reality


def test_without_knobs_reality_is_the_simulation():
    one, first = started(PLAIN, environment=NavVecEnv)
    other, second = started(PLAIN)
    for actions in some_actions(4, 12):
        for key in first:
            assert np.array_equal(first[key], second[key]), key
        first, rewards, *_ = one.step(actions)
        second, others, *_ = other.step(actions)
        assert np.array_equal(rewards, others)
    assert environment_of([PLAIN]) is NavVecEnv and environment_of([PLAIN, LAB]) is RealVecEnv


# ------------------------------------------------------------------------------------------- wheels


def test_wheels_follow_with_a_lag_as_fine_steps_of_its_equation_say():
    lag = 0.3
    env, _ = started(real(lag=lag), R=1)
    speeds = np.zeros(2)  # left, right
    for v, w in ((0.3, 0.0), (0.3, 1.0), (0.0, -1.0)):
        told = np.array([v - w * 0.23 / 2, v + w * 0.23 / 2])
        way = np.zeros(2)
        for _ in range(20_000):
            dt = CONTROL_PERIOD / 20_000
            speeds = speeds + (told - speeds) / lag * dt
            way += speeds * dt
        mean = way / CONTROL_PERIOD
        [motion] = env.turned(np.array([[v, w]]))
        assert motion == pytest.approx([mean.mean(), (mean[1] - mean[0]) / 0.23], abs=1e-4)


def test_a_wheel_with_a_gain_turns_by_it_and_one_that_is_told_too_little_stands():
    env, _ = started(real(wheel_gains=(1.1, 0.9), dead_zone=0.1), R=1)
    [motion] = env.turned(np.array([[0.2, 0.0]]))
    assert motion == pytest.approx([0.2, (0.9 - 1.1) * 0.2 / 0.23])
    [motion] = env.turned(np.array([[0.15, 1.0]]))  # left 0.035, right 0.265
    assert motion == pytest.approx([0.9 * 0.265 / 2, 0.9 * 0.265 / 0.23])


def test_periods_jitter_around_the_nominal_one():
    env, _ = started(real(period_jitter=0.1), R=500)
    motion = env.command(np.tile([1.0, 0.5], (500, 1)))
    periods = motion[:, 0] / MAX_LINEAR_VELOCITY
    assert np.allclose(motion[:, 1] / 0.5, periods)
    assert abs(periods.mean() - 1) < 0.02 and abs(periods.std() - 0.1) < 0.015


# ----------------------------------------------------------------------------------------- odometry


def test_odometry_without_drift_is_the_true_pose_and_with_drift_is_off_by_it():
    env, seen = started(real(distance_drift=1e-9), R=3)
    for actions in some_actions(3, 10):
        env.step(0.5 * actions)
        assert np.allclose(env.estimates, env.world.poses, atol=1e-7)
    open_floor = Scene("floor", tuple(
        Box("wall", x, y, 0.0, length, thickness, 2.0)
        for x, y, length, thickness in ((-6, 0, 0.1, 12), (6, 0, 0.1, 12), (0, -6, 12, 0.1),
                                        (0, 6, 12, 0.1))),
        (0.0, 0.0, 0.0), ((3.0, 0.0),), (), reality=Reality(distance_drift=0.1, veer=0.1))
    env, _ = started(open_floor, R=1)
    distance, _, veer = env._drift[0]
    for _ in range(10):
        seen, *_ = env.step(np.array([[1.0, 0.0]]))
    way = 10 * 0.3 * CONTROL_PERIOD
    x, y, heading = env.estimates[0]
    assert heading == pytest.approx(veer * way) and env.world.poses[0, 2] == 0
    # An arc of that length, in ten chords.
    assert math.hypot(x, y) == pytest.approx(way * (1 + distance), rel=1e-3)
    assert seen["target"] == pytest.approx(polar_targets(env.estimates, env.goals), abs=1e-5)


def test_turns_drift_by_the_angle_turned_and_every_episode_begins_at_the_true_pose():
    env, _ = started(real(turn_drift=0.2), R=2, seed=1)
    for _ in range(20):
        env.step(np.tile([0.0, 1.0], (2, 1)))
    turned = 20 * CONTROL_PERIOD
    expected = PLAIN.start[2] + turned * (1 + env._drift[:, 1])
    assert np.allclose(env.estimates[:, 2], wrap_angle(expected)) and (env._drift[:, 1] != 0).all()
    drift = env._drift.copy()
    env.reset()
    assert np.allclose(env.estimates, env.world.poses) and (env._drift[:, 1] != drift[:, 1]).all()


# ------------------------------------------------------------------------------------------- camera


def test_a_camera_that_looks_up_sees_all_rows_lower():
    images = np.random.default_rng(0).uniform(0, 255, (2, 48, 64, 3)).astype(np.float32)
    moved = lens.shift_rows(images, np.array([2.0, 0.5]))
    assert np.allclose(moved[0, 2:], images[0, :-2]) and np.allclose(moved[0, :2], images[0, 0])
    assert np.allclose(moved[1, 1:], (images[1, 1:] + images[1, :-1]) / 2, atol=1e-3)


def test_a_blur_is_a_gaussian():
    images = np.zeros((1, 48, 64, 3), np.float32)
    images[0, 24, 32] = 1.0
    sigma = 1.3
    found = lens.blurred(images, np.array([sigma]))[0, :, :, 0]
    y, x = np.mgrid[:48, :64] - np.array([24, 32])[:, None, None]
    expected = np.exp(-(x ** 2 + y ** 2) / (2 * sigma ** 2))
    assert np.allclose(found, expected / expected.sum(), atol=2e-3)
    plain = np.full((1, 48, 64, 3), 77, np.float32)
    assert np.allclose(lens.blurred(plain, np.array([2.0])), 77, atol=1e-3)


def test_exposure_white_balance_and_noise_are_as_large_as_they_say():
    env, seen = started(real(exposure=0.8, white_balance=(1.1, 1.0, 0.9), image_noise=5.0), R=8)
    painted = env.camera.render(env.scene_of, env.world.poses, env.goals).astype(float)
    expected = painted * 0.8 * np.array([1.1, 1.0, 0.9])
    difference = (seen["image"] - expected)[(expected > 25) & (expected < 230)]
    assert abs(difference.mean()) < 0.1 and abs(difference.std() - 5.0) < 0.1


def test_a_camera_that_is_mounted_askew_looks_to_the_left_by_its_yaw_and_up_by_its_pitch():
    env, seen = started(real(camera_yaw=0.1), R=1)
    turned = env.world.poses + (0, 0, 0.1)
    expected = env.camera.render(env.scene_of, turned, env.goals)
    assert np.array_equal(seen["image"], expected)
    _, plain = started(PLAIN, R=1)
    _, seen = started(real(camera_pitch=math.atan(3 / FOCAL)), R=1)  # three rows
    assert np.abs(seen["image"][:, 3:].astype(int) - plain["image"][:, :-3]).max() <= 1


def test_a_policy_is_shown_the_velocity_that_it_asked_for_and_at_first_none():
    env, _ = started(real(lag=0.5, wheel_gains=(1.2, 0.8)), R=2)
    for _ in range(3):
        seen, *_ = env.step(np.tile([1.0, 0.5], (2, 1)))
    assert np.allclose(seen["velocity"], (MAX_LINEAR_VELOCITY, 0.5))
    seen, _ = env.reset()
    assert (seen["velocity"] == 0).all() and np.allclose(env.turned(np.zeros((2, 2))), 0)


def test_light_changes_from_one_episode_to_the_next_and_not_within_one():
    env, seen = started(real(light_change=0.3), R=64)
    first = env._light.copy()
    assert abs(np.log(first).std() - 0.3) < 0.1
    env.step(np.zeros((64, 2)))
    assert np.array_equal(env._light, first)
    env.reset()
    assert (env._light != first).all()


def test_an_image_that_is_late_is_the_one_before_and_a_dropped_one_brings_nothing_new():
    exact, truth = started(PLAIN, R=1, environment=NavVecEnv)
    env, seen = started(real(image_delay=1.0), R=1)
    before = truth["image"]
    for actions in some_actions(1, 6):
        assert np.array_equal(seen["image"], before)
        before = truth["image"]
        truth, *_ = exact.step(actions)
        seen, *_ = env.step(actions)
    env, seen = started(real(dropped_images=0.5), R=1)
    _, truth = started(PLAIN, R=1, environment=NavVecEnv)
    exact.reset(seed=0)
    ages = []
    taken = [seen["image"]]
    for actions in some_actions(1, 20):
        truth, *_ = exact.step(0.3 * actions)
        seen, *_ = env.step(0.3 * actions)
        taken.append(truth["image"])
        age = int(env.image_ages[0])
        ages.append(age)
        assert np.array_equal(seen["image"], taken[-1 - age])
    assert {0, 1, 2} <= set(ages)


def test_a_room_that_looks_otherwise_has_the_same_shapes():
    seen = RealVecEnv(1, [replace(LAB, reality=Reality(look="lab"))])
    plain = RealVecEnv(1, [replace(LAB, reality=Reality())])
    image = seen.reset(seed=0)[0]["image"]
    assert (image != plain.reset(seed=0)[0]["image"]).mean() > 0.9
    image = seen.camera.render(np.zeros(1, int), np.array([[0.6, -2.6, 2.9]]), np.zeros((1, 2)))
    other = plain.camera.render(np.zeros(1, int), np.array([[0.6, -2.6, 2.9]]), np.zeros((1, 2)))
    floor = [(picture == colour).all(-1) for picture, colour in
             ((image, seen.camera.cameras["lab"].floor), (other, (118, 118, 118)))]
    assert np.array_equal(*floor) and floor[0].mean() > 0.1


# ------------------------------------------------------------------------------------ drawn reality


def test_a_drawn_reality_is_within_what_a_file_may_hold_and_new_every_episode():
    env, _ = started(PLAIN, R=8, environment=RandomVecEnv)
    looks = set()
    for k in range(12):
        env.reset(seed=k)
        looks |= set(env.looks.tolist())
    assert len(looks) > 40 and looks <= set(range(DRAWN_LOOKS))
    drawn = [drawn_knobs(np.random.default_rng(k)) for k in range(300)]
    for name, item in KNOBS.items():
        values = np.array([knobs[name] for knobs in drawn])
        assert values.shape[1:] == np.shape(item.default)
        assert values.min() >= item.metadata["low"] and values.max() <= item.metadata["high"]
        assert np.ptp(values, axis=0).min() > 0, name
    env, _ = started(PLAIN, R=3, environment=RandomVecEnv)
    first = {name: getattr(env, name).copy() for name in KNOBS}
    env.reset()
    assert all((getattr(env, name) != first[name]).any() for name in KNOBS)


# ----------------------------------------------------------------------------------------- the ring


def swept(thing, command):
    """How near [m] a robot that obeys a command comes to a thing (2,) [m]: by many small steps."""
    place = np.zeros(2)
    heading = 0.0
    nearest = np.hypot(*thing)
    for _ in range(2000):
        dt = (CONTROL_PERIOD + ring.LONGER) / 2000
        heading += command[1] * dt
        place += command[0] * dt * np.array([math.cos(heading), math.sin(heading)])
        nearest = min(nearest, np.hypot(*(thing - place)))
    return nearest


FREE = np.full(ring.SENSORS, ring.RANGE)
COMMANDS = [(0.3, 0.0), (0.3, 0.9), (0.3, -0.9), (0.05, 0.5)]


@pytest.mark.parametrize("command", COMMANDS)
def test_a_thing_blocks_where_the_way_would_come_too_near_to_it(command):
    for sensor, angle in enumerate(ring.ANGLES):
        for away in (0.01, 0.03, 0.06, 0.12, 0.2):
            readings = FREE.copy()
            readings[sensor] = away
            r = ROBOT_RADIUS + away
            nearest = swept(r * np.array([math.cos(angle), math.sin(angle)]), command)
            if abs(nearest - ROBOT_RADIUS - ring.BESIDE) < 2e-3 or abs(nearest - r) < 1e-4:
                continue  # too near to either limit for this twin to tell
            expected = math.cos(angle) > 1e-9 and nearest < min(ROBOT_RADIUS + ring.BESIDE, r)
            assert ring.is_blocked(readings, command) == expected, (sensor, away)


@pytest.mark.parametrize("value", [0.0, np.nan, -1.0])
def test_what_is_no_reading_blocks_the_way_where_it_counts(value):
    ahead = (0.3, 0.0)
    assert not ring.is_blocked(FREE, ahead)
    for sensor, angle in enumerate(ring.ANGLES):
        readings = FREE.copy()
        readings[sensor] = value
        assert ring.is_blocked(readings, ahead) == (math.cos(angle) > 1e-9)
    assert all(ring.is_blocked(none, ahead) for none in (None, FREE[:-1], []))
    assert not ring.is_blocked(FREE, ahead, ages=2 * CONTROL_PERIOD)
    assert all(ring.is_blocked(FREE, ahead, ages=age)
               for age in (3 * CONTROL_PERIOD, np.nan, -1.0))


def test_the_ring_lets_a_robot_through_the_narrowest_passage():
    width = NARROWEST
    walls_beside = width / 2 / np.abs(np.sin(ring.ANGLES)).clip(1e-9)
    readings = np.minimum(walls_beside - ROBOT_RADIUS, ring.RANGE)
    assert not ring.is_blocked(readings, (0.3, 0.0))
    assert ring.is_blocked(readings, (0.3, 0.9)) and ring.is_blocked(readings, (0.3, -0.9))


def test_with_the_ring_bends_towards_corners_end_in_no_collision():
    """A driver that weaves at full speed, in the lab, 16 robots for 300 periods."""
    hits = {}
    for environment in (RealVecEnv, RingVecEnv):
        env, _ = started(LAB, R=16, environment=environment)
        rng = np.random.default_rng(0)
        hits[environment] = 0
        for k in range(300):
            turn = np.where(rng.random(16) < 0.5, 0.9, -0.9) if k % 5 == 0 else turn
            _, _, _, _, infos = env.step(np.column_stack([np.ones(16), turn]))
            ended = infos.get("_final_info", np.zeros(16, bool))
            if ended.any():
                hits[environment] += int((infos["final_info"]["outcome"][ended] == COLLISION).sum())
    assert hits[RealVecEnv] > 50 and hits[RingVecEnv] <= 1  # one may begin within a cell of a wall


def test_the_ring_hears_the_nearest_thing_in_a_cone():
    env, _ = started(PLAIN, R=6)
    rng = np.random.default_rng(0)
    places = PLAIN.reachable[rng.integers(len(PLAIN.reachable), size=6)]
    poses = np.column_stack([places, rng.uniform(-3, 3, 6)])
    env.world.place(slice(None), poses)
    heard = ring.listen(env.world, np.zeros(6), np.zeros(6), rng)
    for pose, readings in zip(poses, heard):
        for angle, reading in zip(ring.ANGLES, readings):
            rays = pose[2] + angle + np.linspace(-0.5, 0.5, 3) * ring.CONE
            r = np.linspace(0, ring.RANGE + ROBOT_RADIUS, 4000)
            points = pose[:2] + r[:, None, None] * np.stack([np.cos(rays), np.sin(rays)], -1)
            inside = (PLAIN.clearance(points) < 0).any(1)
            nearest = r[inside.argmax()] if inside.any() else r[-1]
            if nearest - ROBOT_RADIUS > ring.BLIND + 1e-3:
                assert reading == pytest.approx(nearest - ROBOT_RADIUS, abs=2e-3)


def test_readings_have_their_noise_drop_out_and_are_none_in_the_blind_zone():
    env, _ = started(PLAIN, R=400)
    rng = np.random.default_rng(0)
    places = PLAIN.reachable[rng.integers(len(PLAIN.reachable), size=400)]
    env.world.place(slice(None), np.column_stack([places, rng.uniform(-3, 3, 400)]))
    exact = ring.listen(env.world, np.zeros(400), np.zeros(400), rng)
    heard = ring.listen(env.world, np.full(400, 0.01), np.full(400, 0.1), rng)
    assert abs(np.isnan(heard).mean() - 0.1) < 0.02
    inside = (exact > 0.1) & (exact < ring.RANGE - 0.1) & ~np.isnan(heard)
    assert abs((heard - exact)[inside].std() - 0.01) < 0.001
    no_echo = (exact == ring.RANGE) & ~np.isnan(heard)
    assert no_echo.any() and (heard[no_echo] == ring.RANGE).all()
    x, y, _ = PLAIN.start
    beside = [1.14 - 0.075 - ROBOT_RADIUS - ring.BLIND / 2, y, 0.0]  # the east wall, ahead
    env.world.place(slice(None), np.tile(beside, (400, 1)))
    assert np.isnan(ring.listen(env.world, np.zeros(400), np.zeros(400), rng)[:, 0]).all()


def test_the_ring_keeps_a_robot_from_the_wall_refuses_no_turn_and_standing_ends_the_episode():
    env, _ = started(LAB, R=8, environment=RingVecEnv)
    rng = np.random.default_rng(3)
    places = LAB.reachable[rng.integers(len(LAB.reachable), size=8)]
    starts = np.column_stack([places, rng.uniform(-3, 3, 8)])
    env.reset(seed=0, options={"start": starts, "target": np.zeros(8, int)})
    ends = {}
    for _ in range(80):
        _, paid, terminated, _, infos = env.step(np.tile([1.0, 0.0], (8, 1)))
        for r in set(np.flatnonzero(terminated)) - set(ends):
            ends[r] = OUTCOMES[infos["final_info"]["outcome"][r]]
            if ends[r] == "standing":
                assert infos["final_info"]["stops"][r] >= 25 and paid[r] == COLLISION_REWARD
    assert "standing" in ends.values() and set(ends.values()) <= {"standing", "arrival"}
    wanted = np.tile([0.3, 0.7], (8, 1))
    blocked = env.stopped(wanted)
    assert np.array_equal(blocked[:, 1], wanted[:, 1])
    deaf, _ = started(real(range_dropouts=1.0), R=8, environment=RingVecEnv)
    assert np.array_equal(deaf.stopped(wanted), wanted * (0, 1))  # readings that drop out block


def test_without_the_ring_standing_ends_nothing():
    env, _ = started(LAB, R=2, environment=RealVecEnv)
    for _ in range(60):
        _, _, terminated, _, _ = env.step(np.tile([0.0, 0.5], (2, 1)))
        assert not terminated.any()


def test_the_last_reward_is_paid_by_odometry_and_tells_no_more_than_the_target():
    drifting = replace(PLAIN, reality=Reality(distance_drift=0.3, veer=0.2))
    env, seen = started(drifting, R=8, environment=RealVecEnv)
    before = seen["target"][:, 0].astype(float)
    differs = False
    for step in some_actions(8, 12):
        seen, paid, terminated, truncated, _ = env.step(step)
        goes_on = ~(terminated | truncated)
        distance = seen["target"][:, 0].astype(float)
        believed = 100 * (before - distance) - 0.05
        assert np.allclose(seen["last_reward"][goes_on, 0], believed[goes_on], atol=1e-3)
        assert (seen["last_reward"][~goes_on] == 0).all()
        differs |= bool(np.abs(paid - believed)[goes_on].max(initial=0) > 0.5)
        before = distance
    assert differs


# ---------------------------------------------------------------------------------------- the state


@pytest.mark.parametrize("environment", [RingVecEnv, RandomVecEnv])
def test_an_environment_goes_on_from_its_state_exactly(environment):
    env, _ = started(LAB, R=3, environment=environment)
    actions = some_actions(3, 16)
    for step in actions[:8]:
        env.step(step)
    state = env.state()
    after = [env.step(step)[0] for step in actions[8:]]
    other, _ = started(LAB, R=3, environment=environment, seed=5)
    other.load_state(state)
    for step, expected in zip(actions[8:], after):
        seen, *_ = other.step(step)
        assert all(np.array_equal(seen[key], expected[key]) for key in seen)


# ----------------------------------------------------------------------------------- a robot drives


class Ahead:
    """A policy that drives to the target, blind to walls, and keeps what it saw."""

    def __init__(self):
        self.seen = []

    def reset(self):
        self.seen = []

    def act(self, observation):
        self.seen.append(observation)
        bearing = observation["target"][1]
        return np.array([max(math.cos(bearing), 0), np.clip(2 * bearing, -1, 1)])


class Faulty(LabRobot):
    """The lab's robot with a fault: `fault` changes what a sensor gives, by its name and the
    period; `sent` keeps what its wheels were told."""

    def __init__(self, fault=None, **options):
        self.fault = fault or (lambda name, period, value: value)
        self.sent = []
        super().__init__(replace(LAB, reality=Reality(look="lab")), 4, **options)

    def image(self):
        return self.fault("image", self._periods, super().image())

    def odometry(self):
        return self.fault("odometry", self._periods, super().odometry())

    def ranges(self):
        return self.fault("ranges", self._periods, super().ranges())

    def send(self, linear, angular):
        self.sent.append((linear, angular))
        super().send(linear, angular)


def test_a_policy_drives_the_lab_as_a_robot_to_its_target():
    robot = Faulty()
    log = drive(robot, Ahead(), robot.goal)
    assert log.outcome == robot.outcome == "arrival" and robot.sent[-1] == (0, 0)
    assert log.waits == 0 and len(log.commands) == len(robot.sent) - 1


@pytest.mark.parametrize("broken", [
    None, Stamped(None, 0.0), Stamped(np.zeros((48, 64), np.uint8), 99.0),
    Stamped(np.zeros((48, 64, 3)), 99.0), Stamped("image", 99.0)])
def test_without_an_image_the_wheels_are_stopped_until_one_comes(broken):
    robot = Faulty(lambda name, period, value: broken if name == "image" and 3 <= period < 9
                   else value)
    log = drive(robot, Ahead(), robot.goal)
    assert robot.sent[3:9] == [(0, 0)] * 6 and log.waits == 6
    assert robot.sent[2] != (0, 0) and log.outcome == "arrival"


def test_one_image_that_is_late_changes_nothing_and_one_that_is_older_stops_the_wheels():
    def late(name, period, value):
        return Stamped(value.value, value.time - 0.4 * period) if name == "image" else value
    robot = Faulty(late)
    log = drive(robot, Ahead(), robot.goal, periods=8)
    assert [sent == (0, 0) for sent in robot.sent[:8]] == [False] * 3 + [True] * 5
    assert log.waits == 5 and log.outcome == "timeout"


@pytest.mark.parametrize("broken", [None, Stamped((0.0, np.nan, 0.0), 99.0), Stamped((0, 0), 99.0),
                                    Stamped((0.6, -2.6, 0.0), -1.0)])
def test_without_odometry_the_wheels_are_stopped(broken):
    robot = Faulty(lambda name, period, value: broken if name == "odometry" and period == 2
                   else value)
    drive(robot, Ahead(), robot.goal, periods=4)
    assert [sent == (0, 0) for sent in robot.sent[:4]] == [False, False, True, False]


@pytest.mark.parametrize("broken", [None, Stamped(None, 99.0), Stamped(FREE[1:], 99.0),
                                    Stamped(FREE * np.nan, 99.0), Stamped(FREE, -1.0)])
def test_without_ranges_forward_motion_is_refused_and_turning_is_not(broken):
    robot = Faulty(lambda name, period, value: broken if name == "ranges" else value)
    log = drive(robot, Ahead(), robot.goal, periods=5)
    assert all(linear == 0 for linear, _ in robot.sent) and log.stops == 5
    assert any(angular != 0 for _, angular in robot.sent)


@pytest.mark.parametrize("name", ["image", "odometry", "ranges"])
@pytest.mark.parametrize("time", [np.nan, 1e9, None])
def test_a_time_stamp_of_the_future_or_none_is_no_measurement(name, time):
    robot = Faulty(lambda which, period, value: value._replace(time=time) if which == name
                   else value)
    log = drive(robot, Ahead(), robot.goal, periods=4)
    assert all(linear == 0 for linear, _ in robot.sent)
    assert log.stops + log.waits == 4


@pytest.mark.parametrize("action", [(np.nan, 0.0), (1.0, np.nan)])
def test_an_action_that_is_no_number_never_gets_to_the_wheels(action):
    class Lost(Ahead):
        def act(self, observation):
            return np.array(action)
    robot = Faulty()
    log = drive(robot, Lost(), robot.goal, periods=3)
    assert set(robot.sent) == {(0, 0)} and log.waits == 3


def test_a_policy_that_thinks_until_its_image_is_out_of_date_does_not_drive_by_it():
    robot = Faulty()

    class Slow(Ahead):
        def act(self, observation):
            robot._periods += 3  # pass while it thinks
            return super().act(observation)
    log = drive(robot, Slow(), robot.goal, periods=3)
    assert set(robot.sent) == {(0, 0)} and log.waits == 3


@pytest.mark.parametrize("goal", [(np.nan, 0.0), (3.0, 0.0, 9.0), (3.0,), "home", None])
def test_a_goal_that_is_no_place_is_refused_before_anything_moves(goal):
    robot = Faulty()
    with pytest.raises(ValueError, match="must be two finite numbers"):
        drive(robot, Ahead(), goal)
    assert robot.sent == []


def test_whoever_is_late_does_not_catch_up_and_a_clock_that_is_set_makes_nobody_wait():
    assert next_period(due=4.0, now=4.01) == pytest.approx(4.4)
    assert next_period(due=4.0, now=9.0) == 9.0
    assert next_period(due=4.0, now=-3600.0) == pytest.approx(-3599.6)


@pytest.mark.parametrize("error", [KeyboardInterrupt, RuntimeError])
def test_whatever_ends_a_drive_stops_the_wheels_first(error):
    class Ends(Ahead):
        def act(self, observation):
            if len(self.seen) == 3:
                raise error
            return super().act(observation)
    robot = Faulty()
    with pytest.raises(error):
        drive(robot, Ends(), robot.goal)
    assert robot.sent[-1] == (0, 0) and robot.sent[-2] != (0, 0)


def test_the_rewards_that_a_drive_shows_its_policy_are_those_of_the_simulation():
    robot = Faulty()
    policy = Ahead()
    env, seen = started(replace(LAB, reality=None), R=1, environment=NavVecEnv)
    seen, _ = env.reset(options={"target": 4})
    drive(robot, policy, robot.goal, periods=6)
    for observation in policy.seen:
        assert all(np.allclose(observation[key], seen[key][0], atol=1e-4)
                   for key in ("target", "velocity", "last_reward"))
        seen, *_ = env.step(policy.act(observation)[None])
        policy.seen.pop()


# -------------------------------------------------------------------------------------------- a map


def test_a_map_of_exact_readings_is_free_where_the_floor_is_and_occupied_at_the_walls():
    env, _ = started(PLAIN, R=1)
    grid = OccupancyGrid(PLAIN.bounds)
    rng = np.random.default_rng(0)
    for place in PLAIN.reachable[rng.integers(len(PLAIN.reachable), size=150)]:
        pose = np.array([*place, rng.uniform(-3, 3)])
        env.world.place([0], pose[None])
        [readings] = ring.listen(env.world, np.zeros(1), np.zeros(1), rng)
        grid.add(pose, readings)
    clearance = PLAIN.clearance(grid.centres)
    known = grid.log_odds != 0
    free = known & (clearance > 0.15)
    assert free.sum() > 500 and (grid.probability[free] < 0.5).mean() > 0.97
    at_face = known & (np.abs(clearance) < 0.03)
    assert (grid.probability[at_face] > 0.5).mean() > 0.6


def test_a_policy_for_one_robot_remembers_until_it_is_reset():
    network = make_network(0)
    env = NavVecEnv(1, ["env2"])
    seen, _ = env.reset(seed=0)
    policy = TorchPolicy(network)
    memory = network.initial_state(1)
    first = None
    for _ in range(4):
        action = policy.act({name: value[0] for name, value in seen.items()})
        expected, _, _, _, memory = network.act(seen, memory, torch.Generator())
        assert np.allclose(action, expected[0])
        first = action if first is None else first
    assert not np.allclose(action, first)
    policy.reset()
    assert np.allclose(policy.act({name: value[0] for name, value in seen.items()}), first)
