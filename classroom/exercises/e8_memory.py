"""Exercise 8: no episode remembers the one before.

Several robots drive side by side, and their episodes end at different steps. A memory has to be
empty at the first step of each episode, and only there. The project does it in
`evaluation/drivers.py`, `Policy.reset`. When it learns, each episode has its own row, filled with
zeros up to the longest one, and a mask says which steps count: `ppo.py`, `losses`.
"""

import torch
from torch import nn


def run_robots(cell, x, ended):
    """Returns what an LSTM cell puts out at each step of R robots, (T, R, hidden).

    x: (T, R, inputs). ended: (T, R) bool, true if the robot's episode ends with that step: at its
    next step h and c are 0, as at the first one. The other robots keep theirs.
    cell: an nn.LSTMCell, `h, c = cell(x, (h, c))` with x (R, inputs), h and c (R, hidden).
    """
    raise NotImplementedError("your turn")


# ------------------------------------------------ python -m pytest classroom/exercises/e8_memory.py

EPISODES = [[(0, 9)], [(0, 4), (4, 9)], [(0, 1), (1, 2), (2, 7), (7, 9)]]  # steps, robot by robot


def cell_and_steps():
    """A cell with random weights, 9 inputs for each of 3 robots, and where their episodes end."""
    torch.manual_seed(0)
    ended = torch.zeros(9, 3, dtype=bool)
    for r, episodes in enumerate(EPISODES):
        for _, end in episodes:
            ended[end - 1, r] = True
    return nn.LSTMCell(3, 4), torch.randn(9, 3, 3), ended


def run_one(cell, x):
    """Returns the outputs of one episode, (T, hidden), by torch's loop. x: (T, inputs)."""
    lstm = nn.LSTM(3, 4)
    lstm.load_state_dict({f"{name}_l0": value for name, value in cell.state_dict().items()})
    return lstm(x)[0]


def test_every_episode_is_as_if_there_were_no_other():
    cell, x, ended = cell_and_steps()
    out = run_robots(cell, x, ended)
    for r, episodes in enumerate(EPISODES):
        for begin, end in episodes:
            assert torch.allclose(out[begin:end, r], run_one(cell, x[begin:end, r]), atol=1e-6)


def test_the_last_step_learns_from_all_of_its_episode_and_from_nothing_else():
    cell, x, ended = cell_and_steps()
    x.requires_grad_()
    run_robots(cell, x, ended)[8, 1].sum().backward()
    assert (x.grad[4:, 1] != 0).all() and (x.grad[:4, 1] == 0).all()
    assert (x.grad[:, [0, 2]] == 0).all() and (cell.weight_hh.grad != 0).any()
