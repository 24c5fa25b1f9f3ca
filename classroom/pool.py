"""The drives of a class in one figure: `python -m classroom.pool FOLDER`, where the folder holds
the drives.csv of each, under any names.

Whoever drove the same room by the same seed drove the same tasks, and so did the policy that is
drawn beside them.
"""

import csv
import math
import sys
from dataclasses import dataclass
from functools import partial
from pathlib import Path

import numpy as np
from matplotlib.figure import Figure

import scenes
from classroom.drive import COLUMNS, LARGEST_SEED, MOST_EPISODES, policy_for, same_tasks
from evaluation import summarise
from navbot_min import OUTCOMES
from sim import SceneError
from support.command_line import CommandLine, option
from support.pictures import PALETTE, WIDTH
from support.run_folder import WriteError, write

NUMBERS = {"seed": (int, LARGEST_SEED), "episode": (int, MOST_EPISODES - 1), "spl": (float, 1)}


@dataclass
class Options:
    """What to draw."""
    folder: str = option("drives", "with the drives.csv of each, under any names", positional=True)


def read_drives(parser, folder):
    """All rows of a folder's CSV files. Ends with a message where one is no such file."""
    files = sorted(Path(folder).rglob("*.csv"))
    if not files:
        parser.error(f"there is no CSV file in '{folder}'")
    rows = []
    names = set()
    for file in files:
        try:
            with open(file, newline="", encoding="utf-8-sig") as text:  # a name may begin with #
                read = list(csv.DictReader(text))
        except (OSError, UnicodeDecodeError, csv.Error):
            parser.error(f"'{file}' cannot be read")
        if not read or set(read[0]) != set(COLUMNS):
            parser.error(f"'{file}' is no table of drives: its columns must be "
                         f"{', '.join(COLUMNS)}, separated by commas")
        check_rows(parser, file, read)
        again = names & {row["name"] for row in read}
        if again:
            parser.error(f"'{min(again)}' drives in two files: drive with another --name")
        names |= {row["name"] for row in read}
        rows += read
    return rows


def check_rows(parser, file, rows):
    """Ends with a message where a value of a file's rows is none that a drive writes."""
    for line, row in enumerate(rows, 2):  # after the header
        if None in row or None in row.values():
            parser.error(f"'{file}', line {line}, must have {len(COLUMNS)} values")
        if row["outcome"] not in OUTCOMES:
            parser.error(f"'{file}', line {line}: outcome is {row['outcome']!r}, it must be one of "
                         f"{', '.join(OUTCOMES)}")
        for column, (number, largest) in NUMBERS.items():
            try:
                value = number(row[column])
            except ValueError:
                value = math.nan
            if not 0 <= value <= largest:
                parser.error(f"'{file}', line {line}: {column} is {row[column]!r}, it must be a "
                             f"number from 0 to {largest}")


def first_tries(rows):
    """The rows of each driver's first try of each task: whoever drives one again has practised."""
    found = {}
    for row in rows:
        found.setdefault((row["name"], row["episode"]), row)
    return list(found.values())


def number_of_tasks(parser, rows):
    """How many tasks every driver drove. Ends with a message where one drove others."""
    driven = {}  # name -> numbers of tasks
    for row in rows:
        driven.setdefault(row["name"], set()).add(int(row["episode"]))
    most = max(driven.values(), key=len)
    for name, tasks in driven.items():
        if tasks != set(range(len(most))):
            parser.error(f"'{name}' drove {len(tasks)} tasks, and others {len(most)}: only drives "
                         "of the same tasks can be compared")
    return len(most)


def by_driver(rows):
    """Each driver's share of arrivals [%] and mean SPL: name -> (success, SPL), the worst first."""
    found = {}
    for name in {row["name"] for row in rows}:
        own = [row for row in rows if row["name"] == name]
        success = 100 * np.mean([row["outcome"] == "arrival" for row in own])
        found[name] = success, np.mean([float(row["spl"]) for row in own])
    return dict(sorted(found.items(), key=lambda item: item[1]))


def draw(drivers, learner, title):
    """Success and SPL of each driver, and the learner's as a line. drivers: as of `by_driver`.
    learner: its (success, SPL). Returns a Figure."""
    figure = Figure(figsize=(WIDTH, 1.2 + 0.35 * len(drivers)), layout="constrained")
    names = list(drivers)
    for axes, k, label in zip(figure.subplots(1, 2, sharey=True), (0, 1), ("arrives [%]", "SPL")):
        axes.barh(names, [drivers[name][k] for name in names], color=PALETTE["run"], height=0.6)
        axes.axvline(learner[k], color=PALETTE["arrival"], lw=2, label="the learner")
        axes.set_yticks(names, names, parse_math=False)
        axes.set(xlabel=label, xlim=(0, (105, 1.05)[k]))
        axes.spines[["top", "right"]].set_visible(False)
    axes.legend(frameon=False, loc="lower right")
    figure.suptitle(title, parse_math=False)
    return figure


def main(argv=None):
    """The command line."""
    parser = CommandLine("Draw the drives of a class into drives.png.")
    rows = first_tries(read_drives(parser, parser.read(Options, argv).folder))
    tasks = {(row["env"], row["seed"]) for row in rows}
    if len(tasks) > 1:
        shown = ", ".join(sorted(f"{env} with seed {seed}" for env, seed in tasks))
        parser.error(f"these are drives in {shown}: only drives of the same tasks can be compared")
    [(env, seed)] = tasks
    try:
        scene = scenes.load(env)
    except SceneError as error:
        parser.error(error)
    episodes = number_of_tasks(parser, rows)
    policy, _ = policy_for(scene)
    result = summarise(same_tasks(policy, scene, episodes, int(seed)))
    drivers = by_driver(rows)
    figure = draw(drivers, (100 * result["success"], result["spl"]),
                  f"{env}, {len(drivers)} drivers, {episodes} tasks")
    try:
        write("drives.png", partial(figure.savefig, dpi=110))
    except WriteError as error:
        sys.exit(f"error: {error}")
    print("drives.png")


if __name__ == "__main__":
    main()
