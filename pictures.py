"""Pictures of training and of evaluation, as matplotlib figures."""

import csv
import math
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
COLOURS = {"arrival": "#12913a", "collision": "#d62728", "timeout": "#e8a317"}
MARKERS = {"arrival": ".", "collision": "x", "timeout": "s"}


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
    with open(PAPER_CURVES, newline="") as file:
        paper = list(csv.DictReader(line for line in file if not line.startswith("#")))
    figure = Figure(figsize=(11, 7), layout="constrained")
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


def draw_trajectories(scene, episodes, most=20):
    """Fig. 6: paths over the map, coloured by outcome, at most so many to each target, or four
    times as many in all where targets are anywhere. Returns a Figure."""
    figure = Figure(figsize=(10, 5), layout="constrained")
    axes, drawn, targets = figure.subplots(), {}, set(map(tuple, scene.targets))
    draw_map(axes, scene)
    for e in episodes:
        goal = tuple(e["goal"]) if tuple(e["goal"]) in targets else "anywhere"
        drawn[goal] = drawn.get(goal, 0) + 1
        if drawn[goal] <= (4 * most if goal == "anywhere" else most):
            axes.plot(*e["path"][:, :2].T, color=COLOURS[e["outcome"]], lw=0.9, alpha=0.55)
            axes.plot(*e["path"][-1, :2], color=COLOURS[e["outcome"]], ms=4,
                      marker=MARKERS[e["outcome"]])
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


def draw_floor(scene, episodes, patch=0.25):
    """The success rate of each patch [m] of the floor as a target. Returns a Figure."""
    figure = Figure(figsize=(8, 5), layout="constrained")
    axes, (low, high) = figure.subplots(), scene.bounds
    goals = np.array([e["goal"] for e in episodes])
    edges = [np.arange(a, b + patch, patch) for a, b in zip(low, high)]
    arrived = np.array([e["outcome"] == "arrival" for e in episodes])
    tried, arrivals = (np.histogram2d(*goals.T, bins=edges, weights=weights)[0]
                       for weights in (None, arrived))
    with np.errstate(invalid="ignore"):
        mesh = axes.pcolormesh(*edges, (arrivals / tried).T, cmap="viridis", vmin=0, vmax=1)
    draw_map(axes, scene)
    figure.colorbar(mesh, label="success rate", shrink=0.8)
    axes.set_title(f"{scene.name}: success by where the target is, {len(episodes):,} episodes "
                   "from anywhere")
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
