"""Drive the robot yourself: `python -m classroom.drive --env env1`. A page in the browser shows the
camera image; you steer with the arrow keys. Then a table compares you with a policy and planners.
"""

import csv
import threading
import time
import webbrowser
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from matplotlib.figure import Figure

import scenes
from evaluation import Planned, Policy, ShortestPaths, spl, wilson
from evaluation.protocols import make_environment
from playground.server import Feed, Server
from playground.session import action_of, encoded, held_keys, room_content
from robot.environment import environment_of
from sim import CONTROL_PERIOD, SceneError
from support.cli import option, parse
from support.pictures import WIDTH, draw_path, draw_robot, draw_room, draw_target, save
from support.runs import RunError
from support.traces import drive
from support.weights import load_model

PRETRAINED = Path(__file__).parent.parent / "pretrained"
OTHERS = ("oracle", "bug", "straight")  # planners that drive the same tasks


@dataclass
class Options:
    """Command-line options of a drive."""
    env: str = option("env1", "a room: its name, a file (.toml, .world, .yaml) or random:7")
    episodes: int = option(5, "number of episodes, each with a random start and target", 1, 1000)
    seed: int = option(0, "seed of the tasks: the same seed, the same tasks", 0, 10 ** 9)
    name: str = option("you", "your name, for drives.csv")
    out: str = option("drives", "folder for paths.png and drives.csv")
    map: bool = option(False, "also show the room from above")
    port: int = option(8765, "port on this machine; 0: any free one", 0, 65535)
    no_browser: bool = option(False, "only print the address of the page")


class You(Feed):
    """Driver for one robot: a person at a page of the playground."""

    def __init__(self, has_map):
        super().__init__()
        self.has_map = has_map
        self.message = "Press Start, then drive with the arrow keys."  # empty while you drive
        self.held = set()  # keys

    def reset(self, env, robots):
        """Begins an episode: `act` waits for Start as long as there is a message."""
        self.steps = 0
        self.total = 0.0  # sum of rewards
        if self.has_map:
            self.publish(room=room_content(env.scenes[0]))

    def act(self, env, observations):
        """Shows the observation. Returns the action (1, 2) of the keys in one control period."""
        self.total += float(observations["last_reward"][0, 0])
        self.show(env, observations)
        while self.message:
            self.listen(None)
        self.show(env, observations)
        self.steps += 1
        pressed = self.held
        end = time.monotonic() + CONTROL_PERIOD
        while (left := end - time.monotonic()) > 0:
            pressed = pressed | self.listen(left)
        return action_of(pressed)

    def listen(self, seconds):
        """Does what the page requests next, if anything in this time. Returns the held keys."""
        item = self.next_request(seconds)
        if item:
            request, answer = item
            if isinstance(request.get("keys"), list):
                self.held = held_keys(request["keys"])
            if request.get("run"):
                self.message = ""
            answer.put("")
        return self.held

    def show(self, env, observations):
        """Sends what you may see to the page."""
        seen = {name: value[0].tolist() for name, value in observations.items() if name != "image"}
        state = {"runs": not self.message, "speed": 1, "message": self.message, "outcome": "",
                 "steps": self.steps, "distance": seen["target"][0], "bearing": seen["target"][1],
                 "linear": seen["velocity"][0], "angular": seen["velocity"][1],
                 "reward": seen["last_reward"][0], "return": self.total,
                 "image": encoded(observations["image"][0])}
        if self.has_map:
            state |= {"pose": env.world.poses[0].tolist(), "goal": env.goals[0].tolist()}
        self.publish(state=state)


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
            "seconds": f"{np.mean(seconds):.1f}" if seconds else "-"}


def table(results):
    """Returns a table as text. results: pairs of a name and the dict that `summary` returns."""
    line = "{:30}  {success:7.0%}   [{low:4.0%}, {high:4.0%}]  {spl:4.2f}  {seconds}"
    lines = [line.format(name, **result) for name, result in results]
    return "\n".join([f"{'':30}  success  95 % interval   SPL  seconds to arrive", *lines])


def drive_yourself(options, scene):
    """Serves the page until you have driven all tasks, and adds them to drives.csv. Returns your
    Traces and the page's You. Raises RunError, OSError."""
    folder = Path(options.out)
    folder.mkdir(parents=True, exist_ok=True)  # before the drive, since this may fail
    you = You(options.map)
    server = Server(you, options.port, lambda: {"rooms": [], "drivers": [], "record": True})
    threading.Thread(target=server.serve_forever, daemon=True).start()
    print(server.address, flush=True)
    if not options.no_browser:
        webbrowser.open(server.address)
    traces = []
    for trace in same_tasks(you, scene, options.episodes, options.seed):
        traces.append(trace)
        you.message = (f"Episode {len(traces)} of {options.episodes}: {trace.outcome}, return "
                       f"{trace.rewards.sum():.0f}. Press Start for the next one.")
    rows = rows_of(traces, options.name, options.env, options.seed)
    with open(folder / "drives.csv", "a", newline="", encoding="utf-8") as text:
        writer = csv.DictWriter(text, rows[0])
        if text.tell() == 0:
            writer.writeheader()
        writer.writerows(rows)
    return traces, you


def draw_paths(scene, drives):
    """Returns a Figure with the paths of each driver. drives: pairs of a name and its Traces."""
    figure = Figure(figsize=(2.5 * WIDTH, 4.5), layout="constrained")
    for axes, (name, traces) in zip(figure.subplots(1, len(drives)), drives):
        draw_room(axes, scene)
        axes.set_title(name, parse_math=False)
        for trace in traces:
            draw_target(axes, scene, trace.goal)
            draw_robot(axes, trace.start)
            draw_path(axes, trace)
    return figure


def main(argv=None):
    """Lets you drive, then a policy and planners, and compares all of them."""
    options, parser = parse(Options, "Drive the robot yourself, from its camera image.", argv)
    saved = "not saved"
    try:
        scene = scenes.load(options.env)
        yours, you = drive_yourself(options, scene)
        saved = "saved"
        you.publish(end=f"Done. Last episode: {yours[-1].outcome}. The terminal shows a table.")
        drives = [(options.name, yours)]
        others = [policy_for(scene), *((name, Planned(name, seed=0)) for name in OTHERS)]
        for name, driver in others:
            traces = same_tasks(driver, scene, options.episodes, options.seed)
            drives.append((name, list(traces)))
        save(draw_paths(scene, drives), Path(options.out) / "paths.png")
    except (SceneError, RunError, OSError) as error:
        parser.error(error)
    except KeyboardInterrupt:
        parser.exit(130, f"\nended: the drive is {saved}\n")
    print(table([(name, summary(rows_of(traces))) for name, traces in drives]))
    print(f"paths.png and drives.csv: {options.out}")


if __name__ == "__main__":
    main()
