"""Tests of the loading of Gazebo worlds."""

import math
import re
from dataclasses import astuple

import pytest

import scenes
from scenes.test_scenes import square_room
from scenes.world_file import parse_world
from sim import SceneError

MATERIALS = {"wall": "Gazebo/CeilingTiled", "brick": "Gazebo/Bricks", "wood": "Gazebo/Wood"}


def pose(x, y, z, yaw):
    """Returns the XML of an upright pose."""
    return f"<pose>{x!r} {y!r} {z!r} 0 -0 {yaw!r}</pose>"


def link(name, box, place=(0, 0, 0)):
    """Returns the XML of a link with a box given in world coordinates. place: the model's pose."""
    material, x, y, yaw, length, thickness, height = box
    along = x - place[0], y - place[1]  # relative to the model
    c = math.cos(place[2])
    s = math.sin(place[2])
    geometry = f"<geometry><box><size>{length} {thickness} {height}</size></box></geometry>"
    return f"""
      <link name='{name}'>
        <collision name='{name}_Collision'>{geometry}{pose(0, 0, height / 2, 0)}</collision>
        <visual name='{name}_Visual'>{geometry}<material><script>
          <name>{MATERIALS.get(material, material)}</name></script></material></visual>
        {pose(c * along[0] + s * along[1], c * along[1] - s * along[0], 0, yaw - place[2])}
      </link>"""


def model(links, place=(0, 0, 0), name="room"):
    """Returns the XML of a model with these links at a place (x, y, yaw)."""
    return f"<model name='{name}'>{pose(*place[:2], 0, place[2])}{''.join(links)}</model>"


def world(*models):
    """Returns the XML of a world with these models and with elements that do not matter."""
    return f"""<?xml version='1.0'?>
<sdf version='1.6'><world name='default'>
  <light name='sun' type='directional'><pose>0 0 10 0.4 0 0</pose></light>
  <model name='ground_plane'><static>1</static><link name='link'>
    <collision name='c'><geometry><plane><normal>0 0 1</normal></plane></geometry></collision>
  </link></model>
  <physics type='ode'/><gui><camera name='user_camera'><pose>0 0 9 0 1.5 0</pose></camera></gui>
  {''.join(models)}
</world></sdf>"""


def links_of(boxes, place=(0, 0, 0)):
    """Returns a link for each of the boxes."""
    return [link(f"Wall_{k}", box, place) for k, box in enumerate(boxes)]


def moved_and_stated_twice(boxes):
    """Returns a world whose model is moved, and rotated by more than a turn, with links relative to
    it. Three links occur twice, the first time with another pose, size and material."""
    place = (1.5, -0.7, 2.2)
    wrong = links_of([("wood", x + 1, y, 0.3, 1, 1, 1) for _, x, y, *_ in boxes[:3]])
    return world(model(wrong + links_of(boxes, place), (1.5, -0.7, 2.2 + 2 * math.pi)))


def state_of_some(boxes):
    """Returns a world whose <state> gives the poses of the model and of one link."""
    place = (-1, 2, -0.6)
    first = links_of([("wall", 0, 0, 1, *boxes[0][4:])], place)
    _, x, y, yaw, *_ = boxes[0]
    states = [f"<scale>1 1 1</scale><link name='Wall_0'>{pose(x, y, 0, yaw)}</link>"]
    state = f"<state>{model(states, place)}</state>"
    return world(model(first + links_of(boxes, place)[1:], (9, 9, 1)), state)


@pytest.mark.parametrize("name", ["env1", "maze4"])
@pytest.mark.parametrize("write", [moved_and_stated_twice, state_of_some])
def test_a_world_gives_the_boxes_of_the_scene_file(write, name):
    ours = scenes.load(name)
    scene = parse_world(write([astuple(box) for box in ours.boxes]), name)
    assert scene.name == name and len(scene.boxes) == len(ours.boxes)
    for box, other in zip(scene.boxes, ours.boxes):
        assert box.material == other.material and -math.pi < box.yaw <= math.pi
        for key in ("x", "y", "length", "thickness", "height"):
            assert getattr(box, key) == pytest.approx(getattr(other, key), abs=1e-9)
        assert math.remainder(box.yaw - other.yaw, 2 * math.pi) == pytest.approx(0, abs=1e-9)


ROOM = scenes.parse(square_room(1.0, training_targets=[[0.5, 0.0]], new_targets=[]), "room")
SQUARE = [astuple(wall) for wall in ROOM.boxes]
GOOD = world(model(links_of([*SQUARE, ("wood", 0.6, 0.6, 0, 0.3, 0.3, 0.6)])))


@pytest.mark.parametrize("link", [
    "<collision><geometry><plane/></geometry></collision>",
    "<collision><geometry><box><size>9 9 0.01</size></box></geometry></collision>",
    "<visual><geometry><box/></geometry></visual>",
    "<collision><geometry><box/></geometry></collision><sensor type='camera'/>"])
def test_floors_sensors_and_links_without_collisions_are_left_out(link):
    text = GOOD.replace("</model>", f"<link name='no box'>{link}</link></model>")
    assert len(parse_world(text, "room").boxes) == 5


def test_a_link_may_have_several_collisions_each_with_its_place_and_material():
    """The link is a wall in two parts, with a gap like a door between them."""
    parts = "".join(f"<collision><pose>{x} 0 0.5 0 0 1.5708</pose><geometry><box><size>0.3 0.2 1"
                    "</size></box></geometry></collision>" for x in (-0.5, 0.5))
    parts += "".join(f"<visual><material><script><name>{name}</name></script></material></visual>"
                     for name in (" Gazebo/Bricks\n", "vrc/grey_wall"))
    wall = f"<link name='parted'><pose>0 0.2 0 0 0 1.5708</pose>{parts}</link>"
    room = parse_world(world(model([*links_of(SQUARE), wall])), "room")
    assert [box.material for box in room.boxes[4:]] == ["brick", "wall"]
    found = [value for box in room.boxes[4:] for value in (box.x, box.y, abs(box.yaw))]
    assert found == pytest.approx([0, -0.3, math.pi, 0, 0.7, math.pi], abs=1e-4)


@pytest.mark.parametrize("old, new, words", [
    (GOOD, "<!DOCTYPE a [<!ENTITY a SYSTEM 'file:///etc/passwd'>]><a>&a;</a>", "undefined entity"),
    (GOOD, "<robot/>", "it is a 'robot' with 0 worlds; it must be an 'sdf' with one"),
    (GOOD, "<sdf><world/></sdf>", "no link has a box on the floor"),
    ("<light", "<include><uri>model://table</uri></include><light", "it includes 'model://table'"),
    ("<model name='room'>", "<model name='room'><model/>", "it has model/model; it must hold only"),
    ("</world>", model(links_of(SQUARE * 31), name="b") + "</world>", "it has 129 boxes; it must"),
    ("</world>", "<state><model name='room'><scale>2 1 1</scale></model></state></world>",
     "model 'room' has the scale (2.0, 1.0, 1.0); it must be 1 1 1"),
    ("<pose>0.6 0.6 0 0", "<pose>x 0.6 0 0", "'room'.pose is 'x 0.6 0 0 -0 0'; it must be a list"),
    ("<pose>0.6 0.6 0 0", "<pose>0.6 0.6 0 0.1", "has roll 0.1 and pitch -0; both must be 0"),
    ("<pose>0.6 0.6 0 0", "<pose>0.6 0.6 1 0", "'Wall_4' of 'room' begins 1.00 m above the floor"),
    (">0.3 0.3 0.6<", ">0.3 0.3 -0.6<", "'room'.height is -0.6; it must be above 0"),
    ("<box><size>0.3 0.3 0.6</size></box>", "<cylinder/>", "is a 'cylinder'; it must be one box")])
def test_a_world_that_is_not_a_room_gives_one_sentence(old, new, words):
    assert old in GOOD
    with pytest.raises(SceneError, match=re.escape(words)) as error:
        parse_world(GOOD.replace(old, new), "room")
    assert len(str(error.value)) < 200 and str(error.value).isprintable()


@pytest.mark.parametrize("name, content", [
    ("room.WORLD", GOOD.encode()), ("room.sdf", GOOD.encode("utf-8-sig")),
    ("room.world", GOOD.replace("1.0'", "1.0' encoding='UTF-16'").encode())])
def test_a_world_file_has_either_suffix_and_any_declared_encoding(name, content, tmp_path):
    path = tmp_path / name
    path.write_bytes(content)
    assert scenes.load(path) == parse_world(GOOD, "room")
