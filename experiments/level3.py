"""Level 3 of the paper (II-B): any target in any room. Its runs and the tables of them in results/;
`experiments.results` makes them. `docs/benchmark.md` says which rooms are for what."""

import shutil
from dataclasses import dataclass

import scenes
from evaluation.drivers import Planned
from evaluation.examine import evaluate
from evaluation.planners import PLANNERS
from experiments import level2, runs
from experiments.runs import OUTCOMES, examined_rows, rounded, write_table
from support.rooms import RANDOM, validation_scenes

PAPER_ROOMS = tuple(level2.BUDGET)  # with the paper's training and new targets
TEST_ROOMS = (*PAPER_ROOMS, *level2.MORE_ROOMS)  # never trained or tuned on
VALIDATION = "validation"  # the name of random:0 to random:15 in the tables
ANY_ROOM_BUDGET = 8_000_000  # steps
BUDGET = 500_000  # steps of each run for the figure, and of the ablations
ROOMS = (1, 4, 16, 64, 256, 0)  # to learn in; 0: ever new ones
SEEDS = range(3)
ABLATIONS = {name: level2.ABLATIONS[name]
             for name in ("single", "none", "blind", "no-target", "no-last")}
EPISODES = 300  # in each test room
FEWER_EPISODES = 100  # of the runs for the figure, and of the ablations
PLANNER_EPISODES = 50


@dataclass(frozen=True)
class Run(runs.Run):
    """Level 3: any target in any room. way: "any-room", a number of rooms or an ablation."""
    way: str
    seed: int

    stage = "level3"
    tables = ("level3.csv",)

    @property
    def names(self):
        return {"way": self.way, "seed": self.seed}

    @property
    def training(self):
        budget = ANY_ROOM_BUDGET if self.way == "any-room" else BUDGET
        options = ABLATIONS.get(self.way, [])
        if self.way.startswith("rooms-"):
            options = ["--rooms", self.way.removeprefix("rooms-")]
        return ["--env", RANDOM, "--seed", self.seed, "--steps", budget, *options]

    @property
    def examinations(self):
        episodes = EPISODES if self.way == "any-room" else FEWER_EPISODES
        wanted = {f"evaluation-{room}-anywhere.json":
                  ["--env", room, "--protocol", "anywhere", "--episodes", episodes]
                  for room in TEST_ROOMS}
        if self.way == "any-room":
            wanted |= {f"evaluation-{room}-start.json":
                       ["--env", room, "--protocol", "start", "--episodes", episodes]
                       for room in PAPER_ROOMS}
        return wanted


def main_runs():
    """All runs, the long ones first."""
    ways = ["any-room", *(f"rooms-{rooms}" for rooms in ROOMS), *ABLATIONS]
    return [Run(way, seed) for way in ways for seed in SEEDS]


def seed_row(run):
    """A run's row of level3.csv."""
    summary = run.read("summary.json")
    row = run.training_columns()
    for kind, name in (("training", "training"), ("new", VALIDATION)):
        row |= rounded(summary["frozen"][kind], ("n", *OUTCOMES, "spl"), f"{name}_")
    return row


def test_rows(run):
    """A run's rows of rooms.csv, one for each test room, and where it was examined for the paper's
    targets, one for each kind of these."""
    rows = []
    for file in run.examinations:
        _, room, _ = file.split("-")  # evaluation-env1-anywhere.json
        rows += examined_rows(run, room, file)
    return rows


def planner_rows(name):
    """A planner's rows of level3-planners.csv: from anywhere to anywhere in each room."""
    rows = []
    for room in (*TEST_ROOMS, VALIDATION):
        rooms = validation_scenes() if room == VALIDATION else [scenes.load(room)]
        result, _ = evaluate(Planned(name, seed=0), rooms, PLANNER_EPISODES, "anywhere")
        rows.append({"planner": name, "room": room}
                    | rounded(result["anywhere"], ("n", *OUTCOMES, "spl")))
    return rows


def write_tables():
    """The tables of all runs, and the weights of seed 0, whichever seed is the best."""
    write_table("level3.csv", [seed_row(run) for run in main_runs()])
    write_table("rooms.csv", [row for run in main_runs() for row in test_rows(run)])
    shutil.copy(Run("any-room", 0).folder / "model.pt", runs.ROOT / "pretrained" / "any-room.pt")


def write_planners():
    """Makes level3-planners.csv."""
    write_table("level3-planners.csv", [row for name in PLANNERS for row in planner_rows(name)])
