"""A solution of exercise 3."""

import numpy as np


def polar_target(pose, target):
    """The bearing is the direction in the room minus the heading, wrapped."""
    x, y, theta = pose
    dx = target[0] - x
    dy = target[1] - y
    bearing = np.arctan2(dy, dx) - theta
    return np.hypot(dx, dy), np.pi - np.mod(np.pi - bearing, 2 * np.pi)
