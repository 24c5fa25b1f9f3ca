"""Tests of the loading of Gazebo worlds."""

import math
import re
from dataclasses import astuple, replace
from pathlib import Path

import numpy as np
import pytest

import scenes
from scenes.test_scenes import square_room
from scenes.world_file import SIDES
from sim import SceneError

MATERIALS = {"wall": "Gazebo/CeilingTiled", "brick": "Gazebo/Bricks", "wood": "Gazebo/Wood"}


def parse_world(text, name="room", folder=None):
    """Returns the Scene of a world's text."""
    return scenes.read(text, Path(f"{name}.world"), folder)


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


BOX = "<collision name='c'><geometry><box><size>0.4 0.3 0.6</size></box></geometry></collision>"
PERMEABLE = BOX.replace("</geometry>", "</geometry><surface><contact>{}</contact></surface>")
WHEEL = "<joint name='left_wheel_joint' type='revolute'/>"


def with_model(content, place="0.3 0.2 0.3 0 0 0", name="thing", pose="pose"):
    """Returns GOOD with one more model of this content at a place."""
    return GOOD.replace("</world>", f"<model name='{name}'><{pose}>{place}</{pose.split()[0]}>"
                                    f"{content}</model></world>")


@pytest.mark.parametrize("content", [
    "<link><collision><geometry><plane/></geometry></collision></link>",
    "<link><visual><geometry><box/></geometry></visual></link>",
    f"<link><pose>0 0 -0.595 0 0 0</pose>{BOX}</link>",  # below the floor
    f"<link><pose>0 0 0.61 0 0 0</pose>{BOX}</link>",  # above the robot
    f"<link><pose>0 0 0.8 0 0.5 0</pose>{BOX}</link>",  # likewise, and tilted
    f"<link>{BOX.replace('0.4', '0')}</link>",
    f"<link>{PERMEABLE.format('<collide_bitmask>0x00</collide_bitmask>')}</link>",
    f"<link>{PERMEABLE.format('<collide_without_contact>true</collide_without_contact>')}</link>",
    f"<link name='base_link'>{BOX}</link><link name='WHEEL_left'/>",  # a robot
    f"<link>{BOX}</link><plugin filename='libgazebo_ros_diff_drive.so'/>"])
def test_what_the_robot_cannot_hit_is_left_out(content):
    assert len(parse_world(with_model(content)).boxes) == 5


def test_a_deleted_model_is_left_out():
    deleted = "<state><deletions><name>thing</name></deletions></state></world>"
    text = with_model(f"<link>{BOX}</link>").replace("</world>", deleted)
    assert len(parse_world(text).boxes) == 5


STANDING = (0.3, 0.2, 0.0, 0.4, 0.3, 0.6)  # x, y, yaw, length, thickness, height


@pytest.mark.parametrize("text, expected", [
    (with_model(f"<link>{BOX}<sensor type='contact'/></link>"), STANDING),
    (with_model(f"<static>true</static><link>{BOX}</link>{WHEEL}"), STANDING),
    (with_model(f"<link name='base_link'>{BOX}</link><joint type='fixed'/>"), STANDING),
    (with_model(f"<link name='wheel_of_a_chair'>{BOX}</link>"), STANDING),
    (with_model(f"<link>{BOX}</link><model name='r'><link name='wheel'>{BOX}</link>"
                f"{WHEEL}</model>"), STANDING),
    (with_model(f"<link>{BOX}</link>", "0.3 0.2 0 0 0 0"), (*STANDING[:5], 0.3)),  # sunk
    (with_model(f"<link>{BOX}</link>", "0.3 0.2 0.5 0 0 0"), (*STANDING[:5], 0.8)),  # hangs low
    (with_model(f"<link>{BOX}</link>", "0.3 0.2 -0.1 0 0 0"), (*STANDING[:5], 0.3)),  # 0.2 m high
    (with_model(f"<link>{BOX}</link>", "0.3 0.2 0.3 0.02 0 0"), STANDING),
    (with_model(f"<link>{BOX}</link>", "0.3 0.2 0.3 1.5708 0 0.5"),
     (0.3, 0.2, 0.5 - math.pi / 2, 0.6, 0.4, 0.45)),
    (with_model(f"<link>{BOX}</link>", "0.3 0.2 0.3 0 0 90", pose="pose degrees='true'"),
     (0.3, 0.2, math.pi / 2, 0.4, 0.3, 0.6)),
    (with_model(f"<frame name='f'><pose>0.1 0 0 0 0 0</pose></frame><link>"
                f"<pose relative_to='f'>0 0.1 0 0 0 0</pose>{BOX}</link>"),
     (0.4, 0.3, *STANDING[2:])),
    (with_model(f"<joint name='j' type='fixed'><child>a</child></joint><link name='a'>"
                "<pose>0.1 0 0 0 0 0</pose></link><link>"
                f"<pose relative_to='j'>0 0.1 0 0 0 0</pose>{BOX}</link>"),
     (0.4, 0.3, *STANDING[2:])),
    (with_model(f"<link name='a'><pose>1 0 0 0 0 1.5708</pose>{BOX}</link>").replace(
        "name='thing'", "name='thing' placement_frame='a'"), STANDING),
    (with_model(f"<model name='m'><pose>0.1 0 0 0 0 0</pose><link>{BOX}</link></model>"),
     (0.4, 0.2, *STANDING[2:])),
    (with_model(f"<link name='a'>{BOX}</link>").replace(
        "</world>", "<state><model name='thing'><pose>0 0 0.3 0 0 0</pose><scale>2 1 1</scale>"
        "<link name='a'><pose>-0.2 0 0.3 0 0 0</pose></link></model></state></world>"),
     (-0.2, 0, 0, 0.8, 0.3, 0.6)),
    (with_model("").replace("</world>", f"<state><insertions><model name='new'><link>"
     f"<pose>0.3 0.2 0.3 0 0 0</pose>{BOX}</link></model></insertions></state></world>"), STANDING),
    ("<!-- <?xml ?> -- made by x -->\n" + with_model(f"<link>{BOX}</link>"), STANDING),
    (with_model(f"<link>{BOX}<ignition::grid a:b='1'/><x:y/></link>"), STANDING)])
def test_a_solid_becomes_a_box_from_the_floor_up(text, expected):
    *_, box = parse_world(text).boxes
    assert astuple(box)[1:] == pytest.approx(expected, abs=1e-4)


def test_a_scaled_cylinder_is_a_union_of_boxes_within_3_percent_of_its_radius():
    cylinder = "<geometry><cylinder><radius>0.2</radius><length>0.5</length></cylinder></geometry>"
    state = "<state><model name='thing'><scale>2 2 1</scale></model></state></world>"
    text = with_model(f"<link><collision>{cylinder}</collision></link>").replace("</world>", state)
    boxes = parse_world(text).boxes[5:]
    assert len(boxes) == SIDES and {box.height for box in boxes} == {0.55}
    around = np.exp(1j * np.linspace(0, 2 * np.pi, 1000))
    for radius, is_inside in ((0.4 * 0.97, True), (0.4 * 1.03, False)):
        circle = np.stack([0.3 + radius * around.real, 0.2 + radius * around.imag], -1)
        clearance = scenes.generate.as_scene(boxes).clearance(circle)
        assert ((clearance < 0) == is_inside).all()
    with pytest.raises(SceneError, match="is tilted; it must be upright"):
        parse_world(text.replace("<collision>", "<collision><pose>0 0 0 1.5708 0 0</pose>"))
    with pytest.raises(SceneError, match="is scaled to an ellipse"):
        parse_world(text.replace("2 2 1", "2 1 1"))
    ball = "<pose>0 0 0 1 1 0</pose><geometry><sphere><radius>0.2</radius></sphere></geometry>"
    text = text.replace(cylinder, ball).replace("2 2 1", "2 2 2.5")
    assert parse_world(text).boxes[5:] == tuple(replace(box, height=0.8) for box in boxes)


def test_models_from_a_folder_are_included_and_sun_and_ground_are_not_needed(tmp_path):
    (tmp_path / "worlds").mkdir()
    (tmp_path / "models" / "crate").mkdir(parents=True)
    (tmp_path / "models" / "shelf").mkdir()
    (tmp_path / "models" / "crate" / "model.sdf").write_text(
        "<sdf><model name='c'><pose>9 9 9 0 0 0</pose><frame name='f'><pose>8.9 0.1 0 0 0 0</pose>"
        f"</frame><link name='wheel'>{BOX}</link>{WHEEL}</model></sdf>")
    (tmp_path / "models" / "shelf" / "model.sdf").write_text(
        "<sdf version='1.6'><model name='s'><include><uri>model://crate</uri>"
        "<pose>9 0.1 0 0 0 0</pose><placement_frame>f</placement_frame><static>1</static>"
        "</include></model></sdf>")
    includes = "".join(f"<include><uri>{uri}</uri><pose>0.2 0.2 0.3 0 0 0</pose></include>"
                       for uri in ("model://my/ground_plane", "model://shelf",
                                   "https://fuel.gazebosim.org/1.0/OpenRobotics/models/Sun"))
    text = GOOD.replace("</world>", includes + "</world>")
    *others, box = parse_world(text, "room", tmp_path / "worlds").boxes
    assert len(others) == 5 and astuple(box)[1:] == pytest.approx((0.3, 0.2, *STANDING[2:]))
    (tmp_path / "models" / "crate" / "model.sdf").write_text(
        "<sdf><model name='c'><include><uri>model://crate</uri></include></model></sdf>")
    (tmp_path / "model.sdf").write_text(GOOD)
    with pytest.raises(SceneError, match="it includes 'model://..'; its file must be"):
        parse_world(text.replace("://shelf", "://.."), "room", tmp_path / "worlds")
    with pytest.raises(SceneError, match="it includes models in models, more than 8 deep"):
        parse_world(text, "room", tmp_path / "worlds")
    with pytest.raises(SceneError, match="'model://shelf'; its file must be '../models/shelf/"):
        parse_world(text)


def test_a_model_is_a_room_and_a_robot_is_its_start(tmp_path, caplog):
    robot = (f"<model name='r'><pose>0.1 -0.2 0 0 0 1</pose><link name='base_link'>{BOX}</link>"
             "<joint type='revolute'/></model>")
    path = tmp_path / "model.sdf"
    path.write_text(f"<sdf version='1.6'>{model(links_of(SQUARE))}</sdf>")
    assert len(scenes.load(path).boxes) == 4
    scene = parse_world(world(model(links_of(SQUARE)), robot))
    assert scene.start == pytest.approx((0.1, -0.2, 1)) and "'r' is a robot" in caplog.text
    scene = parse_world(world(model(links_of(SQUARE)), robot.replace("0.1 -0.2", "0.9 0.9")))
    assert scene.start[:2] == pytest.approx((0, 0)) and "place is not the start" in caplog.text
    assert scenes.load(f"{path}@0.3,-0.1,90").start == pytest.approx((0.3, -0.1, math.pi / 2))
    with pytest.raises(SceneError, match=r"start \(5.0, 0.0\) is outside the room"):
        scenes.load(f"{path}@5,0,0")


def test_things_that_may_move_are_named(caplog):
    text = with_model(f"<link>{BOX}</link><plugin name='push' filename='libpush.so'/>")
    parse_world(text.replace("</world>", "<actor name='walker'/></world>"))
    assert "'thing' has a plugin, which may move it" in caplog.text
    assert "actor 'walker' is left out" in caplog.text


def test_a_low_box_over_most_of_the_room_is_a_floor():
    slab = BOX.replace("0.4 0.3 0.6", "2 2 0.1")
    assert len(parse_world(with_model(f"<link>{slab}</link>", "0 0 0 0 0 0")).boxes) == 5


def test_a_link_may_have_several_collisions_each_with_its_place_and_material():
    """The link is a wall in two parts, with a gap like a door between them."""
    parts = "".join(f"<collision><pose>{x} 0 0.5 0 0 1.5708</pose><geometry><box><size>0.3 0.2 1"
                    "</size></box></geometry></collision>" for x in (-0.5, 0.5))
    parts += "".join(f"<visual><material><script><name>{name}</name></script></material></visual>"
                     for name in (" Gazebo/Bricks\n", "vrc/grey_wall"))
    wall = f"<link name='parted'><pose>0 0.2 0 0 0 1.5708</pose>{parts}</link>"
    room = parse_world(world(model([*links_of(SQUARE), wall])))
    assert [box.material for box in room.boxes[4:]] == ["brick", "wall"]
    found = [value for box in room.boxes[4:] for value in (box.x, box.y, abs(box.yaw))]
    assert found == pytest.approx([0, -0.3, math.pi, 0, 0.7, math.pi], abs=1e-4)


@pytest.mark.parametrize("old, new, words", [
    (GOOD, "<!DOCTYPE a [<!ENTITY a SYSTEM 'file:///etc/passwd'>]><a>&a;</a>", "it has a DOCTYPE"),
    (GOOD, "<robot/>", "it is a 'robot' with 1 worlds; it must be an 'sdf' with one world or a"),
    (GOOD, "<sdf><world/></sdf>", "no link has a solid that the robot can collide with"),
    (GOOD, "define sicklaser ranger ( )", "it is not XML; it must be a Gazebo world or model"),
    ("<light", "<include><uri>model://../x</uri></include><light", "it includes 'model://../x'"),
    ("</world>", model(links_of(SQUARE * 128), name="b") + "</world>", "it has 517 boxes; it must"),
    ("<pose>0.6 0.6 0 0", "<pose>x 0.6 0 0", "the pose of 'Wall_4' is 'x 0.6 0 0 -0 0'; it must"),
    ("<pose>0.6 0.6 0 0", "<pose>0.6 0.6 0 0.1", "'Wall_4' of 'room' is tilted; it must be"),
    ("<pose>0 0 0.3", "<pose relative_to='__model__'>0 0 0.3", "relative to '__model__'; it must"),
    ("<pose>0.6 0.6 0 0", "<pose relative_to='Wall_4'>0 0 0 0", "placed relative to another"),
    ("<pose>0.6", "<pose relative_to='a'>0.6", "a pose is relative to 'a'; it must be a link"),
    (">0.3 0.3 0.6<", ">0.3 0.3 -0.6<", "size is (0.3, 0.3, -0.6); all of it must be at least 0"),
    ("<pose>0.6 0.6 0 0", "<pose>60 0.6 0 0", "the boxes extend over 61.25 m; it must be at most"),
    ("<box><size>0.3 0.3 0.6</size></box>", "<mesh/>", "is a 'mesh'; it must be a box")])
def test_a_world_that_is_not_a_room_gives_one_sentence(old, new, words):
    assert old in GOOD
    with pytest.raises(SceneError, match=re.escape(words)) as error:
        parse_world(GOOD.replace(old, new))
    assert len(str(error.value)) < 230 and str(error.value).isprintable()


@pytest.mark.parametrize("name, content", [
    ("room.WORLD", GOOD.encode()), ("room.sdf", GOOD.encode("utf-8-sig")),
    ("room.world", GOOD.replace("1.0'", "1.0' encoding='UTF-16'").encode())])
def test_a_world_file_has_either_suffix_and_any_declared_encoding(name, content, tmp_path):
    path = tmp_path / name
    path.write_bytes(content)
    assert scenes.load(path) == parse_world(GOOD)
