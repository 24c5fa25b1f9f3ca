"""Exercise 8: an episode does not remember the one before.

Several robots drive in parallel, and their episodes end at different steps. The memory must be zero
at the first step of each episode, and only there. In the project: `Policy.reset` in
`evaluation/drivers.py`. An update does it differently: each episode has its own row, padded with
zeros to the length of the longest one, and a mask marks the real steps (`losses` in `ppo.py`).
"""

import torch
from torch import nn


def run_robots(cell, x, ended):
    """Returns the outputs of an LSTM cell for R robots and T steps, (T, R, hidden).

    x: (T, R, inputs). ended: (T, R) bool, true if the robot's episode ends with that step. At its
    next step h and c are 0, as at the first step. The other robots keep their h and c.
    cell: an nn.LSTMCell, `h, c = cell(x, (h, c))` with x (R, inputs), h and c (R, hidden).
    """
    raise NotImplementedError("your turn")


# ------------------------------------------------ python -m pytest classroom/exercises/e8_memory.py

EPISODES = [[(0, 9)], [(0, 4), (4, 9)], [(0, 1), (1, 2), (2, 7), (7, 9)]]  # steps, robot by robot


def cell_and_steps():
    """Returns a cell with random weights, 9 inputs for each of 3 robots, and `ended` for them."""
    torch.manual_seed(0)
    ended = torch.zeros(9, 3, dtype=bool)
    for r, episodes in enumerate(EPISODES):
        for _, end in episodes:
            ended[end - 1, r] = True
    return nn.LSTMCell(3, 4), torch.randn(9, 3, 3), ended


def run_one(cell, x):
    """Returns the outputs of one episode, (T, hidden), from torch's own LSTM. x: (T, inputs)."""
    lstm = nn.LSTM(3, 4)
    lstm.load_state_dict({f"{name}_l0": value for name, value in cell.state_dict().items()})
    return lstm(x)[0]


def test_every_episode_is_computed_as_if_it_were_the_only_one():
    cell, x, ended = cell_and_steps()
    out = run_robots(cell, x, ended)
    for r, episodes in enumerate(EPISODES):
        for begin, end in episodes:
            assert torch.allclose(out[begin:end, r], run_one(cell, x[begin:end, r]), atol=1e-6)


def test_the_last_step_depends_on_every_step_of_its_episode_and_on_no_other():
    cell, x, ended = cell_and_steps()
    x.requires_grad_()
    run_robots(cell, x, ended)[8, 1].sum().backward()
    assert (x.grad[4:, 1] != 0).all() and (x.grad[:4, 1] == 0).all()
    assert (x.grad[:, [0, 2]] == 0).all() and (cell.weight_hh.grad != 0).any()
