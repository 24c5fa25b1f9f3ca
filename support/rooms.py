"""Which room each robot of a training drives in. A given room stays. In random rooms all robots
move on at every stage; a few drive in rooms for validation, from which no training learns."""

import functools
from dataclasses import fields, replace
from pathlib import Path

import scenes as scene_files
from scenes import generate
from sim import Scene

RANDOM = "random"  # the value of `--env`
VALIDATION_ROOMS = 16  # random:0 to random:15, from which no training learns; all our choice
FIRST_ROOM = 1_000_000  # a run of seed k learns in rooms from random:(k + 1) * FIRST_ROOM on
DRAWS = 3  # of a start, at most, until something blocks the straight line to the goal


def make_rooms(config, scenes):
    """Returns the rooms of a training. scenes: the given rooms, or those for validation."""
    return (RandomRooms if config.env == RANDOM else GivenRooms)(config, scenes)


def load_rooms(config):
    """Returns the Scenes of a training: the given room, or those for validation. A resumed run
    has its own copy of the room's file. Raises SceneError."""
    if config.env == RANDOM:
        return validation_scenes()
    file = scene_files.find(config.env)
    if config.resume and file is not None:
        file = Path(config.resume, file.name)
    scene = scene_files.load(file or config.env)
    if config.targets == "memorize":  # one target, and there are no others
        scene = replace(scene, training_targets=scene.training_targets[:1], new_targets=())
    return [scene]


def validation_scenes():
    """Returns the random rooms that no training learns from, a list of Scenes."""
    return [generate.room(k) for k in range(VALIDATION_ROOMS)]


class TrainingRoom(Scene):
    """A random room to learn in. Something mostly blocks the straight line from start to goal:
    otherwise a robot soon has nothing left to learn."""
    def any_start(self, goal, rng):
        for _ in range(DRAWS):
            start = super().any_start(goal, rng)
            if generate.are_blocked(self.boxes, start[None, :2], goal[None])[0]:
                break
        return start


@functools.lru_cache(generate.MOST_KEPT)
def training_room(number):
    """Returns the TrainingRoom of that number. Robots of one room share it."""
    room = generate.room(number)
    return TrainingRoom(**{field.name: getattr(room, field.name) for field in fields(room)})


class GivenRooms:
    """The rooms are given. At level 2 the last robots drive in their mirror images."""

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
        """Returns whether nothing is learned from robot r."""
        return False

    def by_kind(self, stage):
        """Returns the Scenes for the evaluation after training: learned in last, and others."""
        return {"training": self.scenes, "new": []}


class RandomRooms:
    """As GivenRooms, but at every stage all robots move on to other random rooms."""

    def __init__(self, config, scenes):
        self.validation = scenes
        watched = max(config.robots // 16, int(config.robots > 1))  # our choice
        self.learning = config.robots - watched  # the first robots are learned from
        self.first_room = FIRST_ROOM * (1 + config.seed % 900)  # the highest number is 10 ** 9
        self.rooms = config.rooms or FIRST_ROOM  # how many there are; 0: always new ones

    def number(self, r, stage):
        """Returns the number of the room that robot r, which is learned from, drives in."""
        return self.first_room + (r + stage * self.learning) % self.rooms

    def of_robot(self, r, stage):
        if self.is_watched(r):
            return self.validation[(r + stage) % len(self.validation)]
        return training_room(self.number(r, stage))

    def is_watched(self, r):
        return r >= self.learning

    def by_kind(self, stage):
        learned_in = list(dict.fromkeys(self.number(r, stage) for r in range(self.learning)))
        return {"training": [generate.room(k) for k in learned_in[:VALIDATION_ROOMS]],
                "new": self.validation}
