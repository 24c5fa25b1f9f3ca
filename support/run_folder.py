"""The folder of a run: config, tables, weights and checkpoint. No file is left half-written."""

import csv
import itertools
import json
import os
import shlex
import sys
import time
import zipfile
from contextlib import ExitStack, contextmanager, nullcontext
from dataclasses import asdict
from pathlib import Path

import torch

from sim import SceneError
from support import parallel
from support.cli import program
from support.rooms import RANDOM, ROOM, load_rooms
from support.runs import RunError, write
from support.weights import FILE, save_model

try:
    import fcntl
except ImportError:  # on Windows
    fcntl = None

CHECKPOINT = "checkpoint.pt"
EVERY = 10.0  # [s] minimum time between two writes of the newest weights, our choice
TABLES = ("episodes.csv", "updates.csv")
COUNTED = ("stage", "steps", "episodes", "seconds", "arrivals")  # of a Training, in a checkpoint
OF_A_COMMAND = ("resume", "json")  # options that a run does not keep


class Table:
    """A CSV file that grows row by row."""

    def __init__(self, path, size):
        """size: number of bytes to keep of the file; 0 for a new file."""
        self.file = open(path, "a+", newline="", buffering=1)  # each line can be read at once
        self.file.seek(self.file.truncate(size))
        self.writer = csv.writer(self.file)

    def add(self, row):
        """Adds a row: a dict from column to value. Raises OSError."""
        if self.file.tell() == 0:
            self.writer.writerow(row)
        self.writer.writerow(row.values())

    def size(self):
        """Writes the file to disk and returns its size in bytes."""
        os.fsync(self.file.fileno())
        return self.file.tell()


class RunFolder(ExitStack):
    """The files of one run. Only one program can write to them, until `close`."""

    def __init__(self, path):
        """Locks the folder, if its file system has locks. Raises RunError, OSError."""
        super().__init__()
        self.path = Path(path)
        self.tables = {}
        self._written = time.monotonic()
        if fcntl is not None:
            lock = os.open(self.path, os.O_RDONLY)
            self.callback(os.close, lock)
            try:
                fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
            except BlockingIOError:
                raise RunError(f"run '{path}' is in use by another program") from None
            except OSError:
                pass  # this file system has no locks

    def load_checkpoint(self):
        """Loads `state` (or None) from the last checkpoint, and cuts the tables back to it.
        Nothing in the file is executed. Raises RunError, OSError."""
        file = self.path / CHECKPOINT
        saved = {"state": None, "sizes": [0, 0]}
        if file.exists():
            try:
                with zipfile.ZipFile(file) as archive:
                    if archive.testzip():  # torch does not verify checksums
                        raise ValueError
                saved = torch.load(file, "cpu", weights_only=True)
            except Exception as error:  # an error of zipfile, pickle or torch
                raise RunError(f"'{file}' is damaged ({type(error).__name__}): the run cannot be "
                               "resumed, but its weights can be evaluated") from None
        for name, size in zip(TABLES, saved["sizes"]):
            self.tables[name] = Table(self.path / name, size)
            self.callback(self.tables[name].file.close)
        self.state = saved["state"]

    def save_checkpoint(self, state):
        """Writes a checkpoint. state: dicts of tensors and numbers. Raises OSError."""
        content = {"state": state, "sizes": [table.size() for table in self.tables.values()]}
        write(self.path / CHECKPOINT, lambda file: torch.save(content, file))

    def offer_weights(self, model, scenes, now=False):
        """Writes the weights, unless it did so in the last ten seconds. Raises OSError."""
        if now or time.monotonic() - self._written > EVERY:
            save_model(self.path / FILE, model, scenes)
            self._written = time.monotonic()


def begin_run(config, parser, environment):
    """Returns the config of a run and its Scenes, and makes the folder of a new run. environment:
    the class to train in. Exits if input is invalid. Raises RunError, SceneError, OSError."""
    if config.resume:
        config = resumed(config, parser.given)
    check_config(config, parser)
    scenes = load_rooms(config)
    environment.check_rooms(scenes)
    if parallel.rank() == 0:
        if not config.resume:
            make_folder(config, RANDOM if config.env == RANDOM else scenes[0].name)
            if config.env != RANDOM:
                write(Path(config.out, ROOM), json.dumps(asdict(scenes[0])))
        print(f"run folder: {config.out}", file=sys.stderr if config.json else sys.stdout)
    return config, scenes


def make_folder(config, name):
    """Makes a new run's folder and sets `config.out` to it. The default is the first free one of
    runs/NAME-seedK, runs/NAME-seedK-2, ... Raises RunError."""
    for copy in itertools.count(1):
        suffix = f"-{copy}" if copy > 1 else ""
        path = Path(config.out or f"runs/{name}-seed{config.seed}{suffix}")
        try:
            path.mkdir(parents=True)  # fails if another program was faster
            break
        except FileExistsError:
            if config.out:
                raise RunError(f"--out '{path}' already exists; it must name a new folder")
        except OSError as error:
            raise RunError(f"folder '{path}' cannot be created: {error.strerror}")
    config.out = str(path)


def open_folder(config):
    """Returns the RunFolder of a run, for a `with`, and writes its config. In all processes except
    the first, returns a context whose value is None. Raises RunError, OSError."""
    if parallel.rank() > 0:
        return nullcontext()
    folder = RunFolder(config.out)
    folder.load_checkpoint()
    kept = {name: value for name, value in asdict(config).items() if name not in OF_A_COMMAND}
    write(folder.path / "config.json", json.dumps(kept, indent=2))
    if config.resume and not folder.state:
        print("no checkpoint yet: the run starts again from the beginning", file=sys.stderr)
    return folder


def state_of(training):
    """Returns the state of a Training for a checkpoint. Call it in all processes."""
    counted = {name: getattr(training, name) for name in COUNTED}
    return counted | {"model": training.model.state_dict(),
                      "optimizer": training.optimizer.state_dict(),
                      "rngs": parallel.gather(training.rng.bit_generator.state)}


def restore(training, state):
    """Restores the state of a Training with the same config."""
    training.model.load_state_dict(state["model"])
    training.optimizer.load_state_dict(state["optimizer"])
    training.rng.bit_generator.state = state["rngs"][parallel.rank()]
    for name in COUNTED:
        setattr(training, name, state[name])


@contextmanager
def report_errors(config, parser):
    """Ends the program with one sentence if a run cannot start or is interrupted."""
    try:
        yield
    except (SceneError, RunError) as error:
        parser.error(error)
    except (KeyboardInterrupt, OSError, FloatingPointError, parallel.ProcessLost) as error:
        folder = config.out or config.resume
        begun = Path(folder, "config.json").exists()
        then = f"resume with {program()} --resume {shlex.quote(folder)}" if begun else "not started"
        if not isinstance(error, KeyboardInterrupt):
            sys.exit(f"\nerror: {error}; {then}")
        print(f"\ninterrupted; {then}", file=sys.stderr)
        sys.exit(130)  # the exit code of a program that Ctrl-C ended


def resumed(config, given):
    """Returns the config of the run that `config.resume` names, with the changes that this command
    line may make. given: names of the options on it. Raises RunError."""
    path = Path(config.resume)
    try:
        own = json.loads((path / "config.json").read_text(encoding="utf-8"))
        changed = {"resume": config.resume, "json": config.json, "out": str(path)}
        kinds = {name: type(value) for name, value in (own | changed).items()}
        if kinds != {name: type(value) for name, value in asdict(config).items()}:
            raise ValueError  # the file was edited, or another program wrote it
        run = type(config)(**own | changed)
    except (FileNotFoundError, NotADirectoryError):
        raise RunError(f"--resume '{path}' is not a run folder: it has no config.json") from None
    except (OSError, ValueError, TypeError):
        raise RunError(f"'{path / 'config.json'}' is not a config of {program()}: resume a run "
                       "with the program that started it") from None
    for name in given.difference(OF_A_COMMAND):
        value = getattr(config, name)
        if name == "steps" and value < run.steps:
            raise RunError(f"--steps is {value}; it must be at least {run.steps}, the value that "
                           f"run '{path}' was started with")
        if name in ("steps", "device"):
            setattr(run, name, value)
        elif value != own[name]:
            raise RunError(f"--{name.replace('_', '-')} is {value}, but run '{path}' was "
                           f"started with {own[name]!r}: leave it out")
    return run


def check_config(config, parser):
    """Exits if options contradict each other. Sets those that follow from others."""
    if config.env == RANDOM and "targets" not in parser.given:
        config.targets = "anywhere"
    if config.env == RANDOM and config.targets != "anywhere":
        parser.error(f"--targets is {config.targets}; with --env {RANDOM} it must be anywhere")
    for name, other, needed in (("rooms", "env", RANDOM), ("mirrored", "targets", "both"),
                                ("random_starts", "targets", "both")):
        if name in parser.given and getattr(config, other) != needed:
            parser.error(f"--{name.replace('_', '-')} is {getattr(config, name)}; it has an effect "
                         f"only with --{other} {needed}: leave it out")
    parallel.check_processes(config, parser)
