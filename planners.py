"""The methods that the paper sets itself against, on the same tasks: with a map, or by reflex.

Every planner is told its pose exactly, which the learner never is; each docstring says what else it
knows. A planner is made for a scene, `begin`s an episode with a pose and a goal, and then `act`s:
pose (x, y, theta) [m, rad] and readings (len(ANGLES),) [m] in, velocities [m/s, rad/s] out.
"""

import heapq
import math
from collections import defaultdict
from functools import lru_cache

import networkx
import numpy as np
import pymunk

from sim import (ARRIVAL_DISTANCE, CONTROL_PERIOD, MAX_ANGULAR_VELOCITY, MAX_LINEAR_VELOCITY,
                 ROBOT_RADIUS, wrap_angle)

ANGLES = np.radians(np.arange(-180, 180, 5))  # of the range readings, from the heading
RANGE = 3.0  # [m] that they reach
STRIDE = MAX_LINEAR_VELOCITY * CONTROL_PERIOD  # [m] the longest step
GAP = 0.001  # [m] that a shortest path keeps from the walls
AROUND = np.exp(2j * np.pi * np.arange(12) / 12)  # directions all around


def polar(pose, point):
    """Distance [m] and bearing [rad] of a point from a pose."""
    dx, dy = point[0] - pose[0], point[1] - pose[1]
    return math.hypot(dx, dy), wrap_angle(math.atan2(dy, dx) - pose[2])


def turn_and_go(pose, point):
    """Velocities that turn to the point on the spot, and then drive straight to it, exactly."""
    distance, bearing = polar(pose, point)
    if abs(bearing) > 1e-6 and distance > 1e-6:
        return 0.0, np.clip(bearing / CONTROL_PERIOD, -MAX_ANGULAR_VELOCITY, MAX_ANGULAR_VELOCITY)
    return min(distance / CONTROL_PERIOD, MAX_LINEAR_VELOCITY), 0.0


class Roadmap:
    """Points that a robot's centre may pass, joined where its disc fits along the line between."""

    def __init__(self, scene, points):
        """points: (n, 2) [m]; those that are not free are left out."""
        self.scene, self.space = scene, pymunk.Space()
        for box in scene.boxes:  # the disc fits where its centre is clear of walls grown by it
            self.space.add(pymunk.Poly(self.space.static_body, box.corners.tolist(),
                                       radius=ROBOT_RADIUS))
        points = points[scene.clearance(points) > ROBOT_RADIUS]
        self.points, self.graph = [tuple(map(float, point)) for point in points], networkx.Graph()
        for i, a in enumerate(self.points):
            self.graph.add_weighted_edges_from(
                (i, j, math.dist(a, b)) for j, b in enumerate(self.points[:i]) if self.free(a, b))

    def free(self, a, b):
        """Whether the disc fits along the line between two points where it fits."""
        return self.space.segment_query_first(a, b, 0, pymunk.ShapeFilter()) is None

    def arrivals(self, goal, within):
        """The points all around the goal where its circle can be entered, (k, 2)."""
        circle = complex(*goal) + within * (1 - 1e-6) * AROUND
        circle = np.stack([circle.real, circle.imag], -1)
        return circle[self.scene.clearance(circle) > ROBOT_RADIUS]

    def last_leg(self, point, goal, circle, within):
        """The nearest of the goal's circle that the disc can drive to straight, None if none."""
        distance = math.dist(point, goal)
        if distance <= within:
            return point
        straight = np.subtract(point, goal) * within * (1 - 1e-6) / distance + goal
        fits = self.scene.clearance(straight) > ROBOT_RADIUS
        ends = sorted(circle.tolist(), key=lambda end: math.dist(point, end))
        for end in [straight.tolist()] * int(fits) + ends:
            if self.free(point, end):
                return tuple(end)
        return None

    def path(self, start, goal, within=ARRIVAL_DISTANCE):
        """The shortest path by these points from start to the circle `within` [m] of the goal: a
        list of points after the start, None where there is none; and its length [m], or inf."""
        graph, circle = self.graph.copy(), self.arrivals(goal, within)
        for k, point in [*enumerate(self.points), ("start", tuple(start))]:
            if k != "start" and self.free(start, point):
                graph.add_edge("start", k, weight=math.dist(start, point))
            end = self.last_leg(point, goal, circle, within)
            if end is not None:
                graph.add_edge(k, (k, end), weight=math.dist(point, end))
                graph.add_edge((k, end), "goal", weight=0)
        try:
            length, nodes = networkx.single_source_dijkstra(graph, "start", "goal")
        except (networkx.NetworkXNoPath, networkx.NodeNotFound):
            return None, math.inf
        points = [self.points[k] for k in nodes[1:-2] if isinstance(k, int)]
        return [*points, nodes[-2][1]], length


@lru_cache(maxsize=8)
def visibility_graph(scene):
    """The roadmap of shortest paths: around each corner of a box, four points of the polygon about
    the arc that the robot's centre turns on (within 1.3 % of the arc)."""
    angles = (np.arange(4) + 0.5) * np.pi / 8
    points = []
    for box in scene.boxes:
        for k, corner in enumerate(box.corners):
            along = box.yaw + k * np.pi / 2 + angles  # between the normals of the corner's faces
            out = (ROBOT_RADIUS + GAP) / np.cos(np.pi / 16)
            points.append(corner + out * np.stack([np.cos(along), np.sin(along)], -1))
    return Roadmap(scene, np.concatenate(points))


class Planner:
    """Follows `self.way`, a list of points; stands still where there is none left."""

    senses = False  # whether it uses range readings

    def __init__(self, scene, rng):
        """rng: numpy Generator."""
        self.scene, self.rng, self.way, self.goal = scene, rng, [], None

    def begin(self, pose, goal):
        self.goal = tuple(map(float, goal))

    def act(self, pose, readings):
        while self.way and math.dist(pose[:2], self.way[0]) < 1e-6:
            self.way.pop(0)
        return turn_and_go(pose, self.way[0]) if self.way else (0.0, 0.0)


class Oracle(Planner):
    """The shortest path. Knows the whole map."""

    def __init__(self, scene, rng):
        super().__init__(scene, rng)
        self.roadmap = self.make(scene)

    def make(self, scene):
        return visibility_graph(scene)

    def begin(self, pose, goal):
        super().begin(pose, goal)
        self.way = self.roadmap.path(tuple(pose[:2]), self.goal)[0] or []


class PRM(Oracle):
    """A probabilistic roadmap with Gaussian sampling (Boor et al. 1999): of two random points near
    each other the free one is kept where the other is not, so they lie close to the walls. Knows
    the whole map."""

    def make(self, scene):
        points, (low, high) = [], scene.bounds
        while len(points) < 100:
            one = self.rng.uniform(low, high)
            other = one + self.rng.normal(0, 0.2, 2)
            free = scene.clearance(np.stack([one, other])) > ROBOT_RADIUS
            if free.sum() == 1:
                points.append(one if free[0] else other)
        return Roadmap(scene, np.array(points))


class DStar(Planner):
    """D* Lite (Koenig and Likhachev 2002) on a grid that starts empty: walls are entered as range
    readings meet them, and only the part of the search that they change is done again. Knows no
    map; has range sensors all around."""

    senses = True
    CELL = 0.06  # [m]

    def begin(self, pose, goal):
        super().begin(pose, goal)
        self.blocked, self.g, self.rhs = set(), *(defaultdict(lambda: math.inf) for _ in range(2))
        self.queue, self.km, self.target = [], 0.0, self.cell(goal)
        self.start = self.last = self.cell(pose[:2])
        self.rhs[self.target] = 0.0
        heapq.heappush(self.queue, (self.key(self.target), self.target))

    def cell(self, point):
        return round(point[0] / self.CELL), round(point[1] / self.CELL)

    def key(self, s):
        least = min(self.g[s], self.rhs[s])
        return least + math.dist(self.start, s) + self.km, least

    def neighbours(self, s):
        """The eight cells around, each with the cost of the step: inf into or out of a wall."""
        for dx, dy in ((1, 0), (1, 1), (0, 1), (-1, 1), (-1, 0), (-1, -1), (0, -1), (1, -1)):
            n = s[0] + dx, s[1] + dy
            free = n not in self.blocked and s not in self.blocked
            yield n, math.hypot(dx, dy) if free else math.inf

    def update(self, s):
        if s != self.target:
            self.rhs[s] = min(self.g[n] + cost for n, cost in self.neighbours(s))
        if self.g[s] != self.rhs[s]:
            heapq.heappush(self.queue, (self.key(s), s))

    def search(self):
        while self.queue and (self.queue[0][0] < self.key(self.start)
                              or self.rhs[self.start] != self.g[self.start]):
            old, s = heapq.heappop(self.queue)
            if self.g[s] == self.rhs[s]:
                continue  # an entry that a later one has settled
            if old < self.key(s):
                heapq.heappush(self.queue, (self.key(s), s))
                continue
            lower = self.g[s] > self.rhs[s]
            self.g[s] = self.rhs[s] if lower else math.inf
            for n in [n for n, _ in self.neighbours(s)] + [s] * (not lower):
                self.update(n)

    def see(self, pose, readings):
        """Enters walls, grown by the robot's radius; returns the cells that are blocked now."""
        way, hit, new = pose[2] + ANGLES, readings < RANGE - 1e-6, set()
        ends = pose[:2] + readings[:, None] * np.stack([np.cos(way), np.sin(way)], -1)
        reach = int((ROBOT_RADIUS + self.CELL) / self.CELL) + 1
        for end in ends[hit]:
            i, j = self.cell(end)
            for a in range(i - reach, i + reach + 1):
                for b in range(j - reach, j + reach + 1):
                    near = math.dist((a * self.CELL, b * self.CELL), end) < ROBOT_RADIUS + 0.02
                    if near and (a, b) not in self.blocked:
                        new.add((a, b))
        return new - {self.start}

    def act(self, pose, readings):
        self.start = self.cell(pose[:2])
        new = self.see(pose, readings)
        if new:
            self.km, self.last = self.km + math.dist(self.last, self.start), self.start
            self.blocked |= new
            for s in new | {n for s in new for n, _ in self.neighbours(s)}:
                self.update(s)
        self.search()
        steps = [(self.g[n] + cost, n) for n, cost in self.neighbours(self.start)]
        best, following = min(steps)
        if self.start == self.target or best == math.inf:
            return turn_and_go(pose, self.goal)
        return turn_and_go(pose, (following[0] * self.CELL, following[1] * self.CELL))


def room_ahead(readings, direction):
    """How far [m] the disc can drive in that direction [rad from the heading], by the readings."""
    x, y = readings * np.cos(ANGLES - direction), readings * np.sin(ANGLES - direction)
    radius = ROBOT_RADIUS + 0.02
    meets = (np.abs(y) < radius) & (x > 0) & (readings < RANGE - 1e-6)
    return (x[meets] - np.sqrt(radius ** 2 - y[meets] ** 2)).min(initial=RANGE)


class Bug(Planner):
    """Bug2, the paper's simple automaton: straight at the target; around what is in the way, wall
    on the right, until back on the line from start to target and nearer. Knows no map; has range
    sensors all around."""

    senses = True

    def begin(self, pose, goal):
        super().begin(pose, goal)
        self.start, self.hit, self.step = pose[:2].copy(), None, None

    def act(self, pose, readings):
        if self.step is None:
            self.step = self.next_step(pose, readings)
        distance, bearing = polar(pose, self.step)
        if abs(bearing) > MAX_ANGULAR_VELOCITY * CONTROL_PERIOD / 2:
            return turn_and_go(pose, self.step)
        self.step = None  # the arc to a point turns by twice its bearing, and ends there
        arc = distance / np.sinc(bearing / np.pi)
        return min(arc / CONTROL_PERIOD, MAX_LINEAR_VELOCITY), 2 * bearing / CONTROL_PERIOD

    def next_step(self, pose, readings):
        """The point to turn and drive to, at most a stride away."""
        distance, bearing = polar(pose, self.goal)
        ahead = room_ahead(readings, bearing)
        (dx, dy), line = np.subtract(self.goal, pose[:2]), np.subtract(self.goal, self.start)
        off_line = abs(line[0] * dy - line[1] * dx) / max(math.hypot(*line), 1e-9)
        if self.hit and off_line < STRIDE and ahead > STRIDE and distance < self.hit - STRIDE:
            self.hit = None
        way, stride = bearing, min(STRIDE, distance)
        if not self.hit and ahead < stride:
            self.hit, self.wall = distance, bearing
        if self.hit:  # along the nearest wall, on the right; where that is not free, turn left
            towards = np.abs(wrap_angle(ANGLES - self.wall)) < np.radians(100)
            nearest = np.where(towards, readings, np.inf).argmin()
            gap = readings[nearest] - ROBOT_RADIUS - 0.06
            along = ANGLES[nearest] + np.pi / 2 - np.clip(4 * gap, -0.8, 0.8)
            ways = along + np.radians(np.arange(0, 360, 10))
            way = next((a for a in ways if room_ahead(readings, a) > stride), along)
            self.wall = -np.pi / 2  # seen from the heading after the step
        return (pose[0] + stride * math.cos(pose[2] + way),
                pose[1] + stride * math.sin(pose[2] + way))


class Braitenberg(Planner):
    """Two motors excited by the target and inhibited by what is near on the other side
    (Braitenberg 1984). Knows no map; has range sensors."""

    senses = True

    def act(self, pose, readings):
        bearing = polar(pose, self.goal)[1]
        near = np.clip(1 - (readings - ROBOT_RADIUS) / 0.4, 0, 1) * np.maximum(np.cos(ANGLES), 0)
        left, right = near[ANGLES > 0].sum(), near[ANGLES < 0].sum()
        turn = np.clip(1.5 * bearing + 0.8 * (right - left), -1, 1)
        return MAX_LINEAR_VELOCITY * max(0.05, 1 - near.max()), turn * MAX_ANGULAR_VELOCITY


class Straight(Planner):
    """Turns to the target and goes. Knows no map and senses nothing else."""

    def act(self, pose, readings):
        return turn_and_go(pose, self.goal)


class Random(Planner):
    """Any velocities. Knows nothing."""

    def act(self, pose, readings):
        return (self.rng.uniform(0, MAX_LINEAR_VELOCITY),
                self.rng.uniform(-MAX_ANGULAR_VELOCITY, MAX_ANGULAR_VELOCITY))


PLANNERS = {"oracle": Oracle, "prm": PRM, "dstar": DStar, "bug": Bug, "braitenberg": Braitenberg,
            "straight": Straight, "random": Random}
