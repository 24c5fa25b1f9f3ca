"""Trains and examines everything that the tables and the figures of the results show.

`python -m experiments.results` trains each level, room, way and seed for a fixed budget of steps,
some runs at a time with a core each, examines the frozen last policies, writes `results/*.csv`, and
then the figures and the tables of the pages. What is there already is not made again:
interrupted, it goes on where it was.
"""

import subprocess
from dataclasses import dataclass

from experiments import (figures, lab, lab_figures, level1, level2, level3, level_figures, runs,
                         tables)
from support.command_line import CommandLine, option
from support.interruption import interruption

PARTS = {"1": level1, "2": level2, "3": level3, "lab": lab}  # in this order: the lab's runs begin
#   with weights of levels 2 and 3
FIGURES = {"2": figures, "3": level_figures, "lab": lab_figures}


@dataclass
class Options:
    """What to make."""
    level: str = option("", "this level of the paper alone, or the lab; by default all of them",
                        choices=["", *PARTS])
    ablations: bool = option(False, "train and examine level 2's ablations too, seeds 0 to 2")
    planners: bool = option(False, "examine the planners alone, train nothing")
    jobs: int = option(2, "so many runs at a time, a core each", 1, 64)


def wanted_runs(options):
    """The runs that those options ask for: a key of PARTS -> a list."""
    levels = [options.level] if options.level else PARTS
    wanted = {level: PARTS[level].main_runs() for level in levels}
    if options.ablations:
        wanted["2"] += level2.ablation_runs()
    return wanted


def make_all(wanted, options):
    """Makes those runs, and level by level their tables in results/ and their figures."""
    for level, level_runs in wanted.items():
        runs.make_runs(level_runs, options.jobs)
        PARTS[level].write_tables()
    if options.ablations:
        level2.write_ablations()
    if not options.level:
        write_planners()
    for level in wanted:
        if level in FIGURES:
            FIGURES[level].main([])


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
    if options.ablations and options.level not in ("", "2"):
        parser.error(f"--level is {options.level}, with --ablations it must be 2 or left out")
    try:
        if options.planners:
            write_planners()
        else:
            wanted = wanted_runs(options)
            every = [run for level_runs in wanted.values() for run in level_runs]
            for run in every:
                run.check_options()
            print(runs.expected(every, options.jobs), flush=True)
            make_all(wanted, options)
        tables.main([])
    except runs.MadeOtherwise as error:
        parser.error(error)
    except subprocess.CalledProcessError as error:
        said = error.stderr.decode().strip() or f"exit code {error.returncode}"
        parser.error(f"'{' '.join(error.cmd[1:])}' failed: {said.splitlines()[-1]}")


if __name__ == "__main__":
    main()
