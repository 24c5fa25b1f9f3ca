"""The methods that the paper sets itself against, on the same tasks: with a map, or by reflex.

Every planner is told its pose exactly, which the learner never is; each docstring says what else it
knows. What a planner knows of a scene is prepared once, for all robots that drive there:

    knowledge = Oracle.prepare(scene, rng)
    planner = Oracle(scene, rng, knowledge)   one for each robot
    planner.begin(pose, goal)                 an episode begins
    v, w = planner.act(pose, readings)        a command for each step of it

A pose is (x [m], y [m], theta [rad]), a goal is (x, y) [m], readings are (len(ANGLES),) [m], a
command is (v [m/s], w [rad/s]). A planner whose `senses` is False ignores the readings. Nothing is
cached here: a roadmap lives as long as its owner keeps it.
"""

import heapq
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
AROUND = np.exp(2j * np.pi * np.arange(12) / 12)  # unit vectors all around, as complex numbers


def polar(pose, point):
    """Distance [m] and bearing [rad] of a point from a pose."""
    dx = point[0] - pose[0]
    dy = point[1] - pose[1]
    return math.hypot(dx, dy), wrap_angle(math.atan2(dy, dx) - pose[2])


def turn_and_go(pose, point):
    """The command that turns to the point on the spot, or drives straight to it and no farther."""
    distance, bearing = polar(pose, point)
    if abs(bearing) > 1e-6 and distance > 1e-6:
        turn = np.clip(bearing / CONTROL_PERIOD, -MAX_ANGULAR_VELOCITY, MAX_ANGULAR_VELOCITY)
        return 0.0, turn
    return min(distance / CONTROL_PERIOD, MAX_LINEAR_VELOCITY), 0.0


# ----------------------------------------------------------------------------------------- roadmaps


class Roadmap:
    """Points that a robot's centre may pass, joined where its disc fits along the line between."""

    def __init__(self, scene, points):
        """points: (n, 2) [m]; those where the disc does not fit are left out."""
        self.scene = scene
        # A disc fits along a line where a point does among walls grown by the disc's radius. So
        # pymunk answers with one query of a segment in a space of rounded walls.
        self.space = pymunk.Space()
        for box in scene.boxes:
            wall = pymunk.Poly(self.space.static_body, box.corners.tolist(), radius=ROBOT_RADIUS)
            self.space.add(wall)
        fits = scene.clearance(points) > ROBOT_RADIUS
        self.points = [(float(x), float(y)) for x, y in points[fits]]
        self.graph = networkx.Graph()  # its nodes are indices of points
        for i, a in enumerate(self.points):
            for j, b in enumerate(self.points[:i]):
                if self.free(a, b):
                    self.graph.add_edge(i, j, weight=math.dist(a, b))

    def free(self, a, b):
        """Whether the disc fits along the line between two points where it fits."""
        return self.space.segment_query_first(a, b, 0, pymunk.ShapeFilter()) is None

    def path(self, start, goal, within=ARRIVAL_DISTANCE):
        """The shortest path by these points from start to the circle `within` [m] of the goal.

        Returns a list of points (x, y) after the start, None where there is no path; and the
        length [m], inf where there is none.
        """
        start = tuple(start)
        entries = self._entries(goal, within)
        # Each point that sees the goal's circle gets a node of its own where it would enter it,
        # ("entry", point), and all entries lead to "goal" at no cost.
        graph = self.graph.copy()
        entry_of = {}  # node -> the point (x, y) where its last leg ends
        for node, point in [*enumerate(self.points), ("start", start)]:
            if node != "start" and self.free(start, point):
                graph.add_edge("start", node, weight=math.dist(start, point))
            entry = self._last_leg(point, goal, entries, within)
            if entry is not None:
                entry_of[node] = entry
                graph.add_edge(node, ("entry", node), weight=math.dist(point, entry))
                graph.add_edge(("entry", node), "goal", weight=0)
        try:
            length, nodes = networkx.single_source_dijkstra(graph, "start", "goal")
        except (networkx.NetworkXNoPath, networkx.NodeNotFound):
            return None, math.inf
        # nodes: "start", points by their index, ("entry", the node before it), "goal"
        points = [self.points[k] for k in nodes[1:-2]]
        _, last = nodes[-2]
        return [*points, entry_of[last]], length

    def _entries(self, goal, within):
        """The points all around the goal's circle where the disc fits, (k, 2)."""
        circle = complex(*goal) + within * INSIDE * AROUND
        circle = np.stack([circle.real, circle.imag], -1)
        return circle[self.scene.clearance(circle) > ROBOT_RADIUS]

    def _last_leg(self, point, goal, entries, within):
        """Where a straight leg from the point enters the goal's circle, None where none can: at
        the point nearest to it if that is free, else at the nearest of the entries."""
        distance = math.dist(point, goal)
        if distance <= within:
            return point
        straight = np.subtract(point, goal) * within * INSIDE / distance + goal
        ends = sorted(entries.tolist(), key=lambda end: math.dist(point, end))
        if self.scene.clearance(straight) > ROBOT_RADIUS:
            ends.insert(0, straight.tolist())
        for end in ends:
            if self.free(point, end):
                return tuple(end)
        return None


def visibility_graph(scene):
    """The Roadmap of shortest paths.

    A shortest path among polygons bends at their corners alone (Lozano-Perez and Wesley 1979). For
    a disc the walls grow by its radius and a corner becomes a quarter of a circle. Four points lie
    around each, of the polygon about that arc, which is at most 1.3 % longer than the arc.
    """
    distance = (ROBOT_RADIUS + GAP) / np.cos(np.pi / 16)  # of the points from the corner
    quarter = (np.arange(4) + 0.5) * np.pi / 8
    points = []
    for box in scene.boxes:
        for k, corner in enumerate(box.corners):
            along = box.yaw + k * np.pi / 2 + quarter  # between the normals of the corner's faces
            points.append(corner + distance * np.stack([np.cos(along), np.sin(along)], -1))
    return Roadmap(scene, np.concatenate(points))


# ------------------------------------------------------------------------------ planners with a map


class Planner:
    """Follows `self.way`, a list of points; stands still where there is none left."""

    senses = False  # whether `act` uses range readings

    @staticmethod
    def prepare(scene, rng):
        """What planners of this kind know of a scene before they drive, None for nothing; to be
        computed once a scene. rng: numpy Generator."""
        return None

    def __init__(self, scene, rng, knowledge):
        """knowledge: what `prepare` returned for this scene. rng: numpy Generator."""
        self.scene = scene
        self.rng = rng
        self.knowledge = knowledge
        self.way = []
        self.goal = None

    def begin(self, pose, goal):
        """An episode begins at that pose; the goal is (x, y) [m]."""
        self.goal = (float(goal[0]), float(goal[1]))

    def act(self, pose, readings):
        """The command (v [m/s], w [rad/s]) of one step."""
        while self.way and math.dist(pose[:2], self.way[0]) < 1e-6:
            self.way.pop(0)
        if not self.way:
            return 0.0, 0.0
        return turn_and_go(pose, self.way[0])


class Oracle(Planner):
    """The shortest path. Knows the whole map."""

    @staticmethod
    def prepare(scene, rng):
        return visibility_graph(scene)

    def begin(self, pose, goal):
        super().begin(pose, goal)
        way, _ = self.knowledge.path(tuple(pose[:2]), self.goal)
        self.way = way or []


class PRM(Oracle):
    """A probabilistic roadmap with Gaussian sampling (Boor et al. 1999): of two random points near
    each other the free one is kept where the other is not, so they lie close to the walls. Knows
    the whole map. One roadmap is drawn for a scene, and all its robots share it."""

    SAMPLES = 100  # points of the roadmap
    SPREAD = 0.2  # [m] standard deviation from one random point to the other, each axis

    @staticmethod
    def prepare(scene, rng):
        low, high = scene.bounds
        points = []
        while len(points) < PRM.SAMPLES:
            one = rng.uniform(low, high)
            other = one + rng.normal(0, PRM.SPREAD, 2)
            one_fits, other_fits = scene.clearance(np.stack([one, other])) > ROBOT_RADIUS
            if one_fits and not other_fits:
                points.append(one)
            if other_fits and not one_fits:
                points.append(other)
        return Roadmap(scene, np.array(points))


# --------------------------------------------------------------- planners that sense, without a map


class DStar(Planner):
    """D* Lite (Koenig and Likhachev 2002) on a grid that starts empty: walls are entered as range
    readings meet them, and only the part of the search that they change is done again. Knows no
    map; has range sensors all around.

    The search runs backwards, from the goal to the robot. Every cell s has two values, in the
    paper's letters: g(s), its cost to the goal as last settled, and rhs(s), the same looked up from
    its neighbours' g now. Where the two differ, s is inconsistent: something around it has changed,
    and it waits in the queue. The search settles waiting cells, those nearest first, until the
    robot's own cell is consistent. New walls only put the cells around them back into the queue.
    Where it finds no way it drives straight at the goal.
    """

    senses = True
    CELL = 0.06  # [m]
    DETOUR = 5.0  # [m] a way longer than the straight line by more than that is not looked for

    def begin(self, pose, goal):
        super().begin(pose, goal)
        self.blocked = set()  # cells that the robot's centre cannot enter
        self.g = defaultdict(lambda: math.inf)
        self.rhs = defaultdict(lambda: math.inf)
        self.queue = []  # heap of (key, cell); a cell may be in it twice, with an outdated key
        self.km = 0.0  # [cells] that the robot has moved, see `_key`
        self.target = self._cell(goal)
        self.start = self._cell(pose[:2])  # where the robot is
        self.last = self.start  # where it was when `km` last grew
        # Where no way leads to the goal, a search in a plane without an end would have none either.
        self.begun = self.start  # where the robot began
        self.longest = math.dist(self.start, self.target) + self.DETOUR / self.CELL  # way [cells]
        self.rhs[self.target] = 0.0
        heapq.heappush(self.queue, (self._key(self.target), self.target))

    def act(self, pose, readings):
        self.start = self._cell(pose[:2])
        new = self._new_walls(pose, readings)
        if new:
            self.km += math.dist(self.last, self.start)
            self.last = self.start
            self.blocked |= new
            around = {n for s in new for n, _ in self._neighbours(s)}
            for s in new | around:
                self._update(s)
        self._search()
        # Downhill: to the neighbour from which the goal is nearest, the step there included.
        cost, following = min((self.g[n] + step, n) for n, step in self._neighbours(self.start))
        if self.start == self.target or cost == math.inf:
            return turn_and_go(pose, self.goal)
        return turn_and_go(pose, (following[0] * self.CELL, following[1] * self.CELL))

    def _cell(self, point):
        """The cell (i, j) whose centre, (i, j) * CELL, is nearest to a point [m]."""
        return round(point[0] / self.CELL), round(point[1] / self.CELL)

    def _key(self, s):
        """The place of a cell in the queue: a lower bound of the cost [cells] of a path from the
        robot to the goal through it, then its own cost, to break ties.

        The first part holds the distance to the robot, which moves. Keys that are in the queue
        already would all have to sink by that move; instead `km` lifts those that are added later.
        Rounded: along a straight way keys tie, and what sums of floats add must not part them.
        """
        least = min(self.g[s], self.rhs[s])
        first = least + math.dist(self.start, s) + self.km
        return round(first, 6), round(least, 6)

    def _neighbours(self, s):
        """The eight cells around, each with the cost [cells] of the step: inf into or out of a
        wall."""
        for dx, dy in ((1, 0), (1, 1), (0, 1), (-1, 1), (-1, 0), (-1, -1), (0, -1), (1, -1)):
            n = (s[0] + dx, s[1] + dy)
            free = n not in self.blocked and s not in self.blocked
            yield n, math.hypot(dx, dy) if free else math.inf

    def _update(self, s):
        """Looks up rhs(s) again, and queues s where it is inconsistent."""
        if s != self.target:
            self.rhs[s] = min(self.g[n] + step for n, step in self._neighbours(s))
        if self.g[s] != self.rhs[s]:
            heapq.heappush(self.queue, (self._key(s), s))

    def _search(self):
        """Settles waiting cells until the robot's cell is consistent and none before it waits."""
        while self.queue:
            old, s = self.queue[0]
            consistent = self.rhs[self.start] == self.g[self.start]
            if old >= self._key(self.start) and consistent:
                break
            heapq.heappop(self.queue)
            if self.g[s] == self.rhs[s]:
                continue  # a later entry has settled this cell
            if math.dist(self.begun, s) + math.dist(s, self.target) > self.longest:
                continue  # any way over it is too long
            if old < self._key(s):  # its key has risen since: the cell waits longer
                heapq.heappush(self.queue, (self._key(s), s))
                continue
            around = [n for n, _ in self._neighbours(s)]
            if self.g[s] > self.rhs[s]:  # a shorter way: it is settled
                self.g[s] = self.rhs[s]
            else:  # the way it had is gone: it forgets it, and waits for a longer one
                self.g[s] = math.inf
                around.append(s)
            for n in around:
                self._update(n)

    def _new_walls(self, pose, readings):
        """The cells, not blocked so far, whose centre is nearer to a wall that the readings meet
        than the robot's radius and a margin. Never the robot's own cell, nor that of the goal."""
        way = pose[2] + ANGLES
        ends = pose[:2] + readings[:, None] * np.stack([np.cos(way), np.sin(way)], -1)
        hit = readings < RANGE - 1e-6
        reach = int((ROBOT_RADIUS + self.CELL) / self.CELL) + 1  # [cells]
        new = set()
        for end in ends[hit]:
            i, j = self._cell(end)
            for a in range(i - reach, i + reach + 1):
                for b in range(j - reach, j + reach + 1):
                    distance = math.dist((a * self.CELL, b * self.CELL), end)
                    if distance < ROBOT_RADIUS + MARGIN and (a, b) not in self.blocked:
                        new.add((a, b))
        return new - {self.start, self.target}


def room_ahead(readings, direction):
    """How far [m] the disc, with a margin, can drive in that direction [rad from the heading] until
    it touches a point that the readings meet; RANGE where it meets none."""
    x = readings * np.cos(ANGLES - direction)  # of the points met, along the direction
    y = readings * np.sin(ANGLES - direction)  # and beside it
    radius = ROBOT_RADIUS + MARGIN
    meets = (np.abs(y) < radius) & (x > 0) & (readings < RANGE - 1e-6)
    return (x[meets] - np.sqrt(radius ** 2 - y[meets] ** 2)).min(initial=RANGE)


class Bug(Planner):
    """Bug2 (Lumelsky and Stepanov 1987), the paper's simple automaton: straight at the target;
    around what is in the way, wall on the right, until back on the line from start to target and
    nearer. Knows no map; has range sensors all around."""

    senses = True

    def begin(self, pose, goal):
        super().begin(pose, goal)
        self.start = pose[:2].copy()
        self.hit = None  # [m] how far the goal was where it met the wall; None: it follows none
        self.wall = None  # [rad from the heading] about where that wall is
        self.step = None  # the point that it is driving to; None: to be chosen

    def act(self, pose, readings):
        if self.step is None:
            self.step = self._next_step(pose, readings)
        distance, bearing = polar(pose, self.step)
        if abs(bearing) > MAX_ANGULAR_VELOCITY * CONTROL_PERIOD / 2:
            return turn_and_go(pose, self.step)
        # An arc that ends at a point turns by twice the point's bearing, and is longer than the
        # straight line by bearing / sin(bearing) (numpy's sinc(x) is sin(pi x) / (pi x)).
        self.step = None
        arc = distance / np.sinc(bearing / np.pi)
        return min(arc / CONTROL_PERIOD, MAX_LINEAR_VELOCITY), 2 * bearing / CONTROL_PERIOD

    def _next_step(self, pose, readings):
        """The point to turn and drive to, at most a stride away."""
        distance, bearing = polar(pose, self.goal)
        stride = min(STRIDE, distance)
        ahead = room_ahead(readings, bearing)
        if self.hit is not None and self._leaves_wall(pose, distance, ahead):
            self.hit = None
        if self.hit is None and ahead < stride:
            self.hit = distance
            self.wall = bearing
        way = bearing
        if self.hit is not None:
            way = self._along_wall(readings, stride)
        return (pose[0] + stride * math.cos(pose[2] + way),
                pose[1] + stride * math.sin(pose[2] + way))

    def _leaves_wall(self, pose, distance, ahead):
        """Whether Bug2's condition is met: it is back on the line from start to target, nearer to
        the target than where it met the wall, and has room towards it."""
        dx, dy = np.subtract(self.goal, pose[:2])
        line = np.subtract(self.goal, self.start)
        off_line = abs(line[0] * dy - line[1] * dx) / max(math.hypot(*line), 1e-9)
        return off_line < STRIDE and ahead > STRIDE and distance < self.hit - STRIDE

    def _along_wall(self, readings, stride):
        """The direction [rad from the heading] along the nearest wall, the wall on the right; where
        that is not free, the first to the left of it that is."""
        towards = np.abs(wrap_angle(ANGLES - self.wall)) < np.radians(100)
        nearest = np.where(towards, readings, np.inf).argmin()
        gap = readings[nearest] - ROBOT_RADIUS - 0.06  # [m] too far from the wall
        along = ANGLES[nearest] + np.pi / 2 - np.clip(4 * gap, -0.8, 0.8)
        self.wall = -np.pi / 2  # after this step the robot heads along the wall
        for way in along + np.radians(np.arange(0, 360, 10)):
            if room_ahead(readings, way) > stride:
                return way
        return along


# ----------------------------------------------------------------------------------------- reflexes


class Braitenberg(Planner):
    """Two motors excited by the target and inhibited by what is near on the other side
    (Braitenberg 1984). Knows no map; has range sensors."""

    senses = True

    def act(self, pose, readings):
        _, bearing = polar(pose, self.goal)
        nearness = np.clip(1 - (readings - ROBOT_RADIUS) / 0.4, 0, 1)  # 1 at the wall, 0 from 0.4 m
        near = nearness * np.maximum(np.cos(ANGLES), 0)  # what is ahead counts most, behind not
        left = near[ANGLES > 0].sum()
        right = near[ANGLES < 0].sum()
        turn = np.clip(1.5 * bearing + 0.8 * (right - left), -1, 1)
        return MAX_LINEAR_VELOCITY * max(0.05, 1 - near.max()), turn * MAX_ANGULAR_VELOCITY


class Straight(Planner):
    """Turns to the target and goes. Knows no map and senses nothing else."""

    def act(self, pose, readings):
        return turn_and_go(pose, self.goal)


class Random(Planner):
    """Any velocities. Knows nothing."""

    def act(self, pose, readings):
        v = self.rng.uniform(0, MAX_LINEAR_VELOCITY)
        w = self.rng.uniform(-MAX_ANGULAR_VELOCITY, MAX_ANGULAR_VELOCITY)
        return v, w


PLANNERS = {
    "oracle": Oracle,
    "prm": PRM,
    "dstar": DStar,
    "bug": Bug,
    "braitenberg": Braitenberg,
    "straight": Straight,
    "random": Random,
}
