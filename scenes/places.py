"""Chooses a start and targets for a room whose file has none. Among equally good places it takes
the first one by x, then by y. Distances are rounded to a micrometre before they are compared, so
that all machines make the same choice. Axis letters: X, Y cells of a grid, P places."""

import logging
from dataclasses import replace

import numpy as np

from sim import ROBOT_RADIUS, Box, Scene, SceneError, flood

GRID = 0.05  # [m] cell size of the grid on which the start is searched for
MARGIN = 0.1  # [m] minimum gap between a robot at a target and any box, as in the paper's rooms
APART = 0.2  # [m] minimum distance between targets, and to the start; above ARRIVAL_DISTANCE
TIE = 1e-6  # [m] distances that differ by less count as equal
BLOCK = 1.0  # [m] edge of the squares in which the freest place is searched for
THICKNESS = 0.15  # [m] of outer walls, as in the released rooms
TRAINING_TARGETS = 10  # as in env2
NEW_TARGETS = 2
remarks = logging.getLogger("scenes")  # tells users what differs from a room's file


def complete(name, boxes, start=None):
    """Returns the Scene of these boxes with chosen targets and, unless a pose is given, a chosen
    start. A room with an opening gets a fence around all boxes. Raises SceneError if the robot
    cannot drive in it."""
    scene = Scene(name, tuple(boxes), start or (0.0, 0.0, 0.0), (), ())
    floor, opening = largest_part(scene, start)
    if opening is not None:
        x, y = opening
        remarks.warning("room %r has an opening at (%.2f, %.2f): a fence around it closes it", name,
                        x, y)
        scene = replace(scene, boxes=(*scene.boxes, *fence(scene.bounds)))
    if not start:
        x, y = freest_place(scene, floor)
        scene = replace(scene, start=(float(x), float(y), 0.0))
    targets = spread(scene, TRAINING_TARGETS + NEW_TARGETS)
    if not targets:
        raise SceneError(f"the robot can drive at most {APART} m from the start")
    training = max(1, min(TRAINING_TARGETS, len(targets) - NEW_TARGETS))
    return replace(scene, training_targets=tuple(targets[:training]),
                   new_targets=tuple(targets[training:]))


def largest_part(scene, start):
    """Returns the places (P, 2) [m] of the largest connected part of the floor, or of the part with
    the start, and a place (x, y) at which the robot can leave it, or None. Floor that the boxes
    enclose counts twice: the floor outside a small room may be larger."""
    low, high = scene.bounds
    x, y = [np.arange(a, b, GRID) for a, b in zip(low - GRID, high + 2 * GRID)]
    grid = np.stack(np.meshgrid(x, y, indexing="ij"), -1)  # (X, Y, 2) [m]
    free = are_clear(scene, grid.reshape(-1, 2), ROBOT_RADIUS).reshape(grid.shape[:2])
    border = np.ones_like(free)
    border[1:-1, 1:-1] = False
    outside = flood(free, border)
    # [m] how far the robot at each place would be past a fence around all boxes
    beyond = np.maximum(low - grid, grid - high).max(-1) + ROBOT_RADIUS
    part = parts(free & (beyond <= TIE))
    cells = part >= 0
    if start:
        away = np.where(cells, np.hypot(*np.moveaxis(grid - start[:2], -1, 0)), np.inf)
        if not scene.fits(start) or away.min() > GRID:
            raise SceneError(f"start {start[:2]} is outside the room or too close to a box")
        chosen = part.flat[away.argmin()]
    else:
        size = np.bincount(part[cells])
        enclosed = np.bincount(part[cells], ~outside[cells])
        if not len(size):
            raise SceneError("the boxes do not enclose a place that the robot fits into")
        chosen = (size + enclosed).argmax()
    inside = part == chosen
    exits = grid[inside & outside & (beyond > -GRID)]  # next to the fence
    return grid[inside], exits[len(exits) // 2] if len(exits) else None


def parts(free):
    """Returns the connected part that each free cell belongs to, (X, Y) int; -1 if not free. Each
    cell begins as a part. Neighbours join their parts, until all neighbours are in the same one."""
    cell = np.arange(free.size).reshape(free.shape)
    across = free[1:] & free[:-1]
    along = free[:, 1:] & free[:, :-1]
    one = np.concatenate([cell[1:][across], cell[:, 1:][along]])  # pairs of neighbours
    other = np.concatenate([cell[:-1][across], cell[:, :-1][along]])
    part = cell.ravel()
    while len(one):
        low, high = np.sort([part[one], part[other]], axis=0)
        np.maximum.at(part, low, high)  # joins the part `low` to the part `high`
        while (part != part[part]).any():
            part = part[part]
        apart = part[one] != part[other]
        one = one[apart]
        other = other[apart]
    return np.where(free, part.reshape(free.shape), -1)


def walls(length, width):
    """Returns the four outer walls of a room around the origin, with the released dimensions."""
    x = (length - THICKNESS) / 2
    y = (width - THICKNESS) / 2
    return [Box("wall", -x, 0.0, -np.pi / 2, width, THICKNESS, 2.5),
            Box("wall", 0.0, -y, 0.0, length, THICKNESS, 2.5),
            Box("wall", x, 0.0, np.pi / 2, width, THICKNESS, 2.5),
            Box("wall", 0.0, y, np.pi, length, THICKNESS, 2.5)]


def fence(bounds):
    """Returns four walls around these bounds (2, 2) [m], a list of Boxes."""
    x, y = bounds.mean(0).tolist()
    length, width = (np.ptp(bounds, axis=0) + 2 * THICKNESS).tolist()
    return [replace(wall, x=wall.x + x, y=wall.y + y) for wall in walls(length, width)]


def freest_place(scene, places):
    """Returns the one of the places (P, 2) [m] that is farthest from all boxes. Searches blocks of
    places, highest upper bound of clearance first, until no block can have more."""
    column, row = np.floor(places / BLOCK).astype(int).T
    blocks, block = np.unique(column * 10 ** 6 + row, return_inverse=True)
    order = np.argsort(block, kind="stable")  # places by block
    groups = np.split(order, np.cumsum(np.bincount(block))[:-1])
    centres = np.array([places[group].mean(0) for group in groups])
    most = scene.clearance(centres) + BLOCK * np.sqrt(2)  # no place of the block has more
    clearance = np.full(len(places), -np.inf)
    for k in np.argsort(-most):
        if most[k] < clearance.max() - TIE:
            break
        clearance[groups[k]] = scene.clearance(places[groups[k]])
    return places[(clearance / TIE).round().argmax()]


def spread(scene, most):
    """Returns at most `most` reachable places (x, y). Each is the place farthest from the start and
    all earlier ones. They are more than APART apart, and MARGIN from boxes if possible."""
    places = scene.reachable
    roomy = places[are_clear(scene, places, ROBOT_RADIUS + MARGIN)]
    if np.hypot(*(roomy - scene.start[:2]).T).max(initial=0) > APART:
        places = roomy
    chosen = []
    away = np.full(len(places), np.inf)  # [m] distance from the start and all chosen places
    x, y = scene.start[:2]
    for _ in range(most):
        away = np.minimum(away, np.hypot(places[:, 0] - x, places[:, 1] - y))
        if away.max(initial=0) <= APART:
            break
        x, y = [round(value, 3) for value in places[(away / TIE).round().argmax()].tolist()]
        chosen.append((x, y))
    return chosen


def are_clear(scene, points, distance):
    """Returns whether points (P, 2) [m], sorted by x, are farther than a distance [m] from all
    boxes, (P,). Faster than `Scene.clearance`, since it computes distances only near each box."""
    clear = np.ones(len(points), bool)
    x, y = points.T.copy()
    for box in scene.boxes:
        reach = np.ptp(box.corners, axis=0) / 2 + distance + TIE
        first, last = np.searchsorted(x, (box.x - reach[0], box.x + reach[0]))
        near = first + np.flatnonzero(np.abs(y[first:last] - box.y) < reach[1])
        clear[near] &= replace(scene, boxes=(box,)).clearance(points[near]) > distance
    return clear
