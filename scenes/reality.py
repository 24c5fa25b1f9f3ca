"""The errors of a real robot as numbers: the table `[reality]` of a scene file. A room without it
is a simulation without errors. `robot/environment.py` applies the numbers."""

import math
from dataclasses import dataclass, field, fields

from scenes import check, check_keys, number, numbers, shown

LOOKS = ("simulation", "lab")  # of walls, floor, ceiling and light; robot/looks.py
ANGLES = ("camera_yaw", "camera_pitch")  # in degrees in a file, as `camera_yaw_degrees`


def knob(default, low, high):
    """Returns a field of `Reality`: a number, or a tuple of numbers, from low to high."""
    return field(default=default, metadata={"low": low, "high": high})


@dataclass(frozen=True)
class Reality:
    """The errors of one room. The defaults are a simulation: no errors."""
    look: str = "simulation"
    exposure: float = knob(1.0, 0.2, 5.0)  # factor of all colours
    white_balance: tuple = knob((1.0, 1.0, 1.0), 0.2, 5.0)  # factors of red, green and blue
    camera_yaw: float = knob(0.0, -0.3, 0.3)  # [rad] of its mounting, to the left
    camera_pitch: float = knob(0.0, -0.3, 0.3)  # [rad] of its mounting, up
    # Errors of odometry are drawn once per episode, from normal distributions with these standard
    # deviations, and grow with the distance driven and the angle turned.
    distance_drift: float = knob(0.0, 0.0, 1.0)  # [m/m]
    turn_drift: float = knob(0.0, 0.0, 1.0)  # [rad/rad]
    wheel_gains: tuple = knob((1.0, 1.0), 0.2, 5.0)  # true speed over commanded, left and right
    image_delay: float = knob(0.0, 0.0, 1.0)  # fraction of episodes with images one period late


KNOBS = {item.name: item for item in fields(Reality) if item.name != "look"}


def parse_reality(table, in_degrees):
    """Returns the Reality of a scene file's table or, if not in_degrees, of a dict that
    `dataclasses.asdict` made of one. Raises SceneError."""
    suffix = "_degrees" if in_degrees else ""
    names = {name + suffix if name in ANGLES else name: name for name in ("look", *KNOBS)}
    check_keys(table, (), "reality", optional=names)
    look = table.get("look", "simulation")
    check(look in LOOKS, f"reality.look is {shown(look)}, it must be one of {', '.join(LOOKS)}")
    values = {"look": look}
    for key in sorted(table.keys() - {"look"}):
        item = KNOBS[names[key]]
        unit = math.radians(1) if in_degrees and item.name in ANGLES else 1
        limits = [limit / unit for limit in item.metadata.values()]
        if isinstance(item.default, tuple):
            value = numbers(table[key], f"reality.{key}", len(item.default), *limits)
        else:
            value = number(table[key], f"reality.{key}", *limits) * unit
        values[item.name] = value
    return Reality(**values)
