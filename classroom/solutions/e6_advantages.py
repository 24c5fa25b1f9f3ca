"""A solution of exercise 6."""

import numpy as np


def advantages(rewards, values, last_value, gamma, lam):
    """Runs backwards from the last step, since each advantage needs the next one."""
    following = np.append(values[1:], last_value)
    delta = rewards + gamma * following - values
    A = np.zeros(len(delta))
    after = 0.0
    for t in reversed(range(len(delta))):
        A[t] = delta[t] + gamma * lam * after
        after = A[t]
    return A
