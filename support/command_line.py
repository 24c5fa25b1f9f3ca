"""Command lines whose errors are one sentence and exit code 2."""

import argparse
import difflib
import errno
import io
import logging
import os
import sys
from dataclasses import field, fields

from support.paths import why_not

LARGEST = {int: 2 ** 63 - 1, float: sys.float_info.max}  # where an option has no limit of its own
LONGEST_VALUE = 40  # characters of what was typed, as an error shows it
LONGEST_MESSAGE = 190  # characters


class CommandLine(argparse.ArgumentParser):
    """An ArgumentParser that guesses nothing, and says in our words what is wrong. argparse keeps
    the options and prints the help."""

    def __init__(self, description):
        super().__init__(prog=program(), description=description, allow_abbrev=False)

    def error(self, message):
        """Ends the program with one line. message: a sentence, or an exception that holds one or
        that the operating system raised."""
        if isinstance(message, OSError) and message.filename is not None:
            message = (f"'{message.filename}' cannot be used: {message.strerror}; begin in a "
                       "folder where it can be")
        self.exit(2, f"error: {one_line(message)}\n")

    def remark(self, text):
        """Says something beside the program's output, on standard error; '' says nothing."""
        if text:
            print(text, file=sys.stderr)

    def must_write_to(self, folder):
        """Ends the program unless files can be written into a folder, or it can be made."""
        reason = why_not(folder)
        if reason:
            self.error(f"'{folder}' cannot be written to: {reason}; begin in a folder that can be, "
                       "or take a copy of this one")

    def parse(self, argv=None):
        """What the command line says, a Namespace. What is not valid ends the program."""
        settle_output()
        arguments = [action.metavar if action.nargs is None else f"[{action.metavar}]"
                     for action in self._arguments()]
        self.usage = " ".join([self.prog, *arguments, "[options]"])
        words = sys.argv[1:] if argv is None else argv
        if "--help" in words or "-h" in words:
            self.print_help()
            self.exit()
        values = {action.dest: action.default for action in self._actions
                  if action.default is not argparse.SUPPRESS}
        return argparse.Namespace(**values | self._typed(words))

    def read(self, config_class, argv=None):
        """An instance of a dataclass whose fields are `option`s: `--learning-rate 1e-3` sets
        `learning_rate`. What is not valid ends the program. `given` then holds the names of the
        fields that were on the command line."""
        items = {item.name: item for item in fields(config_class)}
        for item in items.values():
            self._add(item)
        values = vars(self.parse(argv))
        self.given = set(values)
        return config_class(**{name: self._checked(items[name], value)
                               for name, value in values.items()})

    def _add(self, item):
        """Makes an argument or an option of a field. argparse leaves out what is not given."""
        text = item.metadata["text"].replace("%", "%%")  # argparse fills in what follows a %
        if item.type is not bool and item.default != "" and "default" not in text:
            text += f"; by default {item.default}"
        if item.metadata["positional"]:
            self.add_argument(item.name, nargs="?", metavar=item.name.upper(), help=text,
                              default=argparse.SUPPRESS)
        elif item.type is bool:
            self.add_argument(flag_of(item), action="store_true", help=text,
                              default=argparse.SUPPRESS)
        else:
            self.add_argument(flag_of(item), metavar=placeholder(item), help=text,
                              default=argparse.SUPPRESS)

    def _arguments(self):
        """Those of argparse's actions that have no flag, such as RUN."""
        return [action for action in self._actions if not action.option_strings]

    def _typed(self, words):
        """What was typed, by the names of fields: text, and True for an option without a value.
        argparse itself takes no RUN behind an option, and no '--' for a value."""
        known = {flag: action for action in self._actions for flag in action.option_strings}
        arguments = []
        values = {}
        words = iter(words)
        for word in words:
            flag, equals, value = word.partition("=")
            if not word.startswith("-"):
                arguments.append(word)
            elif flag not in known:
                self.error(f"unknown argument '{shown(flag)}', {nearest(flag, known)}")
            elif known[flag].nargs == 0:
                if equals:
                    self.error(f"{flag} is '{shown(value)}', but it takes no value: give it alone")
                values[known[flag].dest] = True
            else:
                value = value if equals else next(words, None)
                if not equals and (value is None or value.startswith("--")):
                    self.error(f"{flag} has no value, one must follow it; --help describes it")
                values[known[flag].dest] = value
        return values | self._named(arguments)

    def _named(self, given):
        """What was typed without a flag, by the names of fields."""
        expected = self._arguments()
        if len(given) > len(expected):
            self.error(f"unknown argument '{shown(given[len(expected)])}', at most "
                       f"{len(expected)} may be without a flag; --help describes all")
        for action in expected[len(given):]:
            if action.nargs is None:
                self.error(f"{action.metavar} is missing, it must be {action.help}")
        return {action.dest: word for action, word in zip(expected, given)}

    def _checked(self, item, value):
        """The value of a field, of its type. value: what was typed, or True."""
        if item.type is bool:
            return value
        name = item.name.upper() if item.metadata["positional"] else flag_of(item)
        choices = item.metadata["choices"]
        if item.type in LARGEST:
            return self._number(name, item, value)
        if choices is not None and value not in choices:
            valid = ", ".join(f"'{choice}'" for choice in choices if choice)
            self.error(f"{name} is '{shown(value)}', it must be one of {valid}")
        if not can_name_a_file(value):
            self.error(f"{name} is '{shown(value)}', no file can have that name: it must be "
                       "shorter, without NUL bytes")
        return value

    def _number(self, name, item, text):
        """The number that was typed for a field, within its limits."""
        low, high = limits(item)
        try:
            value = item.type(text)
        except ValueError:
            value = None
        if value is None or not low <= value <= high:  # true for nan as well
            typed = shown(text) if value is not None else f"'{shown(text)}'"
            kind = "a whole number" if item.type is int else "a number"
            self.error(f"{name} is {typed}, it must be {kind} from {low:,} to {high:,}")
        return value


def option(default, text, low=None, high=None, choices=None, positional=False):
    """A field of a configuration: its default, what it is, and which values are valid, limits
    included. text: says itself what is the default, or a number's and a word's is put behind it.
    positional: it has no flag."""
    return field(default=default, metadata=dict(text=text, low=low, high=high, choices=choices,
                                                positional=positional))


def flag_of(item):
    """The flag of a dataclass's field."""
    return f"--{item.name.replace('_', '-')}"


def placeholder(item):
    """What stands for an option's value in --help."""
    choices = item.metadata["choices"]
    if choices is not None:
        return "{" + ",".join(choice for choice in choices if choice) + "}"
    return {int: "N", float: "X"}.get(item.type, item.name.upper())


def limits(item):
    """The smallest and the largest valid value of a field that is a number."""
    low = item.metadata["low"]
    high = item.metadata["high"]
    largest = LARGEST[item.type]
    return -largest if low is None else low, largest if high is None else high


def nearest(word, flags):
    """What to say of a word that is none of the flags."""
    near = [flag for flag in flags if flag.startswith(word) and len(word) > 2]
    near += difflib.get_close_matches(word[:LONGEST_VALUE], flags, 1)
    return f"the nearest is {near[0]}; --help lists all" if near else "--help lists those there are"


def can_name_a_file(text):
    """Whether the system can look for a file of that name, be there one or not."""
    try:
        os.lstat(text)
    except ValueError:  # a NUL byte, or letters that its names cannot have
        return False
    except OSError as error:
        return error.errno not in (errno.ENAMETOOLONG, errno.EINVAL)
    return True


def printable(text):
    """The same with escapes, as Python writes them, for what would change the screen."""
    return "".join(letter if letter.isprintable() else ascii(letter)[1:-1] for letter in text)


def shown(text):
    """What was typed, as an error shows it: printable, and no longer than can be read."""
    text = printable(text)
    return text if len(text) <= LONGEST_VALUE else f"{text[:LONGEST_VALUE - 3]}..."


def one_line(message):
    """A message that fits on a line or two: printable, and cut in the middle where it is long, for
    what is wrong stands in front and what to do at the end."""
    text = printable(str(message))
    half = (LONGEST_MESSAGE - 3) // 2
    return text if len(text) <= LONGEST_MESSAGE else f"{text[:half]}...{text[-half:]}"


def program():
    """How this program is called: `python train.py`, `python -m evaluation`."""
    module = sys.modules["__main__"].__spec__
    if module is None:
        return f"python {os.path.basename(sys.argv[0])}"
    return f"python -m {module.name.removesuffix('.__main__')}"


def settle_output():
    """What a program prints works everywhere: letters that the screen has not are escaped, and
    matplotlib is silent about its cache where there is no home folder to keep it in."""
    if isinstance(sys.stdout, io.TextIOWrapper):
        sys.stdout.reconfigure(errors="backslashreplace")
    logging.getLogger("matplotlib").setLevel(logging.ERROR)
