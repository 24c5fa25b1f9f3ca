"""The runs of `experiments.results`, and the rows that each run adds to tables in results/."""

import itertools
import json
from dataclasses import dataclass

import pandas as pd

from experiments.tables import ROOT
from sim import CONTROL_PERIOD
from support.rooms import RANDOM

RUNS = ROOT / "runs" / "results"
RATES = ("n", "success", "low", "high", "collision", "timeout", "spl")  # columns of most tables
LAB_RATES = (*RATES[:-1], "standing", "stops", "spl")
PAPER_ROOMS = {"env1": 250_000, "env2": 400_000}  # room -> training steps at level 2
TEST_ROOMS = (*PAPER_ROOMS, "maze0", "maze3", "maze4")  # never used for training
WAYS = {"one-start": {"random_starts": 0.0, "mirrored": 0.0}, "varied": {}}  # level 2
PART = 500_000  # steps per point of level3-curves.csv
STOP_WORKERS = (1, 2, 4)  # numbers of processes of the runs that stop by the paper's rule
BUDGETS = (100_000, 150_000, 250_000)  # steps in env1
FRESH = range(200, 205)  # seeds that no choice has used
HIDDEN = ("place", "cube", "both")  # parts of the observation
ABLATIONS = {  # way -> options
    "single": {"memory": "single"}, "none": {"memory": "none"}, "blind": {"without": "image"},
    "no-target": {"without": "target"}, "no-last": {"without": "last"}}
WEIGHTS = {name: f"pretrained/{name}.safetensors" for name in ("env2", "any-room")}  # for the lab
STARTS = {f"from-{name}": {"init": file} for name, file in WEIGHTS.items()} | {"from-scratch": {}}
# One room, never mirrored. Episodes are expensive, so each update learns much from a few.
IN_THE_LAB = {"env": "lab", "mirrored": 0.0, "robots": 8, "episodes_per_update": 8,
              "minibatches": 2, "epochs": 8}
SUMMARIES = {  # stage -> prefix of columns -> evaluation (0: by the training), kind of targets
    "level1": {"start": (0, "training"), "perturbed": (1, "training")},
    "level2": {"training": (0, "training"), "new": (0, "new"), "anywhere": (1, "anywhere")},
    "any-target": {"training": (1, "training"), "new": (1, "new"), "anywhere": (2, "anywhere")},
    "level3": {"training": (0, "training"), "validation": (0, "new")},
    "drawn": {"training": (0, "training"), "validation": (0, "new")},
    "lab": {"training": (1, "training"), "new": (1, "new"), "anywhere": (2, "anywhere")}}


@dataclass(frozen=True)
class Run:
    """A training run and its evaluations. Its files are in runs/results/."""
    stage: str  # first part of the folder's name, and a key of SUMMARIES
    names: dict  # first columns of each of its rows; the last one is the seed
    options: dict  # field of the training's Config -> value
    evaluations: dict  # NAME in evaluation-NAME.json -> options
    weights: str = ""  # a file to evaluate without any training

    @property
    def folder(self):
        """Folder of the run."""
        *names, seed = map(str, self.names.values())
        return RUNS / f"{self.stage}-{'-'.join(names)}-seed{seed}"

    @property
    def training(self):
        """Options of the training, with those that all runs share."""
        common = {"seed": self.names["seed"], "fixed_budget": True, "workers": 1}
        return common | self.options

    def read(self, file):
        """Returns the content of a JSON file, or the rows of a CSV file as a DataFrame."""
        path = self.folder / file
        return pd.read_csv(path) if path.suffix == ".csv" else json.loads(path.read_text())


def in_rooms(rooms, protocol, episodes):
    """Returns an evaluation for each of the rooms: name -> options."""
    return {f"{room}-{protocol}": {"env": room, "protocol": protocol, "episodes": episodes}
            for room in rooms}


def level_2_runs(ways, seeds):
    """Returns the runs with new targets in the training room. ways: name -> options."""
    runs = []
    for (way, options), seed, env in itertools.product(ways.items(), seeds, PAPER_ROOMS):
        wanted = {"anywhere": {"protocol": "anywhere", "episodes": 500}}
        if way in WAYS:
            wanted |= {f"hidden-{name}": {"hide": name, "episodes": 200} for name in HIDDEN}
            wanted["validation"] = {"protocol": "validation", "episodes": 300}
        if way == "varied":  # also in rooms not trained in
            twin = "env2" if env == "env1" else "env1"
            wanted[twin] = {"env": twin, "protocol": "start", "episodes": 200}
            wanted |= in_rooms([room for room in TEST_ROOMS if room != env], "anywhere", 200)
        options = {"env": env, "steps": PAPER_ROOMS[env]} | options
        runs.append(Run("level2", {"env": env, "way": way, "seed": seed}, options, wanted))
    return runs


def level_3_runs():
    """Returns the runs with random targets in random rooms, the long runs first."""
    ways = {"any-room": {"steps": 20_000_000}}
    counts = (1, 4, 16, 64, 256, 0)  # numbers of training rooms; 0: always new ones
    ways |= {f"rooms-{count}": {"rooms": count} for count in counts} | ABLATIONS
    tests = dict.fromkeys(ways, in_rooms(TEST_ROOMS, "anywhere", 100))
    tests["any-room"] = in_rooms(TEST_ROOMS, "anywhere", 300) | in_rooms(PAPER_ROOMS, "start", 300)
    same = {"env": RANDOM, "targets": "anywhere", "steps": 500_000}
    return [Run("level3", {"way": way, "seed": seed}, same | options, tests[way])
            for way, options in ways.items() for seed in range(3)]


def lab_runs():
    """Returns the runs in the lab, the simulated real room (paper IV-C)."""
    ways = [(way, 0, {}, file) for way, file in WEIGHTS.items()]
    drawn = {"env": "env2", "reality": "random", "steps": 600_000}  # not in the lab
    rooms = {"env": RANDOM, "targets": "anywhere", "init": WEIGHTS["any-room"]}
    ways += [("random-env2", 0, drawn, ""), ("random-rooms", 0, drawn | rooms, "")]
    # An episode has at most 200 steps, so `episodes` is the limit: 3,000 in the paper.
    ways += [(way, n, IN_THE_LAB | options | {"episodes": n, "steps": 200 * n}, "")
             for n in (3000, 300) for way, options in STARTS.items()]
    common = {"env": "lab", "ring": True, "episodes": 300}
    runs = []
    for way, allowed, options, file in ways:
        # The name contains `start` only if that is not the default protocol of the run.
        start = "lab-start-ring" if "targets" in options else "lab-ring"
        wanted = {start: common | {"protocol": "start"},
                  "lab-anywhere-ring": common | {"protocol": "anywhere"}}
        options = options | {"ring": True, "evaluation_episodes": 100}  # others follow
        runs += [Run("lab", {"way": way, "allowed": allowed, "seed": seed}, options, wanted, file)
                 for seed in range(1 if file else 3)]
    return runs


def drawn_runs():
    """Returns the run that trains any-room's policy further, with random errors and appearances."""
    options = {"env": RANDOM, "targets": "anywhere", "reality": "random", "steps": 1_000_000,
               "init": WEIGHTS["any-room"]}
    return [Run("drawn", {"way": "drawn-errors", "seed": 0}, options, {})]


def rates(result, keys=RATES, prefix=""):
    """Returns values of an evaluation as columns. Their names begin with the prefix."""
    return {prefix + key: round(result[key], 4) for key in keys}


def summary_rows(run):
    """Returns a run's row in the table of its stage: training time and success rates."""
    summary = {} if run.weights else run.read("summary.json")
    row = run.names | {key: summary.get(key, 0) for key in ("steps", "episodes", "seconds")}
    if run.stage == "level1":
        episodes = run.read("episodes.csv")
        arrived = (episodes.outcome == "arrival").rolling(100).sum()
        row["steps_to_stop"] = next(iter(episodes.steps[arrived >= 81]), "")  # as released
    if run.stage == "lab":  # driving time of a single robot
        row["hours"] = round(row["steps"] * CONTROL_PERIOD / 3600, 2) if row["allowed"] else 0.0
    keys = {"level2": RATES[1:], "any-target": RATES[1:], "lab": LAB_RATES}.get(run.stage, RATES)
    files = ["evaluation.json", *(f"evaluation-{name}.json" for name in run.evaluations)]
    for prefix, (which, kind) in SUMMARIES[run.stage].items():
        row |= rates(run.read(files[which])[kind], keys, f"{prefix}_")
    if run.stage == "level2":
        arrive = [goal["mean_action_arrives"] for goal in run.read("evaluation.json")["targets"]]
        row["mean_action_arrives"] = f"{sum(arrive)} of {len(arrive)}"
    return [row]


def stop_rows(run):
    """Returns a run's row of stops.csv: when it stopped, and how its frozen policy drives."""
    summary = run.read("summary.json")
    row = run.names | {key: summary[key] for key in ("steps", "rolling_new_success")}
    for kind in ("new", "training"):
        row |= rates(summary["frozen"][kind], RATES[:-1], f"{kind}_")
    return [row]


def budget_rows(run):
    """Returns a run's rows of budgets.csv, one for each target."""
    return [run.names | {"kind": target["kind"]}
            | rates(target, ("x", "y", "n", "success", "low", "high"))
            for target in run.read("evaluation.json")["targets"]]


def hidden_rows(run):
    """Returns a run's rows of hidden.csv, one for each value of `--hide`."""
    results = [(name, run.read(f"evaluation-hidden-{name}.json")) for name in HIDDEN]
    return [run.names | {"hidden": name} | rates(result["training"], RATES[:-1], "training_")
            | rates(result["new"], RATES[:-1], "new_") for name, result in results]


def floor_rows(run):
    """Returns a run's rows of floor.csv, one for each validation target."""
    return [run.names | rates(target, ("x", "y", "n", "success", "collision", "timeout"))
            for target in run.read("evaluation-validation.json")["targets"]
            if target["kind"] == "validation"]


def room_rows(run):
    """Returns a run's rows of carry-over.csv or rooms.csv: each kind of targets in each room."""
    results = [(options["env"], run.read(f"evaluation-{name}.json"))
               for name, options in run.evaluations.items() if "env" in options]
    return [run.names | {"room": room, "targets": kind} | rates(result[kind])
            for room, result in results for kind in ("training", "new", "anywhere")
            if result.get(kind)]


def curve_rows(run):
    """Returns a run's rows of curves.csv: means over 100 episodes to targets of one kind."""
    rows = []
    for kind, episodes in run.read("episodes.csv").groupby("kind"):
        for n in range(100, len(episodes) + 1, 50):
            last = episodes[n - 100:n]
            rows.append(run.names | {"kind": kind, "steps": last.steps.iloc[-1], "episodes": n,
                                     "success": round((last.outcome == "arrival").mean(), 2),
                                     "return": round(last["return"].mean(), 1)})
    return rows


def part_rows(run):
    """Returns a run's rows of level3-curves.csv, one for each PART of its steps."""
    episodes = run.read("episodes.csv")
    arrived = episodes.outcome == "arrival"
    parts = arrived.groupby([(episodes.steps - 1) // PART, episodes.kind]).mean().unstack()
    return [run.names | {"steps": (part + 1) * PART, "training_success": round(rates.training, 4),
                         "validation_success": round(rates.new, 4)}
            for part, rates in parts.iterrows()]


def delta_rows(run):
    """Returns a run's rows of deltas.csv, one per 100 training episodes."""
    frozen = round(run.read("evaluation-anywhere.json")["anywhere"]["success"], 3)
    points = [row for row in curve_rows(run) if row["kind"] == "training"]
    return [run.names | {"steps": row["steps"], "success": row["success"], "frozen": frozen}
            for row in points[::2]]


LEVEL_1 = [  # one target; start pose and target are perturbed
    Run("level1", {"env": env, "seed": seed}, {"env": env, "targets": "memorize", "steps": 250_000},
        {"perturbed": {"protocol": "perturbed", "episodes": 500}})
    for env in ("env1", "maze0") for seed in range(5)]
LEVEL_2 = level_2_runs(WAYS, range(5))
ANY_TARGET = [  # level 3's task in one room
    Run("any-target", {"env": "env1", "way": "any-target", "seed": seed},
        {"env": "env1", "targets": "anywhere", "steps": PAPER_ROOMS["env1"]},
        {"start": {"protocol": "start", "episodes": 1000},
         "anywhere": {"protocol": "anywhere", "episodes": 500}}) for seed in range(5)]
BUDGET = [Run("budget", {"budget": steps, "seed": seed}, {"env": "env1", "steps": steps}, {})
          for steps in BUDGETS for seed in (*range(5), *FRESH)]
STOPS = [  # the paper's rule stops these runs
    Run("stop", {"env": env, "processes": workers, "seed": seed},
        {"env": env, "workers": workers, "fixed_budget": False}, {})
    for env, workers in [*itertools.product(["env1"], STOP_WORKERS), ("env2", 2)]
    for seed in range(5)]
LEVEL_2_ABLATIONS = level_2_runs(ABLATIONS | {"one-room": {"mirrored": 0.0}}, range(3))
DELTAS = [  # the lesson, and variants with one changed option
    Run("delta", {"delta": name, "seed": seed}, {"env": "env1", "steps": 120_000} | options,
        {"anywhere": {"protocol": "anywhere", "episodes": 300}})
    for name, options in {
        "lesson": {}, "lambda": {"lam": 1.0},
        "passes": {"epochs": 2}, "clipping": {"epochs": 2, "clip": 1e9}}.items()
    for seed in range(3)]
LEVEL_3 = level_3_runs()
ANY_ROOM = [run for run in LEVEL_3 if run.names["way"] == "any-room"]
LAB = lab_runs()
DRAWN = drawn_runs()
TABLES = {  # file in results/ -> its runs, function that returns the rows of a run
    "level1.csv": (LEVEL_1, summary_rows),
    "seeds.csv": (LEVEL_2, summary_rows), "any-target.csv": (ANY_TARGET, summary_rows),
    "budgets.csv": (BUDGET, budget_rows),
    "stops.csv": (STOPS, stop_rows), "hidden.csv": (LEVEL_2, hidden_rows),
    "floor.csv": (LEVEL_2, floor_rows), "curves.csv": (LEVEL_2, curve_rows),
    "carry-over.csv": ([run for run in LEVEL_2 if run.names["way"] == "varied"], room_rows),
    "ablations.csv": (LEVEL_2_ABLATIONS, summary_rows), "deltas.csv": (DELTAS, delta_rows),
    "level3.csv": (LEVEL_3, summary_rows), "rooms.csv": (LEVEL_3, room_rows),
    "level3-curves.csv": (ANY_ROOM, part_rows),
    "lab.csv": (LAB, summary_rows), "drawn.csv": (DRAWN, summary_rows)}
PRETRAINED = {  # name -> run with its weights, always seed 0, not the best seed
    "env1": "level2-env1-varied-seed0", "env1-memorized": "level2-env1-one-start-seed0",
    "env2": "level2-env2-varied-seed0",
    "any-room": "level3-any-room-seed0", "lab": "lab-from-env2-3000-seed0",
    "drawn-errors": "drawn-drawn-errors-seed0"}
CLASSROOM = {  # folder in classroom/runs/ -> run that it is a part of
    "one": "level2-env1-one-start-seed0", "anywhere": "level2-env1-varied-seed0",
    "none": "level2-env1-none-seed0"}
