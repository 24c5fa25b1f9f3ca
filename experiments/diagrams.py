"""The drawings that explain: `python -m experiments.diagrams` draws all of them into pictures/.

Sizes and numbers are not typed in: they are read from the network, the camera, the configuration
and from episodes that a policy of pretrained/ drives.
"""

import math

import numpy as np
import torch
from matplotlib.figure import Figure
from matplotlib.patches import Arc, Circle, FancyBboxPatch, Polygon, Rectangle
from torch import nn

import render
import scenes
from evaluation import Assignment, Policy, rollouts
from experiments import gallery
from experiments.runs import ROOT
from model import Memory, Network
from navbot_min import (ARRIVAL_REWARD, COLLISION_REWARD, MAX_EPISODE_STEPS, PROGRESS_REWARD,
                        STEP_COST, NavVecEnv, polar_targets)
from ppo import pack_rows
from sim import (ARRIVAL_DISTANCE, CAMERA_HEIGHT, CONTROL_PERIOD, MAX_ANGULAR_VELOCITY,
                 MAX_LINEAR_VELOCITY, ROBOT_RADIUS)
from support.pictures import PALETTE, WIDTH, draw_robot, draw_room, draw_target
from support.weights import load_run
from support.traces import drive
from support.record import WINDOW
from train import SUCCESS_RATE, Config

DPI = 150
INK = PALETTE["robot"]
SMALL, NORMAL = 8.5, 9.5  # [pt] of letters


# ---------------------------------------------------------------------------- blocks and arrows


def sheet(height):
    """An empty sheet, WIDTH x height [inch]: a Figure and axes whose unit is the inch."""
    figure = Figure(figsize=(WIDTH, height))
    axes = figure.add_axes((0, 0, 1, 1))
    axes.set(xlim=(0, WIDTH), ylim=(0, height))
    axes.axis("off")
    return figure, axes


def block(axes, x, y, width, height, text, kind):
    """A box around (x, y) with text in it; kind: of PALETTE, what the box is."""
    axes.add_patch(FancyBboxPatch((x - width / 2, y - height / 2), width, height,
                                  boxstyle="round,pad=0,rounding_size=0.07", fc=PALETTE[kind],
                                  ec=INK, lw=1))
    axes.text(x, y, text, ha="center", va="center", fontsize=NORMAL, linespacing=1.3)


def arrow(axes, *points, style="-|>", **line):
    """An arrow along straight pieces from point to point."""
    line = {"color": INK, "lw": 1.2} | line
    if len(points) > 2:
        axes.plot(*np.transpose(points[:-1]), solid_capstyle="butt", **line)
    axes.annotate("", points[-1], points[-2], arrowprops={
        "arrowstyle": style, "shrinkA": 0, "shrinkB": 0, "mutation_scale": 11} | line)


def note(axes, x, y, text, ha="center", va="center", **style):
    """Small text on the sheet."""
    axes.text(x, y, text, ha=ha, va=va, **({"fontsize": SMALL, "linespacing": 1.25} | style))


# ----------------------------------------------------------------------------------- the network


def layer_shapes(model):
    """What the parts of a stacked Network take and give, read from the model as it runs: a list of
    (module, shape in, shape out), where a shape is that of one image or one step."""
    seen = []

    def keep(module, inputs, output):
        output = output[0] if isinstance(module, Memory) else output
        axes = 2 if inputs[0].dim() == 3 else 1  # M and T, or images
        seen.append((module, tuple(inputs[0].shape[axes:]), tuple(output.shape[axes:])))

    kinds = (nn.Conv2d, nn.MaxPool2d, nn.Flatten, nn.Linear, Memory)
    hooks = [module.register_forward_hook(keep) for module in model.modules()
             if isinstance(module, kinds)]
    observations, _ = NavVecEnv(1).reset()
    with torch.no_grad():
        model({key: torch.as_tensor(value)[:, None] for key, value in observations.items()},
              model.initial_state(1))
    for hook in hooks:
        hook.remove()
    return seen


def operation(module):
    """What a layer of the CNN does, in two lines."""
    if isinstance(module, nn.Conv2d):
        (height, width), (stride, _) = module.kernel_size, module.stride
        return f"conv {width}x{height}\nstride {stride}"
    if isinstance(module, nn.MaxPool2d):
        return f"max-pool\n{module.kernel_size}x{module.kernel_size}"
    return "flatten" if isinstance(module, nn.Flatten) else "dense"


def draw_volume(axes, x, y, shape, scale):
    """Feature maps (channels, height, width) as a stack of sheets, its front's left side at x and
    its middle at y, `scale` [inch] for a pixel. Returns where the stack ends at the right."""
    channels, height, width = shape
    sheets = channels // 8
    for k in reversed(range(sheets)):
        axes.add_patch(Rectangle((x + 0.035 * k, y - scale * height / 2 + 0.035 * k),
                                 scale * width, scale * height, fc=PALETTE["layer"], ec=INK,
                                 lw=0.6))
    return x + scale * width + 0.035 * (sheets - 1)


def draw_cnn(axes, image, layers, y):
    """The upper row of the network's drawing: from the image to its features. Returns where these
    are on the sheet."""
    scale = 1.3 / render.W  # [inch] for a pixel
    axes.imshow(image, extent=(0.25, 1.55, y - scale * render.H / 2, y + scale * render.H / 2),
                interpolation="nearest", aspect="auto", zorder=2)
    note(axes, 0.9, y - 0.78, f"image\n{render.W}x{render.H}, RGB")
    x = 1.55
    for module, _, out in layers:
        arrow(axes, (x + 0.08, y), (x + 0.78, y))
        note(axes, x + 0.42, y + 0.08, operation(module), va="bottom")
        x += 0.86
        if len(out) == 3:
            end = draw_volume(axes, x, y, out, scale)
            words = f"{out[2]}x{out[1]}\n{out[0]} maps"
        else:
            end = x + 0.11
            height = 1.1 if out[0] > 100 else 0.6
            axes.add_patch(Rectangle((x, y - height / 2), 0.11, height, fc=PALETTE["layer"], ec=INK,
                                     lw=0.8))
            words = f"{out[0]}\nvalues" if out[0] > 100 else f"{out[0]}\nfeatures"
        note(axes, (x + end) / 2, y - 0.78, words)
        x = end
    return x, y


def draw_network(image):
    """Fig. 1 and 2: the network with its shapes, read from the model. Returns a Figure."""
    layers = layer_shapes(Network())
    cnn = layers[:6]
    (_, first_in, first_out), (_, second_in, second_out) = layers[6:8]
    (_, _, dense), (_, _, actions), (_, _, values) = layers[8:]
    figure, axes = sheet(5.5)
    note(axes, 0.25, 5.3, "the eye, Fig. 2", ha="left", fontsize=10, weight="bold")
    x, y = draw_cnn(axes, image, cnn, 4.5)
    low = 2.0  # [inch] height of the lower row
    note(axes, 0.25, 3.42, "the stacked LSTM, Fig. 1", ha="left", fontsize=10, weight="bold")
    arrow(axes, (x + 0.06, y), (x + 0.22, y), (x + 0.22, 3.22), (0.3, 3.22), (0.3, low),
          (0.72, low))
    note(axes, 0.36, 3.08, f"{cnn[-1][2][0]} features", ha="left")
    for x, size in ((0.85, first_in[0]), (3.3, second_in[0])):
        block(axes, x, low, 0.26, 0.62, "", "layer")
        note(axes, x, low, "join", rotation=90)
        note(axes, x + 0.46, low + 0.07, str(size), va="bottom")
    for x, words, size in ((2.1, "LSTM", first_out[0]), (4.55, "LSTM", second_out[0]),
                           (6.0, "dense", dense[0])):
        kind = "memory" if words == "LSTM" else "layer"
        block(axes, x, low, 0.92, 0.62, f"{words}\n{size}", kind)
    for x in (2.1, 4.55):  # memory comes back a step later
        arrow(axes, (x + 0.28, low + 0.31), (x + 0.28, low + 0.55), (x - 0.28, low + 0.55),
              (x - 0.28, low + 0.31))
        note(axes, x, low + 0.58, "its memory", va="bottom")
    for left, right in ((0.98, 1.64), (2.56, 3.17), (3.43, 4.09), (5.01, 5.54)):
        arrow(axes, (left, low), (right, low))
    note(axes, 2.86, low + 0.07, str(first_out[0]), va="bottom")
    draw_inputs(axes, low, first_in[0] - cnn[-1][2][0], second_in[0] - first_out[0])
    draw_heads(axes, low, actions[0], values[0])
    return figure


def draw_inputs(axes, y, target, last):
    """What enters the network besides the image, below its lower row at y: so many values of the
    target, and so many of the last step, one of which is the reward."""
    velocity = last - 1
    block(axes, 1.0, 0.85, 1.5, 0.62, f"target: {target}\ndistance, bearing", "input")
    block(axes, 2.7, 0.85, 1.5, 0.62, f"last velocity: {velocity}\nlinear, angular", "input")
    block(axes, 4.25, 0.85, 1.3, 0.62, f"last reward: {last - velocity}", "input")
    arrow(axes, (0.85, 1.16), (0.85, y - 0.31))
    arrow(axes, (2.7, 1.16), (2.7, 1.4), (3.22, 1.4), (3.22, y - 0.31))
    arrow(axes, (4.25, 1.16), (4.25, 1.4), (3.38, 1.4), (3.38, y - 0.31))
    note(axes, 0.25, 0.25, "join: values side by side. The image, too, is an input.", ha="left")


def draw_heads(axes, y, actions, values):
    """What leaves the network: means of so many velocities, and so many values; and the standard
    deviations, which nothing enters."""
    if (actions, values) != (2, 1):
        raise ValueError(f"the drawing is of 2 means and 1 value, not of {actions} and {values}")
    middle = 7.95
    heads = ((y + 0.6, f"linear: sigmoid, 0 to 1\nof {MAX_LINEAR_VELOCITY:g} m/s"),
             (y, f"angular: tanh, -1 to 1\nof {MAX_ANGULAR_VELOCITY:g} rad/s"),
             (y - 1.42, "value head: 1\nfor training alone"))
    for height, words in heads:
        block(axes, middle, height, 1.8, 0.5, words, "output")
        arrow(axes, (6.46, y), (6.75, y), (6.75, height), (7.05, height))
    words = f"{actions} parameters of their\nown, no input"
    block(axes, middle, y - 0.75, 1.8, 0.5, words, "layer")
    note(axes, middle, y + 0.9, "velocities: means of a Gaussian", va="bottom")
    note(axes, middle, y - 0.47, "its standard deviations", va="bottom")


# -------------------------------------------------------------------------------------- the loop


def draw_loop():
    """Algorithm 1 as it runs here: which arrow carries what. Returns a Figure."""
    figure, axes = sheet(4.75)
    top, low = 4.0, 1.6
    config = Config()
    robots = f"$R$ = {config.robots} robots"
    epochs = f"PPO, $K$ = {config.epochs} epochs"
    for x, y, name, words, file, kind in (
            (1.35, top, "environment", robots, "navbot_min.py", "input"),
            (5.0, top, "collector", "the policy drives", "ppo.py", "layer"),
            (7.9, top, "buffer", "whole episodes", "train.py", "layer"),
            (7.9, low, "update", epochs, "ppo.py", "layer"),
            (5.0, low, "network", "policy and value", "model.py", "memory"),
            (1.35, low, "record", "of every episode", "train.py", "output")):
        block(axes, x, y, 2.2 if x < 2 else 1.8, 1.1, "", kind)
        note(axes, x, y + 0.28, name, fontsize=10, weight="bold")
        note(axes, x, y, words, fontsize=NORMAL)
        note(axes, x, y - 0.29, file, family="monospace")
    draw_what_is_carried(axes, top, low, config.episodes_per_update)
    note(axes, 0.25, 0.4, f"Training stops when more than {SUCCESS_RATE:.0%} of the last {WINDOW} "
         "episodes to new targets arrived.", ha="left", fontsize=NORMAL)
    return figure


def draw_what_is_carried(axes, top, low, N):
    """The loop's arrows between its upper and its lower boxes, and what each carries. N: episodes
    of an update."""
    arrow(axes, (2.45, top + 0.25), (4.1, top + 0.25))
    note(axes, 3.28, top + 0.31, "observations, rewards,\nends of episodes", va="bottom")
    arrow(axes, (4.1, top - 0.25), (2.45, top - 0.25))
    note(axes, 3.28, top - 0.31, "actions", va="top")
    arrow(axes, (5.9, top), (7.0, top))
    note(axes, 6.45, top + 0.07, "episodes to\ntraining targets", va="bottom")
    arrow(axes, (7.9, top - 0.55), (7.9, low + 0.55))
    note(axes, 7.8, (top + low) / 2, f"$N$ = {N} episodes,\n"
         "then it is emptied", ha="right")
    arrow(axes, (7.0, low), (5.9, low))
    note(axes, 6.45, low + 0.07, "new weights", va="bottom")
    arrow(axes, (5.15, top - 0.55), (5.15, low + 0.55))
    note(axes, 5.07, (top + low) / 2 - 0.35, "observations", ha="right")
    arrow(axes, (5.55, low + 0.55), (5.55, top - 0.55))
    note(axes, 5.63, (top + low) / 2, "actions,\nvalues", ha="left")
    arrow(axes, (4.4, top - 0.55), (4.4, (top + low) / 2), (1.35, (top + low) / 2),
          (1.35, low + 0.55))
    note(axes, 2.8, (top + low) / 2 - 0.07, "outcomes of all episodes; those to\nnew targets go "
         "nowhere else", va="top")
    arrow(axes, (1.35, low - 0.55), (1.35, 0.55))


# ------------------------------------------------------------------------------------ the camera


def draw_above(axes):
    """The camera's ray from above, and why inverse depth is a straight line in its slope."""
    p = np.array((1.05, 0.52))  # ends of a wall, in the camera's axes
    q = np.array((1.75, -0.5))
    slope = -0.12
    along = q - p
    z = (p[0] * q[1] - p[1] * q[0]) / (along[1] - slope * along[0])
    aside = 0.09 * np.array((-along[1], along[0])) / np.hypot(*along)  # off the wall
    half = render.W / 2 / render.FOCAL  # of the view, at a depth of 1 m
    axes.add_patch(Polygon([(0, 0), (1.1, 1.1 * half), (2.1, 1.1 * half), (2.1, -1.1 * half),
                            (1.1, -1.1 * half)], fc="#f2f2f2", ec="none"))
    axes.add_patch(Circle((-render.CAMERA_OFFSET, 0), ROBOT_RADIUS, fc="white", ec=INK, lw=1))
    axes.plot([0, 2.1], [0, 0], color=INK, lw=0.8, ls=(0, (6, 3)))
    axes.plot(*np.transpose([p, q]), color=PALETTE["brick"], lw=5, solid_capstyle="butt")
    axes.plot([0, z], [0, slope * z], color=INK, lw=1.4)
    axes.plot([z, z], [0, slope * z], color=INK, lw=0.8, ls=":")
    axes.plot([z, 0], [slope * z, 0], "o", color=INK, ms=5)
    arrow(axes, p + aside, (z, slope * z) + aside, style="<|-|>", lw=0.8)
    style = {"fontsize": NORMAL, "ha": "center", "va": "center"}
    axes.text(-render.CAMERA_OFFSET, ROBOT_RADIUS + 0.08, "robot", **style)
    axes.text(-0.05, -0.09, "eye", **(style | {"ha": "right"}))
    axes.text(2.1, 0.08, "optical axis", **(style | {"ha": "right"}))
    axes.text(*(p + (-0.1, 0.03)), "$p$", **style)
    axes.text(*((p + (z, slope * z)) / 2 + 1.9 * aside), "$u$", **style)
    axes.text(*(q + (0.1, 0.0)), "$q$", **style)
    axes.text(z + 0.09, slope * z - 0.04, "$(z,\\ s z)$", **(style | {"ha": "left", "va": "top"}))
    axes.text(0.8, -0.17, "ray of a column,\nslope $s$", **(style | {"va": "top"}))
    axes.text(0.85, 0.07, "depth $z$", **style)
    view = 2 * math.degrees(math.atan(half))
    axes.text(2.08, 0.55, f"view: {view:.0f}°", **(style | {"ha": "right"}))
    axes.set(xlim=(-0.3, 2.15), ylim=(-0.66, 0.68), aspect="equal")
    axes.axis("off")


def draw_aside(axes):
    """The camera from the side: which rows show the foot and the top of a wall. Returns the wall's
    depth and height [m]."""
    z, top, plane = 1.2, 0.6, 0.42
    axes.plot([-0.1, 1.6], [0, 0], color=INK, lw=1)
    axes.add_patch(Rectangle((z, 0), 0.16, top, fc=PALETTE["wood"], ec=INK, lw=0.8))
    axes.plot([0, z], [CAMERA_HEIGHT] * 2, color=INK, lw=0.8, ls=(0, (6, 3)))
    half = plane * render.H / 2 / render.FOCAL
    axes.plot([plane, plane], [CAMERA_HEIGHT - half, CAMERA_HEIGHT + half], color=INK, lw=2.5)
    for height in (0, top):
        axes.plot([0, z], [CAMERA_HEIGHT, height], color=INK, lw=1.2)
        axes.plot(plane, CAMERA_HEIGHT + (height - CAMERA_HEIGHT) * plane / z, "o", color=INK, ms=4)
    axes.plot(0, CAMERA_HEIGHT, "o", color=INK, ms=6)
    for first, last in (((0, 0), (0, CAMERA_HEIGHT - 0.02)), ((0, -0.07), (z, -0.07)),
                        ((z + 0.24, 0), (z + 0.24, top)),
                        ((0, CAMERA_HEIGHT + half), (plane, CAMERA_HEIGHT + half))):
        arrow(axes, first, last, style="<|-|>", lw=0.8)
    style = {"fontsize": NORMAL, "ha": "center", "va": "center"}
    axes.text(-0.03, CAMERA_HEIGHT / 2, f"{CAMERA_HEIGHT} m", **(style | {"ha": "right"}))
    axes.text(z / 2, -0.09, "depth $z$", **(style | {"va": "top"}))
    axes.text(z + 0.28, top / 2, "height $h$", **(style | {"ha": "left"}))
    axes.text(plane / 2, CAMERA_HEIGHT + half + 0.02, f"$f$ = {render.FOCAL:.1f} px",
              **(style | {"va": "bottom"}))
    axes.text(plane - 0.03, CAMERA_HEIGHT - half, f"{render.H} rows", **(style | {"ha": "right"}))
    axes.set(xlim=(-0.3, 1.8), ylim=(-0.2, 0.75), aspect="equal")
    axes.axis("off")
    return z, top


def nearest_faces(scene, pose):
    """Of each column of the image at that pose, by intersecting its ray with every box's edges:
    1/z [1/m] (W,) of the nearest, u/z [texel/m] (W,), and which (box, edge) that is, a list."""
    x, y, theta = pose
    heading = np.array((math.cos(theta), math.sin(theta)))
    left = np.array((-heading[1], heading[0]))
    eye = (x, y) + render.CAMERA_OFFSET * heading
    inverse, far_along, which = np.zeros(render.W), np.zeros(render.W), [None] * render.W
    for b, box in enumerate(scene.boxes):
        for k in range(4):
            p, q = ((corner - eye) @ np.stack([heading, left], -1)
                    for corner in (box.corners[k], box.corners[(k + 1) % 4]))
            for column, slope in enumerate(render.SLOPE):
                across = np.array((q[1] - p[1]) - slope * (q[0] - p[0]))
                if abs(across) < 1e-9:
                    continue
                along = (slope * p[0] - p[1]) / across  # 0 at p, 1 at q
                depth = p[0] + along * (q[0] - p[0])
                if 0 <= along <= 1 and depth > render.NEAR and 1 / depth > inverse[column]:
                    inverse[column] = 1 / depth
                    far_along[column] = along * np.hypot(*(q - p)) / render.TEXEL / depth
                    which[column] = (b, k)
    return inverse, far_along, which


def draw_faces(graph, scene, values, which):
    """Values of each column (W,) over the columns: a line for each face, (box, edge), of `which`.
    """
    for face in dict.fromkeys(which):
        chosen = [column for column in range(render.W) if which[column] == face]
        material = scene.boxes[face[0]].material
        graph.plot(chosen, values[chosen], color=PALETTE[material], lw=4, solid_capstyle="butt",
                   label=material)
        graph.plot(chosen, values[chosen], ".", color=INK, ms=3)
    graph.set(ylim=(0, 1.15 * values.max()), xticks=(0, 16, 32, 48, 63))
    graph.grid(alpha=0.3)


def draw_columns(picture, above, below, scene, pose):
    """A real image, and below it what is a straight line over the columns of each face."""
    far = scene.targets[0] + 1000  # [m] out of sight
    image = render.Camera([scene]).render(np.array([0]), np.array([pose]), far[None])[0]
    picture.imshow(image, extent=(-0.5, render.W - 0.5, render.H - 0.5, -0.5), aspect="auto",
                   interpolation="nearest")
    picture.set(yticks=(0, 23.5, 47), yticklabels=("0", "horizon", "47"), ylabel="row")
    picture.set_title("what the camera makes of a room (stretched sideways), and the lines of its "
                      "faces", fontsize=10, weight="bold")
    inverse, far_along, which = nearest_faces(scene, pose)
    draw_faces(above, scene, inverse, which)
    draw_faces(below, scene, far_along, which)
    above.set(ylabel="$1/z$\n[1/m]")
    below.set(ylabel="$u/z$\n[texel/m]", xlabel="column")
    handles = dict(zip(*reversed(above.get_legend_handles_labels())))
    above.legend(handles.values(), handles, frameon=False, loc="lower center", ncols=3,
                 fontsize=SMALL)
    for axes in (picture, above):
        axes.tick_params(labelbottom=False)


def draw_camera(scene, pose):
    """The camera's geometry from above and from the side, and what it makes of a real room.
    Returns a Figure."""
    figure = Figure(figsize=(WIDTH, 7.9))
    draw_above(figure.add_axes((0.01, 0.675, 0.51, 0.285)))
    z, top = draw_aside(figure.add_axes((0.53, 0.675, 0.47, 0.285)))
    for x, words in ((0.265, "from above"), (0.76, "from the side")):
        figure.text(x, 0.97, words, fontsize=10, weight="bold", ha="center")
    style = {"fontsize": NORMAL, "ha": "center", "va": "top", "linespacing": 1.5}
    figure.text(0.265, 0.665, "The wall from $p$ to $q$ is a straight line, so\n$1/z = a + b\\,s$, "
                "$\\ a = d_y / c$, $\\ b = -d_x / c$,\n$d = q - p$, $\\ c = p_x q_y - p_y q_x$.\n"
                "$u$ [texel] is how far along it: $u/z = e + f\\,s$.", **style)
    foot, over = ((CAMERA_HEIGHT - height) / z * render.FOCAL + render.H / 2 for height in (0, top))
    figure.text(0.76, 0.665, f"Foot at row ${render.H // 2} + {CAMERA_HEIGHT}\\,f/z$, "
                f"top at row ${render.H // 2} + ({CAMERA_HEIGHT} - h)\\,f/z$.\n"
                f"Here $z$ = {z} m and $h$ = {top} m: rows {foot:.1f} and {over:.1f},\n"
                "counted from the image's upper edge.", **style)
    picture = figure.add_axes((0.1, 0.34, 0.88, 0.165))
    above = figure.add_axes((0.1, 0.2, 0.88, 0.125), sharex=picture)
    below = figure.add_axes((0.1, 0.06, 0.88, 0.125), sharex=picture)
    draw_columns(picture, above, below, scene, pose)
    return figure


# ----------------------------------------------------------------------------------- the packing


def draw_rows(axes, rows, lengths, width, title):
    """A minibatch: its rows of episodes, cleared steps, padding."""
    for i, row in enumerate(rows):
        axes.barh(i, width, left=0, height=0.74, color="white", edgecolor=PALETTE["few"],
                  hatch="////", lw=0)
        left = 0
        for k in row:
            axes.barh(i, lengths[k], left=left, height=0.74, color=PALETTE["layer"], edgecolor=INK,
                      lw=0.8)
            if lengths[k] > 0.035 * width:
                axes.text(left + lengths[k] / 2, i, f"{lengths[k]}", ha="center", va="center",
                          fontsize=SMALL)
            axes.barh(i, 1, left=left + lengths[k], height=0.74, color=INK, lw=0)
            left += lengths[k] + 1
    real = sum(lengths) / (len(rows) * width)
    axes.set_title(f"{title}: {len(rows)} rows of {width} steps, {real:.0%} of them real",
                   fontsize=10)
    axes.set(ylim=(len(rows) - 0.5, -0.5), xlim=(-0.1, width + 0.1), yticks=range(len(rows)))
    axes.tick_params(left=False)
    for side in ("top", "right", "left"):
        axes.spines[side].set_visible(False)


def draw_packing(lengths):
    """Episodes of those lengths as a minibatch, padded and packed. Returns a Figure."""
    rows = pack_rows(lengths)
    padded = [[k] for k in range(len(lengths))]
    figure = Figure(figsize=(WIDTH, 1.9 + 0.27 * (len(rows) + len(padded))), layout="constrained")
    above, below = figure.subplots(2, 1, sharex=True, height_ratios=(len(padded), len(rows) + 0.5))
    width = max(lengths) + 1
    draw_rows(above, padded, lengths, width, "padded, an episode a row")
    draw_rows(below, rows, lengths, width, "packed, as here")
    below.set_xlabel("step of a row")
    above.set_ylabel("row")
    below.set_ylabel("row")
    handles = [Rectangle((0, 0), 1, 1, fc=PALETTE["layer"], ec=INK, lw=0.8,
                         label="an episode and its length"),
               Rectangle((0, 0), 1, 1, fc=INK, lw=0,
                         label="a step that clears the memory"),
               Rectangle((0, 0), 1, 1, fc="white", ec=PALETTE["few"], hatch="////", lw=0,
                         label="padding, computed for nothing")]
    figure.legend(handles=handles, loc="outside lower center", ncols=3, frameon=False, fontsize=9)
    return figure


# -------------------------------------------------------------------------------------- the task


def draw_task(trace):
    """The task in one picture: the room, a path through it, three views, what goes in and comes
    out, what is paid, when it ends. trace: has images. Returns a Figure."""
    figure, page = sheet(6.8)
    scene, T = trace.scene, len(trace.commands)
    moments = [0, int(0.4 * T), int(0.85 * T)]
    axes = figure.add_axes((0.065, 0.565, 0.6, 0.395))
    draw_room(axes, scene)
    axes.plot(*trace.poses[:, :2].T, color=INK, lw=1.6, alpha=0.6)
    draw_target(axes, scene, trace.goal, ring=True)
    draw_polar(axes, trace, moments[1])
    for name, t in zip("123", moments):
        draw_robot(axes, trace.poses[t])
        note(axes, *trace.poses[t, :2] + np.array((0, 0.32)), name, fontsize=10, weight="bold")
    axes.set_title("from above: one path to a new target (green, in the ring)", fontsize=10,
                   weight="bold")
    for k, (name, t) in enumerate(zip("123", moments)):
        view = figure.add_axes((0.71, 0.7 - 0.3 * k, 0.27, 0.26))
        view.imshow(trace.images[t], interpolation="nearest")
        view.set_title(f"the camera at {name}", fontsize=10, weight="bold", pad=3)
        view.axis("off")
    note(page, 7.6, 0.6, "to the camera every target\nis a blue cube", fontsize=NORMAL, va="top")
    draw_inputs_and_outputs(page, trace, moments[1])
    draw_pay_and_end(page)
    return figure


def draw_polar(axes, trace, t):
    """Distance and bearing of the target from the robot at step t of the trace."""
    x, y, theta = trace.poses[t]
    (distance, bearing), = polar_targets(trace.poses[t:t + 1], trace.goal[None])
    axes.plot([x, trace.goal[0]], [y, trace.goal[1]], color=INK, lw=1.1, ls="--")
    ahead = np.array((math.cos(theta), math.sin(theta)))
    axes.plot(*np.transpose([(x, y), (x, y) + 0.85 * ahead]), color=INK, lw=0.9)
    first, last = sorted((math.degrees(theta), math.degrees(theta + bearing)))
    axes.add_patch(Arc((x, y), 1.1, 1.1, theta1=first, theta2=last, color=INK, lw=0.9))
    note(axes, x - 0.5, y - 0.45, "bearing")
    note(axes, *(trace.poses[t, :2] + trace.goal) / 2 + (-0.05, 0.12), "distance", ha="left")


def draw_inputs_and_outputs(axes, trace, t):
    """The four inputs and two outputs of the policy, with their values at step t of the trace."""
    (distance, bearing), = polar_targets(trace.poses[t:t + 1], trace.goal[None])
    v, w = trace.commands[t - 1]
    lines = (f"image: {render.W}x{render.H} pixels, RGB",
             f"target: distance {distance:.2f} m, bearing {bearing:+.2f} rad",
             f"last velocity: {v:.2f} m/s, {w:+.2f} rad/s",
             f"last reward: {trace.rewards[t - 1]:.1f}")
    for k, line in enumerate(lines):
        block(axes, 1.67, 2.89 - 0.42 * k, 3.1, 0.34, line, "input")
        arrow(axes, (3.22, 2.89 - 0.42 * k), (3.58, 2.26 + 0.09 * (1.5 - k)))
    block(axes, 3.94, 2.26, 0.72, 0.8, "policy", "memory")
    v, w = trace.commands[t]
    turn = MAX_ANGULAR_VELOCITY
    for y, line in ((2.62, f"linear velocity\n{v:.2f} m/s (0 to {MAX_LINEAR_VELOCITY})"),
                    (1.9, f"angular velocity\n{w:+.2f} rad/s (-{turn:g} to {turn:g})")):
        block(axes, 5.4, y, 1.56, 0.52, line, "output")
        arrow(axes, (4.3, 2.26 + 0.15 * np.sign(y - 2.26)), (4.62, y))
    note(axes, 1.67, 3.19, "what goes in, at 2", fontsize=10, weight="bold")
    note(axes, 5.4, 3.19, "what comes out", fontsize=10, weight="bold")


def draw_pay_and_end(axes):
    """What the robot is paid for a step, and when its episode ends."""
    block(axes, 1.67, 0.6, 3.1, 0.86, f"at an arrival: {ARRIVAL_REWARD:+g}\n"
          f"at a collision: {COLLISION_REWARD:+g}\n"
          f"else: {PROGRESS_REWARD:g} per metre nearer, less {STEP_COST:g}", "layer")
    block(axes, 4.78, 0.6, 2.8, 0.86, f"arrival: within {ARRIVAL_DISTANCE} m of the target\n"
          "collision: it touches a wall or box\n"
          f"timeout: after {MAX_EPISODE_STEPS * CONTROL_PERIOD:g} s", "layer")
    note(axes, 1.67, 1.2, f"what it is paid for a step of {CONTROL_PERIOD} s", fontsize=10,
         weight="bold")
    note(axes, 4.78, 1.2, "when its episode ends", fontsize=10, weight="bold")


# --------------------------------------------------------------------------------- what is drawn


def minibatch_lengths(env, config):
    """Steps of the episodes of one minibatch as in training, to training targets and mostly from
    anywhere, of the policy in pretrained/."""
    model, rooms = load_run(ROOT / "pretrained" / f"{env}.pt")
    robots = 8
    environment = NavVecEnv(robots, rooms, "training", config.random_starts)
    quota = [config.episodes_per_update // robots] * robots
    traces = drive(Policy(model, "sampled", seed=0), environment, quota)
    shuffled = np.random.default_rng(0).permutation(len(traces))
    chosen = np.array_split(shuffled, config.minibatches)[0]
    return [len(traces[k].commands) for k in chosen]


def example(env):
    """A Trace with images of the policy in pretrained/, from the start to the last new target."""
    model, (scene,) = load_run(ROOT / "pretrained" / f"{env}.pt")
    robot = Assignment(scene, len(scene.targets) - 1, 1)
    return rollouts(Policy(model, "sampled", seed=0), [robot], images=True)[0]


def draw_all():
    """Yields the name of each drawing and its Figure."""
    trace = example("env1")
    yield "task", draw_task(trace)
    yield "network", draw_network(trace.images[-4])
    yield "loop", draw_loop()
    yield "camera", draw_camera(scenes.load("env1"), (-2.0, -3.1, 2.6))
    yield "packing", draw_packing(minibatch_lengths("env2", Config()))


def main(argv=None):
    """The command line."""
    gallery.read_command_line("Draw every drawing that explains into pictures/.", argv)
    gallery.save(draw_all(), DPI)


if __name__ == "__main__":
    main()
