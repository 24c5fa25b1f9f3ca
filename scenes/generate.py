"""Random rooms: `random:SEED` names one, and the same seed always makes the same room.

They are to be as difficult as the released ones. So they have their size, their boxes and their
passages, and as many lines of sight blocked. `python -m scenes random:7` draws one.

Axis letters: X, Y cells of a grid, L = LINES straight lines.
"""

import copy
import functools
import math

import numpy as np

from scenes.limits import check, shown
from scenes.places import GRID, complete
from sim import FAR_ENOUGH, ROBOT_RADIUS, Box, Scene, flood

PREFIX = "random:"
MOST_SEED = 10 ** 9
# All choices are ours, by what the released rooms have, which stands beside them.
LENGTHS = (4.6, 5.4)  # [m] outer sides of a room; 5.0
WIDTHS = (2.7, 3.3)  # [m] 3.0
BRICKS = (1.1, 2.2)  # [m] lengths; 1.15 to 1.73
BRICK_SHARE = 0.6  # of the obstacles; 12 of 22
BLOCKED = (0.35, 0.85)  # share of lines that obstacles are to block, drawn first; 0.41 to 0.82
NEAR = 0.05  # to the share that was drawn is a room's own
MEETS_BRICK = 0.4  # share of the bricks that meet another one, in an L or a T
MEETS_WALL = 0.4  # share of the other bricks that reach from a wall into the room
CLOSED = 0.3  # [m] gaps up to it are no passages; the robot needs 0.36
NARROWEST = 0.42  # [m] passages; 0.41 in maze 4
MOST_OBSTACLES = 8  # 4 or 5
TRIES = 100  # to put an obstacle somewhere
LINES = 2000  # whose share is measured while a room is made
MEASURED = 5000  # of a room that there is
MOST_KEPT = 128  # rooms that need not be made again, 0.3 MB each; a resumed run asks twice
CONNECTED = 0.97  # of the floor that the robot fits on, at least


def seed_of(name):
    """The seed in a name like `random:7`. Raises SceneError."""
    text = name.removeprefix(PREFIX)
    digits = text.isascii() and text.isdigit() and len(text) <= len(str(MOST_SEED))
    check(digits and int(text) <= MOST_SEED,
          f"scene {shown(name)} must be random: and a whole number from 0 to {MOST_SEED:,}")
    return int(text)


@functools.lru_cache(MOST_KEPT)
def room(seed):
    """The Scene `random:SEED`."""
    rng = np.random.default_rng(seed)
    wanted = rng.uniform(*BLOCKED)
    while True:
        plan = furnished(rng, wanted)
        if plan.share_blocked >= wanted - NEAR:  # else no place was found for enough boxes
            return complete(f"random-{seed}", plan.boxes)


def furnished(rng, wanted):
    """The Plan of a room that is to have that share of lines blocked. Boxes are tried one after the
    other, and one is kept if the gaps around it are clear, not too many lines are blocked then, and
    the robot can still drive from everywhere to everywhere."""
    length = rng.uniform(*LENGTHS)
    width = rng.uniform(*WIDTHS)
    right_angles = rng.random() < 0.5
    plan = Plan(walls(length, width), rng)
    material = drawn_material(rng)
    for _ in range(TRIES):
        box, joined = obstacle(rng, material, plan.boxes, length, width, right_angles)
        if not has_clear_gaps([*plan.boxes, box], joined):
            continue
        more = plan.with_box(box)
        if more.share_blocked > wanted + NEAR or not more.is_connected():
            continue
        plan = more
        # Drawn after a success alone: else bricks, which fit less often, would become rarer.
        material = drawn_material(rng)
        if plan.share_blocked >= wanted or len(plan.boxes) == 4 + MOST_OBSTACLES:
            break
    return plan


class Plan:
    """A room in the making. What is measured of it is kept, so that a box more costs one box."""

    def __init__(self, boxes, rng):
        """boxes: the outer walls."""
        scene = as_scene(boxes)
        low, high = scene.bounds
        x, y = [np.arange(a, b, GRID) for a, b in zip(low, high)]
        self.grid = np.stack(np.meshgrid(x, y, indexing="ij"), -1)  # (X, Y, 2) [m]
        self.ends = rng.uniform(low, high, (2, LINES, 2))  # (2, L, 2) [m] of straight lines
        self.boxes = boxes
        self.grid_clearance = scene.clearance(self.grid)  # (X, Y) [m]
        self.end_clearance = scene.clearance(self.ends)  # (2, L) [m]
        self.blocked = np.zeros(LINES, bool)

    def with_box(self, box):
        """The same plan with a box more."""
        more = copy.copy(self)
        scene = as_scene([box])
        more.boxes = [*self.boxes, box]
        more.grid_clearance = np.minimum(self.grid_clearance, scene.clearance(self.grid))
        more.end_clearance = np.minimum(self.end_clearance, scene.clearance(self.ends))
        more.blocked = self.blocked | are_blocked([box], *self.ends)
        return more

    @property
    def share_blocked(self):
        """The share of the straight lines between two places, where the robot fits and 1 m or more
        apart, that a box blocks."""
        apart = np.hypot(*(self.ends[1] - self.ends[0]).T) >= FAR_ENOUGH
        counts = apart & (self.end_clearance > ROBOT_RADIUS).all(0)
        return float(self.blocked[counts].mean()) if counts.any() else 1.0

    def is_connected(self):
        """Whether the robot can drive from nearly everywhere to nearly everywhere."""
        free = self.grid_clearance > ROBOT_RADIUS
        freest = self.grid_clearance == self.grid_clearance.max()
        reached = flood(free, freest).sum()
        return 0 < CONNECTED * free.sum() <= reached


def walls(length, width):
    """The four outer walls of a room around the origin, as the released rooms have them."""
    x = length / 2 - 0.075
    y = width / 2 - 0.075
    return [Box("wall", -x, 0.0, -math.pi / 2, width, 0.15, 2.5),
            Box("wall", 0.0, -y, 0.0, length, 0.15, 2.5),
            Box("wall", x, 0.0, math.pi / 2, width, 0.15, 2.5),
            Box("wall", 0.0, y, math.pi, length, 0.15, 2.5)]


def drawn_material(rng):
    """What the next obstacle is to be made of."""
    return "brick" if rng.random() < BRICK_SHARE else "wood"


def obstacle(rng, material, boxes, length, width, right_angles):
    """A brick or a wooden box somewhere: free, or with an end at a wall or at another brick.
    Returns the Box and the one that it is joined to, or None."""
    yaw = rng.uniform(-math.pi, math.pi)
    if right_angles:
        yaw = rng.integers(4) * math.pi / 2
    place = rng.uniform((-length / 2, -width / 2), (length / 2, width / 2))
    if material == "wood":
        return Box("wood", *place.tolist(), float(yaw), 0.61, 0.6, 0.6), None
    joined = None
    brick = rng.uniform(*BRICKS)
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
        place = end + brick / 2 * direction(yaw)
    return Box("brick", float(place[0]), float(place[1]), float(yaw), brick, 0.3, 1.5), joined


def direction(yaw):
    """The unit vector (2,) along an angle [rad]."""
    return np.array((math.cos(yaw), math.sin(yaw)))


def has_clear_gaps(boxes, joined):
    """Whether the last box reaches out of the room nowhere, into another box nowhere but into the
    one that it is joined to, and leaves only gaps that are closed or passages."""
    *others, last = boxes
    low, high = as_scene(boxes[:4]).bounds
    corners = last.corners
    if (corners < low).any() or (corners > high).any():
        return False
    edge = np.concatenate([np.linspace(corners[k - 1], corners[k], 24, endpoint=False)
                           for k in range(4)])
    for other in others:
        gap = min(as_scene([other]).clearance(edge).min(),
                  as_scene([last]).clearance(other.corners).min())
        if CLOSED < gap < NARROWEST or (gap < 0 and other is not joined):
            return False
    return True


def are_blocked(boxes, begin, end):
    """Which of the straight lines (L,) from begin (L, 2) to end (L, 2) meet a box: those that are
    inside both of its pairs of faces at one place, after they have entered the one pair and the
    other, and before they have left either."""
    blocked = np.zeros(len(begin), bool)
    for box in boxes:
        c = math.cos(box.yaw)
        s = math.sin(box.yaw)
        own = np.array([(c, -s), (s, c)])  # into the box's axes
        first = (begin - (box.x, box.y)) @ own
        way = (end - begin) @ own
        way[way == 0] = 1e-12
        half = np.array((box.length, box.thickness)) / 2
        faces = np.stack([(-half - first) / way, (half - first) / way])  # as shares of the line
        enters = faces.min(0).max(-1)
        leaves = faces.max(0).min(-1)
        blocked |= np.maximum(enters, 0) < np.minimum(leaves, 1)
    return blocked


def share_blocked(scene):
    """The share of the straight lines between two places of a room, 1 m or more apart, that
    something blocks: how much of it there is to drive around, in [0, 1]."""
    rng = np.random.default_rng(0)
    begin, end = scene.reachable[rng.integers(len(scene.reachable), size=(2, MEASURED))]
    apart = np.hypot(*(end - begin).T) >= FAR_ENOUGH
    if not apart.any():  # a room that small
        return 0.0
    return float(are_blocked(scene.boxes, begin[apart], end[apart]).mean())


def as_scene(boxes):
    """These boxes as a Scene without targets, for its geometry."""
    return Scene("", tuple(boxes), (0.0, 0.0, 0.0), (), ())
