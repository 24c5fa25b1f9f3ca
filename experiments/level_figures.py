"""The figures of levels 1 and 3: `python -m experiments.level_figures` draws them into pictures/.

The rooms and the success in unseen rooms come from `scenes/` and `results/`; paths, floor and film
are fresh episodes of `pretrained/any-room.pt`.
"""

import math
from dataclasses import replace

import numpy as np
from matplotlib.figure import Figure

import scenes
from evaluation import PATCH, Assignment, Policy, film_episode, rollouts
from experiments.level3 import ROOMS, TEST_ROOMS
from experiments.level_tables import of_seeds
from experiments.runs import RESULTS, ROOT
from support.command_line import CommandLine
from support.film import write_film
from support.pictures import (PALETTE, WIDTH, draw_floor, draw_path, draw_room, outcome_handles,
                              read_table, start_handle)
from support.weights import load_run

PICTURES = ROOT / "pictures"
DPI = 130
RANDOM_ROOMS = 20  # of the picture of rooms
PATHS = 24  # in each room
FLOOR_EPISODES = 1500
FILM_ROOM = "maze3"


def draw_rooms(rooms, released):
    """Rooms from above, small, those that are released with a frame. rooms: Scenes. released: their
    names. Returns a Figure."""
    columns = 5
    rows = math.ceil(len(rooms) / columns)
    figure = Figure(figsize=(WIDTH, 1.35 * rows), layout="constrained")
    for axes, scene in zip(figure.subplots(rows, columns).flat, rooms):
        draw_room(axes, scene)
        axes.set(xlabel="", ylabel="", xticks=[], yticks=[])
        axes.set_title(scene.name.replace("random-", "random:"), fontsize=9, parse_math=False,
                       weight="bold" if scene.name in released else "normal")
        for spine in axes.spines.values():
            spine.set(lw=2.5 if scene.name in released else 0, color=PALETTE["run"])
    return figure


def draw_rooms_learnt(runs, tests):
    """Success from anywhere to anywhere against the number of rooms that were learnt in: there, in
    random rooms that were not, and in the released rooms; every seed, and the mean.

    runs, tests: rows of level3.csv and rooms.csv. Returns a Figure.
    """
    figure = Figure(figsize=(WIDTH, 4.2), layout="constrained")
    axes = figure.subplots()
    each = [of_seeds(runs, tests, f"rooms-{rooms}") for rooms in ROOMS]
    training, unseen, released = zip(*each)
    for values, colour, mark, name in (
            (training, PALETTE["training"], "s", "the rooms that it learnt in"),
            (unseen, PALETTE["new"], "o", "random rooms that it never saw"),
            (released, PALETTE["run"], "^", "the released rooms, which it never saw either")):
        for x, seeds in enumerate(values):
            axes.plot([x] * len(seeds), seeds, color=colour, marker=mark, ms=5, ls="none",
                      alpha=0.6, mew=0)
        axes.plot([np.mean(seeds) for seeds in values], color=colour, marker=mark, ms=7,
                  label=name)
    axes.set(xticks=range(len(ROOMS)), xticklabels=[*map(str, ROOMS[:-1]), "ever new ones"],
             xlabel="rooms learnt in", ylabel="success from anywhere\nto anywhere [%]",
             ylim=(0, 103))
    axes.grid(alpha=0.3)
    axes.legend(frameon=False, loc="lower right")
    return figure


def draw_any_room(driver, rooms):
    """Paths of a policy from anywhere to anywhere, a panel for each room. Returns a Figure."""
    robots = [Assignment(scene, 0, 1) for scene in rooms for _ in range(PATHS)]
    traces = rollouts(driver, robots, "anywhere")
    figure = Figure(figsize=(WIDTH, 4.3), layout="constrained")
    panels = figure.subplots(2, 3).flat
    for axes, scene in zip(panels, rooms):
        here = [trace for trace in traces if trace.scene is scene]
        draw_room(axes, scene)
        for trace in here:
            draw_path(axes, trace, lw=0.9, alpha=0.7)
            axes.plot(*trace.start[:2], color=PALETTE["robot"], marker="o", ms=3, ls="none")
        arrived = sum(trace.arrived for trace in here)
        axes.set_title(f"{scene.name}: {arrived} of {len(here)} arrive", fontsize=9)
        axes.set(xlabel="", ylabel="", xticks=[], yticks=[])
    for axes in list(figure.axes)[len(rooms):]:
        axes.axis("off")
    figure.legend(handles=[start_handle(), *outcome_handles(traces)], loc="outside lower center",
                  ncols=4, frameon=False, fontsize=9)
    return figure


def draw_all():
    """Yields the name of each figure and the Figure."""
    released = [scenes.load(name) for name in TEST_ROOMS]
    random_rooms = [scenes.load(f"random:{k}") for k in range(RANDOM_ROOMS)]
    mixed = list(random_rooms)
    for k, scene in enumerate(released):
        mixed.insert(5 * k + k % 5, scene)  # one in each row
    yield "rooms", draw_rooms(mixed, TEST_ROOMS)
    runs = read_table(RESULTS / "level3.csv")
    if any(row["way"] == "rooms-0" for row in runs):  # as long as these are not all made
        yield "rooms-learnt", draw_rooms_learnt(runs, read_table(RESULTS / "rooms.csv"))
    driver = any_room()
    yield "any-room", draw_any_room(driver, released)
    floor = scenes.load(FILM_ROOM)
    robots = [Assignment(floor, 0, 10)] * (FLOOR_EPISODES // 10)
    yield "any-room-floor", draw_floor(floor, rollouts(driver, robots, "anywhere"), PATCH)


def any_room():
    """A driver with the policy in pretrained/any-room.pt, deterministic actions."""
    model, _ = load_run(ROOT / "pretrained" / "any-room.pt")
    return Policy(model, "mean", seed=0)


def main(argv=None):
    """The command line."""
    parser = CommandLine("Draw the figures of levels 1 and 3 into pictures/.")
    parser.parse(argv)
    parser.must_write_to(PICTURES)
    for name, figure in draw_all():
        path = PICTURES / f"{name}.png"
        figure.savefig(path, dpi=DPI)
        print(path.relative_to(ROOT), flush=True)
    scene = scenes.load(FILM_ROOM)
    trace = replace(film_episode(any_room(), scene, "anywhere", seed=1),
                    label="a room that it never saw")
    write_film(trace, PICTURES / "any-room.gif")
    print("pictures/any-room.gif")


if __name__ == "__main__":
    main()
