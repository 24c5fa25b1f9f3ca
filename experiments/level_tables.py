"""The tables of levels 1 and 3, made from the files in `results/`; `experiments.tables` writes them
into the pages."""

import numpy as np

from experiments.level3 import BUDGET, PAPER_ROOMS, ROOMS, TEST_ROOMS, VALIDATION
from experiments.markdown import (markdown, percentages, select, with_interval,
                                  worst_first)
from support.rooms import EVERY, RandomRooms
from train import Config

LEARNERS = RandomRooms(Config(), []).learning  # robots that are learnt from
EVER_NEW = f"{LEARNERS * BUDGET // EVERY} new ones"  # each drives EVERY steps of all in a room
NETWORKS = {  # column `way` of level3.csv
    "rooms-0": "as it is",
    "single": "one LSTM (`single`)",
    "none": "no memory (`none`)",
    "blind": "no camera image (`blind`)",
    "no-target": "no target position (`no-target`)",
    "no-last": "no last velocity and reward (`no-last`)"}


def level1(rows):
    """Level 1, seed by seed. rows: of level1.csv."""
    header = ["room", "seed", "steps until 81 of 100", "from the start poses, sampled actions",
              "start and target moved, deterministic actions", "SPL, moved"]
    table = []
    for room in sorted({row["env"] for row in rows}):
        here = sorted(select(rows, env=room), key=lambda row: float(row["perturbed_success"]))
        for row in here:
            steps = f"{int(row['steps_to_stop']):,}" if row["steps_to_stop"] else "never"
            table.append([room, row["seed"], steps, with_interval(row, "start"),
                          with_interval(row, "perturbed"), f"{float(row['perturbed_spl']):.2f}"])
    return markdown(header, table)


def lower_levels(one, two):
    """Levels 1 and 2 in short, a row for each room. one, two: rows of level1.csv and seeds.csv."""
    header = ["level", "room", "success in the exam, each seed", "SPL"]
    table = []
    for level, rows, exam in (("1: one target", one, "perturbed"),
                              ("2: new targets", select(two, way="varied"), "new")):
        for room in sorted({row["env"] for row in rows}):
            here = select(rows, env=room)
            spl = np.mean([float(row[f"{exam}_spl"]) for row in here])
            table.append([level, room, worst_first(percentages(here, f"{exam}_success"), "{:.1f}"),
                          f"{spl:.2f}"])
    return markdown(header, table)


def level3(runs, tests):
    """Level 3, seed by seed, the worst first, room by room. runs, tests: rows of level3.csv and
    rooms.csv."""
    header = ["seed", *TEST_ROOMS, "mean of these", "SPL", "random rooms, validation",
              "hours of training, one core"]
    table = []
    tests = select(tests, way="any-room", targets="anywhere")

    def success_of(run):
        return percentages(select(tests, seed=run["seed"]), "success")
    for run in sorted(select(runs, way="any-room"), key=lambda run: np.mean(success_of(run))):
        here = {row["room"]: row for row in select(tests, seed=run["seed"])}
        table.append([run["seed"], *(with_interval(here[room]) for room in TEST_ROOMS),
                      f"**{np.mean(success_of(run)):.1f} %**",
                      f"{np.mean([float(row['spl']) for row in here.values()]):.2f}",
                      with_interval(run, VALIDATION), f"{float(run['seconds']) / 3600:.1f}"])
    return markdown(header, table)


def level3_targets(tests):
    """Level 3 on the paper's targets, seed by seed, the worst first. tests: rows of rooms.csv."""
    kinds = [(room, targets) for room in PAPER_ROOMS for targets in ("training", "new")]
    seeds = {}
    for row in select(tests, way="any-room"):
        seeds.setdefault(row["seed"], {})[row["room"], row["targets"]] = row

    def mean_success(seed):
        return np.mean([float(seeds[seed][kind]["success"]) for kind in kinds])
    table = [[seed, *(with_interval(seeds[seed][kind]) for kind in kinds)]
             for seed in sorted(seeds, key=mean_success)]
    return markdown(["seed", *(f"{room}, {targets}" for room, targets in kinds)], table)


def of_seeds(runs, tests, way):
    """Success [%] of each seed of a way: in the rooms it learnt in, in random rooms it did not, and
    in the test rooms."""
    chosen = select(runs, way=way)
    tests = select(tests, way=way, targets="anywhere")
    released = [np.mean(percentages(select(tests, seed=run["seed"]), "success"))
                for run in chosen]
    return (percentages(chosen, "training_success"), percentages(chosen, f"{VALIDATION}_success"),
            released)


def rooms_learnt(runs, tests):
    """Success against the number of rooms learnt in. runs, tests: rows of level3.csv, rooms.csv."""
    header = ["rooms learnt in", "success there", "random rooms never seen", "test rooms"]
    table = []
    for rooms in ROOMS:
        each = of_seeds(runs, tests, f"rooms-{rooms}")
        table.append([str(rooms) if rooms else EVER_NEW, *map(worst_first, each)])
    return markdown(header, table)


def level3_ablations(runs, tests):
    """The ablations at level 3. runs, tests: rows of level3.csv and rooms.csv."""
    header = ["network", "random rooms never seen", "test rooms"]
    table = []
    for way, name in NETWORKS.items():
        _, unseen, released = of_seeds(runs, tests, way)
        table.append([name, worst_first(unseen), worst_first(released)])
    return markdown(header, table)


def carry_over(rows):
    """What level-2 policies do in rooms they never saw. rows: of carry-over.csv."""
    header = ["trained in", "drives in", "to", "success of each seed"]
    names = {"training": "its training targets", "new": "its new targets",
             "anywhere": "any place, from anywhere"}
    table = []
    for key in dict.fromkeys((row["env"], row["room"], row["targets"]) for row in rows):
        env, room, targets = key
        chosen = select(rows, env=env, room=room, targets=targets)
        table.append([env, room, names[targets], worst_first(percentages(chosen, "success"))])
    return markdown(header, table)


def level3_planners(rows):
    """The planners in the same rooms. rows: of level3-planners.csv."""
    rooms = (*TEST_ROOMS, VALIDATION)
    table = []
    for planner in dict.fromkeys(row["planner"] for row in rows):
        here = {row["room"]: row for row in select(rows, planner=planner)}
        table.append([planner] + [f"{100 * float(here[room]['success']):.0f} %, SPL "
                                  f"{float(here[room]['spl']):.2f}" for room in rooms])
    return markdown(["planner", *rooms], table)
