"""Makes a command line from a dataclass. Errors are one sentence, with exit code 2."""

import argparse
import math
import os
import sys
from dataclasses import field, fields, make_dataclass
from functools import partial
from io import TextIOWrapper


def option(default, text, low=-math.inf, high=math.inf, choices=(), positional=False):
    """Returns a dataclass field for `parse`, with an option's default, help text and valid values.
    The range of a number includes both ends. positional: the option is given without a flag."""
    about = dict(text=text, low=low, high=high, choices=choices, positional=positional)
    return field(default=default, metadata=about)


def parse(config_class, description, argv=None):
    """Parses the command line: `--learning-rate 1e-3` sets the field `learning_rate`. Returns an
    instance of the dataclass and the parser, which reports later errors. Exits if input is invalid.
    config_class: a dataclass whose fields are options, or a dict of options by name."""
    if isinstance(config_class, dict):
        config_class = make_dataclass("Options", [(name, type(item.default), item)
                                                  for name, item in config_class.items()])
    for name in ("stdout", "stderr"):
        stream = getattr(sys, name)
        if type(stream) is TextIOWrapper:  # not captured by a test or notebook, not yet replaced
            setattr(sys, name, Output(stream.buffer, stream.encoding, "backslashreplace"))
    parser = argparse.ArgumentParser(prog=program(), description=description, allow_abbrev=False,
                                     argument_default=argparse.SUPPRESS)
    parser.error = lambda message: parser.exit(2, f"error: {message}\n")  # no usage
    for item in fields(config_class):
        text = item.metadata["text"].replace("%", "%%")
        if item.type is not bool and item.default != "":
            text += f" (default: {item.default})"
        flag = f"--{item.name.replace('_', '-')}"
        if item.metadata["positional"]:
            parser.add_argument(item.name, nargs="?", metavar=item.name.upper(), help=text)
        elif item.type is bool:
            parser.add_argument(flag, action="store_true", help=text)
        elif item.type is str:
            choices = [choice for choice in item.metadata["choices"] if choice] or None
            parser.add_argument(flag, choices=choices, help=text)
        else:
            parser.add_argument(flag, type=partial(number, item), help=text,
                                metavar="N" if item.type is int else "X")
    given = vars(parser.parse_intermixed_args(argv))
    parser.given = set(given)  # names of the fields given on the command line
    return config_class(**given), parser


def number(item, word):
    """Converts a word to a number for a dataclass field. Raises ArgumentTypeError."""
    low, high = item.metadata["low"], item.metadata["high"]
    try:
        value = item.type(word)
    except ValueError:
        value = math.nan  # outside every range
    if not low <= value <= high:
        valid = "a whole number" if item.type is int else "a number"
        valid += f" of at least {low:,}" if high == math.inf else f" from {low:,} to {high:,}"
        raise argparse.ArgumentTypeError(f"'{word}' is not {valid}")
    return value


def program():
    """Returns the command of this program, such as `python train.py` or `python -m evaluation`."""
    module = sys.modules["__main__"].__spec__
    return (f"python -m {module.name.removesuffix('.__main__')}" if module else
            f"python {os.path.basename(sys.argv[0])}")


class Output(TextIOWrapper):
    """A text stream that drops text when its reader, such as `head`, has exited."""

    def write(self, text):
        try:
            super().write(text)
            self.flush()
        except OSError:
            os.dup2(os.open(os.devnull, os.O_WRONLY), self.fileno())
        return len(text)
