"""Drive it yourself: `python -m classroom.drive --env env1`.

You see what the robot sees: its camera, 64 x 48 pixels, how far off the target is and in which
direction, and the last reward. You steer with the arrow keys, once in a control period, as the
policy does. Afterwards your paths are drawn over the map beside the policy's, and your success
stands in a table with the planners' and the learner's, on the same tasks.
"""

import math
import sys
import time
from dataclasses import dataclass
from functools import partial
from pathlib import Path

import numpy as np
from matplotlib.figure import Figure
from matplotlib.lines import Line2D

import scenes
from evaluation import Planned, Policy, ShortestPaths, spl, summarise
from evaluation.protocols import make_environment
from navbot_min import MAX_EPISODE_STEPS
from sim import CONTROL_PERIOD, SceneError
from support.command_line import CommandLine, option
from support.interruption import interruption
from support.pictures import (MARKERS, PALETTE, WIDTH, draw_robot, draw_room, draw_target,
                              start_handle)
from support.run_folder import WriteError, csv_text, write
from support.traces import drive
from support.weights import load_run

PRETRAINED = Path(__file__).parent.parent / "pretrained"
OTHERS = ("oracle", "bug", "straight")  # planners that drive the same tasks
STEERING = {"up": (1.0, 0.0), "left": (0.0, 1.0), "right": (0.0, -1.0)}  # key -> action
STILL = 0.3  # [s] without a key, after which another episode may begin
YOURS = PALETTE["run"]
ITS = PALETTE["arrival"]
MOST_EPISODES = 1000
LARGEST_SEED = 1_000_000_000
COLUMNS = ("name", "env", "seed", "episode", "outcome", "seconds", "metres", "shortest", "spl")


@dataclass
class Options:
    """A drive."""
    env: str = option("env1", "a room: its name, a file (.toml, .world) or random:7")
    episodes: int = option(5, "so many, from anywhere to anywhere", 1, MOST_EPISODES)
    seed: int = option(0, "which tasks: the same seed, the same starts and targets", 0,
                       LARGEST_SEED)
    name: str = option("you", "who drives, for drives.csv")
    map: bool = option(False, "show the map, too: the policy has none")
    out: str = option("drives", "the folder that the picture and drives.csv go into")


class Closed(Exception):
    """The window was closed."""


def why_no_window():
    """Why there is none, and what to do."""
    try:
        import tkinter  # noqa: F401
    except ImportError:
        return ("this python came without tkinter; on Debian and Ubuntu install python3-tk, "
                "elsewhere take a python from python.org")
    return "there is no display; sit before the machine, or connect with `ssh -X`"


class Cockpit:
    """The window: what the robot sees, and which keys are held."""

    def __init__(self, scene, with_map):
        """Raises RuntimeError where there is no display."""
        try:
            import matplotlib.pyplot as plt  # here: a test of the paths needs no window
            for name in [name for name in plt.rcParams if name.startswith("keymap.")]:
                plt.rcParams[name] = []  # arrows steer, and do nothing else
            plt.rcParams["toolbar"] = "None"
            self.figure = plt.figure("navbot_min", figsize=(12 if with_map else 7, 6),
                                     layout="constrained")
        except Exception as error:  # each toolkit has errors of its own
            raise RuntimeError(f"no window can be opened here: {error}; sit before the machine, or "
                               "connect with `ssh -X`") from None
        canvas = self.figure.canvas
        if canvas.required_interactive_framework is None:
            raise RuntimeError(f"no window can be opened here: {why_no_window()}")
        panels = self.figure.subplots(1, 2 if with_map else 1, squeeze=False)[0]
        self.picture = panels[0].imshow(np.zeros((48, 64, 3), np.uint8))
        panels[0].axis("off")
        self.title = panels[0].set_title("")
        self.scene = scene
        self.map = panels[1] if with_map else None
        self.held = set()
        self.pressed = set()  # since the last period
        self.is_open = True
        canvas.mpl_connect("key_press_event", self._press)
        canvas.mpl_connect("key_release_event", self._release)
        canvas.mpl_connect("close_event", self._close)
        if hasattr(canvas, "get_tk_widget"):  # a key that is released elsewhere is not held here
            canvas.get_tk_widget().bind("<FocusOut>", lambda event: self.held.clear(), add="+")
        self.figure.show()

    def _press(self, event):
        self.held.add(event.key)
        self.pressed.add(event.key)

    def _release(self, event):
        self.held.discard(event.key)

    def _close(self, event):
        self.is_open = False

    def show(self, image, text, goal, pose):
        """Shows an image (H, W, 3), a line above it, and on the map goal (2,) and pose (3,)."""
        self.picture.set_data(image)
        self.title.set_text(text)
        if self.map is not None:
            self.map.clear()
            draw_room(self.map, self.scene)
            draw_target(self.map, self.scene, goal, ring=True)
            draw_robot(self.map, pose)
            self.map.axis("off")
        self.figure.canvas.draw_idle()

    def wait(self, is_over):
        """The keys that were held or pressed until that is over, a function of the time [s]. Raises
        Closed."""
        self.pressed.clear()
        while True:
            self.figure.canvas.flush_events()
            if not self.is_open:
                raise Closed
            if is_over(time.perf_counter()):
                return self.held | self.pressed
            time.sleep(0.01)

    def wait_for_release(self):
        """Waits until no key was held or pressed for STILL: one that is held repeats itself."""
        still_since = time.perf_counter()

        def is_still(now):
            nonlocal still_since
            if self.held or self.pressed:
                still_since = now
            self.pressed.clear()
            return now - still_since > STILL
        self.wait(is_still)

    def close(self):
        """Closes the window."""
        import matplotlib.pyplot as plt
        plt.close(self.figure)


class You:
    """A driver for one robot: whoever sits before the window."""

    label = "you"

    def __init__(self, cockpit):
        self.cockpit = cockpit
        self.episode = 0
        self.step = 0
        self.due = 0.0  # [s] when the control period is over
        self.before = ""  # how the episode before ended

    def reset(self, env, robots):
        """Another episode begins."""
        self.step = 0

    def tell(self, trace):
        """How an episode ended."""
        self.before = f"episode {self.episode}: {trace.outcome}, reward {trace.rewards[-1]:+.1f}\n"

    def act(self, env, observations):
        """The action (1, 2) of the keys that are held until the control period is over. An episode
        begins when an arrow key is pressed anew."""
        if self.step == 0:
            self.episode += 1
        self.show(env, observations)
        if self.step == 0:
            self.cockpit.wait_for_release()
            self.cockpit.wait(lambda now: self.cockpit.pressed & set(STEERING))
            self.due = time.perf_counter()
        self.due = max(self.due, time.perf_counter()) + CONTROL_PERIOD
        action = np.zeros(2)
        for key in self.cockpit.wait(lambda now: now >= self.due) & set(STEERING):
            action += STEERING[key]
        self.step += 1
        return action[None]

    def show(self, env, observations):
        """Shows what the robot sees, and says the rest of its observation above."""
        distance, bearing = observations["target"][0]
        side = "left" if bearing > 0 else "right"
        left = (MAX_EPISODE_STEPS - self.step) * CONTROL_PERIOD
        keys = f"{left:.0f} s left" if self.step else "press an arrow key to begin"
        before = "" if self.step else self.before
        text = (f"{before}episode {self.episode}: target {distance:.2f} m, "
                f"{abs(math.degrees(bearing)):.0f} deg to the {side}\n"
                f"last reward {observations['last_reward'][0, 0]:+.1f}, {keys}")
        self.cockpit.show(observations["image"][0], text, env.goals[0], env.world.poses[0])


def same_tasks(driver, scene, episodes, seed, tell=lambda trace: None):
    """The Traces of a driver on the tasks of that seed. Each has a seed of its own, and so is the
    same for every driver, whatever a room draws while one drives. tell: is called with each Trace
    when it ends."""
    env = make_environment("anywhere", [scene], [0])
    traces = []
    for k in range(episodes):
        traces += drive(driver, env, [1], MOST_EPISODES * seed + k)
        tell(traces[-1])
    return traces


def policy_for(scene):
    """The learner beside you, and its name: a policy that learnt in this room where there is one,
    else the one that learnt in random rooms."""
    weights = PRETRAINED / f"{scene.name}.pt"
    if not weights.exists():
        weights = PRETRAINED / "any-room.pt"
    model, _ = load_run(weights)
    return Policy(model, "mean", seed=0), f"learner ({weights.name})"


def draw_paths(scene, yours, its):
    """Your paths beside the policy's, an episode a panel. yours, its: Traces of the same tasks.
    Returns a Figure."""
    columns = min(len(yours), 3)
    rows = -(-len(yours) // columns)
    figure = Figure(figsize=(WIDTH, 1 + 2.2 * rows), layout="constrained")
    panels = figure.subplots(rows, columns, squeeze=False)
    for axes in panels.flat[len(yours):]:
        axes.axis("off")
    for axes, you, it in zip(panels.flat, yours, its):
        draw_room(axes, scene)
        draw_target(axes, scene, you.goal, ring=True)
        draw_robot(axes, you.start)
        for trace, colour in ((it, ITS), (you, YOURS)):
            axes.plot(*trace.poses[:, :2].T, color=colour, lw=1.6)
            axes.plot(*trace.poses[-1, :2], color=colour, marker=MARKERS[trace.outcome], ms=6)
        axes.set_title(f"you: {you.outcome}, {you.seconds:.0f} s\nit: {it.outcome}, "
                       f"{it.seconds:.0f} s", fontsize=9)
        axes.set(xlabel="", ylabel="", xticks=[], yticks=[])
    lines = [Line2D([], [], color=YOURS, label="you"), Line2D([], [], color=ITS, label="learner")]
    figure.legend(handles=[start_handle(), *lines], loc="outside lower center", ncols=3,
                  frameon=False)
    return figure


def table(rows):
    """Lines of text. rows: a name and Traces each."""
    width = max(len(name) for name, _ in rows)
    lines = [f"{'':{width}}  arrives   SPL  seconds to arrive"]
    for name, traces in rows:
        result = summarise(traces)
        seconds = result["seconds_to_arrive"]
        lines.append(f"{name:{width}}  {result['success']:7.0%}  {result['spl']:4.2f}  "
                     f"{'-' if seconds is None else f'{seconds:.1f}'}")
    return "\n".join(lines)


def add_rows(file, options, traces):
    """Adds a row for each episode to a CSV file. Raises WriteError."""
    paths = ShortestPaths()
    before = file.read_bytes() if file.exists() else csv_text([COLUMNS]).encode()
    rows = []
    for k, trace in enumerate(traces):
        shortest = paths.metres(trace.scene, trace.start, trace.goal)
        row = {"name": options.name, "env": options.env, "seed": options.seed, "episode": k,
               "outcome": trace.outcome, "seconds": round(trace.seconds, 1),
               "metres": round(trace.metres, 2), "shortest": round(shortest, 2),
               "spl": round(spl(trace.arrived, shortest, trace.metres), 3)}
        rows.append([row[column] for column in COLUMNS])
    write(file, before + csv_text(rows).encode())


def main(argv=None):
    """The command line: you drive, then the others do, and all are compared."""
    interruption.handle("interrupted: nothing of this drive is kept")
    parser = CommandLine("Drive the robot yourself, by what it sees.")
    options = parser.read(Options, argv)
    try:
        scene = scenes.load(options.env)
        cockpit = Cockpit(scene, options.map)
    except (SceneError, RuntimeError) as error:
        parser.error(error)
    folder = Path(options.out)
    parser.must_write_to(folder)
    for file in (folder / "drives.csv", folder / "paths.png"):
        if file.is_dir():
            parser.error(f"'{file}' is a folder: move it away, or choose another --out")
    you = You(cockpit)
    try:
        yours = same_tasks(you, scene, options.episodes, options.seed, you.tell)
    except Closed:
        parser.error("the window was closed: nothing of this drive is kept")
    cockpit.close()
    learner, name = policy_for(scene)
    its = same_tasks(learner, scene, options.episodes, options.seed)
    others = [(planner, same_tasks(Planned(planner, 0), scene, options.episodes, options.seed))
              for planner in OTHERS]
    print(table([(options.name, yours), (name, its), *others]))
    folder.mkdir(parents=True, exist_ok=True)
    try:
        add_rows(folder / "drives.csv", options, yours)
        write(folder / "paths.png", partial(draw_paths(scene, yours, its).savefig, dpi=110))
    except WriteError as error:
        sys.exit(f"error: {error}")
    print(f"paths and drives.csv: {folder}")


if __name__ == "__main__":
    main()
