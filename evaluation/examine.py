"""Evaluates a frozen driver on fresh episodes of a protocol, and reports the result as text."""

from dataclasses import replace

import numpy as np

from evaluation.measures import ShortestPaths, summarise
from evaluation.protocols import (HIDDEN, PROTOCOLS, Assignment, assign_all, make_environment,
                                  protocol_scenes)
from navbot_min import NavVecEnv
from scenes import load
from sim import Scene
from support.checks import check
from support.traces import drive

KINDS = {"training": "all training targets", "new": "all new targets",
         "validation": "validation targets", "anywhere": "random targets"}
ROOMS = {"training": "training rooms", "new": "new rooms"}  # kinds of level 3
BLOCK = 64  # number of robots per environment; a process drives one block at a time
MOST_ROWS = 40  # maximum number of targets for which `table` has separate lines


def rollouts(driver, robots, protocol="start", seed=0, hidden="", images=False,
             environment=NavVecEnv, workers=1):
    """Returns the Traces of a list of Assignments. workers: number of processes; 0: one per core.
    It does not change the result: each block of robots has its own random numbers. With several
    workers, driver and environment must be picklable, and the driver must not learn."""
    jobs = [(driver, robots[first:first + BLOCK], protocol, [seed, k], hidden, images, environment)
            for k, first in enumerate(range(0, len(robots), BLOCK))]
    if workers == 1:
        driven = [drive_block(*job) for job in jobs]
    else:
        from support import parallel  # loads torch, which planners do not need
        driven = parallel.in_processes(drive_block, jobs, workers or parallel.available_cores())
    return [trace for traces in driven for trace in traces]


def drive_block(driver, robots, protocol, seeds, hidden, images, environment):
    """Returns the Traces of one block of robots. seeds: numbers unique to this block."""
    env = make_environment(protocol, [robot.scene for robot in robots],
                           [robot.target for robot in robots], hidden, environment)
    seed = int(np.random.SeedSequence(seeds).generate_state(1)[0])
    return drive(driver, env, [robot.quota for robot in robots], seed, images)


def film_episode(driver, scene, protocol="start", seed=0, hidden="", environment=NavVecEnv):
    """Returns the Trace, with images, of one episode to the last target of the protocol."""
    [scene] = protocol_scenes(protocol, [scene])
    robot = Assignment(scene, len(scene.targets) - 1, quota=1)
    [trace] = rollouts(driver, [robot], protocol, seed, hidden, True, environment)
    return replace(trace, label=conditions(protocol, hidden))


def conditions(protocol, hidden):
    """Returns a short description of the conditions of an evaluation."""
    parts = hidden.replace("both", "place and cube")
    return f"protocol {protocol}" + (f", target's {parts} hidden" if hidden else "")


def evaluate(driver, scenes, episodes=1000, protocol="start", seed=0, actions="sampled", hidden="",
             environment=NavVecEnv, workers=1):
    """Evaluates a driver (a Policy, a Planned or your own) on fresh episodes. Returns the content
    of `evaluation.json` and the Traces. Raises ValueError, and SceneError if validation targets do
    not fit. scenes: a list of names, paths or Scenes. episodes: number per kind of target; for
    `anywhere`, in total. actions: a name for the driver's actions, to put into the result. hidden,
    environment: see `make_environment`. workers: see `rollouts`."""
    for name, value, valid in (("protocol", protocol, PROTOCOLS), ("hidden", hidden, HIDDEN)):
        known = ", ".join(map(repr, valid))
        check(value in valid, f"{name} is {value!r}; it must be one of {known}")
    scenes = [scene if isinstance(scene, Scene) else load(scene) for scene in scenes]
    scenes = protocol_scenes(protocol, list(dict.fromkeys(scenes)))  # without repeated rooms
    traces = rollouts(driver, assign_all(protocol, scenes, episodes), protocol, seed, hidden,
                      environment=environment, workers=workers)
    result = {"protocol": protocol, "actions": actions, "hidden": hidden, "training": None,
              "new": None}
    if protocol == "anywhere":
        return result | {"anywhere": summarise(traces), "targets": []}, traces
    paths = ShortestPaths()
    kinds = "training", "validation" if protocol == "validation" else "new"
    for new, kind in enumerate(kinds):
        result[kind] = summarise([trace for trace in traces if trace.new == new], paths)
    rows = []
    for scene in scenes:
        name = {"scene": scene.name} if len(scenes) > 1 else {}
        for k, (x, y) in enumerate(scene.targets.tolist()):
            here = [trace for trace in traces if trace.target == k and trace.scene == scene]
            kind = kinds[k >= len(scene.training_targets)]
            rows.append(name | {"x": x, "y": y, "kind": kind} | summarise(here, paths))
    return result | {"targets": rows}, traces


def table(result):
    """Returns a result as text: each kind of target, then each target if there are not too many."""
    kinds = KINDS | ROOMS if result["protocol"] == "anywhere" else KINDS
    rows = [(name, result[kind]) for kind, name in kinds.items() if result.get(kind)]
    if len(result["targets"]) <= MOST_ROWS:
        for row in result["targets"]:
            name = f"{row.get('scene', '')} {row['kind']} ({row['x']:g}, {row['y']:g})"
            rows.append((name.strip(), row))
    width = max(len(name) for name, _ in rows)
    lines = []
    for name, row in rows:
        time = "-" if row["seconds_to_arrive"] is None else f"{row['seconds_to_arrive']:.1f} s"
        standing = f"standing {row['standing']:6.1%}  " if row["standing"] else ""
        line = (f"{name:{width}}  success {row['success']:6.1%} [{row['low']:.1%}, "
                f"{row['high']:.1%}]  collision {row['collision']:6.1%}  timeout "
                f"{row['timeout']:6.1%}  {standing}SPL {row['spl']:.2f}  arrives in {time}  "
                f"n {row['n']}")
        if "mean_action_arrives" in row:
            line += "  deterministic (mean) action "
            line += "arrives" if row["mean_action_arrives"] else "fails"
        lines.append(line)
    if result["protocol"] in ("start", "perturbed") and result["new"] is None:
        lines.insert(1, f"{KINDS['new']:{width}}  none")
    return "\n".join(lines)


def report(summary, window=100):
    """Returns the text at the end of a training run, from the content of its `summary.json`.
    window: number of episodes in the rolling success rate."""
    frozen = summary["frozen"]
    new = frozen["new"]
    rate = summary["rolling_new_success"]
    why = "by the paper's rule" if summary["stopped_by_rule"] else "at the end of its budget"
    rolling = "no episode" if rate is None else f"{rate * window:.0f} of the last {window} episodes"
    success = "none" if not new else (
        f"{rolling} during training, frozen {new['success']:.1%} "
        f"[{new['low']:.1%}, {new['high']:.1%}] of {new['n']:,} fresh episodes")
    where = "in new rooms" if frozen["protocol"] == "anywhere" else "on new targets"
    return (f"stopped {why} after {summary['steps']:,} steps, {summary['episodes']:,} episodes, "
            f"{summary['seconds']:.0f} s\nsuccess {where}: {success}\n{table(frozen)}")
