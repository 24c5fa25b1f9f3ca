"""Run folders: the files of one training run, none left half-written."""

import csv
import errno
import io
import json
import os
import shlex
from dataclasses import asdict
from pathlib import Path

from support.interruption import interruption

try:
    import fcntl
except ImportError:  # on Windows
    fcntl = None


PASSING = ("resume", "json")  # options that say nothing about the run


class RunError(ValueError):
    """A run that cannot be used; the message names it and says why."""


class WriteError(Exception):
    """A file that cannot be written; the message names it and says why."""

    def __init__(self, path, error):
        super().__init__(f"'{path}' cannot be written: {error.strerror or error}")


def write(path, content, before=None):
    """A whole file or none, on the disk when this returns: text, bytes, or a function that writes
    to the binary file it is given. before: the name that the file gets which was there before, if
    it is to be kept. Raises WriteError."""
    path = Path(path)
    if callable(content):
        file = io.BytesIO()
        content(file)
        content = file.getvalue()
    elif isinstance(content, str):
        content = f"{content}\n".encode()
    partial = path.with_name(f".{path.name}.partial")
    try:
        with open(partial, "wb") as file:
            file.write(content)
            file.flush()
            os.fsync(file.fileno())
        if before is not None and path.exists():
            os.replace(path, path.with_name(before))
        os.replace(partial, path)
        if fcntl is not None:  # the folder's own entry, too; Windows does so by itself
            folder = os.open(path.parent, os.O_RDONLY)
            os.fsync(folder)
            os.close(folder)
    except OSError as error:
        raise WriteError(path, error) from None
    finally:
        try:
            partial.unlink(missing_ok=True)
        except OSError:
            pass  # a folder that cannot be written to any more


def new_folder(name):
    """The first of `name`, `name-2`, `name-3` ... that does not exist."""
    path = Path(name)
    copy = 1
    while os.path.lexists(path):
        copy += 1
        path = Path(f"{name}-{copy}")
    return path


class RunFolder:
    """The folder of a run, and the files in it. Only one program at a time writes to it."""

    def __init__(self, config, record):
        """Makes the folder `config.out`, or with `config.resume` goes on with it. record: the rows
        that its tables have by now, `episodes` and `updates`. Raises RunError, WriteError."""
        self.path = Path(config.out)
        self._tables = {}  # name -> the open file
        own = {name: value for name, value in asdict(config).items() if name not in PASSING}
        text = json.dumps(own, indent=2)
        try:
            if not config.resume:
                self._make(text)
            self._lock()
            for partial in self.path.glob(".*.partial"):
                partial.unlink()  # of a program that was killed while it wrote
        except OSError as error:
            raise WriteError(self.path, error) from None
        self.write("config.json", text)
        interruption.line = f"interrupted: {how_to_go_on(config)}"  # from here on there is a run
        self._begin_table("episodes.csv", record.episodes)
        self._begin_table("updates.csv", record.updates)

    def _make(self, config):
        """Makes the folder with its config.json in it: where there is a folder, there is a run to
        go on with."""
        if os.path.lexists(self.path):
            raise FileExistsError(errno.EEXIST, os.strerror(errno.EEXIST))
        hidden = self.path.with_name(f".{self.path.name}.{os.getpid()}")
        hidden.mkdir(parents=True)
        write(hidden / "config.json", config)
        os.rename(hidden, self.path)

    def close(self):
        """Lets go of the open files, and of the folder."""
        for file in self._tables.values():
            file.close()
        self._tables.clear()
        if fcntl is not None:
            os.close(self._descriptor)

    def _lock(self):
        """Takes the folder for this program, until it ends."""
        if fcntl is None:
            return
        self._descriptor = os.open(self.path, os.O_RDONLY)
        try:
            fcntl.flock(self._descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except OSError:
            raise RunError(f"run '{self.path}' is under way in another program") from None

    def write(self, name, content):
        """A file of the run, by `write`."""
        write(self.path / name, content)

    def keep(self, last, before, content):
        """A file of which there are two: the one that there was becomes `before`."""
        write(self.path / last, content, before)

    def _begin_table(self, name, rows):
        """A CSV table that holds these rows, dicts, and no others so far."""
        if rows:
            self.write(name, csv_text([rows[0]] + [row.values() for row in rows]).encode())
        else:
            (self.path / name).unlink(missing_ok=True)

    def add_row(self, name, row):
        """One more row, a dict, of a CSV table. Raises WriteError."""
        path = self.path / name
        try:
            if name not in self._tables:
                # Unbuffered: what does not fit on the disk is known at once, and nothing is left
                # to be written when the program ends.
                self._tables[name] = open(path, "ab", buffering=0)
            file = self._tables[name]
            size = file.tell()
            text = csv_text(([] if size else [row]) + [row.values()]).encode()
            if file.write(text) < len(text):
                file.truncate(size)
                raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))
        except OSError as error:
            raise WriteError(path, error) from None


def how_to_go_on(config):
    """What is said where a run is cut."""
    return f"go on with python train.py --resume {shlex.quote(config.out)}"


def csv_text(rows):
    """Those rows as CSV."""
    text = io.StringIO()
    csv.writer(text).writerows(rows)
    return text.getvalue()


class NoFolder:
    """What a process writes to that leaves the run folder to another one: nothing."""

    def keep(self, last, before, content):
        """Writes nothing."""

    def add_row(self, name, row):
        """Writes nothing."""
