"""Frozen evaluation: a driver on fresh episodes by a protocol, what is measured, and its text."""

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
         "validation": "validation targets", "anywhere": "any free target"}
ROOMS = {"training": "rooms learnt in", "new": "new rooms"}  # kinds of level 3
BLOCK = 64  # robots that drive side by side; a process drives a block at a time
MOST_ROWS = 40  # targets that `table` has a line for


def rollouts(driver, robots, protocol="start", seed=0, hidden="", images=False,
             environment=NavVecEnv, workers=1):
    """Returns the Traces of a list of Assignments. Each block of robots has its own random numbers,
    so the number of workers (processes; 0: one for each core) makes no difference. With several,
    the driver and the environment must be picklable, and the driver must not learn."""
    jobs = [(driver, robots[first:first + BLOCK], protocol, [seed, k], hidden, images, environment)
            for k, first in enumerate(range(0, len(robots), BLOCK))]
    if workers == 1:
        driven = [drive_block(*job) for job in jobs]
    else:
        from support import parallel  # loads torch, which planners do without
        driven = parallel.in_processes(drive_block, jobs, workers or parallel.available_cores())
    return [trace for traces in driven for trace in traces]


def drive_block(driver, robots, protocol, seeds, hidden, images, environment):
    """Returns the Traces of one block of robots. seeds: numbers that only this block has."""
    env = make_environment(protocol, [robot.scene for robot in robots],
                           [robot.target for robot in robots], hidden, environment)
    seed = int(np.random.SeedSequence(seeds).generate_state(1)[0])
    return drive(driver, env, [robot.quota for robot in robots], seed, images)


def film_episode(driver, scene, protocol="start", seed=0, hidden="", environment=NavVecEnv):
    """Returns the Trace, with images, of one episode to the last of the protocol's targets."""
    [scene] = protocol_scenes(protocol, [scene])
    robot = Assignment(scene, len(scene.targets) - 1, quota=1)
    [trace] = rollouts(driver, [robot], protocol, seed, hidden, True, environment)
    return replace(trace, label=conditions(protocol, hidden))


def conditions(protocol, hidden):
    """Returns a few words on how the episodes of an evaluation are driven."""
    what = hidden.replace("both", "place and cube")
    return f"protocol {protocol}" + (f", target's {what} hidden" if hidden else "")


def evaluate(driver, scenes, episodes=1000, protocol="start", seed=0, actions="sampled", hidden="",
             environment=NavVecEnv, workers=1):
    """Evaluates a driver, a Policy, a Planned or your own, on fresh episodes. Returns what
    `evaluation.json` holds, and the Traces. Raises ValueError; SceneError without room for
    validation targets. scenes: a list of names, paths or Scenes. episodes: to the targets of each
    kind; `anywhere`, in all. actions: a name of the driver's actions, for the result. hidden,
    environment: see `make_environment`. workers: see `rollouts`."""
    for name, value, valid in (("protocol", protocol, PROTOCOLS), ("hidden", hidden, HIDDEN)):
        known = ", ".join(map(repr, valid))
        check(value in valid, f"{name} is {value!r}, it must be one of {known}")
    scenes = [scene if isinstance(scene, Scene) else load(scene) for scene in scenes]
    scenes = protocol_scenes(protocol, list(dict.fromkeys(scenes)))  # each room counts once
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
    """Returns an evaluation as text: all targets of each kind, then each if they are not many."""
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
        lines.insert(1, f"{KINDS['new']:{width}}  there are none")
    return "\n".join(lines)


def report(summary):
    """Returns the text at the end of a training from the content of its `summary.json`."""
    frozen = summary["frozen"]
    new = frozen["new"]
    rate = summary["rolling_new_success"]
    why = "by the paper's rule" if summary["stopped_by_rule"] else "before the paper's rule was met"
    rolling = f"{rate or 0:.0%} of the last episodes, 100 at most"
    if rate is None:  # no episode led to a new target
        why = "after all its steps"
        rolling = "no episode"
    success = "there are none" if not new else (
        f"while training {rolling} | frozen {new['success']:.1%} "
        f"[{new['low']:.1%}, {new['high']:.1%}] of {new['n']:,} fresh episodes")
    where = "in new rooms" if frozen["protocol"] == "anywhere" else "on new targets"
    return (f"stopped {why}: {summary['steps']:,} steps, {summary['episodes']:,} episodes, "
            f"{summary['seconds']:.0f} s\nsuccess {where}: {success}\n{table(frozen)}")
