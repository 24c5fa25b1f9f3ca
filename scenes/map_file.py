"""Loads ROS maps: a YAML file and the image that it names. The cells that are not known to be
free become boxes, merged into rectangles. Axis letters: X, Y cells of the map."""

import math

import numpy as np

from scenes import MOST_BOXES, check, number, numbers, shown
from scenes.places import parts, remarks
from sim import Box, SceneError

HEIGHT = 2.5  # [m] of walls, as in the released rooms
MOST_CELLS = 4000 ** 2  # of the image, our choice
WALL = 3  # [cells] thickness of walls around the room, at most
KEYS = ("image", "resolution", "origin", "negate", "occupied_thresh", "free_thresh")
MODES = ("trinary", "scale")  # in both, a cell is free below free_thresh
UNKNOWN = 205  # grey value of unknown cells in saved maps, also if free_thresh is too high for it
AROUND = [(i, j) for i in (-1, 0, 1) for j in (-1, 0, 1)]


def boxes_of(text, folder, start=None):
    """Returns the Boxes of a map's YAML text around its largest free part, or around the part with
    the start, and the start. folder: that of its image, or None. Raises SceneError."""
    check(folder is not None, "its image is another file: give its path to --env")
    table = read_yaml(text)
    mode = table.get("mode", "trinary")
    check(mode in MODES, f"mode is {shown(mode)}; it must be one of {', '.join(MODES)}")
    negate = str(table["negate"]).lower()
    check(negate in ("0", "1", "false", "true"), f"negate is {shown(negate)}; it must be 0 or 1")
    resolution = number(value(table["resolution"]), "resolution", 0.001, 1.0)
    x, y, yaw = numbers(value(table["origin"]), "origin", 3)
    number(value(table["occupied_thresh"]), "occupied_thresh", 0, 1)  # unknown is occupied too
    grey = read_image(folder, table["image"])  # (X, Y), 255 is white
    occupancy = (grey if negate in ("1", "true") else 255 - grey) / 255
    free = occupancy < number(value(table["free_thresh"]), "free_thresh", 0, 1)
    if mode == "trinary":
        free &= grey != UNKNOWN
    check(free.any(), f"no cell of {shown(table['image'])} is free")
    turn = np.exp(1j * yaw)
    seed = None
    if start:
        own = (complex(*start[:2]) - complex(x, y)) / turn / resolution  # [cells] in the map's axes
        seed = math.floor(own.real), math.floor(own.imag)
        inside = all(0 <= k < n for k, n in zip(seed, free.shape))
        check(inside and free[seed], f"start {start[:2]} is not on a free cell of the map")
    boxes = []
    for left, bottom, right, top in merged(free, seed, resolution):
        centre = complex(x, y) + complex(left + right, bottom + top) / 2 * resolution * turn
        boxes.append(Box("wall", centre.real, centre.imag, yaw, float(right - left) * resolution,
                         float(top - bottom) * resolution, HEIGHT))
    return boxes, start


def read_yaml(text):
    """Returns the keys of a map's YAML text and their values, which are texts or lists of texts."""
    try:
        import yaml
        table = yaml.load(text, yaml.BaseLoader)  # as texts, because 5e-2 is not a number in YAML
    except ModuleNotFoundError:
        raise SceneError("PyYAML is missing: pip install -r scenes/requirements.txt") from None
    except yaml.YAMLError as error:
        raise SceneError(f"it is not valid YAML: {str(error).splitlines()[0]}") from None
    check(isinstance(table, dict), f"the map is {shown(table)}; it must be a table")
    for key in KEYS:  # ROS ignores others
        check(key in table, f"the map has no '{key}'")
    return table


def value(text):
    """Returns the number in a text, or the numbers in a list of texts; other texts unchanged."""
    if isinstance(text, list):
        return [value(item) for item in text]
    try:
        return float(text)
    except (TypeError, ValueError):
        return text


def read_image(folder, name):
    """Returns the grey values (X, Y) of an image, from 0 (black) to 255; y points up."""
    from PIL import Image  # a package that matplotlib needs
    path = folder / str(name)
    if not path.is_file():
        path = folder / path.name  # the map was saved on another machine
    try:
        with Image.open(path) as image:
            check(image.width * image.height <= MOST_CELLS,
                  f"{shown(name)} has {image.width} x {image.height} cells; it must have at most "
                  f"{MOST_CELLS:,}")
            if image.mode.startswith("I"):  # 16 bits
                return np.round(np.asarray(image)[::-1].T / 257)
            return np.asarray(image.convert("L"))[::-1].T
    except (OSError, Image.DecompressionBombError) as error:  # OSError: also of an unknown format
        reason = getattr(error, "strerror", None) or "unknown format or too large"
        raise SceneError(f"image {shown(name)} cannot be used: {reason}") from None


def merged(free, seed, resolution):
    """Returns rectangles (left, bottom, right, top) [cells] around one connected part of the free
    cells: the largest, or the one with the cell `seed`. If there are too many rectangles, cells are
    merged into larger ones, which count as free if all of them are."""
    for size in range(1, min(free.shape) + 1):
        coarse = np.pad(free, [(0, -n % size) for n in free.shape])
        coarse = coarse.reshape(len(coarse) // size, size, -1, size).all((1, 3))
        if not coarse.any():
            break
        part = parts(coarse)
        if seed:
            here = part[seed[0] // size, seed[1] // size]
            check(here >= 0, f"its cells are merged to {size * resolution:.2f} m, and the one with "
                  "the start is then not free; it must be farther from the walls")
        else:
            here = np.bincount(part[part >= 0]).argmax()
        inside = part == here
        x, y = [np.flatnonzero(inside.any(axis)) for axis in (1, 0)]
        inside = np.pad(inside[x[0]:x[-1] + 1, y[0]:y[-1] + 1], WALL)
        found = rectangles(inside)
        if len(found) <= MOST_BOXES:
            if size > 1:
                remarks.warning("the map has many details: its cells are merged to %.2f m",
                                size * resolution)
            return (np.array(found) + (x[0], y[0], x[0], y[0]) - WALL) * size
    raise SceneError(f"its free cells need more than {MOST_BOXES} boxes around them")


def rectangles(part):
    """Returns rectangles (left, bottom, right, top) of cells outside of a part (X, Y) bool, at most
    MOST_BOXES + 1. They cover all its neighbours. Each one is grown from the first uncovered
    neighbour, first along one axis and then along the other, whichever order covers more."""
    blocked = ~part
    missing = blocked & np.any([np.roll(part, step, (0, 1)) for step in AROUND], axis=0)
    found = []
    while missing.any() and len(found) <= MOST_BOXES:
        i, j = np.unravel_index(missing.argmax(), missing.shape)
        left, right = run(blocked[:, j], i)
        bottom, top = run(blocked[left:right].all(0), j)
        one = left, bottom, right, top
        bottom, top = run(blocked[i], j)
        left, right = run(blocked[:, bottom:top].all(1), i)
        other = left, bottom, right, top
        best = max(one, other, key=lambda r: missing[r[0]:r[2], r[1]:r[3]].sum())
        missing[best[0]:best[2], best[1]:best[3]] = False
        found.append(best)
    return found


def run(line, k):
    """Returns the ends (first, last + 1) of the run of True values around index k of a line."""
    breaks = np.flatnonzero(~line)
    after = np.searchsorted(breaks, k)
    return (int(breaks[after - 1]) + 1 if after else 0,
            int(breaks[after]) if after < len(breaks) else len(line))
