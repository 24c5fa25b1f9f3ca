"""Command lines whose errors are one sentence and exit code 2."""

import argparse
from dataclasses import field, fields
from math import inf


class CommandLine(argparse.ArgumentParser):
    """argparse that guesses no flags and prints no usage before an error."""

    def __init__(self, description):
        super().__init__(description=description, allow_abbrev=False,
                         formatter_class=argparse.ArgumentDefaultsHelpFormatter)

    def error(self, message):
        self.exit(2, f"error: {message}\n")

    def parse(self, argv=None):
        options, unknown = self.parse_known_args(argv)
        if unknown:
            known = [flag for action in self._actions for flag in action.option_strings]
            self.error(f"unknown argument '{unknown[0]}', known are {', '.join(known)}")
        return options

    def read(self, config_class, argv=None):
        """An instance of a dataclass whose fields are `option`s: `--learning-rate 1e-3` sets
        `learning_rate`. What is not valid ends the program."""
        items = {f"--{item.name.replace('_', '-')}": item for item in fields(config_class)}
        for flag, item in items.items():
            if item.type is bool:
                self.add_argument(flag, action="store_true", help=item.metadata["text"])
            else:
                self.add_argument(flag, type=item.type, default=item.default,
                                  help=item.metadata["text"], choices=item.metadata["choices"])
        config = config_class(**vars(self.parse(argv)))
        for flag, item in items.items():
            low, high = item.metadata["low"], item.metadata["high"]
            value = getattr(config, item.name)
            if low is not None and not low <= value <= (inf if high is None else high):
                valid = f"from {low} up" if high is None else f"from {low} to {high}"
                self.error(f"{flag} is {value}, it must be {valid}")
        return config


def option(default, text, low=None, high=None, choices=None):
    """A field of a configuration: its default, what it is, and which values are valid."""
    return field(default=default, metadata=dict(text=text, low=low, high=high, choices=choices))
