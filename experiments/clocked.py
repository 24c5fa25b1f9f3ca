"""Trains like train.py, then prints one line of JSON: the seconds of each call of each part, and
the memory. Usage: `python -m experiments.clocked`, followed by the options of train.py."""

import json
import sys
import time
from collections import defaultdict
from pathlib import Path

import torch

import ppo
import train
from evaluation import after_training
from model import Network
from navbot_min import NavVecEnv
from support import parallel

CLOCKS = (("preparing", train.Training, "__init__"), ("training", train, "train"),
          ("collecting", train.Training, "collect"), ("acting", Network, "act"),
          ("environment", NavVecEnv, "step"), ("gradient", ppo, "losses"),
          ("gradient", torch.Tensor, "backward"), ("optimizer", torch.optim.Adam, "step"),
          ("evaluation", after_training, "evaluate_frozen"),
          ("curves", after_training, "draw_curves"), ("curves", after_training, "save"))


def clocked(call, calls):
    """Returns the call with a clock: each time it appends its start and duration [s] to `calls`."""
    def timed(*arguments):
        start = time.perf_counter()
        result = call(*arguments)
        calls.append((start, time.perf_counter() - start))
        return result
    return timed


def main(argv):
    """Trains, and prints the line."""
    calls = defaultdict(list)
    for part, owner, name in CLOCKS:
        setattr(owner, name, clocked(getattr(owner, name), calls[part]))
    train.main(argv)
    if parallel.rank() == 0:
        end = sum(calls["training"][0])  # excludes the evaluation, which drives too
        seconds = {part: [length for start, length in calls[part]
                          if start < end or part in ("evaluation", "curves")] for part in calls}
        status = Path("/proc/self/status")  # on Linux; VmHWM is the peak memory [kB]
        held = status.read_text().split("VmHWM:")[1].split()[0] if status.exists() else 0
        print(json.dumps({"seconds": seconds, "memory_mb": int(held) // 1000}))


if __name__ == "__main__":
    main(sys.argv[1:])
