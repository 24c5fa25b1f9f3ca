"""The methods that the paper sets itself against, on the same tasks: with a map, or by reflex.
Every planner is told its pose exactly, which the learner never is; each docstring says what else it
knows. A pose is (x [m], y [m], theta [rad]), a point (x, y) [m], a command (v [m/s], w [rad/s])."""

import heapq
import itertools
import math
from collections import defaultdict

import networkx
import numpy as np
import pymunk

from sim import (ARRIVAL_DISTANCE, CONTROL_PERIOD, MAX_ANGULAR_VELOCITY, MAX_LINEAR_VELOCITY,
                 ROBOT_RADIUS, wrap_angle)

# All numbers below are our choice.
ANGLES = np.radians(np.arange(-180, 180, 5))  # [rad] of the range readings, from the heading
RANGE = 3.0  # [m] that they reach
STRIDE = MAX_LINEAR_VELOCITY * CONTROL_PERIOD  # [m] the longest step
GAP = 0.001  # [m] that a shortest path keeps from the walls
MARGIN = 0.02  # [m] that planners who sense their walls keep from them
INSIDE = 1 - 1e-6  # of the arrival distance: a path ends within the goal's circle, not on it
AROUND = [(math.cos(turn), math.sin(turn)) for turn in 2 * np.pi * np.arange(12) / 12]


def polar(pose, point):
    """Returns the distance [m] and the bearing [rad] of a point from a pose."""
    dx, dy = np.subtract(point, pose[:2])
    return math.hypot(dx, dy), wrap_angle(math.atan2(dy, dx) - pose[2])


def turn_and_go(pose, point):
    """Returns the command that turns to a point on the spot, or drives straight to it at most."""
    distance, bearing = polar(pose, point)
    if abs(bearing) > 1e-6 and distance > 1e-6:
        return 0.0, np.clip(bearing / CONTROL_PERIOD, -MAX_ANGULAR_VELOCITY, MAX_ANGULAR_VELOCITY)
    return min(distance / CONTROL_PERIOD, MAX_LINEAR_VELOCITY), 0.0


class Roadmap:
    """Points (n, 2) [m], those where the robot's disc fits, joined if it fits along the line."""

    def __init__(self, scene, points):
        self.space = pymunk.Space()  # of walls grown by the disc's radius: points drive among them
        for box in scene.boxes:
            self.space.add(pymunk.Poly(self.space.static_body, box.corners.tolist(),
                                       radius=ROBOT_RADIUS))
        fits = scene.clearance(points) > ROBOT_RADIUS
        self.graph = networkx.Graph()  # its nodes are points (x, y), its weights metres
        self.graph.add_nodes_from(map(tuple, points[fits].tolist()))
        for a, b in itertools.combinations(self.graph, 2):
            if self.free(a, b):
                self.graph.add_edge(a, b, weight=math.dist(a, b))

    def free(self, a, b):
        """Returns whether the disc fits along the line to b from a, a point where it fits."""
        return self.space.segment_query_first(a, b, 0, pymunk.ShapeFilter()) is None

    def path(self, start, goal, within=ARRIVAL_DISTANCE):
        """Returns the points (x, y) after the start of the shortest path to within that distance
        [m] of the goal, and its length [m]; None and inf if there is none."""
        start = tuple(start)
        graph = self.graph.copy()
        graph.add_node(start)
        for point in self.graph:
            if self.free(start, point):
                graph.add_edge(start, point, weight=math.dist(start, point))
        ends = {point: self._last_leg(point, goal, within) for point in graph}
        for point, end in ends.items():
            if end is not None:
                graph.add_edge(point, "goal", weight=math.dist(point, end))
        try:
            length, nodes = networkx.single_source_dijkstra(graph, start, "goal")
        except networkx.NetworkXNoPath:
            return None, math.inf
        return [*nodes[1:-1], ends[nodes[-2]]], length

    def _last_leg(self, point, goal, within):
        """Returns the nearest end of a free leg from a point into the goal's circle, or None."""
        distance = math.dist(point, goal)
        if distance <= within:
            return point
        straight = np.subtract(point, goal) / distance
        circle = goal + within * INSIDE * np.vstack([straight, AROUND])
        ends = sorted(circle.tolist(), key=lambda end: math.dist(point, end))
        return next((tuple(end) for end in ends if self.free(point, end)), None)


def visibility_graph(scene):
    """Returns the Roadmap of shortest paths, which bend only at corners (Lozano-Perez and Wesley
    1979). A disc's way around one is an arc; four points about it make it at most 1.3 % longer."""
    distance = (ROBOT_RADIUS + GAP) / np.cos(np.pi / 16)  # of the points from the corner
    quarter = (np.arange(4) + 0.5) * np.pi / 8
    points = []
    for box in scene.boxes:
        for k, corner in enumerate(box.corners):
            along = box.yaw + k * np.pi / 2 + quarter  # between the normals of the corner's faces
            points.append(corner + distance * np.stack([np.cos(along), np.sin(along)], -1))
    return Roadmap(scene, np.concatenate(points))


class Planner:
    """Drives one robot in one scene. `prepare` returns what all planners of a scene know of it."""

    senses = False  # whether `act` uses range readings

    @staticmethod
    def prepare(scene, rng):
        """Returns what is computed once for each scene, None for nothing. rng: numpy Generator."""

    def __init__(self, scene, rng, knowledge):
        """knowledge: what `prepare` returned for this scene. rng: numpy Generator."""
        self.scene = scene
        self.rng = rng
        self.knowledge = knowledge

    def begin(self, pose, goal):
        """Begins an episode at that pose; the goal is (x, y) [m]."""
        self.goal = (float(goal[0]), float(goal[1]))

    def act(self, pose, readings):
        """Returns the command of one step. readings: (len(ANGLES),) [m], if it `senses`."""


class Oracle(Planner):
    """The shortest path; stands still if there is none. Knows the whole map."""

    @staticmethod
    def prepare(scene, rng):
        return visibility_graph(scene)

    def begin(self, pose, goal):
        super().begin(pose, goal)
        self.way = self.knowledge.path(pose[:2], self.goal)[0] or []

    def act(self, pose, readings):
        while self.way and math.dist(pose[:2], self.way[0]) < 1e-6:
            self.way.pop(0)
        return turn_and_go(pose, self.way[0]) if self.way else (0.0, 0.0)


class PRM(Oracle):
    """A probabilistic roadmap with Gaussian sampling (Boor et al. 1999): of two near random points
    the free one is kept if the other is not, so they lie close to walls. Knows the whole map."""

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
    """D* Lite (Koenig and Likhachev 2002), on a grid that starts empty: walls are entered as range
    readings meet them, and only the part of the search that they change is done again. Each cell s
    has g(s), its cost to the goal [cells] as last settled, and rhs(s), the same by its neighbours'
    g now. If they differ, s waits in the queue. Unlike the paper's, keys lead to where the robot
    began, so they stay valid as it drives. Knows no map; has range sensors all around."""

    senses = True
    CELL = 0.06  # [m]
    DETOUR = 8.0  # [m] a way longer than the straight line by more than that is not looked for
    STEPS = [(1, 0), (1, 1), (0, 1), (-1, 1), (-1, 0), (-1, -1), (0, -1), (1, -1)]

    def begin(self, pose, goal):
        super().begin(pose, goal)
        self.blocked = set()  # cells that the robot's centre cannot enter
        self.g = defaultdict(lambda: math.inf)
        self.rhs = defaultdict(lambda: math.inf)
        self.target = self._cell(goal)
        self.begun = self._cell(pose[:2])  # where the robot began
        self.start = self.begun  # where it is
        # If no way leads to the goal, the search would go on for ever in a plane without an end.
        self.longest = math.dist(self.begun, self.target) + self.DETOUR / self.CELL  # [cells]
        self.rhs[self.target] = 0.0
        self.queue = [(self._key(self.target), self.target)]  # heap; old entries stay in it

    def act(self, pose, readings):
        """Drives to the best cell beside it; straight at the goal in its cell or without a way."""
        self.start = self._cell(pose[:2])
        new = self._new_walls(pose, readings)
        changed = {n for s in new for n, _ in self._neighbours(s)} | new
        self.blocked |= new
        for s in changed:
            self._update(s)
        # Settle waiting cells until the robot's cell is right and none before it waits.
        while self.queue and self.queue[0][0][0] <= self.longest:
            settled = self.g[self.start] == self.rhs[self.start]
            if settled and self.queue[0][0] >= self._key(self.start):
                break
            key, s = heapq.heappop(self.queue)
            if self.g[s] == self.rhs[s] or key != self._key(s):
                continue  # an old entry
            # A shorter way is settled. If the way that it had is gone, it waits for a longer one.
            self.g[s] = self.rhs[s] if self.g[s] > self.rhs[s] else math.inf
            for n, _ in [*self._neighbours(s), (s, 0)]:
                self._update(n)
        if self.start == self.target or self.rhs[self.start] == math.inf:
            return turn_and_go(pose, self.goal)
        _, (i, j) = min((self.g[n] + step, n) for n, step in self._neighbours(self.start))
        return turn_and_go(pose, (i * self.CELL, j * self.CELL))

    def _cell(self, point):
        """Returns the cell (i, j) whose centre, (i, j) * CELL, is nearest to a point [m]."""
        return round(point[0] / self.CELL), round(point[1] / self.CELL)

    def _neighbours(self, s):
        """Returns the free cells around a free cell, each with the cost [cells] of the step."""
        if s in self.blocked:
            return []
        around = [((s[0] + dx, s[1] + dy), math.hypot(dx, dy)) for dx, dy in self.STEPS]
        return [(n, step) for n, step in around if n not in self.blocked]

    def _key(self, s):
        """Returns a cell's place in the queue: a lower bound of a path over it, its own cost."""
        cost = min(self.g[s], self.rhs[s])
        # Rounded, because the keys along a straight way are equal except for float errors.
        return round(cost + math.dist(self.begun, s), 6), round(cost, 6)

    def _update(self, s):
        """Looks up rhs(s) again, and queues s if it differs from g(s)."""
        if s != self.target:
            self.rhs[s] = min((self.g[n] + step for n, step in self._neighbours(s)),
                              default=math.inf)
        if self.g[s] != self.rhs[s]:
            heapq.heappush(self.queue, (self._key(s), s))

    def _new_walls(self, pose, readings):
        """Returns the cells that the readings block, except the robot's own and the goal's."""
        way = pose[2] + ANGLES
        ends = pose[:2] + readings[:, None] * np.stack([np.cos(way), np.sin(way)], -1)
        ends = ends[readings < RANGE - 1e-6, None]  # (k, 1, 2)
        reach = math.ceil((ROBOT_RADIUS + MARGIN) / self.CELL) + 1  # [cells]
        square = np.array(list(itertools.product(range(-reach, reach + 1), repeat=2)))
        cells = np.round(ends / self.CELL) + square  # (k, cells of the square, 2)
        near = np.linalg.norm(cells * self.CELL - ends, axis=-1) < ROBOT_RADIUS + MARGIN
        new = set(map(tuple, cells[near].astype(int).tolist()))
        return new - self.blocked - {self.start, self.target}


def room_ahead(readings, direction):
    """Returns how far [m], RANGE at most, the disc can drive that way [rad from the heading]."""
    x = readings * np.cos(ANGLES - direction)  # of the points met, along the direction
    y = readings * np.sin(ANGLES - direction)  # and beside it
    radius = ROBOT_RADIUS + MARGIN
    meets = (np.abs(y) < radius) & (x > 0) & (readings < RANGE - 1e-6)
    return (x[meets] - np.sqrt(radius ** 2 - y[meets] ** 2)).min(initial=RANGE)


class Bug(Planner):
    """Bug2 (Lumelsky and Stepanov 1987): straight at the target; around what is in the way, wall on
    the right, until back on the line and nearer. Knows no map; has range sensors all around."""

    senses = True

    def begin(self, pose, goal):
        super().begin(pose, goal)
        self.line = pose[2] + polar(pose, goal)[1]  # [rad] the line from start to target
        self.hit = None  # [m] how far the goal was where it met the wall; None: it follows none
        self.wall = None  # [rad from the heading] about where that wall is
        self.step = None  # the point that it is driving to; None: to be chosen

    def act(self, pose, readings):
        if self.step is None:
            way, stride = self._next_step(pose, readings)
            self.step = (pose[0] + stride * math.cos(pose[2] + way),
                         pose[1] + stride * math.sin(pose[2] + way))
        distance, bearing = polar(pose, self.step)
        if abs(bearing) > MAX_ANGULAR_VELOCITY * CONTROL_PERIOD / 2:
            return turn_and_go(pose, self.step)
        # An arc that ends at a point turns by twice the point's bearing, and is longer than the
        # straight line by bearing / sin(bearing) (numpy's sinc(x) is sin(pi x) / (pi x)).
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
        gap = readings[nearest] - ROBOT_RADIUS - 0.06  # [m] too far from the wall
        along = ANGLES[nearest] + np.pi / 2 - np.clip(4 * gap, -0.8, 0.8)
        self.wall = -np.pi / 2  # after this step the robot heads along the wall
        ways = along + np.radians(np.arange(0, 360, 10))  # the first one that is free
        return next((way for way in ways if room_ahead(readings, way) > stride), along), stride


class Braitenberg(Planner):
    """Turns to the target and away from walls (Braitenberg 1984). Has range sensors, no map."""

    senses = True

    def act(self, pose, readings):
        nearness = np.clip(1 - (readings - ROBOT_RADIUS) / 0.4, 0, 1)  # 1 at the wall, 0 from 0.4 m
        near = nearness * np.maximum(np.cos(ANGLES), 0)  # what is ahead counts most, behind not
        leftwards = near[ANGLES < 0].sum() - near[ANGLES > 0].sum()  # away from the nearer side
        turn = np.clip(1.5 * polar(pose, self.goal)[1] + 0.8 * leftwards, -1, 1)
        return MAX_LINEAR_VELOCITY * max(0.05, 1 - near.max()), turn * MAX_ANGULAR_VELOCITY


class Straight(Planner):
    """Turns to the target and goes. Knows no map and senses nothing else."""

    def act(self, pose, readings):
        return turn_and_go(pose, self.goal)


class Random(Planner):
    """Any velocities. Knows nothing."""

    def act(self, pose, readings):
        return self.rng.uniform((0, -MAX_ANGULAR_VELOCITY),
                                (MAX_LINEAR_VELOCITY, MAX_ANGULAR_VELOCITY))


PLANNERS = {"oracle": Oracle, "prm": PRM, "dstar": DStar, "bug": Bug, "braitenberg": Braitenberg,
            "straight": Straight, "random": Random}
