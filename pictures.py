"""Pictures of training and of evaluation, as matplotlib figures."""

import csv
import math
from itertools import product
from pathlib import Path

import numpy as np
from matplotlib.animation import PillowWriter
from matplotlib.figure import Figure
from matplotlib.patches import Circle

from render import draw_map
from sim import CONTROL_PERIOD, ROBOT_RADIUS

SPACING = {"env1": {"training": 200, "new": 100},  # episodes between the points of Fig. 4 and 5
           "env2": {"training": 500, "new": 100}}
PAPER_CURVES = Path(__file__).parent / "paper_curves.csv"
WAY_STYLES = {"paper": ("one start pose", "#d62728"),  # of the ways to train in `results.py`
              "varied": ("starts anywhere, and mirrored", "#12913a")}
COLOURS = {"arrival": "#12913a", "collision": "#d62728", "timeout": "#e8a317"}
MARKERS = {"arrival": ".", "collision": "x", "timeout": "s"}


def read_table(path):
    """The rows of a CSV file, as dicts of text; lines from # on are comments."""
    with open(path, newline="") as file:
        return list(csv.DictReader(line for line in file if not line.startswith("#")))


def draw_demo(scene, episodes):
    """The map with every episode's path, beside frames of the last episode. episodes: poses
    (T + 1, 3), images (T + 1, H, W, 3) and the last info of each. Returns a Figure."""
    figure, images = Figure(figsize=(13, 4.6), layout="constrained"), episodes[-1][1]
    panels = figure.subplot_mosaic("m012\nm345", width_ratios=(2.6, 1, 1, 1))
    axes = panels["m"]
    draw_map(axes, scene)
    axes.add_patch(Circle(scene.start[:2], ROBOT_RADIUS, color="#333333"))
    for poses, _, info in episodes:
        axes.plot(*poses[:, :2].T, color=COLOURS[info["outcome"]], lw=2)
    axes.set_title(f"{scene.name}: paths from the start (black), red to a collision\n"
                   "training targets blue, new ones green", fontsize=11)
    for name, t in zip("012345", np.linspace(0, len(images) - 1, 6).astype(int)):
        panels[name].imshow(images[t])
        panels[name].set_title(f"last episode, {t * CONTROL_PERIOD:.1f} s", fontsize=10)
        panels[name].axis("off")
    return figure


def draw_curves(episodes, env, stop_rate):
    """Fig. 4 and 5: success rate and average reward at the paper's spacing, its own curves behind.

    episodes: the rows of episodes.csv. stop_rate: the rate r of Algorithm 1. Returns a Figure.
    """
    paper, figure = read_table(PAPER_CURVES), Figure(figsize=(11, 7), layout="constrained")
    panels = figure.subplots(2, 2, sharey="row")
    for column, (kind, colour) in enumerate((("training", "#1f4fd8"), ("new", "#12913a"))):
        theirs = [row for row in paper if (row["env"], row["targets"]) == (env, kind)]
        rows = [row for row in episodes if row["kind"] == kind]
        window = SPACING.get(env, {}).get(kind, 100)
        ends = [*range(window, len(rows), window), len(rows)] if rows else []
        arrived = [row["outcome"] == "arrival" for row in rows]
        returns = [row["return"] for row in rows]
        ours = {"success_last_100": [100 * np.mean(arrived[max(0, n - 100):n]) for n in ends],
                "mean_return": [np.mean(returns[(n - 1) // window * window:n]) for n in ends]}
        for i, (key, label, scale) in enumerate((
                ("success_last_100", "success rate, last 100 episodes [%]", 100),
                ("mean_return", "average reward of an episode", 1))):
            axes = panels[i, column]
            axes.plot([float(point["episodes"]) for point in theirs],
                      [scale * float(point[key]) for point in theirs], color="#b0b0b0",
                      label="paper (released records)" if theirs else None)
            axes.plot(ends, ours[key], color=colour, marker="o", ms=3, label="this run")
            axes.set(xlabel=f"episodes to {kind} targets", ylabel=label if column == 0 else None)
            axes.grid(alpha=0.3)
        panels[0, column].axhline(100 * stop_rate, color="black", lw=0.8, ls="--")
        panels[0, column].set(title=f"{kind} targets", ylim=(-2, 102))
        panels[0, column].legend(loc="upper left")
    figure.suptitle(f"{env}: this run, and the paper's (dashed: the rate r at which it stops)")
    return figure


def draw_memorizing_reasoning(curves, seeds):
    """Success on new targets against steps, both ways, every seed; dots: the frozen last policies.
    curves, seeds: rows of `results/curves.csv` and `results/seeds.csv`. Returns a Figure."""
    figure = Figure(figsize=(11, 4), layout="constrained")
    for axes, env in zip(figure.subplots(1, 2, sharey=True), SPACING):
        for way, (name, colour) in WAY_STYLES.items():
            for seed in "01234":
                points = [(float(row["steps"]) / 1000, 100 * float(row["success"]))
                          for row in curves if (row["env"], row["way"], row["seed"], row["kind"])
                          == (env, way, seed, "new")]
                axes.plot(*zip(*points), color=colour, lw=1.3, alpha=0.8,
                          label=name if seed == "0" else None)
            ends = [(float(row["steps"]) / 1000, 100 * float(row["new_success"])) for row in seeds
                    if (row["env"], row["way"]) == (env, way)]
            axes.plot(*zip(*ends), "o", color=colour, ms=5, clip_on=False, zorder=3)
        axes.set(title=env, xlabel="steps [thousands]", ylim=(-2, 102))
        axes.grid(alpha=0.3)
    figure.axes[0].plot([], [], "o", color="black", ms=5, label="the last policy, frozen")
    figure.axes[0].set_ylabel("new targets reached, last 100 episodes [%]")
    figure.axes[0].legend(loc="center right")
    return figure


def draw_learning(curves, env):
    """Fig. 4 (env1) or 5 (env2) over the five seeds, the paper's curves behind. curves: rows of
    `results/curves.csv`. Returns a Figure."""
    figure = Figure(figsize=(11, 7), layout="constrained")
    panels, paper = figure.subplots(2, 2, sharey="row", sharex="col"), read_table(PAPER_CURVES)
    for column, kind in enumerate(("training", "new")):
        theirs = [row for row in paper if (row["env"], row["targets"]) == (env, kind)]
        for axes, key, its, scale in zip(panels[:, column], ("success", "return"),
                                         ("success_last_100", "mean_return"), (100, 1)):
            axes.plot([float(row["episodes"]) for row in theirs],
                      [scale * float(row[its]) for row in theirs], color="#a0a0a0", lw=2,
                      label="paper (released records)")
            for way, (name, colour) in WAY_STYLES.items():
                for seed in "01234":
                    points = [(int(row["episodes"]), scale * float(row[key])) for row in curves if (
                        row["env"], row["way"], row["seed"], row["kind"]) == (env, way, seed, kind)]
                    axes.plot(*zip(*points), color=colour, lw=1, alpha=0.7,
                              label=f"ours, {name}" if seed == "0" else None)
            axes.set(xscale="log")
            axes.grid(alpha=0.3)
        panels[0, column].set(title=f"{kind} targets", ylim=(-2, 102))
        panels[1, column].set_xlabel(f"episodes to {kind} targets")
    panels[0, 0].set_ylabel("success rate, last 100 episodes [%]")
    panels[1, 0].set_ylabel("average reward of an episode")
    figure.legend(*panels[0, 0].get_legend_handles_labels(), loc="outside lower center", ncols=3)
    figure.suptitle(f"{env}: five seeds each way, and the paper's one")
    return figure


def draw_trajectories(scene, episodes, most=20):
    """Fig. 6: paths over the map, coloured by outcome, at most so many to each target, or four
    times as many in all to other goals. Returns a Figure."""
    figure = Figure(figsize=(10, 5), layout="constrained")
    axes, groups, targets = figure.subplots(), {}, set(map(tuple, scene.targets))
    draw_map(axes, scene)
    for e in episodes:
        goal = tuple(e["goal"])
        groups.setdefault(goal if goal in targets else None, []).append(e)
    for goal, group in groups.items():  # evenly among all: the first ones to end are the short ones
        count = min(len(group), most if goal else 4 * most)
        for k in np.linspace(0, len(group) - 1, count).astype(int):
            path, outcome = group[k]["path"], group[k]["outcome"]
            axes.plot(*path[:, :2].T, color=COLOURS[outcome], lw=0.9, alpha=0.55)
            axes.plot(*path[-1, :2], color=COLOURS[outcome], ms=4, marker=MARKERS[outcome])
    x, y, theta = scene.start
    axes.add_patch(Circle((x, y), ROBOT_RADIUS, fill=False, color="black", lw=1.5))
    axes.plot([x, x + ROBOT_RADIUS * math.cos(theta)], [y, y + ROBOT_RADIUS * math.sin(theta)],
              color="black", lw=1.5)
    for outcome, colour in COLOURS.items():
        share = np.mean([e["outcome"] == outcome for e in episodes])
        axes.plot([], [], color=colour, marker=MARKERS[outcome], label=f"{outcome} {share:.1%}")
    axes.set_title(f"{scene.name}: start (circle), training targets blue, new ones green")
    axes.legend(loc="upper left", bbox_to_anchor=(1, 1))
    return figure


def paint_floor(axes, scene, goals, success, patch):
    """Paints each patch of the floor, `patch` [m] wide, by the mean success (n,) of the goals
    (n, 2) in it; a patch's centre lies on a grid from the room's corner. Returns the mesh."""
    edges = [np.arange(a - patch / 2, b + patch, patch) for a, b in zip(*scene.bounds)]
    tried, arrived = (np.histogram2d(*np.transpose(goals), bins=edges, weights=weights)[0]
                      for weights in (None, success))
    with np.errstate(invalid="ignore"):
        mesh = axes.pcolormesh(*edges, 100 * (arrived / tried).T, cmap="viridis", vmin=0, vmax=100)
    draw_map(axes, scene)
    return mesh


def draw_floor(scene, episodes, patch):
    """The success rate of each patch of the floor as a target. Returns a Figure."""
    figure = Figure(figsize=(8, 5), layout="constrained")
    axes = figure.subplots()
    mesh = paint_floor(axes, scene, [e["goal"] for e in episodes],
                       [e["outcome"] == "arrival" for e in episodes], patch)
    figure.colorbar(mesh, label="success rate [%]", shrink=0.8)
    axes.set_title(f"{scene.name}: success by where the target is, {len(episodes):,} episodes")
    return figure


def draw_floors(rows, scenes, patch):
    """Where robots arrive that were trained in two ways: rows of `results/floor.csv`, all seeds.
    Returns a Figure."""
    figure = Figure(figsize=(11, 6.4), layout="constrained")
    panels = figure.subplots(2, len(scenes))
    for (i, way), (k, scene) in product(enumerate(WAY_STYLES), enumerate(scenes)):
        chosen = [row for row in rows if (row["env"], row["way"]) == (scene.name, way)]
        success = [float(row["success"]) for row in chosen]
        mesh = paint_floor(panels[i, k], scene, [(float(row["x"]), float(row["y"]))
                                                for row in chosen], success, patch)
        panels[i, k].plot(*scene.start[:2], "o", color="black", ms=9)
        panels[i, k].set(title=f"{scene.name}, {WAY_STYLES[way][0]}", xlabel=None, ylabel=None)
    figure.colorbar(mesh, ax=panels, label="episodes that arrive, five seeds [%]", shrink=0.7)
    return figure


def write_episode(scene, target, frames, path):
    """An episode as a GIF: map and camera side by side, and the velocities. frames: a pose (3,), an
    image and a velocity [m/s, rad/s] for each step."""
    figure = Figure(figsize=(9, 3.4), layout="constrained")
    left, right = figure.subplots(1, 2, width_ratios=(3, 2))
    draw_map(left, scene)
    left.plot(*target, "k+", ms=12)
    trail, = left.plot([], [], color="#1f4fd8", lw=1.5)
    robot = left.add_patch(Circle((0, 0), ROBOT_RADIUS, color="#333333"))
    nose, = left.plot([], [], color="white", lw=2)
    picture = right.imshow(frames[0][1])
    right.axis("off")
    right.set_title(" ", family="monospace", fontsize=10)
    figure.draw_without_rendering()
    figure.set_layout_engine("none")  # laid out once, not at every frame
    poses = np.array([frame[0] for frame in frames])
    writer = PillowWriter(fps=8)
    with writer.saving(figure, path, dpi=70):
        for t, ((x, y, theta), image, (v, w)) in enumerate(frames):
            trail.set_data(*poses[:t + 1, :2].T)
            robot.center = x, y
            nose.set_data([x, x + ROBOT_RADIUS * math.cos(theta)],
                          [y, y + ROBOT_RADIUS * math.sin(theta)])
            picture.set_data(image)
            right.title.set_text(f"{t * CONTROL_PERIOD:4.1f} s   {v:.2f} m/s   {w:+.2f} rad/s")
            writer.grab_frame()
