"""Tests of how a start and targets are chosen."""

import math
import re
import time
from dataclasses import replace

import numpy as np
import pytest

import scenes
from evaluation.planners import visibility_graph
from scenes.generate import room as random_room
from scenes.places import APART, GRID, MARGIN, complete, parts
from sim import ROBOT_RADIUS, Box, SceneError, flood


def outline(*corners, thickness=0.1):
    """Returns walls along the closed line through these corners (x, y) [m]."""
    walls = []
    for (x, y), (next_x, next_y) in zip(corners, corners[1:] + corners[:1]):
        yaw = math.atan2(next_y - y, next_x - x)
        length = math.hypot(next_x - x, next_y - y) + thickness
        walls.append(Box("wall", (x + next_x) / 2, (y + next_y) / 2, yaw, length, thickness, 2.5))
    return walls


def square(half):
    """Returns the walls of a square room; their inner faces are at -half and half [m]."""
    far = half + 0.05
    return outline((-far, -far), (far, -far), (far, far), (-far, far))


OBLONG = outline((0, 0), (5, 0), (5, 3), (0, 3))
WALL = Box("wall", 1.8, 1.5, math.pi / 2, 3, 0.1, 2.5)  # across the room
WALL_WITH_A_DOOR = replace(WALL, y=1.2, length=2.4)
SPACIOUS = {
    "square": square(2.0),
    "L": outline((0, 0), (5, 0), (5, 2), (1.5, 2), (1.5, 5), (0, 5)),
    "triangle": outline((0, 0), (4, 1), (1, 4)),
    "random": list(random_room(0).boxes)}
ROOMS = SPACIOUS | {"corridor": outline((0, 0), (12, 0), (12, 0.5), (0, 0.5))}
each_room = pytest.mark.parametrize("boxes", ROOMS.values(), ids=ROOMS)


@pytest.mark.parametrize("name", sorted(ROOMS.keys() - {"L", "triangle"}))
def test_the_start_is_the_place_farthest_from_all_boxes(name):
    """No point of a grid in these rectangular rooms is farther from the boxes."""
    scene = complete("room", ROOMS[name])
    x, y = [np.arange(low, high, GRID) for low, high in zip(*scene.bounds)]
    farthest = scene.clearance(np.stack(np.meshgrid(x, y), -1)).max()
    assert scene.clearance(scene.start[:2]) == pytest.approx(farthest, abs=3e-6)
    assert scene.start[2] == 0


@each_room
def test_targets_are_reachable_and_apart(boxes):
    scene = complete("room", boxes)
    away = scenes.distance_to_nearest(scene.targets, scene.reachable)
    assert (away < 0.001).all()  # targets are rounded to a millimetre
    places = np.vstack([scene.start[:2], scene.targets])
    between = np.hypot(*(places[:, None] - places).T) + 9 * np.eye(len(places))
    assert between.min() > APART - 0.001


@pytest.mark.parametrize("name", SPACIOUS)
def test_a_spacious_room_has_as_many_targets_as_env2_away_from_its_walls(name):
    scene = complete(name, ROOMS[name])
    assert (len(scene.training_targets), len(scene.new_targets)) == (10, 2)
    assert scene.clearance(scene.targets).min() > ROBOT_RADIUS + MARGIN - 0.001


@each_room
def test_rounding_errors_do_not_change_the_choice(boxes):
    moved = [replace(box, yaw=box.yaw + 1e-13, x=box.x - 1e-13) for box in boxes]
    ours = complete("room", boxes)
    theirs = complete("room", moved)
    assert theirs.start == pytest.approx(ours.start, abs=1e-9)
    assert theirs.targets == pytest.approx(ours.targets, abs=1.1e-3)


def test_of_two_adjacent_rooms_the_one_with_more_space_is_used():
    assert (complete("two", [*OBLONG, WALL]).targets[:, 0] > 1.8).all()
    both = complete("two", [*OBLONG, WALL_WITH_A_DOOR]).targets[:, 0]
    assert both.min() < 1.8 < both.max()


@pytest.mark.parametrize("half, training, new", [(0.325, 1, 0), (0.35, 2, 2)])
def test_a_small_room_has_fewer_targets_but_at_least_one_training_target(half, training, new):
    scene = complete("small", square(half))
    assert (len(scene.training_targets), len(scene.new_targets)) == (training, new)


def test_a_room_with_an_opening_gets_a_fence_and_the_opening_is_named(caplog):
    """The right wall of the room has an opening of 0.8 m, too narrow to contain all targets."""
    parts = [replace(wall, y=y, length=1.6) for wall in [square(2.0)[1]] for y in (-1.25, 1.25)]
    scene = complete("maze", [square(2.0)[0], *square(2.0)[2:], *parts])
    assert len(scene.boxes) == 9 and (np.abs(scene.targets) < 2.1).all()
    x, y = re.search(r"opening at \((.*), (.*)\)", caplog.text).groups()
    assert abs(float(x) - 2.0) < 0.2 and abs(float(y)) < 0.4
    caplog.clear()
    assert len(complete("square", square(2.0)).boxes) == 4 and not caplog.text


def test_a_ring_track_is_used_and_not_its_hollow_inside_nor_the_floor_outside():
    ring = [*square(4.0), *square(2.0)]
    assert (np.abs(complete("ring", ring).targets).max(1) > 2.1).all()
    small = complete("L", outline((0, 0), (3, 0), (3, 1), (1, 1), (1, 3), (0, 3)))
    assert len(small.boxes) == 6 and (small.targets.min(1) < 1).all()


def test_parts_are_those_of_a_flood_fill():
    rng = np.random.default_rng(0)
    for density in (0.3, 0.5, 0.6, 0.8):
        free = np.pad(rng.random((30, 40)) < density, 1)
        part = parts(free)
        for cell in np.argwhere(free)[::25]:
            source = np.zeros_like(free)
            source[tuple(cell)] = True
            assert (flood(free, source) == (part == part[tuple(cell)])).all()


def test_the_largest_rooms_are_completed_in_seconds():
    """A check of the order of magnitude, in CPU time: it took minutes once."""
    rng = np.random.default_rng(0)
    boxes = [Box("wall", *rng.uniform(-29, 29, 2).tolist(), 0.3, 3.0, 0.3, 1.0) for _ in range(508)]
    begin = time.process_time()
    scene = complete("large", [*square(29.5), *boxes])
    graph = visibility_graph(scene)
    assert graph.path(scene.start[:2], scene.targets[0])[1] > 10
    assert time.process_time() - begin < 30


@pytest.mark.parametrize("boxes, words", [
    (square(0.15), "the boxes do not enclose a place that the robot fits into"),
    (square(0.3), "the robot can drive at most 0.2 m from the start")])
def test_boxes_in_which_no_robot_can_drive_are_refused(boxes, words):
    with pytest.raises(SceneError, match=words):
        complete("room", boxes)
