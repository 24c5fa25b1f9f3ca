"""Exercise 6: was an action better than expected?

The advantage compares the rewards after an action with the predicted value. Later rewards have a
lower weight. In the project: `advantages` in `ppo.py`.
"""

import numpy as np


def advantages(rewards, values, last_value, gamma, lam):
    """Returns the generalised advantage estimates of one episode of T steps, (T,):

        A_t = delta_t + gamma lam A_{t+1},    delta_t = r_t + gamma V_{t+1} - V_t,

    with A_T = 0 and V_T = last_value, which is 0 if the robot arrived or collided. rewards, values:
    (T,).
    """
    raise NotImplementedError("your turn")


# -------------------------------------------- python -m pytest classroom/exercises/e6_advantages.py

REWARDS = np.array([1.0, -2.0, 0.5, 3.0])
VALUES = np.array([0.3, 0.1, -0.4, 2.0])


def test_with_lambda_0_it_is_the_td_error():
    expected = [1.0 + 0.9 * 0.1 - 0.3, -2.0 + 0.9 * -0.4 - 0.1, 0.5 + 0.9 * 2.0 + 0.4,
                3.0 + 0.9 * 5.0 - 2.0]
    assert np.allclose(advantages(REWARDS, VALUES, 5.0, 0.9, 0.0), expected)


def test_with_lambda_1_it_is_the_return_minus_the_value():
    returns = [sum(0.9 ** k * r for k, r in enumerate(REWARDS[t:])) + 0.9 ** (4 - t) * 5.0
               for t in range(4)]
    assert np.allclose(advantages(REWARDS, VALUES, 5.0, 0.9, 1.0), returns - VALUES)


def test_in_between_it_is_the_discounted_sum_of_td_errors():
    following = np.append(VALUES[1:], 5.0)
    delta = REWARDS + 0.9 * following - VALUES
    summed = [sum((0.9 * 0.8) ** k * d for k, d in enumerate(delta[t:])) for t in range(4)]
    assert np.allclose(advantages(REWARDS, VALUES, 5.0, 0.9, 0.8), summed)


def test_an_episode_of_one_step():
    assert np.allclose(advantages(np.array([1.0]), np.array([0.4]), 0.0, 0.9, 0.8), [0.6])


def test_with_gamma_0_only_the_next_reward_counts_and_the_arguments_do_not_change():
    rewards = REWARDS.copy()
    assert np.allclose(advantages(rewards, VALUES, 5.0, 0.0, 0.8), REWARDS - VALUES)
    assert np.array_equal(rewards, REWARDS)
