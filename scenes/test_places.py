"""Each test is the shortest proof of one claim about starts and targets that are chosen."""

import math
from dataclasses import replace

import numpy as np
import pytest

import scenes
from scenes.generate import room as random_room
from scenes.places import APART, GRID, MARGIN, are_clear, complete, floor
from sim import ARRIVAL_DISTANCE, ROBOT_RADIUS, Box, Scene, SceneError


def outline(*corners, thickness=0.1):
    """Walls along the closed line through these corners (x, y) [m]."""
    walls = []
    for (x, y), (next_x, next_y) in zip(corners, corners[1:] + corners[:1]):
        yaw = math.atan2(next_y - y, next_x - x)
        length = math.hypot(next_x - x, next_y - y) + thickness
        walls.append(Box("wall", (x + next_x) / 2, (y + next_y) / 2, yaw, length, thickness, 2.5))
    return walls


def square(half):
    """A room from -half to half [m], between the inner faces of its walls."""
    far = half + 0.05
    return outline((-far, -far), (far, -far), (far, far), (-far, far))


def partition(x, gap=0.0):
    """A wall across the room "two" at that x [m], with a gap of so many metres at one end."""
    return Box("wall", x, (3 - gap) / 2, math.pi / 2, 3 - gap, 0.1, 2.5)


OBLONG = outline((0, 0), (5, 0), (5, 3), (0, 3))
RNG = np.random.default_rng(0)
HALL = outline((0, 0), (12, 0), (12, 9), (0, 9)) + [
    Box("wood", *RNG.uniform((1, 1), (11, 8)).tolist(), RNG.uniform(-3, 3), 0.61, 0.6, 0.6)
    for _ in range(30)]
ROOMS = {
    "square": square(2.0),
    "L": outline((0, 0), (5, 0), (5, 2), (1.5, 2), (1.5, 5), (0, 5)),
    "triangle": outline((0, 0), (4, 1), (1, 4)),
    "two": [*OBLONG, partition(1.8)],
    "two with a door": [*OBLONG, partition(1.8, gap=0.6)],
    "corridor": outline((0, 0), (12, 0), (12, 0.5), (0, 0.5)),
    "small": square(0.4),
    "hall": HALL,
    "random": list(random_room(0).boxes),
    "env1": list(scenes.load("env1").boxes)}
each_room = pytest.mark.parametrize("boxes", ROOMS.values(), ids=ROOMS)


@pytest.mark.parametrize("distance", [0.0, 0.3, 2.0])
def test_looking_near_each_box_finds_what_looking_everywhere_does(distance):
    scene = Scene("hall", tuple(HALL), (0.0, 0.0, 0.0), (), ())
    points = RNG.uniform((-1, -1), (13, 10), (5000, 2))
    points = points[points[:, 0].argsort()]
    assert (are_clear(scene, points, distance) == (scene.clearance(points) > distance)).all()


@each_room
def test_the_start_is_the_freest_place(boxes, monkeypatch):
    """Against all places of a grid, each compared to all boxes."""
    monkeypatch.setattr(scenes.places, "SAMPLE", 20)  # as few as in the largest rooms
    start = complete("room", boxes).start
    scene = Scene("room", tuple(boxes), start, (), ())
    grid, inside = floor(scene)
    farthest = scene.clearance(grid[inside]).max()
    assert scene.clearance(start[:2]) == pytest.approx(farthest, abs=3e-6)
    assert start[2] == 0


def test_the_freest_place_of_an_l_is_the_circle_in_its_corner():
    """It touches both outer walls and the inner corner, and the open outside is no place."""
    scene = complete("L", ROOMS["L"])
    corner = np.array((1.45, 1.95))  # of the inner faces
    best = max(min(x - 0.05, y - 0.05, np.hypot(*(corner - (x, y))))
               for x in np.arange(0.5, 1.6, 0.01) for y in np.arange(0.5, 1.6, 0.01))
    assert scene.clearance(scene.start[:2]) == pytest.approx(best, abs=GRID)


@each_room
def test_targets_are_reachable_and_apart(boxes):
    scene = complete("room", boxes)
    away = scenes.distance_to_reachable(scene, scene.targets, ARRIVAL_DISTANCE)
    assert (away < ARRIVAL_DISTANCE).all()
    assert (scene.clearance(scene.targets) > ROBOT_RADIUS - 0.001).all()
    places = np.vstack([scene.start[:2], scene.targets])
    between = np.hypot(*(places[:, None] - places).T) + 9 * np.eye(len(places))
    assert between.min() > APART - 0.001  # targets are rounded to a millimetre


@pytest.mark.parametrize("name", ["square", "L", "triangle", "two", "random", "env1"])
def test_a_room_with_space_has_as_many_targets_as_env2_and_keeps_them_off_its_walls(name):
    scene = complete(name, ROOMS[name])
    assert (len(scene.training_targets), len(scene.new_targets)) == (10, 2)
    assert scene.clearance(scene.targets).min() > ROBOT_RADIUS + MARGIN - 0.001


@each_room
def test_a_choice_is_the_same_on_a_machine_that_rounds_otherwise(boxes):
    moved = [replace(box, yaw=box.yaw + 1e-13, x=box.x - 1e-13) for box in boxes]
    ours = complete("room", boxes)
    theirs = complete("room", moved)
    assert theirs.start == pytest.approx(ours.start, abs=1e-9)
    assert theirs.targets == pytest.approx(ours.targets, abs=1.1e-3)


def test_of_two_rooms_side_by_side_the_one_with_more_space_is_used():
    scene = complete("two", ROOMS["two"])
    assert scene.start[0] > 1.8 and (scene.targets[:, 0] > 1.8).all()
    both = complete("two", ROOMS["two with a door"])
    assert (both.targets[:, 0] < 1.8).any() and (both.targets[:, 0] > 1.8).any()


@pytest.mark.parametrize("half, training, new", [(0.325, 1, 0), (0.35, 2, 2)])
def test_a_small_room_has_fewer_targets_but_one_to_train_on(half, training, new):
    scene = complete("small", square(half))
    assert (len(scene.training_targets), len(scene.new_targets)) == (training, new)


@pytest.mark.parametrize("boxes, words", [
    (square(2.0)[:3], "the boxes enclose no place that the robot fits into"),
    (square(0.15), "the boxes enclose no place that the robot fits into"),
    (square(0.3), "the robot can drive no farther than 0.2 m from the start")])
def test_boxes_that_are_no_room_to_drive_in_are_refused(boxes, words):
    with pytest.raises(SceneError, match=words):
        complete("room", boxes)


def test_a_start_that_is_given_stays():
    scene = complete("room", ROOMS["square"], start=(1.0, 1.0, 0.5))
    assert scene.start == (1.0, 1.0, 0.5)
    assert np.hypot(*(scene.targets[0] - (1.0, 1.0))) > 3.5  # the far corner comes first
