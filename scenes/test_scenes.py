"""Tests of scene files and of the Scenes made from them."""

import json
import math
import re
from dataclasses import asdict
from pathlib import Path

import numpy as np
import pytest

import scenes
from scenes.__main__ import facts, main
from scenes.places import complete
from sim import ROBOT_RADIUS, SceneError


def box(**changes):
    """Returns a box as in a scene file."""
    return dict(material="wall", x=1.0, y=0.0, yaw_degrees=0.0, length=0.2, thickness=0.2,
                height=2.5) | changes


def square_room(half=2.0, thickness=0.1, extra=(), **changes):
    """Returns a scene file's content: a square room with its walls `half` m from the origin."""
    side = 2 * half + 2 * thickness
    place = half + thickness / 2
    walls = [box(x=place * math.cos(math.radians(angle)), y=place * math.sin(math.radians(angle)),
                 yaw_degrees=angle + 90, length=side, thickness=thickness)
             for angle in (0, 90, 180, 270)]
    return dict(boxes=walls + list(extra), start=dict(x=0.0, y=0.0, heading_degrees=0.0),
                training_targets=[[1.0, 0.0]], new_targets=[[0.0, 1.0]]) | changes


# Two released rooms: x, y relative to the room's offset [m], yaw [rad], length, thickness,
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
}


@pytest.mark.parametrize("name", RELEASED)
def test_boxes_and_starts_equal_the_released_ones(name):
    scene = scenes.load(name)
    boxes, offset, start = RELEASED[name]
    assert len(scene.boxes) == len(boxes)
    for ours, (material, x, y, *rest) in zip(scene.boxes, boxes):
        assert ours.material == material
        given = (ours.x, ours.y, ours.yaw, ours.length, ours.thickness, ours.height)
        assert given == pytest.approx((x + offset[0], y + offset[1], *rest), abs=1e-12, rel=0)
    assert scene.start == pytest.approx(start, abs=1e-12, rel=0)


def test_targets_of_test_rooms_are_the_released_one_or_chosen_by_our_rule():
    maze0 = scenes.load("maze0")
    assert maze0.training_targets == ((-2.8, -4.0),) and maze0.new_targets == ()
    for name in ("maze3", "maze4"):
        scene = scenes.load(name)
        chosen = complete(name, scene.boxes)
        assert scene.start == pytest.approx(chosen.start, abs=0.0051)
        assert scene.targets == pytest.approx(chosen.targets, abs=0.0051)


def test_a_room_is_loaded_by_name_or_path_with_or_without_a_byte_order_mark(tmp_path):
    assert {"env1", "env2", "lab", "maze0", "maze3", "maze4"} == set(scenes.names())
    copy = tmp_path / "env2.toml"
    for mark in (b"", b"\xef\xbb\xbf"):
        copy.write_bytes(mark + (scenes.SCENE_FOLDER / "env2.toml").read_bytes())
        assert scenes.load(copy) == scenes.load("env2")


@pytest.mark.parametrize("name", ["env1", "maze0", "lab", "random:3"])
def test_a_scene_is_rebuilt_exactly_from_its_json(name):
    scene = scenes.load(name)
    assert scenes.rebuild(json.loads(json.dumps(asdict(scene)))) == scene  # JSON has lists


@pytest.mark.parametrize("change, words", [
    (dict(training_targets=[[1.0, 0.0], [2.05, 0.0]]), "training_targets[1] (2.05, 0.0) cannot be"),
    (dict(new_targets=[[math.nan, 0.0]]), "new_targets[0][0] is nan; it must be a number from -1"),
    (dict(new_targets=[[1.0, 0.0]]), "(1.0, 0.0) is a training and a new target"),
    (dict(start=dict(x=1.9, y=0.0, heading_degrees=0)), "start (1.9, 0.0) is nearer to a box"),
    (dict(reality={"blur": 0.6}), "reality has an unknown key 'blur'; known: appearance, "),
    (dict(reality={"camera_yaw_degrees": 18}), "it must be a number from -17.18873 to 17.18873"),
    (dict(boxes=square_room()["boxes"][:3]), "the room is not closed: the robot can leave at ("),
    (dict(boxes=[*square_room()["boxes"], box(x=58.0)]), "extend over 60.20 m; it must be at most"),
    (dict(boxes=[box(height=0.2)]), "boxes[0].height is 0.2; it must be above 0.281"),
    (dict(boxes=[box(length="x" * 999)]), "boxes[0].length is 'xxxx")])
def test_a_bad_scene_gives_one_sentence_that_names_the_item(change, words):
    with pytest.raises(SceneError, match=re.escape(words)) as error:
        scenes.parse(square_room() | change, "room")
    assert len(str(error.value)) < 200


def test_a_scene_name_in_a_weights_file_cannot_lead_to_another_folder():
    with pytest.raises(SceneError, match="^name is '../x'; it must be printable"):
        scenes.rebuild(asdict(scenes.load("env1")) | dict(name="../x"))


def test_the_reachable_fraction_of_an_empty_square_is_that_of_its_inner_square():
    [percent] = re.findall(r"reachable: (\d+)%", facts(scenes.parse(square_room(2.0), "room")))
    assert int(percent) == pytest.approx(100 * (2.0 - ROBOT_RADIUS) ** 2 / 2.0 ** 2, abs=1)


def test_the_program_draws_a_room(capsys, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    main(["env2"])
    assert capsys.readouterr().out.startswith("env2-room.png\n5.00 m x 3.00 m, boxes: 8, ")
    assert Path("env2-room.png").read_bytes().startswith(b"\x89PNG")


@pytest.mark.parametrize("name, text, words", [
    ("bad.toml", "start = [", "it is not valid TOML"), ("bad.toml", "x = " + "[" * 10 ** 4, ""),
    ("bad.foo", "", "its name must end in .toml, .world, .sdf"),
    ("bad.toml", "start = 1", "the scene has no 'boxes'")])
def test_an_unusable_file_gives_one_sentence(name, text, words):
    with pytest.raises(SceneError, match=f"^room file '{name}' cannot be used: {words}") as error:
        scenes.read(text, Path(name))
    assert "\n" not in str(error.value)


@pytest.mark.parametrize("name", scenes.names())
def test_a_room_written_as_toml_is_the_same_to_a_millimetre(name):
    room = scenes.load(name)
    copy = scenes.read(scenes.to_toml(room), Path(f"{name}.toml"))
    assert np.allclose([box.corners for box in copy.boxes], [box.corners for box in room.boxes],
                       atol=2e-3)
    assert [box.material for box in copy.boxes] == [box.material for box in room.boxes]
    assert np.allclose(copy.targets, room.targets, atol=1e-3)
    assert len(copy.training_targets) == len(room.training_targets)
    assert np.allclose((copy.start, *copy.other_starts), (room.start, *room.other_starts),
                       atol=1e-3)
    for name, value in vars(room.reality).items() if room.reality else ():
        assert getattr(copy.reality, name) == (value if name == "appearance" else
                                               pytest.approx(value))
