"""What single lines of the learner are good for: `python -m classroom.deltas`.

Each delta is the lesson but for a line or two. It trains each with three seeds in env1, with the
paper's two training targets and from any start, and draws success against steps into
pictures/delta-*.png. A run that is there already is not trained again.
"""

import sys
from functools import partial
from pathlib import Path
from unittest.mock import patch

import numpy as np
from matplotlib.figure import Figure

import scenes
import train
from evaluation import Policy, evaluate
from navbot_min import NavVecEnv
from ppo import Collector
from support.command_line import CommandLine
from support.interruption import interruption
from support.pictures import PALETTE, WIDTH, read_table
from support.processes import OneProcess
from support.run_folder import WriteError, csv_text, write
from train import Config, Training

PICTURES = Path(__file__).parent.parent / "pictures"
RESULT = Path(__file__).parent.parent / "results" / "deltas.csv"
STEPS = 120_000
SEEDS = (0, 1, 2)
WINDOW = 100  # episodes that a point of a curve looks back on
EPISODES = 300  # of the frozen evaluation
LESSON = "the lesson"
SHORT = 40  # steps, 16 s


class TimeLimitsAreFailures(Collector):
    """Where time ran out nothing is expected to come, as if the episode had ended for good."""

    def _last_values(self, truncated, infos):
        return np.zeros(len(truncated))


class ShortTraining(Training):
    """Episodes of SHORT steps. With 200 nobody runs out of time in env1, and a time limit makes no
    difference at all."""

    def make_env(self, rooms):
        return NavVecEnv(len(rooms), rooms, self.config.targets, self.config.random_starts,
                         max_episode_steps=SHORT)


DELTAS = {  # name -> options of the training, the training, and the collector
    LESSON: ({}, Training, Collector),
    "lambda": ({"lam": 1.0}, Training, Collector),
    "clipping": ({"clip": 1e9}, Training, Collector),
    "short": ({}, ShortTraining, Collector),
    "time-limits": ({}, ShortTraining, TimeLimitsAreFailures)}
TITLES = {LESSON: LESSON, "lambda": "lambda = 1: no GAE", "clipping": "no clipping",
          "short": f"the lesson with {SHORT} steps an episode",
          "time-limits": "the same, and running out of time is a failure"}
COMPARED = {"lambda": LESSON, "clipping": LESSON, "time-limits": "short"}  # delta -> with what


def learn(name, seed, steps=STEPS):
    """A row for each WINDOW training episodes of one training: `delta`, `seed`, `steps`, `success`
    over these, and `frozen`, that of the policy at the end from anywhere to anywhere."""
    options, make, collector = DELTAS[name]
    config = Config(env="env1", seed=seed, steps=steps, fixed_budget=True, **options)
    scene = scenes.load("env1")
    with patch.object(train, "Collector", collector):
        training = make(config, [scene], OneProcess())
        train.train(training)
    result, _ = evaluate(Policy(training.model, "mean", seed), [scene], EPISODES, "anywhere")
    episodes = [row for row in training.record.episodes if row["kind"] == "training"]
    rows = []
    for end in range(WINDOW, len(episodes) + 1, WINDOW):
        arrived = [row["outcome"] == "arrival" for row in episodes[end - WINDOW:end]]
        rows.append({"delta": name, "seed": seed, "steps": episodes[end - 1]["steps"],
                     "success": round(float(np.mean(arrived)), 2),
                     "frozen": round(result["anywhere"]["success"], 3)})
    return rows


def draw(rows, name):
    """Success of a delta, and of what it is compared with, against steps, every seed. rows: of
    deltas.csv. Returns a Figure."""
    figure = Figure(figsize=(WIDTH, 3.4), layout="constrained")
    axes = figure.subplots()
    for delta, colour in ((COMPARED[name], PALETTE["paper"]), (name, PALETTE["run"])):
        for k, (seed, style) in enumerate(zip(map(str, SEEDS), ("-", "--", ":"))):
            own = [row for row in rows if row["delta"] == delta and row["seed"] == seed]
            axes.plot([int(row["steps"]) for row in own],
                      [100 * float(row["success"]) for row in own], color=colour, ls=style, lw=1.8,
                      label=TITLES[delta] if k == 0 else None)
    axes.set(xlabel="steps, all robots' together", ylim=(-2, 103),
             ylabel=f"success on training targets,\nlast {WINDOW} episodes [%]")
    axes.grid(alpha=0.3)
    axes.legend(frameon=False, loc="lower right")
    return figure


def learn_what_is_missing():
    """Trains the runs that are not in RESULT, and writes each into it when it is finished. Raises
    WriteError."""
    rows = read_table(RESULT) if RESULT.exists() else []
    made = {(row["delta"], row["seed"]) for row in rows}
    for name in DELTAS:
        for seed in SEEDS:
            if (name, str(seed)) in made:
                continue
            rows += learn(name, seed)
            write(RESULT, csv_text([rows[0], *(row.values() for row in rows)]).encode())


def main(argv=None):
    """The command line."""
    parser = CommandLine("Train what differs from the lesson by a line or two, and draw it.")
    parser.parse(argv)
    for folder in (RESULT.parent, PICTURES):
        parser.must_write_to(folder)
    interruption.handle("interrupted: the runs that are finished are kept")
    try:
        learn_what_is_missing()
        rows = read_table(RESULT)
        for name in COMPARED:
            write(PICTURES / f"delta-{name}.png", partial(draw(rows, name).savefig, dpi=110))
            print(f"pictures/delta-{name}.png")
    except WriteError as error:
        sys.exit(f"error: {error}")


if __name__ == "__main__":
    main()
