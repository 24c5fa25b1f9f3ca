"""Checks of an environment's arguments. An error names what was given, and what is valid."""

import numpy as np

from sim import ROBOT_RADIUS, SceneError

NO_LIMIT = -1  # of an episode's steps, as in Gymnasium


def check(valid, message):
    """Raises ValueError unless something is valid."""
    if not valid:
        raise ValueError(message)


def check_arguments(num_envs, scenes, random_starts, max_episode_steps):
    """Raises ValueError for arguments that no NavVecEnv can be made with."""
    check(num_envs >= 1, f"num_envs is {num_envs}, it must be at least 1")
    check(not isinstance(scenes, str) and 1 <= len(scenes) <= num_envs,
          f"scenes is {scenes!r}, it must be a list of 1 to {num_envs} rooms")
    check(0 <= random_starts <= 1, f"random_starts is {random_starts}, it must be from 0 to 1")
    check(max_episode_steps >= 1 or max_episode_steps == NO_LIMIT,
          f"max_episode_steps is {max_episode_steps}, it must be at least 1, or {NO_LIMIT}")


def check_render_mode(mode, modes):
    """Raises ValueError unless a mode is None or one of the modes."""
    check(mode in (None, *modes), f"render_mode is {mode!r}, it must be None or one of {modes}")


def target_choices(targets, r, scene):
    """Returns the indices that robot r's targets are drawn from. Raises ValueError."""
    every = range(len(scene.targets))
    n = len(scene.training_targets)
    sets = dict(training=every[:n], new=every[n:], both=every, memorize=every[:1],
                anywhere=every[:1])
    if isinstance(targets, str):
        check(targets in sets, f"targets is {targets!r}, it must be one of {', '.join(sets)}")
        check(sets[targets], f"targets is {targets!r}, but scene '{scene.name}' has none")
        return sets[targets]
    check(r < len(targets) and targets[r] in every, f"targets is {targets!r}, for robot {r} it "
          f"must have an index from 0 to {len(every) - 1} into the targets of {scene.name}")
    return [targets[r]]


def check_options(options, scenes):
    """Returns the options of a reset, with a value for each of R Scenes. Raises ValueError."""
    checked = {}
    shapes = {"target": len(scenes), "start": (len(scenes), 3)}
    for name, value in options.items():
        check(name in shapes, f"options has {name!r}, known: 'target' and 'start'")
        checked[name] = np.broadcast_to(value, shapes[name])
        for given, scene in zip(checked[name], scenes):
            if name == "start":
                valid = scene.fits(given)
                what = f"a pose (x, y, theta) inside, {ROBOT_RADIUS} m from the boxes,"
            else:
                valid = given.dtype.kind == "i" and given in range(len(scene.targets))
                what = "an index into the targets"
            check(valid, f"options[{name!r}] is {value!r}, it must be {what} of {scene.name}")
    return checked


def asked_episode(episode, options, r, scene):
    """Returns robot r's episode (target, goal, start) as the options of a reset ask for it."""
    target, goal, start = episode
    if "target" in options:
        target = options["target"][r]
        goal = scene.targets[target]
        start = scene.start
    return target, goal, options["start"][r] if "start" in options else start


def refuse_reality(scenes):
    """Raises SceneError for a room with a robot's errors, which only `robot/` models."""
    for scene in scenes:
        if scene.reality:
            raise SceneError(f"room {scene.name!r} has a robot's errors: python -m robot.train and "
                             "python -m robot.evaluate, or robot:NavBot-lab-v0, are made for it")
