"""A solution of exercise 10, one of many; whether it is better, the judge says."""

import numpy as np

STEP = 0.5  # ten times as much as by Eq. (4)


def rewards(before, after, arrived, hit):
    """Eq. (4), but time costs more: so dawdling does not pay, and nearing must be worth it."""
    progress = 100 * (before - after) - STEP
    return np.where(arrived, 100.0, np.where(hit, -50.0, progress))
