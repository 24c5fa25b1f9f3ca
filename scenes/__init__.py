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
"""

import math
import sys
import tomllib
from dataclasses import fields as fields_of
from pathlib import Path

import numpy as np

from sim import ARRIVAL_DISTANCE, CAMERA_HEIGHT, ROBOT_RADIUS, Box, Scene, SceneError

MATERIALS = ("wall", "brick", "wood")  # those that the camera has a texture for
WIDEST = 30  # [m] that a room may measure, our choice
SCENE_FOLDER = Path(__file__).parent


def names():
    """The names of the rooms that come with the project, sorted."""
    return sorted(path.stem for path in SCENE_FOLDER.glob("*.toml"))


def load(name_or_path):
    """The Scene of that name in `scenes/`, or of a scene file's path.

    Raises SceneError, one sentence that names the file and the item, for a file that cannot be read
    and for a room that a robot cannot be run in.
    """
    path = SCENE_FOLDER / f"{name_or_path}.toml"
    if not path.is_file():
        path = Path(name_or_path)
    if not path.is_file() and path.suffix:
        raise SceneError(f"scene file '{name_or_path}' does not exist")
    if not path.is_file():
        raise SceneError(f"unknown scene '{name_or_path}': it must be one of {', '.join(names())}, "
                         "or a scene file's path")
    try:
        table = tomllib.loads(path.read_text(encoding="utf-8"))
        return parse(table, path.stem)
    except OSError as error:
        raise SceneError(f"scene file '{path}' cannot be read: {error.strerror}") from None
    except ValueError as error:  # of the room, of the TOML or of the text's encoding
        raise SceneError(f"scene file '{path}': {error}") from None


def parse(table, name):
    """The Scene of that name that a dict like a scene file's content describes: world coordinates,
    angles in degrees. Raises SceneError."""
    _check_keys(table, ("start", "boxes", "training_targets", "new_targets"), "the scene")
    start = table["start"]
    _check_keys(start, ("x", "y", "heading_degrees"), "start")
    x = _number(start["x"], "start.x")
    y = _number(start["y"], "start.y")
    heading = _number(start["heading_degrees"], "start.heading_degrees")
    return _checked_scene(name, table, (x, y, math.radians(heading)), yaw_key="yaw_degrees")


def rebuild(fields):
    """The Scene that `dataclasses.asdict` made this dict of, as a checkpoint holds it: angles in
    radians, start a list (x, y, heading). Raises SceneError, for a checkpoint is a file too."""
    _check_keys(fields, [field.name for field in fields_of(Scene)], "the scene")
    name = fields["name"]
    _check(isinstance(name, str), f"name is {name!r}, it must be text")
    start = _numbers(fields["start"], 3, "start")
    return _checked_scene(name, fields, start, yaw_key="yaw")


def _checked_scene(name, table, start, yaw_key):
    """The Scene of a table's boxes and targets, checked as a whole."""
    boxes = _entries(table, "boxes", least=1)
    training = _entries(table, "training_targets", least=1)
    new = _entries(table, "new_targets", least=0)  # a room of level 1 has none
    scene = Scene(
        name,
        boxes=tuple(_box(box, f"boxes[{k}]", yaw_key) for k, box in enumerate(boxes)),
        start=start,
        training_targets=tuple(_numbers(target, 2, f"training_targets[{k}]")
                               for k, target in enumerate(training)),
        new_targets=tuple(_numbers(target, 2, f"new_targets[{k}]")
                          for k, target in enumerate(new)))
    widest = np.ptp(scene.bounds, axis=0).max()
    _check(widest <= WIDEST,
           f"the boxes are spread over {widest:.1f} m, it must be at most {WIDEST} m")
    _check(scene.clearance(start[:2]) > ROBOT_RADIUS,
           f"start {start[:2]} is nearer to a box than the robot's {ROBOT_RADIUS} m")
    for k, target in enumerate(scene.training_targets):
        _check_target(scene, target, f"training_targets[{k}] {target}")
    for k, target in enumerate(scene.new_targets):
        what = f"new_targets[{k}] {target}"
        _check_target(scene, target, what)
        _check(target not in scene.training_targets, f"{what} is a training one too")
    return scene


def _check_target(scene, target, what):
    _check(scene.clearance(target) > 0, f"{what} is inside a box")
    away = scene.reachable - target
    nearest = np.hypot(away[:, 0], away[:, 1]).min(initial=np.inf)
    _check(nearest < ARRIVAL_DISTANCE, f"{what} cannot be reached from the start")


def _box(table, what, yaw_key):
    """The Box of a table whose yaw stands under `yaw_degrees`, or under `yaw` [rad]."""
    _check_keys(table, ("material", "x", "y", yaw_key, "length", "thickness", "height"), what)
    material = table["material"]
    _check(material in MATERIALS,
           f"{what}.material is {material!r}, it must be one of {', '.join(MATERIALS)}")
    yaw = _number(table[yaw_key], f"{what}.{yaw_key}")
    if yaw_key == "yaw_degrees":
        yaw = math.radians(yaw)
    return Box(
        material,
        x=_number(table["x"], f"{what}.x"),
        y=_number(table["y"], f"{what}.y"),
        yaw=yaw,
        length=_number(table["length"], f"{what}.length", above=0),
        thickness=_number(table["thickness"], f"{what}.thickness", above=0),
        # The camera draws no tops of boxes, so all of them are higher than the camera.
        height=_number(table["height"], f"{what}.height", above=CAMERA_HEIGHT))


def _check(valid, message):
    if not valid:
        raise SceneError(message)


def _check_keys(table, keys, what):
    """Checks that a table has these keys and no others."""
    _check(isinstance(table, dict), f"{what} is {table!r}, it must be a table")
    for key in keys:
        _check(key in table, f"{what} has no '{key}'")
    for key in table:
        _check(key in keys, f"{what} has an unknown key '{key}'; known: {', '.join(keys)}")


def _entries(table, key, least):
    """The list under a table's key."""
    entries = table[key]
    valid = f"a list with at least {least} entry" if least else "a list"
    _check(isinstance(entries, (list, tuple)) and len(entries) >= least,
           f"{key} is {entries!r}, it must be {valid}")
    return entries


def _numbers(value, count, what):
    """A tuple of so many floats."""
    _check(isinstance(value, (list, tuple)) and len(value) == count,
           f"{what} is {value!r}, it must be a list of {count} numbers")
    return tuple(_number(item, f"{what}[{k}]") for k, item in enumerate(value))


def _number(value, what, above=-math.inf):
    """A finite float above that bound."""
    is_number = isinstance(value, (int, float)) and not isinstance(value, bool)
    _check(is_number and abs(value) <= sys.float_info.max,  # false for nan as well
           f"{what} is {value!r}, it must be a finite number")
    _check(value > above, f"{what} is {value!r}, it must be above {above}")
    return float(value)
