"""Speed of each stage, on one core and on all. A number is the median of several timings. Compared
training runs take turns. Axis letters: R robots, M sequences, T steps."""

import json
import subprocess
import sys
import tempfile
from functools import partial
from pathlib import Path
from timeit import Timer

import numpy as np
import pandas as pd
import torch

from experiments.figures import draw_benchmark
from model import make_network
from navbot_min import NavVecEnv
from render import H, W
from scenes.generate import walls
from sim import Box, Scene
from support.cli import option, parse
from support.parallel import available_cores
from support.pictures import save
from support.runs import write

SHORT = ("--fixed-budget", "--evaluation-episodes", "1", "--steps", "18000")  # about six updates
OPTIONS = {
    "out": option("benchmark.json", "file for the numbers; the plot is written next to it as .png"),
    "json": option(False, "print the numbers as JSON instead of the path of their file")}


def rate(call, count):
    """Returns items (steps, images, operations) per second of a call that makes `count` items."""
    timer = Timer(call)
    number, _ = timer.autorange()  # this many calls take at least 0.2 s
    return count * number / np.median(timer.repeat(7, number))


def in_turn(*calls):
    """Makes these calls in turn, three times. Each call's three dicts become a DataFrame."""
    rounds = [[call() for call in calls] for _ in range(3)]
    return [pd.DataFrame(results) for results in zip(*rounds)]


def make_room(boxes):
    """Returns a closed room of 12 m with this many boxes, including its four walls."""
    numbers = np.random.default_rng(0).uniform((-4.5, -4.5, 0), (4.5, 4.5, np.pi), (boxes - 4, 3))
    bricks = [Box("brick", *pose, 1.0, 0.3, 1.5) for pose in numbers]
    return Scene("boxes", (*walls(12, 12), *bricks), (5.4, 5.4, 0.0), ((5.4, -5.4),), ())


def world_calls(scene, R):
    """Returns calls for R robots: an image, a world step, and an environment step with images."""
    env = NavVecEnv(R, [scene], "anywhere")
    env.reset(seed=0)
    rng = np.random.default_rng(0)
    turn = np.tile((0.0, 1.0), (R, 1))  # on the spot
    return {"camera_fps": lambda: env.camera.render(env.scene_of, env.world.poses, env.goals),
            "world_sps": lambda: env.world.drive(turn),
            "env_sps": lambda: env.step(rng.uniform((0, -1), 1, (R, 2)))}


def measure_network(M=16, T=50, R=32):
    """Returns the images per second of the network's passes: forward, both, acting."""
    net = make_network(seed=0)
    seen = {"image": torch.randint(256, (M, T, H, W, 3), dtype=torch.uint8),
            "target": torch.rand(M, T, 2), "velocity": torch.rand(M, T, 2),
            "last_reward": torch.rand(M, T, 1)}
    one = {key: value.flatten(0, 1)[:R].numpy() for key, value in seen.items()}
    generator = torch.Generator().manual_seed(0)

    def forward():
        distribution, values, _ = net(seen, net.initial_state(M))
        return distribution.mean.sum() + values.sum()

    return {"forward": rate(torch.no_grad()(forward), M * T),
            "both": rate(lambda: forward().backward(), M * T),
            "act": rate(lambda: net.act(one, net.initial_state(R), generator), R)}


def measure(cores):
    """Returns the speed of every stage. Camera, world and environment always use one core."""
    torch.set_num_threads(cores)
    short = (*SHORT, "--workers", str(cores))
    # Level 1 has no new targets, so `every` learns from every step.
    both, every = in_turn(partial(train, *short), partial(train, *short, "--targets", "memorize"))
    by_robots = {key: {str(R): rate(world_calls("env1", R)[key], R) for R in (1, 32, 256, 1024)}
                 for key in ("camera_fps", "world_sps", "env_sps")}
    by_boxes = {str(boxes): rate(world_calls(make_room(boxes), 32)["camera_fps"], 32)
                for boxes in (4, 8, 16, 24, 40)}
    return {"cores": cores, **by_robots, "camera_fps_boxes": by_boxes,
            "network_fps": measure_network(), "train_sps": both.sps.median(),
            "train_sps_training_targets": every.sps.median()}


def train(*options, launcher=()):
    """Runs train.py. Returns its steps per second from the first update to the last, and the output
    of `clocked`."""
    with tempfile.TemporaryDirectory() as folder:
        command = [sys.executable, *launcher, "-m", "experiments.clocked", *options,
                   "--out", f"{folder}/run"]
        output = subprocess.run(command, check=True, capture_output=True).stdout
        updates = pd.read_csv(f"{folder}/run/updates.csv")
    seconds = updates.steps / updates.steps_per_second  # since the start
    sps = np.ptp(updates.steps) / np.ptp(seconds)
    return json.loads(output.splitlines()[-1]) | {"sps": sps}


def measure_workers(workers):
    """Returns the speed of training with one and with several workers, on an idle machine, on a
    busy one, and by torchrun."""
    torchrun = ("-m", "torch.distributed.run", "--standalone", f"--nproc-per-node={workers}")
    ways = [partial(train, *SHORT, "--workers", str(count)) for count in (1, workers)]
    one, many, by_torchrun = in_turn(*ways, partial(train, *SHORT, launcher=torchrun))
    hog = subprocess.Popen([sys.executable, "-c", "while True: pass"])  # keeps a core busy
    try:
        busy = in_turn(*ways)
    finally:
        hog.kill()
    pairs = {"idle": (one, many), "busy": busy, "torchrun": (one, by_torchrun)}
    return {when: {"1": one.sps.median(), str(workers): many.sps.median(),
                   "ratio": (many.sps / one.sps).median()} for when, (one, many) in pairs.items()}


def measure_programs():
    """Returns each program's start-up time, and time and memory of a whole training run."""
    commands = {"the demo": ["navbot_min.py"], "training": ["train.py"],
                "evaluation": ["-m", "evaluation"], "drawing a room": ["-m", "scenes"]}
    start_up = {name: 1 / rate(partial(subprocess.run, [sys.executable, *words, "--help"],
                                       check=True, stdout=subprocess.DEVNULL), 1)
                for name, words in commands.items()}
    training = train()
    seconds = {part: sum(calls) for part, calls in training["seconds"].items()}
    collecting = seconds.pop("collecting")
    seconds["rest of collecting"] = collecting - seconds["acting"] - seconds["environment"]
    seconds["rest of training"] = (seconds.pop("training") - collecting - seconds["gradient"]
                                   - seconds["optimizer"])
    return {"start": start_up, "seconds": seconds, "memory_mb": training["memory_mb"]}


def main(argv=None):
    """Runs the command line."""
    options, _ = parse(OPTIONS, "Measure how fast each stage is.", argv)
    path = Path(options.out)
    path.parent.mkdir(parents=True, exist_ok=True)
    cores = min(available_cores(), 4)
    workers = measure_workers(cores) if cores > 1 else {}
    figures = measure(1) | {"workers": workers, "programs": measure_programs(),
                            "all_cores": measure(cores)}
    write(path, json.dumps(figures, indent=2))
    save(draw_benchmark(figures), path.with_suffix(".png"))
    print(json.dumps(figures) if options.json else f"wrote {path}")


if __name__ == "__main__":
    main()
