"""A solution of exercise 1."""

import numpy as np


def wrap_angle(angle):
    """Subtracts from pi the remainder modulo a whole turn, so pi stays pi and -pi becomes pi."""
    return np.pi - np.mod(np.pi - angle, 2 * np.pi)
