"""Each test is the shortest proof of one claim about random rooms, all but two on the same 40."""

import functools
import math
import subprocess
import sys
from itertools import combinations
from pathlib import Path

import numpy as np
import pytest

import scenes
from scenes import generate
from sim import CELL, FAR_ENOUGH, ROBOT_RADIUS, SceneError

ROOT = Path(__file__).parent.parent
ROOMS = 40
PRINT_ROOMS = "import scenes; print([scenes.load(f'random:{seed}') for seed in (0, 7, 10 ** 9)])"


@functools.cache
def rooms():
    """The first rooms."""
    return [scenes.load(f"random:{seed}") for seed in range(ROOMS)]


def furniture(material=None):
    """What stands in the rooms, as pairs of a room and a box of that material, or of any."""
    return [(room, box) for room in rooms() for box in room.boxes[4:]
            if material in (None, box.material)]


def centre(box):
    """A box's centre as a complex number."""
    return complex(box.x, box.y)


def outline(box, spacing=0.02):
    """Complex points all around a box."""
    half = np.array((1 + 1j, -1 + 1j, -1 - 1j, 1 - 1j, 1 + 1j))
    corners = centre(box) + np.exp(1j * box.yaw) * (half.real * box.length
                                                    + 1j * half.imag * box.thickness) / 2
    sides = [np.linspace(p, q, math.ceil(abs(q - p) / spacing) + 1)
             for p, q in zip(corners, corners[1:])]
    return np.concatenate(sides)


@functools.cache
def gap(one, other):
    """The distance [m] of two boxes' outlines, at most 0.2 mm too much; where they cross, 1 cm."""
    return np.abs(outline(one)[:, None] - outline(other)).min()


def overlap(one, other):
    """Whether two boxes share floor."""
    own = (outline(one) - centre(other)) * np.exp(-1j * other.yaw)
    inside = (np.abs(own.real) < other.length / 2) & (np.abs(own.imag) < other.thickness / 2)
    return inside.any()


def end_in(brick, other):
    """How far along another brick lies that end of a brick which is joined, from -1 to 1 with the
    middle of the end pieces at -1 and 1; None where the end is not in its middle line."""
    end = centre(brick) - brick.length / 2 * np.exp(1j * brick.yaw)
    own = (end - centre(other)) * np.exp(-1j * other.yaw)
    along = own.real / (other.length - other.thickness) * 2
    return along if abs(own.imag) < 1e-9 and abs(along) < 1 + 1e-9 else None


def test_the_same_seed_makes_the_same_room_in_another_process_and_another_seed_another():
    done = subprocess.run([sys.executable, "-c", PRINT_ROOMS], cwd=ROOT, capture_output=True,
                          text=True, check=True)
    assert done.stdout.strip() == str([scenes.load(f"random:{seed}") for seed in (0, 7, 10 ** 9)])
    assert len({room.boxes for room in rooms()}) == ROOMS


def test_rooms_and_what_stands_in_them_have_the_sizes_of_the_released_ones():
    for room in rooms():
        length, width = np.ptp(room.bounds, axis=0)
        assert 4.6 <= length <= 5.4 and 2.7 <= width <= 3.3
        assert 1 <= len(room.boxes) - 4 <= 8
    for _, brick in furniture("brick"):
        assert 1.1 <= brick.length <= 2.2 and (brick.thickness, brick.height) == (0.3, 1.5)
    for _, wood in furniture("wood"):
        assert (wood.length, wood.thickness, wood.height) == (0.61, 0.6, 0.6)


def test_a_gap_is_closed_or_a_passage():
    gaps = [gap(box, other) for room in rooms() for box, other in combinations(room.boxes, 2)]
    assert not any(0.3 + 2e-4 < one < 0.42 for one in gaps)
    assert sum(0.02 < one <= 0.3 for one in gaps) > 20
    assert sum(0.42 <= one < 0.6 for one in gaps) > 20


def test_everything_stands_inside_its_room_and_only_joined_bricks_share_floor():
    for room, box in furniture():
        walls = np.concatenate([outline(wall) for wall in room.boxes[:4]])
        for part in (np.real, np.imag):  # the room's middle is at 0
            assert np.abs(part(outline(box))).max() < np.abs(part(walls)).max() + 1e-9
        before = room.boxes[:room.boxes.index(box)]
        sharing = [other for other in before if overlap(box, other) or overlap(other, box)]
        assert len(sharing) <= (box.material == "brick"), room.name
        assert all(other.material != "wood" for other in sharing)


def test_nearly_all_of_the_floor_can_be_reached():
    for room in rooms():
        low, high = room.bounds
        x, y = (np.arange(a, b, CELL) for a, b in zip(low + 0.15, high - 0.15))  # between the walls
        free = room.clearance(np.stack(np.meshgrid(x, y), -1)) > ROBOT_RADIUS
        # 0.97 by the grid of 5 cm that rooms are made with; this one is half as wide.
        assert len(room.reachable) > 0.955 * free.sum(), room.name


def lines(room, rng, count=400):
    """Straight lines (count, 150, 2), as points, between places 1 m or more apart that the robot
    fits on."""
    places = rng.uniform(*room.bounds, (20 * count, 2))
    begin, end = places[room.clearance(places) > ROBOT_RADIUS][:4 * count].reshape(2, -1, 2)
    apart = np.linalg.norm(end - begin, axis=1) >= FAR_ENOUGH
    return np.linspace(begin[apart][:count], end[apart][:count], 150, axis=1)


def test_as_many_lines_of_sight_are_blocked_as_were_drawn():
    rng = np.random.default_rng(0)
    shares = np.array([(room.clearance(lines(room, rng)).min(1) < 0).mean() for room in rooms()])
    drawn = np.array([np.random.default_rng(seed).uniform(0.35, 0.85) for seed in range(ROOMS)])
    # Of 400 lines, four standard deviations are up to 0.1, and of the 2000 before up to 0.045.
    assert np.abs(shares - drawn).max() < 0.05 + 0.12
    assert abs((shares - drawn).mean()) < 0.03


def test_a_line_is_blocked_where_one_of_many_points_on_it_is_in_a_box():
    rng = np.random.default_rng(1)
    blocked = set()
    for room in rooms()[:8]:
        points = lines(room, rng)
        points[:50, :, 1] = points[:50, :1, 1]  # along an axis of the room
        deepest = room.clearance(points).min(1)
        found = generate.are_blocked(room.boxes, points[:, 0], points[:, -1])
        sure = np.abs(deepest) > 0.02  # m, half of the way from one point to the next
        assert (found == (deepest < 0))[sure].all() and sure.mean() > 0.9
        blocked |= set(found.tolist())
    assert blocked == {False, True}


def test_a_line_of_no_length_and_one_along_a_wall_are_blocked_by_what_they_are_in():
    box = rooms()[0].boxes[4]
    inside, outside, beyond = np.array([(box.x, box.y), (9.0, 9.0), (9.0, -9.0)])
    begin = np.array([inside, outside, outside])
    end = np.array([inside, outside, beyond])
    with np.errstate(all="raise"):  # nothing is divided by 0
        found = generate.are_blocked([box], begin, end)
    assert found.tolist() == [True, False, False]


def test_rooms_are_of_all_kinds():
    right_angled = [all(abs(math.remainder(box.yaw, math.pi / 2)) < 1e-9 for box in room.boxes)
                    for room in rooms()]
    assert 10 < sum(right_angled) < 30
    joints = [end_in(brick, other) for room, brick in furniture("brick") for other in room.boxes[4:]
              if other.material == "brick" and other is not brick]
    joints = np.abs([joint for joint in joints if joint is not None])
    corners, tees = joints > 1 - 1e-9, joints < 1e-9
    assert corners.sum() > 5 and tees.sum() > 5 and (corners | tees).all()
    touching = [[other for other in room.boxes if other is not brick and gap(brick, other) < 0.02]
                for room, brick in furniture("brick")]
    from_wall = [len(others) == 1 and others[0].material == "wall" for others in touching]
    assert sum(map(len, touching)) and sum(from_wall) > 20
    assert sum(not others for others in touching) > 20 and len(furniture("wood")) > 20


@pytest.mark.parametrize("name", ["random:", "random:-1", "random:x", "random:1.0", "random:\u0663",
                                  "random:1000000001", "random:" + "9" * 5000, "random: 1",
                                  "random:1_0", "random:\0", "random:\x1b[31m"])
def test_a_bad_seed_is_refused_in_a_sentence(name):
    words = "must be random: and a whole number from 0 to 1,000,000,000$"
    with pytest.raises(SceneError, match=words) as error:
        scenes.load(name)
    assert len(str(error.value)) < 200 and str(error.value).isprintable()
