"""A solution of exercise 1."""

import numpy as np


def wrap_angle(angle):
    """Turning back from pi by what is left over of whole turns: so pi stays, and -pi becomes pi."""
    return np.pi - np.mod(np.pi - angle, 2 * np.pi)
