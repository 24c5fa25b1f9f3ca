"""The figure of what reality does: `python -m experiments.lab_figures` draws it into pictures/.

Each knob alone, larger than in the lab.
"""

import math
from dataclasses import replace

import numpy as np
from matplotlib.figure import Figure

import scenes
from experiments import gallery
from robot.environment import RealVecEnv
from scenes.generate import walls
from scenes.reality import Reality
from sim import Scene
from support.pictures import PALETTE, WIDTH

DPI = 130
POSE = (0.5, -2.2, 3.3)  # from which the pairs of images are seen
GOAL = (-2.1, -3.0)  # where the cube stands
SEEN = {  # a knob of the camera -> its value in the picture
    "look": "lab", "exposure": 0.6, "white_balance": (1.2, 1.0, 0.75), "light_change": 0.4,
    "image_noise": 15.0, "blur": 1.5, "camera_yaw": math.radians(6),
    "camera_pitch": math.radians(-6), "image_delay": 1.0, "dropped_images": 0.6}
DRIVEN = {  # a knob of odometry, wheels or time -> its value in the picture
    "distance_drift": 0.15, "turn_drift": 0.15, "veer": 0.2, "lag": 0.8,
    "wheel_gains": (1.0, 0.93), "dead_zone": 0.21, "period_jitter": 0.3}
UNITS = {"light_change": "", "camera_yaw": " deg", "camera_pitch": " deg", "veer": " rad/m",
         "lag": " s", "dead_zone": " m/s", "blur": " px"}


def shown(name, value):
    """A knob and its value as a title."""
    if name.startswith("camera"):
        value = math.degrees(value)
    if isinstance(value, tuple):
        value = ", ".join(f"{part:g}" for part in value)
    text = value if isinstance(value, str) else f"{value:g}"
    return f"{name.replace('_', ' ')} {text}{UNITS.get(name, '')}"


def room_with(**knobs):
    """env2 with those knobs."""
    return replace(scenes.load("env2"), reality=Reality(**knobs))


def seen_after(scene, steps, seed):
    """What one robot sees at POSE after it has turned for so many steps."""
    env = RealVecEnv(1, [scene])
    env.reset(seed=seed, options={"start": POSE, "target": 0})
    env.goals[:] = GOAL
    for _ in range(steps):
        seen, *_ = env.step(np.array([[0.0, 0.5]]))
    return seen["image"][0]


def driven(seed=5, **knobs):
    """The true path of a robot with those knobs that drives an S on an empty floor, and the path by
    its odometry: (T, 2) each."""
    floor = Scene("floor", tuple(walls(9.0, 9.0)), (-2.0, 0.0, 0.0), ((4.0, 4.0),), (),
                  reality=Reality(**knobs))
    env = RealVecEnv(1, [floor], "training", max_episode_steps=-1)
    env.reset(seed=seed)
    true = []
    believed = []
    for k in range(30):
        env.step(np.array([[0.8, 0.6 * math.cos(k / 4)]]))
        true.append(env.world.poses[0, :2])
        believed.append(env.estimates[0, :2].copy())
    return np.array(true), np.array(believed)


def draw_knobs():
    """Each knob alone, against the simulation. Returns a Figure."""
    figure = Figure(figsize=(WIDTH, 7.6), layout="constrained")
    images, paths = figure.subfigures(2, 1, height_ratios=(4, 2.6))
    panels = images.subplots(4, 5).reshape(2, 2, 5)  # two blocks of plain above changed
    for k, (name, value) in enumerate(SEEN.items()):
        plain, changed = panels[k // 5, :, k % 5]
        plain.imshow(seen_after(room_with(), 3, seed=1))
        changed.imshow(seen_after(room_with(**{name: value}), 3, seed=1))
        changed.set_title(shown(name, value), fontsize=8.5)
        for axes in (plain, changed):
            axes.axis("off")
    exact, _ = driven()
    for axes, (name, value) in zip(paths.subplots(2, 4).flat, DRIVEN.items()):
        true, believed = driven(**{name: value})
        axes.plot(*exact.T, color=PALETTE["paper"], lw=3)
        axes.plot(*true.T, color=PALETTE["robot"], lw=1.2)
        axes.plot(*believed.T, color=PALETTE["collision"], lw=1.2, ls="--")
        axes.set_title(shown(name, value), fontsize=8.5)
        axes.set(xticks=[], yticks=[], aspect="equal")
    last = paths.axes[-1]
    last.axis("off")
    for style, label in ((dict(color=PALETTE["paper"], lw=3), "simulation"),
                         (dict(color=PALETTE["robot"], lw=1.2), "true path"),
                         (dict(color=PALETTE["collision"], lw=1.2, ls="--"), "by odometry")):
        last.plot([], [], label=label, **style)
    last.legend(loc="center", frameon=False, fontsize=9)
    return figure


def draw_all():
    """Yields the name of each figure and the Figure."""
    yield "reality", draw_knobs()


def main(argv=None):
    """The command line."""
    gallery.read_command_line("Draw what reality does into pictures/.", argv)
    gallery.save(draw_all(), DPI)


if __name__ == "__main__":
    main()
