"""Run folders: the files of one training run, in a new folder, none left half-written."""

import csv
import json
import os
from pathlib import Path


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
