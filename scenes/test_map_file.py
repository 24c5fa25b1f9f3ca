"""Tests of ROS maps. The oracle is the room that a map is drawn from."""

import cmath
import math
from dataclasses import replace

import numpy as np
import pytest
from PIL import Image

import scenes
from scenes import MOST_BOXES
from scenes.map_file import rectangles
from sim import SceneError

ROOM = scenes.load("env1")
CELL = 0.05  # [m]
UNKNOWN = 205  # grey value of cells that the robot has not seen
YAML = """image: {image}
resolution: {resolution}
origin: {origin}
negate: {negate}
occupied_thresh: 0.65
free_thresh: 0.196
"""


def draw(folder, room=ROOM, turn=0.0, negate=0, **changed):
    """Writes a map of a room, whose axes are turned by an angle [rad], with unknown cells around
    it. Returns the path of the YAML file. changed: other values in it."""
    axes = cmath.exp(1j * turn)
    corners = (room.bounds[[0, 1, 1, 0], 0] + 1j * room.bounds[[0, 0, 1, 1], 1]) / axes
    low = complex(corners.real.min(), corners.imag.min()) - 10 * CELL * (1 + 1j)
    nx, ny = [math.ceil((values.max() - start) / CELL) + 10
              for values, start in ((corners.real, low.real), (corners.imag, low.imag))]
    own = low + CELL * (np.arange(nx)[:, None] + 0.5 + 1j * (np.arange(ny) + 0.5))  # (X, Y)
    place = np.stack([(own * axes).real, (own * axes).imag], -1)
    inside = ((room.bounds[0] < place) & (place < room.bounds[1])).all(-1)
    grey = np.where(room.clearance(place) < 0, 0, np.where(inside, 254, UNKNOWN))
    if negate:
        grey = 255 - grey
    Image.fromarray(grey.astype(np.uint8).T[::-1]).save(folder / "map.pgm")
    origin = [(low * axes).real, (low * axes).imag, turn]
    values = {"image": "map.pgm", "resolution": CELL, "origin": origin, "negate": negate} | changed
    path = folder / "map.yaml"
    path.write_text(YAML.format(**values))
    return path


def test_unknown_cells_are_occupied_also_in_maps_saved_by_ros_2(tmp_path):
    """Their free_thresh is above the value of unknown cells. This room has some in the middle."""
    place = ROOM.reachable[len(ROOM.reachable) // 2]
    hole = scenes.Box("wall", *place.tolist(), 0.0, 0.3, 0.3, 1.0)
    path = draw(tmp_path, replace(ROOM, boxes=(*ROOM.boxes, hole)), image="/elsewhere/map.pgm")
    expected = scenes.load(path)
    grey = np.array(Image.open(tmp_path / "map.pgm"))
    grey[grey == 0] = UNKNOWN
    Image.fromarray(grey).save(tmp_path / "map.pgm")
    path.write_text(path.read_text().replace("0.196", "0.25"))
    assert scenes.load(path) == expected and expected.clearance(place) < 0
    Image.fromarray(grey.astype(np.uint16) * 257).save(tmp_path / "map.png")
    path.write_text(path.read_text().replace("map.pgm", "map.png"))
    assert scenes.load(path) == expected


@pytest.mark.parametrize("turn, negate", [(0.0, 0), (0.0, 1), (-math.pi / 2, 0), (0.4, 0)])
def test_a_map_gives_the_room_that_it_is_drawn_from(turn, negate, tmp_path):
    scene = scenes.load(draw(tmp_path, turn=turn, negate=negate))
    places = ROOM.reachable[::20]
    difference = scene.clearance(places) - ROOM.clearance(places)
    assert np.abs(difference).max() < CELL * math.sqrt(2)
    assert len(scene.boxes) < 300 if turn == 0.4 else len(scene.boxes) < 60


def test_only_the_part_with_the_start_is_used(tmp_path):
    """Two rooms beside each other: the right one is larger."""
    both = scenes.generate.as_scene([
        *scenes.generate.walls(6.0, 3.0),
        scenes.Box("wall", -0.5, 0.0, math.pi / 2, 3.0, 0.15, 2.5)])
    path = draw(tmp_path, both)
    assert (scenes.load(path).targets[:, 0] > -0.5).all()
    scene = scenes.load(f"{path}@-1.5,0,180")
    assert (scene.targets[:, 0] < -0.5).all() and scene.start == (-1.5, 0.0, math.pi)


def test_rectangles_cover_exactly_what_is_around_a_part():
    rng = np.random.default_rng(0)
    part = np.pad(rng.random((30, 40)) < 0.8, 2)
    covered = np.zeros_like(part)
    for left, bottom, right, top in rectangles(part):
        covered[left:right, bottom:top] = True
    assert not (covered & part).any()
    for i, j in np.argwhere(part):
        assert (covered | part)[i - 1:i + 2, j - 1:j + 2].all()


def test_cells_are_merged_if_a_map_has_too_many_details(tmp_path, caplog):
    """A large oblique room: each step of its walls is a box."""
    boxes = [replace(box, x=4 * box.x, y=4 * box.y, length=4 * box.length,
                     thickness=4 * box.thickness) for box in ROOM.boxes]
    room = scenes.generate.as_scene(boxes)
    scene = scenes.load(draw(tmp_path, room, turn=0.4))
    assert len(scene.boxes) <= MOST_BOXES and "its cells are merged to 0.10 m" in caplog.text
    places = 4 * ROOM.reachable[::20]
    difference = room.clearance(places) - scene.clearance(places)
    assert -CELL < difference.min() and difference.max() < 3 * CELL


@pytest.mark.parametrize("changed, words", [
    ({"image": "none.pgm"}, "image 'none.pgm' cannot be used: No such file"),
    ({"image": "map.yaml"}, "image 'map.yaml' cannot be used: unknown format"),
    ({"resolution": 0}, "resolution is 0.0; it must be a number from 0.001"),
    ({"resolution": "!!int ''"}, "resolution is ''; it must be a number from 0.001"),
    ({"origin": "[0, 0]"}, "origin is [0.0, 0.0]; it must be a list of 3 numbers"),
    ({"negate": "0\nmode: raw"}, "mode is 'raw'; it must be one of trinary, scale"),
    ({"negate": "0: 1"}, "it is not valid YAML"),
    ({"negate": 1}, "no cell of 'map.pgm' is free")])
def test_a_map_that_is_not_a_room_gives_one_sentence(changed, words, tmp_path):
    path = draw(tmp_path)
    values = {"image": "map.pgm", "resolution": CELL, "origin": [0, 0, 0], "negate": 0} | changed
    path.write_text(YAML.format(**values))
    if changed == {"negate": 1}:
        Image.new("L", (20, 20), 254).save(tmp_path / "map.pgm")
    with pytest.raises(SceneError, match=words.replace("[", r"\[")):
        scenes.load(path)
