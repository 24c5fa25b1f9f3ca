"""Drive the robot yourself: `python -m classroom.drive --env env1`. You see its image and
steer with the arrow keys. A picture and a table then compare you with a policy and planners."""

import csv
import time
from dataclasses import dataclass
from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np
from matplotlib.figure import Figure

import scenes
from evaluation import Planned, Policy, ShortestPaths, spl, wilson
from evaluation.protocols import make_environment
from robot.environment import environment_of
from sim import CONTROL_PERIOD, SceneError
from support.cli import option, parse
from support.pictures import WIDTH, draw_path, draw_robot, draw_room, draw_target, save
from support.traces import drive
from support.weights import load_model

PRETRAINED = Path(__file__).parent.parent / "pretrained"
OTHERS = ("oracle", "bug", "straight")  # planners that drive the same tasks


@dataclass
class Options:
    """Command-line options of a drive."""
    env: str = option("env1", "a room: its name, a file (.toml, .world) or random:7")
    episodes: int = option(5, "number of episodes, each with a random start and target", 1, 1000)
    seed: int = option(0, "seed of the tasks: the same seed, the same tasks", 0, 10 ** 9)
    name: str = option("you", "your name, for drives.csv")
    out: str = option("drives", "folder for paths.png and drives.csv")


def open_window():
    """Returns a Figure in a window. Raises RuntimeError without a display or a toolkit."""
    plt.rcParams["toolbar"] = "None"  # it uses the arrow keys too
    figure = plt.figure("navbot_min", layout="constrained")
    if figure.canvas.required_interactive_framework is None:
        raise RuntimeError("no window can be opened here: it needs a display, and tkinter or PyQt6")
    figure.show()
    return figure


class You:
    """Driver for one robot: a person at the keyboard. figure: a matplotlib Figure in a window."""

    def __init__(self, figure):
        axes = figure.subplots()
        axes.axis("off")
        self.picture = axes.imshow(np.zeros((48, 64, 3), np.uint8))
        self.title = axes.set_title("")
        self.message = "press Enter, then drive with the arrow keys"  # empty while you drive
        self.held = set()  # keys
        self.pressed = set()  # keys, during this control period
        self.canvas = figure.canvas
        self.canvas.mpl_connect("key_press_event", lambda event: self.held.add(event.key))
        self.canvas.mpl_connect("key_press_event", lambda event: self.pressed.add(event.key))
        self.canvas.mpl_connect("key_release_event", lambda event: self.held.discard(event.key))
        self.canvas.mpl_connect("close_event", lambda event: self.held.add("close"))

    def reset(self, env, robots):
        """Does nothing: `act` waits for Enter as long as there is a message."""

    def act(self, env, observations):
        """Shows the observation. Returns the action (1, 2) of the keys in one control period."""
        distance, bearing = observations["target"][0]
        self.picture.set_data(observations["image"][0])
        self.title.set_text(
            f"target {distance:.2f} m, {abs(np.degrees(bearing)):.0f} deg to the "
            f"{'left' if bearing > 0 else 'right'}\n"
            f"last reward {observations['last_reward'][0, 0]:+.1f}\n{self.message}")
        self.canvas.draw_idle()
        while self.message and "enter" not in self.keys(0.01):
            pass
        self.message = ""
        keys = self.keys(CONTROL_PERIOD)
        return np.array([["up" in keys, ("left" in keys) - ("right" in keys)]], float)

    def keys(self, seconds):
        """Returns the keys held or pressed. Raises RuntimeError if the window is closed."""
        self.pressed.clear()
        until = time.perf_counter() + seconds
        while time.perf_counter() < until:
            self.canvas.flush_events()
            time.sleep(0.005)
        if "close" in self.held:
            raise RuntimeError("the window was closed: the drive was not saved")
        return self.held | self.pressed


def same_tasks(driver, scene, episodes, seed):
    """Yields a driver's Traces on the tasks of this seed, which are the same for every driver."""
    env = make_environment("anywhere", [scene], [0], environment=environment_of([scene]))
    for k in range(episodes):  # each has its own seed: some rooms draw numbers at each step
        yield from drive(driver, env, [1], 1000 * seed + k)


def policy_for(scene):
    """Returns the name and the policy trained in this room, or those for random rooms."""
    weights = PRETRAINED / f"{scene.name}.safetensors"
    weights = weights if weights.exists() else PRETRAINED / "any-room.safetensors"
    return f"policy ({weights.name})", Policy(load_model(weights)[0], "mean", seed=0)


def rows_of(traces, name="", env="", seed=0):
    """Returns the rows of drives.csv for a driver's Traces, as dicts."""
    paths = ShortestPaths()
    rows = []
    for k, trace in enumerate(traces):
        shortest = paths.metres(trace.scene, trace.start, trace.goal)
        rows.append({"name": name, "env": env, "seed": seed, "episode": k,
                     "outcome": trace.outcome, "seconds": round(trace.seconds, 1),
                     "metres": round(trace.metres, 2), "shortest": round(shortest, 2),
                     "spl": round(spl(trace.arrived, shortest, trace.metres), 3)})
    return rows


def summary(rows):
    """Returns the success rate of rows, its 95 % interval, mean SPL, mean time to arrive [s]."""
    seconds = [row["seconds"] for row in rows if row["outcome"] == "arrival"]
    low, high = wilson(len(seconds), len(rows))
    return {"success": len(seconds) / len(rows), "low": low, "high": high,
            "spl": np.mean([row["spl"] for row in rows]),
            "seconds": np.mean(seconds) if seconds else np.nan}


def table(results):
    """Returns a table as text. results: pairs of a name and the dict that `summary` returns."""
    line = "{:30}  {success:7.0%}   [{low:4.0%}, {high:4.0%}]  {spl:4.2f}  {seconds:.1f}"
    lines = [line.format(name, **result) for name, result in results]
    return "\n".join([f"{'':30}  success  95 % interval   SPL  seconds to arrive", *lines])


def main(argv=None):
    """Lets you drive, then a policy and planners, and compares all of them."""
    options, parser = parse(Options, "Drive the robot yourself, from its camera image.", argv)
    folder = Path(options.out)
    try:
        scene = scenes.load(options.env)
        you = You(open_window())
        folder.mkdir(parents=True, exist_ok=True)  # before the drive, since this may fail
        yours = []
        for trace in same_tasks(you, scene, options.episodes, options.seed):
            yours.append(trace)
            you.message = f"{trace.outcome}, reward {trace.rewards[-1]:+.1f}: press Enter again"
        rows = rows_of(yours, options.name, options.env, options.seed)
        with open(folder / "drives.csv", "a", newline="", encoding="utf-8") as text:
            writer = csv.DictWriter(text, rows[0])
            if text.tell() == 0:
                writer.writeheader()
            writer.writerows(rows)
    except (SceneError, ImportError, RuntimeError, OSError) as error:
        parser.error(error)
    plt.close("all")
    drives = [(options.name, yours)]
    for name, driver in [policy_for(scene), *((name, Planned(name, seed=0)) for name in OTHERS)]:
        drives.append((name, list(same_tasks(driver, scene, options.episodes, options.seed))))
    figure = Figure(figsize=(2.5 * WIDTH, 4.5), layout="constrained")
    for axes, (name, traces) in zip(figure.subplots(1, len(drives)), drives):
        draw_room(axes, scene)
        axes.set_title(name, parse_math=False)
        for trace in traces:
            draw_target(axes, scene, trace.goal)
            draw_robot(axes, trace.start)
            draw_path(axes, trace)
    save(figure, folder / "paths.png")
    print(table([(name, summary(rows_of(traces))) for name, traces in drives]))
    print(f"paths.png and drives.csv: {folder}")


if __name__ == "__main__":
    main()
