"""The figures of the results: `python -m experiments.figures` draws all of them into pictures/.
Tables are as `experiments.tables.read` returns them. Paths are fresh episodes of pretrained/."""

from dataclasses import replace
from functools import partial

import numpy as np
import pandas as pd
from matplotlib.figure import Figure

import scenes
from evaluation import PATCH, Assignment, Policy, film_episode, rollouts
from experiments.runs import TEST_ROOMS
from experiments.tables import LAB, ROOMS_LEARNT, ROOT, read
from render import Camera
from robot.environment import RealVecEnv
from robot.lab import LabRobot
from robot.appearance import DrawnCamera, LabCamera
from robot.mapping import OccupancyGrid
from robot.policy import TorchPolicy
from robot.robot import drive
from scenes.generate import share_blocked, walls
from scenes.reality import parse_reality
from sim import Scene
from support.cli import option, parse
from support.film import write_film
from support.pictures import (PALETTE, SPACING, START, TOO_FEW, WIDTH, WINDOW, draw_floor,
                              draw_path, draw_robot, draw_room, draw_target, draw_trajectories,
                              legend_below, paint_floor, released_curve, target_handles)
from support.weights import load_model

ENVS = ("env1", "env2")
WAYS = {"one-start": "one start pose", "varied": "starts anywhere, and mirrored"}  # to train


def page(height, rows=1, columns=1, **options):
    """Returns an empty Figure, WIDTH x height [inch], and its panels. options: as of subplots."""
    figure = Figure(figsize=(WIDTH, height), layout="constrained")
    return figure, figure.subplots(rows, columns, **options)


def pretrained(name, actions="sampled"):
    """Returns a driver with a policy of pretrained/, and the first of its scenes."""
    model, rooms = load_model(ROOT / "pretrained" / f"{name}.safetensors")
    return Policy(model, actions, seed=0), rooms[0]


def draw_images(panels, images):
    """Shows images of the camera, one in each panel. images: title -> (H, W, 3)."""
    for axes, (title, image) in zip(panels, images.items()):
        axes.imshow(image)
        axes.set_title(title, fontsize=8)
        axes.axis("off")


def draw_paths(axes, scene, traces, title):
    """Draws the paths of traces over a map, and how many arrive."""
    draw_room(axes, scene)
    for trace in traces:
        draw_path(axes, trace, alpha=0.7, lw=0.9, label=trace.outcome)
        axes.plot(*trace.start[:2], "o", color=PALETTE["robot"], ms=3, label="start")
    arrived = sum(trace.arrived for trace in traces)
    axes.set(xlabel=f"{title}: {arrived} of {len(traces)} arrive", ylabel="", xticks=[], yticks=[])


def draw_memorizing_reasoning(curves, seeds):
    """Draws success on new targets against steps, and that of the frozen last policies."""
    figure, panels = page(4.1, 1, 2, sharey=True)
    for axes, env in zip(panels, ENVS):
        budget = seeds[seeds.env == env].steps.max() / 1000
        for place, mark, (way, name) in zip((1.03, 1.07), "so", WAYS.items()):
            ours = curves.query("env == @env and way == @way and kind == 'new'")
            for _, run in ours.groupby("seed"):
                axes.plot(run.steps / 1000, run.success, lw=1.2, alpha=0.8,
                          color=PALETTE[way], label=f"{name}: while training")
            frozen = seeds.query("env == @env and way == @way").new_success
            axes.plot([place * budget] * len(frozen), frozen, mark, ms=6.5, mfc="none",
                      color=PALETTE[way], label=f"{name}: last policies, frozen")
        axes.set(title=env, xlabel="steps [thousands]", xlim=(0, 1.1 * budget), ylim=(-3, 103))
        axes.grid(alpha=0.3)
    panels[0].set_ylabel(f"new targets reached,\nlast {WINDOW} episodes [%]")
    legend_below(figure, ncols=2)
    return figure


def draw_learning(curves, env):
    """Draws Fig. 4 (env1) or 5 (env2) over all seeds, the paper's curves behind."""
    figure, panels = page(5.8, 2, 2, sharey="row", sharex="col")
    for column, kind in zip(panels.T, ("training", "new")):
        ours = curves.query("env == @env and kind == @kind")
        episodes, *theirs = released_curve(env, kind)
        for axes, key, values in zip(column, ("success", "return"), theirs):
            axes.semilogx(episodes, values, color=PALETTE["paper"], label="the paper's run")
            for (way, _), run in ours.groupby(["way", "seed"]):
                axes.plot(run.episodes, run[key], color=PALETTE[way], lw=1, label=WAYS[way])
            axes.grid(alpha=0.3)
        column[0].set_title(f"{env}, {kind} targets", color=PALETTE[kind], weight="bold")
        column[1].set(xlabel=f"episodes to {kind} targets", ylabel="average reward, last "
                      f"{WINDOW}\n(paper: {SPACING[env][kind]}) episodes")
    panels[0, 0].set(ylabel=f"success rate,\nlast {WINDOW} episodes [%]", ylim=(-3, 103))
    legend_below(figure, ncols=3)
    return figure


def draw_floors(floor, rooms):
    """Draws the success of both ways from the start pose to each patch of the floor."""
    figure, panels = page(6, len(WAYS), len(rooms), squeeze=False)
    for row, (way, name) in zip(panels, WAYS.items()):
        for axes, scene in zip(row, rooms):
            spots = floor.query("env == @scene.name and way == @way")
            each = spots.loc[spots.index.repeat(spots.n)]  # episodes count alike, seeds do not
            mesh = paint_floor(axes, scene, each[["x", "y"]].to_numpy(), each.success / 100, PATCH)
            draw_robot(axes, scene.start)
            axes.set_title(f"{scene.name}: {name}", fontsize=10)
    figure.colorbar(mesh, ax=panels, shrink=0.7, label="episodes that arrive, all seeds [%]")
    legend_below(figure, [START, *target_handles(rooms[0]), TOO_FEW], ncols=5)
    return figure


def draw_hidden():
    """Draws eight paths from the start to the last new target, parts of which are hidden."""
    figure, panels = page(4.4, len(ENVS), 3)
    for row, env in zip(panels, ENVS):
        driver, scene = pretrained(env)
        robots = [Assignment(scene, len(scene.targets) - 1, 1)] * 8
        for axes, hidden in zip(row, ("", "place", "cube")):
            traces = rollouts(driver, robots, hidden=hidden)
            draw_paths(axes, scene, traces, f"{env}, {hidden or 'nothing'} hidden")
            draw_robot(axes, scene.start)
            draw_target(axes, scene, traces[0].goal, ring=True, label="new target")
    legend_below(figure, ncols=5)
    return figure


def draw_fig6(env):
    """Draws 20 paths of a policy from the start to each target."""
    driver, scene = pretrained(env)
    robots = [Assignment(scene, k, 1) for k in range(len(scene.targets)) for _ in range(20)]
    return draw_trajectories(scene, rollouts(driver, robots))


def draw_rooms():
    """Draws rooms from above, the test rooms in a frame, with the fraction of blocked ways."""
    figure, panels = page(6.75, 5, 5)
    for axes, name in zip(panels.flat, (*TEST_ROOMS, *(f"random:{k}" for k in range(20)))):
        scene = scenes.load(name)
        draw_room(axes, scene)
        axes.set(xlabel=f"{name}, {share_blocked(scene):.0%}", ylabel="", xticks=[], yticks=[])
        axes.spines[:].set(lw=2.5 if name in TEST_ROOMS else 0, color=PALETTE["run"])
    return figure


def draw_rooms_learnt(level3, rooms):
    """Draws success with random starts and targets, all seeds and their mean, by training rooms."""
    in_tests = rooms[rooms.targets == "anywhere"].groupby(["way", "seed"]).success.mean()
    runs = level3[level3.way.isin(ROOMS_LEARNT)].join(in_tests, on=["way", "seed"])
    runs["place"] = runs.way.map(list(ROOMS_LEARNT).index)
    means = runs.groupby("place").mean(numeric_only=True)
    figure, axes = page(4.2)
    for column, colour, mark, name in (
            ("training_success", "training", "s", "the rooms that it learnt in"),
            ("validation_success", "new", "o", "random rooms that it never saw"),
            ("success", "run", "^", "the test rooms, which it never saw either")):
        axes.plot(runs.place, runs[column], mark, color=PALETTE[colour], ms=4)
        axes.plot(means[column], mark + "-", color=PALETTE[colour], ms=7, label=name)
    axes.set(xticks=range(len(ROOMS_LEARNT)), xticklabels=ROOMS_LEARNT.values(), ylim=(30, 103),
             xlabel="rooms learnt in", ylabel="success from anywhere\nto anywhere [%]")
    axes.grid(alpha=0.3)
    legend_below(figure)
    return figure


def draw_any_room():
    """Draws 24 paths from random starts to random targets in each of the held-out rooms."""
    figure = Figure(figsize=(WIDTH, 4.6), layout="constrained")
    robots = [Assignment(scenes.load(name), 0, 1) for name in TEST_ROOMS for _ in range(24)]
    traces = rollouts(pretrained("any-room", "mean")[0], robots, "anywhere")
    for axes, name in zip(figure.subplot_mosaic("001122;.3344.").values(), TEST_ROOMS):
        here = [trace for trace in traces if trace.scene.name == name]
        draw_paths(axes, here[0].scene, here, name)
    legend_below(figure, ncols=4)
    return figure


def draw_any_room_floor():
    """Draws the success on each patch of the floor of a held-out room, one of the two hardest."""
    scene = scenes.load("maze0")
    robots = [Assignment(scene, 0, 10)] * 150
    traces = rollouts(pretrained("any-room", "mean")[0], robots, "anywhere")
    return draw_floor(replace(scene, training_targets=(), new_targets=()), traces, PATCH)


POSE = (0.5, -2.2, 3.3)  # in env2, from which the images are seen
# As in a room's file, larger than in the lab.
SEEN = {"appearance": "lab", "exposure": 0.6, "white_balance": (1.2, 1, 0.75),
        "camera_yaw_degrees": 6, "camera_pitch_degrees": -6, "image_delay": 1}
DRIVEN = {"distance_drift": 0.15, "turn_drift": 0.15, "wheel_gains": (1, 0.93)}


def driven(scene, start, seed, commands, **errors):
    """Returns the last image that a robot sees, its true path (T, 2), and that by its odometry."""
    scene = replace(scene, reality=parse_reality(errors, True))
    env = RealVecEnv(1, [scene], max_episode_steps=-1)
    env.reset(seed=seed, options={"start": start, "target": 0})
    places = []
    for command in commands:
        seen, *_ = env.step(np.array([command]))
        places.append((env.world.poses[0, :2], env.estimates[0, :2].copy()))
    return seen["image"][0], *np.swapaxes(places, 0, 1)


def draw_reality():
    """Draws each error of the lab on its own against the simulation."""
    figure, panels = page(3.6, 2, 5)
    turn = partial(driven, scenes.load("env2"), POSE, 1, [(0.0, 0.5)] * 3)
    images = {f"{error}: {size}": turn(**{error: size})[0] for error, size in SEEN.items()}
    draw_images(panels.flat, {"simulation": turn()[0]} | images)
    floor = Scene("floor", tuple(walls(9.0, 9.0)), (-2.0, 0.0, 0.0), ((4.0, 4.0),), ())
    s_shape = [(0.8, 0.6 * np.cos(k / 4)) for k in range(30)]
    drive_s = partial(driven, floor, floor.start, 5, s_shape)
    for axes, (error, size) in zip(panels.flat[-len(DRIVEN):], DRIVEN.items()):
        _, true, by_odometry = drive_s(**{error: size})
        axes.plot(*drive_s()[1].T, color=PALETTE["paper"], lw=3, label="simulation")
        axes.plot(*true.T, color=PALETTE["robot"], label="true path")
        axes.plot(*by_odometry.T, "--", color=PALETTE["collision"], label="by odometry")
        axes.set(xlabel=f"{error}: {size}", xticks=[], yticks=[], aspect="equal")
    legend_below(figure, ncols=3)
    return figure


def draw_appearances():
    """Draws env2 as the simulation shows it, as the lab would, and in looks that are drawn."""
    figure, panels = page(3.2, 2, 5)
    scene = [scenes.load("env2")]
    cameras = {"simulation": Camera(scene), "the lab's": LabCamera(scene),
               **{f"drawn, {seed}": DrawnCamera(scene, seed) for seed in range(8)}}
    view = np.array([0]), np.array([POSE]), np.array([scene[0].targets[0]])
    draw_images(panels.flat, {name: camera.render(*view)[0] for name, camera in cameras.items()})
    return figure


def draw_lab(lab, lab_curves):
    """Draws what policies do in the lab against the episodes that they learnt there."""
    lab = lab.assign(collision=(lab.training_collision + lab.new_collision) / 2,
                     stops=(lab.training_stops + lab.new_stops) / 2)
    figure, panels = page(4.6, 1, 3)
    titles = "success on new targets [%]", "collisions per 100 episodes", "stops per episode"
    for axes, column, title in zip(panels, ("new_success", "collision", "stops"), titles):
        for way, colour, mark in (("from-scratch", "paper", "s"), ("from-env2", "training", "o"),
                                  ("from-any-room", "run", "^"), ("random-env2", "training", "P"),
                                  ("random-rooms", "run", "X")):
            mean = lab_curves[lab_curves.way == way].groupby("episodes").mean(numeric_only=True)
            if column in mean:
                axes.plot(mean[column], color=PALETTE[colour])
            # At 0 episodes stand the weights that the way begins with.
            frozen = lab[lab.way.isin((way, way.removeprefix("from-")))]
            axes.plot(frozen.allowed, frozen[column], mark, color=PALETTE[colour], label=LAB[way])
        axes.set(xlabel="episodes in the lab", ylabel=title, ylim=(0, None))
        axes.grid(alpha=0.3)
    panels[0].plot(3000, 51, "*", ms=12, color=PALETTE["robot"], label="the paper's robot")  # IV-C
    legend_below(figure, ncols=2, title="lines: mean while learning; marks: frozen policies")
    return figure


def draw_lab_map():
    """Draws the paper's Fig. 8: an episode in the lab, and the map that the robot makes of it."""
    scene = scenes.load("lab")
    robot = LabRobot(scene, target=10, seed=3)  # the first new target; this episode arrives
    log = drive(robot, TorchPolicy(pretrained("lab")[0].model), robot.goal)
    grid = OccupancyGrid(scene.bounds)
    for pose, readings in zip(log.poses, log.readings):
        grid.add(pose, readings)
    figure, axes = page(5.2)
    axes.imshow(1 - grid.probability.T, origin="lower", cmap="gray", vmin=0, vmax=1,
                extent=np.ravel(grid.bounds, "F"))
    for box in scene.boxes:
        axes.fill(*box.corners.T, fill=False, ec=PALETTE["brick"], lw=1.2, label="the room")
    for poses, style, colour, label in ((robot.true_poses, "-", "robot", "true path"),
                                        (log.poses, "--", "collision", "path by odometry")):
        axes.plot(*np.array(poses)[:, :2].T, style, color=PALETTE[colour], label=label)
    draw_target(axes, scene, robot.goal, ring=True)
    draw_robot(axes, robot.true_poses[0])
    legend_below(figure, ncols=3)
    return figure


def draw_benchmark(benchmark):
    """Draws what images and steps cost by the number of robots, and images by that of boxes."""
    figure, (left, right) = page(3.6, 1, 2)
    left.set(xscale="log", yscale="log", xlabel="robots R, side by side (log scale)",
             ylabel="cost for one robot [µs] (log scale)", title="env1, one core")
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
    right.set(xlim=(0, None), ylim=(0, None), xlabel="boxes in the room, four of them walls",
              ylabel="cost of one camera image [µs]", title="R = 32, one core")
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
    "episode.gif": lambda: film_episode(*pretrained("env1")),
    "rooms.png": draw_rooms,
    "rooms-learnt.png": lambda: draw_rooms_learnt(read("level3.csv"), read("rooms.csv")),
    "any-room.png": draw_any_room,
    "any-room-floor.png": draw_any_room_floor,
    "any-room.gif": lambda: film_episode(  # this episode arrives; one in five or so does not
        pretrained("any-room", "mean")[0], scenes.load("maze4"), "anywhere", seed=6),
    "reality.png": draw_reality,
    "appearances.png": draw_appearances,
    "lab.png": lambda: draw_lab(read("lab.csv"), read("lab-curves.csv")),
    "lab-map.png": draw_lab_map,
    "benchmark.png": lambda: draw_benchmark(read("benchmark.json"))}


def main(argv=None, pictures=FIGURES, description="Draw the figures of the results."):
    """The command line. pictures: as FIGURES."""
    only = option("", "draw only this picture", choices=["", *pictures])
    options, _ = parse({"only": only}, description, argv)
    for name in [options.only] if options.only else pictures:
        write_picture = write_film if name.endswith("gif") else partial(Figure.savefig, dpi=130)
        write_picture(pictures[name](), ROOT / "pictures" / name)
        print(f"pictures/{name}", flush=True)


if __name__ == "__main__":
    main()
