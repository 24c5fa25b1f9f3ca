"""Trains and examines everything that the tables and the figures of the results show.

`python -m experiments.results` trains each level, room, way and seed for a fixed budget of steps,
some runs at a time with a core each, examines the frozen last policies, writes `results/*.csv`, and
then the figures and the tables of the pages. What is there already is not made again:
interrupted, it goes on where it was.
"""

import subprocess
from dataclasses import dataclass

from experiments import figures, level1, level2, level3, level_figures, runs, tables
from support.command_line import CommandLine, option
from support.interruption import interruption


@dataclass
class Options:
    """What to make."""
    level: int = option(0, "this level of the paper alone; by default 0: all three", 0, 3)
    ablations: bool = option(False, "train and examine level 2's ablations too, seeds 0 to 2")
    planners: bool = option(False, "examine the planners alone, train nothing")
    jobs: int = option(2, "so many runs at a time, a core each", 1, 64)


def wanted_runs(options):
    """The runs that those options ask for."""
    of_level = {1: level1.main_runs(), 2: level2.main_runs(), 3: level3.main_runs()}
    if options.ablations:
        of_level[2] += level2.ablation_runs()
    levels = [options.level] if options.level else [1, 2, 3]
    return [run for level in levels for run in of_level[level]]


def write_tables(options):
    """The tables in results/ of those runs."""
    if options.level in (0, 1):
        level1.write_tables()
    if options.level in (0, 2):
        level2.write_tables(options.ablations)
    if options.level in (0, 3):
        level3.write_tables()


def write_planners():
    """The planners' tables."""
    level2.write_planners()
    level3.write_planners()


def main(argv=None):
    """The command line."""
    parser = CommandLine("Make every table and figure of the results.")
    options = parser.read(Options, argv)
    interruption.handle("interrupted: the runs under way are saved; the same command goes on")
    for folder in (runs.RUNS, runs.RESULTS):
        parser.must_write_to(folder)
    if options.planners and options.level:
        parser.error(f"--level is {options.level}, with --planners it must be left out")
    if options.ablations and options.level not in (0, 2):
        parser.error(f"--level is {options.level}, with --ablations it must be 2 or left out")
    try:
        if options.planners:
            write_planners()
        else:
            wanted = wanted_runs(options)
            for run in wanted:
                run.check_options()
            print(runs.expected(wanted, options.jobs), flush=True)
            runs.make_runs(wanted, options.jobs)
            write_tables(options)
            if options.level == 0:
                write_planners()
            if options.level in (0, 2):
                figures.main([])
            if options.level in (0, 3):
                level_figures.main([])
        tables.main([])
    except runs.MadeOtherwise as error:
        parser.error(error)
    except subprocess.CalledProcessError as error:
        said = error.stderr.decode().strip() or f"exit code {error.returncode}"
        parser.error(f"'{' '.join(error.cmd[1:])}' failed: {said.splitlines()[-1]}")


if __name__ == "__main__":
    main()
