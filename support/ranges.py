"""Range sensors, as the paper's real robot has them (IV-C). The learner does without."""

import math

import numpy as np

from sim import ROBOT_FILTER


def range_readings(world, angles, max_range):
    """(R, len(angles)) distances [m] from the centre of each robot of a `sim.World` to the first
    wall, at most max_range [m], along rays at those angles [rad] from its heading."""
    readings = np.full((len(world.scenes), len(angles)), float(max_range))
    for r, (x, y, theta) in enumerate(world.state()[:-1, :3]):  # where pymunk has them
        for k, angle in enumerate(angles):
            end = (x + max_range * math.cos(theta + angle), y + max_range * math.sin(theta + angle))
            hit = world.space.segment_query_first((x, y), end, 0, ROBOT_FILTER)
            if hit:
                readings[r, k] = max_range * hit.alpha
    return readings
