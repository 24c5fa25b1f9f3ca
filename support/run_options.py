"""What the options of a run must obey together, and how many processes share it by default."""

import os
from pathlib import Path

import torch

from support.cores import available_cores
from support.processes import torchrun_count

MOST_WORKERS = 4  # unless more are asked for: more were not tried, and each takes memory


def default_workers(config):
    """As many workers as there are cores to use that can share the robots, MOST_WORKERS at most."""
    if torchrun_count():
        return torchrun_count()
    if config.device == "cuda":
        return 1
    most = min(len(available_cores()), MOST_WORKERS,
               config.episodes_per_update // config.minibatches)
    return max(count for count in range(1, max(most, 1) + 1) if config.robots % count == 0)


def check_run(config, parser):
    """Ends the program where a run cannot be begun: its folder exists, there is no such GPU, or the
    robots and the episodes of a minibatch cannot be shared. Sets `config.workers` if it is 0."""
    writes = int(os.environ.get("RANK", 0)) == 0
    if writes and config.out and Path(config.out).exists():
        parser.error(f"--out '{config.out}' exists already, it must name a new folder")
    if config.device == "cuda" and not torch.cuda.is_available():
        parser.error("--device is cuda, but torch finds no such GPU here; it must be cpu")
    if config.minibatches > config.episodes_per_update:
        parser.error(f"--minibatches is {config.minibatches}, it must be at most "
                     f"{config.episodes_per_update}, the episodes of an update")
    config.workers = config.workers or default_workers(config)
    if torchrun_count() not in (0, config.workers):
        parser.error(f"--workers is {config.workers}, under torchrun it must be left out")
    if config.device == "cuda" and config.workers > 1 and not torchrun_count():
        parser.error(f"--workers is {config.workers}, with --device cuda it must be 1; torchrun "
                     "shares the work of several GPUs")
    if config.robots % config.workers:
        parser.error(f"--robots is {config.robots}, it must be a multiple of the "
                     f"{config.workers} processes")
    most = config.episodes_per_update // config.minibatches
    if config.workers > most:
        parser.error(f"--workers is {config.workers}, it must be at most {most}, the episodes of a "
                     "minibatch")
