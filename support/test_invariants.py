"""What holds whatever robots do: random rooms, random and extreme actions, 100,000 steps.

Hypothesis makes the rooms, the same ones each time. They are driven in once, and every test looks
at one invariant of what was driven, by an oracle that computes it in another way than the code.
"""

import cmath
import functools
import math
import pickle
from types import SimpleNamespace
from unittest.mock import patch

import numpy as np
from hypothesis import HealthCheck, assume, given, settings
from hypothesis import strategies as st

import scenes
from navbot_min import ARRIVAL, COLLISION, TIMEOUT, NavVecEnv
from render import BLUE, FLOOR, SKY, texture
from scenes.test_scenes import box
from sim import SceneError
from support.traces import TurnToTarget

ROOMS = 13
ROBOTS = 72  # more than the camera paints at once
STEPS = 116  # of each robot in each room, 108,576 in all
LIMIT = 40  # steps of an episode
EXTREMES = np.array([0, -0.0, 1, -1, 1e-300, -1e-9, 1.0001, -2, 7e5, -1e30, 1e308])
SUBSTEPS = 4
POISON = 13  # what memory holds before it is painted


# ------------------------------------------------------------------------------- rooms and driving


@st.composite
def rooms(draw):
    """A closed room: four walls, up to six boxes at any angle, start and targets anywhere."""
    a = draw(st.floats(0.6, 2.2))  # [m] half of its length
    b = draw(st.floats(0.6, 1.6))  # and of its width
    thin = draw(st.sampled_from([0.001, 0.15]))
    walls = [box(x=x, y=y, length=length, thickness=thickness)
             for x, y, length, thickness in ((a, 0.0, thin, 2 * b), (-a, 0.0, thin, 2 * b),
                                             (0.0, b, 2 * a + thin, thin),
                                             (0.0, -b, 2 * a + thin, thin))]
    x = st.floats(-a, a)
    y = st.floats(-b, b)
    boxes = st.builds(box, material=st.sampled_from(scenes.MATERIALS), x=x, y=y,
                      yaw_degrees=st.floats(-400, 400), length=st.floats(0.002, 1.2),
                      thickness=st.floats(0.002, 0.6), height=st.floats(0.3, 3.0))
    start = [draw(x), draw(y)]
    room = dict(boxes=walls + draw(st.lists(boxes, min_size=1, max_size=6)),
                start=dict(x=start[0], y=start[1], heading_degrees=draw(st.floats(-720, 720))),
                training_targets=[start], new_targets=[])
    try:
        floor = scenes.parse(room, "room").reachable
        assume(len(floor) > 200)  # of cells, a little place at least
        places = st.integers(0, len(floor) - 1)
        targets = floor[draw(st.lists(places, min_size=1, max_size=4))]
        return scenes.parse(room | {"training_targets": targets.tolist()}, "room")
    except SceneError:
        assume(False)


@functools.cache
def random_rooms():
    """ROOMS rooms that a robot can be run in, the same ones each time."""
    found = []

    @settings(max_examples=ROOMS, derandomize=True, database=None, deadline=None,
              suppress_health_check=list(HealthCheck))
    @given(rooms())
    def keep(scene):
        found.append(scene)
    keep()
    return found


def extreme_actions(rng, seen):
    """An action for each robot (R, 2), by its number: at random; straight ahead; in circles; on the
    spot; any extremes; hardly anything; nothing; to the target, the last two of nine so."""
    R = len(seen["target"])
    actions = TurnToTarget().act(None, seen).astype(float)
    ways = [rng.uniform((0, -1), (1, 1), (R, 2)), np.tile((1, 0), (R, 1)), np.tile((1, 1), (R, 1)),
            np.tile((0, -1), (R, 1)), rng.choice(EXTREMES, (R, 2)),
            rng.uniform(-1e-7, 1e-7, (R, 2)), np.zeros((R, 2))]
    for k, way in enumerate(ways):
        actions[k::9] = way[k::9]
    return actions


def poisoned(shape, dtype=float):
    """Memory in which it shows what was not written."""
    return np.full(shape, POISON, dtype)


@functools.cache
def drives():
    """What happened in each room: arrays (T, R, ...) by their names, and the scene."""
    return [drive(scene, seed) for seed, scene in enumerate(random_rooms())]


def drive(scene, seed):
    """Drives in one room, every step by `extreme_actions`."""
    rng = np.random.default_rng(seed)
    env = NavVecEnv(ROBOTS, [scene], random_starts=0.5, max_episode_steps=LIMIT)
    steps = []
    with patch.object(np, "empty", poisoned):
        seen, _ = env.reset(seed=seed)
        for t in range(STEPS):
            before = dict(pose=env.world.poses, goal=env.goals.copy())
            actions = extreme_actions(rng, seen)
            seen, rewards, terminated, truncated, infos = env.step(actions)
            done = terminated | truncated
            last = infos.get("final_obs", seen)
            steps.append(before | dict(
                action=actions, reward=rewards, terminated=terminated, truncated=truncated,
                led_to=infos["pose"], then=env.world.poses, then_goal=env.goals.copy(),
                last_target=last["target"], next_target=seen["target"],
                outcome=np.where(done, infos.get("final_info", {"outcome": -1})["outcome"], -1),
                length=np.where(done, infos.get("final_info", {"length": -1})["length"], -1),
                total=np.where(done, infos.get("final_info", {"return": 0})["return"], 0),
                bad_pixels=bad_pixels(last["image"]) if t % 4 == 0 else np.zeros(ROBOTS),
                valid=np.full(ROBOTS, env.observation_space.contains(seen)
                              and env.observation_space.contains(last))))
    log = {name: np.array([step[name] for step in steps]) for name in steps[0]}
    return SimpleNamespace(scene=scene, **log)


# ----------------------------------------------------------------------------------------- oracles


def slow_clearance(scene, points):
    """Distance of complex points from the nearest edge of any box, 0 inside a box."""
    nearest = np.full(points.shape, np.inf)
    for wall in scene.boxes:
        turn = cmath.exp(1j * wall.yaw)
        half = complex(wall.length, wall.thickness) / 2
        corners = [complex(wall.x, wall.y) + turn * corner
                   for corner in (half, -half.conjugate(), -half, half.conjugate())]
        inside = np.ones(points.shape, bool)
        for p, q in zip(corners, corners[1:] + corners[:1]):
            along = (points - p) / (q - p)  # the edge goes from 0 to 1
            inside &= along.imag > 0
            nearest = np.minimum(nearest, np.abs(points - p - along.real.clip(0, 1) * (q - p)))
        nearest[inside] = 0
    return nearest


def places(poses):
    """Complex places of (..., 3) poses."""
    return poses[..., 0] + 1j * poses[..., 1]


def arcs(drive):
    """Complex places and headings after each of SUBSTEPS parts of the arcs that the actions ask
    for, (SUBSTEPS + 1, T, R), were there no walls."""
    v = drive.action[..., 0].clip(0, 1) * 0.3
    w = drive.action[..., 1].clip(-1, 1) * 1.0
    seconds = 0.4 * np.arange(SUBSTEPS + 1)[:, None, None] / SUBSTEPS
    turned = w * seconds
    ahead = np.where(w == 0, seconds, np.expm1(1j * turned) / (1j * np.where(w == 0, 1, w)))
    heading = drive.pose[..., 2]
    return places(drive.pose) + v * ahead * np.exp(1j * heading), heading + turned


def packed(colours):
    """Colours (..., 3) as one number each."""
    return colours.astype(np.int64) @ (1, 256, 65536)


@functools.cache
def kinds_of_colour():
    """What each packed colour is: 0 sky, 1 wall, 2 floor, 3 cube, 4 none that occurs. Faces are lit
    by tenths from 0.5 to 1, those of the cube by any light from 0.5."""
    kinds = np.full(2 ** 24, 4, np.uint8)
    for tenth in range(5, 11):
        for material in scenes.MATERIALS:
            kinds[packed((texture(material) * (tenth / 10)).clip(0, 255).round())] = 1
    kinds[packed(np.outer(np.linspace(0.5, 1, 10_000), BLUE).round())] = 3
    kinds[packed(np.array(SKY))] = 0
    kinds[packed(np.array(FLOOR))] = 2
    return kinds


def bad_pixels(images):
    """How many pixels of each image are not what they can be in a closed room under 8 m across:
    each column is sky, then wall, then floor from above down, the cube over it somewhere, and wall
    at the horizon, for every box is higher than the camera and every ray ends at one."""
    kind = kinds_of_colour()[packed(images)]  # (R, H, W)
    cube = kind == 3
    background = np.where(cube, 0, kind)
    order = background < np.maximum.accumulate(background, 1)
    horizon = kind[:, 23:25] != 1
    return (kind == 4).sum((1, 2)) + (order & ~cube).sum((1, 2)) + horizon.sum((1, 2))


# -------------------------------------------------------------------------------------- invariants


def test_a_hundred_thousand_steps_were_driven_and_episodes_ended_in_every_way():
    assert len(drives()) == ROOMS and ROOMS * ROBOTS * STEPS >= 100_000
    counts = sum(np.bincount(drive.outcome.ravel() + 1, minlength=4) for drive in drives())
    assert counts[1:].min() > 100


def test_no_robot_is_ever_in_a_wall():
    for drive in drives():
        for poses in (drive.pose, drive.led_to, drive.then):
            assert slow_clearance(drive.scene, places(poses)).min() >= 0.178 - 1e-9


def test_robots_drive_arcs_and_collide_exactly_where_the_disc_would_overlap_a_wall():
    for drive in drives():
        ways, headings = arcs(drive)
        gap = slow_clearance(drive.scene, ways) - 0.178
        sure = (np.abs(gap[1:]) > 1e-9).all(0)
        free = (np.logical_and.accumulate(gap[1:] > 0)).sum(0)  # substeps that are made
        hit = free < SUBSTEPS
        collided = drive.outcome == COLLISION
        arrived = drive.outcome == ARRIVAL
        assert (collided == hit)[sure & ~arrived].all() and sure.mean() > 0.99
        expected = np.take_along_axis(ways, free[None], 0)[0]
        assert np.abs(expected - places(drive.led_to))[sure].max() < 1e-9
        turn = np.exp(1j * np.take_along_axis(headings, free[None], 0)[0])
        assert np.abs(turn - np.exp(1j * drive.led_to[..., 2]))[sure].max() < 1e-9


def test_poses_are_finite_and_headings_in_their_range():
    for drive in drives():
        for poses in (drive.pose, drive.led_to, drive.then):
            assert np.isfinite(poses).all()
            assert (-math.pi < poses[..., 2]).all() and (poses[..., 2] <= math.pi).all()


def test_observations_are_in_their_declared_space():
    assert all(drive.valid.all() for drive in drives())


def test_every_pixel_is_painted_and_is_what_it_can_be():
    # But for one in some ten million: where a row's ray meets the edge of a top to the last bit,
    # sky may show between that face and the higher one behind.
    pixels = ROOMS * ROBOTS * STEPS // 4 * 48 * 64
    assert sum(drive.bad_pixels.sum() for drive in drives()) < pixels / 10 ** 7


def test_distance_and_bearing_agree_with_the_pose():
    for drive in drives():
        for poses, goals, seen in ((drive.led_to, drive.goal, drive.last_target),
                                   (drive.then, drive.then_goal, drive.next_target)):
            ahead = (places(goals) - places(poses)) * np.exp(-1j * poses[..., 2])
            told = seen[..., 0] * np.exp(1j * seen[..., 1])
            assert np.abs(ahead - told).max() < 1e-5


def test_rewards_are_those_of_eq_4_and_add_up_to_the_return():
    for drive in drives():
        before = np.abs(places(drive.goal) - places(drive.pose))
        after = np.abs(places(drive.goal) - places(drive.led_to))
        expected = 100 * (before - after) - 0.05
        expected[drive.outcome == COLLISION] = -50
        expected[after < 0.177] = 100
        assert np.abs(expected - drive.reward).max() < 1e-9
        total = np.zeros(ROBOTS)
        for reward, outcome, told in zip(drive.reward, drive.outcome, drive.total):
            total += reward
            assert np.abs(total - told)[outcome >= 0].max(initial=0) < 1e-9
            total[outcome >= 0] = 0


def test_every_episode_ends_in_exactly_one_outcome():
    for drive in drives():
        arrived = np.abs(places(drive.goal) - places(drive.led_to)) < 0.177
        assert not (drive.terminated & drive.truncated).any()
        assert ((drive.outcome >= 0) == (drive.terminated | drive.truncated)).all()
        assert ((drive.outcome == ARRIVAL) == arrived).all()
        assert ((drive.outcome == TIMEOUT) == drive.truncated).all()
        steps = np.zeros(ROBOTS, int)
        for outcome, length in zip(drive.outcome, drive.length):
            steps += 1
            assert (steps == length)[outcome >= 0].all() and steps.max() <= LIMIT
            assert (outcome[steps == LIMIT] >= 0).all()
            steps[outcome >= 0] = 0


def some_episodes():
    """Rooms, one for each of 24 robots, and the options of a reset that draws nothing."""
    rng = np.random.default_rng(5)
    own = [random_rooms()[r % ROOMS] for r in range(24)]
    starts = [[*room.reachable[rng.integers(len(room.reachable))], rng.uniform(-9, 9)]
              for room in own]
    targets = [int(rng.integers(len(room.targets))) for room in own]
    return own, {"start": starts, "target": targets}


def test_robots_in_one_world_drive_as_worlds_of_one_robot():
    own, options = some_episodes()
    many = NavVecEnv(24, own, max_episode_steps=LIMIT)
    single = [NavVecEnv(1, [room], max_episode_steps=LIMIT) for room in own]
    seen, _ = many.reset(seed=0, options=options)
    for r, one in enumerate(single):
        one.reset(seed=0, options={key: value[r] for key, value in options.items()})
    rng = np.random.default_rng(6)
    under_way = set(range(24))
    for _ in range(LIMIT):
        actions = extreme_actions(rng, seen)
        seen, rewards, terminated, truncated, infos = many.step(actions)
        last = infos.get("final_obs", seen)
        for r in sorted(under_way):
            alone, *results, its_infos = single[r].step(actions[r:r + 1])
            alone = its_infos.get("final_obs", alone)
            assert all(np.allclose(alone[key][0], last[key][r], atol=1e-5)
                       for key in ("target", "velocity", "last_reward"))
            # A pose that differs in its last digit may put a pixel's edge on its other side.
            assert (alone["image"][0] != last["image"][r]).any(-1).mean() < 0.01
            assert np.allclose([result[0] for result in results],
                               [rewards[r], terminated[r], truncated[r]], atol=1e-6)
            assert np.allclose(its_infos["pose"][0], infos["pose"][r], atol=1e-9)
        under_way -= set(np.flatnonzero(terminated | truncated).tolist())
    assert not under_way


def test_a_pickled_copy_goes_on_alike():
    env = NavVecEnv(ROOMS, random_rooms(), random_starts=0.5, max_episode_steps=LIMIT)
    seen, _ = env.reset(seed=1)
    rng = np.random.default_rng(7)
    for _ in range(25):
        seen, *_ = env.step(extreme_actions(rng, seen))
    twin = pickle.loads(pickle.dumps(env))
    ended = 0
    for _ in range(60):
        actions = extreme_actions(rng, seen)
        seen, *results, infos = env.step(actions)
        its_seen, *its_results, its_infos = twin.step(actions)
        assert all((seen[key] == its_seen[key]).all() for key in seen)
        assert all((one == other).all() for one, other in zip(results, its_results))
        assert (infos["pose"] == its_infos["pose"]).all()
        ended += (results[1] | results[2]).sum()
    assert ended > ROOMS
