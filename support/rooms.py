"""Which room each robot of a training drives in, and when it moves on to another one.

In a room that is given it stays. In random rooms all robots move on from time to time: to the next
of N rooms, or to rooms that are new. A few robots drive in rooms that nobody learns
from. They are what new targets are to level 2: they show how the policy does where it never was.
"""

import math
from dataclasses import fields, replace

from scenes import generate
from sim import Scene

RANDOM = "random"  # what `--env` calls them
VALIDATION_ROOMS = 16  # random:0 to random:15, from which no training learns; all our choice
FIRST_ROOM = 1_000_000  # a run of seed k learns in rooms from random:(k + 1) * FIRST_ROOM on
MOST_RUNS = 900  # seeds k and k + 900 share their rooms, no others do
ROBOTS_PER_WATCHED = 16  # one robot in so many drives in a room for validation
EVERY = 50_000  # steps of 64 robots from one move to the next, of other numbers in proportion: each
#   drives so long in a room that the episodes which a move drops are few
DRAWS = 3  # of a start, at most, until something is in the way to the goal


def make_rooms(config, scenes):
    """The rooms of a training. scenes: the rooms that are given, or those for validation."""
    return (RandomRooms if config.env == RANDOM else GivenRooms)(config, scenes)


def validation_scenes():
    """The random rooms that no training learns from, a list of Scenes."""
    return [generate.room(k) for k in range(VALIDATION_ROOMS)]


def mirrored(scene):
    """The room as a mirror shows it, x for -x, without the new targets. The sun stays where it is,
    so its images are the flipped ones in another light."""
    x, y, theta = scene.start
    return replace(
        scene,
        name=f"{scene.name}-mirrored",
        boxes=tuple(replace(box, x=-box.x, yaw=-box.yaw) for box in scene.boxes),
        start=(-x, y, math.pi - theta),
        training_targets=tuple((-x, y) for x, y in scene.training_targets),
        new_targets=(),
        other_starts=tuple((-x, y, math.pi - theta) for x, y, theta in scene.other_starts))


class TrainingRoom(Scene):
    """A random room to learn in: a start that is drawn anywhere is mostly behind something. Where
    nothing is in the way a robot soon has nothing left to learn."""

    def any_start(self, goal, rng):
        for _ in range(DRAWS):
            start = super().any_start(goal, rng)
            if generate.are_blocked(self.boxes, start[None, :2], goal[None])[0]:
                break
        return start


def as_training_room(scene):
    """The TrainingRoom like that Scene."""
    return TrainingRoom(**{field.name: getattr(scene, field.name) for field in fields(scene)})


class GivenRooms:
    """Robots stay where they are."""

    moves = 0

    def __init__(self, config, scenes):
        """At level 2 the last robots drive in mirrored rooms, without new targets: there they only
        train. Robot r drives in `scenes[r % len(scenes)]` or in its mirror image. What stands for a
        real room has none."""
        self.scenes = scenes
        self.mirrors = [mirrored(scene) for scene in scenes]
        has_mirrors = config.targets == "both" and not any(scene.reality for scene in scenes)
        in_mirror = int(config.robots * config.mirrored) if has_mirrors else 0
        self.first_in_mirror = config.robots - in_mirror

    def of_robot(self, r):
        """The Scene that robot r drives in."""
        rooms = self.scenes if r < self.first_in_mirror else self.mirrors
        return rooms[r % len(rooms)]

    def is_watched(self, r):
        """Whether robot r only shows how the policy does, and nothing is learnt from it."""
        return False

    def by_kind(self):
        """The Scenes for the evaluation after training: rooms that it learnt in, and others."""
        return {"training": self.scenes, "new": []}

    def due(self, steps):
        """How many moves there are in so many steps of all robots."""
        return 0

    def move(self, steps):
        """After so many steps of all robots, moves them on where it is time. Whether it is."""
        return False

    def state(self):
        """All that changes, for `load_state`."""
        return {}

    def load_state(self, state):
        """Goes back to a state. Whether robots drive elsewhere then."""
        return False


class RandomRooms:
    """From time to time all robots move on to other rooms. A room is known by its number, the seed
    it is made from. How often there was a move says all: who drives where follows from it."""

    def __init__(self, config, scenes):
        """scenes: those for validation."""
        self.validation = scenes
        watched = max(config.robots // ROBOTS_PER_WATCHED, 1 if config.robots > 1 else 0)
        self.learning = config.robots - watched  # the first ones are learnt from
        self.first_room = FIRST_ROOM * (1 + config.seed % MOST_RUNS)
        self.rooms = config.rooms or FIRST_ROOM  # how many there are; 0: ever new ones
        self.every = EVERY * config.robots / 64  # steps from one move to the next
        self.moves = 0
        self._made = {}  # number -> the Scene, since the last move

    def number(self, r):
        """The number of the room that robot r, which is learnt from, drives in."""
        k = r + self.moves * self.learning
        return self.first_room + k % self.rooms

    def of_robot(self, r):
        """The Scene that robot r drives in."""
        if self.is_watched(r):
            return self.validation[(r + self.moves) % len(self.validation)]
        number = self.number(r)
        if number not in self._made:
            self._made[number] = as_training_room(generate.room(number))
        return self._made[number]

    def is_watched(self, r):
        """Whether robot r only shows how the policy does, and nothing is learnt from it."""
        return r >= self.learning

    def by_kind(self):
        """The Scenes for the evaluation after training: of the rooms that it learnt in last, as
        many as there are for validation, and these."""
        numbers = list(dict.fromkeys(map(self.number, range(self.learning))))[:VALIDATION_ROOMS]
        return {"training": [generate.room(k) for k in numbers], "new": self.validation}

    def due(self, steps):
        """How many moves there are in so many steps of all robots."""
        return int(steps // self.every)

    def move(self, steps):
        """After so many steps of all robots, moves them on where it is time. Whether it is."""
        if self.moves >= self.due(steps):
            return False
        self.moves = self.due(steps)
        self._made = {}
        return True

    def state(self):
        """All that changes, for `load_state`."""
        return {"moves": self.moves}

    def load_state(self, state):
        """Goes back to a state. Whether robots drive elsewhere then."""
        before = self.moves
        self.moves = state["moves"]
        return self.moves != before
