"""Exercise 5: the uncertainty of a success rate.

61 of 100 episodes is a sample: another hundred would give another number. An interval contains the
true rates that agree with the sample. In the project: `wilson` in `evaluation/measures.py`.
"""

import math

import numpy as np
import pytest

Z = 1.959963984540054  # 95 % of a normal distribution lie within Z standard deviations


def wilson(successes, n):
    """Returns the 95 % interval (low, high) of a rate, by Wilson (1927). It contains all rates p
    that are at most Z standard deviations away from the observed rate s = successes / n,

        |s - p| <= Z sqrt(p (1 - p) / n).

    The two ends solve a quadratic equation in p. n is at least 1.
    """
    raise NotImplementedError("your turn")


# ---------------------------------------------- python -m pytest classroom/exercises/e5_interval.py


def test_both_ends_are_z_standard_deviations_away():
    for successes, n in ((61, 100), (3, 5), (990, 1000)):
        for p in wilson(successes, n):
            assert abs(successes / n - p) == pytest.approx(Z * math.sqrt(p * (1 - p) / n))


def test_the_observed_rate_is_inside():
    low, high = wilson(61, 100)
    assert low < 0.61 < high


def test_0_and_100_percent_are_not_certain():
    low, high = wilson(20, 20)
    assert high == pytest.approx(1) and low == pytest.approx(20 / (20 + Z ** 2))
    low, high = wilson(0, 20)
    assert low == pytest.approx(0) and high == pytest.approx(Z ** 2 / (20 + Z ** 2))


def test_it_contains_the_true_rate_in_95_of_100_experiments():
    rng = np.random.default_rng(0)
    seen = rng.binomial(100, 0.8, size=2000)
    inside = [low <= 0.8 <= high for low, high in (wilson(int(k), 100) for k in seen)]
    assert 0.93 < np.mean(inside) < 0.97
