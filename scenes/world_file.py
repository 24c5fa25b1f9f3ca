"""Loads Gazebo worlds: the boxes of an SDF file such as the released simulator's `env5.world`. They
are the collision boxes of all links, except planes, boxes below the floor, and links with sensors.
If a link occurs twice, the last one counts. A pose in <state> overrides the others, as in Gazebo.
A file whose room would differ from Gazebo's is refused."""

import math
from xml.etree import ElementTree

from scenes import MOST_BOXES, box_of, check, check_width, numbers, shown
from scenes.generate import as_scene
from scenes.places import complete
from sim import SceneError, wrap_angle

MATERIAL_OF = {"Gazebo/Bricks": "brick", "Gazebo/Wood": "wood"}  # any other or none: wall
UPRIGHT = 1e-3  # [rad] roll and pitch up to this count as 0, our choice
ON_FLOOR = 0.01  # [m] distances from the floor up to this count as 0, our choice
LEFT_OUT = {"model://sun", "model://ground_plane"}  # Gazebo models without walls


def parse_world(text, name):
    """Returns the Scene of an SDF file's text, with a start and targets chosen by `complete`.
    Raises SceneError."""
    try:
        root = ElementTree.fromstring(text)  # decoded text: its encoding declaration is ignored
    except ElementTree.ParseError as error:
        raise SceneError(f"it is not valid XML: {error}") from None
    worlds = root.findall("world")
    check(root.tag == "sdf" and len(worlds) == 1,
          f"it is a {shown(root.tag)} with {len(worlds)} worlds; it must be an 'sdf' with one")
    [world] = worlds
    for include in world.iter("include"):
        uri = include.findtext("uri", "").strip()
        check(uri in LEFT_OUT, f"it includes {shown(uri)}; it must contain the model itself")
    for path in ("model/model", ".//population/*", ".//insertions/*", ".//deletions/*"):
        check(world.find(path) is None, f"it has {path.strip('./*')}; it must hold only models of "
                                        "links with fixed places")
    models = world.findall("model")
    boxes = [box for model in models for box in boxes_of_model(model, world)]
    check(boxes, "no link has a box on the floor")
    check(len(boxes) <= MOST_BOXES, f"it has {len(boxes)} boxes; it must have at most {MOST_BOXES}")
    check_width(as_scene(boxes))
    return complete(name, boxes)


def boxes_of_model(model, world):
    """Returns a list of the Boxes of a model, at the poses that the world's <state> gives."""
    solid = {key: link for key, link in last_statements(model).items()
             if link.find("collision") is not None and link.find("sensor") is None}
    if not solid:
        return []
    name = shown(model.get("name"))
    place = pose_of(model, f"model {name}")
    stated = {}
    for state in world.findall("state/model"):
        if state.get("name") == model.get("name"):
            scale = read_numbers(state.findtext("scale", "1 1 1"), 3, f"model {name}.scale")
            check(scale == (1, 1, 1), f"model {name} has the scale {scale}; it must be 1 1 1")
            place = pose_of(state, f"model {name} in <state>", place)
            stated |= last_statements(state)
    boxes = []
    for key, link in solid.items():
        what = f"link {shown(link.get('name'))} of {name}"
        pose = compose(place, pose_of(link, what))
        if key in stated:  # a pose in the world, not in the model
            pose = pose_of(stated[key], f"{what} in <state>", pose)
        boxes += boxes_of_link(link, pose, what)
    return boxes


def last_statements(model):
    """Returns a dict of the links of a model by name, or by number if unnamed. The last wins."""
    return {link.get("name", k): link for k, link in enumerate(model.findall("link"))}


def boxes_of_link(link, place, what):
    """Returns a list of the Boxes of a link. place: its pose in the world."""
    # A collision has the material of the visual with the same number, or else of the last one.
    materials = [MATERIAL_OF.get(visual.findtext("material/script/name", "").strip(), "wall")
                 for visual in link.findall("visual")] or ["wall"]
    boxes = []
    for k, collision in enumerate(link.findall("collision")):
        shapes = [shape for geometry in collision.findall("geometry") for shape in geometry]
        tags = [shape.tag for shape in shapes]
        if tags in ([], ["empty"], ["plane"]):
            continue
        check(tags == ["box"], f"{what} is a {shown(' and a '.join(tags))}; it must be one box")
        length, thickness, height = read_numbers(shapes[0].findtext("size"), 3, f"{what}.size")
        check(height > 0, f"{what}.height is {height}; it must be above 0")
        x, y, z, yaw = compose(place, pose_of(collision, what))
        if z + height / 2 <= ON_FLOOR:
            continue
        bottom = z - height / 2
        check(abs(bottom) <= ON_FLOOR,
              f"{what} begins {bottom:.2f} m above the floor; it must be on it")
        table = dict(material=materials[min(k, len(materials) - 1)], x=x, y=y,
                     yaw=float(wrap_angle(yaw)), length=length, thickness=thickness, height=height)
        boxes.append(box_of(table, what, in_degrees=False))
    return boxes


def pose_of(element, what, otherwise=(0.0, 0.0, 0.0, 0.0)):
    """Returns the pose (x, y, z, yaw) [m, rad] of an upright element; `otherwise` by default."""
    pose = element.find("pose")
    if pose is None:
        return otherwise
    unusual = {key: value for key, value in pose.items()
               if value not in ("", "false", "0", "euler_rpy")}
    check(not unusual, f"{what}.pose has {shown(unusual)}; it must be in radians, without a frame")
    x, y, z, roll, pitch, yaw = read_numbers(pose.text, 6, f"{what}.pose")
    check(max(abs(roll), abs(pitch)) <= UPRIGHT,
          f"{what} has roll {roll:g} and pitch {pitch:g}; both must be 0")
    return x, y, z, yaw


def compose(outer, inner):
    """Returns the world pose (x, y, z, yaw) of a pose `inner` given relative to `outer`."""
    x, y, z, yaw = inner
    c = math.cos(outer[3])
    s = math.sin(outer[3])
    return (outer[0] + c * x - s * y, outer[1] + s * x + c * y, outer[2] + z, outer[3] + yaw)


def read_numbers(text, count, what):
    """Returns the `count` numbers in a text, separated by spaces, as a tuple of floats."""
    try:
        values = [float(word) for word in (text or "").split()]
    except ValueError:
        values = text
    return numbers(values, what, count)
