"""Training runs that tables are made of: each is trained and examined once, some at a time, and
goes on where it was when the program is interrupted."""

import csv
import json
import shutil
import subprocess
import sys
import threading
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

from scenes.limits import shown_path
from support.command_line import CommandLine
from support.interruption import interruption
from support.pictures import read_table
from train import Config

ROOT = Path(__file__).parent.parent
RESULTS = ROOT / "results"
RUNS = ROOT / "runs" / "results"
OUTCOMES = ("success", "low", "high", "collision", "timeout")  # columns of a rate, all tables


class MadeOtherwise(Exception):
    """A run's folder holds a run with other options."""


class Run:
    """One training run, and the files in which its examinations lie. A subclass says what it is:
    `stage`, such as level2; `names`, the columns that every table begins with; `training`, the
    options of train.py; `examinations`, the file that holds an answer -> the options of `python -m
    evaluation`; and `tables`, those in results/ that say how many seconds it took."""

    @property
    def folder(self):
        """Where the run lies."""
        *names, seed = map(str, self.names.values())
        return RUNS / f"{self.stage}-{'-'.join(names)}-seed{seed}"

    @property
    def is_trained(self):
        """Whether training and the evaluation at its end are done."""
        summary = self.folder / "summary.json"
        return summary.exists() and json.loads(summary.read_text())["frozen"] is not None

    @property
    def command_line(self):
        """All options of train.py but the folder."""
        return [*map(str, self.training), "--fixed-budget", "--workers", "1"]

    def check_options(self):
        """Raises MadeOtherwise where its folder holds a run with other options."""
        if not (self.folder / "config.json").exists():
            return
        made = self.read("config.json")
        parser = CommandLine("")
        wanted = parser.read(Config, self.command_line)
        for name in sorted(parser.given):
            value = getattr(wanted, name)
            if made.get(name) != value:
                raise MadeOtherwise(f"{shown_path(self.folder)} was made with {name} = "
                                    f"{made.get(name)}, now it is {value}: move it away")

    def make(self):
        """Trains and examines, each unless it is done."""
        if not self.is_trained and (self.folder / "config.json").exists():
            call("train.py", "--resume", self.folder)  # a training that was cut short
        elif not self.is_trained:
            shutil.rmtree(self.folder, ignore_errors=True)
            call("train.py", *self.command_line, "--out", self.folder)
        for file, options in self.examinations.items():
            if not (self.folder / file).exists():
                call("-m", "evaluation", self.folder, "--workers", 1, *options)
        print(f"{self.folder.name} is done", flush=True)

    def read(self, file):
        """The content of one of its JSON files."""
        return json.loads((self.folder / file).read_text())

    def training_columns(self):
        """The first columns of its row in a table: which run it is, and how long it trained."""
        summary = self.read("summary.json")
        return self.names | {key: summary[key] for key in ("steps", "episodes", "seconds")}

    def seconds(self):
        """How long it took when results/ was made; where it is not there, how long its steps take
        by the benchmark."""
        names = {key: str(value) for key, value in self.names.items()}
        for table in self.tables:
            rows = read_table(RESULTS / table) if (RESULTS / table).exists() else []
            for row in rows:
                if names.items() <= row.items():
                    return float(row["seconds"])
        steps = self.training[self.training.index("--steps") + 1]
        rates = json.loads((RESULTS / "benchmark.json").read_text())["workers"]["idle"]
        return steps / rates["1"]  # steps a second with one worker


def call(*arguments):
    """Runs python in a session of its own: a Ctrl-C comes to it through this program alone.

    Raises CalledProcessError.
    """
    command = [sys.executable, *map(str, arguments)]
    program = subprocess.Popen(command, cwd=ROOT, stdout=subprocess.DEVNULL,
                               stderr=subprocess.PIPE, start_new_session=True)
    interruption.programs.add(program)
    _, said = program.communicate()
    interruption.programs.discard(program)
    if program.returncode:
        raise subprocess.CalledProcessError(program.returncode, command, stderr=said)


def expected(runs, jobs):
    """What there is to do, in one sentence, by the seconds that the runs in results/ took."""
    left = [run for run in runs if not run.is_trained]
    seconds = sum(run.seconds() for run in left)
    return (f"{len(left)} of {len(runs)} runs are to be trained, which takes about "
            f"{seconds / jobs / 60:.0f} minutes, {jobs} at a time, if this machine is as fast as "
            "the one of results/; examinations and planners come on top")


def make_runs(runs, jobs):
    """Makes those runs, so many at a time. The first that fails ends it when the runs under way are
    finished."""
    has_failed = threading.Event()

    def make(run):
        if has_failed.is_set():
            return
        try:
            run.make()
        except Exception:
            has_failed.set()
            raise

    pool = ThreadPoolExecutor(jobs)
    try:
        for future in [pool.submit(make, run) for run in runs]:
            future.result()
    finally:
        pool.shutdown(cancel_futures=True)


def examined_rows(run, room, file):
    """What an examination of a run in a room found, as rows of a table: one for each kind of
    targets. file: of its JSON files."""
    result = run.read(file)
    return [run.names | {"room": room, "targets": targets}
            | rounded(result[targets], ("n", *OUTCOMES, "spl"))
            for targets in ("training", "new", "anywhere") if result.get(targets) is not None]


def rounded(result, keys, prefix=""):
    """Those values of an evaluation as columns of a table."""
    return {prefix + key: round(result[key], 4) for key in keys}


def write_table(name, rows):
    """A table in results/. rows: dicts with the same keys."""
    with open(RESULTS / name, "w", newline="") as file:
        writer = csv.DictWriter(file, rows[0])
        writer.writeheader()
        writer.writerows(rows)
