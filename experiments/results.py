"""Trains and examines everything that the tables and the figures of the results show.

`python -m experiments.results` trains each room, way and seed for a fixed budget of steps, some
runs at a time with a core each, examines the frozen last policies, writes `results/*.csv`, and
then the figures and the tables of the pages. What is there already is not made again:
interrupted, it goes on where it was.
"""

import csv
import json
import shutil
import subprocess
import sys
import threading
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from pathlib import Path

import numpy as np

import scenes
from evaluation.drivers import Planned
from evaluation.examine import evaluate
from evaluation.measures import summarise
from evaluation.planners import PLANNERS
from experiments import figures, tables
from support.command_line import CommandLine, option
from support.interruption import interruption
from support.pictures import read_table

ROOT = Path(__file__).parent.parent
RESULTS = ROOT / "results"
RUNS = ROOT / "runs" / "results"

BUDGET = {"env1": 250_000, "env2": 400_000}  # steps, new targets' included
# Of every run: the update as it was when the tables were made (docs/tuning-log.md), and one core.
SETTINGS = ["--robots", "32", "--episodes-per-update", "32", "--learning-rate", "6e-4",
            "--workers", "1"]
WAYS = {  # to train, with seeds 0 to 4
    "one-start": ["--random-starts", "0", "--mirrored", "0"],
    "varied": []}
ABLATIONS = {  # of `varied`, with seeds 0 to 2
    "single": ["--memory", "single"],
    "none": ["--memory", "none"],
    "blind": ["--without", "image"],
    "no-target": ["--without", "target"],
    "no-last": ["--without", "last"],
    "one-room": ["--mirrored", "0"]}
SEEDS = range(5)
ABLATION_SEEDS = range(3)
HIDDEN = ("place", "cube", "both")

ANYWHERE_EPISODES = 500  # in all
HIDDEN_EPISODES = 200  # of each kind
VALIDATION_EPISODES = 300  # in all
PLANNER_EPISODES = {"start": 1, "anywhere": 50}  # to each target; in all
CURVE_WINDOW = 100  # episodes that a point of curves.csv looks back on
CURVE_SPACING = 50  # episodes from one point to the next
OUTCOMES = ("success", "low", "high", "collision", "timeout")  # columns of a rate, all tables


@dataclass
class Options:
    """What to make."""
    ablations: bool = option(False, "train and examine the ablations too, with seeds 0 to 2")
    planners: bool = option(False, "examine the planners alone, train nothing")
    jobs: int = option(2, "so many runs at a time, a core each", 1, 64)


@dataclass(frozen=True)
class Run:
    """One training run, and the files in which its examinations lie."""
    env: str
    way: str
    seed: int

    @property
    def folder(self):
        return RUNS / f"{self.env}-{self.way}-seed{self.seed}"

    @property
    def is_trained(self):
        """Whether training and the evaluation at its end are done."""
        summary = self.folder / "summary.json"
        return summary.exists() and json.loads(summary.read_text())["frozen"] is not None

    @property
    def examinations(self):
        """What to ask of the last policy: the file that holds the answer, and the options."""
        wanted = {"evaluation-anywhere.json": [
            "--protocol", "anywhere", "--episodes", ANYWHERE_EPISODES]}
        if self.way in WAYS:
            for hidden in HIDDEN:
                wanted[f"evaluation-hidden-{hidden}.json"] = [
                    "--hide", hidden, "--episodes", HIDDEN_EPISODES]
            wanted["evaluation-validation.json"] = [
                "--protocol", "validation", "--episodes", VALIDATION_EPISODES]
        return wanted

    def make(self):
        """Trains and examines, each unless it is done."""
        if not self.is_trained and (self.folder / "config.json").exists():
            call("train.py", "--resume", self.folder)  # a training that was cut short
        elif not self.is_trained:
            shutil.rmtree(self.folder, ignore_errors=True)
            options = (WAYS | ABLATIONS)[self.way]
            call("train.py", "--env", self.env, "--seed", self.seed, "--fixed-budget",
                 "--steps", BUDGET[self.env], *SETTINGS, *options, "--out", self.folder)
        for file, options in self.examinations.items():
            if not (self.folder / file).exists():
                call("-m", "evaluation", self.folder, "--workers", 1, *options)
        print(f"{self.folder.name} is done", flush=True)

    def read(self, file):
        """The content of one of its JSON files."""
        return json.loads((self.folder / file).read_text())

    @property
    def names(self):
        """The columns that every table begins with."""
        return {"env": self.env, "way": self.way, "seed": self.seed}


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


def rounded(result, keys, prefix=""):
    """Those values of an evaluation as columns of a table."""
    return {prefix + key: round(result[key], 4) for key in keys}


# --------------------------------------------------------------------------------------- the tables


def seed_row(run):
    """A run's row of seeds.csv or ablations.csv."""
    summary = run.read("summary.json")
    anywhere = run.read("evaluation-anywhere.json")["anywhere"]
    row = run.names
    for key in ("steps", "episodes", "seconds"):
        row[key] = summary[key]
    for kind, result in (("training", summary["frozen"]["training"]),
                         ("new", summary["frozen"]["new"]), ("anywhere", anywhere)):
        row |= rounded(result, (*OUTCOMES, "spl"), f"{kind}_")
    arrive = [target["mean_action_arrives"] for target in summary["frozen"]["targets"]]
    row["mean_action_arrives"] = f"{sum(arrive)} of {len(arrive)}"
    return row


def hidden_rows(run):
    """A run's rows of hidden.csv, one for each thing that is hidden from the policy."""
    rows = []
    for hidden in HIDDEN:
        result = run.read(f"evaluation-hidden-{hidden}.json")
        row = run.names | {"hidden": hidden}
        for kind in ("training", "new"):
            row |= rounded(result[kind], ("n", *OUTCOMES), f"{kind}_")
        rows.append(row)
    return rows


def floor_rows(run):
    """A run's rows of floor.csv, one for each validation target."""
    targets = run.read("evaluation-validation.json")["targets"]
    return [run.names | rounded(target, ("x", "y", "n", "success", "collision", "timeout"))
            for target in targets if target["kind"] == "validation"]


def curve_rows(run):
    """A run's rows of curves.csv: success and mean return of the last 100 episodes to targets of
    a kind, each 50 episodes."""
    arrived = {"training": [], "new": []}
    returns = {"training": [], "new": []}
    points = []
    for row in read_table(run.folder / "episodes.csv"):
        kind = row["kind"]
        arrived[kind].append(row["outcome"] == "arrival")
        returns[kind].append(float(row["return"]))
        n = len(arrived[kind])
        if n >= CURVE_WINDOW and n % CURVE_SPACING == 0:
            points.append(run.names | {
                "kind": kind, "steps": row["steps"], "episodes": n,
                "success": round(float(np.mean(arrived[kind][-CURVE_WINDOW:])), 2),
                "return": round(float(np.mean(returns[kind][-CURVE_WINDOW:])), 1)})
    return points


def planner_row(env, name):
    """A planner's row of planners.csv: one episode to each target from the start pose, and 50
    from anywhere to anywhere."""
    row = {"env": env, "planner": name}
    for protocol, episodes in PLANNER_EPISODES.items():
        _, traces = evaluate(Planned(name, seed=0), [scenes.load(env)], episodes, protocol)
        row |= rounded(summarise(traces), ("n", *OUTCOMES, "spl"), f"{protocol}_")
    return row


def write_table(name, rows):
    """A table in results/. rows: dicts with the same keys."""
    with open(RESULTS / name, "w", newline="") as file:
        writer = csv.DictWriter(file, rows[0])
        writer.writeheader()
        writer.writerows(rows)


def write_tables(runs, ablations):
    """The tables of those runs, and the weights of seed 0, whichever seed is the best."""
    write_table("seeds.csv", [seed_row(run) for run in runs])
    for name, make_rows in (("hidden.csv", hidden_rows), ("floor.csv", floor_rows),
                            ("curves.csv", curve_rows)):
        write_table(name, [row for run in runs for row in make_rows(run)])
    if ablations:
        write_table("ablations.csv", [seed_row(run) for run in ablations])
    for env in BUDGET:
        shutil.copy(Run(env, "varied", 0).folder / "model.pt", ROOT / "pretrained" / f"{env}.pt")


# ----------------------------------------------------------------------------------------- the runs


def expected(runs, jobs):
    """What there is to do, in one sentence, by the seconds that the runs in results/ took."""
    left = [run for run in runs if not run.is_trained]
    took = {(row["env"], row["way"], row["seed"]): float(row["seconds"])
            for name in ("seeds.csv", "ablations.csv") for row in read_table(RESULTS / name)}
    seconds = sum(took[run.env, run.way, str(run.seed)] for run in left)
    return (f"{len(left)} of {len(runs)} runs are to be trained, which takes about "
            f"{seconds / jobs / 60:.0f} minutes, {jobs} at a time, if this machine is as fast as "
            "the one of results/; their examination comes on top")


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


def examine_planners():
    """Makes planners.csv."""
    rows = [planner_row(env, name) for name in PLANNERS for env in BUDGET]
    write_table("planners.csv", rows)


def main(argv=None):
    """The command line."""
    parser = CommandLine("Make every table and figure of the results.")
    options = parser.read(Options, argv)
    interruption.handle("interrupted: the runs under way are saved; the same command goes on")
    for folder in (RUNS, RESULTS):
        parser.must_write_to(folder)
    runs = [Run(env, way, seed) for way in WAYS for seed in SEEDS for env in BUDGET]
    ablations = []
    if options.ablations:
        ablations = [Run(env, way, seed) for env in BUDGET for seed in ABLATION_SEEDS
                     for way in ABLATIONS]
    try:
        if options.planners:
            examine_planners()
        else:
            print(expected(runs + ablations, options.jobs), flush=True)
            make_runs(runs + ablations, options.jobs)
            write_tables(runs, ablations)
            figures.main([])
        tables.main([])
    except subprocess.CalledProcessError as error:
        said = error.stderr.decode().strip() or f"exit code {error.returncode}"
        parser.error(f"'{' '.join(error.cmd[1:])}' failed: {said.splitlines()[-1]}")


if __name__ == "__main__":
    main()
