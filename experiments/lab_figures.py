"""The figures of the lab: `python -m experiments.lab_figures` draws them into pictures/.

What each knob does, alone and larger than in the lab; what episodes in the lab are worth; and an
episode over the map that the robot makes on its way (the paper's Fig. 8).
"""

import math
from dataclasses import replace

import numpy as np
from matplotlib.figure import Figure
from matplotlib.patches import Circle
from matplotlib.ticker import MaxNLocator

import scenes
from experiments import gallery
from experiments.lab import NO_LAB, ROOM, STARTS
from experiments.lab_tables import NAMES, collisions, stops
from experiments.markdown import percentages, select
from experiments.runs import RESULTS, ROOT
from render import Camera
from robot import ring
from robot.environment import RealVecEnv, RingVecEnv
from robot.lab import LabRobot
from robot.looks import DrawnCamera, LabCamera
from robot.mapping import OccupancyGrid
from robot.policy import TorchPolicy
from robot.robot import drive
from scenes.generate import walls
from scenes.reality import Reality
from sim import ROBOT_RADIUS, Scene
from support.pictures import PALETTE, WIDTH, draw_robot, draw_target, read_table
from support.weights import load_run

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
HEARD = {"range_noise": 0.1, "range_dropouts": 0.25}  # a knob of the ring -> its value
UNITS = {"light_change": "", "camera_yaw": " deg", "camera_pitch": " deg", "veer": " rad/m",
         "lag": " s", "dead_zone": " m/s", "blur": " px", "range_noise": " m"}


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


def heard(seed=3, **knobs):
    """What the ring of a robot with those knobs hears at POSE: (S, 2) places [m] around the robot,
    NaN where there is no reading."""
    env = RingVecEnv(1, [room_with(**knobs)])
    env.reset(seed=seed, options={"start": POSE, "target": 0})
    [readings] = ring.listen(env.world, env.range_noise, env.range_dropouts, env.np_random)
    away = ROBOT_RADIUS + readings
    return np.stack([away * np.cos(ring.ANGLES), away * np.sin(ring.ANGLES)], -1)


def draw_driven(axes, **knobs):
    """The path of an S with those knobs, beside the simulation's."""
    exact, _ = driven()
    true, believed = driven(**knobs)
    axes.plot(*exact.T, color=PALETTE["paper"], lw=3, label="simulation")
    axes.plot(*true.T, color=PALETTE["robot"], lw=1.2, label="true path")
    axes.plot(*believed.T, color=PALETTE["collision"], lw=1.2, ls="--", label="by odometry")


def draw_heard(axes, **knobs):
    """What the ring hears with those knobs, beside the simulation's."""
    for x, y in heard():
        axes.plot((0, x), (0, y), color=PALETTE["paper"], lw=1.5)
    axes.plot(*heard(**knobs).T, color=PALETTE["robot"], marker="o", ms=3, ls="none",
              label="a reading")
    axes.add_patch(Circle((0, 0), ROBOT_RADIUS, color=PALETTE["robot"], lw=0))


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
    below = list(paths.subplots(2, 5).flat)
    drawn = [(draw_driven, knob) for knob in DRIVEN.items()]
    drawn += [(draw_heard, knob) for knob in HEARD.items()]
    for axes, (draw, (name, value)) in zip(below, drawn):
        draw(axes, **{name: value})
        axes.set_title(shown(name, value), fontsize=8.5)
        axes.set(xticks=[], yticks=[], aspect="equal")
    *_, last = below
    last.axis("off")
    lines = below[0].get_lines() + below[len(DRIVEN)].get_lines()[-1:]
    last.legend(handles=lines, loc="center", frameon=False, fontsize=8.5)
    return figure


def draw_looks():
    """env2 as the simulation shows it, as the lab would, and in looks that are drawn. Returns a
    Figure."""
    scene = [scenes.load("env2")]
    cameras = {"simulation": Camera(scene), "the lab's": LabCamera(scene)}
    cameras |= {f"drawn, {seed}": DrawnCamera(scene, seed) for seed in range(8)}
    figure = Figure(figsize=(WIDTH, 3.2), layout="constrained")
    for axes, (name, camera) in zip(figure.subplots(2, 5).flat, cameras.items()):
        axes.imshow(camera.render(np.array([0]), np.array([POSE]), np.array([GOAL]))[0])
        axes.set_title(name, fontsize=9)
        axes.axis("off")
    return figure


# ----------------------------------------------------------------- what episodes there are worth


PAPER = (3000, 51.0)  # episodes, and success [%] on new targets: paper IV-C
STYLES = {  # colour, marker
    "from-scratch": (PALETTE["paper"], "s"), "from-env2": (PALETTE["training"], "o"),
    "from-any-room": (PALETTE["run"], "^"), "random-env2": (PALETTE["training"], "P"),
    "random-rooms": (PALETTE["run"], "X")}


def draw_learning(rows, curves):
    """Success on new targets, collisions and stops in the lab against the episodes that a policy
    learns there. Lines are what its last WINDOW episodes came to while it learnt, the mean of
    seeds; marks are the frozen policies, every seed. rows, curves: of lab.csv and lab-curves.csv.
    Returns a Figure."""
    figure = Figure(figsize=(WIDTH, 4.4), layout="constrained")
    measures = {  # title -> of frozen policies, and the column of curves
        "success on new targets [%]": (lambda chosen: percentages(chosen, "new_success"),
                                       "new_success"),
        "collisions in 100 episodes": (collisions, "collision"),
        "stops an episode": (stops, None)}
    panels = figure.subplots(1, 3)
    for axes, (title, (frozen, column)) in zip(panels, measures.items()):
        for way in (*STARTS, *NO_LAB):
            colour, mark = STYLES[way]
            if column and way in STARTS:
                axes.plot(*mean_curve(select(curves, way=way), column), color=colour, lw=1.6)
            axes.plot(*frozen_points(rows, way, frozen), color=colour, marker=mark, ms=6, ls="none",
                      mew=0, alpha=0.75, label=NAMES[way])
        axes.set(xlabel="episodes in the lab", title=title, ylim=(0, None),
                 xticks=(0, 1000, 2000, 3000))
        axes.title.set_fontsize(9.5)
        axes.grid(alpha=0.3)
        axes.yaxis.set_major_locator(MaxNLocator(5))
    panels[0].set(ylim=(0, 103))
    panels[0].plot(*PAPER, marker="*", ms=12, ls="none", color=PALETTE["robot"],
                   label="the paper's robot")
    handles, labels = panels[0].get_legend_handles_labels()
    figure.legend(handles, labels, loc="outside lower center", ncols=2, frameon=False, fontsize=9)
    return figure


def mean_curve(curves, column):
    """The episodes, and the mean of seeds of a column [%]. curves: rows of lab-curves.csv."""
    episodes = sorted({int(row["episodes"]) for row in curves})
    return episodes, [np.mean(percentages(select(curves, episodes=str(count)), column))
                      for count in episodes]


def frozen_points(rows, way, measure):
    """The episodes that a way's policies learnt in the lab, and what a measure gives for them; with
    the weights that they began with, at 0. rows: of lab.csv."""
    begun_with = way.removeprefix("from-")  # no weights have the name of any other way
    chosen = select(rows, way=way) + [row for row in rows if row["way"] == begun_with != way]
    return [int(row["allowed"]) for row in chosen], measure(chosen)


# -------------------------------------------------------------------------- the paper's Fig. 8


def driven_map(policy, target, seed):
    """A drive in the lab: the robot, the Drive, and the map (OccupancyGrid) that it made."""
    scene = scenes.load(ROOM)
    robot = LabRobot(scene, target, seed)
    log = drive(robot, policy, robot.goal)
    grid = OccupancyGrid(scene.bounds)
    for pose, readings in zip(log.poses, log.readings):
        grid.add(pose, readings)
    return robot, log, grid


def draw_map_of(robot, log, grid, scene):
    """The map, the true path and the one by odometry. Returns a Figure."""
    figure = Figure(figsize=(WIDTH, 5.2), layout="constrained")
    axes = figure.subplots()
    low, high = grid.bounds
    axes.imshow(1 - grid.probability.T, origin="lower", cmap="gray", vmin=0, vmax=1,
                extent=(low[0], high[0], low[1], high[1]))
    for box in scene.boxes:
        corners = box.corners
        axes.plot(*np.concatenate([corners, corners[:1]]).T, color=PALETTE["brick"], lw=1.2,
                  label="the room" if box is scene.boxes[0] else None)
    true = np.array(robot.true_poses)
    believed = np.array(log.poses)
    axes.plot(*true[:, :2].T, color=PALETTE["robot"], lw=1.8, label="true path")
    axes.plot(*believed[:, :2].T, color=PALETTE["collision"], lw=1.8, ls="--",
              label="path by odometry")
    draw_target(axes, scene, robot.goal, ring=True)
    draw_robot(axes, true[0])
    axes.set(xlim=(low[0] - 0.1, high[0] + 0.1), ylim=(low[1] - 0.1, high[1] + 0.1),
             aspect="equal", xlabel="x [m]", ylabel="y [m]")
    figure.legend(loc="outside upper center", ncols=3, frameon=False, fontsize=9)
    return figure


FILMED = {"target": 10, "seed": 3}  # the first new target; of an episode that arrives


def draw_all():
    """Yields the name of each figure and the Figure."""
    yield "reality", draw_knobs()
    yield "looks", draw_looks()
    if not (RESULTS / "lab.csv").exists():  # as long as it is not made
        return
    yield "lab", draw_learning(read_table(RESULTS / "lab.csv"),
                               read_table(RESULTS / "lab-curves.csv"))
    model, _ = load_run(ROOT / "pretrained" / "lab.pt")
    yield "lab-map", draw_map_of(*driven_map(TorchPolicy(model), **FILMED), scenes.load(ROOM))


def main(argv=None):
    """The command line."""
    gallery.read_command_line("Draw what reality does into pictures/.", argv)
    gallery.save(draw_all(), DPI)


if __name__ == "__main__":
    main()
