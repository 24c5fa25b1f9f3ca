"""A solution of exercise 8."""

import torch


def run_robots(cell, x, ended):
    """Runs step by step. A robot whose episode has ended continues with a memory of zeros."""
    h = torch.zeros(x.shape[1], cell.hidden_size)
    c = torch.zeros(x.shape[1], cell.hidden_size)
    out = []
    for t in range(len(x)):
        h, c = cell(x[t], (h, c))
        out.append(h)
        continues = ~ended[t][:, None]  # (R, 1)
        h = h * continues
        c = c * continues
    return torch.stack(out)
