"""Where the episodes of an evaluation start and lead, what of the target is hidden, and how many
episodes go to which target.

A protocol overrides the hook `sample_episode` of an environment, which is NavVecEnv or a subclass
of it:

- `start`: every episode starts at the scene's start pose, as training's test episodes do.
- `perturbed`: near the start pose, to near a target.
- `anywhere`: from any place, at any heading, to any place.
- `validation`: as `start`, to the targets of `validation_scene`, so that anyone can tune on these
  and the new targets stay an exam.
"""

import math
from dataclasses import dataclass, replace

import numpy as np

from render import CUBE_SIZE
from robot.environment import environment_of
from scenes import distance_to_reachable
from sim import CELL, Scene, SceneError

# At most. More robots wait longer for the last: each drives its episodes one after another.
EPISODES_PER_ROBOT = 16
HIDDEN = ("", "place", "cube", "both")  # what a policy may not be shown of its target
PATCH = 0.25  # [m] from one validation target to the next, and the size of a patch of floor.png
EXAM_DISTANCE = 0.5  # [m] that a validation target keeps from the start and each new target
OUT_OF_SIGHT = 1000.0  # [m] away is a cube that the camera does not show


class Perturbed:
    """Episodes lead from near a start pose to near a target, as at level 1."""

    def sample_episode(self, r):
        target, goal, start = super().sample_episode(r)
        scene = self.scenes[self.scene_of[r]]
        return target, scene.near(goal, self.np_random), scene.near(start, self.np_random)


class Anywhere:
    """Episodes lead from anywhere to anywhere, as at level 3. The target's index is without
    meaning."""

    def sample_episode(self, r):
        target, _, _ = super().sample_episode(r)
        scene = self.scenes[self.scene_of[r]]
        goal = scene.any_place(self.np_random)
        return target, goal, scene.any_start(goal, self.np_random)


PROTOCOLS = {"start": (), "perturbed": (Perturbed,), "anywhere": (Anywhere,), "validation": ()}


class WithoutCube:
    """A camera that does not show the targets' cubes."""

    def __init__(self, camera):
        self.camera = camera

    def render(self, scene_of, poses, targets):
        """As render.Camera's."""
        return self.camera.render(scene_of, poses, targets + OUT_OF_SIGHT)


def hiding(environment, hidden):
    """That class of environment, with robots that are not shown everything of their target.
    hidden: `place`, the observed distance and bearing are 0; `cube`, the camera does not show the
    target; `both`."""

    class Hiding(environment):
        def __init__(self, *args, **options):
            super().__init__(*args, **options)
            if hidden in ("cube", "both"):
                self.camera = WithoutCube(self.camera)

        def observe(self, *arguments):
            seen = super().observe(*arguments)
            if hidden in ("place", "both"):
                seen["target"] = np.zeros_like(seen["target"])
            return seen

    return Hiding


def make_environment(protocol, scenes, targets, hidden="", environment=None):
    """The environment of a protocol. scenes, targets: of each robot its Scene and the index of its
    target. hidden: see `hiding`; "" hides nothing. environment: NavVecEnv or a subclass of it; by
    default the one that the scenes ask for."""
    environment = environment or environment_of(scenes)
    environment = type(environment.__name__, (*PROTOCOLS[protocol], environment), {})
    if hidden:
        environment = hiding(environment, hidden)
    return environment(len(targets), scenes, targets)


def validation_scene(scene):
    """The scene to tune on, so that its new targets stay an exam. In their place it has the points
    of a grid that can be driven to, 0.5 m or more from the start and from each new target. Raises
    SceneError where there is none."""
    columns, rows = (np.ptp(scene.bounds, axis=0) / PATCH).astype(int)
    grid = scene.bounds[0] + PATCH * np.argwhere(np.ones((columns, rows)))  # (P, 2)
    exam = np.array([scene.start[:2], *scene.new_targets])
    reachable = distance_to_reachable(scene, grid, CELL) < 0.02
    untrained = distance_to_nearest(grid, np.array(scene.training_targets)) >= CUBE_SIZE
    apart = distance_to_nearest(grid, exam) >= EXAM_DISTANCE
    spots = grid[reachable & untrained & apart]
    if len(spots) == 0:
        raise SceneError(f"{scene.name} has no room for validation targets: none of a grid of "
                         f"{PATCH} m is {EXAM_DISTANCE} m from the start and the new targets")
    return replace(scene, new_targets=tuple((float(x), float(y)) for x, y in spots))


def distance_to_nearest(points, others):
    """Distance [m] from each of the points (P, 2) to the nearest of the others (n, 2)."""
    apart = points[:, None] - others
    return np.hypot(apart[..., 0], apart[..., 1]).min(1)


def protocol_scenes(protocol, scenes):
    """The scenes that a protocol drives in: the given ones, by `validation` each with validation
    targets in the place of its new ones. Raises SceneError."""
    if protocol == "validation":
        return [validation_scene(scene) for scene in scenes]
    return list(scenes)


def split(n, parts):
    """n in so many whole parts, as even as can be, but none under 1."""
    return [max(1, n // parts + (k < n % parts)) for k in range(parts)]


@dataclass
class Assignment:
    """What one robot does in an evaluation: so many episodes to one target of one scene."""
    scene: Scene
    target: int
    quota: int


def assign(scene, target, episodes):
    """The Assignments of the robots that share those episodes to that target."""
    robots = math.ceil(episodes / EPISODES_PER_ROBOT)
    return [Assignment(scene, target, quota) for quota in split(episodes, robots)]


def assign_all(protocol, scenes, episodes):
    """The Assignments of an evaluation: so many episodes of each kind, training and new, or by
    `anywhere` in all. They are split evenly over the scenes that have targets of the kind, and
    then over these targets."""
    robots = []
    if protocol == "anywhere":
        for scene, share in zip(scenes, split(episodes, len(scenes))):
            robots += assign(scene, 0, share)
        return robots
    for new in (False, True):
        targets_of = [(scene, target_indices(scene, new)) for scene in scenes]
        targets_of = [(scene, targets) for scene, targets in targets_of if len(targets) > 0]
        for (scene, targets), share in zip(targets_of, split(episodes, len(targets_of))):
            for target, quota in zip(targets, split(share, len(targets))):
                robots += assign(scene, target, quota)
    return robots


def target_indices(scene, new):
    """The indices into scene.targets of the new targets, or of the training targets."""
    training = len(scene.training_targets)
    return range(training, len(scene.targets)) if new else range(training)
