"""Measures the effect of single lines of the learner: `python -m classroom.deltas`. Each delta
trains in env1 with three seeds. A run that results/deltas.csv already contains is skipped."""

from itertools import product
from pathlib import Path

import torch
from matplotlib.figure import Figure

import scenes
from evaluation import Policy, evaluate
from support.cli import parse
from support.pictures import PALETTE, WIDTH, save
from support.runs import read_table, write
from train import WINDOW, Config, Training, train

PICTURES = Path(__file__).parent.parent / "pictures"
RESULT = PICTURES.parent / "results" / "deltas.csv"
STEPS = 120_000
SEEDS = ("0", "1", "2")
EPISODES = 300  # of the frozen evaluation
LESSON = "the lesson"
DELTAS = {  # name -> title, options of the training
    LESSON: (LESSON, {}),
    "lambda": ("lambda = 1 (no GAE)", {"lam": 1.0}),
    "clipping": ("no clipping", {"clip": 1e9})}
COMPARED = ("lambda", "clipping")  # each with the lesson


class Recorded(Training):
    """A Training that also lists the success rate and the steps after each training episode."""

    def record(self, row):
        super().record(row)
        if row["kind"] == "training":
            self.rates.append({"steps": row["steps"], "success": self.success("training")})


def learn(name, seed):
    """Trains once. Returns a row of RESULT per WINDOW training episodes: `success` is their success
    rate, `frozen` that of the final policy with random starts and random targets."""
    _, options = DELTAS[name]
    config = Config(env="env1", seed=int(seed), steps=STEPS, fixed_budget=True, **options)
    training = Recorded(config, [scenes.load("env1")])
    training.rates = []
    train(training)
    driver = Policy(training.model, "mean", config.seed)
    result, _ = evaluate(driver, training.scenes, EPISODES, "anywhere")
    return [{"delta": name, "seed": seed, **rate, "frozen": round(result["anywhere"]["success"], 3)}
            for rate in training.rates[WINDOW - 1::WINDOW]]


def draw(rows, name):
    """Returns a Figure of the success rates of the lesson and of a delta."""
    axes = Figure(figsize=(WIDTH, 3.4), layout="constrained").subplots()
    for delta, colour in ((LESSON, PALETTE["paper"]), (name, PALETTE["run"])):
        for seed, style in zip(SEEDS, ("-", "--", ":")):
            points = [(int(row["steps"]), 100 * float(row["success"])) for row in rows
                      if (row["delta"], row["seed"]) == (delta, seed)]
            axes.plot(*zip(*points), color=colour, ls=style, lw=1.8,
                      label=DELTAS[delta][0] if seed == SEEDS[0] else None)
    axes.set(title=f"env1, three seeds: {LESSON} and {DELTAS[name][0]}", ylim=(-2, 103),
             xlabel="steps, summed over robots",
             ylabel=f"success rate, training targets,\nlast {WINDOW} episodes [%]")
    axes.grid(alpha=0.3)
    axes.legend(frameon=False, loc="lower right")
    return axes.figure


def main(argv=None):
    """Trains the runs that RESULT does not contain, and draws all of them."""
    parse({}, "Train variants of the lesson and draw them.", argv)
    torch.set_num_threads(1)
    rows = read_table(RESULT) if RESULT.exists() else []
    done = {(row["delta"], row["seed"]) for row in rows}
    for run in product(DELTAS, SEEDS):
        if run not in done:
            rows += learn(*run)
            lines = [",".join(map(str, row.values())) for row in rows]
            write(RESULT, "\n".join([",".join(rows[0]), *lines]) + "\n")
    for name in COMPARED:
        save(draw(rows, name), PICTURES / f"delta-{name}.png")
        print(f"pictures/delta-{name}.png")


if __name__ == "__main__":
    main()
