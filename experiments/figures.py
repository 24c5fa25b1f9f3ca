"""The figures of the results: `python -m experiments.figures` draws all of them into pictures/.
Tables are read by `experiments.tables.read`. Paths are new episodes of policies in pretrained/."""

from dataclasses import replace
from functools import partial

import numpy as np
import pandas as pd
from matplotlib.figure import Figure

import scenes
from evaluation import PATCH, Assignment, Policy, film_episode, rollouts
from evaluation.measures import wilson
from experiments.runs import TEST_ROOMS
from experiments.tables import LAB, ROOMS_LEARNT, ROOT, read
from render import Camera
from robot.environment import RealVecEnv
from robot.lab import LabRobot
from robot.appearance import DrawnCamera, LabCamera
from robot.mapping import OccupancyGrid
from robot.mujoco_robot import MujocoCamera, MujocoVecEnv
from robot.policy import TorchPolicy
from robot.robot import drive
from scenes.generate import share_blocked, walls
from scenes.reality import parse_reality
from sim import Scene, flood
from support.cli import option, parse
from support.film import write_film
from support.pictures import (PALETTE, SPACING, START, TOO_FEW, WIDTH, WINDOW, draw_path,
                              draw_robot, draw_room, draw_target, draw_trajectories, legend_below,
                              paint_floor, released_curve, target_handles)
from support.rooms import validation_scenes
from support.runs import RunError
from support.weights import load_model

ENVS = ("env1", "env2")
WAYS = {"one-start": "one start pose", "varied": "random starts, mirrored room"}  # way: label
SIX = ("#0072b2", "#d55e00", "#009e73", "#cc79a7", "#e69f00", "#000000")  # by Okabe and Ito


def page(height, rows=1, columns=1, **options):
    """Returns an empty Figure, WIDTH x height [inch], and its panels. options: for `subplots`."""
    figure = Figure(figsize=(WIDTH, height), layout="constrained")
    return figure, figure.subplots(rows, columns, **options)


def pretrained(name, actions="sampled"):
    """Returns a driver with a policy of pretrained/, and the first scene that it trained in."""
    model, rooms = load_model(ROOT / "pretrained" / f"{name}.safetensors")
    return Policy(model, actions, seed=0), rooms[0]


def draw_images(panels, images):
    """Shows one camera image in each panel. images: title -> (H, W, 3)."""
    for axes, (title, image) in zip(panels, images.items()):
        axes.imshow(image)
        axes.set_title(title, fontsize=10)
        axes.axis("off")


def draw_memorizing_reasoning(curves, seeds):
    """Draws success on new targets against steps, next to that of the frozen final policies."""
    figure, panels = page(4.1, 1, 2, sharey=True)
    for axes, env in zip(panels, ENVS):
        budget = seeds[seeds.env == env].steps.max() / 1000
        for place, mark, (way, name) in zip((1.03, 1.07), "so", WAYS.items()):
            ours = curves.query("env == @env and way == @way and kind == 'new'")
            for _, run in ours.groupby("seed"):
                axes.plot(run.steps / 1000, run.success, lw=1.2, alpha=0.8,
                          color=PALETTE[way], label=f"{name}: during training")
            frozen = seeds.query("env == @env and way == @way").new_success
            axes.plot([place * budget] * len(frozen), frozen, mark, ms=6.5, mfc="none",
                      color=PALETTE[way], label=f"{name}: final policies, frozen")
        axes.set(title=env, xlabel="steps [thousands]", xlim=(0, 1.1 * budget), ylim=(-3, 103))
        axes.grid(alpha=0.3)
    panels[0].set_ylabel(f"success rate on new targets,\nlast {WINDOW} episodes [%]")
    legend_below(figure, ncols=2, title="five seeds each")
    return figure


def draw_learning(curves, env):
    """Draws Fig. 4 (env1) or 5 (env2): median and range of the seeds, and the paper's curves."""
    figure, panels = page(5.8, 2, 2, sharey="row", sharex="col")
    for column, kind in zip(panels.T, ("training", "new")):
        ours = curves.query("env == @env and kind == @kind")
        episodes, *theirs = released_curve(env, kind)
        for axes, key, values in zip(column, ("success", "return"), theirs):
            axes.semilogx(episodes, values, color=PALETTE["paper"], label="the paper's run")
            for way, runs in ours.groupby("way"):
                seeds = runs.pivot(index="episodes", columns="seed", values=key).dropna()
                axes.plot(seeds.median(axis=1), color=PALETTE[way], label=WAYS[way])
                axes.fill_between(seeds.index, seeds.min(axis=1), seeds.max(axis=1), lw=0,
                                  alpha=0.25, color=PALETTE[way])
            axes.grid(alpha=0.3)
        column[0].set_title(f"{env}, {kind} targets", color=PALETTE[kind], weight="bold")
        column[1].set(xlabel=f"episodes to {kind} targets (log scale)",
                      ylabel=f"mean return, last {WINDOW}\n(paper: {SPACING[env][kind]}) episodes")
    panels[0, 0].set(ylabel=f"success rate,\nlast {WINDOW} episodes [%]", ylim=(-3, 103))
    legend_below(figure, ncols=3, title="line: median of five seeds; band: their range")
    return figure


def draw_floors(floor, rooms):
    """Draws the success rate, from the start pose, for targets in each patch of the floor."""
    figure, panels = page(6, len(WAYS), len(rooms), squeeze=False)
    for row, (way, name) in zip(panels, WAYS.items()):
        for axes, scene in zip(row, rooms):
            spots = floor.query("env == @scene.name and way == @way")
            each = spots.loc[spots.index.repeat(spots.n)]  # each episode has the same weight
            mesh = paint_floor(axes, scene, each[["x", "y"]].to_numpy(), each.success / 100, PATCH)
            draw_robot(axes, scene.start)
            axes.set_title(f"{scene.name}: {name}", fontsize=10)
    figure.colorbar(mesh, ax=panels, shrink=0.7, label="success rate, all seeds [%]")
    legend_below(figure, [START, *target_handles(rooms[0]), TOO_FEW], ncols=5)
    return figure


def draw_hidden():
    """Draws eight paths to the last new target with its place, its cube or nothing hidden."""
    figure, panels = page(4.5, len(ENVS), 3)
    for row, env in zip(panels, ENVS):
        driver, scene = pretrained(env)
        last = len(scene.targets) - 1
        for axes, hidden in zip(row, ("", "place", "cube")):
            traces = rollouts(driver, [Assignment(scene, last, 1)] * 8, hidden=hidden)
            arrived = sum(trace.arrived for trace in traces)
            draw_room(axes, scene)
            axes.set(xlabel=f"{env}, {hidden or 'nothing'} hidden: {arrived} of 8 arrive",
                     ylabel="", xticks=[], yticks=[])
            for trace in traces:
                draw_path(axes, trace, alpha=0.7, lw=1.2, label=trace.outcome)
            draw_robot(axes, scene.start)
            draw_target(axes, scene, traces[0].goal, ring=True)
    legend_below(figure, [START, target_handles(scene)[-1]], ncols=4)
    return figure


def draw_fig6(env):
    """Draws 20 paths of a policy from the start pose to each target."""
    driver, scene = pretrained(env)
    robots = [Assignment(scene, k, 1) for k in range(len(scene.targets)) for _ in range(20)]
    return draw_trajectories(scene, rollouts(driver, robots))


def draw_rooms():
    """Draws rooms from above, the test rooms in frames, with the fraction of blocked paths."""
    figure, panels = page(6.75, 5, 5)
    figure.suptitle("test rooms (framed) and random rooms: fraction of straight paths blocked")
    for axes, name in zip(panels.flat, (*TEST_ROOMS, *(f"random:{k}" for k in range(20)))):
        scene = scenes.load(name)
        draw_room(axes, scene)
        axes.set(xlabel=f"{name}: {share_blocked(scene):.0%}", ylabel="", xticks=[], yticks=[])
        axes.spines[:].set(lw=2.5 if name in TEST_ROOMS else 0, color=PALETTE["run"])
    return figure


def draw_rooms_learnt(level3, rooms):
    """Draws success with random starts and targets against the number of training rooms."""
    in_tests = rooms[rooms.targets == "anywhere"].groupby(["way", "seed"]).success.mean()
    runs = level3[level3.way.isin(ROOMS_LEARNT)].join(in_tests, on=["way", "seed"])
    runs["place"] = runs.way.map(list(ROOMS_LEARNT).index)
    means = runs.groupby("place").mean(numeric_only=True)
    figure, axes = page(4.4)
    for column, colour, mark, name in (
            ("training_success", "training", "s", "training rooms"),
            ("success", "run", "^", "test rooms"),
            ("validation_success", "new", "o", "validation rooms")):
        axes.plot(runs.place, runs[column], mark, color=PALETTE[colour], ms=4)
        axes.plot(means[column], mark + "-", color=PALETTE[colour], ms=7, label=name)
    new, known = means.validation_success.round(), means.training_success.round()
    axes.set_title(f"1 to 16 rooms: success in new rooms rises from {new[0]:g} to {new[2]:g} %,\n"
                   f"but success in the training rooms falls from {known[0]:g} to {known[2]:g} %")
    axes.set(xticks=range(len(ROOMS_LEARNT)), xticklabels=ROOMS_LEARNT.values(), ylim=(0, 103),
             xlabel="number of training rooms",
             ylabel="success rate with random\nstart and target [%]")
    axes.grid(alpha=0.3)
    legend_below(figure, ncols=3)
    return figure


def draw_any_room():
    """Draws six paths from random starts to random targets in each of four test rooms."""
    figure, panels = page(6, 2, 2)
    driver, _ = pretrained("any-room", "mean")
    for axes, scene in zip(panels.flat, map(scenes.load, TEST_ROOMS[1:])):
        here = rollouts(driver, [Assignment(scene, 0, 1)] * len(SIX), "anywhere")
        draw_room(axes, scene)
        for trace, colour in zip(here, SIX):
            draw_target(axes, scene, trace.goal, fc=colour)
            axes.plot(*trace.poses[:, :2].T, color=colour, lw=2)
            axes.plot(*trace.start[:2], "o", color=colour, ms=8)
            if not trace.arrived:
                axes.plot(*trace.poses[-1, :2], "X", color=colour, ms=10, mec="white")
        arrived = sum(trace.arrived for trace in here)
        axes.set(title=f"{scene.name}: {arrived} of {len(here)} arrive",
                 xlabel="", ylabel="", xticks=[], yticks=[])
    for mark, name in (("o", "start"), ("s", "target"), ("X", "failure")):
        axes.plot([], [], mark, color=PALETTE["robot"], label=name)
    legend_below(figure, ncols=3, title="one colour for each episode")
    return figure


# [m] -> lower bounds of classes of widths. Random rooms have no passage below 0.42 m.
PASSAGES = {0.8: "80 or more", 0.6: "60 to 80", 0.5: "50 to 60", 0.0: "42 to 50"}


def passage(trace):
    """Returns the class of the narrowest passage on the widest way of an episode, a key of
    PASSAGES."""
    x, y = [np.arange(low, high, 0.025) for low, high in zip(*trace.scene.bounds)]
    grid = np.stack(np.meshgrid(x, y, indexing="ij"), -1)
    clearance = trace.scene.clearance(grid)
    # A robot may start and arrive close to a wall: that is not a passage.
    start, goal = [np.hypot(*(grid - place).transpose(2, 0, 1)) < 0.3
                   for place in (trace.start[:2], trace.goal)]
    return next(width for width in PASSAGES
                if not width or (flood(clearance > width / 2, start) & goal).any())


def draw_level3_curves(curves, unlimited, runs, earlier):
    """Draws success in the validation rooms against steps: during training, with a noise limit and
    without, and of frozen policies, with today's learner and an earlier one."""
    figure, (left, right) = page(3.8, 1, 2, sharey=True)
    for _, run in curves.groupby("seed"):
        left.plot(run.steps / 1e6, run.validation_success, color=PALETTE["varied"], lw=1.6)
    left.plot(unlimited.steps / 1e6, unlimited.validation_success, "--", color=PALETTE["arrival"],
              lw=2.2, label="without a limit on action noise, one seed")
    for rows, colour, mark, label in ((earlier, "one-start", "s", "an earlier learner"),
                                      (runs, "varied", "o", "today's learner")):
        rows = rows[rows.way.isin(["any-room", "rooms-0"])]
        means = rows.groupby("steps").validation_success.mean()
        right.semilogx(rows.steps, rows.validation_success, mark, color=PALETTE[colour], mfc="none")
        right.plot(means, mark + "-", color=PALETTE[colour], label=label)
    left.set(title="during training, sampled actions", ylim=(0, 103), ylabel="success rate in\n"
             "validation rooms [%]", xlabel="million steps, summed over robots")
    right.set(title="frozen policies, deterministic actions", xlabel="million steps (log scale)")
    right.set_xticks([5e5, 1e6, 2e6, 4e6, 8e6, 2e7], ["0.5", "1", "2", "4", "8", "20"])
    right.minorticks_off()
    for axes in (left, right):
        axes.grid(alpha=0.3)
    legend_below(figure, ncols=3, title="filled markers: means of three seeds")
    return figure


def draw_touches():
    """Draws where the any-room policy collides in two rooms, and its success in the validation
    rooms by the width of the narrowest passage."""
    driver, _ = pretrained("any-room", "mean")
    figure, panels = page(3.2, 1, 3)
    for axes, name in zip(panels, ("maze0", "maze4")):
        scene = scenes.load(name)
        traces = rollouts(driver, [Assignment(scene, 0, 10)] * 50, "anywhere")
        touches = np.array([trace.poses[-1] for trace in traces if trace.outcome == "collision"])
        draw_room(axes, replace(scene, training_targets=(), new_targets=()))
        axes.plot(*touches[:, :2].T, "o", ms=5, alpha=0.5, mew=0, color=PALETTE["collision"])
        axes.set_title(f"{name}: the robot's centre at\n{len(touches)} collisions, "
                       f"{len(traces)} episodes", fontsize=10)
    robots = [Assignment(scene, 0, 60) for scene in validation_scenes()]
    traces = rollouts(driver, robots, "anywhere")
    groups = pd.Series([trace.arrived for trace in traces]).groupby(list(map(passage, traces)))
    for k, (_, arrived) in enumerate(groups):  # from narrow to wide
        success = 100 * arrived.mean()
        low, high = wilson(arrived.sum(), len(arrived))
        panels[2].plot([k, k], [100 * low, 100 * high], color=PALETTE["robot"])
        panels[2].plot(k, success, "o", color=PALETTE["robot"])
        panels[2].text(k, 100 * low - 5, f"{success:.0f} %\nof {len(arrived)}", ha="center",
                       va="top", fontsize=9)
    panels[2].set(xlim=(-0.5, 3.5), ylim=(0, 103), ylabel="success rate [%]",
                  xlabel="narrowest passage [cm]")
    panels[2].set_xticks(range(4), [*PASSAGES.values()][::-1], fontsize=8)
    panels[2].set_title("validation rooms, 95 % intervals", fontsize=10)
    panels[2].grid(alpha=0.3)
    return figure


POSE = (0.5, -2.2, 3.3)  # in env2, where the images are taken
SEEN = {"appearance": "lab", "exposure": 0.6, "white_balance": (1.2, 1, 0.75),
        "camera_yaw_degrees": 6, "camera_pitch_degrees": -6, "image_delay": 1}  # exaggerated
DRIVEN = {"distance_drift": 0.15, "turn_drift": 0.15, "wheel_gains": (1, 0.93)}


def driven(scene, start, seed, commands, **errors):
    """Returns a robot's last image, its true path (T, 2) and its path by odometry (T, 2)."""
    scene = replace(scene, reality=parse_reality(errors, True))
    env = RealVecEnv(1, [scene], max_episode_steps=-1)
    env.reset(seed=seed, options={"start": start, "target": 0})
    places = []
    for command in commands:
        seen, *_ = env.step(np.array([command]))
        places.append((env.world.poses[0, :2], env.estimates[0, :2].copy()))
    return seen["image"][0], *np.swapaxes(places, 0, 1)


def draw_reality():
    """Draws each error of the lab separately: camera images and S-shaped paths."""
    figure, panels = page(4.2, 2, 5)
    turn = partial(driven, scenes.load("env2"), POSE, 1, [(0.0, 0.5)] * 3)
    images = {f"{error}\n{size}": turn(**{error: size})[0] for error, size in SEEN.items()}
    draw_images(panels.flat, {"no error\n": turn()[0]} | images)
    floor = Scene("floor", tuple(walls(9.0, 9.0)), (-2.0, 0.0, 0.0), ((4.0, 4.0),), ())
    s_shape = [(0.8, 0.6 * np.cos(k / 4)) for k in range(30)]
    drive_s = partial(driven, floor, floor.start, 5, s_shape)
    for axes, (error, size) in zip(panels.flat[-len(DRIVEN):], DRIVEN.items()):
        _, true, by_odometry = drive_s(**{error: size})
        axes.plot(*drive_s()[1].T, color=PALETTE["paper"], lw=4, label="path without errors")
        axes.plot(*true.T, color=PALETTE["robot"], lw=2, label="true path")
        axes.plot(*by_odometry.T, "--", color=PALETTE["collision"], lw=2, label="path by odometry")
        axes.set(xlim=(-2.3, 0.7), ylim=(-0.9, 1.35), aspect="equal", xticks=[], yticks=[])
        axes.set_title(f"{error}\n{size}", fontsize=10)
    legend_below(figure, ncols=3, title="panels with paths are 3 m wide")
    return figure


def draw_appearances():
    """Draws env2 with the textures of the simulation, of the lab, and of eight random seeds."""
    figure, panels = page(3.2, 2, 5)
    scene = [scenes.load("env2")]
    cameras = {"simulation": Camera(scene), "lab": LabCamera(scene),
               **{f"random, seed {seed}": DrawnCamera(scene, seed) for seed in range(8)}}
    view = np.array([0]), np.array([POSE]), np.array([scene[0].targets[0]])
    draw_images(panels.flat, {name: camera.render(*view)[0] for name, camera in cameras.items()})
    return figure


VIEWS = {  # room -> a pose and the place of the cube, at which the images are taken
    "env1": ((-1.6, -3.46, 2.86), (-3.4, -3.1)), "env2": (POSE, (-0.3, -2.35)),
    "maze0": ((-1.35, -1.95, -2.7), (-2.65, -2.0)), "maze4": ((-2.4, -1.8, -1.6), (-2.5, -3.65))}


def draw_mujoco():
    """Draws pairs of images: the same pose in our simulation and in MuJoCo."""
    figure, panels = page(3.4, 2, len(VIEWS))
    for column, (name, (pose, cube)) in zip(panels.T, VIEWS.items()):
        scene = [scenes.load(name)]
        view = np.array([0]), np.array([pose]), np.array([cube])
        draw_images(column, {f"{name}, ours": Camera(scene).render(*view)[0],
                             f"{name}, MuJoCo": MujocoCamera(scene).render(*view)[0]})
    return figure


def film_mujoco():
    """Returns an episode of the any-room policy in MuJoCo, the one of any-room.gif."""
    trace = film_episode(pretrained("any-room", "mean")[0], scenes.load("maze4"), "anywhere",
                         seed=6, environment=MujocoVecEnv)
    return replace(trace, label="in MuJoCo, protocol anywhere")


def draw_delta(deltas, names):
    """Draws the success rate against steps of two learners. names: delta -> label."""
    figure, axes = page(3.4)
    for (delta, name), colour in zip(names.items(), ("robot", "run")):
        runs = deltas[deltas.delta == delta].groupby("seed")
        for (_, run), style in zip(runs, ("-", "--", ":")):
            axes.plot(run.steps, run.success, style, color=PALETTE[colour], lw=1.8,
                      label=name if style == "-" else None)
    axes.set(title="env1, three seeds (solid, dashed, dotted)", ylim=(-2, 103),
             xlabel="steps, summed over robots", ylabel="success rate, training targets [%]")
    axes.grid(alpha=0.3)
    legend_below(figure, ncols=2)
    return figure


def draw_lab(lab):
    """Draws the frozen policies in the lab: a row per kind of training, with a dot per seed."""
    lab = lab.assign(new_standing=100 * lab.new_standing)
    rows = dict(list(lab.groupby(["allowed", "way"])))
    figure, panels = page(5.8, 1, 3, sharey=True, width_ratios=(2, 1, 1))
    titles = {"new_success": "success rate\non new targets [%]",
              "new_standing": "stands still [%]", "new_stops": "ring stops\nper episode"}
    for axes, (column, title) in zip(panels, titles.items()):
        for y, ((allowed, _), runs) in enumerate(rows.items()):
            colour = PALETTE[{0: "robot", 300: "training", 3000: "run"}[allowed]]
            axes.plot(runs[column].mean(), y, "|", ms=20, mew=2.5, color=colour)
            axes.plot(runs[column], [y] * len(runs), "o", ms=9, alpha=0.5, mew=0, color=colour,
                      label=f"{allowed:,}")
        axes.set(xlim=(0, None), title=title)
        axes.grid(alpha=0.3)
    panels[0].plot(51, list(rows).index((3000, "from-env2")), "*", ms=13, color=PALETTE["arrival"],
                   label="3,000, the paper's real robot")  # IV-C
    panels[0].set(xlim=(-2, 102), yticks=range(len(rows)), ylim=(len(rows) - 0.4, -0.6),
                  yticklabels=[LAB[way].replace(" with", "\nwith") for _, way in rows])
    legend_below(figure, ncols=4, title="training episodes in the lab (dot: one seed, bar: mean)")
    return figure


def draw_lab_map():
    """Draws the paper's Fig. 8: an episode in the lab, and the map made by the robot."""
    scene = scenes.load("lab")
    robot = LabRobot(scene, target=10, seed=3)  # the first new target; the robot arrives
    log = drive(robot, TorchPolicy(pretrained("lab")[0].model), robot.goal)
    grid = OccupancyGrid(scene.bounds)
    for pose, readings in zip(log.poses, log.readings):
        grid.add(pose, readings)
    figure, axes = page(5.2)
    axes.imshow(1 - grid.probability.T, origin="lower", cmap="gray", vmin=0, vmax=1,
                extent=np.ravel(grid.bounds, "F"))
    for box in scene.boxes:
        axes.fill(*box.corners.T, fill=False, ec=PALETTE["brick"], lw=1.2, label="true boxes")
    for poses, style, colour, label in ((robot.true_poses, "-", "robot", "true path"),
                                        (log.poses, "--", "collision", "path by odometry")):
        axes.plot(*np.array(poses)[:, :2].T, style, color=PALETTE[colour], label=label)
    draw_target(axes, scene, robot.goal, ring=True)
    draw_robot(axes, robot.true_poses[0])
    axes.set(title="map by the robot (grey: unknown)", xlabel="x [m]", ylabel="y [m]")
    legend_below(figure, [START, target_handles(scene)[-1]], ncols=5)
    return figure


def draw_benchmark(benchmark):
    """Draws the time of images and steps against the numbers of robots and of boxes."""
    figure, (left, right) = page(3.6, 1, 2)
    left.set(xscale="log", yscale="log", xlabel="number of robots R (log scale)",
             ylabel="time per robot [µs] (log scale)", title="env1, one core")
    for axes, key, name, style in (
            (left, "env_sps", "environment step", "o-"), (left, "world_sps", "world step", "^:"),
            (left, "camera_fps", "camera image", "s--"),
            (right, "camera_fps_boxes", "camera image", "s")):
        rates = pd.Series(benchmark[key])
        counts = rates.index.astype(int)
        axes.plot(counts, 1e6 / rates, style, color=PALETTE["robot"], label=name)
        axes.set_xticks(counts, counts)
        axes.grid(alpha=0.3)
    left.legend(frameon=False)
    right.set(xlim=(0, None), ylim=(0, None), xlabel="number of boxes (four are walls)",
              ylabel="time per camera image [µs]", title="R = 32, one core")
    return figure


FIGURES = {  # file in pictures/ -> a function that returns its Figure, or the Trace of a film
    "memorizing-reasoning.png":
        lambda: draw_memorizing_reasoning(read("curves.csv"), read("seeds.csv")),
    "fig4.png": lambda: draw_learning(read("curves.csv"), "env1"),
    "fig5.png": lambda: draw_learning(read("curves.csv"), "env2"),
    "floor.png": lambda: draw_floors(read("floor.csv"), [scenes.load(env) for env in ENVS]),
    "fig6-env1.png": lambda: draw_fig6("env1"),
    "fig6-env2.png": lambda: draw_fig6("env2"),
    "hidden.png": draw_hidden,
    "delta-lambda.png": lambda: draw_delta(
        read("deltas.csv"), {"lesson": "lambda = 0.95", "lambda": "lambda = 1"}),
    "delta-clipping.png": lambda: draw_delta(
        read("deltas.csv"), {"passes": "with clipping", "clipping": "without clipping"}),
    "rooms.png": draw_rooms,
    "rooms-learnt.png": lambda: draw_rooms_learnt(read("level3.csv"), read("rooms.csv")),
    "level3-curves.png": lambda: draw_level3_curves(
        *map(read, ("level3-curves.csv", "without-limit.csv", "level3.csv", "earlier-level3.csv"))),
    "any-room.png": draw_any_room,
    "touches.png": draw_touches,
    "any-room.gif": lambda: film_episode(  # an arrival; one episode in nine fails
        pretrained("any-room", "mean")[0], scenes.load("maze4"), "anywhere", seed=6),
    "reality.png": draw_reality,
    "appearances.png": draw_appearances,
    "lab.png": lambda: draw_lab(read("lab.csv")),
    "lab-map.png": draw_lab_map,
    "benchmark.png": lambda: draw_benchmark(read("benchmark.json")),
    "mujoco.png": draw_mujoco,  # this one and the next need robot/requirements.txt
    "mujoco.gif": film_mujoco}


def main(argv=None, pictures=FIGURES, description="Draw the figures of the results."):
    """Runs the command line. pictures: a dict like FIGURES."""
    only = option("", "draw only this picture", choices=["", *pictures])
    options, parser = parse({"only": only}, description, argv)
    for name in [options.only] if options.only else pictures:
        write_picture = write_film if name.endswith("gif") else partial(Figure.savefig, dpi=130)
        try:
            write_picture(pictures[name](), ROOT / "pictures" / name)
        except RunError as error:  # a missing package
            parser.error(error)
        print(f"pictures/{name}", flush=True)


if __name__ == "__main__":
    main()
