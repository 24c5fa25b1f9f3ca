"""What a room may hold, and how messages show what is in a file: files may come from strangers.

All limits are our choice. They hold for scene files, for the scenes in a run's weights, and for
whatever else makes rooms.
"""

import math
import re
import reprlib

from sim import SceneError

LARGEST_FILE = 10 ** 6  # bytes of a scene file
MOST_BOXES = 128
MOST_TARGETS = 1024  # training and new ones together
WIDEST = 30  # [m] that a room may measure
MOST_COVERED = 10_000  # [m2] that the upright rectangles around all boxes cover together
LARGEST_NUMBER = 10 ** 6  # of any kind: metres, degrees, radians
LONGEST_NAME = 80  # characters
MOST_ELEMENTS = 50_000  # of a Gazebo world
DEEPEST = 64  # elements of a Gazebo world inside one another
MOST_DOTS = 16  # of a line, those in numbers and comments apart
LONGEST_MESSAGE = 199
MOST_SHOWN = 40  # characters of a value in a message


class Brief(reprlib.Repr):
    """Values as short text; of what is no plain value, the type alone."""

    def repr_int(self, value, level):
        return repr(value) if abs(value) < 10 ** 30 else "a huge number"

    def repr_instance(self, value, level):
        plain = value is None or isinstance(value, (bool, float))
        return repr(value) if plain else f"a {type(value).__name__}"


def shown(value):
    """A value of a file as a message shows it: cut, and safe for any terminal, for what cannot be
    printed comes as its escape."""
    text = Brief().repr(value)
    return text if len(text) <= MOST_SHOWN else f"{text[:MOST_SHOWN - 3]}..."


def shown_path(path, most=60):
    """A path as a message shows it, in quotes: its end, at most so many characters."""
    text = repr(str(path))
    return text if len(text) <= most else f"'...{text[4 - most:]}"


def sentence(text):
    """A message as it is, or cut where it is too long."""
    return text if len(text) <= LONGEST_MESSAGE else f"{text[:LONGEST_MESSAGE - 3]}..."


def check(valid, message):
    """Raises SceneError with that message where something is not valid."""
    if not valid:
        raise SceneError(sentence(message))


def check_name(name):
    """Checks a room's name: text that can be printed, and that leads into no other folder where it
    becomes a part of a file's name."""
    valid = isinstance(name, str) and 0 < len(name) <= LONGEST_NAME and name.isprintable()
    check(valid and not name.startswith(".") and not set(name) & set("/\\:"),
          f"name is {shown(name)}, it must be 1 to {LONGEST_NAME} printable characters, none of "
          "them / \\ or :, the first no dot")


def check_text(text, what):
    """Checks what would keep a reader of TOML busy for hours: its time grows with the square of the
    number of parts in `a.b.c = 1`. Scenes have no such keys."""
    check('"""' not in text and "'''" not in text,
          f"{what} has text in three quotes, it must have none")
    for k, line in enumerate(text.split("\n")):
        dots = re.sub(r"\d\.\d", "", line).count(".")
        check(dots <= MOST_DOTS or line.lstrip(" \t").startswith("#"),
              f"{what}: line {k + 1} has {dots} dots that are in no number, it may have "
              f"{MOST_DOTS}")


def number(value, what, above=-math.inf):
    """A float above that bound and within LARGEST_NUMBER."""
    is_number = isinstance(value, (int, float)) and not isinstance(value, bool)
    check(is_number and abs(value) <= LARGEST_NUMBER,  # false for nan as well
          f"{what} is {shown(value)}, it must be a number within {LARGEST_NUMBER:,}")
    check(value > above, f"{what} is {shown(value)}, it must be above {above}")
    return float(value)
