"""Assigns a room to each robot of a training run. A given room stays the same. Random rooms change
at every stage, and a few robots drive in validation rooms, which are never trained on."""

import functools
import json
from dataclasses import fields, replace
from pathlib import Path

import scenes as scene_files
from scenes import generate
from sim import Scene, SceneError

RANDOM = "random"  # the value of `--env`
ROOM = "room.json"  # the given room, in the folder of a run
VALIDATION_ROOMS = 16  # random:0 to random:15, never trained on, our choice
FIRST_ROOM = 1_000_000  # a run with seed k trains in rooms numbered from (k + 1) * FIRST_ROOM up
DRAWS = 3  # draws of a start, at most, until a box blocks the straight line to the goal, our choice


def make_rooms(config, scenes):
    """Returns the rooms of a run. scenes: the given rooms, or the validation rooms."""
    return (RandomRooms if config.env == RANDOM else GivenRooms)(config, scenes)


def load_rooms(config):
    """Returns the Scenes of a run: the given room, or the validation rooms. A resumed run has its
    own copy of the room. Raises SceneError."""
    if config.env == RANDOM:
        return validation_scenes()
    if config.resume:
        path = Path(config.resume, ROOM)
        try:
            return [scene_files.rebuild(json.loads(path.read_text("utf-8")))]
        except (OSError, ValueError, KeyError, TypeError) as error:
            raise SceneError(f"room '{path}' cannot be used: {error}") from None
    scene = scene_files.load(config.env)
    if config.targets == "memorize":  # only one target
        scene = replace(scene, training_targets=scene.training_targets[:1], new_targets=())
    return [scene]


def validation_scenes():
    """Returns the random rooms that no run trains on, a list of Scenes."""
    return [generate.room(k) for k in range(VALIDATION_ROOMS)]


class TrainingRoom(Scene):
    """A random room to train in. In most episodes a box blocks the straight line to the goal:
    otherwise episodes soon become too easy to learn from."""
    def any_start(self, goal, rng):
        for _ in range(DRAWS):
            start = super().any_start(goal, rng)
            if generate.are_blocked(self.boxes, start[None, :2], goal[None])[0]:
                break
        return start


@functools.lru_cache(generate.MOST_KEPT)
def training_room(number):
    """Returns the TrainingRoom with this number. The robots in a room share the object."""
    room = generate.room(number)
    return TrainingRoom(**{field.name: getattr(room, field.name) for field in fields(room)})


def change_room(env, r, scene):
    """Puts robot r of a NavVecEnv, which has one Scene per robot, at the start pose of another."""
    env.scenes[r] = scene
    env.world.set_scene(r, scene)
    env.camera.set_scene(r, scene)


class GivenRooms:
    """Given rooms. At level 2 the last robots drive in mirrored rooms."""

    def __init__(self, config, scenes):
        self.scenes = scenes
        self.mirrors = [scene.mirrored() for scene in scenes]
        mirrored = config.mirrored if config.targets == "both" else 0
        self.first_in_mirror = config.robots - int(config.robots * mirrored)

    def of_robot(self, r, stage):
        """Returns the Scene that robot r drives in."""
        rooms = self.scenes if r < self.first_in_mirror else self.mirrors
        return rooms[r % len(rooms)]

    def is_watched(self, r):
        """Returns whether robot r drives in a validation room: its episodes are not trained on."""
        return False

    def by_kind(self, stage):
        """Returns Scenes to evaluate after training: the last training rooms, and new ones."""
        return {"training": self.scenes, "new": []}


class RandomRooms:
    """Random rooms, with the methods of GivenRooms. At every stage all robots change rooms."""

    def __init__(self, config, scenes):
        self.validation = scenes
        watched = max(config.robots // 16, int(config.robots > 1))  # our choice
        self.learning = config.robots - watched  # number of the first robots, which are trained on
        self.first_room = FIRST_ROOM * (1 + config.seed % 900)  # the highest number is 10 ** 9
        self.rooms = config.rooms or FIRST_ROOM  # number of rooms; FIRST_ROOM for always new ones

    def number(self, r, stage):
        """Returns the room number of robot r, which is not watched."""
        return self.first_room + (r + stage * self.learning) % self.rooms

    def of_robot(self, r, stage):
        if self.is_watched(r):
            return self.validation[(r + stage) % len(self.validation)]
        return training_room(self.number(r, stage))

    def is_watched(self, r):
        return r >= self.learning

    def by_kind(self, stage):
        numbers = list(dict.fromkeys(self.number(r, stage) for r in range(self.learning)))
        return {"training": [generate.room(k) for k in numbers[:VALIDATION_ROOMS]],
                "new": self.validation}
