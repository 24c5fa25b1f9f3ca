"""Rooms as data: a scene file, or a dict like it, checked until a robot can drive in the room."""

import math
import tomllib
from dataclasses import fields
from pathlib import Path

import numpy as np

from sim import ARRIVAL_DISTANCE, CAMERA_HEIGHT, ROBOT_RADIUS, Box, Scene, SceneError

MATERIALS = ("wall", "brick", "wood")
SCENE_FOLDER = Path(__file__).parent / "scenes"


def _check(valid, message):
    if not valid:
        raise SceneError(message)


def _number(value, what, low=-math.inf):
    number = isinstance(value, (int, float)) and not isinstance(value, bool)
    _check(number and math.isfinite(value), f"{what} is {value!r}, it must be a finite number")
    _check(value > low, f"{what} is {value!r}, it must be above {low}")
    return float(value)


def _numbers(value, count, what):
    _check(isinstance(value, (list, tuple)) and len(value) == count,
           f"{what} is {value!r}, it must be a list of {count} numbers")
    return tuple(_number(item, f"{what}[{k}]") for k, item in enumerate(value))


def _keys(table, required, what, optional=()):
    _check(isinstance(table, dict), f"{what} is {table!r}, it must be a table")
    for key in required:
        _check(key in table, f"{what} has no '{key}'")
    known = [*required, *optional]
    for key in table:
        _check(key in known, f"{what} has an unknown key '{key}'; known: {', '.join(known)}")


def _parse_box(table, offset, what):
    _keys(table, [field.name for field in fields(Box)], what)
    _check(table["material"] in MATERIALS, f"{what}.material is {table['material']!r}, "
           f"it must be one of {', '.join(MATERIALS)}")
    lows = {"length": 0, "thickness": 0, "height": CAMERA_HEIGHT}  # no box's top is ever seen
    box = {key: _number(value, f"{what}.{key}", lows.get(key, -math.inf))
           for key, value in table.items() if key != "material"}
    return Box(table["material"], **box | {"x": box["x"] + offset[0], "y": box["y"] + offset[1]})


def parse_scene(table, name):
    """The scene that a dict describes, as a scene file or `dataclasses.asdict` of a Scene holds it.
    Raises SceneError for what a robot could not be run in."""
    lists = ("boxes", "training_targets", "new_targets")
    _keys(table, ["start", *lists], "the scene", optional=["offset", "name"])
    for key in lists:
        _check(isinstance(table[key], (list, tuple)) and len(table[key]) > 0,
               f"{key} is {table[key]!r}, it must be a list with at least one entry")
    offset = _numbers(table.get("offset", (0, 0)), 2, "offset")
    boxes = tuple(_parse_box(box, offset, f"boxes[{k}]") for k, box in enumerate(table["boxes"]))
    start = _numbers(table["start"], 3, "start")
    training, new = (tuple(_numbers(xy, 2, f"{key}[{k}]") for k, xy in enumerate(table[key]))
                     for key in lists[1:])
    scene = Scene(name, boxes, start, training, new)
    widest = np.ptp(scene.bounds, axis=0).max()
    _check(widest <= 30, f"the boxes are spread over {widest:.1f} m, it must be at most 30 m")
    _check(scene.clearance(start[:2]) > ROBOT_RADIUS,
           f"start {start[:2]} is nearer to a box than the robot's {ROBOT_RADIUS} m")
    for key, targets in (("training_targets", training), ("new_targets", new)):
        for k, target in enumerate(targets):
            what = f"{key}[{k}] {target}"
            _check(scene.clearance(target) > 0, f"{what} is inside a box")
            _check(np.hypot(*(scene.reachable - target).T).min(initial=np.inf) < ARRIVAL_DISTANCE,
                   f"{what} cannot be reached from the start")
            _check(targets is training or target not in training, f"{what} is a training one too")
    return scene


def load_scene(env):
    """The scene of that name in `scenes/`, or of a TOML file's path. Raises SceneError."""
    path = SCENE_FOLDER / f"{env}.toml"
    path = path if path.is_file() else Path(env)
    if not path.is_file():
        names = ", ".join(sorted(known.stem for known in SCENE_FOLDER.glob("*.toml")))
        raise SceneError(f"unknown env '{env}': it must be one of {names}, or a scene file's path")
    try:
        return parse_scene(tomllib.loads(path.read_text(encoding="utf-8")), path.stem)
    except (SceneError, tomllib.TOMLDecodeError, UnicodeDecodeError) as error:
        raise SceneError(f"scene file '{path}': {error}") from None
