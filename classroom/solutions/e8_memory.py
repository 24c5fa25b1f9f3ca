"""A solution of exercise 8."""

import torch


def run_row(cell, x, mask):
    """Step by step; one that is no step of an episode empties the memory."""
    empty = torch.zeros(1, cell.hidden_size)
    h, c = empty, empty
    out = []
    for t in range(len(x)):
        if mask[t]:
            h, c = cell(x[t:t + 1], (h, c))
        else:
            h, c = empty, empty
        out.append(h[0])
    return torch.stack(out)
