"""Tests of the planners, most of them against a slow search."""

import math

import networkx
import numpy as np
import pytest

import scenes
from evaluation import Planned, assign, evaluate, rollouts
from evaluation.planners import ANGLES, PRM, RANGE, DStar, visibility_graph
from scenes.generate import range_readings
from scenes.test_scenes import box, square_room
from sim import ROBOT_RADIUS, World

ENV1 = scenes.load("env1")
ENV2 = scenes.load("env2")


def grid_graph(cells):
    """Returns a graph of cells (i, j), with edges to eight neighbours and lengths in cells."""
    graph = networkx.Graph()
    for i, j in cells:
        for di, dj in ((1, 0), (0, 1), (1, 1), (1, -1)):
            if (i + di, j + dj) in cells:
                graph.add_edge((i, j), (i + di, j + dj), weight=math.hypot(di, dj))
    return graph


@pytest.mark.parametrize("scene", [ENV1, ENV2], ids=["env1", "env2"])
def test_shortest_paths_are_longer_than_the_line_and_shorter_than_on_a_grid(scene):
    rng = np.random.default_rng(0)
    roadmap = visibility_graph(scene)
    cell = 0.025
    first = scene.reachable[0]  # origin of the integer cell indices
    cells = [tuple(ij) for ij in np.round((scene.reachable - first) / cell).astype(int).tolist()]
    start = rng.integers(len(cells))
    grid = networkx.single_source_dijkstra_path_length(grid_graph(set(cells)), cells[start])
    a = tuple(scene.reachable[start])
    bent = 0
    for end in rng.integers(len(cells), size=25):
        b = tuple(scene.reachable[end])
        _, there = roadmap.path(a, b, within=1e-6)
        _, back = roadmap.path(b, a, within=1e-6)
        straight = math.dist(a, b)
        assert there == pytest.approx(back, abs=1e-4) and there >= straight - 1e-4
        assert there <= cell * grid[cells[end]] + 0.01
        assert there == pytest.approx(straight, abs=1e-4) or not roadmap.free(a, b)
        bent += there > straight + 0.01
    assert bent > 5


@pytest.mark.parametrize("scene", [ENV1, ENV2], ids=["env1", "env2"])
def test_a_path_is_free_ends_at_arrival_and_has_the_returned_length(scene):
    roadmap = PRM.prepare(scene, np.random.default_rng(0))
    for target in scene.targets:
        points, length = roadmap.path(scene.start[:2], target, within=0.1)
        corners = np.array([scene.start[:2], *points])
        assert length == pytest.approx(sum(map(math.dist, corners, corners[1:])))
        assert 0.0999 < math.dist(corners[-1], target) < 0.1
        for a, b in zip(corners, corners[1:]):
            assert scene.clearance(np.linspace(a, b, 500)).min() > ROBOT_RADIUS - 1e-6


@pytest.mark.parametrize("name, scene, protocol, episodes, least", [
    ("oracle", ENV1, "start", 1, 0.9), ("oracle", ENV2, "start", 1, 0.9),
    ("oracle", ENV1, "anywhere", 40, 0.9), ("oracle", ENV2, "anywhere", 40, 0.9),
    ("prm", ENV1, "start", 1, 0.7), ("dstar", ENV1, "start", 1, 0.7)])
def test_planners_with_a_map_or_a_search_reach_every_target_by_a_short_path(
        name, scene, protocol, episodes, least):
    result, _ = evaluate(Planned(name, 0), [scene], episodes, protocol)
    for row in result["targets"] or [result["anywhere"]]:
        assert row["success"] == 1 and row["spl"] > least


def test_d_star_lite_finds_the_cost_of_a_search_from_scratch():
    """The shorter path around a wall in this room turns out to be blocked by a second wall."""
    walls = [box(x=0.0, y=0.0, length=0.1, thickness=1.2), box(x=0.6, y=0.7, thickness=1.6)]
    table = square_room(half=1.5, extra=walls, start=dict(x=-0.7, y=0.1, heading_degrees=0),
                        training_targets=[[1.1, 0.8]], new_targets=[])
    scene = scenes.parse(table, "room")
    world = World([scene])
    planner = DStar(scene, None, None)
    planner.begin(world.poses[0], scene.targets[0])
    grid = grid_graph({(i, j) for i in range(-40, 41) for j in range(-40, 41)})
    costs = []
    while planner.start != planner.target:
        [pose] = world.poses
        [readings] = range_readings(world, ANGLES, RANGE)
        world.drive([planner.act(pose, readings)])
        free = grid.subgraph(set(grid) - planner.blocked)
        scratch = networkx.dijkstra_path_length(free, planner.start, planner.target)
        assert planner.g[planner.start] == pytest.approx(scratch)
        costs.append(scratch)
    assert max(np.diff(costs)) > 5  # [cells] that the second wall added


def test_d_star_stops_its_search_if_there_is_not_any_path():
    """Known walls surround the robot. The search ends, and the robot drives straight ahead."""
    planner = DStar(None, None, None)
    planner.begin(np.zeros(3), (1.0, 0.0))
    ring = range(-8, 9)
    planner.blocked = {(i, j) for i in ring for j in ring if max(abs(i), abs(j)) == 8}
    v, w = planner.act(np.zeros(3), np.full(len(ANGLES), RANGE))
    assert planner.g[planner.start] == math.inf and v > 0 and w == 0


@pytest.mark.parametrize("half, obstacle, start, goal, least", [
    (1.0, dict(x=0.2, y=0.0, length=0.2, thickness=0.8), (-0.5, 0.0), (0.81, 0.3), 1.3),
    (2.0, dict(x=0.0, y=-1.0, length=0.1, thickness=2.0), (-0.5, -1.7), (0.5, -1.7), 4)])
def test_d_star_reaches_a_goal_next_to_a_wall_and_takes_a_detour_of_3_m(
        half, obstacle, start, goal, least):
    """The first goal is nearer to a wall than the planner's margin."""
    table = square_room(half, extra=[box(**obstacle)], training_targets=[goal], new_targets=[],
                        start=dict(x=start[0], y=start[1], heading_degrees=45))
    [trace] = rollouts(Planned("dstar", 0), assign(scenes.parse(table, "room"), 0, 1))
    assert trace.arrived and trace.metres > least


@pytest.mark.parametrize("name, empty, blocked", [
    ("straight", "arrival", "collision"), ("bug", "arrival", "arrival"),
    ("braitenberg", "arrival", None), ("random", None, None)])
def test_reflexes_arrive_or_collide_as_expected(name, empty, blocked):
    for extra, expected in (([], empty), ([box(x=0.9, y=0.0, length=0.2, thickness=0.8)], blocked)):
        table = square_room(extra=extra, start=dict(x=0.0, y=0.0, heading_degrees=60),
                            training_targets=[[1.6, 0.0]])
        [trace] = rollouts(Planned(name, 0), assign(scenes.parse(table, "room"), 0, 1))
        assert expected in (None, trace.outcome)
