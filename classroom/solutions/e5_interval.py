"""A solution of exercise 5."""

import math

from classroom.exercises.e5_interval import Z


def wilson(successes, n):
    """Solves n (s - p)^2 = Z^2 p (1 - p), that is (n + Z^2) p^2 - (2 n s + Z^2) p + n s^2 = 0."""
    s = successes / n
    a = n + Z ** 2
    b = 2 * n * s + Z ** 2
    root = math.sqrt(max(b ** 2 - 4 * a * n * s ** 2, 0))
    return (b - root) / (2 * a), (b + root) / (2 * a)
