"""Frozen evaluation: a driver on fresh episodes by a protocol, what is measured, and its text."""

from dataclasses import replace

import numpy as np

from evaluation.measures import ShortestPaths, summarise
from evaluation.protocols import (HIDDEN, PROTOCOLS, Assignment, assign_all, make_environment,
                                  protocol_scenes)
from support.checks import load_scenes
from support.cores import in_processes
from support.traces import drive

KINDS = {"training": "all training targets", "new": "all new targets",
         "validation": "validation targets", "anywhere": "any free target"}
ROOMS = {"training": "rooms learnt in", "new": "new rooms"}  # level 3 has no other kinds
BLOCK = 64  # robots that drive side by side; a process drives a block at a time
MOST_ROWS = 40  # targets that `table` has a line for


def rollouts(driver, robots, protocol="start", seed=0, hidden="", images=False,
             environment=None, workers=1, paths=None):
    """Drives what each robot is to do, a list of Assignments; returns the Traces.

    The robots drive in blocks, each with random numbers of its own: it makes no difference how many
    processes share the blocks. With several workers driver and environment have to be picklable.
    paths: ShortestPaths, which then know those of the Traces.
    """
    blocks = [robots[k:k + BLOCK] for k in range(0, len(robots), BLOCK)]
    jobs = [(driver, block, protocol, [seed, k], hidden, images, environment, paths is not None)
            for k, block in enumerate(blocks)]
    own_scene = {robot.scene: robot.scene for robot in robots}  # another process returns copies
    traces = []
    for driven, lengths in in_processes(drive_block, jobs, workers):
        for trace in driven:
            trace.scene = own_scene[trace.scene]
        traces += driven
        if paths is not None:
            paths.learn(lengths)
    return traces


def drive_block(driver, robots, protocol, seeds, hidden, images, environment, measured):
    """The Traces of one block of robots, and the lengths of their shortest paths, if they are to be
    measured. seeds: numbers that are this block's alone."""
    scenes = [robot.scene for robot in robots]
    targets = [robot.target for robot in robots]
    env = make_environment(protocol, scenes, targets, hidden, environment)
    seed = int(np.random.SeedSequence(seeds).generate_state(1)[0])
    traces = drive(driver, env, [robot.quota for robot in robots], seed, images)
    paths = ShortestPaths()
    if measured:
        for trace in traces:
            paths.metres(trace.scene, trace.start, trace.goal)
    return traces, paths.lengths


def film_episode(driver, scene, protocol="start", seed=0, hidden="", environment=None):
    """The Trace, with images, of one episode of the kind that `evaluate` counts; it leads to the
    last of the protocol's targets, where that has targets."""
    scene = protocol_scenes(protocol, [scene])[0]
    robot = Assignment(scene, len(scene.targets) - 1, quota=1)
    [trace] = rollouts(driver, [robot], protocol, seed, hidden, images=True,
                       environment=environment)
    return replace(trace, label=conditions(protocol, hidden))


def conditions(protocol, hidden):
    """A few words on how an evaluation's episodes are driven."""
    if not hidden:
        return f"protocol {protocol}"
    what = "place and cube" if hidden == "both" else hidden
    return f"protocol {protocol}, target's {what} hidden"


def evaluate(driver, scenes, episodes=1000, protocol="start", seed=0, actions="sampled", hidden="",
             environment=None, workers=1):
    """Frozen evaluation: no learning, fresh episodes. Returns what `evaluation.json` holds, and the
    episodes' Traces.

    driver: a Policy, a Planned or your own. scenes: a list of names, paths or Scenes. episodes: so
    many of each kind, training and new, split evenly over the scenes and their targets; by
    `anywhere`, so many in all. actions: what the result says of the driver's actions. hidden: see
    `protocols.hiding`. environment: NavVecEnv or a subclass with hooks of its own; by default the
    one that the scenes ask for. workers: processes that share the work; the result is the same with
    any number. Raises ValueError for what is not valid; SceneError where there is no room for
    validation targets.
    """
    for name, value, valid in (("protocol", protocol, PROTOCOLS), ("hidden", hidden, HIDDEN)):
        if value not in valid:
            known = ", ".join(map(repr, valid))
            raise ValueError(f"{name} is {value!r}, it must be one of {known}")
    scenes = list(dict.fromkeys(load_scenes(scenes)))  # one that is given twice counts once
    scenes = protocol_scenes(protocol, scenes)
    paths = ShortestPaths()
    traces = rollouts(driver, assign_all(protocol, scenes, episodes), protocol, seed, hidden,
                      environment=environment, workers=workers, paths=paths)
    result = {"protocol": protocol, "actions": actions, "hidden": hidden, "training": None,
              "new": None}
    if protocol == "anywhere":
        result["anywhere"] = summarise(traces, paths)
        result["targets"] = []
        return result, traces
    test_kind = "validation" if protocol == "validation" else "new"
    result["training"] = summarise([trace for trace in traces if not trace.new], paths)
    result[test_kind] = summarise([trace for trace in traces if trace.new], paths)
    result["targets"] = target_rows(scenes, traces, test_kind, paths)
    return result, traces


def target_rows(scenes, traces, test_kind, paths):
    """A row for each target of each scene: where it is, its kind and its episodes' summary."""
    traces_of = {}
    for trace in traces:
        traces_of.setdefault((id(trace.scene), trace.target), []).append(trace)
    rows = []
    for scene in scenes:
        for k, (x, y) in enumerate(scene.targets):
            row = {"x": float(x), "y": float(y)}
            if len(scenes) > 1:
                row = {"scene": scene.name} | row
            row["kind"] = test_kind if k >= len(scene.training_targets) else "training"
            rows.append(row | summarise(traces_of[id(scene), k], paths))
    return rows


def table(result):
    """An evaluation as lines of text: all targets of a kind, then a target a line, where these are
    not too many."""
    kinds = KINDS | ROOMS if result["protocol"] == "anywhere" else KINDS
    rows = [(name, result[kind]) for kind, name in kinds.items() if result.get(kind)]
    if len(result["targets"]) <= MOST_ROWS:
        rows += [(target_name(row), row) for row in result["targets"]]
    width = max(len(name) for name, _ in rows)
    lines = [f"{name:{width}}  {row_text(row)}" for name, row in rows]
    if result["protocol"] in ("start", "perturbed") and result["new"] is None:
        lines.insert(1, f"{KINDS['new']:{width}}  there are none")
    return "\n".join(lines)


def target_name(row):
    """What `table` calls the target of a row of the result's `targets`."""
    name = f"{row['kind']} ({row['x']:g}, {row['y']:g})"
    return f"{row['scene']} {name}" if "scene" in row else name


def row_text(row):
    """A summary as text."""
    time = "-" if row["seconds_to_arrive"] is None else f"{row['seconds_to_arrive']:.1f} s"
    text = (f"success {row['success']:6.1%} [{row['low']:.1%}, {row['high']:.1%}]  "
            f"collision {row['collision']:6.1%}  timeout {row['timeout']:6.1%}  "
            + (f"standing {row['standing']:6.1%}  " if row["standing"] else "") +
            f"SPL {row['spl']:.2f}  arrives in {time}  n {row['n']}")
    if "mean_action_arrives" in row:
        verb = "arrives" if row["mean_action_arrives"] else "fails"
        text += f"  deterministic (mean) action {verb}"
    return text


def report(summary):
    """What a training run says at its end: the rolling number that it stopped on and the frozen one
    side by side, then the table of the frozen evaluation. summary: what `summary.json` holds."""
    why = "by the paper's rule" if summary["stopped_by_rule"] else "before the paper's rule was met"
    if summary["rolling_new_success"] is None:
        why = "after all its steps"  # there are no episodes to decide by
    rolling = "no episode"
    if summary["rolling_new_success"] is not None:
        rolling = f"{summary['rolling_new_success']:.0%} of the last episodes, 100 at most"
    new = summary["frozen"]["new"]
    where = "in new rooms" if summary["frozen"]["protocol"] == "anywhere" else "on new targets"
    success = "there are none"
    if new is not None:
        success = (f"while training {rolling} | frozen {new['success']:.1%} "
                   f"[{new['low']:.1%}, {new['high']:.1%}] of {new['n']:,} fresh episodes")
    return (f"stopped {why}: {summary['steps']:,} steps, {summary['episodes']:,} episodes, "
            f"{summary['seconds']:.0f} s\n"
            f"success {where}: {success}\n{table(summary['frozen'])}")
