"""Exercise 7: one step, but not too far.

The same episodes are learnt from several times, while the policy moves away from the one that drove
them. PPO stops paying for a change that has gone far enough. The project does it in `ppo.py`,
`losses`, the paper's Eq. (3).
"""

import pytest
import torch


def policy_loss(log_probs, old_log_probs, A, eps):
    """The loss to be made small, a tensor of one number: minus the mean over all steps of

        min(r A, clip(r, 1 - eps, 1 + eps) A),    r = p / p_old,

    from the log-probabilities of the actions now and as they were taken, and the advantages, (B,)
    each.
    """
    raise NotImplementedError("your turn")


# ------------------------------------------ python -m pytest classroom/exercises/e7_clipped_loss.py


def slope(ratio, advantage, eps=0.2):
    """How the loss changes with the log-probability of one action."""
    log_prob = torch.tensor([float(ratio)]).log().requires_grad_()
    policy_loss(log_prob, torch.zeros(1), torch.tensor([float(advantage)]), eps).backward()
    return log_prob.grad.item()


def test_before_anything_has_changed_it_is_minus_the_mean_advantage():
    A = torch.tensor([1.0, -3.0, 5.0])
    old = torch.tensor([-1.0, -2.0, -0.5])
    assert policy_loss(old, old, A, 0.2).item() == pytest.approx(-1.0)


def test_good_actions_become_likelier_and_bad_ones_less_likely():
    assert slope(1.0, 2.0) == pytest.approx(-2.0)
    assert slope(1.0, -2.0) == pytest.approx(2.0)


def test_what_has_gone_far_enough_goes_no_further():
    assert slope(1.3, 2.0) == 0 and slope(0.7, -2.0) == 0
    assert slope(1.3, 2.0, eps=0.5) == pytest.approx(-2.6)


def test_what_has_gone_the_wrong_way_comes_back():
    assert slope(0.7, 2.0) == pytest.approx(-1.4) and slope(1.3, -2.0) == pytest.approx(2.6)


def test_its_value_is_the_smaller_one():
    ratios = torch.tensor([0.5, 1.5, 0.5, 1.5]).log()
    A = torch.tensor([1.0, 1.0, -1.0, -1.0])
    assert policy_loss(ratios, torch.zeros(4), A, 0.2).item() == pytest.approx(
        -(0.5 + 1.2 - 0.8 - 1.5) / 4)
