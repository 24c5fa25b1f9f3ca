"""Run folders: the files of one training run, none overwritten, none left half-written."""

import csv
import json
import os
from dataclasses import asdict
from itertools import chain, count
from pathlib import Path

import torch


def write(path, content):
    """A whole file or none: text, or a function that writes to the path it is given."""
    partial = path.with_name(f".{path.name}")
    content(partial) if callable(content) else partial.write_text(content + "\n")
    os.replace(partial, path)


class RunFolder:
    """A new folder and the files in it."""

    def __init__(self, out, default, config):
        """Makes the folder `out`, or where that is empty `default`, `default`-2, ..., the first
        that does not exist, and writes the config, a dict. Raises OSError."""
        names = chain([out or default], (f"{out or default}-{copy}" for copy in count(2)))
        self.path = next(path for path in map(Path, names) if not path.exists())
        self.path.mkdir(parents=True)
        self._tables = {}
        self.write("config.json", json.dumps(config, indent=2))

    def write(self, name, content):
        """A file of the run, by `write`."""
        write(self.path / name, content)

    def add_row(self, name, row):
        """One more row, a dict, of a CSV table."""
        if name not in self._tables:
            self._tables[name] = file = open(self.path / name, "w", newline="", buffering=1)
            csv.writer(file).writerow(row)
        csv.writer(self._tables[name]).writerow(row.values())

    def save_model(self, model, scene):
        """Weights, what rebuilds the network, and the scene; loads with `weights_only=True`."""
        content = {"weights": model.state_dict(), "memory": model.memory,
                   "without": model.without, "scene": asdict(scene)}
        self.write("model.pt", lambda path: torch.save(content, path))
