"""Pictures of training and of evaluation, as matplotlib figures, and the palette of all pictures.

A picture is a `matplotlib.figure.Figure`, which needs no display. A room's name is drawn as it is,
not read as a formula where it has two `$`. One meaning has one colour in all of them: PALETTE.
"""

import csv
import math
from pathlib import Path

import numpy as np
from matplotlib.colors import ListedColormap
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Circle, Patch

from render import CUBE_SIZE
from sim import CONTROL_PERIOD, ROBOT_RADIUS

WIDTH = 9.0  # [inch] of a figure, so that its letters can be read at 800 px
SPACING = {"env1": {"training": 200, "new": 100},  # episodes between the points of Fig. 4 and 5
           "env2": {"training": 500, "new": 100}}
WINDOW = 100  # episodes that a success rate is taken over, paper IV-B
PAPER_CURVES = Path(__file__).parent / "paper_curves.csv"
KINDS = {  # of episodes, by the task: what they are called
    "memorize": {"training": "the one target"},
    "both": {"training": "training targets", "new": "new targets"},
    "anywhere": {"training": "rooms learnt in", "new": "rooms not learnt in"}}
RING = 1.05  # cube sizes, radius of the ring around the target of the episode that is shown
FEWEST = 5  # episodes to a patch of the floor that its success rate is shown from
MOST_PANELS = 16  # of `draw_trajectories`: a scene of more targets has one panel for all

# Those that meet in a picture differ for colour-blind readers too (`test_pictures.py`).
PALETTE = {
    "training": "#1f4fd8", "new": "#22b14c",  # targets, blue and green as in Fig. 3
    "arrival": "#00708a", "collision": "#d7191c", "timeout": "#e6a800",  # outcomes
    "standing": "#7a4fb5",
    "one-start": "#b35806", "varied": "#542788",  # ways to train
    "run": "#9e0f66", "paper": "#9a9a9a",  # this run, and the paper's released records
    "wall": "#d3ccc4", "brick": "#bd7f73", "wood": "#e6c08f",  # boxes, paler than the camera's
    "robot": "#222222", "goal": "#6b6b6b",  # a goal that is no target of the scene
    "cube": "#1414eb",  # what the camera shows at the target, whichever it is
    "few": "#c9c9c9",  # patches of the floor with too few episodes to tell
    "input": "#fbe9c9", "layer": "#e3e8ee", "memory": "#f3d9e3", "output": "#d8ebe6"}  # of diagrams
MARKERS = {"arrival": "o", "collision": "X", "timeout": "s", "standing": "D"}


def read_table(path):
    """The rows of a CSV file, as dicts of text; lines from # on are comments."""
    with open(path, newline="") as file:
        return list(csv.DictReader(line for line in file if not line.startswith("#")))


def draw_room(axes, scene):
    """Draws a scene's boxes from above on matplotlib axes, in metres."""
    for box in scene.boxes:
        axes.fill(*box.corners.T, color=PALETTE[box.material], lw=0)
    low, high = scene.bounds
    axes.set(xlim=(low[0], high[0]), ylim=(low[1], high[1]), aspect="equal",
             xlabel="x [m]", ylabel="y [m]")


def kind_of(scene, goal):
    """"training" or "new" where the goal (2,) is such a target of the scene, else "goal"."""
    for kind, targets in (("training", scene.training_targets), ("new", scene.new_targets)):
        if any(math.dist(goal, target) < 1e-6 for target in targets):
            return kind
    return "goal"


def draw_target(axes, scene, goal, ring=False):
    """Draws the cube at the goal (2,) [m], training targets blue, new ones green (Fig. 3); with a
    ring where it is the target of the episode that the picture is about."""
    half = CUBE_SIZE / 2
    x, y = goal
    axes.fill((x - half, x + half, x + half, x - half), (y - half, y - half, y + half, y + half),
              facecolor=PALETTE[kind_of(scene, goal)], edgecolor="white", lw=0.6, zorder=3.6)
    if ring:
        draw_ring(axes, goal)


def draw_ring(axes, goal):
    """Draws the ring that says: this is the target of the episode."""
    axes.add_patch(Circle(goal, RING * CUBE_SIZE, fill=False, color=PALETTE["robot"], lw=1.4,
                          zorder=3.7))


def draw_robot(axes, pose):
    """Draws the robot's disc at that pose (3,), and a white line that way it looks. Returns both
    artists, which `move_robot` moves."""
    disc = axes.add_patch(Circle((0, 0), ROBOT_RADIUS, color=PALETTE["robot"], lw=0, zorder=3.2))
    nose, = axes.plot([], [], color="white", lw=1.6, zorder=3.3)
    move_robot(disc, nose, pose)
    return disc, nose


def move_robot(disc, nose, pose):
    """Moves what `draw_robot` drew to another pose (3,)."""
    x, y, theta = pose
    disc.center = x, y
    ahead = x + ROBOT_RADIUS * math.cos(theta), y + ROBOT_RADIUS * math.sin(theta)
    nose.set_data([x, ahead[0]], [y, ahead[1]])


def draw_map(axes, scene):
    """Draws a scene from above on matplotlib axes: boxes, and all targets (Fig. 3)."""
    draw_room(axes, scene)
    for target in scene.targets:
        draw_target(axes, scene, target)


def draw_path(axes, trace, **style):
    """Draws where a trace led, in the colour of its outcome, with its outcome's mark at the end."""
    colour = PALETTE[trace.outcome]
    axes.plot(*trace.poses[:, :2].T, color=colour, **style)
    axes.plot(*trace.poses[-1, :2], color=colour, marker=MARKERS[trace.outcome], ms=3.5, ls="none",
              zorder=3.5)


def outcome_handle(outcome, share=""):
    """A legend's entry for an outcome."""
    return Line2D([], [], color=PALETTE[outcome], marker=MARKERS[outcome], ms=5,
                  label=f"{outcome}{share}")


def outcome_handles(traces):
    """A legend's entries for the outcomes of those traces, with their shares."""
    handles = []
    for outcome in MARKERS:
        count = sum(trace.outcome == outcome for trace in traces)
        if count > 0:
            handles.append(outcome_handle(outcome, f" {count / len(traces):.1%}"))
    return handles


def target_handle(kind):
    """A legend's entry for targets of a kind, `training` or `new`."""
    return Line2D([], [], color=PALETTE[kind], marker="s", ms=8, ls="none", label=f"{kind} target")


def target_handles(scene):
    """A legend's entries for the targets of a scene, where it has any."""
    kinds = {"training": scene.training_targets, "new": scene.new_targets}
    return [target_handle(kind) for kind, targets in kinds.items() if targets]


def start_handle(label="start"):
    """A legend's entry for the robot's disc."""
    return Line2D([], [], color=PALETTE["robot"], marker="o", ms=8, ls="none", label=label)


def draw_demo(scene, traces):
    """The map with the path of every trace, beside six frames of the last one, which has images.
    Returns a Figure."""
    figure = Figure(figsize=(WIDTH, 3.6), layout="constrained")
    panels = figure.subplot_mosaic("m123\nm456", width_ratios=(3.1, 1, 1, 1))
    last = traces[-1]
    axes = panels["m"]
    draw_map(axes, scene)
    for trace in traces:
        draw_path(axes, trace, lw=2.4 if trace is last else 1, alpha=0.8)
    draw_target(axes, scene, last.goal, ring=True)
    draw_robot(axes, last.poses[0])
    for name, t in zip("123456", np.linspace(0, len(last.images) - 1, 6).astype(int)):
        axes.text(*last.poses[t, :2], name, fontsize=7, ha="center", va="center", zorder=4,
                  bbox=dict(boxstyle="circle,pad=0.15", fc="white", ec=PALETTE["robot"]))
        panels[name].imshow(last.images[t])
        panels[name].set_title(f"{name}: {t * CONTROL_PERIOD:.1f} s", fontsize=10)
        panels[name].axis("off")
    different = len({trace.poses.tobytes() for trace in traces})
    axes.set_title(f"{scene.name}: {len(traces)} episodes, {different} different paths\n"
                   "thick: the last one; right: its camera at 1 to 6", fontsize=10,
                   parse_math=False)
    figure.legend(handles=[start_handle(), *target_handles(scene), *outcome_handles(traces)],
                  loc="outside lower center", ncols=6, frameon=False, fontsize=9)
    return figure


def window_ends(n, window):
    """At which of n episodes the points of a curve lie: after every full window, and at the end,
    where the last full one reaches back over the window before it."""
    ends = list(range(window, n + 1, window))
    if ends and ends[-1] < n:
        ends.append(n)
    return ends


def curve(rows, window):
    """The points of Fig. 4 and 5: episodes (P,), success [%] of the last 100 of them, and mean
    reward of an episode over the last `window`. No mean is over less than its full window."""
    ends = window_ends(len(rows), window)
    arrived = [row["outcome"] == "arrival" for row in rows]
    returns = [float(row["return"]) for row in rows]
    success = [100 * np.mean(arrived[end - WINDOW:end]) for end in ends]
    reward = [np.mean(returns[end - window:end]) for end in ends]
    return ends, success, reward


def released_curve(env, kind):
    """The paper's own curve to targets of that kind, as `curve` returns ours; None for a room that
    is not of the paper. Its last mean, over a shorter window than the others, is nan."""
    rows = [row for row in read_table(PAPER_CURVES)
            if row["env"] == env and row["targets"] == kind]
    if not rows:
        return None
    ends = [int(row["episodes"]) for row in rows]
    success = [100 * float(row["success_last_100"]) for row in rows]
    reward = [float(row["mean_return"]) if row["window"] == rows[0]["window"] else math.nan
              for row in rows]
    return ends, success, reward


def draw_column(column, theirs, ours, window):
    """Draws success rate and average reward to targets of a kind into a column of two panels.

    theirs: what `released_curve` returns. ours: what `curve` returns for that window.
    """
    for i, axes in enumerate(column):
        if theirs:
            axes.plot(theirs[0], theirs[i + 1], color=PALETTE["paper"], lw=2,
                      label="the paper's run, released records")
        if ours[0]:
            axes.plot(ours[0], ours[i + 1], color=PALETTE["run"], marker="o", ms=4,
                      label="this run")
        else:
            axes.text(0.03, 0.92, f"this run: under {window} episodes", va="center",
                      transform=axes.transAxes, color=PALETTE["run"])
        axes.grid(alpha=0.3)


def draw_curves(episodes, env, stop_rate, task="both"):
    """Fig. 4 and 5: success rate and average reward at the paper's spacing; at level 2 its own
    curves behind.

    episodes: the rows of episodes.csv. stop_rate: the rate r of Algorithm 1. task: of KINDS.
    Returns a Figure.
    """
    kinds = KINDS[task]
    figure = Figure(figsize=(WIDTH, 5.8), layout="constrained")
    panels = figure.subplots(2, len(kinds), sharey="row", sharex="col", squeeze=False)
    for column, (kind, name) in zip(panels.T, kinds.items()):
        window = SPACING.get(env, {}).get(kind, WINDOW) if task == "both" else WINDOW
        ours = curve([row for row in episodes if row["kind"] == kind], window)
        theirs = released_curve(env, kind) if task == "both" else None
        draw_column(column, theirs, ours, window)
        column[0].set_title(name, color=PALETTE[kind], weight="bold")
        column[1].set(xlabel=f"episodes, {name}",
                      ylabel=f"average reward of an episode,\nlast {window} episodes")
    panels[0, 0].set(ylabel=f"success rate,\nlast {WINDOW} episodes [%]", ylim=(-3, 103))
    if "new" in kinds:
        panels[0, 1].axhline(100 * stop_rate, color=PALETTE["robot"], lw=0.9, ls="--",
                             label=f"training stops above {stop_rate:.0%}")
    figure.suptitle(env, parse_math=False)
    handles = {}  # by label: each once, whichever panel it is in
    for axes in panels.flat:
        handles |= {handle.get_label(): handle for handle in axes.get_legend_handles_labels()[0]}
    figure.legend(handles=list(handles.values()), loc="outside lower center", ncols=3,
                  frameon=False)
    return figure


def by_target(scene, traces):
    """Groups of traces to draw together, (goal, traces): those to each target of the scene that
    there are any to, in its order, and all others, whose goal is None, last."""
    groups = {}
    if len(scene.targets) <= MOST_PANELS:
        groups = {tuple(target): [] for target in scene.targets.tolist()}
    others = []
    for trace in traces:
        groups.get(tuple(trace.goal), others).append(trace)
    chosen = [(goal, group) for goal, group in groups.items() if group]
    if others or not chosen:
        chosen.append((None, others))
    return chosen


def draw_group(axes, scene, goal, group, most):
    """Draws one panel of `draw_trajectories`: at most so many of the group's paths, evenly among
    all, for the first ones to end are the short ones."""
    draw_room(axes, scene)
    shown = [group[k] for k in np.linspace(0, len(group) - 1, min(len(group), most)).astype(int)]
    for trace in shown:
        draw_path(axes, trace, lw=0.9, alpha=0.6)
    starts = {tuple(trace.poses[0]) for trace in group}
    if len(starts) == 1:
        draw_robot(axes, starts.pop())
    else:
        for trace in shown:
            axes.plot(*trace.poses[0, :2], color=PALETTE["robot"], marker="o", ms=3.5, ls="none",
                      zorder=3)
    arrived = sum(trace.outcome == "arrival" for trace in group)
    name = "goals anywhere"
    if goal is not None:
        draw_target(axes, scene, goal, ring=True)
        name = f"{kind_of(scene, goal)} target ({goal[0]:.1f}, {goal[1]:.1f})"
    axes.set_title(f"{name}\n{arrived} of {len(group)} arrive", fontsize=9)
    axes.label_outer()


def draw_trajectories(scene, traces, most=20):
    """Fig. 6: a panel for each target with the paths to it over the map, coloured by outcome, at
    most so many; goals anywhere share one, of four times as many. Returns a Figure."""
    groups = by_target(scene, traces)
    columns = min(len(groups), 4)
    rows = math.ceil(len(groups) / columns)
    width, height = np.ptp(scene.bounds, axis=0)
    panel = min(WIDTH / columns, 7.0)  # [inch]
    figure = Figure(figsize=(WIDTH, rows * (panel * height / width + 0.3) + 0.8),
                    layout="constrained")
    panels = figure.subplots(rows, columns, squeeze=False, sharex=True, sharey=True)
    for axes, (goal, group) in zip(panels.flat, groups):
        draw_group(axes, scene, goal, group, most if goal is not None else 4 * most)
    for axes in panels.flat[len(groups):]:
        axes.axis("off")
    figure.suptitle(f"{scene.name}: where the robot drove", parse_math=False)
    shown = {kind_of(scene, goal) for goal, _ in groups if goal is not None}
    targets = [target_handle(kind) for kind in ("training", "new") if kind in shown]
    figure.legend(handles=[start_handle(), *targets, *outcome_handles(traces)],
                  loc="outside lower center", ncols=6, frameon=False, fontsize=9)
    return figure


def paint_floor(axes, scene, goals, success, patch):
    """Paints each patch of the floor, `patch` [m] wide, by the mean success (n,) of the goals
    (n, 2) in it, grey where there are fewer than FEWEST; a patch's centre lies on a grid from the
    room's corner. Returns the mesh, in percent, and whether any patch is grey."""
    x, y = [np.arange(low - patch / 2, high + patch, patch) for low, high in zip(*scene.bounds)]
    goals = np.asarray(goals, dtype=float).reshape(-1, 2)
    tried = np.histogram2d(*goals.T, bins=(x, y))[0]
    arrived = np.histogram2d(*goals.T, bins=(x, y), weights=success)[0]
    percent = np.where(tried >= FEWEST, 100 * arrived / np.maximum(tried, 1), np.nan)
    few = np.where((tried > 0) & (tried < FEWEST), 1.0, np.nan)
    axes.pcolor(x, y, np.ma.masked_invalid(few.T), cmap=ListedColormap([PALETTE["few"]]),
                hatch="////", edgecolor="white", lw=0)
    mesh = axes.pcolormesh(x, y, percent.T, cmap="viridis", vmin=0, vmax=100)
    draw_map(axes, scene)
    return mesh, bool(np.nansum(few))


def floor_handles(scene, grey):
    """A legend's entries for a painted floor. grey: whether any of its patches is."""
    handles = target_handles(scene)
    if grey:
        handles.append(Patch(facecolor=PALETTE["few"], hatch="////", edgecolor="white", lw=0,
                             label=f"under {FEWEST} episodes: too few to tell"))
    return [*handles, Patch(facecolor="white", edgecolor=PALETTE["robot"], lw=0.6,
                            label="not tried")]


def draw_floor(scene, traces, patch):
    """The success rate of each patch of the floor as a target. Returns a Figure."""
    width, height = np.ptp(scene.bounds, axis=0)
    figure = Figure(figsize=(WIDTH, 7.2 * height / width + 1.4), layout="constrained")
    axes = figure.subplots()
    mesh, grey = paint_floor(axes, scene, [trace.goal for trace in traces],
                             [trace.outcome == "arrival" for trace in traces], patch)
    figure.colorbar(mesh, label="success rate [%]", shrink=0.8)
    figure.suptitle(f"{scene.name}: success by where the target is, {len(traces):,} episodes",
                    parse_math=False)
    figure.legend(handles=floor_handles(scene, grey), loc="outside lower center", ncols=4,
                  frameon=False)
    return figure
