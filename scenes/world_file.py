"""Gazebo's worlds as rooms: the boxes of an SDF file such as the released simulator's `env5.world`.

    <sdf version="1.6">
      <world name="default">
        <model name="env5">
          <pose>-2 -3 0 0 0 0</pose>                          in the world
          <link name="Wall_0">
            <pose>0 1.425 0 0 0 3.14159</pose>                in the model
            <collision name="Wall_0_Collision">
              <pose>0 0 1.25 0 0 0</pose>                     in the link
              <geometry><box><size>5 0.15 2.5</size></box></geometry>
            </collision>
            <visual name="Wall_0_Visual"> ... <material><script><name>Gazebo/Grey ...

A pose is x y z roll pitch yaw [m, rad]. What counts:

- The collisions of all links of all models are the room. What has none (lights, cameras, things
  that are only seen) is left out; so are planes, boxes in the floor, and links with sensors.
- A link that is stated twice is what its second statement says, where its first one stands.
- Where a <state> gives a link's pose in the world, this is what Gazebo shows, and it counts. Where
  it gives only the model's, it counts for that, and so does the link's own pose in the model.
- A collision's material is that of the visual of the same number, or of the last one. Ceiling tiles
  and grey are `wall`, bricks `brick` and wood `wood`. Any other, or none, becomes `wall`.

What would be another room than Gazebo's is refused: rotated out of the upright, off the floor,
other shapes than boxes, models in other files or in models, poses in other frames, scaled models.
"""

import math
import re
from collections import defaultdict
from xml.etree import ElementTree

from scenes.limits import DEEPEST, MOST_BOXES, MOST_ELEMENTS, check, number, shown
from sim import SceneError, wrap_angle

MATERIAL_OF = {"Gazebo/CeilingTiled": "wall", "Gazebo/Grey": "wall", "Gazebo/Bricks": "brick",
               "Gazebo/Wood": "wood"}
UPRIGHT = 1e-3  # [rad] of roll and pitch that is none, our choice
ON_FLOOR = 0.01  # [m] below or above the floor that is none, our choice
LEFT_OUT = {"model://sun", "model://ground_plane"}  # of Gazebo's own models, those that are no room
NO_NUMBER = re.compile(r"[^-+.0-9eE]")  # float() takes more: inf, 1_000, digits of any script
NO_POSE = (0.0, 0.0, 0.0, 0.0)


class Builder(ElementTree.TreeBuilder):
    """A tree of elements that stays small, and that no document type can make larger."""

    def __init__(self):
        super().__init__()
        self.count = 0
        self.depth = 0

    def doctype(self, name, public, system):
        """Refuses the declaration that entities would come with, before any of them is read."""
        raise SceneError("it has a document type (DOCTYPE), it must have none")

    def start(self, tag, attributes):
        """An element begins."""
        self.count += 1
        self.depth += 1
        check(self.count <= MOST_ELEMENTS, f"it has more than {MOST_ELEMENTS:,} elements")
        check(self.depth <= DEEPEST, f"its elements are nested more than {DEEPEST} deep")
        return super().start(tag, attributes)

    def end(self, tag):
        """An element ends."""
        self.depth -= 1
        return super().end(tag)


def read_boxes(text):
    """The boxes of an SDF file's text, a list of (what, table): what messages call it, and a table
    like that of a box in a scene file, but with its `yaw` in radians. Raises SceneError."""
    world = read_world(text)
    _check_elsewhere(world)
    states = defaultdict(list)
    for state in world.findall("state/model"):
        states[state.get("name")].append(state)
    boxes = []
    named = set()
    for model in world.findall("model"):
        name = model.get("name")
        own = _boxes_of(model, states[name])
        if own:
            check(name not in named, f"two models with boxes have the name {shown(name)}")
            named.add(name)
        boxes += own
        check(len(boxes) <= MOST_BOXES, f"it has more than {MOST_BOXES} boxes")
    check(boxes, "no link has a box that stands on the floor")
    return boxes


def read_world(text):
    """The element <world> of an SDF file's text."""
    parser = ElementTree.XMLParser(target=Builder())
    try:
        parser.feed(text)  # text, not bytes: whatever encoding it names is passed over
        root = parser.close()
    except ElementTree.ParseError as error:
        line, column = error.position
        raise SceneError(f"it is no valid XML at line {line}, column {column + 1}") from None
    check(root.tag == "sdf", f"it is a {shown(root.tag)}, it must be an 'sdf'")
    worlds = root.findall("world")
    check(len(worlds) == 1, f"it has {len(worlds)} worlds, it must have one")
    return worlds[0]


def _check_elsewhere(world):
    """Refuses what the room would lack: models that stand in files of their own, in one another, or
    that Gazebo makes or takes away by itself."""
    for include in world.iter("include"):
        uri = (include.findtext("uri") or "").strip()
        check(uri in LEFT_OUT, f"it includes {shown(uri)}, it must hold the model itself")
    for model in world.findall("model"):
        check(model.find("model") is None, f"model {shown(model.get('name'))} holds another model, "
                                           "it must hold links alone")
    for tag in ("population", "insertions", "deletions"):
        check(not any(len(element) for element in world.iter(tag)),
              f"it has {tag}, it must hold each model where it stands")


def _boxes_of(model, states):
    """The boxes of a model, as read_boxes returns them. states: the elements of <state> that are
    about it."""
    solid = {key: link for key, link in last_statements(model).items() if is_solid(link)}
    if not solid:
        return []
    model_name = shown(model.get("name"))
    what = f"model {model_name}"
    place = pose_of(model, what)
    links = {}
    for state in states:
        check(numbers(state.findtext("scale", "1 1 1"), 3, f"{what}.scale") == [1.0] * 3,
              f"{what} is scaled in <state>, it must have its true size and the scale 1 1 1")
        place = pose_of(state, f"{what} in <state>", place)
        links |= last_statements(state)
    boxes = []
    for key, link in solid.items():
        what = f"link {shown(link.get('name'))} of {model_name}"
        pose = compose(place, pose_of(link, what))
        if key in links:
            pose = pose_of(links[key], f"{what} in <state>", pose)
        boxes += boxes_of_link(link, pose, what)
    return boxes


def boxes_of_link(link, place, what):
    """The boxes of a link at a place in the world, as read_boxes returns them."""
    materials = [MATERIAL_OF.get((visual.findtext("material/script/name") or "").strip(), "wall")
                 for visual in link.findall("visual")] or ["wall"]
    collisions = link.findall("collision")
    boxes = []
    for k, collision in enumerate(collisions):
        called = what if len(collisions) == 1 else f"collision {k + 1} of {what}"
        box = read_box(collision, place, called)
        if box is not None:
            boxes.append((called, dict(material=materials[min(k, len(materials) - 1)], **box)))
    return boxes


def last_statements(model):
    """The links of a model by name: where the first of a name stands, what the last one says. Those
    without a name, which Gazebo refuses, are by their place."""
    return {link.get("name", k): link for k, link in enumerate(model.findall("link"))}


def is_solid(link):
    """Whether a robot may run into a link that is a part of the room."""
    return link.find("collision") is not None and link.find("sensor") is None


def read_box(collision, place, what):
    """The pose and size of a collision, those of a scene file's box; None where it is the floor.
    place: its link's pose in the world."""
    shapes = [shape.tag for geometry in collision.findall("geometry") for shape in geometry]
    if shapes in ([], ["empty"]):
        return None
    geometry = collision.find("geometry")
    if shapes == ["plane"]:
        normal = numbers(geometry.findtext("plane/normal", "0 0 1"), 3, f"{what}.normal")
        check(normal[:2] == [0, 0], f"{what} is a plane that is no floor, its normal must be 0 0 1")
        return None
    check(len(shapes) == 1, f"{what} has {len(shapes)} shapes, it must have one")
    check(shapes == ["box"], f"{what} is a {shown(shapes[0])}, it must be one box")
    size = geometry.findtext("box/size", "")
    length, thickness, height = numbers(size, 3, f"{what}.size", above=0)
    x, y, z, yaw = compose(place, pose_of(collision, what))
    if z + height / 2 <= ON_FLOOR:
        return None
    bottom = z - height / 2
    check(abs(bottom) <= ON_FLOOR, f"{what} begins {bottom:.2f} m above the floor, it must stand "
                                   "on it")
    return dict(x=x, y=y, yaw=float(wrap_angle(yaw)), length=length, thickness=thickness,
                height=height)


def pose_of(element, what, otherwise=NO_POSE):
    """The upright pose (x, y, z, yaw) [m, rad] that an element states, or another one where it
    states none."""
    poses = element.findall("pose")
    if not poses:
        return otherwise
    check(len(poses) == 1, f"{what} has {len(poses)} poses, it must have one")
    [pose] = poses
    for attribute in ("degrees", "rotation_format"):
        check(pose.get(attribute, "false") in ("false", "0", "euler_rpy"),
              f"{what}.pose is not in radians, it must be roll, pitch and yaw in radians")
    for frame in (pose.get("frame"), pose.get("relative_to")):
        check(not frame, f"{what}.pose is in the frame {shown(frame)}, it must name none")
    x, y, z, roll, pitch, yaw = numbers(pose.text, 6, f"{what}.pose")
    check(max(abs(roll), abs(pitch)) <= UPRIGHT,
          f"{what} has roll {roll:g} and pitch {pitch:g}, both must be 0")
    return x, y, z, yaw


def compose(outer, inner):
    """The pose (x, y, z, yaw) in the world of what has the pose `inner` in a thing at `outer`."""
    x, y, z, yaw = outer
    inner_x, inner_y, inner_z, inner_yaw = inner
    c = math.cos(yaw)
    s = math.sin(yaw)
    return (x + c * inner_x - s * inner_y, y + s * inner_x + c * inner_y, z + inner_z,
            yaw + inner_yaw)


def numbers(text, count, what, above=-math.inf):
    """So many floats that stand in a text, parted by spaces, each above a bound."""
    words = (text or "").split()
    check(len(words) == count, f"{what} is {shown(text)}, it must be {count} numbers")
    return [number(as_float(word), f"{what}[{k}]", above) for k, word in enumerate(words)]


def as_float(word):
    """The float that a word writes, or the word."""
    try:
        return word if NO_NUMBER.search(word) else float(word)
    except ValueError:
        return word
