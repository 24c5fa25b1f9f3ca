"""Files that are whole or not there, and tables."""

import csv
import os
from pathlib import Path


class RunError(ValueError):
    """A run that cannot be used. The message names it and says why."""


class ProcessLost(RuntimeError):
    """A process that shares the work has ended early."""


def write(path, content):
    """Writes a whole file or none: it is written beside its place, to disk, and moved there.
    content: text, bytes, or a function that writes to a binary file. Raises OSError."""
    path = Path(path)
    partial = path.with_name(f".{path.name}.{os.getpid()}")
    try:
        with open(partial, "wb") as file:
            if callable(content):
                content(file)
            else:
                file.write(content.encode() if isinstance(content, str) else content)
            file.flush()
            os.fsync(file.fileno())
        os.replace(partial, path)
    finally:
        partial.unlink(missing_ok=True)


def read_table(path):
    """Returns the rows of a CSV file as dicts of text. Lines that begin with # are comments."""
    with open(path, newline="") as file:
        return list(csv.DictReader(line for line in file if not line.startswith("#")))
