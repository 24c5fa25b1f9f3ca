"""How fast each stage is, on one core and on all: camera, world, environment, network, training.

Every figure is the best of several short timings, the one that the rest of the machine disturbed
least. What counts is the share of a roof, the rate at which this machine does plain large
convolutions in the same run, and the ratio to the peers, which are timed in the same way. `--peers`
needs an environment of its own, with this project's requirements and
`pip install miniworld vizdoom stable-baselines3 sb3-contrib`; a peer that is missing is left out.
"""

import json
import os
import sys
import time
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import torch
from matplotlib.figure import Figure

from command_line import CommandLine, option
from model import REWARD_SCALE, Network
from navbot_min import NavVecEnv
from peers import PEERS
from ppo import Collector, update
from render import Camera
from scene_file import load_scene, parse_scene
from sim import World
from train import Config

ROBOTS = (1, 32, 256, 1024)
BOXES = (8, 40)


@dataclass
class Options:
    """What to measure."""
    cores: int = option(0, "measure on so many cores alone; 0 for one core, then for all", 0)
    seconds: float = option(0.2, "length of a timing", 0.001)
    peers: bool = option(False, "measure the peers too, where they are installed")
    out: str = option("benchmark.json", "file for the figures; the plot goes beside it, as .png")
    json: bool = option(False, "print the figures alone, as JSON, on standard output")


def rate(call, seconds, timings=15):
    """What `call` counts a second: it returns how many steps, images or so it has done."""
    call()
    best = 0.0
    for _ in range(timings):
        done, start = 0, time.perf_counter()
        while (elapsed := time.perf_counter() - start) < seconds:
            done += call()
        best = max(best, done / elapsed)
    return best


def times(count, call):
    """A call that counts as so many."""
    return lambda: (call(), count)[1]


def room(boxes):
    """A closed room of 12 m with so many boxes, four of them its walls."""
    wall = dict(material="wall", yaw=0.0, thickness=0.1, length=12.0, height=2.5)
    sides = [wall | dict(x=6.0 * np.cos(a), y=6.0 * np.sin(a), yaw=a + np.pi / 2)
             for a in np.arange(4) * np.pi / 2]
    rng = np.random.default_rng(0)
    inside = [dict(material="brick", x=x, y=y, yaw=rng.uniform(0, np.pi), length=1.0, thickness=0.3,
                   height=float(rng.choice([0.6, 1.5])))
              for x, y in rng.permutation(np.argwhere(np.ones((6, 6))) * 1.8 - 4.5)[:boxes - 4]]
    return parse_scene(dict(start=[5.4, 5.4, 0.0], training_targets=[[5.4, -5.4]],
                            new_targets=[[-5.4, 5.4]], boxes=sides + inside), f"{boxes} boxes")


def camera_fps(scene, R, seconds):
    """Images a second, taken from anywhere in the room."""
    camera, rng = Camera([scene]), np.random.default_rng(0)
    poses = np.column_stack([rng.choice(scene.reachable, R), rng.uniform(-np.pi, np.pi, R)])
    targets = scene.targets[rng.integers(len(scene.targets), size=R)]
    return rate(times(R, lambda: camera.render(np.zeros(R, int), poses, targets)), seconds)


def world_sps(scene, R, seconds):
    """Robot-steps a second of the physics alone, robots turning on the spot."""
    world = World([scene] * R)
    return rate(times(R, lambda: world.drive(np.tile((0.0, 1.0), (R, 1)))), seconds)


def env_sps(scene, R, seconds):
    """Environment steps a second, images included, with random actions."""
    env, rng = NavVecEnv(R, scene), np.random.default_rng(0)
    env.reset(seed=0)
    return rate(times(R, lambda: env.step(rng.uniform((0, -1), (1, 1), (R, 2)))), seconds)


def network_fps(seconds, M=16, T=50):
    """Frames a second: forward, forward and backward over sequences, and one step of 32 robots."""
    net, rng = Network(), np.random.default_rng(0)
    seen = {key: torch.as_tensor(rng.random((M, T, n), np.float32))
            for key, n in (("target", 2), ("velocity", 2), ("reward", 1))}
    seen["image"] = torch.as_tensor(rng.integers(0, 256, (M, T, 48, 64, 3), np.uint8))
    one = {key: value.flatten(0, 1)[:32].numpy() for key, value in seen.items()}

    def forward():
        distribution, values, _ = net(seen, net.initial_state(M))
        return distribution.mean.sum() + values.sum()
    with torch.no_grad():
        forward_fps = rate(times(M * T, forward), seconds)
    return {"forward": forward_fps,
            "both": rate(times(M * T, lambda: forward().backward()), seconds),
            "act": rate(times(32, lambda: net.act(one, net.initial_state(32))), seconds)}


def train_sps(scene, targets, seconds):
    """Training steps a second, all told, and the share of the steps that is learnt from.

    targets: `both` as in training, where those to the new targets are not learnt from, or
    `training`, where every step is, as for the peers."""
    torch.manual_seed(0)
    config, model, rng = Config(), Network(), np.random.default_rng(0)
    optimizer = torch.optim.Adam(model.parameters(), config.learning_rate, eps=1e-5, fused=True)
    env = NavVecEnv(config.robots, scene, targets, config.random_starts)
    collector = Collector(env, model, REWARD_SCALE, 0)
    buffer, steps, learnt = [], 0, 0

    def learn():
        nonlocal steps, learnt
        before = steps
        while len(buffer) < config.episodes_per_update:
            buffer.extend(episode for episode, info in collector.step() if not info["new"])
            steps += config.robots
        learnt += sum(len(episode) for episode in buffer)
        update(model, optimizer, buffer, config, rng)
        buffer.clear()
        return steps - before
    return rate(learn, 10 * seconds, timings=5), learnt / steps


def flops(net):
    """Floating-point operations of the network for a frame: forward, and forward and backward."""
    counted = []

    def count(module, _, y):  # two for each weight, at every place of its output
        places = y.shape[2:].numel() if isinstance(module, torch.nn.Conv2d) else 1
        counted.append(2 * places * sum(p.numel() for n, p in module.named_parameters()
                                        if "weight" in n))
    for module in net.modules():
        if isinstance(module, (torch.nn.Conv2d, torch.nn.Linear, torch.nn.LSTM)):
            module.register_forward_hook(count)
    one = {"image": torch.zeros(1, 1, 48, 64, 3, dtype=torch.uint8), "target": torch.zeros(1, 1, 2),
           "velocity": torch.zeros(1, 1, 2), "reward": torch.zeros(1, 1, 1)}
    net(one, net.initial_state(1))
    return sum(counted), 3 * sum(counted) - counted[0]  # images need no gradient


def convolution_rate(seconds):
    """The roof: floating-point operations a second of a plain large convolution."""
    x = torch.randn(16, 64, 96, 128).contiguous(memory_format=torch.channels_last)
    layer = torch.nn.Conv2d(64, 64, 3, padding=1).to(memory_format=torch.channels_last)
    with torch.no_grad():
        return rate(times(2 * 9 * 64 * 64 * 16 * 96 * 128, lambda: layer(x)), seconds)


def measure(cores, seconds):
    """All figures of this project on so many cores."""
    if hasattr(os, "sched_setaffinity"):
        os.sched_setaffinity(0, sorted(ALL_CORES)[:cores])
    torch.set_num_threads(cores)
    scene, roof = load_scene("env1"), convolution_rate(seconds)
    sps, share = train_sps(scene, "both", seconds)
    forward, both = flops(Network())
    return {"cores": cores, "camera_fps": {str(R): camera_fps(scene, R, seconds) for R in ROBOTS},
            "camera_fps_boxes": {str(n): camera_fps(room(n), 32, seconds) for n in BOXES},
            "world_sps": {str(R): world_sps(scene, R, seconds) for R in ROBOTS},
            "env_sps": {str(R): env_sps(scene, R, seconds) for R in ROBOTS},
            "network_fps": network_fps(seconds), "train_sps": sps,
            "train_sps_training_targets": train_sps(scene, "training", seconds)[0],
            "flops_per_frame": {"forward": forward, "both": both}, "roof_flops": roof,
            "roof_fps": {"forward": roof / forward, "both": roof / both, "act": roof / forward},
            "roof_sps": roof / (forward + share * Config.epochs * both)}


def report(figures):
    """The figures of one number of cores as text."""
    lines = [f"on {figures['cores']} core(s); a large convolution does "
             f"{figures['roof_flops'] / 1e9:.0f} GFLOP/s"]
    for key, what in (("camera_fps", "camera, env1, images/s"), ("env_sps", "environment, steps/s"),
                      ("world_sps", "world alone, robot-steps/s")):
        lines.append(f"  {what:33} " + "  ".join(f"R = {R}: {value:,.0f}"
                                                for R, value in figures[key].items()))
    lines.append(f"  {'camera, R = 32, images/s':33} " + "  ".join(
        f"{n} boxes: {value:,.0f}" for n, value in figures["camera_fps_boxes"].items()))
    for key, what in (("act", "network, 32 robots drive"), ("forward", "network, forward"),
                      ("both", "network, forward, backward")):
        lines.append(f"  {what:33} {figures['network_fps'][key]:,.0f} frames/s, "
                     f"{figures['network_fps'][key] / figures['roof_fps'][key]:.0%} of the roof")
    lines.append(f"  {'training, all told':33} {figures['train_sps']:,.0f} steps/s, "
                 f"{figures['train_sps'] / figures['roof_sps']:.0%} of the roof; "
                 f"to training targets alone {figures['train_sps_training_targets']:,.0f}")
    for name, peer in figures.get("peers", {}).items():
        lines.append(f"  beside {name:26} {peer['sps']:,.0f} steps/s, "
                     f"ours {peer['ratio']:.1f} times as many")
    return "\n".join(lines)


def draw(figures, path):
    """Cost of an image against robots and boxes, and of an environment step against robots."""
    figure = Figure(figsize=(9, 3.6), layout="constrained")
    left, right = figure.subplots(1, 2)
    for key, what in (("env_sps", "environment step"), ("camera_fps", "image"),
                      ("world_sps", "world step")):
        left.plot(ROBOTS, [1e6 / figures[key][str(R)] for R in ROBOTS], marker="o", label=what)
    left.set(xscale="log", yscale="log", xlabel="robots R", ylabel="cost of one [us]",
             xticks=ROBOTS, xticklabels=ROBOTS, title="env1, one core")
    left.legend()
    right.plot(BOXES, [1e6 / figures["camera_fps_boxes"][str(n)] for n in BOXES], marker="o",
               color="C1")
    right.set(ylim=(0, None), xlabel="boxes in the room", ylabel="cost of one image [us]",
              xticks=BOXES, title="R = 32, one core")
    for axes in (left, right):
        axes.grid(alpha=0.3)
    figure.savefig(path, dpi=110)


ALL_CORES = os.sched_getaffinity(0) if hasattr(os, "sched_getaffinity") else range(os.cpu_count())


def main(argv=None):
    """The command line."""
    parser = CommandLine("Measure how fast each stage is.")
    options = parser.read(Options, argv)
    if options.cores > len(ALL_CORES):
        parser.error(f"--cores is {options.cores}, it must be at most {len(ALL_CORES)}")
    say = sys.stderr if options.json else sys.stdout
    figures = measure(options.cores or 1, options.seconds)
    figures["peers"] = {}
    for name, (key, peer) in PEERS.items() if options.peers else ():
        try:
            sps = peer(lambda call, count, timings=15: rate(times(count, call), options.seconds,
                                                            timings))
        except ImportError as error:
            print(f"{name} is left out: {error}", file=sys.stderr)
            continue
        ours = figures["env_sps"]["32"] if key == "env" else figures["train_sps_training_targets"]
        figures["peers"][name] = {"sps": sps, "ratio": ours / sps}
    print(report(figures), file=say)
    if not options.cores:
        figures["all_cores"] = measure(len(ALL_CORES), options.seconds)
        print(report(figures["all_cores"]), file=say)
    Path(options.out).write_text(json.dumps(figures, indent=2) + "\n")
    draw(figures, Path(options.out).with_suffix(".png"))
    if options.json:
        print(json.dumps(figures, indent=2))


if __name__ == "__main__":
    main()
