"""The end of a training run: curves, evaluation of the frozen policy, summary."""

import json
import sys
from pathlib import Path

from evaluation.drivers import Policy
from evaluation.examine import evaluate, report
from support.pictures import draw_curves, save
from support.rooms import RANDOM
from support.runs import read_table, write


def finish(training, stop_rate):
    """Writes curves, evaluation and summary of a Training. stop_rate: r of Algorithm 1."""
    config = training.config
    folder = Path(config.out)
    summary = {"env": RANDOM if config.env == RANDOM else training.scenes[0].name,
               "seed": config.seed, "steps": training.steps, "episodes": training.episodes,
               "seconds": round(training.seconds, 2), "stopped_by_rule": training.stops_by_rule(),
               "rolling_new_success": training.success("new"), "frozen": None}
    write(folder / "summary.json", json.dumps(summary, indent=2))
    episodes = read_table(folder / "episodes.csv")
    save(draw_curves(episodes, summary["env"], stop_rate, config.targets), folder / "curves.png")
    print("evaluating the frozen policy on fresh episodes ...", file=sys.stderr)
    evaluate_rooms = evaluate_many if config.targets == "anywhere" else evaluate_frozen
    summary["frozen"] = evaluate_rooms(training)
    write(folder / "evaluation.json", json.dumps(summary["frozen"], indent=2))
    write(folder / "summary.json", json.dumps(summary, indent=2))
    text = report(summary, len(training.arrivals["new"]))
    print(text, file=sys.stderr if config.json else sys.stdout)
    if config.json:
        print(json.dumps(summary, indent=2))


def evaluate_policy(training, scenes, actions, protocol, episodes=None):
    """Returns the result of `evaluate` for the policy of a Training."""
    config = training.config
    workers = 0 if config.device == "cpu" else 1  # a process with a GPU must not fork
    return evaluate(Policy(training.model.cpu(), actions, config.seed), scenes,
                    episodes or config.evaluation_episodes, protocol, config.seed, actions,
                    environment=training.environment, workers=workers)[0]


def evaluate_many(training):
    """Evaluates level 3, deterministic actions, in the last training rooms and in new rooms."""
    frozen = {"protocol": "anywhere", "actions": "mean", "hidden": "", "training": None,
              "new": None, "targets": []}
    for kind, scenes in training.rooms.by_kind(training.stage).items():
        if scenes:
            frozen[kind] = evaluate_policy(training, scenes, "mean", "anywhere")["anywhere"]
    return frozen


def evaluate_frozen(training):
    """Evaluates levels 1 and 2 with sampled actions, and one deterministic one per target."""
    frozen = evaluate_policy(training, training.scenes, "sampled", "start")
    by_mean = evaluate_policy(training, training.scenes, "mean", "start", episodes=1)
    for target, mean in zip(frozen["targets"], by_mean["targets"]):
        target["mean_action_arrives"] = mean["success"] == 1
    return frozen
