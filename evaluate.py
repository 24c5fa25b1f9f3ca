"""What a frozen policy can do: fresh episodes, outcomes, intervals; and the curves of training."""

import csv
import math
from pathlib import Path

import numpy as np
import torch
from matplotlib.figure import Figure

from navbot_min import CONTROL_PERIOD, OUTCOMES, NavVecEnv

EPISODES_PER_ROBOT = 8  # at most; the robots of all targets drive side by side
Z95 = 1.959963984540054  # standard normal quantile of a two-sided 95 % interval
SPACING = {"env1": {"training": 200, "new": 100},  # episodes between the points of Fig. 4 and 5
           "env2": {"training": 500, "new": 100}}
PAPER_CURVES = Path(__file__).parent / "paper_curves.csv"


def wilson(successes, n):
    """The 95 % interval (low, high) of a proportion (Wilson 1927). n = 0 gives (0, 1)."""
    if n == 0:
        return 0.0, 1.0
    p, z2 = successes / n, Z95 ** 2
    centre, spread = p + z2 / (2 * n), Z95 * math.sqrt(p * (1 - p) / n + z2 / (4 * n * n))
    return max(0.0, (centre - spread) / (1 + z2 / n)), min(1.0, (centre + spread) / (1 + z2 / n))


def rollouts(model, scene, quotas, actions, seed):
    """Drives `quotas[k]` episodes to target k, for every k; returns their infos, one dict each.

    Which episodes count is fixed before they start, by a quota per robot: counting the first n that
    finish would favour short collisions. actions: "sampled" or "mean".
    """
    targets, quota = [], []
    for k, n in enumerate(quotas):
        robots = math.ceil(n / EPISODES_PER_ROBOT)
        targets += [k] * robots
        quota += [n // robots + (i < n % robots) for i in range(robots)]
    env, quota = NavVecEnv(len(targets), scene, targets=targets), np.array(quota)
    generator = torch.Generator().manual_seed(seed)
    observations, _ = env.reset(seed=seed)
    state, episodes = model.initial_state(len(targets)), []
    while quota.any():
        mean, sampled, _, _, state = model.act(observations, state, generator)
        chosen = sampled if actions == "sampled" else mean
        observations, _, terminated, truncated, infos = env.step(chosen.numpy())
        for r in np.flatnonzero(terminated | truncated):
            state[r] = 0
            if quota[r]:
                quota[r] -= 1
                info = infos["final_info"]
                episodes.append({key: value[r].item() for key, value in info.items()})
    return episodes


def summarise(episodes):
    """Outcomes of those episodes as fractions that sum to 1, success with its 95 % interval, and
    the mean time to arrive [s], None where none arrived. `spl` is not computed yet."""
    n = len(episodes)
    counts = {name: sum(e["outcome"] == name for e in episodes) for name in OUTCOMES}
    low, high = wilson(counts["arrival"], n)
    times = [e["length"] * CONTROL_PERIOD for e in episodes if e["outcome"] == "arrival"]
    return {"n": n, "success": counts["arrival"] / n, "low": low, "high": high,
            "collision": counts["collision"] / n, "timeout": counts["timeout"] / n, "spl": None,
            "seconds_to_arrive": sum(times) / len(times) if times else None}


def evaluate(model, scene, episodes=1000, actions="sampled", seed=0):
    """Frozen evaluation by the paper's protocol: its fixed start, no learning, fresh episodes.

    episodes: so many of each kind, training and new, split evenly over its targets; with mean
    actions a fixed start gives one and the same episode each time, so one a target.
    Returns what `evaluation.json` holds.
    """
    counts = [len(scene.training_targets), len(scene.new_targets)]
    quotas = [max(1, episodes // count + (k < episodes % count))
              for count in counts for k in range(count)]
    if actions == "mean":
        quotas = [1] * len(quotas)
    done = rollouts(model, scene, quotas, actions, seed)
    return {"protocol": "paper", "actions": actions,
            "training": summarise([e for e in done if not e["new"]]),
            "new": summarise([e for e in done if e["new"]]),
            "targets": [{"x": float(x), "y": float(y),
                         "kind": "training" if k < counts[0] else "new",
                         **summarise([e for e in done if e["target"] == k])}
                        for k, (x, y) in enumerate(scene.targets)]}


def table(result):
    """An evaluation as lines of text: all targets of a kind, then a target a line."""
    lines = []
    for name, row in [(f"all {kind} targets", result[kind]) for kind in ("training", "new")] + [
            (f"{t['kind']} ({t['x']}, {t['y']})", t) for t in result["targets"]]:
        time = f"{row['seconds_to_arrive']:.1f} s" if row["seconds_to_arrive"] else "-"
        lines.append(f"{name:23}  success {row['success']:6.1%} [{row['low']:.1%}, "
                     f"{row['high']:.1%}]  collision {row['collision']:6.1%}"
                     f"  timeout {row['timeout']:6.1%}  arrives in {time}  n {row['n']}")
        if "mean_action_arrives" in row:
            lines[-1] += "  mean action " + ("arrives" if row["mean_action_arrives"] else "fails")
    return "\n".join(lines)


def report(summary):
    """What a training run says at its end: the rolling number that it stopped on and the frozen one
    side by side, then the table of the frozen evaluation."""
    why = "by the paper's rule" if summary["stopped_by_rule"] else "before the paper's rule was met"
    rolling, new = summary["rolling_new_success"], summary["frozen"]["new"]
    rolling = "no episode" if rolling is None else f"{rolling:.0%} of the last 100 episodes"
    return (f"stopped {why}: {summary['steps']:,} steps, {summary['episodes']:,} episodes, "
            f"{summary['seconds']:.0f} s\n"
            f"success on new targets: while training {rolling} | frozen {new['success']:.1%} "
            f"[{new['low']:.1%}, {new['high']:.1%}] of {new['n']:,} fresh episodes\n"
            + table(summary["frozen"]))


def draw_curves(episodes, env, stop_rate):
    """Fig. 4 and 5: success rate and average reward at the paper's spacing, its own curves behind.

    episodes: the rows of episodes.csv. stop_rate: the rate r of Algorithm 1. Returns a Figure.
    """
    with open(PAPER_CURVES, newline="") as file:
        paper = list(csv.DictReader(line for line in file if not line.startswith("#")))
    figure = Figure(figsize=(11, 7), layout="constrained")
    panels = figure.subplots(2, 2, sharey="row")
    for column, (kind, colour) in enumerate((("training", "#1f4fd8"), ("new", "#12913a"))):
        theirs = [row for row in paper if (row["env"], row["targets"]) == (env, kind)]
        rows = [row for row in episodes if row["kind"] == kind]
        window = SPACING.get(env, {}).get(kind, 100)
        ends = [*range(window, len(rows), window), len(rows)] if rows else []
        arrived = [row["outcome"] == "arrival" for row in rows]
        returns = [row["return"] for row in rows]
        ours = {"success_last_100": [100 * np.mean(arrived[max(0, n - 100):n]) for n in ends],
                "mean_return": [np.mean(returns[(n - 1) // window * window:n]) for n in ends]}
        for i, (key, label, scale) in enumerate((
                ("success_last_100", "success rate, last 100 episodes [%]", 100),
                ("mean_return", "average reward of an episode", 1))):
            axes = panels[i, column]
            axes.plot([float(point["episodes"]) for point in theirs],
                      [scale * float(point[key]) for point in theirs], color="#b0b0b0",
                      label="paper (released records)" if theirs else None)
            axes.plot(ends, ours[key], color=colour, marker="o", ms=3, label="this run")
            axes.set(xlabel=f"episodes to {kind} targets", ylabel=label if column == 0 else None)
            axes.grid(alpha=0.3)
        panels[0, column].axhline(100 * stop_rate, color="black", lw=0.8, ls="--")
        panels[0, column].set(title=f"{kind} targets", ylim=(-2, 102))
        panels[0, column].legend(loc="upper left")
    figure.suptitle(f"{env}: this run, and the paper's (dashed: the rate r at which it stops)")
    return figure
