"""Run folders: the files of one training run, in a new folder, none left half-written; and both
ends of the format of its weights, `save_model` and `load_run`."""

import csv
import json
import os
import pickle
import warnings
from dataclasses import asdict
from pathlib import Path

import torch

import scenes as scene_files
from model import Network


class RunError(ValueError):
    """A run that cannot be used; the message names it and says why."""


def write(path, content):
    """A whole file or none: text, or a function that writes to the path it is given."""
    partial = path.with_name(f".{path.name}")
    try:
        if callable(content):
            content(partial)
        else:
            partial.write_text(content + "\n", encoding="utf-8")
        os.replace(partial, path)
    finally:
        partial.unlink(missing_ok=True)


def new_folder(name):
    """The first of `name`, `name-2`, `name-3` ... that does not exist."""
    path = Path(name)
    copy = 1
    while path.exists():
        copy += 1
        path = Path(f"{name}-{copy}")
    return path


class RunFolder:
    """A new folder and the files in it."""

    def __init__(self, path, config):
        """Makes the folder, which must not exist, and writes the config, a dict. Raises OSError."""
        self.path = Path(path)
        self.path.mkdir(parents=True)
        self._tables = {}
        self.write("config.json", json.dumps(config, indent=2))

    def write(self, name, content):
        """A file of the run, by `write`."""
        write(self.path / name, content)

    def add_row(self, name, row):
        """One more row, a dict, of a CSV table."""
        if name not in self._tables:
            file = open(self.path / name, "w", newline="", buffering=1, encoding="utf-8")
            csv.writer(file).writerow(row)
            self._tables[name] = file
        csv.writer(self._tables[name]).writerow(row.values())


class NoFolder:
    """What a process writes to that leaves the run folder to another one: nothing."""

    def add_row(self, name, row):
        """Writes nothing."""


def save_model(path, model, scenes):
    """Writes the weights, what rebuilds the network, and the scenes it learnt in."""
    content = {"weights": model.state_dict(), "memory": model.memory, "without": model.without,
               "scenes": [asdict(scene) for scene in scenes]}
    write(Path(path), lambda partial: torch.save(content, partial))


def load_run(path):
    """The network and the list of scenes of a run folder, or of its weights' file. Raises RunError;
    what is in the file is never executed."""
    valid = "it must be a run folder or a .pt file"
    if not Path(path).exists():
        raise RunError(f"run '{path}' does not exist: {valid}")
    file = Path(path) / "model.pt" if Path(path).is_dir() else Path(path)
    if not file.is_file():
        raise RunError(f"run '{path}' has no {file.name}: {valid}")
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # about files that are none of ours: the error says it
            saved = torch.load(file, weights_only=True, map_location="cpu")
        scenes = [scene_files.rebuild(fields) for fields in saved["scenes"]]
        model = Network(saved["memory"], saved["without"])
        model.load_state_dict(saved["weights"])
    except KeyError as error:
        raise RunError(f"'{file}' is not a whole run of this network: it has no {error}") from None
    except (pickle.UnpicklingError, EOFError, RuntimeError, TypeError, ValueError,
            AttributeError) as error:
        reason = (str(error) or type(error).__name__).splitlines()[0][:200]
        raise RunError(f"'{file}' is not a whole run of this network: {reason}") from None
    return model, scenes
