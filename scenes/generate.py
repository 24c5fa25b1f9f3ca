"""Makes random rooms: the same seed always gives the same room, `random:SEED`. Size, boxes,
passages and blocked lines of sight resemble those of the released rooms, and so does difficulty.
Axis letters: X, Y cells of a grid, L lines, B boxes, R robots, S sensors."""

import functools
import math
import re
import reprlib

import numpy as np

from scenes.places import GRID, complete, walls
from sim import FAR_ENOUGH, ROBOT_RADIUS, Box, Scene, SceneError, flood

PREFIX = "random:"
MOST_SEED = 10 ** 9
# All values are our choice. After a semicolon comes the value in the released rooms.
LENGTHS = (4.6, 5.4)  # [m] outer length of the room; 5.0
WIDTHS = (2.7, 3.3)  # [m] outer width; 3.0
BRICKS = (1.1, 2.2)  # [m] length of a brick; 1.15 to 1.73
BRICK_FRACTION = 0.6  # fraction of obstacles that are bricks; 12 of 22
BLOCKED = (0.35, 0.85)  # range of the fraction of straight lines that obstacles block; 0.41 to 0.82
NEAR = 0.05  # tolerance of the blocked fraction
MEETS_BRICK = 0.4  # fraction of bricks that form an L or a T with another one
MEETS_WALL = 0.4  # fraction of the other bricks that begin at a wall
CLOSED = 0.3  # [m] gaps up to this width are closed to the robot, which needs 0.36
NARROWEST = 0.42  # [m] narrowest passage; 0.41 in maze 4
MOST_OBSTACLES = 8  # maximum number per room; 4 or 5
TRIES = 100  # attempts to place obstacles per room
LINES = 2000  # number of lines to estimate the blocked fraction while a room is made
MEASURED = 5000  # number of lines to estimate it in a finished room
MOST_KEPT = 128  # rooms kept in memory, 0.3 MB each
CONNECTED = 0.97  # minimum fraction of the free floor that is in one piece


def seed_of(name):
    """Returns the seed in a name like `random:7`. Raises SceneError."""
    digits = name.removeprefix(PREFIX)
    if not re.fullmatch("[0-9]{1,10}", digits) or int(digits) > MOST_SEED:
        raise SceneError(f"scene {reprlib.repr(name)} must be random: and a whole number from 0 "
                         f"to {MOST_SEED:,}")
    return int(digits)


@functools.lru_cache(MOST_KEPT)
def room(seed):
    """Returns the Scene `random:SEED`."""
    rng = np.random.default_rng(seed)
    wanted = rng.uniform(*BLOCKED)
    share = 0.0
    while share < wanted - NEAR:  # start again: too few boxes fitted
        length = rng.uniform(*LENGTHS)
        width = rng.uniform(*WIDTHS)
        boxes, share = furnished(rng, wanted, length, width)
    return complete(f"random-{seed}", boxes)


def furnished(rng, wanted, length, width):
    """Returns a list of boxes and the fraction of lines that they block: about the wanted one, or
    less. Obstacles are drawn one by one. One is kept if the gaps around it are clear, not too many
    lines are blocked, and nearly all of the free floor is still connected."""
    right_angles = rng.random() < 0.5
    boxes = walls(length, width)
    empty = as_scene(boxes)
    x, y = [np.arange(low, high, GRID) for low, high in zip(*empty.bounds)]
    grid = np.stack(np.meshgrid(x, y, indexing="ij"), -1)  # (X, Y, 2) [m]
    clearance = empty.clearance(grid)  # (X, Y) [m]
    ends = rng.uniform(*empty.bounds, (2, LINES, 2))  # (2, L, 2) [m] ends of straight lines
    # A line counts if the robot fits at both ends and they are far enough apart.
    counts = (empty.clearance(ends) > ROBOT_RADIUS).all(0)  # (L,)
    counts &= np.hypot(*(ends[1] - ends[0]).T) >= FAR_ENOUGH
    blocked = np.zeros(LINES, bool)
    is_brick = rng.random() < BRICK_FRACTION
    for _ in range(TRIES):
        box, joined = obstacle(rng, is_brick, boxes, length, width, right_angles)
        if not has_clear_gaps([*boxes, box], joined):
            continue
        new = as_scene([box])
        new_clearance = np.minimum(clearance, new.clearance(grid))
        new_counts = counts & (new.clearance(ends) > ROBOT_RADIUS).all(0)
        new_blocked = blocked | are_blocked([box], *ends)
        share = new_blocked[new_counts].mean()
        if share > wanted + NEAR:
            continue
        free = new_clearance > ROBOT_RADIUS
        piece = flood(free, new_clearance == new_clearance.max())
        if piece.sum() < CONNECTED * free.sum():
            continue
        boxes.append(box)
        clearance = new_clearance
        counts = new_counts
        blocked = new_blocked
        # Redrawn only after a success: otherwise bricks, which fit less often, would become rarer.
        is_brick = rng.random() < BRICK_FRACTION
        if share >= wanted or len(boxes) == 4 + MOST_OBSTACLES:
            break
    return boxes, blocked[counts].mean()


def obstacle(rng, is_brick, boxes, length, width, right_angles):
    """Draws a brick or a wooden box. Returns the Box, and the Box that it is joined to or None."""
    yaw = rng.uniform(-math.pi, math.pi)
    if right_angles:
        yaw = rng.integers(4) * math.pi / 2
    place = rng.uniform((-length / 2, -width / 2), (length / 2, width / 2))
    if not is_brick:
        return Box("wood", *place.tolist(), float(yaw), 0.61, 0.6, 0.6), None
    joined = None
    brick_length = rng.uniform(*BRICKS)
    others = [box for box in boxes if box.material == "brick"]
    if others and rng.random() < MEETS_BRICK:
        joined = others[rng.integers(len(others))]
        along = rng.choice((-0.5, 0.0, 0.5)) * (joined.length - joined.thickness)
    elif rng.random() < MEETS_WALL:
        joined = boxes[rng.integers(4)]
        along = rng.uniform(-0.5, 0.5) * joined.length
    if joined is not None:
        if right_angles:
            yaw = joined.yaw + rng.choice((-1, 1)) * math.pi / 2
        end = (joined.x, joined.y) + along * direction(joined.yaw)
        place = end + brick_length / 2 * direction(yaw)
    x, y = place.tolist()
    return Box("brick", x, y, float(yaw), brick_length, 0.3, 1.5), joined


def direction(yaw):
    """Returns the unit vector (2,) in the direction of an angle [rad]."""
    return np.array((math.cos(yaw), math.sin(yaw)))


def has_clear_gaps(boxes, joined):
    """Returns whether the last box is inside the room, overlaps only the box that it is joined to,
    and leaves only gaps that are either closed or wide enough for the robot."""
    *others, last = boxes
    corners = last.corners
    low, high = as_scene(boxes[:4]).bounds
    if (corners < low).any() or (corners > high).any():  # it is partly outside
        return False
    edge = np.linspace(np.roll(corners, 1, axis=0), corners, 24, endpoint=False).reshape(-1, 2)
    ends = as_scene([last]).clearance([other.corners for other in others]).min(-1)
    for other, end in zip(others, ends):
        gap = min(as_scene([other]).clearance(edge).min(), end)
        if CLOSED < gap < NARROWEST or (gap < 0 and other is not joined):
            return False
    return True


def are_blocked(boxes, begin, end):
    """Returns which of the straight lines from begin (L, 2) to end (L, 2) meet a box, (L,) bool."""
    return first_hit(boxes, begin, end - begin) < 1


def first_hit(boxes, begin, along):
    """Returns the distances (...) from begin (..., 2) along vectors (..., 2) to the first box, in
    lengths of the vectors: infinity if a ray meets none of the B boxes, 0 inside a box."""
    x, y, yaw, length, thickness = np.array(
        [(box.x, box.y, box.yaw, box.length, box.thickness) for box in boxes]).T
    turns = np.exp(-1j * yaw)  # rotations into the axes of each box
    first = (begin[..., :1] - x + 1j * (begin[..., 1:] - y)) * turns  # (..., B)
    across = (along[..., :1] + 1j * along[..., 1:]) * turns
    # Slab method: a ray is inside a box while it is between both pairs of opposite faces.
    enters = 0.0
    leaves = np.inf
    for place, speed, side in ((first.real, across.real, length),
                               (first.imag, across.imag, thickness)):
        speed = np.where(np.abs(speed) < 1e-12, 1e-12, speed)
        one = (-side / 2 - place) / speed
        other = (side / 2 - place) / speed
        enters = np.maximum(enters, np.minimum(one, other))
        leaves = np.minimum(leaves, np.maximum(one, other))
    return np.where(enters < leaves, enters, np.inf).min(-1)


def range_readings(world, angles, max_range):
    """Returns the distances (R, S) [m] from the robots of a `sim.World` to the first wall, at most
    max_range [m], along rays at angles (S,) [rad] from their headings."""
    headings = world.poses[:, 2:] + np.asarray(angles)  # (R, S)
    rays = np.stack([np.cos(headings), np.sin(headings)], -1)  # (R, S, 2) unit vectors
    distances = np.empty(headings.shape)
    rooms = np.array([id(scene) for scene in world.scenes])
    for room in set(rooms):
        robots = np.flatnonzero(rooms == room)
        boxes = world.scenes[robots[0]].boxes
        distances[robots] = first_hit(boxes, world.poses[robots, None, :2], rays[robots])
    return np.minimum(distances, max_range)


def share_blocked(scene):
    """Returns the fraction, in [0, 1], of straight lines between random reachable places, 1 m or
    more apart, that a box blocks."""
    rng = np.random.default_rng(0)
    begin, end = scene.reachable[rng.integers(len(scene.reachable), size=(2, MEASURED))]
    apart = np.hypot(*(end - begin).T) >= FAR_ENOUGH
    return float(are_blocked(scene.boxes, begin, end)[apart].sum() / max(apart.sum(), 1))


def as_scene(boxes):
    """Returns a Scene of these boxes without targets, for geometric queries."""
    return Scene("", tuple(boxes), (0.0, 0.0, 0.0), (), ())
