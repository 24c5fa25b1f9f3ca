"""Writes whole files, and reads tables."""

import csv
import os
from io import BytesIO
from pathlib import Path


class RunError(ValueError):
    """A run that cannot be used. The message names it and gives the reason."""


class ProcessLost(RuntimeError):
    """A process of a training run or of an evaluation exited unexpectedly."""


def write(path, content):
    """Writes a whole file or none: writes it to disk under another name, and then renames it.
    content: text, bytes, or a function that writes to a binary file. Raises OSError."""
    if callable(content):
        buffer = BytesIO()  # torch would hide the error of a full disk
        content(buffer)
        content = buffer.getvalue()
    path = Path(path)
    partial = path.with_name(f".{path.name}.{os.getpid()}")
    try:
        with open(partial, "wb") as file:
            file.write(content.encode() if isinstance(content, str) else content)
            file.flush()
            os.fsync(file.fileno())
        os.replace(partial, path)
    except OSError as error:
        error.filename = str(path)  # not that of the partial file, for the message
        raise
    finally:
        partial.unlink(missing_ok=True)


def read_table(path):
    """Returns the rows of a CSV file as dicts of text. Lines that begin with # are comments."""
    with open(path, newline="") as file:
        return list(csv.DictReader(line for line in file if not line.startswith("#")))
