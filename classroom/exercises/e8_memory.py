"""Exercise 8: no episode remembers the one before.

Episodes of different lengths are learnt from in one row, end to end, because that is fast; the
memory has to be empty at the first step of each. The project does it in `model.py`, `Memory`, with
a trick that lets torch run the whole row at once.
"""

import torch
from torch import nn


def run_row(cell, x, mask):
    """What an LSTM cell puts out at every step of a row, (T, hidden).

    x: (T, inputs). mask: (T,) bool, false at steps that are no steps of an episode: there the
    output is 0, and after them h and c are 0 again, as before the first step.
    cell: an nn.LSTMCell, `h, c = cell(x, (h, c))` with x (1, inputs), h and c (1, hidden).
    """
    raise NotImplementedError("your turn")


# ------------------------------------------------ python -m pytest classroom/exercises/e8_memory.py


def cell_and_steps(T, hidden=4):
    """A cell with random weights, and T inputs for it."""
    torch.manual_seed(0)
    return nn.LSTMCell(3, hidden), torch.randn(T, 3)


def alone(cell, x):
    """What the cell puts out in an episode that has a row for itself."""
    lstm = nn.LSTM(3, 4)
    lstm.load_state_dict({f"{name}_l0": value for name, value in cell.state_dict().items()})
    return lstm(x[:, None])[0][:, 0]


def test_one_episode_is_a_row():
    cell, x = cell_and_steps(5)
    assert torch.allclose(run_row(cell, x, torch.ones(5, dtype=bool)), alone(cell, x), atol=1e-6)


def test_two_episodes_in_a_row_do_not_know_of_each_other():
    cell, x = cell_and_steps(9)
    mask = torch.tensor([1, 1, 1, 0, 1, 1, 1, 1, 1], dtype=bool)
    out = run_row(cell, x, mask)
    assert torch.allclose(out[:3], alone(cell, x[:3]), atol=1e-6)
    assert torch.allclose(out[4:], alone(cell, x[4:]), atol=1e-6)
    assert (out[3] == 0).all()


def test_the_last_step_learns_from_the_first_of_its_episode():
    cell, x = cell_and_steps(6, hidden=5)
    x.requires_grad_()
    run_row(cell, x, torch.tensor([1, 1, 0, 1, 1, 1], dtype=bool))[-1].sum().backward()
    assert (x.grad[3] != 0).all() and (x.grad[:2] == 0).all()
    assert (cell.weight_hh.grad != 0).any()


def test_padding_at_the_end_teaches_nothing():
    cell, x = cell_and_steps(6)
    x.requires_grad_()
    run_row(cell, x, torch.tensor([1, 1, 1, 0, 0, 0], dtype=bool)).sum().backward()
    assert (x.grad[3:] == 0).all() and (x.grad[:3] != 0).all()
