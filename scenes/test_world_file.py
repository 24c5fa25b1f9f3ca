"""Each test is the shortest proof of one claim about Gazebo's worlds as rooms."""

import math
import re

import pytest

import scenes
from scenes.__main__ import main
from scenes.limits import DEEPEST, MOST_BOXES, MOST_ELEMENTS
from scenes.test_scenes import RELEASED, ROOT
from sim import SceneError

MATERIALS = {"wall": "Gazebo/CeilingTiled", "brick": "Gazebo/Bricks", "wood": "Gazebo/Wood"}
WALL = ("wall", 0, 0, 0, 1, 0.15, 2.5)


def released(name):
    """The boxes of a released room: material, x, y [m], yaw [rad], length, thickness, height."""
    boxes, offset, _ = RELEASED[name]
    return [(material, x + offset[0], y + offset[1], *rest) for material, x, y, *rest in boxes]


def pose(x, y, z, yaw):
    """An upright pose as a world states it."""
    return f"<pose>{x!r} {y!r} {z!r} 0 -0 {yaw!r}</pose>"


def link(name, box, place=(0, 0, 0)):
    """A link of a model at that place (x, y, yaw) that has a box of the world there."""
    material, x, y, yaw, length, thickness, height = box
    along = x - place[0], y - place[1]  # the model's place, undone
    c = math.cos(place[2])
    s = math.sin(place[2])
    geometry = f"<geometry><box><size>{length} {thickness} {height}</size></box></geometry>"
    return f"""
      <link name='{name}'>
        <collision name='{name}_Collision'>{geometry}{pose(0, 0, height / 2, 0)}</collision>
        <visual name='{name}_Visual'>{geometry}<material><script>
          <uri>file://media/materials/scripts/gazebo.material</uri>
          <name>{MATERIALS.get(material, material)}</name></script></material></visual>
        {pose(c * along[0] + s * along[1], c * along[1] - s * along[0], 0, yaw - place[2])}
      </link>"""


def model(links, place=(0, 0, 0), name="room"):
    """A model at that place of links."""
    return f"<model name='{name}'>{pose(*place[:2], 0, place[2])}{''.join(links)}</model>"


def world(*models):
    """A world's text, with things that are of no concern."""
    return f"""<?xml version='1.0'?>
<sdf version='1.6'><world name='default'>
  <light name='sun' type='directional'><pose>0 0 10 0.4 0 0</pose></light>
  <model name='ground_plane'><static>1</static><link name='link'>
    <collision name='c'><geometry><plane><normal>0 0 1</normal></plane></geometry></collision>
  </link></model>
  <physics type='ode'/><plugin name='p' filename='p.so'/>
  <gui><camera name='user_camera'><pose>0 0 9 0 1.5 0</pose></camera></gui>
  {''.join(models)}
</world></sdf>"""


def links_of(boxes, place=(0, 0, 0)):
    """A link for each of the boxes."""
    return [link(f"Wall_{k}", box, place) for k, box in enumerate(boxes)]


def around(box):
    """A small closed room of walls around the origin, and that box."""
    return [("wall", math.cos(yaw), math.sin(yaw), yaw + math.pi / 2, 2.15, 0.15, 2.5)
            for yaw in (0, math.pi / 2, math.pi, -math.pi / 2)] + [box]


def as_written(name):
    """The plainest file."""
    return world(model(links_of(released(name))))


def moved(name):
    """The model stands somewhere else, rotated by more than a turn, its links relative to it."""
    place = (1.5, -0.7, 2.2)
    return world(model(links_of(released(name), place), (1.5, -0.7, 2.2 + 2 * math.pi)))


def stated_twice(name):
    """Three links are stated twice, the first time with another pose, size and material."""
    boxes = released(name)
    wrong = links_of([("wood", x + 1, y, 0.3, 1, 1, 1) for _, x, y, *_ in boxes[:3]])
    return world(model(wrong + links_of(boxes)))


def state_of_links(name):
    """The models and links stand elsewhere, and <state> says where they are in the world."""
    boxes = released(name)
    elsewhere = [(material, x + 1, y - 2, yaw + 1, *size) for material, x, y, yaw, *size in boxes]
    states = [f"<link name='Wall_{k}'>{pose(x, y, 0, yaw)}</link>"
              for k, (_, x, y, yaw, *_) in enumerate(boxes)]
    state = f"<state world_name='default'>{model(states, (3, 3, 3))}</state>"
    return world(model(links_of(elsewhere)), state)


def state_of_some(name):
    """<state> says where the model is, and one of its links, which stands elsewhere in it."""
    place = (-1, 2, -0.6)
    boxes = released(name)
    first = links_of([("wall", 0, 0, 1, *boxes[0][4:])], place)
    _, x, y, yaw, *_ = boxes[0]
    states = [f"<scale>1 1 1</scale><link name='Wall_0'>{pose(x, y, 0, yaw)}</link>"]
    state = f"<state>{model(states, place)}</state>"
    return world(model(first + links_of(boxes, place)[1:], (9, 9, 1)), state)


def several_models(name):
    """Each box has a model of its own."""
    return world(*[model([link("link", box)], name=f"box {k}")
                   for k, box in enumerate(released(name))])


def compared(box):
    """Numbers that boxes of the same place and size share."""
    return (box.x, box.y, math.cos(box.yaw), math.sin(box.yaw), box.length, box.thickness,
            box.height)


@pytest.mark.parametrize("name", ["env1", "env2", "maze0", "maze4"])
@pytest.mark.parametrize("write", [as_written, moved, stated_twice, state_of_links, state_of_some,
                                   several_models], ids=lambda write: write.__name__)
def test_a_world_has_the_boxes_of_the_scene_file(write, name, tmp_path):
    path = tmp_path / f"{name}.world"
    path.write_text(write(name))
    scene = scenes.load(path)
    ours = scenes.load(name)
    assert scene.name == name and len(scene.boxes) == len(ours.boxes)
    for box, other in zip(scene.boxes, ours.boxes):
        assert box.material == other.material
        assert compared(box) == pytest.approx(compared(other), abs=1e-9)
        assert -math.pi < box.yaw <= math.pi
    assert len(scene.training_targets) == 10 and len(scene.new_targets) == 2


@pytest.mark.parametrize("material, ours", [
    ("Gazebo/Grey", "wall"), (" Gazebo/Bricks\n", "brick"), ("vrc/grey_wall", "wall"),
    ("", "wall")])
def test_other_materials_are_walls(material, ours):
    text = world(model(links_of(around((material, 0.6, 0.6, 0, 0.3, 0.3, 1)))))
    assert scenes.parse_world(text, "room").boxes[-1].material == ours


NOT_OF_THE_ROOM = {
    "a plane": "<plane/>", "a box in the floor": "<box><size>9 9 0.1</size></box>"}


@pytest.mark.parametrize("geometry", NOT_OF_THE_ROOM.values(), ids=NOT_OF_THE_ROOM)
def test_a_floor_is_no_box(geometry):
    floor = f"""<model name='floor'><link name='floor'><pose>0 0 -0.05 0 0 0</pose><collision>
        <geometry>{geometry}</geometry></collision></link></model>"""
    text = world(floor, model(links_of(around(WALL)[:4])))
    assert len(scenes.parse_world(text, "room").boxes) == 4


def test_what_is_only_seen_and_what_has_a_sensor_is_left_out():
    cube = "<link name='cube'><visual><geometry><box/></geometry></visual></link>"
    camera = link("camera", WALL).replace("</link>", "<sensor type='camera'/></link>")
    text = world(model([cube, camera, *links_of(around(WALL)[:4])]))
    assert len(scenes.parse_world(text, "room").boxes) == 4


def test_a_link_may_have_several_collisions_each_with_its_place():
    """A wall in two parts, as with a door between them."""
    part = ("<collision><pose>{} 0 0.5 0 0 1.5708</pose><geometry><box><size>0.3 0.2 1</size></box>"
            "</geometry></collision>")
    parts = part.format(-0.5) + part.format(0.5)
    wall = f"<link name='parted'><pose>0 0.2 0 0 0 1.5708</pose>{parts}</link>"
    room = scenes.parse_world(world(model([*links_of(around(WALL)[:4]), wall])), "room")
    found = [value for box in room.boxes[4:] for value in (box.x, box.y, abs(box.yaw))]
    assert found == pytest.approx([0, -0.3, math.pi, 0, 0.7, math.pi], abs=1e-4)


GOOD = world(model(links_of(around(("wood", 0.6, 0.6, 0, 0.3, 0.3, 0.6)))))


@pytest.mark.parametrize("old, new, words", [
    ("<?xml version='1.0'?>", "<!DOCTYPE sdf>", "it has a document type (DOCTYPE)"),
    ("<?xml version='1.0'?>", "<!DOCTYPE a [<!ENTITY b 'bb'>]>", "document type (DOCTYPE)"),
    ("<?xml version='1.0'?>", "<!DOCTYPE a SYSTEM 'file:///etc/passwd'>", "document type"),
    ("<light", "&lol;<light", "it is no valid XML at line 3, column 3"),
    ("</world>", "", "it is no valid XML at line"),
    ("<light", "\0<light", "it is no valid XML at line 3"),
    (GOOD, "", "it is no valid XML at line 1, column 1"),
    (GOOD, "<robot/>", "it is a 'robot', it must be an 'sdf'"),
    (GOOD, "<sdf/>", "it has 0 worlds, it must have one"),
    ("</world>", "</world><world/>", "it has 2 worlds"),
    (GOOD, "<sdf><world/></sdf>", "no link has a box that stands on the floor"),
    ("<light", "<a>" * DEEPEST + "</a>" * DEEPEST + "<light", "nested more than 64 deep"),
    ("<light", "<a/>" * MOST_ELEMENTS + "<light", "it has more than 50,000 elements"),
    ("<light", "<include><uri>model://table</uri></include><light", "it includes 'model://table'"),
    ("<model name='room'>", "<model name='room'><include/>", "it includes ''"),
    ("<model name='room'>", "<model name='room'><model/>", "'room' holds another model"),
    ("</world>", "<model name='b'><model/></model></world>", "'b' holds another model"),
    ("</world>", "<population><model/></population></world>", "it has population, it must hold"),
    ("</world>", "<state><insertions><model/></insertions></state></world>", "it has insertions"),
    ("</world>", "<state><deletions><name>room</name></deletions></state></world>", "deletions"),
    ("<normal>0 0 1<", "<normal>1 0 0<", "'ground_plane' is a plane that is no floor"),
    ("</world>", model(links_of([WALL])) + "</world>", "two models with boxes have the name"),
    ("</world>", model(links_of([WALL] * (MOST_BOXES - 4)), name="b") + "</world>", "than 128"),
    ("</world>", "<state><model name='room'><scale>2 1 1</scale></model></state></world>",
     "'room' is scaled in <state>"),
    ("<pose>0.6 0.6 0 0", "<pose>nan 0.6 0 0", "link 'Wall_4' of 'room'.pose[0] is 'nan'"),
    ("<pose>0.6 0.6 0 0", "<pose>0.6 1e9 0 0", "'room'.pose[1] is 1000000000.0, it must be"),
    ("<pose>0.6 0.6 0 0", "<pose>1_0 0.6 0 0", "'room'.pose[0] is '1_0', it must be a number"),
    ("<pose>0.6 0.6 0 0", "<pose>0.6 0.6 0", "'room'.pose is '0.6 0.6 0 -0 0', it must be 6"),
    ("<pose>0.6 0.6 0 0", "<pose>0.6 0.6 0 0.1", "has roll 0.1 and pitch -0, both must be 0"),
    ("<pose>0.6 0.6", "<pose frame='map'>0.6 0.6", "pose is in the frame 'map', it must name none"),
    ("<pose>0.6 0.6", "<pose relative_to='a'>0.6 0.6", "pose is in the frame 'a'"),
    ("<pose>0.6 0.6", "<pose degrees='true'>0.6 0.6", "'room'.pose is not in radians"),
    ("<pose>0.6 0.6", "<pose/><pose>0.6 0.6", "'Wall_4' of 'room' has 2 poses, it must have one"),
    ("<pose>0.6 0.6 0 0", "<pose>0.6 0.6 1 0", "'Wall_4' of 'room' begins 1.00 m above the floor"),
    ("<pose>0.6 0.6 0 0", "<pose>0.6 0.6 -0.2 0", "begins -0.20 m above the floor"),
    (">0.3 0.3 0.6<", ">0.3 0.3 -0.6<", "'room'.size[2] is -0.6, it must be above 0"),
    (">0.3 0.3 0.6<", "><", "'room'.size is '', it must be 3 numbers"),
    (">0.3 0.3 0.6<", ">0.3 0.3 0.1<", "begins 0.25 m above"),
    ("<box><size>0.3 0.3 0.6</size></box>", "<cylinder/>", "is a 'cylinder', it must be one box"),
    ("0.6</size></box>", "0.6</size></box></geometry><geometry><cylinder/>", "has 2 shapes"),
    ("Wall_0", "Wall_1", "the boxes enclose no place that the robot fits into")])
def test_a_world_that_is_no_room_is_one_sentence(old, new, words, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    assert old in GOOD
    (tmp_path / "bad.world").write_text(GOOD.replace(old, new))
    with pytest.raises(SceneError, match=f"^scene file 'bad.world': .*{re.escape(words)}") as error:
        scenes.load("bad.world")
    assert len(str(error.value)) < 200 and str(error.value).isprintable()


def test_a_box_that_is_lower_than_the_camera_is_refused():
    text = world(model(links_of(around(("wood", 0.6, 0.6, 0, 0.3, 0.3, 0.2)))))
    with pytest.raises(SceneError, match="'room'.height is 0.2, it must be above 0.281"):
        scenes.parse_world(text, "room")


@pytest.mark.parametrize("content, valid", [
    (GOOD.encode("utf-8-sig"), True), (GOOD.encode("utf-16"), False),
    (GOOD.replace("1.0'", "1.0' encoding='UTF-16'").encode(), True),
    (GOOD.replace("1.0'", "1.0' encoding='x'").replace("Wall", "Wänd").encode(), True),
    (GOOD.replace("Wall", "Wänd").encode("latin-1"), False)])
def test_a_world_is_utf_8_whatever_it_says(content, valid, tmp_path):
    path = tmp_path / "room.world"
    path.write_bytes(content)
    if valid:
        assert len(scenes.load(path).boxes) == 5
    else:
        with pytest.raises(SceneError, match=r"byte \d+ is no UTF-8 text"):
            scenes.load(path)


def test_it_is_said_that_start_and_targets_are_chosen(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "room.world").write_text(GOOD)
    main(["room.world"])
    assert "start and targets: chosen, for the file has none" in capsys.readouterr().out
    main([str(ROOT / "scenes" / "env1.toml")])
    assert "chosen" not in capsys.readouterr().out


def test_a_worlds_name_may_end_in_capitals_and_a_folder_is_no_file(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "room.WORLD").write_text(GOOD)
    assert len(scenes.load("room.WORLD").boxes) == 5
    (tmp_path / "folder.world").mkdir()
    with pytest.raises(SceneError, match="^scene file 'folder.world' is no file$"):
        scenes.load("folder.world")
