"""The world: rooms, and many robots driving in one pymunk space.

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
SUBSTEPS = 4  # physics steps of one command
ROBOTS_PER_COPY = 32  # pymunk pairs all robots that overlap, so a crowd gets rooms of its own

_ROBOTS = pymunk.ShapeFilter(group=1)  # shapes of one group neither touch nor see each other
_ROBOT_TYPE, _WALL_TYPE = 1, 2
_ROW = (batch.BodyFields.POSITION | batch.BodyFields.ANGLE  # x, y, theta, vx, vy, omega
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
        c, s = math.cos(self.yaw), math.sin(self.yaw)
        own = np.array([(1, 1), (-1, 1), (-1, -1), (1, -1)]) * (self.length / 2, self.thickness / 2)
        return own @ np.array([(c, s), (-s, c)]) + (self.x, self.y)


@dataclass(frozen=True)
class Scene:
    """A closed room: boxes, start pose, training targets, new (test-only) targets, in metres."""
    name: str
    boxes: tuple[Box, ...]
    start: tuple[float, float, float]
    training_targets: tuple[tuple[float, float], ...]
    new_targets: tuple[tuple[float, float], ...]

    @cached_property
    def targets(self):
        """(P, 2) all targets [m]: the training ones, then the new ones."""
        return np.array(self.training_targets + self.new_targets)

    @cached_property
    def bounds(self):
        """(2, 2) lowest and highest (x, y) [m] of any box."""
        corners = np.concatenate([box.corners for box in self.boxes])
        return np.stack([corners.min(0), corners.max(0)])

    def mirrored(self):
        """The room as a mirror shows it, x for -x, without the new targets. The sun stays where it
        is, so its images are the flipped ones in another light."""
        x, y, theta = self.start
        boxes = tuple(replace(box, x=-box.x, yaw=-box.yaw) for box in self.boxes)
        return Scene(self.name, boxes, (-x, y, math.pi - theta),
                     tuple((-x, y) for x, y in self.training_targets), ())

    def clearance(self, points):
        """Distance [m] from each of the (..., 2) points to the nearest box, negative inside one."""
        nearest = np.full(np.shape(points)[:-1], np.inf)
        for box in self.boxes:
            c, s = math.cos(box.yaw), math.sin(box.yaw)
            own = (np.asarray(points) - (box.x, box.y)) @ np.array([(c, -s), (s, c)])
            beyond = np.abs(own) - (box.length / 2, box.thickness / 2)
            outside = np.hypot(*np.maximum(beyond, 0).T).T
            nearest = np.minimum(nearest, outside + np.minimum(beyond.max(-1), 0))
        return nearest

    @cached_property
    def reachable(self):
        """Centres (P, 2) [m] of the grid cells that the robot's disc can drive to from the start.

        A flood fill, so passages less than a cell wider than the robot may count as closed.
        Raises SceneError when the flood runs out of the room.
        """
        (low, high), cell = self.bounds, 0.025
        x, y = (np.arange(a - cell, b + 2 * cell, cell) for a, b in zip(low, high))
        grid = np.stack(np.meshgrid(x, y, indexing="ij"), -1)
        free = self.clearance(grid) > ROBOT_RADIUS
        flood = free & (np.abs(grid - self.start[:2]).max(-1) <= cell)
        size = 0
        while flood.sum() > size:
            size = flood.sum()
            grown = flood.copy()
            for step, axis in ((-1, 0), (1, 0), (-1, 1), (1, 1)):
                grown |= np.roll(flood, step, axis)
            flood = grown & free
        if flood[[0, -1]].any() or flood[:, [0, -1]].any():
            raise SceneError("the room is not closed: the robot can drive out of it")
        return grid[flood]

    @cached_property
    def starts(self):
        """For each target the reachable (P, 2) points [m] that are 1 m away or more; in a smaller
        room those that are farthest away."""
        distances = (np.hypot(*(self.reachable - target).T) for target in self.targets)
        return [self.reachable[d >= min(1, d.max())] for d in distances]


class World:
    """R robots in one pymunk space; robot r drives in a copy of `scenes[r]`.

    Rooms and copies of rooms lie side by side, at most ROBOTS_PER_COPY robots to a copy. Poses are
    given and returned in the coordinates of the robot's own room, and are the whole state.
    """

    def __init__(self, scenes):
        self.scenes = list(scenes)
        self.space = pymunk.Space()
        self.space.on_collision(_ROBOT_TYPE, _WALL_TYPE, pre_solve=self._touch)
        self._offsets = self._lay_out_rooms()  # (R, 2) own room to space
        self._touched = []
        self._index = {}
        for r in range(len(self.scenes)):
            body = pymunk.Body(mass=1, moment=1)
            disc = pymunk.Circle(body, ROBOT_RADIUS)
            disc.filter, disc.collision_type = _ROBOTS, _ROBOT_TYPE
            self.space.add(body, disc)
            self._index[body] = r
        # One row a body, as pymunk's batch functions move them. The last is the space's static
        # body, which carries the walls and has to stay at zero.
        self._rows = np.zeros((len(self.scenes) + 1, 6))
        self._to_space, self._from_space = batch.Buffer(), batch.Buffer()
        self._to_space.set_float_buf(self._rows)
        self.place(slice(None), np.array([scene.start for scene in self.scenes]))

    def _lay_out_rooms(self):
        rooms = {}
        for r, scene in enumerate(self.scenes):
            rooms.setdefault(id(scene), []).append(r)
        copies = [robots[k:k + ROBOTS_PER_COPY] for robots in rooms.values()
                  for k in range(0, len(robots), ROBOTS_PER_COPY)]
        pitch = 1 + np.max([np.ptp(scene.bounds, axis=0) for scene in self.scenes], axis=0)
        columns = math.ceil(math.sqrt(len(copies)))
        offsets = np.zeros((len(self.scenes), 2))
        for k, robots in enumerate(copies):
            scene = self.scenes[robots[0]]
            offsets[robots] = offset = pitch * divmod(k, columns) - scene.bounds[0]
            for box in scene.boxes:
                wall = pymunk.Poly(self.space.static_body, (box.corners + offset).tolist())
                wall.collision_type = _WALL_TYPE
                self.space.add(wall)
        return offsets

    def _touch(self, arbiter, space, data):
        arbiter.process_collision = False  # a hit is reported, never bounced
        self._touched.append(self._index[arbiter.bodies[0]])

    @property
    def poses(self):
        """(R, 3) poses, each in its own room."""
        poses = self._rows[:-1, :3].copy()
        poses[:, :2] -= self._offsets
        return poses

    def place(self, robots, poses):
        """Puts the robots (indices or a slice) at those (n, 3) poses, at rest."""
        rows = self._rows[:-1]
        rows[robots, :2] = np.asarray(poses)[:, :2] + self._offsets[robots]
        rows[robots, 2] = wrap_angle(np.asarray(poses)[:, 2])
        rows[robots, 3:] = 0
        batch.set_space_bodies(self.space, _ROW, self._to_space)

    def drive(self, commands):
        """Drives every robot for CONTROL_PERIOD; returns (R,) bool, which of them hit a wall.

        commands: (R, 2), linear [m/s] and angular [rad/s] velocity. A substep that would end in a
        wall is not made: the robot stands where it was before it, for the rest of the period.
        """
        v, w = np.array(commands, dtype=float).T
        rows, dt = self._rows[:-1], CONTROL_PERIOD / SUBSTEPS
        hit = np.zeros(len(rows), dtype=bool)
        for _ in range(SUBSTEPS):
            before = rows[:, :3].copy()
            # An arc's chord points along the heading at half time and is sin(a) / a shorter than
            # the arc, a = w dt / 2 (numpy's sinc has pi in it), so arcs are exact.
            chord = v * np.sinc(w * dt / (2 * np.pi))
            middle = before[:, 2] + w * dt / 2
            rows[:, 3], rows[:, 4], rows[:, 5] = chord * np.cos(middle), chord * np.sin(middle), w
            batch.set_space_bodies(self.space, _ROW, self._to_space)
            self._touched.clear()
            self.space.step(dt)
            self._from_space.clear()
            batch.get_space_bodies(self.space, _ROW, self._from_space)
            self._rows[:] = np.frombuffer(self._from_space.float_buf()).reshape(-1, 6)
            if self._touched:
                rows[self._touched, :3] = before[self._touched]
                v[self._touched] = w[self._touched] = 0
                hit[self._touched] = True
        rows[:, 2] = wrap_angle(rows[:, 2])
        return hit

    def range_readings(self, angles, max_range):
        """(R, len(angles)) distances [m] from each robot's centre to the first wall, at most
        max_range [m], along rays at those angles [rad] from its heading (paper IV-C)."""
        readings = np.full((len(self.scenes), len(angles)), float(max_range))
        for r, (x, y, theta) in enumerate(self._rows[:-1, :3]):
            for k, angle in enumerate(angles):
                way = math.cos(theta + angle), math.sin(theta + angle)
                end = x + max_range * way[0], y + max_range * way[1]
                hit = self.space.segment_query_first((x, y), end, 0, _ROBOTS)
                readings[r, k] *= hit.alpha if hit else 1
        return readings
