"""Trains and examines everything that the README's tables and figures show.

`python results.py` trains each room, way and seed for a fixed budget of steps, two runs at a time
with a core each, evaluates the frozen last policies, and writes `results/*.csv` and the figures.
A run that is there already is not trained again: interrupted, it goes on with the next one.
`--draw` makes the figures alone, from the tables.
"""

import csv
import json
import os
import shutil
import subprocess
import sys
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from itertools import chain, product
from pathlib import Path

import numpy as np

from command_line import CommandLine, option
from evaluate import HIDDEN, PATCH, Planned, Policy, evaluate, load_run, rollouts, summarise, watch
from pictures import (draw_floors, draw_learning, draw_memorizing_reasoning, draw_trajectories,
                      read_table, write_episode)
from planners import PLANNERS
from scene_file import load_scene

HERE = Path(__file__).parent
RESULTS, RUNS = HERE / "results", Path("runs") / "results"
BUDGET = {"env1": 250_000, "env2": 400_000}  # steps, new targets' included
WAYS = {"paper": ["--random-starts", "0", "--mirrored", "0"], "varied": []}  # five seeds of each
ABLATIONS = {"single": ["--memory", "single"], "none": ["--memory", "none"],
             "blind": ["--without", "image"], "no-target": ["--without", "target"],
             "no-last": ["--without", "last"], "one-room": ["--mirrored", "0"]}  # three seeds each
PAPER = {("env1", "new"): "81 %", ("env2", "new"): "69 %",  # "ultimate" success rates, paper IV-B
         ("env1", "training"): "> 75 %", ("env2", "training"): "62 %"}  # and the released record's


@dataclass
class Options:
    """What to make."""
    draw: bool = option(False, "draw the figures from the tables, train nothing")
    ablations: bool = option(False, "train the ablations too, seeds 0 to 2")
    planners: bool = option(False, "examine the planners, train nothing")
    jobs: int = option(2, "runs at a time, a core each", 1)


def call(script, *arguments):
    """Runs a script of ours on one core, in a session of its own: Ctrl-C does not cut it short."""
    subprocess.run([sys.executable, str(HERE / script), *map(str, arguments)], check=True,
                   env=os.environ | {"OMP_NUM_THREADS": "1"}, capture_output=True,
                   start_new_session=True)


def run(env, way, seed):
    """Trains and examines one run, unless that is done; returns its row of the table."""
    folder = RUNS / f"{env}-{way}-seed{seed}"
    if not (folder / "evaluation-anywhere.json").exists():
        shutil.rmtree(folder, ignore_errors=True)
        call("train.py", "--env", env, "--seed", seed, "--fixed-budget", "--steps", BUDGET[env],
             *(WAYS | ABLATIONS)[way], "--out", folder)
        call("evaluate.py", folder, "--protocol", "anywhere", "--episodes", 500)
        print(f"{folder} done", flush=True)
    summary = json.loads((folder / "summary.json").read_text())
    anywhere = json.loads((folder / "evaluation-anywhere.json").read_text())["anywhere"]
    row = {"env": env, "way": way, "seed": seed}
    row |= {key: summary[key] for key in ("steps", "episodes", "seconds")}
    for kind, result in (*((kind, summary["frozen"][kind]) for kind in ("training", "new")),
                         ("anywhere", anywhere)):
        row |= {f"{kind}_{key}": round(result[key], 4)
                for key in ("success", "low", "high", "collision", "timeout", "spl")}
    arrive = [target["mean_action_arrives"] for target in summary["frozen"]["targets"]]
    return row | {"mean_action_arrives": f"{sum(arrive)} of {len(arrive)}"}


def hide(env, way, seed):
    """Examines that run's policy with its target hidden, unless that is done; returns its rows of
    hidden.csv, one for each thing that is hidden."""
    rows, folder = [], RUNS / f"{env}-{way}-seed{seed}"
    for hidden in HIDDEN[1:]:
        result = folder / f"evaluation-hidden-{hidden}.json"
        if not result.exists():
            call("evaluate.py", folder, "--hide", hidden, "--episodes", 200)
        result = json.loads(result.read_text())
        rows.append({"env": env, "way": way, "seed": seed, "hidden": hidden} | {
            f"{kind}_{key}": round(result[kind][key], 4) for kind in ("training", "new")
            for key in ("n", "success", "low", "high", "collision", "timeout")})
    return rows


def validate(env, way, seed):
    """Examines that run's policy on validation targets, unless that is done; returns its rows of
    floor.csv, one for each of them."""
    folder = RUNS / f"{env}-{way}-seed{seed}"
    result = folder / "evaluation-validation.json"
    if not result.exists():
        call("evaluate.py", folder, "--protocol", "validation", "--episodes", 300)
    return [{"env": env, "way": way, "seed": seed} | {key: round(target[key], 4) for key in (
        "x", "y", "n", "success", "collision", "timeout")}
            for target in json.loads(result.read_text())["targets"]
            if target["kind"] == "validation"]


def curve(env, way, seed, every=50):
    """Rows of curves.csv: success of the last 100 episodes and mean return of the last 100, each
    `every` episodes to targets of a kind."""
    rows, points = {"training": [], "new": []}, []
    with open(RUNS / f"{env}-{way}-seed{seed}" / "episodes.csv", newline="") as file:
        for row in csv.DictReader(file):
            kind = rows[row["kind"]]
            kind.append((row["outcome"] == "arrival", float(row["return"])))
            if len(kind) >= 100 and len(kind) % every == 0:
                success, reward = np.mean(kind[-100:], axis=0)
                points.append({"env": env, "way": way, "seed": seed, "kind": row["kind"],
                               "steps": row["steps"], "episodes": len(kind),
                               "success": round(success, 2), "return": round(reward, 1)})
    return points


def examine(env, name):
    """A planner's row of planners.csv: one episode to each target from the paper's start, and 50
    from anywhere to anywhere."""
    scene, row = load_scene(env), {"env": env, "planner": name}
    for protocol, episodes in (("paper", 1), ("anywhere", 50)):
        done = evaluate(Planned(name, scene, 0), scene, episodes, protocol)[1]
        result = summarise(scene, done)
        row |= {f"{protocol}_{key}": round(result[key], 4) for key in (
            "n", "success", "low", "high", "collision", "timeout", "spl")}
    return row


def write_table(name, rows):
    with open(RESULTS / name, "w", newline="") as file:
        writer = csv.DictWriter(file, rows[0])
        writer.writeheader()
        writer.writerows(rows)


def draw_paths(env):
    """Fig. 6: the paths of seed 0's policy, 20 episodes to each target."""
    model, scene = load_run(HERE / "pretrained" / f"{env}.pt")
    episodes = rollouts(Policy(model, "sampled", 0), scene, [20] * len(scene.targets))
    return draw_trajectories(scene, episodes)


def film(env):
    """The README's film: an episode of seed 0's policy to the last of the new targets."""
    model, scene = load_run(HERE / "pretrained" / f"{env}.pt")
    frames = watch(Policy(model, "sampled", 0), scene, len(scene.targets) - 1)
    write_episode(scene, scene.targets[-1], frames, HERE / "pictures" / "episode.gif")


def summary_markdown(rows, others, floor):
    """The README's first table: the paper's numbers, and the mean and the worst of our five seeds,
    twice: here, and the same on another machine, which has no validation targets."""
    lines = ["| protocol `paper` unless said | paper, one run | " + " | ".join(
        f"`{way}`, {where}" for way in WAYS for where in ("mean (worst)", "other machine"))
        + " |", "|---" * 6 + "|"]
    spots = [{"env": env, "way": way, "validation_success": np.mean([
        float(row["success"]) for row in floor
        if (row["env"], row["way"], row["seed"]) == (env, way, seed)])}
        for env, way, seed in product(BUDGET, WAYS, "01234")]
    for kind, name in (("new", "new targets"), ("training", "training targets"),
                       ("validation", "`validation`"), ("anywhere", "`anywhere`")):
        for env in BUDGET:
            cells = [f"{env}, {name}", PAPER.get((env, kind), "-")]
            for way, table in product(WAYS, (rows + spots, others)):
                reached = [100 * float(row[f"{kind}_success"]) for row in table
                           if (row["env"], row["way"]) == (env, way) and f"{kind}_success" in row]
                cells.append(f"{np.mean(reached):.1f} % ({min(reached):.1f} %)" if reached else "-")
            lines.append("| " + " | ".join(cells) + " |")
    return "\n".join(lines)


def markdown(rows):
    """The README's table: each room and way, worst seed first."""
    lines = ["| room | way | seed | training targets [95 %] | new targets [95 %] | SPL, new "
             "| from anywhere to anywhere | mean action arrives at |", "|---" * 8 + "|"]
    for env in BUDGET:
        for way in dict.fromkeys(row["way"] for row in rows):
            chosen = [row for row in rows if (row["env"], row["way"]) == (env, way)]
            for row in sorted(chosen, key=lambda row: float(row["new_success"])):
                training, new = (
                    "{:.1f} % [{:.1f}, {:.1f}]".format(*(100 * float(row[f"{kind}_{key}"])
                                                         for key in ("success", "low", "high")))
                    for kind in ("training", "new"))
                lines.append(f"| {env} | {way} | {row['seed']} | {training} | {new} "
                             f"| {float(row['new_spl']):.2f} "
                             f"| {100 * float(row['anywhere_success']):.1f} % "
                             f"| {row['mean_action_arrives']} |")
            if chosen:
                mean = {key: np.mean([float(row[key]) for row in chosen]) for key in (
                    "training_success", "new_success", "new_spl", "anywhere_success")}
                lines.append(f"| {env} | {way} | **mean** "
                             f"| **{100 * mean['training_success']:.1f} %** "
                             f"| **{100 * mean['new_success']:.1f} %** | {mean['new_spl']:.2f} "
                             f"| {100 * mean['anywhere_success']:.1f} % | |")
    return "\n".join(lines)


def ablations_markdown(rows, others):
    """The README's table of the ablations beside the whole network: seeds 0 to 2, worst first and
    their mean, here and on the other machine."""
    lines = ["| room | network | new targets | other machine | training | other machine "
             "| `anywhere` | other machine |", "|---" * 8 + "|"]
    for env, way in product(BUDGET, ("varied", *ABLATIONS)):
        cells = []
        for kind, table in product(("new", "training", "anywhere"), (rows, others)):
            reached = sorted(100 * float(row[f"{kind}_success"]) for row in table
                             if (row["env"], row["way"]) == (env, way) and row["seed"] in "012")
            seeds = ", ".join(f"{x:.0f}" for x in reached) + ": " if kind != "training" else ""
            cells.append(f"{seeds}**{np.mean(reached):.1f}**" if reached else "-")
        lines.append(f"| {env} | {way} | " + " | ".join(cells) + " |")
    return "\n".join(lines)


def hidden_markdown(rows, seeds):
    """The README's table of hidden targets: each room, way and kind of target, seeds 0 to 4."""
    lines = ["| room | way | targets | " + " | ".join(
        f"{name} hidden" for name in ("nothing", *HIDDEN[1:])) + " |", "|---" * 7 + "|"]
    rows = [row | {"hidden": ""} for row in seeds] + rows
    for env, way, kind in product(BUDGET, WAYS, ("new", "training")):
        cells = [", ".join(f"{100 * float(row[f'{kind}_success']):.0f}" for row in sorted(
            rows, key=lambda row: row["seed"]) if (row["env"], row["way"], row["hidden"])
            == (env, way, hidden)) for hidden in HIDDEN]
        lines.append(f"| {env} | {way} | {kind} | " + " | ".join(cells) + " |")
    return "\n".join(lines)


def planners_markdown(rows, seeds):
    """The README's table of the planners, and of the learner beside them: `varied`, mean actions,
    the worst or the mean of the seeds."""
    lines = ["| planner | env1, targets reached | env2, targets reached | env1, anywhere, SPL "
             "| env2, anywhere, SPL |", "|---" * 5 + "|"]
    for name in PLANNERS:
        paper, anywhere = [], []
        for row in (row for row in rows if row["planner"] == name):
            n = int(row["paper_n"])
            paper.append(f"{round(n * float(row['paper_success']))} of {n}")
            anywhere.append("{:.1f} % [{:.1f}, {:.1f}], {:.2f}".format(
                *(100 * float(row[f"anywhere_{key}"]) for key in ("success", "low", "high")),
                float(row["anywhere_spl"])))
        lines.append(f"| {name} | " + " | ".join(paper + anywhere) + " |")
    learner = [[row for row in seeds if (row["env"], row["way"]) == (env, "varied")]
               for env in BUDGET]
    paper = [min((row["mean_action_arrives"] for row in chosen), key=lambda text: int(
        text.split()[0])) for chosen in learner]
    for chosen in learner:
        success, spl = ([float(row[f"anywhere_{key}"]) for row in chosen]
                        for key in ("success", "spl"))
        paper.append("{:.1f} % (seeds {:.1f} to {:.1f}), {:.2f}".format(
            *(100 * f(success) for f in (np.mean, min, max)), np.mean(spl)))
    return "\n".join([*lines, "| **learner** | " + " | ".join(paper) + " |"])


def train_all(jobs, ablations):
    """Trains and examines every run, so many at a time, and writes the tables and the weights."""
    tasks = [(env, way, seed) for way in WAYS for seed in range(5) for env in BUDGET]
    more = [(env, way, seed) for env in BUDGET for seed in range(3) for way in ABLATIONS]
    with ThreadPoolExecutor(jobs) as pool:
        tables = {"seeds.csv": list(pool.map(run, *zip(*tasks))),
                  "hidden.csv": chain(*pool.map(hide, *zip(*tasks))),
                  "floor.csv": chain(*pool.map(validate, *zip(*tasks))),
                  "curves.csv": chain(*(curve(*task) for task in tasks))}
        if ablations:
            tables["ablations.csv"] = pool.map(run, *zip(*more))
        for name, rows in tables.items():
            write_table(name, list(rows))
    (HERE / "pretrained").mkdir(exist_ok=True)
    for env in BUDGET:  # seed 0's, whichever seed is the best
        shutil.copy(RUNS / f"{env}-varied-seed0" / "model.pt", HERE / "pretrained" / f"{env}.pt")


def draw_all():
    """Draws the figures from the tables, and prints the README's tables."""
    seeds, curves, floor, hidden, ablations, others = (
        read_table(RESULTS / f"{name}.csv")
        for name in ("seeds", "curves", "floor", "hidden", "ablations", "other-machine"))
    figures = {"memorizing-reasoning": draw_memorizing_reasoning(curves, seeds),
               "fig4": draw_learning(curves, "env1"), "fig5": draw_learning(curves, "env2"),
               "floor": draw_floors(floor, [load_scene(env) for env in BUDGET], PATCH),
               **{f"fig6-{env}": draw_paths(env) for env in BUDGET}}
    for name, figure in figures.items():
        figure.savefig(HERE / "pictures" / f"{name}.png", dpi=110)
    film("env1")
    print(summary_markdown(seeds, others, floor), markdown(seeds), hidden_markdown(hidden, seeds),
          ablations_markdown(seeds + ablations, others), sep="\n\n")


def main(argv=None):
    """The command line."""
    parser = CommandLine("Make every table and figure of the results.")
    options = parser.read(Options, argv)
    if options.planners:
        rows = [examine(env, name) for name in PLANNERS for env in BUDGET]
        write_table("planners.csv", rows)
        return print(planners_markdown(rows, read_table(RESULTS / "seeds.csv")))
    try:
        if not options.draw:
            train_all(options.jobs, options.ablations)
        draw_all()
    except KeyboardInterrupt:
        parser.error("interrupted: the runs under way are finished, no other is begun")
    except subprocess.CalledProcessError as error:
        reason = error.stderr.decode().strip().splitlines()[-1]
        parser.error(f"'{' '.join(error.cmd[1:])}' failed: {reason}")


if __name__ == "__main__":
    main()
