"""What several processes share that train together, as `torchrun --nproc-per-node 2 train.py`
starts them: the robots, the episodes of an update, the gradients.

A reader of the lesson can skip this file: `OneProcess`, the usual case, does nothing.
"""

import atexit
import os
from pathlib import Path

import torch
from torch import distributed


class OneProcess:
    """A process on its own: what all processes have is what it has."""

    rank = 0  # which of the processes this is
    count = 1  # how many there are

    def gather(self, mine):
        """What every process has, in the order of their ranks."""
        return [mine]

    def sum(self, tensor):
        """The sum of that tensor over all processes."""
        return tensor

    def average_gradients(self, model, steps):
        """Makes the gradients those of the minibatches of all processes together, whose losses are
        means over so many steps each."""


class ManyProcesses:
    """One of several processes, each with the same methods as `OneProcess`."""

    def __init__(self):
        distributed.init_process_group()
        atexit.register(distributed.destroy_process_group)  # else its threads may abort the exit
        self.rank = distributed.get_rank()
        self.count = distributed.get_world_size()

    def gather(self, mine):
        """What every process has, in the order of their ranks."""
        everyone = [None] * self.count
        distributed.all_gather_object(everyone, mine)
        return everyone

    def sum(self, tensor):
        """The sum of that tensor over all processes."""
        distributed.all_reduce(tensor)
        return tensor

    def average_gradients(self, model, steps):
        """Makes the gradients those of the minibatches of all processes together, whose losses are
        means over so many steps each."""
        some_parameter = next(model.parameters())
        all_steps = self.sum(some_parameter.new_tensor(steps))
        for parameter in model.parameters():
            self.sum(parameter.grad.mul_(steps / all_steps))


def join_processes(device):
    """This process among those that torchrun started, or the only one. On a GPU each takes one."""
    if device == "cuda":
        torch.cuda.set_device(int(os.environ.get("LOCAL_RANK", 0)))
    several = int(os.environ.get("WORLD_SIZE", 1)) > 1
    return ManyProcesses() if several else OneProcess()


def check_run(config, parser):
    """Ends the program where a run cannot be begun: its folder exists, there is no such GPU, or the
    robots and the episodes of an update cannot be shared evenly."""
    writes = int(os.environ.get("RANK", 0)) == 0
    if writes and config.out and Path(config.out).exists():
        parser.error(f"--out '{config.out}' exists already, it must name a new folder")
    if config.device == "cuda" and not torch.cuda.is_available():
        parser.error("--device is cuda, but torch finds no such GPU here; it must be cpu")
    count = int(os.environ.get("WORLD_SIZE", 1))
    for flag, value in (("robots", config.robots),
                        ("episodes-per-update", config.episodes_per_update)):
        if value % count:
            parser.error(f"--{flag} is {value}, it must be a multiple of the {count} processes")
    most = config.episodes_per_update // count
    if config.minibatches > most:
        parser.error(f"--minibatches is {config.minibatches}, it must be at most {most}, the "
                     "episodes of an update")
