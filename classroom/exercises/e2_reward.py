"""Exercise 2: what the robot is paid.

A reward says what is wanted, not how to do it: here, to come nearer at every step, and to arrive
without a touch. The project does it in `navbot_min.py`, `rewards`, the paper's Eq. (4).
"""

import numpy as np

ARRIVAL = 100.0
COLLISION = -50.0
PER_METRE = 100.0
STEP = 0.05


def rewards(before, after, arrived, hit):
    """The rewards (R,) of R robots for one step: ARRIVAL for one that arrived; else COLLISION for
    one that hit something; else PER_METRE for each metre that it came nearer, less STEP.

    before, after: (R,) [m] distances to the target. arrived, hit: (R,) bool; both can be true.
    """
    raise NotImplementedError("your turn")


# ------------------------------------------------ python -m pytest classroom/exercises/e2_reward.py


def paid(before, after, arrived=False, hit=False):
    """The reward of one robot."""
    [reward] = rewards(np.array([before]), np.array([after]), np.array([arrived]), np.array([hit]))
    return reward


def test_a_step_nearer_pays_by_the_metre():
    assert np.isclose(paid(1.00, 0.90), 9.95)


def test_a_step_away_costs_as_much_and_time_costs_both_ways():
    assert np.isclose(paid(0.90, 1.00), -10.05)
    assert np.isclose(paid(1.00, 1.00), -0.05)


def test_an_end_pays_once_and_arriving_counts_more_than_touching():
    assert paid(0.2, 0.1, arrived=True) == 100
    assert paid(0.5, 0.4, hit=True) == -50
    assert paid(0.2, 0.1, arrived=True, hit=True) == 100


def test_many_robots_are_paid_at_once():
    got = rewards(np.array([1.0, 1.0, 1.0, 2.0]), np.array([0.9, 0.9, 0.9, 1.8]),
                  np.array([False, True, False, False]), np.array([False, False, True, False]))
    assert np.allclose(got, [9.95, 100, -50, 19.95])
