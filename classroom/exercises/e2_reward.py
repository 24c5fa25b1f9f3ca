"""Exercise 2: the reward.

A reward defines the goal, not how to reach it. Here the robot should come nearer at every step and
arrive without a collision. In the project: `rewards` in `navbot_min.py`, the paper's Eq. (4).
"""

import numpy as np

ARRIVAL = 100.0
COLLISION = -50.0
PER_METRE = 100.0
STEP = 0.05


def rewards(before, after, arrived, hit):
    """Returns the rewards (R,) of R robots for one step: ARRIVAL if the robot arrived; otherwise
    COLLISION if it hit something; otherwise PER_METRE per metre that it came nearer, minus STEP.

    before, after: (R,) [m] distances to the target. arrived, hit: (R,) bool; both can be true.
    """
    raise NotImplementedError("your turn")


# ------------------------------------------------ python -m pytest classroom/exercises/e2_reward.py


def reward_of(before, after, arrived=False, hit=False):
    """Returns the reward of one robot."""
    [reward] = rewards(np.array([before]), np.array([after]), np.array([arrived]), np.array([hit]))
    return reward


def test_a_step_nearer_is_rewarded_per_metre():
    assert np.isclose(reward_of(1.00, 0.90), 9.95)


def test_a_step_away_costs_as_much_and_each_step_costs_time():
    assert np.isclose(reward_of(0.90, 1.00), -10.05)
    assert np.isclose(reward_of(1.00, 1.00), -0.05)


def test_the_last_step_has_one_reward_and_arrival_comes_first():
    assert reward_of(0.2, 0.1, arrived=True) == 100
    assert reward_of(0.5, 0.4, hit=True) == -50
    assert reward_of(0.2, 0.1, arrived=True, hit=True) == 100


def test_many_robots_are_computed_at_once():
    got = rewards(np.array([1.0, 1.0, 1.0, 2.0]), np.array([0.9, 0.9, 0.9, 1.8]),
                  np.array([False, True, False, False]), np.array([False, False, True, False]))
    assert np.allclose(got, [9.95, 100, -50, 19.95])
