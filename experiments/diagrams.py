"""The diagrams of the pages: `python -m experiments.diagrams` draws all of them into pictures/.
Numbers come from the code and from an episode. Positions on a sheet are in inches."""

import numpy as np
import torch
from matplotlib.figure import Figure
from matplotlib.patches import Arc, Circle, FancyArrowPatch, Rectangle
from matplotlib.path import Path
from torch import nn

import render
from evaluation import film_episode
from experiments.figures import main, pretrained
from model import FEATURES, HIDDEN, LAST, TARGET, make_cnn
from navbot_min import (ARRIVAL_REWARD, COLLISION_REWARD, MAX_EPISODE_STEPS, PROGRESS_REWARD,
                        STEP_COST, polar_targets)
from sim import (ARRIVAL_DISTANCE, CAMERA_HEIGHT, CONTROL_PERIOD, MAX_ANGULAR_VELOCITY,
                 MAX_LINEAR_VELOCITY, ROBOT_RADIUS)
from support.pictures import PALETTE, WIDTH, draw_robot, draw_room, draw_target
from train import SUCCESS_RATE, WINDOW, Config

INK = PALETTE["robot"]
TITLE = {"fontsize": 10, "weight": "bold"}


def sheet(height):
    """Returns an empty Figure, WIDTH x height [inch], and axes whose unit is the inch."""
    figure = Figure(figsize=(WIDTH, height))
    return figure, figure.add_axes((0, 0, 1, 1), xlim=(0, WIDTH), ylim=(0, height), frame_on=False,
                                   xticks=(), yticks=())


def note(axes, x, y, text, **style):
    """Draws text, by default small and centred."""
    axes.text(x, y, text, **{"fontsize": 9, "ha": "center", "va": "center"} | style)


def block(axes, x, y, width, height, text, kind):
    """Draws a box around (x, y) with text in it. kind: a colour of PALETTE."""
    corner = x - width / 2, y - height / 2
    axes.add_patch(Rectangle(corner, width, height, fc=PALETTE[kind], ec=INK))
    note(axes, x, y, text)


def arrow(axes, *points, style="-|>"):
    """Draws an arrow along straight lines from point to point."""
    line = Path(points)
    axes.add_patch(FancyArrowPatch(path=line, arrowstyle=style, mutation_scale=11, color=INK))


def draw_cnn(axes, image, y):
    """Draws the CNN with the shapes of its layers' outputs for an image. Returns its right end."""
    scale = 1.3 / render.W  # [inch] per pixel
    axes.imshow(image, extent=(0.25, 1.55, y - scale * render.H / 2, y + scale * render.H / 2),
                interpolation="nearest", aspect="auto", zorder=2)
    note(axes, 0.9, y + 0.8, "CNN (Fig. 2)", **TITLE)
    note(axes, 0.9, y - 0.78, f"image\n{render.W}x{render.H}, RGB")
    x = 1.55
    values = torch.zeros(1, 3, render.H, render.W)
    names = {nn.Conv2d: "conv {0.kernel_size[1]}x{0.kernel_size[0]}\nstride {0.stride[0]}",
             nn.MaxPool2d: "max-pool\n{0.kernel_size}x{0.kernel_size}",
             nn.Flatten: "flatten", nn.Linear: "dense"}
    for layer in make_cnn():
        values = layer(values)
        if isinstance(layer, nn.ReLU):
            continue
        arrow(axes, (x + 0.08, y), (x + 0.78, y))
        note(axes, x + 0.42, y + 0.08, names[type(layer)].format(layer), va="bottom")
        x += 0.86
        count, *size = values.shape[1:]
        height, width = np.multiply(size, scale) if size else (0.6, 0.11)
        words = f"{size[1]}x{size[0]}\n{count} maps" if size else f"{count}\nvalues"
        block(axes, x + width / 2, y, width, height, "", "layer")
        note(axes, x + width / 2, y - 0.78, words)
        x += width
    return x


def draw_network(image):
    """Draws Fig. 1 and 2: the network with its shapes."""
    figure, axes = sheet(5.5)
    note(axes, 1.28, 3.42, "stacked LSTM (Fig. 1)", **TITLE)
    x = draw_cnn(axes, image, y=4.5)
    for left, y, width, words, kind in (
            (0.58, 2, 0.54, "concat", "layer"), (1.65, 2, 0.9, f"LSTM\n{HIDDEN}", "memory"),
            (3.03, 2, 0.54, "concat", "layer"), (4.1, 2, 0.9, f"LSTM\n{HIDDEN}", "memory"),
            (5.55, 2, 0.9, f"dense\n{HIDDEN}", "layer"),
            (0.25, 0.85, 1.5, f"target: {TARGET}\ndistance, bearing", "input"),
            (1.95, 0.85, 1.5, f"last velocity: {LAST - 1}\nlinear, angular", "input"),
            (3.65, 0.85, 1.3, "last reward: 1", "input"),
            (7.05, 2.6, 1.8, f"linear: sigmoid, 0 to 1\nx {MAX_LINEAR_VELOCITY:g} m/s", "output"),
            (7.05, 2, 1.8, f"angular: tanh, -1 to 1\nx {MAX_ANGULAR_VELOCITY:g} rad/s", "output"),
            (7.05, 1.25, 1.8, "2 parameters\nwithout an input", "layer"),
            (7.05, 0.58, 1.8, "value: 1\nonly for training", "output")):
        block(axes, left + width / 2, y, width, 0.52, words, kind)
    for points in (
            ((x + 0.06, 4.5), (x + 0.22, 4.5), (x + 0.22, 3.22), (0.3, 3.22), (0.3, 2), (0.6, 2)),
            ((1.1, 2), (1.65, 2)), ((2.55, 2), (3.05, 2)), ((3.55, 2), (4.1, 2)),
            ((2.38, 2.26), (2.38, 2.5), (1.82, 2.5), (1.82, 2.26)),  # the memory of an LSTM
            ((4.83, 2.26), (4.83, 2.5), (4.27, 2.5), (4.27, 2.26)),
            ((0.85, 1.11), (0.85, 1.74)), ((2.7, 1.11), (2.7, 1.4), (3.22, 1.4), (3.22, 1.74)),
            ((4.3, 1.11), (4.3, 1.4), (3.38, 1.4), (3.38, 1.74)), ((5, 2), (5.55, 2)),
            ((6.45, 2), (7.05, 2)), ((6.45, 2), (6.75, 2), (6.75, 2.6), (7.05, 2.6)),
            ((6.45, 2), (6.75, 2), (6.75, 0.58), (7.05, 0.58))):
        arrow(axes, *points)
    for x, y, words in (
            (0.75, 3.08, f"{FEATURES} features"), (1.34, 2.12, FEATURES + TARGET),
            (2.77, 2.12, HIDDEN), (3.8, 2.12, HIDDEN + LAST), (2.1, 2.62, "memory"),
            (4.55, 2.62, "memory"), (7.9, 2.97, "means of the Gaussian policy"),
            (7.95, 1.6, "its standard deviations"),
            (1.92, 0.25, "yellow: inputs, with the image; green: outputs")):
        note(axes, x, y, words)
    return figure


def draw_loop():
    """Draws the data flow of Algorithm 1."""
    figure, axes = sheet(4.75)
    top, middle, low = 4.0, 2.8, 1.6
    for x, y, name, words, file, kind in (
            (1.35, top, "environment", f"$R$ = {Config.robots} robots", "navbot_min.py", "input"),
            (5.0, top, "collector", "drives the robots", "ppo.py", "layer"),
            (7.9, top, "buffer", "whole episodes", "train.py", "layer"),
            (7.9, low, "update", f"PPO, {Config.minibatches} minibatches", "ppo.py", "layer"),
            (5.0, low, "network", "policy and value", "model.py", "memory"),
            (1.35, low, "record", "every episode", "train.py", "output")):
        block(axes, x, y, 2.2 if x < 2 else 1.8, 1.1, words, kind)
        note(axes, x, y + 0.28, name, **TITLE)
        note(axes, x, y - 0.29, file, family="monospace")
    above, below = top - 0.55, low + 0.55  # ends of the blocks
    for x, y, words, *points in (
            (3.28, 4.47, "observations, rewards,\nends of episodes", (2.45, 4.25), (4.1, 4.25)),
            (3.28, 3.6, "actions", (4.1, 3.75), (2.45, 3.75)),
            (6.45, 4.23, "episodes to\ntraining targets", (5.9, top), (7.0, top)),
            (7.25, middle, f"$N$ = {Config.episodes_per_update} episodes,\nthen emptied",
             (7.9, above), (7.9, below)),
            (6.45, 1.74, "new weights", (7.0, low), (5.9, low)),
            (4.68, 2.45, "observations", (5.15, above), (5.15, below)),
            (5.87, middle, "actions,\nvalues", (5.55, below), (5.55, above)),
            (2.8, 2.58, "outcomes of all episodes; episodes\nto new targets are only recorded",
             (4.4, above), (4.4, middle), (1.35, middle), (1.35, below)),
            (3.05, 0.4, f"Training stops when more than {SUCCESS_RATE * WINDOW:.0f} of the last "
             f"{WINDOW} episodes to new targets succeed.", (1.35, low - 0.55), (1.35, 0.55))):
        note(axes, x, y, words)
        arrow(axes, *points)
    return figure


def draw_above(axes):
    """Draws a camera ray from above. Inverse depth is a linear function of its slope."""
    p, q = np.array(((1.05, 0.52), (1.75, -0.5)))  # ends of a wall, in camera axes
    hit = p + 0.69 * (q - p)
    half = render.W / 2 / render.FOCAL  # width of the view at a depth of 1 m [m]
    axes.fill((0, 2.1, 2.1), (0, 2.1 * half, -2.1 * half), color="#f2f2f2", lw=0)
    axes.add_patch(Circle((-render.CAMERA_OFFSET, 0), ROBOT_RADIUS, fc="white", ec=INK, lw=1))
    axes.plot([0, 2.1], [0, 0], color=INK, lw=0.8, ls=(0, (6, 3)))
    axes.plot(*np.transpose([p, q]), color=PALETTE["brick"], lw=5, solid_capstyle="butt")
    axes.plot(*np.transpose([(0, 0), hit]), color=INK, lw=1.4, marker="o", ms=5)
    arrow(axes, p + (0.07, 0.05), hit + (0.07, 0.05), style="<|-|>")  # off the wall
    for x, y, words in (
            (-render.CAMERA_OFFSET, ROBOT_RADIUS + 0.08, "robot"), (-0.2, -0.09, "camera"),
            (1.87, 0.08, "optical axis"), (0.95, 0.55, "$p$"), (1.85, -0.5, "$q$"),
            (1.44, 0.27, "$u$"), (1.77, -0.25, "$(z,\\ s z)$"),
            (0.8, -0.26, "ray of a column,\nslope $s$"), (0.85, 0.07, "depth $z$"),
            (1.7, 0.58, f"field of view: {2 * np.degrees(np.arctan(half)):.0f}°")):
        note(axes, x, y, words)
    axes.set(xlim=(-0.3, 2.15), ylim=(-0.66, 0.68))


def draw_aside(axes):
    """Draws the camera from the side, with the image rows of the bottom and the top of a wall."""
    eye = CAMERA_HEIGHT
    depth, top, plane = 1.2, 0.6, 0.42  # [m] of the wall, and depth of the image plane
    half = plane * render.H / 2 / render.FOCAL
    axes.plot([-0.1, 1.6], [0, 0], color=INK, lw=1)
    axes.add_patch(Rectangle((depth, 0), 0.16, top, fc=PALETTE["wood"], ec=INK, lw=0.8))
    axes.plot([0, depth], [eye, eye], "--", color=INK, lw=0.8)
    axes.plot([plane, plane], [eye - half, eye + half], color=INK, lw=2.5)
    for height in (0, top):
        axes.plot([0, depth], [eye, height], "o-", color=INK, lw=1.2, markevery=[0])
        axes.plot(plane, eye + (height - eye) * plane / depth, "o", color=INK, ms=4)
    note(axes, plane - 0.16, eye - half, f"{render.H} rows")
    for x, y, words, *ends in (
            (-0.17, eye / 2, f"{eye} m", (0, 0), (0, eye - 0.02)),
            (depth / 2, -0.13, "depth $z$", (0, -0.07), (depth, -0.07)),
            (1.62, top / 2, "height $h$", (1.44, 0), (1.44, top)),
            (plane / 2, 0.52, f"$f$ = {render.FOCAL:.1f} px", (0, 0.46), (plane, 0.46))):
        note(axes, x, y, words)
        arrow(axes, *ends, style="<|-|>")
    axes.set(xlim=(-0.3, 1.8), ylim=(-0.2, 0.75))


def draw_camera():
    """Draws the camera's geometry from above and from the side."""
    figure, page = sheet(2.8)
    for draw, left, title in (
            (draw_above, 0.01, "from above: $1/z$ and $u/z$ are linear in $s$"),
            (draw_aside, 0.51, "from the side: height $h$ is at row "
             f"${render.H // 2} + ({CAMERA_HEIGHT} - h)\\,f/z$")):
        axes = figure.add_axes((left, 0.02, 0.48, 0.84), aspect="equal")
        axes.axis("off")
        draw(axes)
        note(page, WIDTH * (left + 0.24), 2.6, title, **TITLE)
    return figure


def draw_task(trace):
    """Draws the task: a path, three images, observation, action and reward. trace: has images."""
    figure, page = sheet(6.8)
    moments = (np.array((0, 0.4, 0.85)) * len(trace.commands)).astype(int)
    axes = figure.add_axes((0.065, 0.565, 0.6, 0.395))
    draw_room(axes, trace.scene)
    axes.plot(*trace.poses[:, :2].T, color=INK, lw=1.6, alpha=0.6)
    draw_target(axes, trace.scene, trace.goal, ring=True)
    axes.set_title("path to a new target (circled), from above", **TITLE)
    for k, t in enumerate(moments):
        draw_robot(axes, trace.poses[t])
        note(axes, *trace.poses[t, :2] + (0, 0.32), k + 1, **TITLE)
        view = figure.add_axes((0.71, 0.7 - 0.3 * k, 0.27, 0.26), xticks=[], yticks=[])
        view.imshow(trace.images[t], interpolation="nearest")
        view.set_title(f"camera image at {k + 1}", pad=3, **TITLE)
    note(page, 7.6, 0.45, "The target is a blue cube\nin the camera image.")
    pose = trace.poses[moments[1]]
    (distance, bearing), = polar_targets(pose[None], trace.goal[None])
    axes.plot(*np.transpose([pose[:2], trace.goal]), color=INK, lw=1.1, ls="--")
    first, last = sorted(np.degrees((pose[2], pose[2] + bearing)))
    axes.add_patch(Arc(pose[:2], 1.1, 1.1, theta1=first, theta2=last, color=INK, lw=0.9))
    ahead = 0.7 * np.array((np.cos(pose[2]), np.sin(pose[2])))
    axes.plot(*np.transpose([pose[:2], pose[:2] + ahead]), color=INK, lw=1.1, ls="--")
    note(axes, *pose[:2] - (0.5, 0.45), "bearing")
    note(axes, *(pose[:2] + trace.goal) / 2 + (0.22, 0.12), "distance")
    draw_words(page, trace, moments[1], distance, bearing)
    return figure


def draw_words(axes, trace, t, distance, bearing):
    """Draws observation and action at step t, the reward, and the ends of an episode."""
    (last_v, last_w), (v, w) = trace.commands[t - 1:t + 1]
    for x, y, width, height, title, words, kind in (
            (1.67, 2.3, 3.1, 1.1, "observation at 2",
             f"image: {render.W}x{render.H} pixels, RGB\n"
             f"target: distance {distance:.2f} m, bearing {bearing:+.2f} rad\n"
             f"last velocity: {last_v:.2f} m/s, {last_w:+.2f} rad/s\n"
             f"last reward: {trace.rewards[t - 1]:.1f}", "input"),
            (3.94, 2.3, 0.72, 0.8, "", "policy", "memory"),
            (5.4, 2.3, 1.56, 1.1, "action",
             f"linear velocity\n{v:.2f} m/s (max. {MAX_LINEAR_VELOCITY:g})\n"
             f"angular velocity\n{w:+.2f} rad/s (max. {MAX_ANGULAR_VELOCITY:g})", "output"),
            (1.67, 0.6, 3.1, 0.86, f"reward for a step of {CONTROL_PERIOD} s",
             f"arrival: {ARRIVAL_REWARD:+g}\ncollision: {COLLISION_REWARD:+g}\n"
             f"otherwise: {PROGRESS_REWARD:g} x progress [m] - {STEP_COST:g}", "layer"),
            (4.78, 0.6, 2.8, 0.86, "end of an episode",
             f"arrival: within {ARRIVAL_DISTANCE} m of the target\n"
             "collision: with a wall or a box\n"
             f"timeout: after {MAX_EPISODE_STEPS * CONTROL_PERIOD:g} s", "layer")):
        block(axes, x, y, width, height, words, kind)
        note(axes, x, y + height / 2 + 0.17, title, **TITLE)
    arrow(axes, (3.22, 2.3), (3.58, 2.3))
    arrow(axes, (4.3, 2.3), (4.62, 2.3))


DIAGRAMS = {  # file in pictures/ -> a function that returns its Figure
    "task.png": lambda: draw_task(film_episode(*pretrained("env1"))),
    "network.png": lambda: draw_network(film_episode(*pretrained("env1")).images[-4]),
    "loop.png": draw_loop,
    "camera.png": draw_camera}


if __name__ == "__main__":
    main(pictures=DIAGRAMS, description="Draw the diagrams of the pages.")
