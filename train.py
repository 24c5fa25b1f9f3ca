"""Algorithm 1: train on the training targets, record the new ones, stop by the paper's rule.

`python train.py --env env1` trains from scratch, evaluates the frozen policy on fresh episodes and
leaves a run folder: config.json, episodes.csv, updates.csv, model.pt, curves.png, evaluation.json,
summary.json.
"""

import atexit
import json
import os
import sys
import time
from collections import deque
from dataclasses import asdict, dataclass
from itertools import chain
from pathlib import Path

import numpy as np
import torch
from torch import distributed
from tqdm import tqdm

from command_line import CommandLine, option
from evaluate import Policy, evaluate, report
from model import BLANKS, MEMORIES, REWARD_SCALE, Network
from navbot_min import NavVecEnv
from pictures import draw_curves
from ppo import Collector, update
from runs import RunFolder
from scene_file import load_scene
from sim import SceneError

SUCCESS_RATE = 0.60  # r of Algorithm 1, paper IV-B
FINAL_STD = 0.2  # of the initial deviations, when a run uses all its steps, our choice
FADE = 0.15  # share of the steps, the last ones, in which the deviations shrink to it, our choice
WINDOW = 100  # test episodes that the success rate is taken over, paper IV-B

# Which of how many processes this is: `torchrun --nproc-per-node 2 train.py` starts two.
RANK, PROCESSES = int(os.environ.get("RANK", 0)), int(os.environ.get("WORLD_SIZE", 1))


@dataclass
class Config:
    """A training run. The command line is made from these fields."""
    env: str = option("env1", "a scene's name, or a path to a scene file")
    seed: int = option(0, "of every random number in the run", 0)
    steps: int = option(500_000, "limit on environment steps, new targets' included", 1)
    fixed_budget: bool = option(False, "train for all the steps: the paper's rule stops nothing")
    robots: int = option(32, "R, robots that drive side by side", 1)
    random_starts: float = option(0.7, "share of training episodes that start anywhere", 0.0, 1.0)
    mirrored: float = option(0.5, "share of the robots that drive in the mirrored room", 0.0, 1.0)
    memory: str = option("stacked", "the network's memory", choices=MEMORIES)
    without: str = option("", "an input that the network has to do without", choices=BLANKS)
    episodes_per_update: int = option(32, "N of Algorithm 1", 1)
    epochs: int = option(2, "K of Algorithm 1", 1)
    minibatches: int = option(4, "an epoch's minibatches of whole episodes", 1)
    learning_rate: float = option(6e-4, "of Adam", 1e-9, 1.0)
    gamma: float = option(0.99, "discount of a step", 0.0, 1.0)
    lam: float = option(0.95, "lambda of generalised advantage estimation", 0.0, 1.0)
    clip: float = option(0.2, "epsilon of Eq. (3)", 1e-9, 1.0)
    device: str = option("cpu", "where the network runs", choices=("cpu", "cuda"))
    evaluation_episodes: int = option(1000, "frozen episodes to targets of each kind", 1)
    out: str = option("", "run folder, must not exist; by default runs/<env>-seed<k>")
    json: bool = option(False, "print the summary alone, as JSON, on standard output")


class Record:
    """What happened so far: every episode, and the success rates that Algorithm 1 looks at."""

    def __init__(self, scene):
        self.scene, self.episodes, self.steps = scene, [], 0
        self._last = {kind: deque(maxlen=WINDOW) for kind in ("training", "new")}

    def add(self, info):
        """Adds an episode; returns its row of episodes.csv, where a target of the mirrored room is
        named by its place in the true one."""
        kind = "new" if info["new"] else "training"
        x, y = self.scene.targets[info["target"]]
        row = {"steps": self.steps, "target_x": x.item(), "target_y": y.item(), "kind": kind}
        row |= {key: info[key] for key in ("outcome", "return", "length")}
        self.episodes.append(row)
        self._last[kind].append(info["outcome"] == "arrival")
        return row

    def success(self, kind):
        """Success rate of the last 100 episodes of that kind; None before the first."""
        return sum(self._last[kind]) / len(self._last[kind]) if self._last[kind] else None

    def rates(self):
        """Both success rates, as the progress bar shows them."""
        return {f"{kind} targets": f"{self.success(kind):.0%}" for kind in self._last
                if self._last[kind]}

    def rule_is_met(self):
        """The stop of Algorithm 1: the last 100 test episodes succeed at a rate above r."""
        return len(self._last["new"]) == WINDOW and self.success("new") > SUCCESS_RATE


def gather(mine):
    """What every process has, in the order of their ranks."""
    everyone = [mine] * PROCESSES
    if PROCESSES > 1:
        distributed.all_gather_object(everyone, mine)
    return everyone


def train(config, scene, folder):
    """Algorithm 1. Returns the model and the summary so far; what happened is in the folder.

    Several processes share the robots and the episodes of an update. All record the same and so
    stop at the same step; one of them has a folder and writes, the others have None.
    """
    torch.manual_seed(config.seed)
    model = Network(config.memory, config.without).to(config.device)
    rng = np.random.default_rng([config.seed, RANK])  # weights are the same, dice each has its own
    torch.manual_seed(rng.integers(2 ** 31))
    optimizer = torch.optim.Adam(model.parameters(), config.learning_rate, eps=1e-5, fused=True)
    R = config.robots // PROCESSES
    mirrored = int(R * config.mirrored)  # of them: they only train, the tests are in the true room
    rooms = [scene] * (R - mirrored) + [scene.mirrored()] * mirrored
    env = NavVecEnv(R, rooms, "both", config.random_starts)  # line 3 of Algorithm 1: P
    collector = Collector(env, model, REWARD_SCALE, int(rng.integers(2 ** 31)))
    record, buffer, start = Record(scene), [], time.perf_counter()

    def stops():
        return record.rule_is_met() and not config.fixed_budget
    bar = tqdm(total=config.steps, unit=" steps", mininterval=0.5, disable=RANK > 0)
    try:
        while record.steps < config.steps and not stops():
            record.steps += config.robots
            bar.update(config.robots)
            ended = collector.step()  # what happens on the way to a new target is never learnt from
            buffer += [episode for episode, info in ended if not info["new"]]
            infos, stored = zip(*gather(([info for _, info in ended], len(buffer))))
            for info in chain(*infos):
                if not stops():
                    row = record.add(info)
                    folder and folder.add_row("episodes.csv", row)
            if not stops() and min(stored) >= config.episodes_per_update // PROCESSES:
                left = max(1 - record.steps / config.steps, 0)
                optimizer.param_groups[0]["lr"] = config.learning_rate * left
                statistics = update(model, optimizer, buffer, config, rng)
                model.limit_std(FINAL_STD + (1 - FINAL_STD) * min(left / FADE, 1))
                buffer.clear()
                speed = round(record.steps / (time.perf_counter() - start), 1)
                folder and folder.add_row("updates.csv", {"steps": record.steps, **statistics,
                                                          "steps_per_second": speed})
                bar.set_postfix(record.rates())
    except KeyboardInterrupt:
        bar.write("interrupted: training ends here, and its policy is evaluated", file=sys.stderr)
    seconds = time.perf_counter() - start
    bar.set_postfix(record.rates())
    bar.close()
    return model, record, {
        "env": scene.name, "seed": config.seed, "steps": record.steps,
        "episodes": len(record.episodes), "seconds": round(seconds, 2),
        "stopped_by_rule": stops(), "rolling_new_success": record.success("new"),
        "frozen": None}


def read_config(argv):
    """The configuration from the command line, checked; and the parser, for later errors."""
    parser = CommandLine("Train a robot to navigate from its camera (Algorithm 1).")
    config = parser.read(Config, argv)
    if RANK == 0 and config.out and Path(config.out).exists():
        parser.error(f"--out '{config.out}' exists already, it must name a new folder")
    N = config.episodes_per_update
    for flag, value in (("robots", config.robots), ("episodes-per-update", N)):
        if value % PROCESSES:
            parser.error(f"--{flag} is {value}, it must be a multiple of the {PROCESSES} processes")
    if config.minibatches > N // PROCESSES:
        parser.error(f"--minibatches is {config.minibatches}, it must be at most {N // PROCESSES}, "
                     "the episodes of an update")
    if config.device == "cuda" and not torch.cuda.is_available():
        parser.error("--device is cuda, but torch finds no such GPU here; it must be cpu")
    return config, parser


def main(argv=None):
    """The command line: train, save, evaluate the frozen policy, summarise."""
    config, parser = read_config(argv)
    if config.device == "cuda":
        torch.cuda.set_device(int(os.environ.get("LOCAL_RANK", 0)))
    if PROCESSES > 1:
        distributed.init_process_group()
        atexit.register(distributed.destroy_process_group)  # else its threads may abort the exit
    try:
        scene = load_scene(config.env)
        if RANK > 0:
            return train(config, scene, None)
        folder = RunFolder(config.out, f"runs/{scene.name}-seed{config.seed}", asdict(config))
    except (SceneError, OSError) as error:
        parser.error(error)
    messages = sys.stderr if config.json else sys.stdout
    print(f"run folder: {folder.path}", file=messages)
    model, record, summary = train(config, scene, folder)
    folder.save_model(model, scene)
    curves = draw_curves(record.episodes, scene.name, SUCCESS_RATE)
    folder.write("curves.png", lambda path: curves.savefig(path, format="png", dpi=110))
    folder.write("summary.json", json.dumps(summary, indent=2))
    print("evaluating the frozen policy on fresh episodes ...", file=sys.stderr)
    try:
        sampled, mean = (Policy(model, actions, config.seed) for actions in ("sampled", "mean"))
        n, seed = config.evaluation_episodes, config.seed
        summary["frozen"] = evaluate(sampled, scene, n, seed=seed)[0]
        by_mean = evaluate(mean, scene, 1)[0]  # from one start, each episode would be the same
    except KeyboardInterrupt:
        sys.exit("interrupted: the run is saved without its evaluation")
    for target, mean in zip(summary["frozen"]["targets"], by_mean["targets"]):
        target["mean_action_arrives"] = mean["success"] == 1
    folder.write("evaluation.json", json.dumps(summary["frozen"], indent=2))
    folder.write("summary.json", json.dumps(summary, indent=2))
    print(report(summary), file=messages)
    if config.json:
        print(json.dumps(summary, indent=2))


if __name__ == "__main__":
    main()
