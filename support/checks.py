"""Checks of an environment's arguments. Each error shows the given value and the valid ones."""

import numpy as np

from sim import ARRIVAL_DISTANCE, ROBOT_RADIUS, SceneError

NO_LIMIT = -1  # value of max_episode_steps for no limit, as in Gymnasium


def check(valid, message):
    """Raises ValueError with this message unless `valid` is true."""
    if not valid:
        raise ValueError(message)


def check_arguments(num_envs, scenes, random_starts, max_episode_steps):
    """Raises ValueError if an argument of NavVecEnv is invalid."""
    check(num_envs >= 1, f"num_envs is {num_envs}; it must be at least 1")
    check(not isinstance(scenes, str) and 1 <= len(scenes) <= num_envs,
          f"scenes is {scenes!r}; it must be a list of 1 to {num_envs} rooms")
    check(0 <= random_starts <= 1, f"random_starts is {random_starts}; it must be from 0 to 1")
    check(max_episode_steps >= 1 or max_episode_steps == NO_LIMIT,
          f"max_episode_steps is {max_episode_steps}; it must be at least 1, or {NO_LIMIT}")


def check_render_mode(mode, modes):
    """Raises ValueError unless the mode is None or one of the modes."""
    check(mode in (None, *modes), f"render_mode is {mode!r}; it must be None or one of {modes}")


def target_choices(targets, r, scene):
    """Returns the indices from which robot r's targets are drawn. Raises ValueError."""
    every = range(len(scene.targets))
    n = len(scene.training_targets)
    sets = dict(training=every[:n], new=every[n:], both=every, memorize=every[:1],
                anywhere=every[:1])
    if isinstance(targets, str):
        check(targets in sets, f"targets is {targets!r}; it must be one of {', '.join(sets)}")
        check(sets[targets], f"targets is {targets!r}, but scene '{scene.name}' has none")
        return sets[targets]
    check(r < len(targets) and targets[r] in every, f"targets is {targets!r}; for robot {r} it "
          f"must hold an index from 0 to {len(every) - 1} into the targets of {scene.name}")
    return [targets[r]]


def is_reachable(scene, place):
    """Returns whether a robot that starts at the start pose can arrive at a place (x, y)."""
    away = np.hypot(*(scene.reachable - place).T)
    return bool(scene.clearance(place) > 0 and away.min() < ARRIVAL_DISTANCE)


def check_options(options, scenes):
    """Returns the options of a reset as arrays, with a value for each Scene. Raises ValueError."""
    checked = {}
    shapes = {"target": len(scenes), "goal": (len(scenes), 2), "start": (len(scenes), 3)}
    for name, value in options.items():
        check(name in shapes, f"options has an unknown key {name!r}; known: {', '.join(shapes)}")
        checked[name] = np.broadcast_to(value, shapes[name])
        for given, scene in zip(checked[name], scenes):
            if name == "start":
                valid = scene.fits(given)
                what = f"a pose (x, y, theta), {ROBOT_RADIUS} m or more from all boxes, inside"
            elif name == "goal":
                valid = is_reachable(scene, given)
                what = "a place (x, y) that a robot can reach in"
            else:
                valid = given.dtype.kind == "i" and given in range(len(scene.targets))
                what = "an index into the targets of"
            check(valid, f"options[{name!r}] is {value!r}; it must be {what} {scene.name}")
    return checked


def asked_episode(episode, options, r, scene):
    """Returns robot r's episode (target, goal, start), changed by the options of a reset."""
    target, goal, start = episode
    if "target" in options:
        target = options["target"][r]
        goal = scene.targets[target]
        start = scene.start
    goal = options["goal"][r] if "goal" in options else goal
    return target, goal, options["start"][r] if "start" in options else start


def refuse_reality(scenes):
    """Raises SceneError for a room with a robot's errors, which only `robot/` simulates."""
    for scene in scenes:
        if scene.reality:
            raise SceneError(f"room {scene.name!r} has a robot's errors; use python -m "
                             "robot.train, python -m robot.evaluate or robot:NavBot-lab-v1")
