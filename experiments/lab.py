"""The stand-in for the paper's real room (IV-C): policies of the simulation in the lab as they are,
after learning there, and after learning under errors that are drawn. The runs and their tables in
results/; `experiments.results` makes them. `docs/robot.md` says what the lab does."""

import shutil
from dataclasses import dataclass, replace

import numpy as np

import scenes
from evaluation.drivers import Policy
from evaluation.examine import evaluate
from experiments import runs
from experiments.runs import OUTCOMES, rounded, write_table
from robot.environment import RingVecEnv
from scenes.reality import KNOBS, Reality
from sim import CONTROL_PERIOD
from support.cores import available_cores
from support.pictures import read_table
from support.rooms import RANDOM
from support.weights import load_run

ROOM = "lab"
MEASURED = (*OUTCOMES, "standing", "stops", "spl")
WEIGHTS = ("env2", "any-room")  # of seed 0, in pretrained/
STARTS = {  # to learn in the lab -> what it begins with
    "from-env2": ["--init", "pretrained/env2.pt"],
    "from-any-room": ["--init", "pretrained/any-room.pt"],
    "from-scratch": []}
# One room, which has no mirror. Episodes are dear there: updates are of few and learn much of each.
IN_THE_LAB = ["--env", ROOM, "--ring", "--mirrored", "0", "--robots", "8",
              "--episodes-per-update", "8", "--minibatches", "2", "--epochs", "8"]
EPISODES = (300, 3000)  # in the lab; the paper's are 3,000
MOST_STEPS = 2_000_000  # no run needs so many
NO_LAB = {  # never in the lab: errors that are drawn anew each episode -> where, and how long
    "random-env2": ["--env", "env2", "--ring"],
    "random-rooms": ["--env", RANDOM, "--ring", "--init", "pretrained/any-room.pt"]}
NO_LAB_STEPS = 600_000
SEEDS = range(3)
KNOB_EPISODES = 200  # of each error alone
WINDOW = 300  # episodes that a point of a curve looks back on, of which 50 or so are to new targets
EVERY = 50
EXAM_EPISODES = 300  # to targets of each kind, and from anywhere to anywhere


@dataclass(frozen=True)
class Run(runs.Run):
    """A run that learns in the lab, or for the lab. way: a key of STARTS or NO_LAB. allowed:
    episodes in the lab."""
    way: str
    allowed: int
    seed: int

    stage = "lab"
    tables = ("lab.csv",)

    @property
    def names(self):
        return {"way": self.way, "allowed": self.allowed, "seed": self.seed}

    @property
    def training(self):
        if self.way in NO_LAB:
            options = [*NO_LAB[self.way], "--reality", "random", "--steps", NO_LAB_STEPS]
        else:
            options = [*IN_THE_LAB, *STARTS[self.way], "--episodes", self.allowed,
                       "--steps", MOST_STEPS]
        # The evaluation at the end of training is short, for the examinations follow.
        return [*options, "--seed", self.seed, "--evaluation-episodes", 100]

    @property
    def examinations(self):
        exam = ["--env", ROOM, "--ring", "--episodes", EXAM_EPISODES, "--protocol"]
        # A file's name says the protocol where it is not the run's own: `start`, but in many rooms.
        _, room, *_ = self.training
        start = "start-" if room == RANDOM else ""
        return {f"evaluation-lab-{start}ring.json": [*exam, "start"],
                "evaluation-lab-anywhere-ring.json": [*exam, "anywhere"]}


def main_runs():
    """All runs, the long ones first."""
    without = [Run(way, 0, seed) for way in NO_LAB for seed in SEEDS]
    return without + [Run(way, allowed, seed) for allowed in sorted(EPISODES, reverse=True)
                      for way in STARTS for seed in SEEDS]


def measured_columns(by_target, anywhere):
    """What two examinations found, as columns of lab.csv. by_target: from the start pose to the
    lab's targets. anywhere: from anywhere to anywhere."""
    columns = {}
    for kind in ("training", "new"):
        columns |= rounded(by_target[kind], ("n", *MEASURED), f"{kind}_")
    return columns | rounded(anywhere["anywhere"], ("n", *MEASURED), "anywhere_")


def seed_row(run):
    """A run's row of lab.csv. `hours`: what its episodes would take one robot in the lab."""
    row = run.training_columns()
    in_the_lab = row["steps"] if run.allowed else 0
    row["hours"] = round(in_the_lab * CONTROL_PERIOD / 3600, 2)
    return row | measured_columns(*map(run.read, run.examinations))


def curve_rows(run):
    """Rows of lab-curves.csv, one for each EVERY episodes of a run in the lab: how the last WINDOW
    of them ended, to any target and to new ones."""
    episodes = read_table(run.folder / "episodes.csv")
    rows = []
    for end in range(WINDOW, len(episodes) + 1, EVERY):
        last = episodes[end - WINDOW:end]
        new = [row["outcome"] == "arrival" for row in last if row["kind"] == "new"]
        hits = [row["outcome"] == "collision" for row in last]
        rows.append(run.names | {"episodes": end, "new_n": len(new),
                                 "new_success": round(float(np.mean(new)), 4),
                                 "collision": round(float(np.mean(hits)), 4)})
    return rows


def untouched_row(name):
    """The row of lab.csv of the weights in pretrained/ of that name, which never were in the lab or
    a room with errors."""
    model, _ = load_run(runs.ROOT / "pretrained" / f"{name}.pt")
    results = []
    for protocol, actions in (("start", "sampled"), ("anywhere", "mean")):
        driver = Policy(model, actions, seed=0)
        result, _ = evaluate(driver, [scenes.load(ROOM)], EXAM_EPISODES, protocol,
                             environment=RingVecEnv, workers=len(available_cores()))
        results.append(result)
    nothing = dict.fromkeys(("steps", "episodes", "seconds", "hours"), 0)
    return {"way": name, "allowed": 0, "seed": 0} | nothing | measured_columns(*results)


def alone(scene):
    """That Scene with none of its errors, with each of them alone, and with all: name -> Scene."""
    realities = {"none": Reality()}
    for name in ("look", *KNOBS):
        value = getattr(scene.reality, name)
        if value != getattr(Reality(), name):
            realities[name] = Reality(**{name: value})
    realities["all"] = scene.reality
    return {name: replace(scene, reality=reality) for name, reality in realities.items()}


def knob_rows(name):
    """The rows of knobs.csv of the weights in pretrained/ of that name: what each error of the lab
    costs them alone, from anywhere to anywhere."""
    model, _ = load_run(runs.ROOT / "pretrained" / f"{name}.pt")
    rows = []
    for knob, scene in alone(scenes.load(ROOM)).items():
        result, _ = evaluate(Policy(model, "mean", seed=0), [scene], KNOB_EPISODES, "anywhere",
                             environment=RingVecEnv, workers=len(available_cores()))
        rows.append({"weights": name, "knob": knob}
                    | rounded(result["anywhere"], ("n", *MEASURED)))
    return rows


def write_tables():
    """The tables, and the weights of seed 0 that learnt longest from env2's, whichever is the best.
    """
    write_table("lab.csv", [untouched_row(name) for name in WEIGHTS]
                + [seed_row(run) for run in main_runs()])
    longest = [run for run in main_runs() if run.allowed == EPISODES[-1]]
    write_table("lab-curves.csv", [row for run in longest for row in curve_rows(run)])
    write_table("knobs.csv", [row for name in WEIGHTS for row in knob_rows(name)])
    learnt = Run("from-env2", EPISODES[-1], 0)
    shutil.copy(learnt.folder / "model.pt", runs.ROOT / "pretrained" / "lab.pt")
