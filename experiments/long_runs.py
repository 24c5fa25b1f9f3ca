"""Long runs: whether memory and speed stay what they were, and whether the tables of a training are
whole after it.

`python -m experiments.long_runs` drives 32 robots at random for a million steps, then trains for
300,000, each in a process of its own, and writes `results/long-runs.json`: for each tenth of a run
the memory that the process held and the steps a second. Speed is that of the machine too: where
others use it, look for a trend that goes on over the tenths, not at single ones.
"""

import csv
import json
import multiprocessing
import subprocess
import sys
import tempfile
import time
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from navbot_min import NavVecEnv
from support.command_line import CommandLine, option
from support.run_folder import WriteError, write

ROOT = Path(__file__).parent.parent
ROBOTS = 32  # of the environment's run
INTERVAL = 0.5  # [s] from one look at a process to the next
TENTHS = 10


@dataclass
class Options:
    """How long the runs are."""
    env_steps: int = option(1_000_000, "steps of the environment, all robots' together",
                              1000, 10 ** 9)
    train_steps: int = option(300_000, "steps of the training, all robots' together", 10_000,
                              10 ** 9)
    out: str = option(str(ROOT / "results" / "long-runs.json"), "file that gets the figures")


def resident_megabytes(pid="self"):
    """The memory [MB] that a process holds now; 0 where the system does not tell, or it is gone."""
    try:
        status = Path(f"/proc/{pid}/status").read_text()
    except OSError:
        return 0.0
    kilobytes = [int(line.split()[1]) for line in status.splitlines() if line.startswith("VmRSS")]
    return kilobytes[0] / 1000 if kilobytes else 0.0


def in_tenths(samples):
    """What a run was like in each tenth of its steps, a dict each.

    samples: (steps so far, seconds so far, megabytes), in their order. Memory is the middle one and
    the highest one of a tenth's samples, None where it has none.
    """
    steps, seconds, megabytes = np.array(samples, dtype=float).T
    edges = np.linspace(steps[0], steps[-1], TENTHS + 1)
    at = np.interp(edges, steps, seconds)  # [s] when each tenth ends
    rows = []
    for k in range(TENTHS):
        held = megabytes[(edges[k] < steps) & (steps <= edges[k + 1])]
        rows.append({
            "steps": round(edges[k + 1]),
            "steps_per_second": round((edges[k + 1] - edges[k]) / (at[k + 1] - at[k]), 1),
            "memory_mb": round(float(np.median(held)), 1) if len(held) else None,
            "highest_mb": round(float(held.max()), 1) if len(held) else None})
    return rows


def drive(steps):
    """Drives robots at random in env1; returns samples, see `in_tenths`."""
    env = NavVecEnv(ROBOTS, ["env1"], random_starts=0.5)
    env.reset(seed=0)
    env.action_space.seed(0)
    begin = time.perf_counter()
    last = begin
    samples = [(0, 0.0, resident_megabytes())]
    for done in range(ROBOTS, steps + 1, ROBOTS):
        env.step(env.action_space.sample())
        now = time.perf_counter()
        if now - last > INTERVAL or done + ROBOTS > steps:
            last = now
            samples.append((done, now - begin, resident_megabytes()))
    return samples


def environment_run(steps):
    """The figures of a long run of the environment, in a process of its own."""
    with multiprocessing.get_context("spawn").Pool(1) as pool:
        return {"robots": ROBOTS, "tenths": in_tenths(pool.apply(drive, (steps,)))}


def training_run(steps):
    """The figures of a long training by one process, and of its tables."""
    with tempfile.TemporaryDirectory() as folder:
        run = Path(folder) / "run"
        command = [sys.executable, "train.py", "--fixed-budget", "--steps", str(steps), "--workers",
                   "1", "--evaluation-episodes", "1", "--out", str(run)]
        process = subprocess.Popen(command, cwd=ROOT, stdout=subprocess.DEVNULL,
                                   stderr=subprocess.PIPE)
        samples = []
        begin = time.perf_counter()
        while process.poll() is None:
            time.sleep(INTERVAL)
            done = steps_so_far(run / "episodes.csv")
            # Before the first episode it still imports; after the last it evaluates.
            if done and (not samples or samples[-1][0] < done):
                samples.append((done, time.perf_counter() - begin, resident_megabytes(process.pid)))
        if process.returncode:
            raise RuntimeError(process.stderr.read().decode().strip().splitlines()[-1])
        tables = {name: table_figures(run / name) for name in ("episodes.csv", "updates.csv")}
    return {"tenths": in_tenths(samples), "tables": tables}


def steps_so_far(path):
    """The steps in the last whole line of a CSV table that is still being written, 0 for none."""
    if not path.exists():
        return 0
    lines = path.read_bytes().rpartition(b"\n")[0].splitlines()
    return int(lines[-1].split(b",")[0]) if len(lines) > 1 else 0


def table_figures(path):
    """How many rows a CSV table has, the steps of the last one, and whether it is whole: its last
    line ends, every row has a value for every column, and steps never go back."""
    text = path.read_text()
    columns, *rows = csv.reader(text.splitlines())
    full = all(len(row) == len(columns) and all(row) for row in rows)
    steps = [int(row[0]) for row in rows]
    return {"rows": len(rows), "steps": steps[-1],
            "whole": text.endswith("\n") and full and steps == sorted(steps)}


def summary(name, tenths):
    """A run in one sentence."""
    first, last = tenths[0], tenths[-1]
    return (f"{name}: {first['memory_mb']} MB in the first tenth, {last['memory_mb']} MB in the "
            f"last; {first['steps_per_second']} and {last['steps_per_second']} steps a second")


def main(argv=None):
    """The command line."""
    parser = CommandLine("Watch memory and speed over long runs.")
    parser.prog = "python -m experiments.long_runs"
    options = parser.read(Options, argv)
    try:
        write(options.out, "{}")  # rather now than after the runs
        figures = {"environment": environment_run(options.env_steps)}
        print(summary("environment", figures["environment"]["tenths"]), flush=True)
        figures["training"] = training_run(options.train_steps)
        print(summary("training", figures["training"]["tenths"]), flush=True)
        write(options.out, json.dumps(figures, indent=2))
    except (WriteError, RuntimeError) as error:
        parser.error(error)
    for name, table in figures["training"]["tables"].items():
        print(f"{name}: {table['rows']} rows, {'whole' if table['whole'] else 'NOT WHOLE'}")


if __name__ == "__main__":
    main()
