"""Level 1 of the paper (II-B): one target, with noise. Its runs and their table in results/;
`experiments.results` makes them."""

from dataclasses import dataclass

import numpy as np

from experiments import runs
from experiments.runs import OUTCOMES, rounded, write_table
from support.pictures import read_table

BUDGET = {"env1": 250_000, "maze0": 250_000}  # steps
SEEDS = range(5)
PROTOCOLS = {"start": "evaluation.json",  # training's own, at its end
             "perturbed": "evaluation-perturbed.json"}
EPISODES = 500  # by `perturbed`
STOP = 0.81  # of the last 100 episodes, where the released records of level 1 end


@dataclass(frozen=True)
class Run(runs.Run):
    """Level 1: one target, from near the start pose to near the target."""
    env: str
    seed: int

    stage = "level1"
    tables = ("level1.csv",)

    @property
    def names(self):
        return {"env": self.env, "seed": self.seed}

    @property
    def training(self):
        return ["--env", self.env, "--targets", "memorize", "--seed", self.seed,
                "--steps", BUDGET[self.env]]

    @property
    def examinations(self):
        return {PROTOCOLS["perturbed"]: ["--protocol", "perturbed", "--episodes", EPISODES]}


def main_runs():
    """Both rooms, five seeds."""
    return [Run(env, seed) for env in BUDGET for seed in SEEDS]


def steps_to(run, success):
    """The steps after which so many of the last 100 training episodes had arrived; "" for never."""
    arrived = []
    for row in read_table(run.folder / "episodes.csv"):
        if row["kind"] == "training":
            arrived.append(row["outcome"] == "arrival")
            if len(arrived) >= 100 and np.mean(arrived[-100:]) >= success:
                return int(row["steps"])
    return ""


def seed_row(run):
    """A run's row of level1.csv."""
    row = run.training_columns()
    row["steps_to_stop"] = steps_to(run, STOP)
    for protocol, file in PROTOCOLS.items():
        result = run.read(file)["training"]
        row |= rounded(result, ("n", *OUTCOMES, "spl"), f"{protocol}_")
    return row


def write_tables():
    """The table of all runs."""
    write_table("level1.csv", [seed_row(run) for run in main_runs()])
