"""Algorithm 1: train on the training targets, record the new ones, stop by the paper's rule.

`python train.py --env env1` trains from scratch, evaluates the frozen policy on fresh episodes and
leaves a run folder: config.json, episodes.csv, updates.csv, model.pt, curves.png, evaluation.json,
summary.json.
"""

import json
import sys
import time
from collections import deque
from dataclasses import asdict, dataclass, field, fields
from pathlib import Path

import numpy as np
import torch
from tqdm import tqdm

from evaluate import draw_curves, evaluate, report
from model import MEMORIES, REWARD_SCALE, Network
from navbot_min import CommandLine, NavVecEnv
from ppo import Collector, update
from runs import RunFolder
from sim import SceneError, load_scene

SUCCESS_RATE = 0.60  # r of Algorithm 1, paper IV-B
WINDOW = 100  # test episodes that the success rate is taken over, paper IV-B


def option(default, text, low=None, high=None, choices=None):
    """A field of the configuration: its default, what it is, and which values are valid."""
    return field(default=default, metadata=dict(text=text, low=low, high=high, choices=choices))


@dataclass
class Config:
    """A training run. The command line is made from these fields."""
    env: str = option("env1", "a scene's name, or a path to a scene file")
    seed: int = option(0, "of every random number in the run", 0)
    steps: int = option(500_000, "limit on environment steps, new targets' included", 1)
    robots: int = option(32, "R, robots that drive side by side", 1)
    random_starts: float = option(0.7, "share of training episodes that start anywhere", 0.0, 1.0)
    memory: str = option("stacked", "the network's memory", choices=MEMORIES)
    episodes_per_update: int = option(32, "N of Algorithm 1", 1)
    epochs: int = option(4, "K of Algorithm 1", 1)
    minibatches: int = option(2, "an epoch's minibatches of whole episodes", 1)
    learning_rate: float = option(6e-4, "of Adam", 1e-9, 1.0)
    gamma: float = option(0.99, "discount of a step", 0.0, 1.0)
    lam: float = option(0.95, "lambda of generalised advantage estimation", 0.0, 1.0)
    clip: float = option(0.2, "epsilon of Eq. (3)", 1e-9, 1.0)
    evaluation_episodes: int = option(1000, "frozen episodes to targets of each kind", 1)
    out: str = option("", "run folder, must not exist; by default runs/<env>-seed<k>")
    json: bool = option(False, "print the summary alone, as JSON, on standard output")


def read_config(argv):
    """The configuration from the command line, checked; and the parser, for later errors."""
    parser = CommandLine("Train a robot to navigate from its camera (Algorithm 1).")
    for item in fields(Config):
        flag, text = f"--{item.name.replace('_', '-')}", item.metadata["text"]
        if item.type is bool:
            parser.add_argument(flag, action="store_true", help=text)
        else:
            parser.add_argument(flag, type=item.type, default=item.default, help=text,
                                choices=item.metadata["choices"])
    config = Config(**vars(parser.parse(argv)))
    for item in fields(Config):
        low, high = item.metadata["low"], item.metadata["high"]
        value, flag = getattr(config, item.name), f"--{item.name.replace('_', '-')}"
        if low is not None and not low <= value <= (np.inf if high is None else high):
            valid = f"from {low} up" if high is None else f"from {low} to {high}"
            parser.error(f"{flag} is {value}, it must be {valid}")
    if config.out and Path(config.out).exists():
        parser.error(f"--out '{config.out}' exists already, it must name a new folder")
    return config, parser


class Record:
    """What happened so far: every episode, and the success rates that Algorithm 1 looks at."""

    def __init__(self, scene):
        self.scene, self.episodes, self.steps = scene, [], 0
        self._last = {kind: deque(maxlen=WINDOW) for kind in ("training", "new")}

    def add(self, info):
        """Adds an episode; returns its row of episodes.csv."""
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


def train(config, scene, folder):
    """Algorithm 1. Returns the model and the summary so far; what happened is in the folder."""
    torch.manual_seed(config.seed)
    rng = np.random.default_rng(config.seed)
    model = Network(config.memory)
    optimizer = torch.optim.Adam(model.parameters(), lr=config.learning_rate, eps=1e-5, fused=True)
    env = NavVecEnv(config.robots, scene, "both", config.random_starts)  # line 3: p0 from all of P
    collector = Collector(env, model, REWARD_SCALE, config.seed)
    record, buffer, start = Record(scene), [], time.perf_counter()
    bar = tqdm(total=config.steps, unit=" steps", file=sys.stderr, mininterval=0.5)
    try:
        while record.steps < config.steps:
            record.steps += config.robots
            bar.update(config.robots)
            for episode, info in collector.step():
                folder.add_row("episodes.csv", record.add(info))
                if not info["new"]:  # what happens on the way to a new target is never learnt from
                    buffer.append(episode)
                if record.rule_is_met():
                    break
            if record.rule_is_met():
                break
            if len(buffer) >= config.episodes_per_update:  # N of them stored
                statistics = update(model, optimizer, buffer, config, rng)
                buffer.clear()
                speed = round(record.steps / (time.perf_counter() - start), 1)
                folder.add_row("updates.csv", {"steps": record.steps, **statistics,
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
        "stopped_by_rule": record.rule_is_met(), "rolling_new_success": record.success("new"),
        "frozen": None}


def main(argv=None):
    """The command line: train, save, evaluate the frozen policy, summarise."""
    config, parser = read_config(argv)
    try:
        scene = load_scene(config.env)
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
        summary["frozen"] = evaluate(model, scene, config.evaluation_episodes, seed=config.seed)
        by_mean = evaluate(model, scene, actions="mean")
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
