"""A solution of exercise 2."""

import numpy as np

from classroom.exercises.e2_reward import ARRIVAL, COLLISION, PER_METRE, STEP


def rewards(before, after, arrived, hit):
    """The outer `where` takes precedence, so an arrival counts more than a collision."""
    progress = PER_METRE * (before - after) - STEP
    return np.where(arrived, ARRIVAL, np.where(hit, COLLISION, progress))
