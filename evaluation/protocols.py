"""The protocols of an evaluation: `start`, `perturbed` and `anywhere` are levels 2, 1 and 3 of
training. `validation` is `start` with the new targets of `validation_scene`, for tuning."""

import math
from dataclasses import dataclass, replace

import numpy as np

from navbot_min import NavVecEnv, level_1, level_2, level_3
from render import CUBE_SIZE
from scenes import distance_to_nearest
from sim import Scene, SceneError

PROTOCOLS = {"start": level_2, "perturbed": level_1, "anywhere": level_3, "validation": level_2}
EPISODES_PER_ROBOT = 16  # maximum; with fewer, more robots would wait for the last episode
OUT_OF_SIGHT = 1000.0  # [m] offset of a hidden cube
HIDDEN = ("", "place", "cube", "both")  # parts of the target that can be hidden
PATCH = 0.25  # [m] grid size of validation targets, and size of a patch in floor.png
TEST_DISTANCE = 0.5  # [m] minimum distance of a validation target from start and new targets


def make_environment(protocol, scenes, targets, hidden="", environment=NavVecEnv):
    """Returns the environment of a protocol. scenes, targets: each robot's Scene and the index of
    its target. hidden: `place` (the observed distance and bearing are 0), `cube` (the camera does
    not show the target), `both`, or "". environment: NavVecEnv or a subclass."""
    env = environment(len(targets), scenes, targets, level=PROTOCOLS[protocol])
    hide(env, hidden)
    return env


def hide(env, hidden):
    """Hides a part of the target from now on; `hidden` as in `make_environment`."""
    vars(env).pop("observe", None)  # what was hidden before
    vars(env.camera).pop("render", None)
    observe = env.observe
    render = env.camera.render
    if hidden in ("place", "both"):
        env.observe = lambda robots, *seen: (
            observe(robots, *seen) | {"target": np.zeros((len(robots), 2), np.float32)})
    if hidden in ("cube", "both"):
        env.camera.render = lambda rooms, poses, cubes: render(rooms, poses, cubes + OUT_OF_SIGHT)


def validation_scene(scene):
    """Returns the scene to tune on: its new targets are reachable points of a grid, TEST_DISTANCE
    or more from the start and the new targets of `scene`. Raises SceneError if there are none."""
    columns, rows = (np.ptp(scene.bounds, axis=0) / PATCH).astype(int)
    grid = scene.bounds[0] + PATCH * np.argwhere(np.ones((columns, rows)))  # (P, 2)
    reachable = distance_to_nearest(grid, scene.reachable) < 0.02
    untrained = distance_to_nearest(grid, scene.training_targets) >= CUBE_SIZE
    apart = distance_to_nearest(grid, [scene.start[:2], *scene.new_targets]) >= TEST_DISTANCE
    places = grid[reachable & untrained & apart].tolist()
    if not places:
        raise SceneError(f"{scene.name} has no space for validation targets")
    return replace(scene, new_targets=tuple(map(tuple, places)))


def protocol_scenes(protocol, scenes):
    """Returns the scenes of a protocol. For `validation`, their new targets are replaced."""
    return [validation_scene(scene) for scene in scenes] if protocol == "validation" else scenes


def split(n, parts):
    """Splits n into whole parts that are as equal as possible and at least 1. Returns a list."""
    return [max(1, n // parts + (k < n % parts)) for k in range(parts)]


@dataclass
class Assignment:
    """The task of one robot in an evaluation: `quota` episodes to one target of one scene."""
    scene: Scene
    target: int
    quota: int


def assign(scene, target, episodes):
    """Returns the Assignments of the robots that share the episodes to one target."""
    robots = math.ceil(episodes / EPISODES_PER_ROBOT)
    return [Assignment(scene, target, quota) for quota in split(episodes, robots)]


def assign_all(protocol, scenes, episodes):
    """Returns the Assignments of an evaluation. episodes: see `examine.evaluate`."""
    kinds = [[(scene, range(len(scene.training_targets))) for scene in scenes],
             [(scene, range(len(scene.training_targets), len(scene.targets)))
              for scene in scenes if scene.new_targets]]
    if protocol == "anywhere":
        kinds = [[(scene, [0]) for scene in scenes]]
    robots = []
    for kind in kinds:
        for (scene, targets), share in zip(kind, split(episodes, len(kind))):
            for target, quota in zip(targets, split(share, len(targets))):
                robots += assign(scene, target, quota)
    return robots
