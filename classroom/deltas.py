"""Measures what single lines of the learner are good for: `python -m classroom.deltas`. Three seeds
of each delta train in env1. A run that results/deltas.csv has is not made again."""

from functools import partial
from itertools import product
from pathlib import Path

import numpy as np
import torch
from matplotlib.figure import Figure

import scenes
from evaluation import Policy, evaluate
from navbot_min import NavVecEnv
from support.cli import parse
from support.pictures import PALETTE, WIDTH, save
from support.runs import read_table, write
from train import WINDOW, Config, Training, train

PICTURES = Path(__file__).parent.parent / "pictures"
RESULT = PICTURES.parent / "results" / "deltas.csv"
STEPS = 120_000
SEEDS = ("0", "1", "2")
EPISODES = 300  # of the frozen evaluation


class TimeLimitsAreFailures(NavVecEnv):
    """Running out of time terminates an episode: no more rewards are expected."""

    def step(self, actions):
        observations, rewards, terminated, truncated, infos = super().step(actions)
        return observations, rewards, terminated | truncated, np.zeros_like(truncated), infos


LESSON = "the lesson"
DELTAS = {  # name -> title, options of the training, environment
    LESSON: (LESSON, {}, NavVecEnv),
    "lambda": ("lambda = 1: no GAE", {"lam": 1.0}, NavVecEnv),
    "clipping": ("no clipping", {"clip": 1e9}, NavVecEnv),
    # 40 steps take 16 s. In 200 steps hardly any episode of env1 times out.
    "short": ("the lesson with episodes of 40 steps", {}, partial(NavVecEnv, max_episode_steps=40)),
    "time-limits": ("the same, and running out of time is a failure", {},
                    partial(TimeLimitsAreFailures, max_episode_steps=40))}
COMPARED = {"lambda": LESSON, "clipping": LESSON, "time-limits": "short"}  # delta -> with what


class Recorded(Training):
    """Keeps the success rate, and its steps, after each training episode, in a list."""

    def record(self, row):
        super().record(row)
        if row["kind"] == "training":
            self.rates.append({"steps": row["steps"], "success": self.success("training")})


def learn(name, seed):
    """Trains once. Returns a row of RESULT for every WINDOW training episodes: `success` is theirs,
    `frozen` that of the last policy from random starts to random targets."""
    _, options, environment = DELTAS[name]
    config = Config(env="env1", seed=int(seed), steps=STEPS, fixed_budget=True, **options)
    training = Recorded(config, [scenes.load("env1")])
    training.environment = environment
    training.rates = []
    train(training)
    driver = Policy(training.model, "mean", config.seed)
    result, _ = evaluate(driver, training.scenes, EPISODES, "anywhere")
    return [{"delta": name, "seed": seed, **rate, "frozen": round(result["anywhere"]["success"], 3)}
            for rate in training.rates[WINDOW - 1::WINDOW]]


def draw(rows, name):
    """Returns a Figure of the success rates of a delta, and of what it is compared with."""
    axes = Figure(figsize=(WIDTH, 3.4), layout="constrained").subplots()
    for delta, colour in ((COMPARED[name], PALETTE["paper"]), (name, PALETTE["run"])):
        for seed, style in zip(SEEDS, ("-", "--", ":")):
            points = [(int(row["steps"]), 100 * float(row["success"])) for row in rows
                      if (row["delta"], row["seed"]) == (delta, seed)]
            axes.plot(*zip(*points), color=colour, ls=style, lw=1.8,
                      label=DELTAS[delta][0] if seed == SEEDS[0] else None)
    axes.set(xlabel="steps of all robots together", ylim=(-2, 103),
             ylabel=f"success on training targets,\nlast {WINDOW} episodes [%]")
    axes.legend(frameon=False, loc="lower right")
    return axes.figure


def main(argv=None):
    """Trains the runs that RESULT lacks, and draws all of them."""
    parse({}, "Train variants of the lesson and draw them.", argv)
    torch.set_num_threads(1)
    rows = read_table(RESULT) if RESULT.exists() else []
    made = {(row["delta"], row["seed"]) for row in rows}
    for run in product(DELTAS, SEEDS):
        if run not in made:
            rows += learn(*run)
            lines = [",".join(map(str, row.values())) for row in rows]
            write(RESULT, "\n".join([",".join(rows[0]), *lines]) + "\n")
    for name in COMPARED:
        save(draw(rows, name), PICTURES / f"delta-{name}.png")
        print(f"pictures/delta-{name}.png")


if __name__ == "__main__":
    main()
