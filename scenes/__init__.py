"""Loads rooms: a TOML file such as `scenes/env1.toml`, a Gazebo world or a ROS map becomes a
`sim.Scene` (docs/rooms.md). TOML files are in metres and degrees, Scenes in metres and radians, all
in world coordinates."""

import json
import math
import os
import reprlib
import tomllib
from pathlib import Path

import numpy as np

from scenes import generate
from scenes.places import complete, remarks
from sim import ARRIVAL_DISTANCE, CAMERA_HEIGHT, ROBOT_RADIUS, Box, Scene, SceneError

MATERIALS = ("wall", "brick", "wood")  # the camera has a texture for each
SCENE_FOLDER = Path(__file__).parent
WORLDS = (".world", ".sdf")  # suffixes of Gazebo worlds and models
MAPS = (".yaml", ".yml")  # suffixes of ROS maps
# Limits, our choice: in a huge room everything takes minutes.
MOST_BOXES = 512
MOST_TARGETS = 1024
WIDEST = 60  # [m]
LARGEST = 10 ** 6  # [m] or [degrees]
SHORT = reprlib.Repr()
SHORT.maxlevel = 1
shown = SHORT.repr  # formats a value for a message: one line, shortened if long or nested


def names():
    """Returns the names of the rooms in this folder, sorted."""
    return sorted(path.stem for path in SCENE_FOLDER.glob("*.toml"))


def load(name_or_path):
    """Returns the Scene for a name in `scenes/`, for `random:SEED`, or for a file: TOML, a Gazebo
    world or a ROS map. Worlds and maps have no start: `FILE@x,y,degrees` chooses one. Raises
    SceneError with one sentence that names the file and the item."""
    name = str(name_or_path)
    if name.startswith(generate.PREFIX):
        return generate.room(generate.seed_of(name))
    path = SCENE_FOLDER / f"{name}.toml" if name in names() else Path(name)
    start = ""
    if "@" in path.name and not path.exists():
        file, start = name.rsplit("@", 1)
        path = Path(file)
    check(path.suffix or os.path.isfile(path), f"unknown scene {shown(name)}: it must be one of "
          f"{', '.join(names())}, random:SEED, or the path of a room's file")
    try:
        text = path.read_text("utf-8-sig")  # some editors write a byte order mark first
    except (OSError, ValueError) as error:
        reason = getattr(error, "strerror", None) or error
        raise SceneError(f"room file {str(path)!r} cannot be used: {reason}") from None
    return read(text, path, path.parent, start)


def read(text, path, folder=None, start=""):
    """Returns the Scene described by the text of a room's file. The format is that of the path's
    suffix; otherwise the path is only a name. folder: that of the path, in which other files are
    looked up; None if there are none. start: `x,y,degrees`, or "". Raises SceneError."""
    suffix = path.suffix.lower()
    try:
        if suffix in (*WORLDS, *MAPS):
            if suffix in WORLDS:
                from scenes.world_file import boxes_of
            else:
                from scenes.map_file import boxes_of
            return with_targets(path.stem, *boxes_of(text, folder, start_of(start)), bool(start))
        check(suffix == ".toml", f"its name must end in .toml, {', '.join(WORLDS)} (Gazebo) or "
              f"{', '.join(MAPS)} (a ROS map)")
        check(not start, "it has its own start, so '@' cannot choose one")
        try:
            table = tomllib.loads(text)
        except tomllib.TOMLDecodeError as error:
            raise SceneError(f"it is not valid TOML: {error}") from None
        return parse(table, path.stem)
    except RecursionError:
        raise SceneError(f"room file {str(path)!r} cannot be used: its parts are nested too "
                         "deeply, or each is placed relative to another") from None
    except (ValueError, OSError) as error:  # SceneErrors are ValueErrors
        raise SceneError(f"room file {str(path)!r} cannot be used: {error}") from None


def with_targets(name, boxes, pose, is_chosen):
    """Returns the Scene of a world or map, with chosen targets. pose: the start, or None to choose
    one. is_chosen: whether a user gave it; otherwise it is a robot's, and may be unusable."""
    check_size(generate.as_scene(boxes))
    try:
        scene = complete(name, boxes, pose)
    except SceneError as error:
        if is_chosen or not pose:
            raise
        remarks.warning("%s: the robot's place is not the start", error)
        scene = complete(name, boxes)
    check_size(scene)  # a fence counts
    remarks.warning("the targets of room %r are chosen: its file has none", scene.name)
    return scene


def start_of(text):
    """Returns the pose (x [m], y [m], heading [rad]) in a text `x,y,degrees`; None if empty."""
    if not text:
        return None
    x, y, degrees = numbers_in(text.replace(",", " "), 3, "the start after '@'")
    return x, y, math.radians(degrees)


def to_toml(scene):
    """Returns the text of a scene file for a Scene. Positions are rounded to millimetres, angles to
    hundredths of a degree."""
    def pose(start):
        x, y, heading = start
        return f"{{ x = {x:.3f}, y = {y:.3f}, heading_degrees = {math.degrees(heading):.2f} }}"

    def places(targets):
        return ", ".join(f"[{x:.3f}, {y:.3f}]" for x, y in targets)

    boxes = [f'  {{ material = "{box.material}", x = {box.x:.3f}, y = {box.y:.3f}, '
             f"yaw_degrees = {math.degrees(box.yaw):.2f}, length = {box.length:.3f}, "
             f"thickness = {box.thickness:.3f}, height = {box.height:.3f} }},"
             for box in scene.boxes]
    reality = []
    if scene.reality:
        from scenes.reality import ANGLES
        values = {f"{name}_degrees" if name in ANGLES else name:
                  math.degrees(value) if name in ANGLES else value
                  for name, value in vars(scene.reality).items()}
        reality = ["[reality]", *(f"{name} = {json.dumps(value)}"
                                  for name, value in values.items()), ""]
    return "\n".join([f"start = {pose(scene.start)}",
                      f"other_starts = [{', '.join(map(pose, scene.other_starts))}]",
                      f"training_targets = [{places(scene.training_targets)}]",
                      f"new_targets = [{places(scene.new_targets)}]",
                      "boxes = [", *boxes, "]", "", *reality])


def rebuild(fields):
    """Returns a Scene from its `dataclasses.asdict`, the form in weights files: in radians, starts
    as (x, y, heading). Raises SceneError, KeyError or TypeError."""
    name = fields["name"]
    valid = isinstance(name, str) and name.isprintable() and name.strip(".")
    check(valid and Path(name).name == name,  # it becomes part of file names
          f"name is {shown(name)}; it must be printable and contain no folder")
    return parse({key: fields[key] for key in fields if key != "name"}, name, in_degrees=False)


def parse(table, name, in_degrees=True):
    """Returns the Scene described by the content of a scene file, with angles in degrees or in
    radians. Raises SceneError."""
    check_keys(table, ("start", "boxes", "training_targets", "new_targets"), "the scene",
               optional=("other_starts", "reality"))
    reality = table.get("reality")
    if reality is not None:
        from scenes.reality import parse_reality
        reality = parse_reality(reality, in_degrees)
    scene = Scene(
        name,
        boxes=each(table, "boxes", 1, MOST_BOXES, box_of, in_degrees),
        start=pose_of(table["start"], "start", in_degrees),
        training_targets=each(table, "training_targets", 1, MOST_TARGETS, numbers, 2),
        new_targets=each(table, "new_targets", 0, MOST_TARGETS, numbers, 2),
        other_starts=each(table, "other_starts", 0, MOST_TARGETS, pose_of, in_degrees),
        reality=reality)
    check_size(scene)
    for start in (scene.start, *scene.other_starts):
        check(scene.clearance(start[:2]) > ROBOT_RADIUS,
              f"start {start[:2]} is nearer to a box than the robot's radius, {ROBOT_RADIUS} m")
        check(scene.fits(start), f"start {start[:2]} is outside the room")
    for kind in ("training_targets", "new_targets"):
        for k, target in enumerate(getattr(scene, kind)):
            [away] = distance_to_nearest([target], scene.reachable)
            check(away < ARRIVAL_DISTANCE, f"{kind}[{k}] {target} cannot be reached from the start")
    for target in scene.new_targets:
        check(target not in scene.training_targets, f"{target} is a training and a new target")
    return scene


def each(table, key, least, most, read_entry, argument):
    """Returns a tuple: the list under a key with read_entry applied to each entry."""
    entries = table.get(key, ())
    check(isinstance(entries, (list, tuple)) and least <= len(entries) <= most,
          f"{key} is {shown(entries)}; it must be a list of {least} to {most:,} entries")
    return tuple(read_entry(entry, f"{key}[{k}]", argument) for k, entry in enumerate(entries))


def box_of(table, what, in_degrees):
    """Returns the Box in a table. what: its name in messages, here and in the functions below."""
    keys = ("x", "y", "yaw_degrees" if in_degrees else "yaw", "length", "thickness", "height")
    check_keys(table, ("material", *keys), what)
    material = table["material"]
    check(material in MATERIALS, f"{what}.material is {shown(material)}; it must be one of "
                                 f"{', '.join(MATERIALS)}")
    x, y, yaw, *size = [number(table[key], f"{what}.{key}") for key in keys]
    # The camera does not draw the tops of boxes, so all boxes must be higher than the camera.
    for key, low in (("length", 0), ("thickness", 0), ("height", CAMERA_HEIGHT)):
        check(table[key] > low, f"{what}.{key} is {table[key]}; it must be above {low}")
    return Box(material, x, y, math.radians(yaw) if in_degrees else yaw, *size)


def pose_of(value, what, in_degrees):
    """Returns a pose (x [m], y [m], heading [rad]) from a table in degrees or a list in radians."""
    if not in_degrees:
        return numbers(value, what, 3)
    keys = ("x", "y", "heading_degrees")
    check_keys(value, keys, what)
    x, y, heading = [number(value[key], f"{what}.{key}") for key in keys]
    return x, y, math.radians(heading)


def numbers(value, what, count, *limits):
    """Returns a list of `count` numbers, each within the limits, as a tuple of floats."""
    check(isinstance(value, (list, tuple)) and len(value) == count,
          f"{what} is {shown(value)}; it must be a list of {count} numbers")
    return tuple(number(item, f"{what}[{k}]", *limits) for k, item in enumerate(value))


def numbers_in(text, count, what):
    """Returns the `count` numbers in a text, separated by spaces, as a tuple of floats."""
    try:
        values = [float(word) for word in (text or "").split()]
    except ValueError:
        values = text
    return numbers(values, what, count)


def number(value, what, low=-LARGEST, high=LARGEST):
    """Returns a number from low to high as a float."""
    is_number = isinstance(value, (int, float)) and not isinstance(value, bool)
    check(is_number and low <= value <= high,  # false for nan as well
          f"{what} is {shown(value)}; it must be a number from {low:.7g} to {high:.7g}")
    return float(value)


def check_keys(table, keys, what, optional=()):
    """Checks that a table has all these keys, and no others except the optional ones."""
    check(isinstance(table, dict), f"{what} is {shown(table)}; it must be a table")
    for key in keys:
        check(key in table, f"{what} has no '{key}'")
    known = (*keys, *optional)
    for key in table:
        check(key in known, f"{what} has an unknown key {shown(key)}; known: {', '.join(known)}")


def check_size(scene):
    """Checks the number of boxes and the extent of all boxes together."""
    check(len(scene.boxes) <= MOST_BOXES,
          f"it has {len(scene.boxes)} boxes; it must have at most {MOST_BOXES}")
    widest = np.ptp(scene.bounds, axis=0).max()
    check(widest <= WIDEST,
          f"the boxes extend over {widest:.2f} m; it must be at most {WIDEST} m")


def distance_to_nearest(points, others):
    """Returns the distance [m] from each of the points (P, 2) to the nearest of others (n, 2)."""
    return np.array([np.hypot(*np.subtract(others, point).T).min() for point in points])


def check(valid, message):
    """Raises SceneError with this message unless `valid` is true."""
    if not valid:
        raise SceneError(message)
