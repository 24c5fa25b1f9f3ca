"""Planners and reflexes for comparison: the methods that the paper contrasts itself with. Each gets
its exact pose, which the learner never does; the docstrings list what else it knows. A pose is
(x [m], y [m], theta [rad]), a point (x, y) [m], a command (v [m/s], w [rad/s])."""

import functools
import heapq
import itertools
import math
from collections import defaultdict

import numpy as np
import pymunk

from sim import (ARRIVAL_DISTANCE, CONTROL_PERIOD, MAX_ANGULAR_VELOCITY, MAX_LINEAR_VELOCITY,
                 ROBOT_RADIUS, wrap_angle)

# All values below are our choice.
ANGLES = np.radians(np.arange(-180, 180, 5))  # [rad] directions of the sensors, from the heading
RANGE = 3.0  # [m] range of the sensors
STRIDE = MAX_LINEAR_VELOCITY * CONTROL_PERIOD  # [m] longest step
GAP = 0.001  # [m] distance of a shortest path from the walls
MARGIN = 0.02  # [m] distance from walls of planners that sense them
TAUT = 0.05  # sine of the largest angle by which a leg may cut a corner
INSIDE = 1 - 1e-6  # factor of the arrival distance: a path ends inside the circle, not on it
AROUND = [(math.cos(turn), math.sin(turn)) for turn in 2 * np.pi * np.arange(12) / 12]


def polar(pose, point):
    """Returns the distance [m] and the bearing [rad] of a point from a pose."""
    dx, dy = np.subtract(point, pose[:2])
    return math.hypot(dx, dy), wrap_angle(math.atan2(dy, dx) - pose[2])


def turn_and_go(pose, point):
    """Returns the command to turn in place towards a point or, once it is ahead, drive to it."""
    distance, bearing = polar(pose, point)
    if abs(bearing) > 1e-6 and distance > 1e-6:
        return 0.0, np.clip(bearing / CONTROL_PERIOD, -MAX_ANGULAR_VELOCITY, MAX_ANGULAR_VELOCITY)
    return min(distance / CONTROL_PERIOD, MAX_LINEAR_VELOCITY), 0.0


class Roadmap:
    """A graph of the points (n, 2) [m] where the disc fits, joined if it fits between them. Legs
    between points are checked when a search needs them, and kept."""

    def __init__(self, scene, points, sides=None):
        """sides: (n, 2, 2) unit vectors along the two faces that meet at each point. If given, legs
        are left out that no shortest path has: those that do not pass the corner at both ends."""
        self.space = pymunk.Space()  # walls grown by the radius: the robot is a point
        for box in scene.boxes:
            self.space.add(pymunk.Poly(self.space.static_body, box.corners.tolist(),
                                       radius=ROBOT_RADIUS))
        fits = scene.clearance(points) > ROBOT_RADIUS
        self.points = points[fits]
        self.sides = None if sides is None else sides[fits]
        self.index_of = {point: k for k, point in enumerate(map(tuple, self.points.tolist()))}
        self.legs = functools.cache(self._legs)

    def free(self, a, b):
        """Returns whether the disc fits along the line from a to b. It must fit at a."""
        return self.space.segment_query_first(a, b, 0, pymunk.ShapeFilter()) is None

    def _legs(self, point):
        """Returns the points to which free lines lead from a point where the disc fits."""
        useful = np.ones(len(self.points), bool)
        if self.sides is not None:
            along = self.points - point
            along /= np.maximum(np.hypot(*along.T), 1e-9)[:, None]
            useful = passes(along, self.sides)
            if point in self.index_of:
                useful &= passes(along, self.sides[self.index_of[point]])
        return [other for other in map(tuple, self.points[useful].tolist())
                if other != point and self.free(point, other)]

    def path(self, start, goal, within=ARRIVAL_DISTANCE):
        """Returns the points (x, y) after the start of the shortest path that ends `within` [m] of
        the goal, and its length [m]; None and inf if there is no path. Searches by A*."""
        # Entries: the least length of any path by the point, its length up to the point, the point,
        # the point before it, and whether it is the end.
        queue = [(0.0, 0.0, tuple(start), None, False)]
        previous = {}  # point -> the point before it
        while queue:
            _, length, point, before, is_end = heapq.heappop(queue)
            if is_end:
                points = [point]
                while previous[before]:
                    points.append(before)
                    before = previous[before]
                return points[::-1], length
            if point in previous:
                continue
            previous[point] = before
            end = self._last_leg(point, goal, within)
            if end is not None:
                whole = length + math.dist(point, end)
                heapq.heappush(queue, (whole, whole, end, point, True))
            for other in self.legs(point):
                if other not in previous:
                    so_far = length + math.dist(point, other)
                    least = so_far + max(math.dist(other, goal) - within, 0)
                    heapq.heappush(queue, (least, so_far, other, point, False))
        return None, math.inf

    def _last_leg(self, point, goal, within):
        """Returns the nearest point in the goal's circle to which a free line leads, or None."""
        distance = math.dist(point, goal)
        if distance <= within:
            return point
        straight = np.subtract(point, goal) / distance
        circle = goal + within * INSIDE * np.vstack([straight, AROUND])
        ends = sorted(circle.tolist(), key=lambda end: math.dist(point, end))
        return next((tuple(end) for end in ends if self.free(point, end)), None)


def passes(along, sides):
    """Returns which lines in directions `along` (n, 2) have both faces (..., 2, 2) of a corner on
    one side, (n,) bool. A small angle is allowed, because the corners are rounded."""
    across = along[:, None, 0] * sides[..., 1] - along[:, None, 1] * sides[..., 0]  # sines (n, 2)
    return (across.min(-1) > -TAUT) | (across.max(-1) < TAUT)


def visibility_graph(scene):
    """Returns the Roadmap of shortest paths, which bend only at corners (Lozano-Perez and Wesley
    1979). Around a corner the disc's path is an arc; four points make it at most 1.3 % longer."""
    distance = (ROBOT_RADIUS + GAP) / np.cos(np.pi / 16)  # [m] from the corner to the points
    quarter = (np.arange(4) + 0.5) * np.pi / 8
    points = []
    sides = []
    for box in scene.boxes:
        along = box.yaw + np.arange(4)[:, None] * np.pi / 2 + quarter  # between two faces' normals
        around = distance * np.stack([np.cos(along), np.sin(along)], -1)  # (4 corners, 4, 2)
        outline = (box.corners[:, None] + around).reshape(16, 2)
        edges = np.roll(outline, -1, axis=0) - outline
        edges /= np.hypot(*edges.T)[:, None]
        points.append(outline)
        sides.append(np.stack([edges, -np.roll(edges, 1, axis=0)], 1))
    return Roadmap(scene, np.concatenate(points), np.concatenate(sides))


class Planner:
    """Drives one robot in one scene. `prepare` computes what the planners of a scene share."""

    senses = False  # whether `act` uses range readings

    @staticmethod
    def prepare(scene, rng):
        """Returns the shared knowledge of a scene, computed once, or None. rng: numpy Generator."""

    def __init__(self, scene, rng, knowledge):
        """knowledge: the result of `prepare` for this scene. rng: numpy Generator."""
        self.scene = scene
        self.rng = rng
        self.knowledge = knowledge

    def begin(self, pose, goal):
        """Begins an episode at a pose. goal: (x, y) [m]."""
        self.goal = (float(goal[0]), float(goal[1]))

    def act(self, pose, readings):
        """Returns the command of one step. readings: (len(ANGLES),) [m] if it `senses`."""


class Oracle(Planner):
    """Drives the shortest path; does not move if there is none. Knows the whole map."""

    @staticmethod
    def prepare(scene, rng):
        return visibility_graph(scene)

    def begin(self, pose, goal):
        super().begin(pose, goal)
        self.path = self.knowledge.path(pose[:2], self.goal)[0] or []  # points still to reach

    def act(self, pose, readings):
        while self.path and math.dist(pose[:2], self.path[0]) < 1e-6:
            self.path.pop(0)
        return turn_and_go(pose, self.path[0]) if self.path else (0.0, 0.0)


class PRM(Oracle):
    """A probabilistic roadmap with Gaussian sampling (Boor et al. 1999): of two close
    points, one is kept if only that one is free: it is near a wall. Knows the whole map."""

    @staticmethod
    def prepare(scene, rng):
        low, high = scene.bounds
        points = []
        while len(points) < 100:
            one = rng.uniform(low, high)
            pair = np.stack([one, one + rng.normal(0, 0.2, 2)])  # [m]
            fits = scene.clearance(pair) > ROBOT_RADIUS
            if fits.sum() == 1:
                points.append(pair[fits][0])
        return Roadmap(scene, np.array(points))


class DStar(Planner):
    """D* Lite (Koenig and Likhachev 2002) on a grid that starts empty. Range readings add walls,
    and only the affected part of the search is repeated. Each cell s has g(s), its last settled
    cost to the goal [cells], and rhs(s), its cost from the current g of its neighbours. If they
    differ, s waits in the queue. Unlike in that paper, keys refer to the robot's first cell, so
    they stay valid while it drives. Has range sensors all around but no map."""

    senses = True
    CELL = 0.06  # [m]
    DETOUR = 8.0  # [m] maximum length of a path in addition to the straight line
    STEPS = [(1, 0), (1, 1), (0, 1), (-1, 1), (-1, 0), (-1, -1), (0, -1), (1, -1)]

    def begin(self, pose, goal):
        super().begin(pose, goal)
        self.blocked = set()  # cells that the robot's centre cannot enter
        self.g = defaultdict(lambda: math.inf)
        self.rhs = defaultdict(lambda: math.inf)
        self.target = self._cell(goal)
        self.begun = self._cell(pose[:2])  # first cell of the robot
        self.start = self.begun  # current cell of the robot
        # Without this limit the search for an unreachable goal would not end: the grid is infinite.
        self.longest = math.dist(self.begun, self.target) + self.DETOUR / self.CELL  # [cells]
        self.rhs[self.target] = 0.0
        self.queue = [(self._key(self.target), self.target)]  # a heap; outdated entries stay in it

    def act(self, pose, readings):
        """Drives to the best next cell; straight to the goal in its cell or if no path exists."""
        self.start = self._cell(pose[:2])
        new = self._new_walls(pose, readings)
        changed = {n for s in new for n, _ in self._neighbours(s)} | new
        self.blocked |= new
        for s in changed:
            self._update(s)
        # Settle waiting cells until the robot's cell is settled and no cell before it waits.
        while self.queue and self.queue[0][0][0] <= self.longest:
            settled = self.g[self.start] == self.rhs[self.start]
            if settled and self.queue[0][0] >= self._key(self.start):
                break
            key, s = heapq.heappop(self.queue)
            if self.g[s] == self.rhs[s] or key != self._key(s):
                continue  # outdated entry
            # A shorter path settles s. If the old path is blocked, s waits for a longer one.
            self.g[s] = self.rhs[s] if self.g[s] > self.rhs[s] else math.inf
            for n, _ in [*self._neighbours(s), (s, 0)]:
                self._update(n)
        if self.start == self.target or self.rhs[self.start] == math.inf:
            return turn_and_go(pose, self.goal)
        _, (i, j) = min((self.g[n] + step, n) for n, step in self._neighbours(self.start))
        return turn_and_go(pose, (i * self.CELL, j * self.CELL))

    def _cell(self, point):
        """Returns the cell (i, j) that contains a point [m]. Its centre is at (i, j) * CELL."""
        return round(point[0] / self.CELL), round(point[1] / self.CELL)

    def _neighbours(self, s):
        """Returns the free neighbours of a free cell, each with the cost [cells] of the step."""
        if s in self.blocked:
            return []
        around = [((s[0] + dx, s[1] + dy), math.hypot(dx, dy)) for dx, dy in self.STEPS]
        return [(n, step) for n, step in around if n not in self.blocked]

    def _key(self, s):
        """Returns the key of a cell: a lower bound on path cost through it, and its cost."""
        cost = min(self.g[s], self.rhs[s])
        # Rounded, because the keys along a straight path differ only by floating-point errors.
        return round(cost + math.dist(self.begun, s), 6), round(cost, 6)

    def _update(self, s):
        """Computes rhs(s) again, and queues s if it differs from g(s)."""
        if s != self.target:
            self.rhs[s] = min((self.g[n] + step for n, step in self._neighbours(s)),
                              default=math.inf)
        if self.g[s] != self.rhs[s]:
            heapq.heappush(self.queue, (self._key(s), s))

    def _new_walls(self, pose, readings):
        """Returns the cells that readings newly block; the cells of robot and goal stay free."""
        angles = pose[2] + ANGLES
        ends = pose[:2] + readings[:, None] * np.stack([np.cos(angles), np.sin(angles)], -1)
        ends = ends[readings < RANGE - 1e-6, None]  # (k, 1, 2)
        reach = math.ceil((ROBOT_RADIUS + MARGIN) / self.CELL) + 1  # [cells]
        square = np.array(list(itertools.product(range(-reach, reach + 1), repeat=2)))
        cells = np.round(ends / self.CELL) + square  # (k, cells of the square, 2)
        near = np.linalg.norm(cells * self.CELL - ends, axis=-1) < ROBOT_RADIUS + MARGIN
        new = set(map(tuple, cells[near].astype(int).tolist()))
        return new - self.blocked - {self.start, self.target}


def room_ahead(readings, direction):
    """Distance [m], at most RANGE, that the disc can drive in a direction [rad from heading]."""
    x = readings * np.cos(ANGLES - direction)  # measured points, along the direction
    y = readings * np.sin(ANGLES - direction)  # and across it
    radius = ROBOT_RADIUS + MARGIN
    meets = (np.abs(y) < radius) & (x > 0) & (readings < RANGE - 1e-6)
    return (x[meets] - np.sqrt(radius ** 2 - y[meets] ** 2)).min(initial=RANGE)


class Bug(Planner):
    """Bug2 (Lumelsky and Stepanov 1987): drives straight to the target, and around obstacles, wall
    on the right, until it is back on the line and nearer. Has range sensors but no map."""

    senses = True

    def begin(self, pose, goal):
        super().begin(pose, goal)
        self.line = pose[2] + polar(pose, goal)[1]  # [rad] direction from start to target
        self.hit = None  # [m] distance to the goal when it met the wall; None: no wall
        self.wall = None  # [rad from the heading] rough direction of the wall
        self.step = None  # the point to which it drives; None: to be chosen

    def act(self, pose, readings):
        if self.step is None:
            direction, stride = self._next_step(pose, readings)
            self.step = (pose[0] + stride * math.cos(pose[2] + direction),
                         pose[1] + stride * math.sin(pose[2] + direction))
        distance, bearing = polar(pose, self.step)
        if abs(bearing) > MAX_ANGULAR_VELOCITY * CONTROL_PERIOD / 2:
            return turn_and_go(pose, self.step)
        # An arc to a point turns by twice the bearing of the point. It is bearing / sin(bearing)
        # times as long as the straight line; numpy's sinc(x) is sin(pi x) / (pi x).
        self.step = None
        arc = distance / np.sinc(bearing / np.pi)
        return min(arc / CONTROL_PERIOD, MAX_LINEAR_VELOCITY), 2 * bearing / CONTROL_PERIOD

    def _next_step(self, pose, readings):
        """Returns the direction [rad from the heading] and length [m] of the next step."""
        distance, bearing = polar(pose, self.goal)
        stride = min(STRIDE, distance)
        ahead = room_ahead(readings, bearing)
        off_line = distance * abs(math.sin(pose[2] + bearing - self.line))
        if self.hit and off_line < STRIDE < ahead and distance < self.hit - STRIDE:
            self.hit = None  # Bug2's condition to leave the wall
        if self.hit is None and ahead < stride:
            self.hit = distance
            self.wall = bearing
        if self.hit is None:
            return bearing, stride
        towards = np.abs(wrap_angle(ANGLES - self.wall)) < np.radians(100)
        nearest = np.where(towards, readings, np.inf).argmin()
        gap = readings[nearest] - ROBOT_RADIUS - 0.06  # [m] excess distance from the wall
        along = ANGLES[nearest] + np.pi / 2 - np.clip(4 * gap, -0.8, 0.8)
        self.wall = -np.pi / 2  # after this step the robot heads along the wall
        turns = along + np.radians(np.arange(0, 360, 10))  # takes the first free direction
        return next((turn for turn in turns if room_ahead(readings, turn) > stride), along), stride


class Braitenberg(Planner):
    """Turns to the target and away from walls (Braitenberg 1984). Has range sensors but no map."""

    senses = True

    def act(self, pose, readings):
        nearness = np.clip(1 - (readings - ROBOT_RADIUS) / 0.4, 0, 1)  # 1 at a wall, 0 beyond 0.4 m
        near = nearness * np.maximum(np.cos(ANGLES), 0)  # walls ahead count most, behind not
        leftwards = near[ANGLES < 0].sum() - near[ANGLES > 0].sum()  # away from the nearer side
        turn = np.clip(1.5 * polar(pose, self.goal)[1] + 0.8 * leftwards, -1, 1)
        return MAX_LINEAR_VELOCITY * max(0.05, 1 - near.max()), turn * MAX_ANGULAR_VELOCITY


class Straight(Planner):
    """Turns to the target and drives to it. Has no map and no sensors."""

    def act(self, pose, readings):
        return turn_and_go(pose, self.goal)


class Random(Planner):
    """Drives with random velocities. Knows nothing."""

    def act(self, pose, readings):
        return self.rng.uniform((0, -MAX_ANGULAR_VELOCITY),
                                (MAX_LINEAR_VELOCITY, MAX_ANGULAR_VELOCITY))


PLANNERS = {"oracle": Oracle, "prm": PRM, "dstar": DStar, "bug": Bug, "braitenberg": Braitenberg,
            "straight": Straight, "random": Random}
