"""What a training leaves when it is over: weights, curves, the frozen policy's evaluation, and a
summary, in its run folder and on the screen."""

import json
import sys

from evaluation.drivers import Policy
from evaluation.examine import evaluate, report
from robot.environment import environment_of
from support.cores import available_cores
from support.pictures import draw_curves
from support.rooms import RANDOM
from support.weights import save_model


def finish(folder, training, scenes, stop_rate):
    """Saves the run, evaluates its policy and writes the summary.

    training: what `train.train` has brought to its end.
    """
    config = training.config
    model = training.model
    episodes = training.record.episodes
    name = RANDOM if config.env == RANDOM else scenes[0].name
    summary = {"env": name, "seed": config.seed, "steps": training.record.steps,
               "episodes": len(episodes), "seconds": round(training.record.seconds, 2),
               "stopped_by_rule": training.stopped_by_rule(),
               "rolling_new_success": training.record.success("new"), "frozen": None}
    save_model(folder.path / "model.pt", model, scenes)
    curves = draw_curves(episodes, summary["env"], stop_rate, config.targets)
    folder.write("curves.png", lambda file: curves.savefig(file, format="png", dpi=110))
    folder.write("summary.json", json.dumps(summary, indent=2))
    print("evaluating the frozen policy on fresh episodes ...", file=sys.stderr)
    # On this machine's cores: the other processes of a training may be on others, or on GPUs.
    workers = min(config.workers, len(available_cores()))
    summary["frozen"] = evaluate_task(training, scenes, workers)
    folder.write("evaluation.json", json.dumps(summary["frozen"], indent=2))
    folder.write("summary.json", json.dumps(summary, indent=2))
    print(report(summary), file=sys.stderr if config.json else sys.stdout)
    if config.json:
        print(json.dumps(summary, indent=2))
    folder.close()


def evaluate_task(training, scenes, workers):
    """What `evaluation.json` holds, by the task that was trained."""
    config = training.config
    model = training.model.cpu()
    if config.targets == "anywhere":
        return evaluate_rooms(model, training.rooms, config, workers)
    environment = environment_of(scenes, config.ring, config.reality)
    return evaluate_frozen(model, scenes, config.evaluation_episodes, config.seed, workers,
                           environment)


def evaluate_rooms(model, rooms, config, workers):
    """Level 3: fresh episodes from anywhere to anywhere by deterministic actions, in the rooms that
    the last episodes were driven in, and in those that no episode was learnt from."""
    frozen = {"protocol": "anywhere", "actions": "mean", "hidden": "", "training": None,
              "new": None, "targets": []}
    for kind, scenes in rooms.by_kind().items():
        if scenes:
            environment = environment_of(scenes, config.ring, config.reality)
            result, _ = evaluate(Policy(model, "mean", config.seed), scenes,
                                 config.evaluation_episodes, "anywhere", config.seed,
                                 environment=environment, workers=workers)
            frozen[kind] = result["anywhere"]
    return frozen


def evaluate_frozen(model, scenes, episodes, seed, workers, environment=None):
    """What `evaluation.json` holds: fresh episodes with sampled actions, as in training, and
    whether the deterministic (mean) action arrives: from one start pose each episode is the same.
    """
    frozen, _ = evaluate(Policy(model, "sampled", seed), scenes, episodes, seed=seed,
                         environment=environment, workers=workers)
    by_mean, _ = evaluate(Policy(model, "mean", seed), scenes, 1, environment=environment)
    for target, mean in zip(frozen["targets"], by_mean["targets"]):
        target["mean_action_arrives"] = mean["success"] == 1
    return frozen
