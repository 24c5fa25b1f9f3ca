"""A solution of exercise 10, one of many. The comparison shows whether it is better."""

import numpy as np

STEP = 0.5  # ten times the value in Eq. (4)


def rewards(before, after, arrived, hit):
    """Returns Eq. (4) with a higher cost per step, so that slow progress is not rewarded."""
    progress = 100 * (before - after) - STEP
    return np.where(arrived, 100.0, np.where(hit, -50.0, progress))
