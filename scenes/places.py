"""Where to start and where to drive to, in a room whose file says nothing of it.

The start is the spot with the most room around it, heading along x. Targets are spread out: each is
the place that is farthest from the start and from all targets before it. The last are the new ones.
Where boxes part a room in several, all lie in that of the start.

Of spots that are equally good the first one counts, by x, then by y. They are compared to a
micrometre, so that all machines choose the same.

Axis letters: X, Y cells of a grid, P points, n those of them that are left.
"""

from dataclasses import replace

import numpy as np

from scenes.limits import check
from sim import ROBOT_RADIUS, Scene, flood

GRID = 0.05  # [m] on which a start is looked for
MARGIN = 0.1  # [m] that targets keep between the robot's disc and any box; the paper's rooms: 0.1
APART = 0.2  # [m] between targets at least, and from the start: more than makes an arrival
TIE = 1e-6  # [m] below which distances count as equal
SAMPLE = 5000  # spots that a first guess of the freest one is made of
TRAINING_TARGETS = 10  # as in env2
NEW_TARGETS = 2


def complete(name, boxes, start=None):
    """The Scene of these boxes with targets of our choice and, where none is given, such a start.
    Raises SceneError where there is no closed room, or none that a robot can drive in."""
    if start is None:
        start = freest_spot(name, boxes)
    scene = Scene(name, tuple(boxes), start, (), ())
    targets = spread(scene, TRAINING_TARGETS + NEW_TARGETS)
    check(targets, f"the room has no target: the robot can drive no farther than {APART} m from "
                   f"the start ({start[0]:.2f}, {start[1]:.2f})")
    training = max(1, min(TRAINING_TARGETS, len(targets) - NEW_TARGETS))
    return replace(scene, training_targets=tuple(targets[:training]),
                   new_targets=tuple(targets[training:]))


def floor(scene):
    """The centres (X, Y, 2) [m] of a grid's cells, and which of them are inside the room and have
    room for the robot's disc, (X, Y) bool."""
    x, y = [np.arange(low - GRID, high + 2 * GRID, GRID) for low, high in zip(*scene.bounds)]
    grid = np.stack(np.meshgrid(x, y, indexing="ij"), -1)
    free = are_clear(scene, grid.reshape(-1, 2), ROBOT_RADIUS).reshape(grid.shape[:2])
    border = np.ones_like(free)
    border[1:-1, 1:-1] = False
    return grid, free & ~flood(free, border)


def are_clear(scene, points, distance):
    """Which of the points (P, 2) [m], sorted by x, are farther than that [m] from all boxes, (P,)
    bool. As `Scene.clearance` says, but it looks only near each box."""
    clear = np.ones(len(points), bool)
    for box in scene.boxes:
        reach = np.ptp(box.corners, axis=0) / 2 + distance + TIE
        first, last = np.searchsorted(points[:, 0], (box.x - reach[0], box.x + reach[0]))
        beside = np.abs(points[first:last, 1] - box.y) < reach[1]
        near = first + np.flatnonzero(clear[first:last] & beside)
        clear[near] = replace(scene, boxes=(box,)).clearance(points[near]) > distance
    return clear


def freest_spot(name, boxes):
    """The pose at the spot inside these boxes that is farthest from all of them."""
    scene = Scene(name, tuple(boxes), (0.0, 0.0, 0.0), (), ())
    grid, inside = floor(scene)
    check(inside.any(), "the boxes enclose no place that the robot fits into")
    spots = grid[inside]
    # How far all spots are from all boxes takes long. So a few tell how far the freest one is at
    # least, and that leaves only a few of all.
    least = scene.clearance(spots[::len(spots) // SAMPLE + 1]).max()
    spots = spots[are_clear(scene, spots, least - 2 * TIE)]
    x, y = spots[(scene.clearance(spots) / TIE).round().argmax()]
    return float(x), float(y), 0.0


def spread(scene, most):
    """Places [(x, y), ...] of the room's reachable floor, at most so many, APART from one another
    and from the start."""
    places = scene.reachable
    roomy = places[are_clear(scene, places, ROBOT_RADIUS + MARGIN)]
    if (distances(roomy, scene.start) > APART).any():
        places = roomy
    away = distances(places, scene.start)  # from the start and the targets so far
    chosen = []
    while len(chosen) < most and away.max(initial=0) > APART:
        x, y = places[(away / TIE).round().argmax()].tolist()
        chosen.append((round(x, 3), round(y, 3)))
        away = np.minimum(away, distances(places, chosen[-1]))
    return chosen


def distances(points, place):
    """How far [m] the points (P, 2) are from a place (x, y, ...), (P,)."""
    return np.hypot(points[:, 0] - place[0], points[:, 1] - place[1])
