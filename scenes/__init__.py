"""Rooms as data: a TOML file becomes a `sim.Scene`, checked until a robot can drive in the room.

A scene file, e.g. `scenes/env1.toml`, is in world coordinates [m] and in degrees:

    start = { x = -0.4, y = -2.6, heading_degrees = 240 }
    training_targets = [[-3.8, -3.8], [-1.5, -4.0]]
    new_targets = [[-3.0, -2.2]]
    boxes = [
      { material = "wall", x = -4.44, y = -3.115, yaw_degrees = -90, length = 3.0,
        thickness = 0.15, height = 2.5 },
      ...
    ]

A Scene is in metres and radians, as everything else here. `python -m scenes FILE` draws a room.

A Gazebo world, a `.world` file, gives boxes alone (`scenes/world_file.py`). Its start and targets
are chosen (`scenes/places.py`).
"""

import math
import re
import tomllib
from dataclasses import fields as fields_of
from pathlib import Path

import numpy as np

from scenes import neighbours  # before any other of ours: it checks that they are ours
from scenes import generate
from scenes.limits import (LARGEST_FILE, MOST_BOXES, MOST_COVERED, MOST_TARGETS, WIDEST, check,
                           check_name, check_text, number, sentence, shown, shown_path)
from scenes.places import complete
from scenes.reality import parse_reality
from scenes.world_file import read_boxes
from sim import ARRIVAL_DISTANCE, CAMERA_HEIGHT, ROBOT_RADIUS, Box, Scene, SceneError

MATERIALS = ("wall", "brick", "wood")  # those that the camera has a texture for
SCENE_FOLDER = Path(__file__).parent
WORLD = ".world"  # how the names of Gazebo's files end


def names():
    """The names of the rooms that come with the project, sorted."""
    return sorted(path.stem for path in SCENE_FOLDER.glob("*.toml"))


def load(name_or_path):
    """The Scene of that name in `scenes/`, of `random:SEED`, or of the path of a scene file or of a
    Gazebo world.

    Raises SceneError, one sentence that names the file and the item, for a file that cannot be read
    and for a room that a robot cannot be run in. What a file may hold: `scenes/limits.py`.
    """
    if str(name_or_path).startswith(generate.PREFIX):
        return generate.room(generate.seed_of(name_or_path))
    path = Path(name_or_path)
    if str(name_or_path) in names():
        path = SCENE_FOLDER / f"{name_or_path}.toml"
    what = f"scene file {shown_path(path)}"
    try:
        exists = path.is_file()
        check(exists or not path.suffix or not path.exists(), f"{what} is no file")
        check(exists or not path.suffix, f"{what} does not exist")
        check(exists, f"unknown scene {shown_path(name_or_path)}: it must be one of "
                      f"{', '.join(names())}, or a scene file's path")
        text = read(path)
    except OSError as error:
        raise SceneError(f"{what} cannot be read: {error.strerror}") from None
    read_scene = parse_world if is_world(path) else parse
    content = text if is_world(path) else read_toml(text, what)
    try:
        return read_scene(content, path.stem)
    except SceneError as error:
        raise SceneError(sentence(f"{what}: {error}")) from None


def is_world(name_or_path):
    """Whether that names a Gazebo world."""
    return Path(name_or_path).suffix.lower() == WORLD


def remark(name_or_path):
    """What a program says of a room, where there is something to say, else ''."""
    return "start and targets: chosen, for the file has none" if is_world(name_or_path) else ""


def read(path):
    """The text of a file. Raises SceneError, OSError."""
    what = f"scene file {shown_path(path)}"
    with open(path, "rb") as file:
        content = file.read(LARGEST_FILE + 1)
    check(len(content) <= LARGEST_FILE, f"{what} has more than {LARGEST_FILE:,} bytes")
    try:
        return content.decode()
    except UnicodeDecodeError as error:
        raise SceneError(f"{what}: byte {error.start} is no UTF-8 text") from None


def read_toml(text, what):
    """The dict that a TOML file's text holds. what: the file, for messages. Raises SceneError."""
    check_text(text, what)
    try:
        return tomllib.loads(text)
    except tomllib.TOMLDecodeError as error:
        place = re.search(r"line \d+, column \d+", str(error))
        raise SceneError(f"{what} is no valid TOML at {place[0] if place else 'its end'}") from None
    except RecursionError:
        raise SceneError(f"{what} has lists or tables that are nested too deeply") from None
    except ValueError:
        raise SceneError(f"{what} has a number that is too long") from None


def parse_world(text, name):
    """The Scene of that name that a Gazebo world's text describes, with a start and targets of our
    choice. Raises SceneError."""
    check_name(name)
    boxes = tuple(_box(table, what, "yaw") for what, table in read_boxes(text))
    _check_boxes(Scene(name, boxes, (0.0, 0.0, 0.0), (), ()))
    scene = complete(name, boxes)
    _check_targets(scene)
    return scene


def parse(table, name):
    """The Scene of that name that a dict like a scene file's content describes: world coordinates,
    angles in degrees. Raises SceneError."""
    check_name(name)
    _check_keys(table, ("start", "boxes", "training_targets", "new_targets"), "the scene",
                optional=("other_starts", "reality"))
    others = _entries(table, "other_starts", least=0, most=MOST_TARGETS)
    starts = [_pose(table["start"], "start")]
    starts += [_pose(other, f"other_starts[{k}]") for k, other in enumerate(others)]
    return _checked_scene(name, table, starts, yaw_key="yaw_degrees")


def rebuild(fields):
    """The Scene that `dataclasses.asdict` made this dict of, as a checkpoint holds it: angles in
    radians, start a list (x, y, heading). Raises SceneError, for a checkpoint is a file too."""
    *keys, starts, reality = [field.name for field in fields_of(Scene)]
    _check_keys(fields, keys, "the scene", optional=(starts, reality))  # older files lack them
    check_name(fields["name"])
    others = _entries(fields, "other_starts", least=0, most=MOST_TARGETS)
    starts = [_numbers(fields["start"], 3, "start")]
    starts += [_numbers(other, 3, f"other_starts[{k}]") for k, other in enumerate(others)]
    return _checked_scene(fields["name"], fields, starts, yaw_key="yaw")


def _checked_scene(name, table, starts, yaw_key):
    """The Scene of a table's boxes and targets, checked as a whole. starts: its poses."""
    boxes = _entries(table, "boxes", least=1, most=MOST_BOXES)
    training = _entries(table, "training_targets", least=1, most=MOST_TARGETS)
    new = _entries(table, "new_targets", least=0,  # a room of level 1 has none
                   most=MOST_TARGETS - len(training))
    scene = Scene(
        name,
        boxes=tuple(_box(box, f"boxes[{k}]", yaw_key) for k, box in enumerate(boxes)),
        start=starts[0],
        training_targets=tuple(_numbers(target, 2, f"training_targets[{k}]")
                               for k, target in enumerate(training)),
        new_targets=tuple(_numbers(target, 2, f"new_targets[{k}]")
                          for k, target in enumerate(new)),
        other_starts=tuple(starts[1:]),
        reality=parse_reality(table.get("reality"), in_degrees=yaw_key == "yaw_degrees"))
    _check_boxes(scene)
    for start in starts:
        check(scene.clearance(start[:2]) > ROBOT_RADIUS,
              f"start {start[:2]} is nearer to a box than the robot's {ROBOT_RADIUS} m")
    _check_targets(scene)
    return scene


def _check_boxes(scene):
    """Checks what the boxes come to together: the time that a room takes grows with both."""
    widest = np.ptp(scene.bounds, axis=0).max()
    check(widest <= WIDEST,
          f"the boxes are spread over {widest:.1f} m, it must be at most {WIDEST} m")
    covered = sum(np.prod(np.ptp(box.corners, axis=0) + 2 * ROBOT_RADIUS) for box in scene.boxes)
    check(covered <= MOST_COVERED, f"the rectangles around all boxes cover {covered:,.0f} m2 "
                                   f"together, it must be at most {MOST_COVERED:,} m2")


def _check_targets(scene):
    """Checks that no target is in a box, and that all can be driven to."""
    names_of = [f"training_targets[{k}] {target}"
                for k, target in enumerate(scene.training_targets)]
    names_of += [f"new_targets[{k}] {target}" for k, target in enumerate(scene.new_targets)]
    inside = scene.clearance(scene.targets) <= 0
    away = distance_to_reachable(scene, scene.targets, ARRIVAL_DISTANCE)
    for k, what in enumerate(names_of):
        check(not inside[k], f"{what} is inside a box")
        check(away[k] < ARRIVAL_DISTANCE, f"{what} cannot be reached from the start")
    trained = set(scene.training_targets)
    for k, target in enumerate(scene.new_targets):
        check(target not in trained, f"new_targets[{k}] {target} is a training one too")


def distance_to_reachable(scene, points, most):
    """Distance [m] from each of the points (P, 2) to the nearest place that the robot can drive to;
    infinite where that is more than `most` away, or a little less."""
    reachable = scene.reachable  # sorted by x
    nearest = []
    for x, y in points:
        first, last = np.searchsorted(reachable[:, 0], (x - most, x + most))
        dx, dy = reachable[first:last].T - [[x], [y]]
        nearest.append(np.hypot(dx, dy).min(initial=np.inf))
    return np.array(nearest)


def _pose(table, what):
    """The pose of a table, (x [m], y [m], heading [rad])."""
    _check_keys(table, ("x", "y", "heading_degrees"), what)
    x = number(table["x"], f"{what}.x")
    y = number(table["y"], f"{what}.y")
    heading = number(table["heading_degrees"], f"{what}.heading_degrees")
    return x, y, math.radians(heading)


def _box(table, what, yaw_key):
    """The Box of a table whose yaw stands under `yaw_degrees`, or under `yaw` [rad]."""
    _check_keys(table, ("material", "x", "y", yaw_key, "length", "thickness", "height"), what)
    material = table["material"]
    check(isinstance(material, str) and material in MATERIALS,
          f"{what}.material is {shown(material)}, it must be one of {', '.join(MATERIALS)}")
    yaw = number(table[yaw_key], f"{what}.{yaw_key}")
    if yaw_key == "yaw_degrees":
        yaw = math.radians(yaw)
    return Box(
        material,
        x=number(table["x"], f"{what}.x"),
        y=number(table["y"], f"{what}.y"),
        yaw=yaw,
        length=number(table["length"], f"{what}.length", above=0),
        thickness=number(table["thickness"], f"{what}.thickness", above=0),
        # The camera draws no tops of boxes, so all of them are higher than the camera.
        height=number(table["height"], f"{what}.height", above=CAMERA_HEIGHT))


def _check_keys(table, keys, what, optional=()):
    """Checks that a table has these keys, and no others but optional ones."""
    check(isinstance(table, dict), f"{what} is {shown(table)}, it must be a table")
    for key in keys:
        check(key in table, f"{what} has no '{key}'")
    known = (*keys, *optional)
    for key in table:
        check(isinstance(key, str) and key in known,
              f"{what} has an unknown key {shown(key)}; known: {', '.join(known)}")


def _entries(table, key, least, most):
    """The list under a table's key; none where it may be empty and there is no such key."""
    entries = table.get(key, ()) if least == 0 else table[key]
    valid = f"a list with at least {least} entry" if least else "a list"
    check(isinstance(entries, (list, tuple)) and len(entries) >= least,
          f"{key} is {shown(entries)}, it must be {valid}")
    check(len(entries) <= most, f"{key} has {len(entries):,} entries, it may have {most:,}")
    return entries


def _numbers(value, count, what):
    """A tuple of so many floats."""
    check(isinstance(value, (list, tuple)) and len(value) == count,
          f"{what} is {shown(value)}, it must be a list of {count} numbers")
    return tuple(number(item, f"{what}[{k}]") for k, item in enumerate(value))
