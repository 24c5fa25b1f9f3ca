"""A solution of exercise 7."""

import torch


def policy_loss(log_probs, old_log_probs, A, eps):
    """Computes the ratio from the logarithms. If the clipped term is the smaller one, it is a
    constant and has no gradient."""
    r = (log_probs - old_log_probs).exp()
    return -torch.min(r * A, r.clamp(1 - eps, 1 + eps) * A).mean()
