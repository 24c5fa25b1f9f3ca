"""The figures of levels 1 and 3: `python -m experiments.level_figures` draws them into pictures/.

The rooms and the success in unseen rooms come from `scenes/` and `results/`; paths, floor and film
are fresh episodes of `pretrained/any-room.pt`.
"""

import math
from dataclasses import replace

import numpy as np
from matplotlib.figure import Figure
from matplotlib.lines import Line2D

import scenes
from evaluation import PATCH, Assignment, Policy, film_episode, rollouts
from experiments import gallery
from experiments.level3 import ROOMS, TEST_ROOMS
from experiments.level_tables import EVER_NEW, of_seeds
from experiments.runs import RESULTS, ROOT
from scenes.generate import share_blocked
from support.film import write_film
from support.pictures import (PALETTE, WIDTH, draw_floor, draw_path, draw_room, outcome_handle,
                              read_table, start_handle)
from support.traces import OUTCOMES
from support.weights import load_run

DPI = 130
RANDOM_ROOMS = 20  # of the picture of rooms
PATHS = 24  # in each room
FLOOR_EPISODES = 1500
FLOOR_ROOM = "maze0"  # one of the two hardest
FILM_ROOM = "maze4"
FILM_SEED = 6  # of an episode that arrives, around something; every fifth or so does not


def draw_rooms(rooms, released):
    """Rooms from above, small, with the share of lines that are blocked; those that are released
    with a frame. rooms: Scenes. released: their names. Returns a Figure."""
    columns = 5
    rows = math.ceil(len(rooms) / columns)
    figure = Figure(figsize=(WIDTH, 1.35 * rows), layout="constrained")
    for axes, scene in zip(figure.subplots(rows, columns).flat, rooms):
        draw_room(axes, scene)
        axes.set(xlabel="", ylabel="", xticks=[], yticks=[])
        name = scene.name.replace("random-", "random:")
        axes.set_title(f"{name}, {share_blocked(scene):.0%}", fontsize=9, parse_math=False,
                       weight="bold" if scene.name in released else "normal")
        for spine in axes.spines.values():
            spine.set(lw=2.5 if scene.name in released else 0, color=PALETTE["run"])
    return figure


def draw_rooms_learnt(runs, tests):
    """Success from anywhere to anywhere against the number of rooms that were learnt in: there, in
    random rooms that were not, and in the test rooms; every seed, and the mean.

    runs, tests: rows of level3.csv and rooms.csv. Returns a Figure.
    """
    figure = Figure(figsize=(WIDTH, 4.2), layout="constrained")
    axes = figure.subplots()
    each = [of_seeds(runs, tests, f"rooms-{rooms}") for rooms in ROOMS]
    training, unseen, released = zip(*each)
    for shift, values, colour, mark, name in (
            (-0.07, training, PALETTE["training"], "s", "the rooms that it learnt in"),
            (0.0, unseen, PALETTE["new"], "o", "random rooms that it never saw"),
            (0.07, released, PALETTE["run"], "^", "the test rooms, which it never saw either")):
        for x, seeds in enumerate(values):
            axes.plot([x + shift] * len(seeds), seeds, color=colour, marker=mark, ms=5, ls="none",
                      alpha=0.6, mew=0)
        means = [np.mean(seeds) for seeds in values]
        axes.plot(np.arange(len(values)) + shift, means, color=colour, marker=mark, ms=7,
                  label=name)
    axes.set(xticks=range(len(ROOMS)), xticklabels=[*map(str, ROOMS[:-1]), EVER_NEW],
             xlabel="rooms learnt in", ylabel="success from anywhere\nto anywhere [%]",
             ylim=(30, 103))
    axes.grid(alpha=0.3)
    axes.legend(frameon=False, loc="upper right")
    return figure


MISSED = {"color": PALETTE["robot"], "ls": ":", "lw": 0.9, "marker": "o", "mfc": "none", "ms": 6}


def draw_any_room(driver, rooms):
    """Paths of a policy from anywhere to anywhere, a panel for each room. Returns a Figure."""
    robots = [Assignment(scene, 0, 1) for scene in rooms for _ in range(PATHS)]
    traces = rollouts(driver, robots, "anywhere")
    figure = Figure(figsize=(WIDTH, 4.3), layout="constrained")
    panels = figure.subplots(2, 3).ravel()
    for axes, scene in zip(panels, rooms):
        here = [trace for trace in traces if trace.scene is scene]
        draw_room(axes, scene)
        for trace in here:
            draw_path(axes, trace, lw=0.9, alpha=0.7)
            axes.plot(*trace.start[:2], color=PALETTE["robot"], marker="o", ms=3, ls="none")
            if not trace.arrived:
                axes.plot(*np.stack([trace.poses[-1, :2], trace.goal]).T, **MISSED, markevery=[1])
        arrived = sum(trace.arrived for trace in here)
        axes.set_title(f"{scene.name}: {arrived} of {len(here)} arrive", fontsize=9)
        axes.set(xlabel="", ylabel="", xticks=[], yticks=[])
    outcomes = [outcome_handle(outcome) for outcome in OUTCOMES
                if any(trace.outcome == outcome for trace in traces)]
    for axes in panels[len(rooms):]:
        axes.axis("off")
        axes.legend(handles=[start_handle(), *outcomes, Line2D([], [], **MISSED, markevery=[1],
                                                               label="the goal that it missed")],
                    loc="center", frameon=False, fontsize=9)
    return figure


def draw_all():
    """Yields the name of each figure and the Figure."""
    released = [scenes.load(name) for name in TEST_ROOMS]
    random_rooms = [scenes.load(f"random:{k}") for k in range(RANDOM_ROOMS)]
    mixed = list(random_rooms)
    for k, scene in enumerate(released):
        mixed.insert(6 * k, scene)  # along the diagonal
    yield "rooms", draw_rooms(mixed, TEST_ROOMS)
    runs = read_table(RESULTS / "level3.csv")
    if any(row["way"] == "rooms-0" for row in runs):  # as long as these are not all made
        yield "rooms-learnt", draw_rooms_learnt(runs, read_table(RESULTS / "rooms.csv"))
    driver = any_room()
    yield "any-room", draw_any_room(driver, released)
    scene = scenes.load(FLOOR_ROOM)
    traces = rollouts(driver, [Assignment(scene, 0, 10)] * (FLOOR_EPISODES // 10), "anywhere")
    without_targets = replace(scene, training_targets=(), new_targets=())  # none counts here
    yield "any-room-floor", draw_floor(without_targets, traces, PATCH)


def any_room():
    """A driver with the policy in pretrained/any-room.pt, deterministic actions."""
    model, _ = load_run(ROOT / "pretrained" / "any-room.pt")
    return Policy(model, "mean", seed=0)


def main(argv=None):
    """The command line."""
    gallery.read_command_line("Draw the figures of levels 1 and 3 into pictures/.", argv)
    gallery.save(draw_all(), DPI)
    scene = scenes.load(FILM_ROOM)
    trace = replace(film_episode(any_room(), scene, "anywhere", seed=FILM_SEED),
                    label="a room that it never saw")
    write_film(trace, gallery.PICTURES / "any-room.gif")
    print("pictures/any-room.gif")


if __name__ == "__main__":
    main()
