"""Whether a program can write where it is to: known before it begins, not when it is done."""

import os
import tempfile
from pathlib import Path

from support.run_folder import RunError

LONGEST_FILE = "." + 40 * "x"  # at least as long as the names of the files in a run folder


def check_new_folder(path):
    """Raises RunError, one sentence, unless a run folder can be made at this path, which must not
    exist. Leaves nothing there."""
    if os.path.lexists(path):
        raise RunError(f"--out '{path}' exists already, it must name a new folder")
    reason = why_not(path)
    if reason:
        raise RunError(f"run folder '{path}' cannot be made: {reason}; --out must name one where "
                       "it can")


def why_not(path):
    """Why no file can be written into a folder, or none can be made there, in a few words; '' if
    one can. What it tries, it tries in a folder of its own beside, which it takes away."""
    try:
        path = Path(os.path.abspath(path))
        base = next(folder for folder in (path, *path.parents) if os.path.lexists(folder))
        if not base.is_dir():
            return f"'{base.name}' is no folder"
        with tempfile.TemporaryDirectory(prefix=".", dir=base) as trial:
            folder = Path(trial, path.relative_to(base))
            folder.mkdir(parents=True, exist_ok=True)
            (folder / LONGEST_FILE).touch()
    except OSError as error:
        return error.strerror
    except ValueError:
        return "it is no path"
    return ""
