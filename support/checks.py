"""What is wrong with the arguments of the environments, each said in one ValueError's sentence that
names the argument, what was given and what is valid."""

import numbers
import operator

import numpy as np

import scenes as scene_files
from sim import ROBOT_RADIUS, Scene

NO_LIMIT = -1  # of the steps of an episode, as Gymnasium says it


def is_whole_number(value):
    """Whether it is a whole number from 1 up."""
    return isinstance(value, (int, np.integer)) and not isinstance(value, bool) and value >= 1


def check_arguments(num_envs, max_episode_steps, random_starts, render_mode):
    """Refuses what a vector environment cannot be made with."""
    if not is_whole_number(num_envs):
        raise ValueError(f"num_envs is {num_envs!r}, it must be a whole number from 1 up")
    if not is_whole_number(max_episode_steps) and max_episode_steps != NO_LIMIT:
        raise ValueError(f"max_episode_steps is {max_episode_steps!r}, it must be a whole number "
                         f"from 1 up, or {NO_LIMIT} for no limit")
    if not isinstance(random_starts, numbers.Real) or not 0 <= random_starts <= 1:
        raise ValueError(f"random_starts is {random_starts!r}, it must be from 0 to 1")
    check_render_mode(render_mode, ["rgb_array"])


def check_render_mode(mode, modes):
    """Refuses all but None and these modes."""
    if mode is not None and mode not in modes:
        raise ValueError(f"render_mode is {mode!r}, it must be None or one of {', '.join(modes)}")


def load_scenes(scenes, most=None):
    """The Scenes of a list of names, paths or Scenes. most: how many robots there are for them."""
    if not isinstance(scenes, (list, tuple)) or len(scenes) == 0:
        raise ValueError(f"scenes is {scenes!r}, it must be a list such as ['env1']")
    if most is not None and len(scenes) > most:
        raise ValueError(f"scenes has {len(scenes)} entries, it must have at most {most}, one for "
                         "each robot")
    return [scene if isinstance(scene, Scene) else scene_files.load(scene) for scene in scenes]


def target_choices(targets, scenes):
    """The target indices that each robot's episodes draw from, one array a robot.

    targets: `training`, `new`, `both`, `memorize` or `anywhere`, or an index for each robot.
    scenes: one for each robot.
    """
    named = isinstance(targets, str)
    if not named and np.shape(targets) != (len(scenes),):
        raise ValueError(f"targets has shape {np.shape(targets)}, it must be a name or "
                         f"({len(scenes)},): an index into its scene's targets for each robot")
    choices = []
    for r, scene in enumerate(scenes):
        everyone = np.arange(len(scene.targets))
        training = len(scene.training_targets)
        sets = {"training": everyone[:training], "new": everyone[training:], "both": everyone,
                "memorize": everyone[:1], "anywhere": everyone[:1]}
        if named and targets not in sets:
            raise ValueError(f"targets is {targets!r}, it must be one of {', '.join(sets)}")
        whole = named or (isinstance(targets[r], (int, np.integer))
                          and not isinstance(targets[r], bool))
        if not whole or (not named and targets[r] not in everyone):
            raise ValueError(f"targets[{r}] is {targets[r]!r}, it must be from 0 to "
                             f"{len(everyone) - 1}: an index into the targets of {scene.name}")
        chosen = sets[targets] if named else np.array([targets[r]])
        if len(chosen) == 0:
            raise ValueError(f"targets is {targets!r}, but scene '{scene.name}' has none of them")
        choices.append(chosen)
    return choices


def check_actions(actions, R):
    """The actions as a float array (R, 2)."""
    actions = np.asarray(actions, dtype=float)
    valid = "linear in [0, 1], angular in [-1, 1]"
    if actions.shape != (R, 2):
        raise ValueError(f"the actions have shape {actions.shape}, it must be ({R}, 2): {valid}")
    finite = np.isfinite(actions).all(1)
    if not finite.all():
        raise ValueError(f"the action of robot {finite.argmin()} is not finite, it must be {valid}")
    return actions


def check_options(options, scenes):
    """The options of a reset: a dict that may hold `target`, indices (R,), and `start`, poses
    (R, 3). Each may be given as one for all robots. scenes: one for each robot."""
    checked = {}
    if options is not None and not isinstance(options, dict):
        raise ValueError(f"options is {options!r}, it must be a dict")
    for key, value in (options or {}).items():
        if key == "target":
            checked[key] = check_targets(value, scenes)
        elif key == "start":
            checked[key] = check_starts(value, scenes)
        else:
            raise ValueError(f"options has {key!r}, known are 'target' and 'start'")
    return checked


def check_targets(target, scenes):
    """Target indices (R,) from one for all robots or one for each."""
    valid = ("it must be a whole number: an index into the scene's targets, one for all robots or "
             "one for each")
    try:
        given = target if np.ndim(target) else [target] * len(scenes)
        targets = [operator.index(k) for k in given]
        whole = len(targets) == len(scenes) and not any(isinstance(k, bool) for k in given)
    except (TypeError, ValueError):
        whole = False
    if not whole:
        raise ValueError(f"options['target'] is {target!r}, {valid}")
    for k, scene in zip(targets, scenes):
        if not 0 <= k < len(scene.targets):
            raise ValueError(f"options['target'] is {k}, it must be from 0 to "
                             f"{len(scene.targets) - 1}: an index into the targets of {scene.name}")
    return np.array(targets)


def check_starts(start, scenes):
    """Start poses (R, 3) from one for all robots or one for each."""
    valid = "it must be a pose (x, y, theta) of finite numbers [m, m, rad]"
    try:
        starts = np.asarray(start, dtype=float)
    except (TypeError, ValueError):
        raise ValueError(f"options['start'] is {start!r}, {valid}") from None
    if starts.shape not in ((3,), (len(scenes), 3)) or not np.isfinite(starts).all():
        raise ValueError(f"options['start'] is {start!r}, {valid}")
    starts = np.broadcast_to(starts, (len(scenes), 3))
    for pose, scene in zip(starts, scenes):
        low, high = scene.bounds
        inside = (low < pose[:2]).all() and (pose[:2] < high).all()
        if not inside or scene.clearance(pose[:2]) <= ROBOT_RADIUS:
            raise ValueError(f"options['start'] is {tuple(pose.tolist())}, it must be in the room "
                             f"'{scene.name}' and {ROBOT_RADIUS} m or more from its boxes")
    return starts


def asked_episode(episode, options, r, scene):
    """Robot r's episode (target, goal, start) as the options of a reset ask for it: what they do
    not name stays as drawn, but an episode to a target of one's choice begins at the start pose."""
    target, goal, start = episode
    if "target" in options:
        target = options["target"][r]
        goal = scene.targets[target]
        start = scene.start
    if "start" in options:
        start = options["start"][r]
    return target, goal, start
