"""Chooses a start and targets for a room whose file has none. Among equally good places it takes
the first one by x, then by y. Distances are rounded to a micrometre before they are compared, so
that all machines make the same choice. Axis letters: X, Y cells of a grid."""

from dataclasses import replace

import numpy as np

from sim import ROBOT_RADIUS, Scene, SceneError, flood

GRID = 0.05  # [m] cell size of the grid on which the start is searched for
MARGIN = 0.1  # [m] minimum gap between a robot at a target and any box, as in the paper's rooms
APART = 0.2  # [m] minimum distance between targets, and to the start; above ARRIVAL_DISTANCE
TIE = 1e-6  # [m] distances that differ by less count as equal
TRAINING_TARGETS = 10  # as in env2
NEW_TARGETS = 2


def complete(name, boxes):
    """Returns the Scene of these boxes with a chosen start and targets. Raises SceneError if the
    boxes do not enclose a room or the robot cannot drive in it."""
    scene = Scene(name, tuple(boxes), (0.0, 0.0, 0.0), (), ())
    scene = replace(scene, start=freest_place(scene))
    targets = spread(scene, TRAINING_TARGETS + NEW_TARGETS)
    if not targets:
        raise SceneError(f"the robot can drive at most {APART} m from the start")
    training = max(1, min(TRAINING_TARGETS, len(targets) - NEW_TARGETS))
    return replace(scene, training_targets=tuple(targets[:training]),
                   new_targets=tuple(targets[training:]))


def freest_place(scene):
    """Returns a pose, heading along x, at the place inside the room farthest from all boxes."""
    x, y = [np.arange(low - GRID, high + 2 * GRID, GRID) for low, high in zip(*scene.bounds)]
    grid = np.stack(np.meshgrid(x, y, indexing="ij"), -1)  # (X, Y, 2) [m]
    free = are_clear(scene, grid, ROBOT_RADIUS)
    border = np.ones_like(free)
    border[1:-1, 1:-1] = False
    inside = grid[free & ~flood(free, border)]
    if not len(inside):
        raise SceneError("the boxes do not enclose a place that the robot fits into")
    x, y = inside[(scene.clearance(inside) / TIE).round().argmax()]
    return float(x), float(y), 0.0


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
    """Returns whether points (..., 2) [m] are farther than a distance [m] from all boxes, (...).
    Faster than `Scene.clearance`, since it computes distances only near each box."""
    clear = np.ones(points.shape[:-1], bool)
    for box in scene.boxes:
        reach = np.ptp(box.corners, axis=0) / 2 + distance + TIE
        near = (np.abs(points - (box.x, box.y)) < reach).all(-1)
        clear[near] &= replace(scene, boxes=(box,)).clearance(points[near]) > distance
    return clear
