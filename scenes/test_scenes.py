"""Each test is the shortest proof of one claim about rooms as data."""

import json
import math
import os
import re
import subprocess
import sys
from dataclasses import asdict
from pathlib import Path

import numpy as np
import pytest

import scenes
from scenes.__main__ import main, share_reachable
from scenes.places import complete
from sim import ROBOT_RADIUS, SceneError
from support.rooms import mirrored

ROOT = Path(__file__).parent.parent
ENV1 = scenes.load("env1")
ENV2 = scenes.load("env2")


def box(**changes):
    """A box of a scene file."""
    return dict(material="wall", x=1.0, y=0.0, yaw_degrees=0.0, length=0.2, thickness=0.2,
                height=2.5) | changes


def square_room(half=2.0, thickness=0.1, extra=(), **changes):
    """A scene file's content: a square room around the origin, `half` metres to each inner wall."""
    side = 2 * half + 2 * thickness
    place = half + thickness / 2
    walls = [box(x=place * math.cos(math.radians(angle)), y=place * math.sin(math.radians(angle)),
                 yaw_degrees=angle + 90, length=side, thickness=thickness)
             for angle in (0, 90, 180, 270)]
    return dict(boxes=walls + list(extra), start=dict(x=0.0, y=0.0, heading_degrees=0.0),
                training_targets=[[1.0, 0.0]], new_targets=[[0.0, 1.0]]) | changes


# The released rooms: x, y relative to the room's offset [m], yaw [rad], length, thickness,
# height [m]; then the offset and the start.
WALLS = [("wall", -2.425, 0, -math.pi / 2, 3, 0.15, 2.5), ("wall", 0, -1.425, 0, 5, 0.15, 2.5),
         ("wall", 2.425, 0, math.pi / 2, 3, 0.15, 2.5), ("wall", 0, 1.425, math.pi, 5, 0.15, 2.5)]
RELEASED = {
    "env1": ([*WALLS,
              ("brick", -0.597, -0.8375, -0.52367, 1.15, 0.3, 1.5),
              ("brick", 0.293, 0.7925, -0.52367, 1.15, 0.3, 1.5),
              ("wood", -1.765, 0.61, -math.pi / 2, 0.61, 0.6, 0.6),
              ("wood", 1.435, -0.66, -math.pi / 2, 0.61, 0.6, 0.6)],
             (-2.015, -3.115), (-0.4, -2.6, 4 * math.pi / 3)),
    "env2": ([*WALLS,
              ("wood", -0.8, -1.0, 0, 0.61, 0.6, 0.6),
              ("brick", 1.4297, -0.665956, math.pi / 2, 1.4, 0.3, 1.5),
              ("wood", -1.5, 1.0, -math.pi / 2, 0.61, 0.6, 0.6),
              ("wood", 0.1, 0.4, 0, 0.61, 0.6, 0.6)],
             (-1.285, -2.935), (0.65, -3.0, math.pi / 2)),
    "maze0": ([("wall", -3.08, -2.875, -math.pi / 2, 3, 0.15, 2.5),
               ("wall", -0.655, -4.3, 0, 5, 0.15, 2.5),
               ("brick", -1.4976, -2.35, 0, 1.72926, 0.3, 1.5),
               ("brick", 0.0926, -2.913, math.pi / 2, 1.55, 0.3, 1.5),
               ("wood", -1.0377, -3.8198, math.pi / 2, 0.61, 0.6, 0.6),
               ("wood", 1.0409, -2.0127, -math.pi / 2, 0.61, 0.6, 0.6),
               ("wall", 1.77, -2.875, math.pi / 2, 3, 0.15, 2.5),
               ("wall", -0.655, -1.45, math.pi, 5, 0.15, 2.5),
               ("brick", -2.2036, -3.0337, math.pi / 2, 1.5, 0.3, 1.5)],
              (0, 0), (1.0, -3.0, math.pi)),
    "maze3": ([("wall", -4.26, -3.095, -math.pi / 2, 3, 0.15, 2.5),
               ("wall", -1.835, -4.52, 0, 5, 0.15, 2.5),
               ("brick", -0.63, -3.11, math.pi / 2, 1.4, 0.3, 1.5),
               ("wall", 0.59, -3.095, math.pi / 2, 3, 0.15, 2.5),
               ("wall", -1.835, -1.67, math.pi, 5, 0.15, 2.5),
               ("wood", -1.96, -2.535, -math.pi / 2, 0.61, 0.6, 0.6),
               ("wood", -3.175, -3.55, 0, 0.61, 0.6, 0.6),
               ("brick", -1.305, -3.66, 0, 1.65, 0.3, 1.5)],
              (0, 0), (-3.44, -2.5, 0)),
    "maze4": ([("wall", -4.93, -2.875, -math.pi / 2, 3, 0.15, 2.5),
               ("wall", -2.505, -4.3, 0, 5, 0.15, 2.5),
               ("wall", -0.08, -2.875, math.pi / 2, 3, 0.15, 2.5),
               ("brick", -3.6063, -3.3695, -math.pi / 6, 1.25, 0.3, 1.5),
               ("brick", -1.4936, -3.3087, math.pi / 6, 1.25, 0.3, 1.5),
               ("brick", -3.8367, -2.7207, 1.17418, 1.19196, 0.3, 1.5),
               ("wall", -2.505, -1.45, math.pi, 5, 0.15, 2.5),
               ("brick", -1.3285, -2.6598, 2 * math.pi / 3, 1.25, 0.3, 1.5),
               ("wood", -2.5897, -2.7884, -math.pi / 2, 0.61, 0.6, 0.6)],
              (0, 0), (-0.76, -2.13, 0)),
}


@pytest.mark.parametrize("name", RELEASED)
def test_world_coordinates_and_degrees_are_the_released_poses(name):
    scene = scenes.load(name)
    boxes, offset, start = RELEASED[name]
    assert len(scene.boxes) == len(boxes)
    for ours, (material, x, y, *rest) in zip(scene.boxes, boxes):
        assert ours.material == material
        given = (ours.x, ours.y, ours.yaw, ours.length, ours.thickness, ours.height)
        assert given == pytest.approx((x + offset[0], y + offset[1], *rest), abs=1e-12, rel=0)
    assert scene.start == pytest.approx(start, abs=1e-12, rel=0)


@pytest.mark.parametrize("scene", [ENV1, ENV2], ids=["env1", "env2"])
def test_rooms_are_the_papers(scene):
    """Facts of the released rooms: 0.28 m of air everywhere, no target straight ahead."""
    places = np.vstack([scene.targets, scene.start[:2]])
    assert scene.clearance(places).min() >= 0.28
    for target in scene.targets:
        line = np.linspace(scene.start[:2], target, 500)
        assert scene.clearance(line).min() < ROBOT_RADIUS


def test_the_targets_of_the_test_rooms_are_the_released_one_and_those_of_our_rule():
    maze0 = scenes.load("maze0")
    assert maze0.training_targets == ((-2.8, -4.0),) and maze0.new_targets == ()
    for name in ("maze3", "maze4"):
        scene = scenes.load(name)
        chosen = complete(name, scene.boxes)
        assert scene.start == pytest.approx(chosen.start, abs=0.0051)
        assert scene.targets == pytest.approx(chosen.targets, abs=0.0051)
        assert (len(scene.training_targets), len(scene.new_targets)) == (10, 2)


def test_rooms_are_known_by_name():
    assert set(RELEASED) <= set(scenes.names())
    assert scenes.load(str(ROOT / "scenes" / "env2.toml")) == ENV2


def test_a_room_of_level_1_has_no_new_targets():
    scene = scenes.parse(square_room(new_targets=[]), "room")
    assert scene.new_targets == () and scene.targets.shape == (1, 2)


@pytest.mark.parametrize("scene", [ENV1, ENV2, mirrored(ENV1)], ids=["env1", "env2", "mirrored"])
def test_a_scene_comes_back_from_its_fields_bit_for_bit(scene):
    assert scenes.rebuild(asdict(scene)) == scene
    assert scenes.rebuild(json.loads(json.dumps(asdict(scene)))) == scene  # lists for tuples


@pytest.mark.parametrize("change, words", [
    (dict(training_targets=[[1.0, 0.0], [2.05, 0.0]]), "training_targets[1] (2.05, 0.0) is inside"),
    (dict(new_targets=[[9.0, 0.0]]), "new_targets[0] (9.0, 0.0) cannot be reached"),
    (dict(training_targets=[]), "training_targets is [], it must be a list with at least 1"),
    (dict(new_targets=0), "new_targets is 0, it must be a list"),
    (dict(new_targets=[[math.nan, 0.0]]), "new_targets[0][0] is nan"),
    (dict(new_targets=[[10 ** 400, 0.0]]), "new_targets[0][0] is a huge number, it must be"),
    (dict(new_targets=[[1.0, 0.0]]), "is a training one too"),
    (dict(start=[0.0, 0.0, 0.0]), "start is [0.0, 0.0, 0.0], it must be a table"),
    (dict(start=dict(x=0.0, y=0.0, heading=0.0)), "start has no 'heading_degrees'"),
    (dict(start=dict(x=1.9, y=0.0, heading_degrees=0)), "start (1.9, 0.0) is nearer to a box"),
    (dict(start=dict(x=0.0, y=0.0, heading_degrees=True)), "start.heading_degrees is True"),
    (dict(offset=[1.0, 0.0]), "unknown key 'offset'"),
    (dict(boxes=square_room()["boxes"][:3]), "the room is not closed"),
    (dict(boxes=[box(height=0.2)]), "boxes[0].height is 0.2, it must be above 0.281"),
    (dict(boxes=[box(material="glass")]), "boxes[0].material is 'glass'"),
    (dict(boxes=[*square_room()["boxes"], box(x=1e5)]), "spread over 100002.2 m"),
    (dict(boxes=[box(length="long")]), "boxes[0].length is 'long'"),
    (dict(boxes=[{}]), "boxes[0] has no 'material'"),
    (dict(boxes=[box(yaw=0.0)]), "boxes[0] has an unknown key 'yaw'"),
])
def test_a_bad_scene_is_one_error_that_names_the_item(change, words):
    with pytest.raises(SceneError, match=re.escape(words)):
        scenes.parse(square_room() | change, "room")


@pytest.mark.parametrize("change, words", [
    (dict(start=(0.0, 0.0)), "start is (0.0, 0.0), it must be a list of 3 numbers"),
    (dict(name=1), "name is 1, it must be 1 to 80 printable characters"),
    (dict(boxes=ENV1.boxes), "boxes[0] is a Box, it must be a table"),
    (dict(training_targets=((-9.0, 0.0),)), "training_targets[0] (-9.0, 0.0) cannot be reached")])
def test_a_bad_scene_of_a_checkpoint_is_one_error_too(change, words):
    with pytest.raises(SceneError, match=re.escape(words)):
        scenes.rebuild(asdict(ENV1) | change)


def test_the_reachable_share_of_an_empty_square_is_its_inner_square():
    share = share_reachable(scenes.parse(square_room(half=2.0), "room"))
    assert share == pytest.approx((2.0 - ROBOT_RADIUS) ** 2 / 2.0 ** 2, abs=0.01)


def test_a_room_is_drawn_without_torch(tmp_path):
    code = ("import runpy, sys; sys.modules['torch'] = None; sys.argv = ['scenes', 'env2']; "
            "runpy.run_module('scenes', run_name='__main__')")
    done = subprocess.run([sys.executable, "-c", code], cwd=tmp_path, capture_output=True,
                          text=True, env=os.environ | {"PYTHONPATH": str(ROOT)})
    assert done.returncode == 0, done.stderr
    path, facts = done.stdout.splitlines()
    assert (tmp_path / path).read_bytes().startswith(b"\x89PNG") and path == "env2.png"
    assert facts.startswith("5.00 m x 3.00 m, boxes: 8, training targets: 10, new targets: 2, ")


@pytest.mark.parametrize("content, words", [
    (None, "scene file 'bad.toml' does not exist"),
    (b"start = [", "scene file 'bad.toml' is no valid TOML at its end"),
    (b"\xff", "scene file 'bad.toml': byte 0 is no UTF-8 text"),
    (b"x = " + b"9" * 5000, "scene file 'bad.toml' has a number that is too long"),
    (b"start = 1", "scene file 'bad.toml': the scene has no 'boxes'"),
    ((ROOT / "scenes" / "env1.toml").read_bytes().replace(b"[-3.0, -2.2]", b"[-3.0, 5.0]"),
     "scene file 'bad.toml': new_targets[0] (-3.0, 5.0) cannot be reached from the start")])
def test_a_room_that_cannot_be_used_is_one_line(content, words, capsys, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    if content is not None:
        Path("bad.toml").write_bytes(content)
    with pytest.raises(SystemExit) as stop:
        main(["bad.toml"])
    printed = capsys.readouterr()
    assert stop.value.code == 2 and printed.out == "" and printed.err.count("\n") == 1
    assert words in printed.err and not Path("bad.png").exists()
