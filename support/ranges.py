"""Range sensors, as the paper's real robot has them (IV-C). R robots, S sensors."""

import numpy as np

from scenes.generate import first_hit


def range_readings(world, angles, max_range):
    """Returns the distances (R, S) [m] from the centre of each robot of a `sim.World` to the first
    wall, at most max_range [m], along rays at those angles (S,) [rad] from its heading."""
    headings = world.poses[:, 2:] + np.asarray(angles)  # (R, S)
    ways = np.stack([np.cos(headings), np.sin(headings)], -1)  # (R, S, 2)
    places = world.poses[:, None, :2]
    met = np.empty(headings.shape)
    rooms = np.array([id(scene) for scene in world.scenes])
    for room in set(rooms):
        robots = np.flatnonzero(rooms == room)
        boxes = world.scenes[robots[0]].boxes
        met[robots] = first_hit(boxes, places[robots], ways[robots])
    return np.minimum(met, max_range)
