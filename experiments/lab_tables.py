"""The table of the lab, made from `results/lab.csv`; `experiments.tables` writes it into the pages.
"""

import math

import numpy as np

from experiments.lab import EPISODES, NO_LAB, ROOM, WEIGHTS
from experiments.markdown import markdown, percentages, select, worst_first
from scenes import load
from scenes.reality import ANGLES

NAMES = {  # column `way` of lab.csv
    "env2": "env2's, as it is",
    "any-room": "any-room's, as it is",
    "random-env2": "learnt in env2, errors drawn",
    "random-rooms": "any-room's, learnt on in random rooms, errors drawn",
    "from-scratch": "from random weights",
    "from-env2": "from env2's",
    "from-any-room": "from any-room's"}


def in_order():
    """Which rows the tables and figures show, in their order: (way, episodes in the lab)."""
    without = [(way, 0) for way in (*WEIGHTS, *NO_LAB)]
    return without + [(way, allowed) for way in ("from-scratch", "from-env2", "from-any-room")
                      for allowed in EPISODES]


def collisions(rows):
    """How many of 100 episodes to the lab's targets end in a collision, one a row."""
    return np.mean([percentages(rows, f"{kind}_collision") for kind in ("training", "new")], axis=0)


def stops(rows):
    """How often the ring refuses to drive on, in an episode to the lab's targets, one a row."""
    return np.mean([[float(row[f"{kind}_stops"]) for row in rows] for kind in ("training", "new")],
                   axis=0)


def knobs(rows):
    """What each error of the lab costs alone, the dearest first. rows: of knobs.csv."""
    lab = load(ROOM).reality
    success = {}  # of all weights, for each knob
    for row in rows:
        success.setdefault(row["knob"], []).append(100 * float(row["success"]))
    ends = ("none", "all")
    between = [knob for knob in success if knob not in ends]
    between.sort(key=lambda knob: np.mean(success[knob]))
    table = []
    for knob in ("none", *between, "all"):
        value = "" if knob in ends else worded(knob, getattr(lab, knob))
        table.append([knob.replace("_", " "), value, *(f"{one:.0f}" for one in success[knob])])
    return markdown(["error alone", "in the lab", *(NAMES[name] for name in WEIGHTS)], table)


def worded(knob, value):
    """A knob's value as its room's file has it."""
    if isinstance(value, tuple):
        return ", ".join(f"{part:g}" for part in value)
    if knob in ANGLES:
        return f"{math.degrees(value):g} degrees"
    return value if isinstance(value, str) else f"{value:g}"


def lab(rows):
    """Policies in the lab: success of each seed, the worst first. rows: of lab.csv."""
    header = ["policy", "episodes in the lab", "robot-hours", "new targets", "training targets",
              "any place, from anywhere", "collisions in 100 episodes", "stops an episode"]
    table = []
    for way, allowed in in_order():
        chosen = select(rows, way=way, allowed=str(allowed))
        hours = np.mean([float(row["hours"]) for row in chosen])
        success = [worst_first(percentages(chosen, f"{kind}_success"))
                   for kind in ("new", "training", "anywhere")]
        table.append([NAMES[way], f"{allowed:,}", f"{hours:.1f}", *success,
                      f"{np.mean(collisions(chosen)):.1f}", f"{np.mean(stops(chosen)):.1f}"])
    return markdown(header, table)
