"""What a training leaves when it is over: weights, curves, the frozen policy's evaluation, and a
summary, in its run folder and on the screen."""

import json
import sys

from evaluation.drivers import Policy
from evaluation.examine import evaluate, report
from support.cores import available_cores
from support.pictures import draw_curves
from support.weights import save_model


def finish(folder, training, scenes, stop_rate):
    """Saves the run, evaluates its policy and writes the summary.

    training: what `train.train` has brought to its end.
    """
    config = training.config
    model = training.model
    episodes = training.record.episodes
    summary = {"env": scenes[0].name, "seed": config.seed, "steps": training.record.steps,
               "episodes": len(episodes), "seconds": round(training.record.seconds, 2),
               "stopped_by_rule": training.stopped_by_rule(),
               "rolling_new_success": training.record.success("new"), "frozen": None}
    save_model(folder.path / "model.pt", model, scenes)
    curves = draw_curves(episodes, summary["env"], stop_rate)
    folder.write("curves.png", lambda file: curves.savefig(file, format="png", dpi=110))
    folder.write("summary.json", json.dumps(summary, indent=2))
    print("evaluating the frozen policy on fresh episodes ...", file=sys.stderr)
    # On this machine's cores: the other processes of a training may be on others, or on GPUs.
    workers = min(config.workers, len(available_cores()))
    summary["frozen"] = evaluate_frozen(model.cpu(), scenes, config.evaluation_episodes,
                                        config.seed, workers)
    folder.write("evaluation.json", json.dumps(summary["frozen"], indent=2))
    folder.write("summary.json", json.dumps(summary, indent=2))
    print(report(summary), file=sys.stderr if config.json else sys.stdout)
    if config.json:
        print(json.dumps(summary, indent=2))
    folder.close()


def evaluate_frozen(model, scenes, episodes, seed, workers):
    """What `evaluation.json` holds: fresh episodes with sampled actions, as in training, and
    whether the deterministic (mean) action arrives: from one start pose each episode is the same.
    """
    frozen, _ = evaluate(Policy(model, "sampled", seed), scenes, episodes, seed=seed,
                         workers=workers)
    by_mean, _ = evaluate(Policy(model, "mean", seed), scenes, 1)
    for target, mean in zip(frozen["targets"], by_mean["targets"]):
        target["mean_action_arrives"] = mean["success"] == 1
    return frozen
