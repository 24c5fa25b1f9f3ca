"""Exercise 7: a limit on the change of the policy.

An update uses the same episodes several times, while the policy moves away from the one that drove
them. PPO gives no gradient to a probability that has already changed far enough. In the project:
`losses` in `ppo.py`, the paper's Eq. (3).
"""

import pytest
import torch


def policy_loss(log_probs, old_log_probs, A, eps):
    """Returns the loss to minimize, a tensor with one number: minus the mean over all steps of

        min(r A, clip(r, 1 - eps, 1 + eps) A),    r = p / p_old.

    log_probs: (B,) log-probabilities of the actions now. old_log_probs: (B,) when they were taken.
    A: (B,) advantages.
    """
    raise NotImplementedError("your turn")


# ------------------------------------------ python -m pytest classroom/exercises/e7_clipped_loss.py


def gradient(ratio, advantage, eps=0.2):
    """Returns the gradient of the loss with respect to the log-probability of one action."""
    log_prob = torch.tensor([float(ratio)]).log().requires_grad_()
    policy_loss(log_prob, torch.zeros(1), torch.tensor([float(advantage)]), eps).backward()
    return log_prob.grad.item()


def test_if_the_policy_has_not_changed_it_is_minus_the_mean_advantage():
    A = torch.tensor([1.0, -3.0, 5.0])
    old = torch.tensor([-1.0, -2.0, -0.5])
    assert policy_loss(old, old, A, 0.2).item() == pytest.approx(-1.0)


def test_good_actions_become_likelier_and_bad_ones_less_likely():
    assert gradient(1.0, 2.0) == pytest.approx(-2.0)
    assert gradient(1.0, -2.0) == pytest.approx(2.0)


def test_a_probability_that_has_changed_far_enough_has_no_gradient():
    assert gradient(1.3, 2.0) == 0 and gradient(0.7, -2.0) == 0
    assert gradient(1.3, 2.0, eps=0.5) == pytest.approx(-2.6)


def test_a_probability_that_moved_in_the_wrong_direction_comes_back():
    assert gradient(0.7, 2.0) == pytest.approx(-1.4) and gradient(1.3, -2.0) == pytest.approx(2.6)


def test_the_objective_is_the_smaller_of_the_two():
    ratios = torch.tensor([0.5, 1.5, 0.5, 1.5]).log()
    A = torch.tensor([1.0, 1.0, -1.0, -1.0])
    assert policy_loss(ratios, torch.zeros(4), A, 0.2).item() == pytest.approx(
        -(0.5 + 1.2 - 0.8 - 1.5) / 4)
