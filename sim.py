"""The world: rooms, and many robots that drive in them.

pymunk detects collisions between a robot's disc and the walls. The motion is computed here, in
closed form: during each command a robot drives a circular arc (`World.drive`).

Frames and units: SI, ROS axes (x forward, y left, heading counter-clockwise), radians in (-pi, pi].
A pose is (x [m], y [m], theta [rad]). Axis letters: R robots, B boxes per room, P points.
"""

import math
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
import pymunk

ROBOT_RADIUS = 0.178  # [m] a Kobuki's disc, released model
CAMERA_HEIGHT = 0.281  # [m] above the floor, released model
MAX_LINEAR_VELOCITY = 0.3  # [m/s] paper III-C; the minimum is 0: the robot never reverses
MAX_ANGULAR_VELOCITY = 1.0  # [rad/s] paper III-C, left and right
ARRIVAL_DISTANCE = 0.177  # [m] robot centre to target, released config
CONTROL_PERIOD = 0.4  # [s] duration of a command, our choice
SUBSTEPS = 4  # collision checks per command, our choice
CELL = 0.025  # [m] cell size of the grid of reachable places, our choice
FAR_ENOUGH = 1.0  # [m] minimum distance of a random start from its target, our choice
PERTURBATION = (0.05, 0.05, math.radians(10))  # [m, m, rad] standard deviations, our choice
EVERYTHING = pymunk.ShapeFilter()  # matches every shape


class SceneError(ValueError):
    """Invalid scene. The message names the file and the item."""


def wrap_angle(angle):
    """Returns the equivalent angle [rad] in (-pi, pi]."""
    wrapped = np.pi - np.mod(np.pi - angle, 2 * np.pi)
    return np.where(wrapped > -np.pi, wrapped, np.pi)[()]  # rounding may give -pi


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

    @cached_property
    def corners(self):
        """Corners (4, 2) [m], counter-clockwise."""
        c = math.cos(self.yaw)
        s = math.sin(self.yaw)
        own = np.array([(1, 1), (-1, 1), (-1, -1), (1, -1)]) * (self.length / 2, self.thickness / 2)
        return own @ np.array([(c, s), (-s, c)]) + (self.x, self.y)


@dataclass(frozen=True)
class Scene:
    """A closed room: boxes, start pose, training targets and new (test-only) targets, in metres.
    Some rooms have several start poses; some describe the errors of a real robot."""
    name: str
    boxes: tuple[Box, ...]
    start: tuple[float, float, float]
    training_targets: tuple[tuple[float, float], ...]
    new_targets: tuple[tuple[float, float], ...]
    other_starts: tuple[tuple[float, float, float], ...] = ()
    reality: object = None  # a scenes.reality.Reality; None means no errors

    @cached_property
    def targets(self):
        """All targets (P, 2) [m]: training targets, then new ones."""
        return np.array(self.training_targets + self.new_targets)

    @cached_property
    def bounds(self):
        """Lowest and highest (x, y) of all boxes, (2, 2) [m]."""
        corners = np.concatenate([box.corners for box in self.boxes])
        return np.stack([corners.min(0), corners.max(0)])

    def clearance(self, points):
        """Returns the distance [m] from points (..., 2) to the nearest box, negative inside one."""
        points = np.asarray(points)
        nearest = np.full(points.shape[:-1], np.inf)
        for box in self.boxes:
            c = math.cos(box.yaw)
            s = math.sin(box.yaw)
            own = (points - (box.x, box.y)) @ np.array([(c, -s), (s, c)])  # in the box's axes
            beyond = np.abs(own) - (box.length / 2, box.thickness / 2)  # distance past its faces
            outside = np.hypot(np.maximum(beyond[..., 0], 0), np.maximum(beyond[..., 1], 0))
            inside = np.minimum(np.maximum(beyond[..., 0], beyond[..., 1]), 0)
            nearest = np.minimum(nearest, outside + inside)
        return nearest

    def fits(self, pose):
        """Returns whether the robot's disc at a pose (x, y, ...) is inside, clear of boxes."""
        low, high = self.bounds
        place = np.asarray(pose[:2])
        inside = (low < place).all() and (place < high).all()
        return bool(inside and self.clearance(place) > ROBOT_RADIUS)

    def mirrored(self):
        """Returns the mirror image of the room (x becomes -x), without the new targets. Its images
        are not quite the flipped images: sun and textures stay as they are."""
        starts = [(-x, y, math.pi - theta) for x, y, theta in (self.start, *self.other_starts)]
        return replace(
            self,
            name=f"{self.name}-mirrored",
            boxes=tuple(replace(box, x=-box.x, yaw=-box.yaw) for box in self.boxes),
            start=starts[0],
            other_starts=tuple(starts[1:]),
            training_targets=tuple((-x, y) for x, y in self.training_targets),
            new_targets=())

    @cached_property
    def reachable(self):
        """Centres (P, 2) [m] of the grid cells reachable by the robot from its start, sorted by x,
        found by a flood fill. A passage less than about 1.5 cells wider than the robot may count as
        closed. Raises SceneError if the flood leaves the room."""
        x, y = [np.arange(low - CELL, high + 2 * CELL, CELL) for low, high in zip(*self.bounds)]
        grid = np.stack(np.meshgrid(x, y, indexing="ij"), -1)
        free = np.full(grid.shape[:2], True)
        for box in self.boxes:
            half = np.ptp(box.corners, axis=0) / 2 + ROBOT_RADIUS + CELL
            near = np.ix_(np.abs(x - box.x) < half[0], np.abs(y - box.y) < half[1])
            free[near] &= replace(self, boxes=(box,)).clearance(grid[near]) > ROBOT_RADIUS
        flooded = flood(free, np.abs(grid - self.start[:2]).max(-1) <= CELL)
        exits = [*grid[[0, -1]][flooded[[0, -1]]], *grid[:, [0, -1]][flooded[:, [0, -1]]]]
        if exits:
            x, y = exits[0]
            raise SceneError(f"the room is not closed: the robot can leave at ({x:.2f}, {y:.2f})")
        return grid[flooded]

    def own_start(self, rng):
        """Returns the start pose (3,); if the room has several, draws one of them."""
        starts = (self.start, *self.other_starts)
        return starts[rng.integers(len(starts))] if self.other_starts else self.start

    def any_place(self, rng):
        """Draws a reachable place (2,) [m] uniformly."""
        return self.reachable[rng.integers(len(self.reachable))]

    def any_start(self, goal, rng):
        """Draws a pose (3,) with any heading, at a reachable place at least 1 m from a goal (x, y);
        in a smaller room, at the farthest place."""
        dx = self.reachable[:, 0] - goal[0]
        dy = self.reachable[:, 1] - goal[1]
        squared = dx * dx + dy * dy
        away = np.flatnonzero(squared >= min(FAR_ENOUGH ** 2, squared.max()))
        x, y = self.reachable[away[rng.integers(len(away))]]
        return np.array([x, y, rng.uniform(-np.pi, np.pi)])

    def near(self, place, rng):
        """Perturbs a pose (3,) or place (2,) by PERTURBATION. Draws again until the robot fits
        there, or is no closer to a box than before, and can arrive there."""
        while True:
            moved = place + rng.normal(0, PERTURBATION[:len(place)])
            no_nearer = self.clearance(moved[:2]) > min(ROBOT_RADIUS, self.clearance(place[:2]))
            if no_nearer and np.hypot(*(self.reachable - moved[:2]).T).min() < ARRIVAL_DISTANCE:
                return moved


def flood(free, source):
    """Returns the cells that a flood fill from `source` reaches through neighbouring free cells.
    free, source, result: (X, Y) bool. It floods whole runs of free cells, along x and along y."""
    blocked = np.pad(~free, (0, 1), constant_values=True)  # a run ends at the edge
    # Free cells with the same number of blocked cells before them are in the same run.
    along_x = np.cumsum(blocked.T).reshape(blocked.T.shape).T[:-1, :-1]
    along_y = np.cumsum(blocked).reshape(blocked.shape)[:-1, :-1]
    flooded = free & source
    before = None
    while not np.array_equal(flooded, before):
        before = flooded
        for run in (along_x, along_y):
            reached = np.zeros(run[-1, -1] + 1, bool)
            reached[run[flooded]] = True
            flooded = free & reached[run]
    return flooded


def walls_of(scene):
    """Returns a pymunk Space with the boxes of a scene."""
    space = pymunk.Space()
    for box in scene.boxes:
        space.add(pymunk.Poly(space.static_body, box.corners.tolist()))
    return space


class World:
    """R robots; robot r drives in `scenes[r]`. Robots neither see each other nor collide."""

    def __init__(self, scenes):
        """scenes: R Scenes, one per robot. Robots start at the start poses of their scenes."""
        self.scenes = list(scenes)
        spaces = {id(scene): walls_of(scene) for scene in self.scenes}  # shared by robots in a room
        self._spaces = [spaces[id(scene)] for scene in self.scenes]
        self._poses = np.zeros((len(self.scenes), 3))
        self.place(slice(None), [scene.start for scene in self.scenes])

    def set_scene(self, r, scene):
        """Puts robot r at the start pose of another Scene."""
        self.scenes[r] = scene
        self._spaces[r] = walls_of(scene)
        self.place(r, scene.start)

    @property
    def poses(self):
        """A copy of the poses (R, 3)."""
        return self._poses.copy()

    def place(self, robots, poses):
        """Puts robots (indices or a slice) at poses (n, 3)."""
        self._poses[robots] = poses
        self._poses[robots, 2] = wrap_angle(self._poses[robots, 2])

    def drive(self, commands):
        """Drives every robot for CONTROL_PERIOD. Returns (R,) bool: True for robots that collided.

        commands: (R, 2), linear [m/s] and angular [rad/s] velocity. A robot does not make a substep
        that would end in a wall: it stops before it for the rest of the period.
        """
        v, w = np.array(commands, dtype=float).T
        dt = CONTROL_PERIOD / SUBSTEPS
        # The chord of the arc points along the heading halfway through the substep. Its length is
        # sin(a) / a times that of the arc, a = w dt / 2 (numpy's sinc(x) is sin(pi x) / (pi x)).
        speed = v * np.sinc(w * dt / (2 * np.pi))  # along the chord
        hit = np.zeros(len(v), dtype=bool)
        reach = ROBOT_RADIUS + np.abs(v) * CONTROL_PERIOD + 1e-6
        near = [r for r in range(len(v)) if self._collides(r, self._poses[r], reach[r])]
        for _ in range(SUBSTEPS):
            middle = self._poses[:, 2] + w * dt / 2
            ahead = self._poses.copy()
            ahead[:, 0] += speed * np.cos(middle) * dt
            ahead[:, 1] += speed * np.sin(middle) * dt
            ahead[:, 2] += w * dt
            for r in near:  # the others cannot reach a wall in this period
                hit[r] = hit[r] or self._collides(r, ahead[r], ROBOT_RADIUS)
            self._poses = np.where(hit[:, None], self._poses, ahead)
        self._poses[:, 2] = wrap_angle(self._poses[:, 2])
        return hit

    def _collides(self, r, pose, radius):
        """Returns whether a disc at a pose overlaps a wall of robot r's room."""
        x, y, _ = pose.tolist()
        return self._spaces[r].point_query_nearest((x, y), radius, EVERYTHING) is not None
