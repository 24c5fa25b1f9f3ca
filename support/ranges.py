"""Range sensors, as the paper's real robot has them (IV-C). The learner does without.

Axis letters: R robots, S sensors, B boxes of a room.
"""

import numpy as np


def range_readings(world, angles, max_range):
    """(R, S) distances [m] from the centre of each robot of a `sim.World` to the first wall, at
    most max_range [m], along rays at those angles (S,) [rad] from its heading."""
    readings = np.full((len(world.scenes), len(angles)), float(max_range))
    robots_of = {}  # a room, by identity -> its robots
    for r, scene in enumerate(world.scenes):
        robots_of.setdefault(id(scene), []).append(r)
    poses = world.poses
    for robots in robots_of.values():
        scene = world.scenes[robots[0]]
        headings = poses[robots, 2:] + np.asarray(angles)  # (n, S)
        met = nearest(scene.boxes, poses[robots, :2], headings)
        readings[robots] = np.minimum(met, max_range)
    return readings


def nearest(boxes, places, headings):
    """How far (n, S) [m] it is from places (n, 2) along headings (n, S) [rad] to the first of B
    boxes; infinite where there is none, 0 inside one. A ray is inside a box while it is between
    both of its pairs of faces."""
    places = places[:, 0] + 1j * places[:, 1]
    centres = np.array([box.x + 1j * box.y for box in boxes])
    turns = np.exp(-1j * np.array([box.yaw for box in boxes]))  # into each box's axes
    first = (places[:, None, None] - centres) * turns  # (n, 1, B)
    way = np.exp(1j * headings)[..., None] * turns  # (n, S, B)
    half_length = np.array([box.length / 2 for box in boxes])
    half_thickness = np.array([box.thickness / 2 for box in boxes])
    enters_x, leaves_x = between(first.real, way.real, half_length)
    enters_y, leaves_y = between(first.imag, way.imag, half_thickness)
    enters = np.maximum(np.maximum(enters_x, enters_y), 0)
    meets = enters < np.minimum(leaves_x, leaves_y)
    return np.where(meets, enters, np.inf).min(-1)


def between(first, way, half):
    """How far along a ray it comes between two faces at -half and half, and out again. first: where
    it begins; way: how far it goes across, a metre of its length."""
    way = np.where(np.abs(way) < 1e-12, 1e-12, way)
    one = (-half - first) / way
    other = (half - first) / way
    return np.minimum(one, other), np.maximum(one, other)
