"""A solution of exercise 8."""

import torch


def run_robots(cell, x, ended):
    """Step by step; a robot whose episode has ended continues with an empty memory."""
    h = torch.zeros(x.shape[1], cell.hidden_size)
    c = torch.zeros(x.shape[1], cell.hidden_size)
    out = []
    for t in range(len(x)):
        h, c = cell(x[t], (h, c))
        out.append(h)
        goes_on = ~ended[t][:, None]  # (R, 1)
        h = h * goes_on
        c = c * goes_on
    return torch.stack(out)
