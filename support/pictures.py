"""Pictures of training and evaluation as matplotlib figures, which need no display. Import this
module before matplotlib, because MPLBACKEND can break its import. A matplotlibrc has no effect."""

import math
import os
import sys
from functools import partial
from importlib.util import find_spec
from pathlib import Path

kind, _, module = os.environ.get("MPLBACKEND", "").partition("://")
if kind == "module" and not find_spec(module.split(".")[0]):
    del os.environ["MPLBACKEND"]  # set by a notebook in another environment: matplotlib would fail

import matplotlib
import numpy as np
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Circle, Patch, Rectangle

from render import CUBE_SIZE
from sim import ARRIVAL_DISTANCE, ROBOT_RADIUS
from support.palette import PALETTE
from support.runs import read_table, write

if "matplotlib.pyplot" not in sys.modules:  # programs that use pyplot keep their settings
    matplotlib.rcdefaults()

WIDTH = 9.0  # [inch] of a figure, so that text is legible at 800 px
SPACING = {"env1": {"training": 200, "new": 100},  # episodes between two points of Fig. 4 and 5
           "env2": {"training": 500, "new": 100}}
WINDOW = 100  # episodes in a success rate, paper IV-B
KINDS = {  # task -> kind of episodes -> name in a picture
    "memorize": {"training": "training target"},
    "both": {"training": "training targets", "new": "new targets"},
    "anywhere": {"training": "training rooms", "new": "new rooms"}}
FEWEST = 5  # episodes in a patch of the floor, otherwise no success rate is shown

MARKERS = {"arrival": "o", "collision": "X", "timeout": "s", "standing": "D"}

# Legend entries: the robot at its start, and a patch of the floor without a colour.
START = Line2D([], [], color=PALETTE["robot"], marker="o", ms=8, ls="none", label="start")
TOO_FEW = Patch(fc="white", ec=PALETTE["robot"], label=f"white: fewer than {FEWEST} episodes")


def save(figure, path):
    """Writes a Figure as PNG. Raises OSError."""
    write(path, partial(figure.savefig, format="png", dpi=110))


def legend_below(figure, handles=(), **style):
    """Draws a legend below: the handles, then all labelled artists, each label once."""
    labelled = {handle.get_label(): handle for axes in figure.axes
                for handle in axes.get_legend_handles_labels()[0]}
    figure.legend(handles=[*handles, *labelled.values()], loc="outside lower center",
                  frameon=False, fontsize=9, **style)


def draw_room(axes, scene):
    """Draws the boxes of a scene from above, in metres."""
    for box in scene.boxes:
        axes.fill(*box.corners.T, color=PALETTE[box.material], lw=0)
    x, y = scene.bounds.T
    axes.set(xlim=x, ylim=y, aspect="equal", xlabel="x [m]", ylabel="y [m]")


def kind_of(scene, goal):
    """Returns the kind of a goal (2,) [m]: "training", "new", or "goal" for a random target."""
    if tuple(goal) in map(tuple, scene.training_targets):
        return "training"
    return "new" if tuple(goal) in map(tuple, scene.new_targets) else "goal"


def draw_target(axes, scene, goal, ring=False, **style):
    """Draws the cube at the goal (2,) [m], blue for training targets and green for new ones
    (Fig. 3). ring: draws the circle around it within which the robot arrives."""
    style = {"fc": PALETTE[kind_of(scene, goal)], "ec": "white", "lw": 0.6, "zorder": 3.6} | style
    axes.add_patch(Rectangle(np.subtract(goal, CUBE_SIZE / 2), CUBE_SIZE, CUBE_SIZE, **style))
    if ring:
        axes.add_patch(Circle(goal, ARRIVAL_DISTANCE, fill=False, ec=PALETTE["robot"], zorder=3.7))


def draw_robot(axes, pose):
    """Draws the robot's disc at a pose (3,), and its heading. Returns both artists."""
    x, y, theta = pose
    nose = x + ROBOT_RADIUS * math.cos(theta), y + ROBOT_RADIUS * math.sin(theta)
    disc = axes.add_patch(Circle((x, y), ROBOT_RADIUS, color=PALETTE["robot"], lw=0, zorder=3.2))
    return disc, *axes.plot(*zip((x, y), nose), color="white", lw=1.6, zorder=3.3)


def draw_map(axes, scene):
    """Draws the boxes and all targets of a scene from above (Fig. 3)."""
    draw_room(axes, scene)
    for target in scene.targets:
        draw_target(axes, scene, target)


def draw_path(axes, trace, **style):
    """Draws the path of a trace in the colour of its outcome, with a marker at the end."""
    colour = PALETTE[trace.outcome]
    axes.plot(*trace.poses[:, :2].T, color=colour, **style)
    axes.plot(*trace.poses[-1, :2], MARKERS[trace.outcome], color=colour, ms=3.5, zorder=3.5)


def target_handles(scene):
    """Returns legend entries for the kinds of targets of a scene."""
    kinds = dict.fromkeys(kind_of(scene, target) for target in scene.targets)
    return [Line2D([], [], color=PALETTE[kind], marker="s", ls="none", label=f"{kind} target")
            for kind in kinds]


def legend_of_paths(figure, scene, traces):
    """Draws a legend for paths, with the fraction of each outcome."""
    outcomes = [trace.outcome for trace in traces]
    ends = [Line2D([], [], color=PALETTE[outcome], marker=MARKERS[outcome], ms=5,
                   label=f"{outcome} {outcomes.count(outcome) / len(outcomes):.1%}")
            for outcome in MARKERS if outcome in outcomes]
    legend_below(figure, [START, *target_handles(scene), *ends], ncols=6)


def draw_demo(scene, traces):
    """Returns a Figure: the map with all paths, and six images of the last trace."""
    figure = Figure(figsize=(WIDTH, 6.5), layout="constrained")
    axes, camera = figure.subplots(2, height_ratios=(4, 1))
    draw_map(axes, scene)
    for trace in traces:
        draw_path(axes, trace, alpha=0.8)
    draw_target(axes, scene, trace.goal, ring=True)
    draw_robot(axes, trace.start)
    moments = np.linspace(0, len(trace.images) - 1, 6).astype(int)
    camera.imshow(np.hstack(trace.images[moments]))
    camera.set_title("camera images on the path to the circled target, from start to end")
    camera.axis("off")
    legend_of_paths(figure, scene, traces)
    return figure


def curve(rows, window):
    """Returns the points of Fig. 4 and 5, after each full window and the last episode: number of
    episodes (P,), success [%] of the last WINDOW, and mean return of the last `window` episodes."""
    ends = [*range(window, len(rows), window), len(rows)]
    arrived = [row["outcome"] == "arrival" for row in rows]
    returns = [float(row["return"]) for row in rows]
    return (ends, [100 * np.mean(arrived[end - WINDOW:end]) for end in ends],
            [np.mean(returns[end - window:end]) for end in ends])


def released_curve(env, kind):
    """Returns the paper's curve like `curve`. A mean return over a shorter window is nan."""
    rows = [row for row in read_table(Path(__file__).with_name("paper_curves.csv"))
            if (row["env"], row["targets"]) == (env, kind)]
    return ([int(row["episodes"]) for row in rows],
            [100 * float(row["success_last_100"]) for row in rows],
            [float(row["mean_return"]) if row["window"] == rows[0]["window"] else math.nan
             for row in rows])


def draw_curves(episodes, env, stop_rate, task="both"):
    """Returns a Figure like Fig. 4 and 5, with the paper's curves if they exist for task and room.
    episodes: rows of episodes.csv. stop_rate: the rate r of Algorithm 1. task: a key of KINDS."""
    kinds = KINDS[task]
    in_paper = task == "both" and env in SPACING
    figure = Figure(figsize=(WIDTH, 5.8), layout="constrained")
    panels = figure.subplots(2, len(kinds), sharey="row", sharex="col", squeeze=False)
    for column, (kind, name) in zip(panels.T, kinds.items()):
        window = SPACING[env][kind] if in_paper else WINDOW
        rows = [row for row in episodes if row["kind"] == kind]
        for k, axes in enumerate(column, 1):  # row 1: success; row 2: return
            axes.grid(alpha=0.3)
            if in_paper:
                theirs = released_curve(env, kind)
                axes.plot(theirs[0], theirs[k], color=PALETTE["paper"], lw=2,
                          label="the paper's run")
            if len(rows) >= window:
                ours = curve(rows, window)
                axes.plot(ours[0], ours[k], "o-", color=PALETTE["run"], ms=4, label="this run")
            else:
                axes.text(0.03, 0.92, f"this run: fewer than {window} episodes",
                          transform=axes.transAxes, color=PALETTE["run"])
        column[0].set_title(name, color=PALETTE[kind], weight="bold")
        column[1].set(xlabel="episodes", ylabel=f"mean return,\nlast {window} episodes")
    panels[0, 0].set(ylabel=f"success rate,\nlast {WINDOW} episodes [%]", ylim=(-3, 103))
    if "new" in kinds:
        panels[0, 1].axhline(100 * stop_rate, color=PALETTE["robot"], lw=0.9, ls="--",
                             label=f"training stops above {stop_rate:.0%}")
    figure.suptitle(env, parse_math=False)  # a $ in a name does not begin a formula
    legend_below(figure, ncols=3)
    return figure


def draw_trajectories(scene, traces, most=20):
    """Returns a Figure like Fig. 6: a panel for each target with at most `most` paths, coloured by
    outcome. Random targets, or more than 16 targets, share a panel with at most 4 `most` paths."""
    shown = scene.targets if len(scene.targets) <= 16 else []
    groups = {tuple(target): [] for target in shown} | {None: []}  # None: other goals
    for trace in traces:
        groups.get(tuple(trace.goal), groups[None]).append(trace)
    groups = {goal: group for goal, group in groups.items() if group} or {None: []}
    columns = min(len(groups), 4)
    rows = math.ceil(len(groups) / columns)
    width, height = np.ptp(scene.bounds, axis=0)
    tall = min(WIDTH / columns, 7.0) * height / width + 0.3  # [inch] of a panel
    figure = Figure(figsize=(WIDTH, rows * tall + 0.8), layout="constrained")
    panels = figure.subplots(rows, columns, squeeze=False, sharex=True, sharey=True).flat
    for axes, (goal, group) in zip(panels, groups.items()):
        draw_room(axes, scene)
        name = "random targets"
        if goal:
            draw_target(axes, scene, goal, ring=True)
            name = f"{kind_of(scene, goal)} target ({goal[0]:.1f}, {goal[1]:.1f})"
        # Evenly spaced, because the first episodes to end are short.
        drawn = min(len(group), most if goal else 4 * most)
        for k in np.linspace(0, len(group) - 1, drawn).astype(int):
            draw_path(axes, group[k], lw=0.9, alpha=0.6)
            axes.plot(*group[k].start[:2], color=PALETTE["robot"], marker="o", ms=3.5, zorder=3)
        arrived = sum(trace.arrived for trace in group)
        axes.set_title(f"{name}\n{arrived} of {len(group)} arrive", fontsize=9)
        axes.label_outer()
    for axes in panels[len(groups):]:
        axes.axis("off")
    figure.suptitle(f"{scene.name}: paths", parse_math=False)
    legend_of_paths(figure, scene, traces)
    return figure


def paint_floor(axes, scene, goals, success, patch):
    """Paints patches of the floor, `patch` [m] wide, by the mean success (n,) of their goals (n, 2)
    if at least FEWEST exist. A patch is centred on the room's corner. Returns the mesh [%]."""
    bins = [np.arange(low - patch / 2, high + patch, patch) for low, high in zip(*scene.bounds)]
    x, y = np.reshape(goals, (-1, 2)).T
    tried = np.histogram2d(x, y, bins)[0]
    arrived = np.histogram2d(x, y, bins, weights=success)[0]
    percent = np.ma.masked_where(tried < FEWEST, 100 * arrived / np.maximum(tried, 1))
    mesh = axes.pcolormesh(*bins, percent.T, cmap="viridis", vmin=0, vmax=100)
    draw_map(axes, scene)
    return mesh


def draw_floor(scene, traces, patch):
    """Returns a Figure with the success rate for targets in each patch of the floor."""
    width, height = np.ptp(scene.bounds, axis=0)
    figure = Figure(figsize=(WIDTH, 7.2 * height / width + 1.4), layout="constrained")
    mesh = paint_floor(figure.subplots(), scene, [trace.goal for trace in traces],
                       [trace.arrived for trace in traces], patch)
    figure.colorbar(mesh, label="success rate [%]", shrink=0.8)
    figure.suptitle(f"{scene.name}: success by target, {len(traces):,} episodes", parse_math=False)
    legend_below(figure, [*target_handles(scene), TOO_FEW], ncols=4)
    return figure
