"""How fast each stage is, on one core and on all: camera, world, environment, network, training.

Every figure is the best of several short timings, the one that the rest of the machine disturbed
least. What counts is the share of a roof, the rate at which this machine does plain large
convolutions in the same run, and the ratio to the peers, which are timed in the same way.
`python -m experiments.benchmark --peers` needs an environment of its own:
`pip install -r experiments/requirements-peers.txt`; a peer that is missing is left out.

Axis letters: R robots, M rows of sequences, T steps.
"""

import io
import json
import math
import multiprocessing
import os
import subprocess
import sys
import tempfile
import time
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path

import numpy as np
import torch

import ppo
import scenes
from evaluation.after_training import evaluate_frozen
from experiments.figures import draw_benchmark
from experiments.peers import PEERS
from model import Network, make_network
from navbot_min import HIGHEST_ACTION, LOWEST_ACTION, NavVecEnv
from render import Camera, H, W
from sim import World
from support.command_line import CommandLine, option
from support.cores import available_cores, one_thread
from support.pictures import draw_curves, read_table
from support.processes import OneProcess, start_workers
from support.run_folder import WriteError, write
from support.run_options import default_workers
from train import SUCCESS_RATE, Config, Training

ROBOTS = (1, 32, 256, 1024)
BOXES = (4, 8, 16, 24, 40)
TIMINGS = 15  # the best of so many counts
TRAINING_TIMINGS = 5  # of training, each of them ten times as long
ROUNDS = 9  # of a race
TORCHRUN_STEPS = 3000  # of a race of torchrun, for each update of the others
ROOT = Path(__file__).parent.parent
COMMANDS = {"the demo": ["navbot_min.py"], "training": ["train.py"],
            "evaluation": ["-m", "evaluation"], "drawing a room": ["-m", "scenes"]}


@dataclass
class Options:
    """What to measure."""
    cores: int = option(0, "measure on so many cores alone; by default 0: on one core, then on all",
                        0, 4096)
    seconds: float = option(0.2, "[s] length of a timing", 0.001, 60.0)
    updates: int = option(6, "how many a timing of workers lasts", 1, 1000)
    peers: bool = option(False, "measure other programs too, where they are installed")
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


def make_updates(training, count):
    """Trains for so many updates. Returns the steps that it took and those that were learnt from.

    It is the training of train.py, mirrored room included.
    """
    before = training.record.steps
    learnt = 0
    for _ in range(count):
        for row in training.collect():
            training.record.add_episode(row)
        learnt += sum(len(episode) for episode in training.buffer)
        training.learn()
    return training.record.steps - before, learnt


def make_training(workers, scene):
    """A Training of the real thing, shared among so many workers."""
    config = Config(workers=workers)
    if workers == 1:
        return Training(config, [scene], OneProcess())
    return Training(config, [scene], start_workers(workers, train_along, config, [scene]))


def train_along(config, scenes, workers):
    """What the other workers do until the first one ends them."""
    training = Training(config, scenes, workers)
    while True:
        make_updates(training, 1)


def train_sps(scene, workers, seconds):
    """Training steps a second, all told, and the share of the steps that is learnt from. Without
    new targets that is every step, as with the peers."""
    training = make_training(workers, scene)
    steps = 0
    learnt = 0

    def one_update():
        nonlocal steps, learnt
        new_steps, new_learnt = make_updates(training, 1)
        steps += new_steps
        learnt += new_learnt
        return new_steps

    sps = rate(one_update, 10 * seconds, TRAINING_TIMINGS)
    training.processes.close()
    return sps, learnt / steps


def race(scene, workers, updates, busy=False):
    """One worker and so many, a few updates of each in turn: the median training steps a second
    of both, and the median ratio. busy: whether another process keeps a core busy meanwhile."""
    one = make_training(1, scene)
    many = make_training(workers, scene)
    hog = multiprocessing.Process(target=keep_busy, daemon=True)
    if busy:
        hog.start()
    sps = []
    for turn in range(ROUNDS + 1):
        pair = []
        for training in (one, many):
            start = time.perf_counter()
            steps, _ = make_updates(training, updates)
            pair.append(steps / (time.perf_counter() - start))
        if turn > 0:  # the first is to warm up
            sps.append(pair)
    many.processes.close()
    if busy:
        hog.kill()
    return medians(sps, workers)


def keep_busy():
    """What a process does that leaves no core to others."""
    while True:
        pass


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
    two = {"image": torch.zeros(1, 2, H, W, 3, dtype=torch.uint8),
           "target": torch.zeros(1, 2, 2), "velocity": torch.zeros(1, 2, 2),
           "last_reward": torch.zeros(1, 2, 1)}  # one step alone would go round the LSTM's hook
    net(two, net.initial_state(1))
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


def use(cores, threads):
    """From now on, this process runs on these cores, and torch with so many threads."""
    if hasattr(os, "sched_setaffinity"):
        os.sched_setaffinity(0, cores)
    torch.set_num_threads(threads)


def measure(cores, seconds):
    """All figures of this project on those cores."""
    use(cores, threads=1)
    scene = scenes.load("env1")
    rooms = {boxes: make_room(boxes) for boxes in BOXES}
    workers = default_workers(Config())  # of these cores
    sps, share = train_sps(scene, workers, seconds)
    training_targets_sps, _ = train_sps(replace(scene, new_targets=()), workers, seconds)
    use(cores, threads=len(cores))
    roof = convolution_rate(seconds)
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


def measure_workers(cores, updates):
    """Training by one worker and by one for each core: on an idle machine, while another process
    keeps a core busy, and by torchrun."""
    scene = scenes.load("env1")
    use(cores, threads=1)
    workers = default_workers(Config())
    if workers == 1:
        return {}
    return {"idle": race(scene, workers, updates),
            "busy": race(scene, workers, updates, busy=True),
            "torchrun": race_of_torchrun(workers, TORCHRUN_STEPS * updates)}


def measure_pauses(cores, updates):
    """How long the parts of a training take, the median and the slowest, by one worker, by several,
    and by one process with as many threads of torch's own; on an idle and on a busy machine."""
    use(cores, threads=1)
    workers = default_workers(Config())
    if workers == 1:
        return {}
    ways = {"1 worker": (1, 1), f"{workers} workers": (workers, 1),
            f"{workers} threads of torch's own": (1, workers)}
    measured = {}
    for when in ("idle", "busy"):
        hog = multiprocessing.Process(target=keep_busy, daemon=True)
        if when == "busy":
            hog.start()
        measured[when] = {}
        for name, way in ways.items():
            # A process of its own: after torch has had several threads it must not be forked.
            with ProcessPoolExecutor(1, multiprocessing.get_context("spawn")) as pool:
                measured[when][name] = pool.submit(pauses, *way, updates).result()
        if when == "busy":
            hog.kill()
    return measured


def pauses(workers, threads, updates):
    """Seconds of an update, of the network's acting in a step of all robots, and of the
    environment's step: name -> [median, slowest]."""
    one_thread()
    training = make_training(workers, scenes.load("env1"))
    torch.set_num_threads(threads)
    seconds = {"update": [], "acting": [], "environment": []}
    make_updates(training, 1)  # to warm up
    note_seconds(training, "learn", seconds["update"])
    note_seconds(training.model, "act", seconds["acting"])
    note_seconds(training.env, "step", seconds["environment"])
    make_updates(training, updates * ROUNDS)
    training.processes.close()
    return {part: [float(np.median(taken)), max(taken)] for part, taken in seconds.items()}


def note_seconds(owner, name, seconds):
    """From now on each call of `owner.name` adds to the list how long it took."""
    call = getattr(owner, name)

    def timed(*arguments):
        start = time.perf_counter()
        result = call(*arguments)
        seconds.append(time.perf_counter() - start)
        return result

    setattr(owner, name, timed)


def race_of_torchrun(processes, steps):
    """A training by one process, and one by so many that torchrun starts, in turn: as `race`."""
    torchrun = ["-m", "torch.distributed.run", "--standalone", "--nproc-per-node", str(processes)]
    sps = []
    for _ in range(3):
        pair = []
        for start in ([], torchrun):
            with tempfile.TemporaryDirectory() as folder:
                command = [sys.executable, *start, "train.py", "--steps", str(steps),
                           "--fixed-budget", "--evaluation-episodes", "1", "--out", f"{folder}/run"]
                if not start:
                    command += ["--workers", "1"]
                subprocess.run(command, cwd=ROOT, check=True, capture_output=True)
                last = read_table(Path(folder) / "run" / "updates.csv")[-1]
                pair.append(float(last["steps_per_second"]))
        sps.append(pair)
    return medians(sps, processes)


def medians(sps, workers):
    """What a race says: of [(one, many), ...] the medians, and that of the ratios."""
    alone, shared = np.median(sps, axis=0).tolist()
    return {"1": alone, str(workers): shared, "ratio": float(np.median([b / a for a, b in sps]))}


# ------------------------------------------------------------------------------------- the programs


def start_up_seconds():
    """How long each command takes until it says how it is used: its imports."""
    seconds = {}
    for name, command in COMMANDS.items():
        timings = []
        for _ in range(3):
            start = time.perf_counter()
            subprocess.run([sys.executable, *command, "--help"], cwd=ROOT, check=True,
                           stdout=subprocess.DEVNULL)
            timings.append(time.perf_counter() - start)
        seconds[name] = round(min(timings), 2)
    return seconds


def clock(owner, name, seconds, part):
    """Adds to seconds[part] from now on what `owner.name` takes. Returns it as it was."""
    call = getattr(owner, name)

    def timed(*arguments):
        start = time.perf_counter()
        result = call(*arguments)
        seconds[part] += time.perf_counter() - start
        return result

    setattr(owner, name, timed)
    return call


def where_time_goes(scene, workers):
    """Seconds that the parts of a training in env1 take, seed 0, until the paper's rule stops it,
    as the first of its processes sees them."""
    seconds = dict.fromkeys(("act", "environment", "gradient", "optimiser"), 0.0)

    start = time.perf_counter()
    training = make_training(workers, scene)
    seconds["making"] = time.perf_counter() - start
    clock(training.model, "act", seconds, "act")
    clock(training.env, "step", seconds, "environment")
    clock(training.optimizer, "step", seconds, "optimiser")
    untimed = clock(ppo, "gradient", seconds, "gradient")
    collecting = 0.0
    start = time.perf_counter()
    while not training.is_over():
        began = time.perf_counter()
        for row in training.collect():
            training.record.add_episode(row)
        collecting += time.perf_counter() - began
        if not training.is_over():
            training.learn()
    total = time.perf_counter() - start
    ppo.gradient = untimed
    del training.model.act  # what is evaluated has to be picklable: the class's own again
    training.processes.close()
    seconds["other collecting"] = collecting - seconds["act"] - seconds["environment"]
    seconds["other learning"] = total - collecting - seconds["gradient"] - seconds["optimiser"]
    start = time.perf_counter()
    evaluate_frozen(training.model, [scene], Config.evaluation_episodes, 0, workers)
    seconds["evaluation"] = time.perf_counter() - start
    start = time.perf_counter()
    draw_curves(training.record.episodes, scene.name, SUCCESS_RATE).savefig(io.BytesIO(), dpi=110)
    seconds["curves"] = time.perf_counter() - start
    return {part: round(value, 2) for part, value in seconds.items()}


def peak_memory(command):
    """The most memory [MB] that a command and the processes that it starts hold at once; pages that
    they share count once. None where the system does not tell."""
    process = subprocess.Popen(command, cwd=ROOT, stdout=subprocess.DEVNULL,
                               stderr=subprocess.DEVNULL)
    peak = 0
    while process.poll() is None:
        peak = max(peak, sum(map(proportional_kilobytes, family(process.pid))))
        time.sleep(0.2)
    return round(peak / 1000) or None


def family(pid):
    """That process and all that it has started."""
    try:
        children = Path(f"/proc/{pid}/task/{pid}/children").read_text().split()
    except OSError:
        children = []
    return [pid, *(member for child in children for member in family(child))]


def proportional_kilobytes(pid):
    """A process's memory [kB], of a page that several share its part."""
    try:
        text = Path(f"/proc/{pid}/smaps_rollup").read_text()
    except OSError:  # it has ended, or the system has no such file
        return 0
    return next(int(line.split()[1]) for line in text.splitlines() if line.startswith("Pss:"))


def measure_programs(cores):
    """What a user waits for: imports, a whole training and its parts, and its memory."""
    use(cores, threads=1)
    with tempfile.TemporaryDirectory() as folder:
        command = [sys.executable, "train.py", "--env", "env1", "--out", f"{folder}/run"]
        memory = peak_memory(command)
    return {"start_up_seconds": start_up_seconds(), "memory_mb": memory,
            "seconds": where_time_goes(scenes.load("env1"), default_workers(Config()))}


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
    for when, pair in figures.get("workers", {}).items():
        counts = "  ".join(f"{count}: {pair[count]:,.0f}" for count in pair if count != "ratio")
        lines.append(f"  {f'training by workers, {when}':33} {counts} steps/s, ratio "
                     f"{pair['ratio']:.2f}")
    if "programs" in figures:
        programs = figures["programs"]
        for key, what in (("start_up_seconds", "imports of each command"),
                          ("seconds", "parts of a training in env1")):
            values = "  ".join(f"{name}: {value:.1f}" for name, value in programs[key].items())
            lines.append(f"  {what:33} {values} (seconds)")
        lines.append(f"  {'its peak of memory':33} {programs['memory_mb']} MB")
    for name, peer in figures.get("peers", {}).items():
        lines.append(f"  beside {name:26} {peer['sps']:,.0f} steps/s, "
                     f"ours {peer['ratio']:.1f} times as many")
    return "\n".join(lines)


def main(argv=None):
    """The command line."""
    parser = CommandLine("Measure how fast each stage is.")
    options = parser.read(Options, argv)
    cores = available_cores()
    if options.cores > len(cores):
        parser.error(f"--cores is {options.cores}, it must be at most {len(cores)}")
    path = Path(options.out)
    if path.is_dir() or not path.parent.is_dir() or path.suffix == ".png":
        parser.error(f"--out is '{path}', it must be a file in a folder that exists, not the plot")
    parser.must_write_to(path.parent)
    messages = sys.stderr if options.json else sys.stdout
    one_thread()  # trainings come first: they fork, as train.py does
    raced = {"workers": measure_workers(cores, options.updates),
             "pauses": measure_pauses(cores, options.updates),
             "programs": measure_programs(cores)}
    figures = measure(cores[:options.cores or 1], options.seconds)
    figures["peers"] = measure_peers(figures, options.seconds) if options.peers else {}
    figures |= raced
    print(report(figures), file=messages)
    if options.cores == 0:
        figures["all_cores"] = measure(cores, options.seconds)
        print(report(figures["all_cores"]), file=messages)
    text = json.dumps(figures, indent=2)
    try:
        write(path, text)
        write(path.with_suffix(".png"), partial(draw_benchmark(figures).savefig, dpi=110))
    except WriteError as error:
        parser.error(error)
    if options.json:
        print(text)


if __name__ == "__main__":
    main()
