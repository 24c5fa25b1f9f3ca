"""Level 2 of the paper (II-B): new targets in the room of training. Its runs, in both rooms, and
their tables in results/; `experiments.results` makes them."""

import shutil
from dataclasses import dataclass

import numpy as np

import scenes
from evaluation.drivers import Planned
from evaluation.examine import evaluate
from evaluation.measures import summarise
from evaluation.planners import PLANNERS
from experiments import runs
from experiments.runs import OUTCOMES, examined_rows, rounded, write_table
from support.pictures import read_table

BUDGET = {"env1": 250_000, "env2": 400_000}  # steps, new targets' included
# Of every run: the update as it was when the tables were made (docs/tuning-log.md).
SETTINGS = ["--robots", "32", "--episodes-per-update", "32", "--learning-rate", "6e-4"]
MORE_ROOMS = ("maze0", "maze3", "maze4")  # of the released simulator
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
OTHER_EPISODES = 200  # of each kind, or in all
PLANNER_EPISODES = {"start": 1, "anywhere": 50}  # to each target; in all
CURVE_WINDOW = 100  # episodes that a point of curves.csv looks back on
CURVE_SPACING = 50  # episodes from one point to the next


def other_rooms(env):
    """The rooms that a policy trained in `env` never saw, and the protocols to drive in them by:
    [(room, protocol), ...]."""
    [twin] = set(BUDGET) - {env}
    return [(twin, "start"), *((room, "anywhere") for room in (twin, *MORE_ROOMS))]


@dataclass(frozen=True)
class Run(runs.Run):
    """A training run in one of the paper's rooms, level 2."""
    env: str
    way: str
    seed: int

    stage = "level2"
    tables = ("seeds.csv", "ablations.csv")

    @property
    def names(self):
        return {"env": self.env, "way": self.way, "seed": self.seed}

    @property
    def training(self):
        options = (WAYS | ABLATIONS)[self.way]
        return ["--env", self.env, "--seed", self.seed, "--steps", BUDGET[self.env], *SETTINGS,
                *options]

    @property
    def examinations(self):
        wanted = {"evaluation-anywhere.json": [
            "--protocol", "anywhere", "--episodes", ANYWHERE_EPISODES]}
        if self.way in WAYS:
            for hidden in HIDDEN:
                wanted[f"evaluation-hidden-{hidden}.json"] = [
                    "--hide", hidden, "--episodes", HIDDEN_EPISODES]
            wanted["evaluation-validation.json"] = [
                "--protocol", "validation", "--episodes", VALIDATION_EPISODES]
        if self.way == "varied":
            for room, protocol in other_rooms(self.env):
                suffix = "" if protocol == "start" else f"-{protocol}"
                wanted[f"evaluation-{room}{suffix}.json"] = [
                    "--env", room, "--protocol", protocol, "--episodes", OTHER_EPISODES]
        return wanted


# --------------------------------------------------------------------------------------- the tables


def seed_row(run):
    """A run's row of seeds.csv or ablations.csv."""
    summary = run.read("summary.json")
    anywhere = run.read("evaluation-anywhere.json")["anywhere"]
    row = run.training_columns()
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


def main_runs():
    """Both ways to train, five seeds, both rooms."""
    return [Run(env, way, seed) for way in WAYS for seed in SEEDS for env in BUDGET]


def ablation_runs():
    """The ablations, three seeds, both rooms."""
    return [Run(env, way, seed) for env in BUDGET for seed in ABLATION_SEEDS for way in ABLATIONS]


def carry_over_rows(run):
    """A run's rows of carry-over.csv: what its policy does in rooms that it never saw."""
    rows = []
    for room, protocol in other_rooms(run.env):
        suffix = "" if protocol == "start" else f"-{protocol}"
        rows += examined_rows(run, room, f"evaluation-{room}{suffix}.json")
    return rows


def write_tables():
    """The tables of all runs, and the weights of seed 0, whichever seed is the best."""
    write_table("seeds.csv", [seed_row(run) for run in main_runs()])
    for name, make_rows in (("hidden.csv", hidden_rows), ("floor.csv", floor_rows),
                            ("curves.csv", curve_rows)):
        write_table(name, [row for run in main_runs() for row in make_rows(run)])
    write_carry_over()
    for env in BUDGET:
        shutil.copy(Run(env, "varied", 0).folder / "model.pt",
                    runs.ROOT / "pretrained" / f"{env}.pt")


def write_ablations():
    """Makes ablations.csv."""
    write_table("ablations.csv", [seed_row(run) for run in ablation_runs()])


def write_carry_over():
    """Makes carry-over.csv."""
    write_table("carry-over.csv", [row for run in main_runs() if run.way == "varied"
                                   for row in carry_over_rows(run)])


def write_planners():
    """Makes planners.csv."""
    write_table("planners.csv", [planner_row(env, name) for name in PLANNERS for env in BUDGET])
