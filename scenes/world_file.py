"""Loads Gazebo worlds and models: the solids of an SDF file such as the released simulator's
`env5.world` become the boxes of a room. A solid is a box, cylinder or sphere of a link that the
robot can collide with. A pose in <state> overrides the others, as in Gazebo. If a link occurs
twice, the last one counts. A robot is left out; its place is the start. Poses are (4, 4)."""

import math
import re
from dataclasses import dataclass
from pathlib import Path
from xml.etree import ElementTree
from xml.parsers import expat

import numpy as np

from scenes import check, numbers_in, shown
from scenes.generate import as_scene
from scenes.places import remarks
from sim import CAMERA_HEIGHT, Box, SceneError, wrap_angle

MATERIAL_OF = {"Gazebo/Bricks": "brick", "Gazebo/Wood": "wood"}  # any other or none: wall
WITHOUT_WALLS = ("sun", "ground_plane")  # ends of the names of Gazebo models to leave out
IN_MODEL = ("link", "frame", "model", "joint")  # elements that a pose can be relative to
BASES = ("base_link", "base_footprint")  # names of a robot's first link
DRIVES = ("diff_drive", "diffdrive", "skid_steer", "planar_move", "ackermann", "mecanum")  # plugins
DEEPEST = 8  # models in models, our choice
UPRIGHT = math.radians(1.2)  # [rad] tilts below this count as 0, our choice
ON_FLOOR = 0.01  # [m] the robot drives over what is lower, our choice
OVERHEAD = 0.6  # [m] the robot passes under what begins above this, our choice
LOWEST = 0.3  # [m] what is lower is drawn this high, because the camera draws no tops, our choice
SIDES = 5  # boxes of a round solid, which becomes a decagon: each box joins two opposite sides
# The decagon's corners are as far outside of the circle as the middles of its sides are inside.
CORNER = 2 / (1 + math.cos(math.pi / 10))  # [radii] distance of the corners from the centre


@dataclass
class Solid:
    """A collision box, cylinder or sphere, upright, at its place in the world [m, rad]."""
    what: str  # its name in messages
    material: str
    x: float
    y: float
    yaw: float
    length: float
    thickness: float
    bottom: float
    top: float
    is_round: bool

    @property
    def boxes(self):
        """The Boxes that it consists of, from the floor up: several if it is round."""
        length, thickness = self.length, self.thickness
        turns = [0.0]
        if self.is_round:
            length *= CORNER * math.cos(math.pi / 10)
            thickness *= CORNER * math.sin(math.pi / 10)
            turns = [k * math.pi / SIDES for k in range(SIDES)]
        return [Box(self.material, self.x, self.y, float(wrap_angle(self.yaw + turn)), length,
                    thickness, max(self.top, LOWEST)) for turn in turns]


def boxes_of(text, folder=None, start=None):
    """Returns the Boxes of an SDF file's text, and the start, which is that of a robot in the world
    if None is given. folder: that of the file; included models are looked up in it as
    ../models/NAME/model.sdf. Raises SceneError."""
    root = read_xml(text)
    worlds = root.findall("world") or [root]  # a file may have only a model
    check(root.tag in ("sdf", "gazebo") and len(worlds) == 1, f"it is a {shown(root.tag)} with "
          f"{len(worlds)} worlds; it must be an 'sdf' with one world or a model")
    [world] = worlds
    check(world.find(".//population") is None, "it has a population, whose places are random")
    expand(world, folder)
    for actor in world.iterfind("actor"):
        remarks.warning("actor %s is left out", shown(actor.get("name")))
    deleted = [name.text for name in world.iterfind("state/deletions/name")]
    states = {state.get("name"): state for state in world.iterfind("state/model")}
    solids = []
    robots = []
    for model in [*world.findall("model"), *world.findall("state/insertions/model")]:
        name = model.get("name")
        if name not in deleted:
            solids += solids_of_model(model, pose_in(world, model), states.get(name), robots)
    return in_the_way(solids), start or (robots[0] if robots else None)


def read_xml(text):
    """Returns the root element of an XML text. Raises SceneError. Unlike ElementTree's own parser,
    it accepts tags like <ignition:type>, whose prefix is often not declared."""
    check(text.lstrip().startswith("<"),
          "it is not XML; it must be a Gazebo world or model (a world of Stage is neither)")
    builder = ElementTree.TreeBuilder()
    parser = expat.ParserCreate()
    parser.StartElementHandler = builder.start
    parser.EndElementHandler = builder.end
    parser.CharacterDataHandler = builder.data
    parser.StartDoctypeDeclHandler = lambda *_: check(False, "it has a DOCTYPE, which can define "
                                                             "entities; it must be plain SDF")
    # Unlike XML, Gazebo accepts a comment before the declaration. Lines keep their numbers.
    text = re.sub("<!--.*?-->", lambda comment: "\n" * comment[0].count("\n"), text, flags=re.S)
    try:
        parser.Parse(re.sub(r"^\s*<\?xml.*?\?>", "", text, flags=re.S), True)
    except expat.ExpatError as error:
        raise SceneError(f"it is not valid XML: {error}") from None
    return builder.close()


def expand(parent, folder, depth=0):
    """Replaces all <include> elements in a world or model by the models that they name."""
    check(depth < DEEPEST, f"it includes models in models, more than {DEEPEST} deep")
    for k, child in enumerate(list(parent)):
        if child.tag == "include":
            child = parent[k] = included(child, folder)
        if child.tag == "model":
            expand(child, folder, depth + 1)


def included(include, folder):
    """Returns the model element that an <include> names: an empty one for sun and ground plane."""
    uri = include.findtext("uri", "").strip()
    name = uri.rstrip("/").split("/")[-1]
    if name.lower().replace(" ", "_").endswith(WITHOUT_WALLS):
        return ElementTree.Element("model")
    if uri.startswith("model://"):
        name = uri.removeprefix("model://").strip("/")  # it may be in another model's folder
    path = (folder or Path()) / ".." / "models" / name / "model.sdf"
    is_name = all(part.strip(".") and Path(part).name == part for part in name.split("/"))
    check(folder is not None and is_name and path.is_file(),
          f"it includes {shown(uri)}; its file must be '../models/{name}/model.sdf', seen from the "
          "world's folder")
    model = read_xml(path.read_text("utf-8-sig")).find("model")
    check(model is not None, f"'../models/{name}/model.sdf' has no model")
    model.set("name", include.findtext("name", model.get("name", name)).strip())
    for tag in ("pose", "static", "placement_frame"):
        if include.find(tag) is not None:
            for own in model.findall(tag):
                model.remove(own)
            model.append(include.find(tag))
    return model


def is_robot(model):
    """Returns whether a model can move and has a drive, or two of these: a wheel, a robot's base, a
    joint that turns. Other models in it do not count."""
    names = [part.get("name", "").lower() for part in model if part.tag in ("link", "joint")]
    plugins = [(plugin.get("filename", "") + plugin.get("name", "")).lower()
               for plugin in model.findall("plugin")]
    has_drive = any(drive in plugin for plugin in plugins for drive in DRIVES)
    signs = (any("wheel" in name for name in names), any(name in BASES for name in names),
             any(joint.get("type") != "fixed" for joint in model.findall("joint")))
    is_static = model.findtext("static", "").strip() in ("1", "true")
    return not is_static and (has_drive or sum(signs) >= 2)


def solids_of_model(model, place, state, robots):
    """Returns a list of the Solids of a model and of the models in it. place: its pose in the
    world. state: its <model> in <state>, or None. robots: a list to which the poses (x, y, heading)
    of robots are added; they have no Solids."""
    name = shown(model.get("name"))
    place = stated(state, place)
    if is_robot(model):
        remarks.warning("model %s is a robot: it is left out, and its place is the start", name)
        robots.append((*place[:2, 3].tolist(), math.atan2(place[1, 0], place[0, 0])))
        return []
    if model.find("plugin") is not None:
        remarks.warning("model %s has a plugin, which may move it: here it stands still", name)
    scale = (1.0, 1.0, 1.0)
    moved = {}
    inner = {}
    if state is not None:
        scale = numbers_in(state.findtext("scale", "1 1 1"), 3, f"model {name}.scale")
        moved = {link.get("name"): link for link in state.iterfind("link")}
        inner = {other.get("name"): other for other in state.iterfind("model")}
    solids = []
    links = {link.get("name", k): link for k, link in enumerate(model.findall("link"))}
    for key, link in links.items():
        what = f"link {shown(link.get('name'))} of {name}"
        if link.find("collision") is not None:
            link_place = stated(moved.get(key), place @ pose_in(model, link))
            solids += solids_of_link(link, link_place, scale, what)
    for other in model.iterfind("model"):
        solids += solids_of_model(other, place @ pose_in(model, other),
                                  inner.get(other.get("name")), robots)
    return solids


def solids_of_link(link, place, scale, what):
    """Returns a list of the Solids of a link. place: its pose in the world."""
    # A collision has the material of the visual with the same number, or else of the last one.
    materials = [MATERIAL_OF.get(visual.findtext("material/script/name", "").strip(), "wall")
                 for visual in link.findall("visual")] or ["wall"]
    solids = []
    for k, collision in enumerate(link.findall("collision")):
        shapes = [shape for geometry in collision.findall("geometry") for shape in geometry]
        tags = [shape.tag for shape in shapes]
        if tags in ([], ["empty"], ["plane"]) or is_permeable(collision):
            continue
        check(tags in (["box"], ["cylinder"], ["sphere"]),
              f"{what} is a {shown(' and a '.join(tags))}; it must be a box, cylinder or sphere")
        if tags == ["box"]:
            size = numbers_in(shapes[0].findtext("size"), 3, f"{what}.size")
        else:
            [radius] = numbers_in(shapes[0].findtext("radius"), 1, f"{what}.radius")
            height = 2 * radius
            if tags == ["cylinder"]:
                [height] = numbers_in(shapes[0].findtext("length"), 1, f"{what}.length")
            size = (2 * radius, 2 * radius, height)
            check(scale[0] == scale[1], f"{what} is scaled to an ellipse; x and y must be equal")
        size = tuple(np.multiply(size, scale).tolist())
        check(min(size) >= 0, f"{what}.size is {size}; all of it must be at least 0")
        pose = place @ pose_in(link, collision)
        if tags == ["sphere"]:
            pose[:3, :3] = np.eye(3)  # it has no orientation
        if min(size) == 0 or pose[2, 3] - np.abs(pose[2, :3]) @ size / 2 >= OVERHEAD:
            continue  # nothing, or above the robot however it is tilted
        axis = np.abs(pose[2, :3]).argmax()  # the vertical one of the solid's own axes
        tilt = math.acos(min(abs(pose[2, axis]), 1.0))
        check(tilt < UPRIGHT and (tags != ["cylinder"] or axis == 2),
              f"{what} is tilted; it must be upright, within {math.degrees(UPRIGHT):.1f} degrees")
        along, across = (axis + 1) % 3, (axis + 2) % 3
        x, y, z = pose[:3, 3].tolist()
        yaw = math.atan2(pose[1, along], pose[0, along])
        solids.append(Solid(what, materials[min(k, len(materials) - 1)], x, y, yaw, size[along],
                            size[across], z - size[axis] / 2, z + size[axis] / 2,
                            tags != ["box"]))
    return solids


def is_permeable(collision):
    """Returns whether the robot can drive through a collision."""
    contact = "surface/contact/collide_"
    only_felt = collision.findtext(f"{contact}without_contact", "").strip() in ("1", "true")
    return only_felt or collision.findtext(f"{contact}bitmask", "1").strip() in ("0", "0x0", "0x00")


def in_the_way(solids):
    """Returns the Boxes of all Solids that the robot can collide with."""
    solids = [solid for solid in solids if solid.bottom < OVERHEAD and solid.top > ON_FLOOR]
    check(solids, "no link has a solid that the robot can collide with")
    low, high = as_scene([box for solid in solids for box in solid.boxes]).bounds
    most = np.prod(high - low) / 2  # a low solid with more area is a floor
    solids = [solid for solid in solids
              if solid.top > CAMERA_HEIGHT or solid.length * solid.thickness < most]
    lower = [solid.what for solid in solids if solid.top <= CAMERA_HEIGHT]
    if lower:
        remarks.warning("lower than the camera, but drawn %.1f m high: %s%s", LOWEST,
                        ", ".join(lower[:3]), f" and {len(lower) - 3} more" * (len(lower) > 3))
    check(solids, "it has only a floor")
    return [box for solid in solids for box in solid.boxes]


def pose_in(parent, element):
    """Returns the pose of an element relative to its parent."""
    pose = element.find("pose")
    own = np.eye(4) if pose is None else matrix(pose, shown(element.get("name")))
    base = element.get("attached_to", "")
    if pose is not None:
        base = pose.get("relative_to") or pose.get("frame") or base
    if element.tag == "joint" and not base:
        base = element.findtext("child", "").strip()
    if base not in ("", "world", "__model__") or (base and parent.tag == "link"):
        own = pose_in(parent, named(parent, base)) @ own
    placed = element.get("placement_frame") or element.findtext("placement_frame", "").strip()
    if placed:  # the pose is not that of the model, but of a part of it
        own = own @ np.linalg.inv(pose_in(element, named(element, placed)))
    return own


def named(parent, name):
    """Returns the last element in a world or model that has a name and that poses can refer to."""
    found = [child for child in parent if child.tag in IN_MODEL and child.get("name") == name]
    check(found, f"a pose is relative to {shown(name)}; it must be a link, frame, joint or model "
                 "beside it")
    return found[-1]


def stated(state, otherwise):
    """Returns the pose in an element of <state>, which is in the world; `otherwise` if none."""
    pose = None if state is None else state.find("pose")
    return otherwise if pose is None else matrix(pose, shown(state.get("name")))


def matrix(pose, what):
    """Returns the matrix (4, 4) of a <pose> element: of its position and its roll, pitch, yaw."""
    form = pose.get("rotation_format", "euler_rpy")
    check(form == "euler_rpy", f"the pose of {what} has the rotation_format {shown(form)}; it must "
                               "be euler_rpy")
    *place, roll, pitch, yaw = numbers_in(pose.text or "0 0 0 0 0 0", 6, f"the pose of {what}")
    unit = math.radians(1) if pose.get("degrees") in ("1", "true") else 1.0
    result = np.eye(4)
    for axis, angle in ((2, yaw), (1, pitch), (0, roll)):  # R = Rz Ry Rx
        i, j = (axis + 1) % 3, (axis + 2) % 3
        turn = np.eye(4)
        turn[[i, j], [i, j]] = math.cos(angle * unit)
        turn[i, j] = -math.sin(angle * unit)
        turn[j, i] = math.sin(angle * unit)
        result = result @ turn
    result[:3, 3] = place
    return result
