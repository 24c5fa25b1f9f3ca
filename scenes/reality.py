"""The errors of a real robot: the table `[reality]` of a scene file. A room without this table has
no errors. `robot/environment.py` simulates the errors."""

import math
from dataclasses import dataclass, field, fields

from scenes import check, check_keys, number, numbers, shown

APPEARANCES = ("simulation", "lab")  # walls, floor, ceiling and light; robot/appearance.py
ANGLES = ("camera_yaw", "camera_pitch")  # files have these in degrees, as `camera_yaw_degrees`


def error(default, low, high):
    """Returns a field of `Reality`: a number, or a tuple of numbers, from low to high."""
    return field(default=default, metadata={"low": low, "high": high})


@dataclass(frozen=True)
class Reality:
    """The errors of one room. The defaults mean no errors."""
    appearance: str = "simulation"
    exposure: float = error(1.0, 0.2, 5.0)  # factor for all colours
    white_balance: tuple = error((1.0, 1.0, 1.0), 0.2, 5.0)  # factors for red, green and blue
    camera_yaw: float = error(0.0, -0.3, 0.3)  # [rad] mounting error, to the left
    camera_pitch: float = error(0.0, -0.3, 0.3)  # [rad] mounting error, upwards
    # Standard deviations of odometry errors, which are drawn once per episode from normal
    # distributions, and grow with the distance driven and the angle turned.
    distance_drift: float = error(0.0, 0.0, 1.0)  # [m/m]
    turn_drift: float = error(0.0, 0.0, 1.0)  # [rad/rad]
    wheel_gains: tuple = error((1.0, 1.0), 0.2, 5.0)  # true over commanded speed, left and right
    image_delay: float = error(0.0, 0.0, 1.0)  # fraction of episodes with images one period late


ERRORS = {item.name: item for item in fields(Reality) if item.name != "appearance"}


def parse_reality(table, in_degrees):
    """Returns the Reality of a scene file's table or, if not in_degrees, of the
    `dataclasses.asdict` of a Reality. Raises SceneError."""
    suffix = "_degrees" if in_degrees else ""
    names = {name + suffix if name in ANGLES else name: name for name in ("appearance", *ERRORS)}
    check_keys(table, (), "reality", optional=names)
    appearance = table.get("appearance", "simulation")
    check(appearance in APPEARANCES, f"reality.appearance is {shown(appearance)}; it must be one "
          f"of {', '.join(APPEARANCES)}")
    values = {"appearance": appearance}
    for key in sorted(table.keys() - {"appearance"}):
        item = ERRORS[names[key]]
        unit = math.radians(1) if in_degrees and item.name in ANGLES else 1
        limits = [limit / unit for limit in item.metadata.values()]
        if isinstance(item.default, tuple):
            value = numbers(table[key], f"reality.{key}", len(item.default), *limits)
        else:
            value = number(table[key], f"reality.{key}", *limits) * unit
        values[item.name] = value
    return Reality(**values)
