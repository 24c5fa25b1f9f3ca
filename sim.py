"""The world: rooms, and many robots that drive in one pymunk space.

Why pymunk at all? It does one thing here: it says when a robot's disc touches a wall, quickly and
for many robots at once. The motion is ours: between two commands a robot drives a circular arc,
and the arc is computed in closed form (`World.drive`).

Frames and units: SI, ROS axes (x forward, y left, heading counter-clockwise), radians in (-pi, pi].
A pose is (x [m], y [m], theta [rad]). Axis letters: R robots, B boxes of a room, P points.
"""

import math
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
import pymunk
from pymunk import batch

ROBOT_RADIUS = 0.178  # [m] a Kobuki's disc, released model
CAMERA_HEIGHT = 0.281  # [m] above the floor, released model
MAX_LINEAR_VELOCITY = 0.3  # [m/s] paper III-C; the slowest is 0, the robot never reverses
MAX_ANGULAR_VELOCITY = 1.0  # [rad/s] paper III-C, both ways
ARRIVAL_DISTANCE = 0.177  # [m] robot centre to target, released config
CONTROL_PERIOD = 0.4  # [s] one command, our choice
SUBSTEPS = 4  # physics steps of one command, our choice
CELL = 0.025  # [m] grid on which a room's reachable floor is found, our choice
FAR_ENOUGH = 1.0  # [m] from a start drawn at random to its target, our choice
PERTURBATION = (0.05, 0.05, math.radians(10))  # [m, m, rad] one standard deviation, our choice
ROBOTS_PER_COPY = 32  # pymunk looks at every pair of robots that overlap before it ignores it,
#   so a crowd gets several copies of its room

ROBOT_FILTER = pymunk.ShapeFilter(group=1)  # shapes of one group neither touch nor see each other
ROBOT_TYPE = 1  # collision types of pymunk
WALL_TYPE = 2
ROW = (batch.BodyFields.POSITION | batch.BodyFields.ANGLE  # x, y, theta, vx, vy, omega
       | batch.BodyFields.VELOCITY | batch.BodyFields.ANGULAR_VELOCITY)


class SceneError(ValueError):
    """A scene that cannot be used; the message names the file and the item."""


def wrap_angle(angle):
    """The same direction [rad] in (-pi, pi]."""
    return np.pi - np.mod(np.pi - angle, 2 * np.pi)


@dataclass(frozen=True)
class Box:
    """A box on the floor: centre, yaw, size along its own x and y, height [m, rad]."""
    material: str
    x: float
    y: float
    yaw: float
    length: float
    thickness: float
    height: float

    @property
    def corners(self):
        """(4, 2) corners [m], counter-clockwise."""
        c = math.cos(self.yaw)
        s = math.sin(self.yaw)
        own = np.array([(1, 1), (-1, 1), (-1, -1), (1, -1)]) * (self.length / 2, self.thickness / 2)
        return own @ np.array([(c, s), (-s, c)]) + (self.x, self.y)


@dataclass(frozen=True)
class Scene:
    """A closed room: boxes, start pose, training targets, new (test-only) targets, in metres; some
    rooms have more start poses than one, and some say what reality does there."""
    name: str
    boxes: tuple[Box, ...]
    start: tuple[float, float, float]
    training_targets: tuple[tuple[float, float], ...]
    new_targets: tuple[tuple[float, float], ...]
    other_starts: tuple[tuple[float, float, float], ...] = ()
    reality: object = None  # a scenes.reality.Reality; None: a simulation

    @cached_property
    def targets(self):
        """(P, 2) all targets [m]: the training ones, then the new ones."""
        return np.array(self.training_targets + self.new_targets)

    @cached_property
    def bounds(self):
        """(2, 2) lowest and highest (x, y) [m] of any box."""
        corners = np.concatenate([box.corners for box in self.boxes])
        return np.stack([corners.min(0), corners.max(0)])

    def clearance(self, points):
        """Distance [m] from each of the (..., 2) points to the nearest box, negative inside one."""
        points = np.asarray(points)
        nearest = np.full(points.shape[:-1], np.inf)
        for box in self.boxes:
            c = math.cos(box.yaw)
            s = math.sin(box.yaw)
            own = (points - (box.x, box.y)) @ np.array([(c, -s), (s, c)])  # in the box's axes
            beyond = np.abs(own) - (box.length / 2, box.thickness / 2)  # past its faces
            outside = np.hypot(np.maximum(beyond[..., 0], 0), np.maximum(beyond[..., 1], 0))
            inside = np.minimum(beyond.max(-1), 0)
            nearest = np.minimum(nearest, outside + inside)
        return nearest

    @cached_property
    def reachable(self):
        """Centres (P, 2) [m] of the grid cells that the robot's disc can drive to from the start,
        sorted by x.

        A flood fill, so passages less than a cell wider than the robot may count as closed.
        Raises SceneError when the flood runs out of the room.
        """
        x, y = [np.arange(low - CELL, high + 2 * CELL, CELL) for low, high in zip(*self.bounds)]
        grid = np.stack(np.meshgrid(x, y, indexing="ij"), -1)
        free = np.full(grid.shape[:2], True)
        for box in self.boxes:
            half = np.ptp(box.corners, axis=0) / 2 + ROBOT_RADIUS + CELL
            near = np.ix_(np.abs(x - box.x) < half[0], np.abs(y - box.y) < half[1])
            free[near] &= replace(self, boxes=(box,)).clearance(grid[near]) > ROBOT_RADIUS
        flooded = flood(free, np.abs(grid - self.start[:2]).max(-1) <= CELL)
        if flooded[[0, -1]].any() or flooded[:, [0, -1]].any():
            raise SceneError("the room is not closed: the robot can drive out of it")
        return grid[flooded]

    def own_start(self, rng):
        """The start pose (3,); where the room has several, any of them."""
        starts = (self.start, *self.other_starts)
        return starts[rng.integers(len(starts))] if self.other_starts else self.start

    def any_place(self, rng):
        """A place (2,) [m] that the robot can drive to, drawn uniformly."""
        return self.reachable[rng.integers(len(self.reachable))]

    def any_start(self, goal, rng):
        """A pose (3,) at any heading, at any reachable place that is 1 m or more from a goal
        (x, y); in a smaller room, as far as can be."""
        dx = self.reachable[:, 0] - goal[0]
        dy = self.reachable[:, 1] - goal[1]
        squared = dx * dx + dy * dy
        away = np.flatnonzero(squared >= min(FAR_ENOUGH ** 2, squared.max()))
        x, y = self.reachable[away[rng.integers(len(away))]]
        return np.array([x, y, rng.uniform(-np.pi, np.pi)])

    def near(self, place, rng):
        """A pose (3,) or place (2,) near that one: moved by PERTURBATION, drawn again until the
        robot can get there, and it is not nearer to a box than the robot's disc, or than before."""
        while True:
            moved = place + rng.normal(0, PERTURBATION[:len(place)])
            no_nearer = self.clearance(moved[:2]) > min(ROBOT_RADIUS, self.clearance(place[:2]))
            if no_nearer and np.hypot(*(self.reachable - moved[:2]).T).min() < ARRIVAL_DISTANCE:
                return moved


def flood(free, source):
    """The cells of a grid that a flood from `source` fills, each through free cells beside it.
    free, source and what is returned: (X, Y) bool."""
    flooded = np.zeros_like(free)
    front = np.flatnonzero(free & source)
    while len(front):
        flooded.flat[front] = True
        around = np.add.outer((-free.shape[1], -1, 1, free.shape[1]), front).ravel() % free.size
        front = np.unique(around[free.flat[around] & ~flooded.flat[around]])
    return flooded


def _touch(arbiter, space, touched):
    """What pymunk calls where a robot touches a wall. touched: a list that gets the robot."""
    arbiter.process_collision = False  # a hit is reported, never bounced
    touched.append(arbiter.bodies[0].robot)


class World:
    """R robots in one pymunk space; robot r drives in a copy of `scenes[r]`.

    Rooms and copies of rooms lie side by side, at most ROBOTS_PER_COPY robots to a copy. Poses are
    given and returned in the coordinates of the robot's own room, and are the whole state.
    """

    def __init__(self, scenes):
        """scenes: R Scenes, one for each robot. Robots start at their scenes' start poses."""
        self.scenes = list(scenes)
        self.space = pymunk.Space()
        self._touched = []  # robots that touched a wall in this substep
        # The space lives on until Python looks for cycles, so nothing in it may hold the world.
        self.space.on_collision(ROBOT_TYPE, WALL_TYPE, pre_solve=_touch, data=self._touched)
        self._offsets = self._lay_out_rooms()  # (R, 2) own room to space
        for r in range(len(self.scenes)):
            body = pymunk.Body(mass=1, moment=1)
            disc = pymunk.Circle(body, ROBOT_RADIUS)
            disc.filter = ROBOT_FILTER
            disc.collision_type = ROBOT_TYPE
            self.space.add(body, disc)
            body.robot = r
        # One row a body, as pymunk's batch functions move them. The last is the space's static
        # body, which carries the walls and has to stay at zero.
        self._rows = np.zeros((len(self.scenes) + 1, 6))
        self._to_space = batch.Buffer()
        self._from_space = batch.Buffer()
        self._to_space.set_float_buf(self._rows)
        self.place(slice(None), np.array([scene.start for scene in self.scenes]))

    def state(self):
        """All that changes while robots drive, (R + 1, 6), for `load_state`."""
        return self._rows.copy()

    def load_state(self, state):
        """Goes back to a state of this world, exactly."""
        self._rows[:] = state
        batch.set_space_bodies(self.space, ROW, self._to_space)

    def __getstate__(self):
        """What is pickled or copied: pymunk's own pickle would lose the collision callback."""
        return {"scenes": self.scenes, "state": self.state()}

    def __setstate__(self, content):
        self.__init__(content["scenes"])
        self.load_state(content["state"])

    def _lay_out_rooms(self):
        """Adds the walls of every copy of a room to the space, copies side by side in a square of
        columns. Returns where each robot's copy lies, (R, 2) [m]."""
        robots_of = {}  # a room, by identity -> its robots
        for r, scene in enumerate(self.scenes):
            robots_of.setdefault(id(scene), []).append(r)
        copies = [robots[k:k + ROBOTS_PER_COPY] for robots in robots_of.values()
                  for k in range(0, len(robots), ROBOTS_PER_COPY)]  # the robots of each
        widths = [np.ptp(scene.bounds, axis=0) for scene in self.scenes]
        pitch = 1 + np.max(widths, axis=0)  # [m] from one copy to the next, along x and y
        columns = math.ceil(math.sqrt(len(copies)))
        offsets = np.zeros((len(self.scenes), 2))
        for k, robots in enumerate(copies):
            scene = self.scenes[robots[0]]
            place = np.array([k // columns, k % columns]) * pitch
            offset = place - scene.bounds[0]
            offsets[robots] = offset
            for box in scene.boxes:
                wall = pymunk.Poly(self.space.static_body, (box.corners + offset).tolist())
                wall.collision_type = WALL_TYPE
                self.space.add(wall)
        return offsets

    @property
    def poses(self):
        """(R, 3) poses, each in its own room."""
        poses = self._rows[:-1, :3].copy()
        poses[:, :2] -= self._offsets
        return poses

    def place(self, robots, poses):
        """Puts the robots (indices or a slice) at those (n, 3) poses, at rest."""
        poses = np.asarray(poses)
        rows = self._rows[:-1]
        rows[robots, :2] = poses[:, :2] + self._offsets[robots]
        rows[robots, 2] = wrap_angle(poses[:, 2])
        rows[robots, 3:] = 0
        batch.set_space_bodies(self.space, ROW, self._to_space)

    def drive(self, commands):
        """Drives every robot for CONTROL_PERIOD; returns (R,) bool, which of them hit a wall.

        commands: (R, 2), linear [m/s] and angular [rad/s] velocity. A substep that would end in a
        wall is not made: the robot stands where it was before it, for the rest of the period.
        """
        commands = np.array(commands, dtype=float)
        v = commands[:, 0]
        w = commands[:, 1]
        rows = self._rows[:-1]  # a view: what pymunk moves shows here
        dt = CONTROL_PERIOD / SUBSTEPS
        hit = np.zeros(len(rows), dtype=bool)
        # The arc is exact. Its chord points along the heading at half time, and is sin(a) / a as
        # long as the arc, where a = w dt / 2 (numpy's sinc(x) is sin(pi x) / (pi x)).
        chord = v * np.sinc(w * dt / (2 * np.pi))
        for _ in range(SUBSTEPS):
            before = rows[:, :3].copy()
            middle = before[:, 2] + w * dt / 2
            rows[:, 3] = chord * np.cos(middle)
            rows[:, 4] = chord * np.sin(middle)
            rows[:, 5] = w
            self._step_space(dt)
            if self._touched:
                rows[self._touched, :3] = before[self._touched]
                chord[self._touched] = 0
                w[self._touched] = 0
                hit[self._touched] = True
        rows[:, 2] = wrap_angle(rows[:, 2])
        return hit

    def _step_space(self, dt):
        """Lets pymunk move all bodies for dt [s]. `_touched` then holds the robots that hit."""
        batch.set_space_bodies(self.space, ROW, self._to_space)
        self._touched.clear()
        self.space.step(dt)
        self._from_space.clear()
        batch.get_space_bodies(self.space, ROW, self._from_space)
        self._rows[:] = np.frombuffer(self._from_space.float_buf()).reshape(-1, 6)
