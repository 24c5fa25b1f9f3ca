"""Checkpoints: a training as it is between two updates, in its run folder.

`checkpoint.pt` is the last one and `checkpoint-before.pt` the one before it, for the case that the
last cannot be read. Each holds all that changes while a policy learns, for all processes, and the
rows of both CSV tables. A training that goes on from one writes the bytes that it would have
written without the break, with the same number of processes on the same machine.
"""

import contextlib
import math
import os
import sys
import time
from dataclasses import asdict
from pathlib import Path

import numpy as np
import torch

from scenes.limits import shown_path
from support.interruption import interruption
from support.processes import OneProcess, torchrun_rank
from support.run_folder import RunError
from support.torch_files import read_torch_file
from support.weights import check_weights, scenes_of

LAST = "checkpoint.pt"
BEFORE = "checkpoint-before.pt"
DAMAGED = "checkpoint-damaged.pt"  # a last one that could not be read
FORMAT = "navbot_min checkpoint"
VERSION = 1
EVERY = 30.0  # [s] from one checkpoint to the next
SHARE = 0.01  # of the time that checkpoints may take; where they are slow, they are rarer
LARGEST = 2 ** 33  # bytes of a checkpoint; 64 robots need some 30 MB
LONGEST_WORD = 100  # in a row of a CSV table
ROWS = {  # the first columns of the CSV tables; all others hold a float
    "episodes": {"steps": int, "scene": str, "target_x": float, "target_y": float, "kind": str,
                 "outcome": str, "return": float, "length": int},
    "updates": {"steps": int}}


class Keeper:
    """Saves a training from time to time, and when the program is asked to end."""

    def __init__(self, folder, scenes):
        """folder: the RunFolder, or in other processes than the first NoFolder."""
        self.folder = folder
        self.scenes = scenes
        self._interval = EVERY
        self._last = time.monotonic()

    def go_on(self, training):
        """To be called between two updates, by all processes alike. Saves the training when it is
        time. Whether training goes on: not where any of the processes is asked to end."""
        processes = training.processes
        asked = processes.count_all(len(interruption.signals))
        interruption.patient = True  # from here on a signal waits for the next call
        due = processes.rank == 0 and time.monotonic() - self._last >= self._interval
        if processes.count_all(int(due)) and not asked:
            self.save(training)
        return not asked

    def save(self, training):
        """Writes a checkpoint. All processes call it at the same time. Raises WriteError,
        RunError."""
        begin = time.monotonic()
        check_weights(training.model)
        state = training.state()
        collectors = training.processes.gather(packed(state.pop("collector")))
        self.folder.keep(LAST, BEFORE, lambda file: torch.save(to_tensors(
            {"format": FORMAT, "version": VERSION, "state": state, "collectors": collectors,
             "scenes": [asdict(scene) for scene in self.scenes]}), file))
        self._last = time.monotonic()
        self._interval = max(EVERY, (self._last - begin) / SHARE)


class NoKeeper:
    """Saves nothing."""

    def go_on(self, training):
        """Training goes on."""
        return True

    def save(self, training):
        """Saves nothing."""


def load(config, make_training):
    """The scenes of the run in `config.out` and the states of all its processes, by the last of its
    checkpoints that can be read; None where there is none yet. make_training(config, scenes,
    processes) makes a Training to compare with. Raises RunError where there are checkpoints and
    none can be used."""
    refused = None
    for name in (LAST, BEFORE):
        file = Path(config.out) / name
        if not file.exists():
            continue
        try:
            saved = read(file, config, make_training)
        except RunError as error:
            refused = refused or error
            continue
        if refused is not None:
            set_aside(Path(config.out), refused)
        return saved
    if refused is not None:
        raise refused
    return None


def set_aside(folder, refused):
    """Keeps the last checkpoint, which was refused, from taking the place of the one before it when
    the next is written, and says so."""
    if torchrun_rank() == 0:
        print(f"{refused}: going on from {BEFORE}", file=sys.stderr)
        with contextlib.suppress(OSError):  # a folder that cannot be written to is said later
            os.replace(folder / LAST, folder / DAMAGED)


def read(file, config, make_training):
    """The scenes and the states of all processes by this checkpoint. Raises RunError."""
    saved = read_torch_file(file, LARGEST)
    form, version = saved.get("format"), saved.get("version")
    if type(form) is not str or type(version) is not int or (form, version) != (FORMAT, VERSION):
        raise RunError(f"{shown_path(file)} is no checkpoint of this version of the program")
    try:
        scenes = scenes_of(saved)
        states = [saved["state"] | {"collector": part} for part in saved["collectors"]]
        if len(states) != config.workers:
            raise ValueError
        processes = OneProcess()
        processes.count = config.workers
        training = make_training(config, scenes, processes)
        training.collector.step()  # so that there is an unfinished episode to compare with
        like = training.state()
        like["collector"] = packed(like["collector"])
        like = to_tensors(like)
        for state in states:
            check_like(state, like)
            if state["collector"]["length"].max() > training.env.max_episode_steps:
                raise ValueError
            state["collector"] = unpacked(state["collector"])
            training.load_state(state)  # whatever it raises, before anything is begun
            check_state(training)
    except (KeyError, TypeError, ValueError, IndexError, RuntimeError, AttributeError,
            OverflowError):
        raise RunError(f"{shown_path(file)} is no whole checkpoint of this run") from None
    return scenes, states


def check_like(saved, like):
    """Checks that what was saved has the names, types and shapes of what is alike, and holds finite
    numbers alone. Raises ValueError."""
    if isinstance(like, dict) and isinstance(saved, dict):
        if saved.keys() != like.keys():
            raise ValueError
        for name in like:
            if name == "history":
                check_history(saved[name], like[name], saved["length"])
            elif name in ROWS:
                check_rows(saved[name], ROWS[name])
            else:
                check_like(saved[name], like[name])
    elif type(saved) is not type(like):
        raise ValueError
    elif isinstance(like, (int, float)) and not 0 <= saved < math.inf:  # none of them is negative
        raise ValueError
    elif isinstance(like, torch.Tensor):
        check_tensor(saved, like.dtype, like.shape)


def check_history(saved, like, lengths):
    """Checks the unfinished episodes, which have these lengths. Raises ValueError."""
    steps = int(lengths.sum())
    if (lengths < 0).any() or (steps and list(saved) != list(like)):
        raise ValueError
    for name in saved:
        check_tensor(saved[name], like[name].dtype, (steps, *like[name].shape[1:]))


def check_rows(rows, like):
    """Checks the rows of a CSV table. Raises ValueError."""
    for row in rows:
        if list(row) != list(rows[0]) or list(row)[:len(like)] != list(like):
            raise ValueError
        for name, value in row.items():
            valid = len(value) <= LONGEST_WORD if type(value) is str else math.isfinite(value)
            if type(value) is not like.get(name, float) or not valid:
                raise ValueError


def check_tensor(tensor, dtype, shape):
    """Checks that a tensor is such a one, of finite numbers. Raises ValueError."""
    if tensor.dtype != dtype or tensor.shape != torch.Size(shape) or not tensor.isfinite().all():
        raise ValueError


def check_state(training):
    """Checks numbers that are used as an index, and that robots moved no sooner than it was time.
    Raises ValueError."""
    if training.rooms.moves > training.rooms.due(training.record.steps):
        raise ValueError
    env = training.env
    for r, scene in enumerate(env.world.scenes):
        if not 0 <= env._target[r] < len(scene.targets):
            raise ValueError


def packed(collector):
    """A collector's state with its unfinished episodes end to end, by robot: name -> (steps, ...).
    What else its history holds is of episodes that have ended."""
    lengths = collector["length"]
    history = collector["history"]
    steps = [(r, t) for r in range(len(lengths))
             for t in range(len(history) - lengths[r], len(history))]
    names = history[0] if steps else {}
    return collector | {"history": {name: np.stack([history[t][name][r] for r, t in steps])
                                    for name in names}}


def unpacked(collector):
    """The state of a collector that `packed` and `to_tensors` made this of."""
    collector = to_arrays(collector)
    lengths = collector["length"]
    R = len(lengths)
    T = max(lengths)
    history = [{name: np.zeros((R, *rows.shape[1:]), rows.dtype)
                for name, rows in collector["history"].items()} for _ in range(T)]
    steps = [(r, t) for r in range(R) for t in range(T - lengths[r], T)]
    for name, rows in collector["history"].items():
        for (r, t), row in zip(steps, rows):
            history[t][name][r] = row
    return collector | {"history": history}


def to_tensors(content):
    """The same with tensors for arrays: only these can be read again without executing anything."""
    if isinstance(content, dict):
        return {name: to_tensors(value) for name, value in content.items()}
    if isinstance(content, (list, tuple)):
        return [to_tensors(value) for value in content]
    if isinstance(content, np.ndarray):
        return torch.from_numpy(content)
    return content


TENSORS = ("generator", "memory")  # what is a tensor in a collector's state, too


def to_arrays(content, name=""):
    """The state of a collector that `to_tensors` made this of."""
    if isinstance(content, dict):
        return {key: to_arrays(value, key) for key, value in content.items()}
    if isinstance(content, torch.Tensor) and name not in TENSORS:
        return content.numpy()
    return content
