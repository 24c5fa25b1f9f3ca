"""How fast each stage is, on one core and on all: camera, world, environment, network, training.

Every figure is the best of several short timings, the one that the rest of the machine disturbed
least. What counts is the share of a roof, the rate at which this machine does plain large
convolutions in the same run, and the ratio to the peers, which are timed in the same way.
`python -m experiments.benchmark --peers` needs an environment of its own:
`pip install -r experiments/requirements-peers.txt`; a peer that is missing is left out.

Axis letters: R robots, M rows of sequences, T steps.
"""

import json
import math
import os
import sys
import time
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import torch

import scenes
from experiments.figures import draw_benchmark
from experiments.peers import PEERS
from model import Network, make_network
from navbot_min import HIGHEST_ACTION, LOWEST_ACTION, NavVecEnv
from render import Camera, H, W
from sim import World
from support.command_line import CommandLine, option
from support.processes import OneProcess
from support.run_folder import write
from train import Config, Training

ROBOTS = (1, 32, 256, 1024)
BOXES = (4, 8, 16, 24, 40)
TIMINGS = 15  # the best of so many counts
TRAINING_TIMINGS = 5  # of training, each of them ten times as long


@dataclass
class Options:
    """What to measure."""
    cores: int = option(0, "measure on so many cores alone; 0 for one core, then for all", 0)
    seconds: float = option(0.2, "length of a timing", 0.001)
    peers: bool = option(False, "measure the peers too, where they are installed")
    out: str = option("benchmark.json", "file for the figures; the plot goes beside it, as .png")
    json: bool = option(False, "print the figures alone, as JSON, on standard output")


# ---------------------------------------------------------------------------------------- the clock


def rate(call, seconds, timings=TIMINGS):
    """What `call` counts a second: it returns how many steps, images or so it has done."""
    call()
    best = 0.0
    for _ in range(timings):
        done = 0
        elapsed = 0.0
        start = time.perf_counter()
        while elapsed < seconds:
            done += call()
            elapsed = time.perf_counter() - start
        best = max(best, done / elapsed)
    return best


def counted(count, call):
    """A call that counts as so many."""
    def counted_call():
        call()
        return count
    return counted_call


# ---------------------------------------------------------------------------------------- the world


def make_room(boxes):
    """A closed room of 12 m with so many boxes, four of them its walls."""
    table = {"start": {"x": 5.4, "y": 5.4, "heading_degrees": 0.0},
             "training_targets": [[5.4, -5.4]], "new_targets": [[-5.4, 5.4]], "boxes": []}
    for side in range(4):
        angle = side * math.pi / 2
        table["boxes"].append({
            "material": "wall", "x": 6.0 * math.cos(angle), "y": 6.0 * math.sin(angle),
            "yaw_degrees": 90.0 * side + 90.0, "length": 12.0, "thickness": 0.1, "height": 2.5})
    rng = np.random.default_rng(0)
    places = 1.8 * np.argwhere(np.ones((6, 6))) - 4.5  # (36, 2) a grid
    for x, y in rng.permutation(places)[:boxes - 4]:
        table["boxes"].append({
            "material": "brick", "x": float(x), "y": float(y), "yaw_degrees": rng.uniform(0, 180),
            "length": 1.0, "thickness": 0.3, "height": float(rng.choice([0.6, 1.5]))})
    return scenes.parse(table, f"{boxes} boxes")


def camera_fps(scene, R, seconds):
    """Images a second, taken from anywhere in the room."""
    rng = np.random.default_rng(0)
    camera = Camera([scene])
    indices = np.zeros(R, dtype=int)
    poses = np.column_stack([rng.choice(scene.reachable, R), rng.uniform(-np.pi, np.pi, R)])
    targets = scene.targets[rng.integers(len(scene.targets), size=R)]
    return rate(counted(R, lambda: camera.render(indices, poses, targets)), seconds)


def world_sps(scene, R, seconds):
    """Robot-steps a second of the physics alone, robots turning on the spot."""
    world = World([scene] * R)
    commands = np.tile((0.0, 1.0), (R, 1))
    return rate(counted(R, lambda: world.drive(commands)), seconds)


def env_sps(scene, R, seconds):
    """Environment steps a second, images included, with random actions."""
    rng = np.random.default_rng(0)
    env = NavVecEnv(R, [scene])
    env.reset(seed=0)

    def step():
        env.step(rng.uniform(LOWEST_ACTION, HIGHEST_ACTION, (R, 2)))

    return rate(counted(R, step), seconds)


# -------------------------------------------------------------------------------------- the learner


def network_fps(seconds, M=16, T=50, R=32):
    """Frames a second: forward, forward and backward over sequences, and one step of R robots."""
    rng = np.random.default_rng(0)
    net = make_network(seed=0)
    seen = {key: torch.as_tensor(rng.random((M, T, n), np.float32))
            for key, n in (("target", 2), ("velocity", 2), ("last_reward", 1))}
    seen["image"] = torch.as_tensor(rng.integers(0, 256, (M, T, H, W, 3), np.uint8))
    one = {key: value.flatten(0, 1)[:R].numpy() for key, value in seen.items()}
    generator = torch.Generator().manual_seed(0)

    def forward():
        distribution, values, _ = net(seen, net.initial_state(M))
        return distribution.mean.sum() + values.sum()

    def backward():
        forward().backward()

    def act():
        net.act(one, net.initial_state(R), generator)

    with torch.no_grad():
        forward_fps = rate(counted(M * T, forward), seconds)
    return {"forward": forward_fps, "both": rate(counted(M * T, backward), seconds),
            "act": rate(counted(R, act), seconds)}


def train_sps(scene, seconds):
    """Training steps a second, all told, and the share of the steps that is learnt from.

    It is the training of train.py, mirrored room included; without new targets every step is
    learnt from, as with the peers.
    """
    training = Training(Config(), [scene], OneProcess())
    learnt = 0

    def one_update():
        nonlocal learnt
        before = training.record.steps
        while not training.buffer_is_full:
            for info in training.collect():
                training.record.add(info)
        learnt += sum(len(episode) for episode in training.buffer)
        training.learn()
        return training.record.steps - before

    sps = rate(one_update, 10 * seconds, TRAINING_TIMINGS)
    return sps, learnt / training.record.steps


def flops(net):
    """Floating-point operations of the network for a frame: forward, and forward and backward."""
    operations = []

    def count(module, _, output):
        places = 1
        if isinstance(module, torch.nn.Conv2d):
            places = output.shape[2:].numel()  # every weight is used at every place
        weights = sum(parameter.numel() for name, parameter in module.named_parameters()
                      if "weight" in name)
        operations.append(2 * places * weights)  # a product and a sum

    for module in net.modules():
        if isinstance(module, (torch.nn.Conv2d, torch.nn.Linear, torch.nn.LSTM)):
            module.register_forward_hook(count)
    one = {"image": torch.zeros(1, 1, H, W, 3, dtype=torch.uint8),
           "target": torch.zeros(1, 1, 2), "velocity": torch.zeros(1, 1, 2),
           "last_reward": torch.zeros(1, 1, 1)}
    net(one, net.initial_state(1))
    forward = sum(operations)
    first_layer = operations[0]  # whose input, the image, needs no gradient
    return forward, 3 * forward - first_layer


def convolution_rate(seconds):
    """The roof: floating-point operations a second of a plain large convolution."""
    M, C, height, width = 16, 64, 96, 128
    images = torch.randn(M, C, height, width).contiguous(memory_format=torch.channels_last)
    layer = torch.nn.Conv2d(C, C, 3, padding=1).to(memory_format=torch.channels_last)
    operations = 2 * 3 * 3 * C * C * M * height * width
    with torch.no_grad():
        return rate(counted(operations, lambda: layer(images)), seconds)


# -------------------------------------------------------------------------------------- the figures


def available_cores():
    """The cores that this process may use."""
    if hasattr(os, "sched_getaffinity"):
        return sorted(os.sched_getaffinity(0))
    return list(range(os.cpu_count()))


def measure(cores, seconds):
    """All figures of this project on those cores."""
    if hasattr(os, "sched_setaffinity"):
        os.sched_setaffinity(0, cores)
    torch.set_num_threads(len(cores))
    scene = scenes.load("env1")
    rooms = {boxes: make_room(boxes) for boxes in BOXES}
    roof = convolution_rate(seconds)
    sps, share = train_sps(scene, seconds)
    training_targets_sps, _ = train_sps(replace(scene, new_targets=()), seconds)
    forward, both = flops(Network())
    return {"cores": len(cores),
            "camera_fps": {str(R): camera_fps(scene, R, seconds) for R in ROBOTS},
            "camera_fps_boxes": {str(boxes): camera_fps(room, 32, seconds)
                                 for boxes, room in rooms.items()},
            "world_sps": {str(R): world_sps(scene, R, seconds) for R in ROBOTS},
            "env_sps": {str(R): env_sps(scene, R, seconds) for R in ROBOTS},
            "network_fps": network_fps(seconds), "train_sps": sps,
            "train_sps_training_targets": training_targets_sps,
            "flops_per_frame": {"forward": forward, "both": both}, "roof_flops": roof,
            "roof_fps": {"forward": roof / forward, "both": roof / both, "act": roof / forward},
            "roof_sps": roof / (forward + share * Config.epochs * both)}


def measure_peers(figures, seconds):
    """The peers that are installed, beside this project's figures on the same cores."""
    def time_peer(call, count, timings=TIMINGS):
        return rate(counted(count, call), seconds, timings)

    ours = {"env": figures["env_sps"]["32"], "training": figures["train_sps_training_targets"]}
    peers = {}
    for name, (kind, peer) in PEERS.items():
        try:
            sps = peer(time_peer)
        except ImportError as error:
            print(f"{name} is left out: {error}", file=sys.stderr)
        else:
            peers[name] = {"sps": sps, "ratio": ours[kind] / sps}
    return peers


def report(figures):
    """The figures of one number of cores as text."""
    lines = [f"on {figures['cores']} core(s); a large convolution does "
             f"{figures['roof_flops'] / 1e9:.0f} GFLOP/s"]
    for key, what, unit in (("camera_fps", "camera, env1, images/s", "robots"),
                            ("camera_fps_boxes", "camera, 32 robots, images/s", "boxes"),
                            ("env_sps", "environment, steps/s", "robots"),
                            ("world_sps", "world alone, robot-steps/s", "robots")):
        values = "  ".join(f"{count}: {value:,.0f}" for count, value in figures[key].items())
        lines.append(f"  {what:33} {values} ({unit})")
    for key, what in (("act", "network, 32 robots drive"), ("forward", "network, forward"),
                      ("both", "network, forward and backward")):
        fps = figures["network_fps"][key]
        lines.append(f"  {what:33} {fps:,.0f} frames/s, {fps / figures['roof_fps'][key]:.0%} of "
                     "the roof")
    sps = figures["train_sps"]
    lines.append(f"  {'training, all told':33} {sps:,.0f} steps/s, "
                 f"{sps / figures['roof_sps']:.0%} of the roof; where every step is learnt from "
                 f"{figures['train_sps_training_targets']:,.0f}")
    for name, peer in figures.get("peers", {}).items():
        lines.append(f"  beside {name:26} {peer['sps']:,.0f} steps/s, "
                     f"ours {peer['ratio']:.1f} times as many")
    return "\n".join(lines)


def main(argv=None):
    """The command line."""
    parser = CommandLine("Measure how fast each stage is.")
    parser.prog = "python -m experiments.benchmark"
    options = parser.read(Options, argv)
    cores = available_cores()
    if options.cores > len(cores):
        parser.error(f"--cores is {options.cores}, it must be at most {len(cores)}")
    path = Path(options.out)
    if not path.parent.is_dir():
        parser.error(f"--out is '{path}', it must be a file in a folder that exists")
    messages = sys.stderr if options.json else sys.stdout
    figures = measure(cores[:options.cores or 1], options.seconds)
    figures["peers"] = measure_peers(figures, options.seconds) if options.peers else {}
    print(report(figures), file=messages)
    if options.cores == 0:
        figures["all_cores"] = measure(cores, options.seconds)
        print(report(figures["all_cores"]), file=messages)
    text = json.dumps(figures, indent=2)
    try:
        write(path, text)
        draw_benchmark(figures).savefig(path.with_suffix(".png"), dpi=110)
    except OSError as error:
        parser.error(f"--out '{path}' cannot be written: {error.strerror}")
    if options.json:
        print(text)


if __name__ == "__main__":
    main()
