"""What reality does to a robot, as numbers: the table `[reality]` of a scene file.

Every number has its unit and its valid range beside it. A room without such a table is a
simulation: nothing is added. `robot/environment.py` does what these numbers say.
"""

import math
from dataclasses import dataclass, field, fields

from scenes.limits import check, number, shown

LOOKS = ("simulation", "lab")  # how walls, floor, ceiling and light look; robot/looks.py


def knob(default, low, high):
    """A number of `Reality`, or a list of some, that has to be from low to high."""
    return field(default=default, metadata={"low": low, "high": high})


@dataclass(frozen=True)
class Reality:
    """The defaults are a simulation's: no error."""
    look: str = "simulation"
    # The camera. Colours are 0 to 255.
    exposure: float = knob(1.0, 0.2, 5.0)  # factor of all colours
    white_balance: tuple = knob((1.0, 1.0, 1.0), 0.2, 5.0)  # factors of red, green and blue
    light_change: float = knob(0.0, 0.0, 1.0)  # from one episode to the next: standard deviation of
    #   the logarithm of a factor of all colours
    image_noise: float = knob(0.0, 0.0, 100.0)  # standard deviation, of each colour of each pixel
    blur: float = knob(0.0, 0.0, 3.0)  # [px] standard deviation of a Gaussian
    camera_yaw: float = knob(0.0, -0.3, 0.3)  # [rad] mounted so far to the left
    camera_pitch: float = knob(0.0, -0.3, 0.3)  # [rad] mounted so far up
    # Odometry. An episode's errors are drawn as it begins, from normal distributions with these
    # standard deviations, and grow with the way.
    distance_drift: float = knob(0.0, 0.0, 1.0)  # [m/m] of the way driven
    turn_drift: float = knob(0.0, 0.0, 1.0)  # [rad/rad] of the angle turned
    veer: float = knob(0.0, 0.0, 1.0)  # [rad/m] of the heading, on the way
    # The wheels.
    lag: float = knob(0.0, 0.0, 5.0)  # [s] until 63 % of a change of speed are done
    wheel_gains: tuple = knob((1.0, 1.0), 0.2, 5.0)  # speed of the left and the right wheel, over
    #   what they were told
    dead_zone: float = knob(0.0, 0.0, 0.3)  # [m/s] a wheel that is told less stands still
    # Time.
    period_jitter: float = knob(0.0, 0.0, 0.5)  # standard deviation of a control period, as a share
    image_delay: float = knob(0.0, 0.0, 1.0)  # share of the episodes in which the image is one
    #   period old
    dropped_images: float = knob(0.0, 0.0, 0.9)  # share of the periods that bring no new image
    # The ultrasonic sensors.
    range_noise: float = knob(0.0, 0.0, 1.0)  # [m] standard deviation of a reading
    range_dropouts: float = knob(0.0, 0.0, 1.0)  # share of the readings that there are not


ANGLES = ("camera_yaw", "camera_pitch")  # in degrees in a file, under `camera_yaw_degrees`
KNOBS = {item.name: item for item in fields(Reality) if item.name != "look"}


def parse_reality(table, in_degrees=True):
    """The Reality of a scene file's table, or where not `in_degrees` of a dict that
    `dataclasses.asdict` made of one; None where there is none. Raises SceneError."""
    if table is None:
        return None
    check(isinstance(table, dict), f"reality is {shown(table)}, it must be a table")
    names = {name: name for name in ("look", *KNOBS)}  # as they stand in the table
    if in_degrees:
        names |= {name: f"{name}_degrees" for name in ANGLES}
    for key in table:
        check(isinstance(key, str) and key in names.values(),
              f"reality has an unknown key {shown(key)}; known: {', '.join(names.values())}")
    values = {}
    for name, key in names.items():
        if key in table:
            values[name] = _value(name, key, table[key])
    return Reality(**values)


def _value(name, key, value):
    """A checked value of the field of that name, from the table's key."""
    what = f"reality.{key}"
    if name == "look":
        check(isinstance(value, str) and value in LOOKS,
              f"{what} is {shown(value)}, it must be one of {', '.join(LOOKS)}")
        return value
    item = KNOBS[name]
    if not isinstance(item.default, tuple):
        return _bounded(value, item, key, what)
    count = len(item.default)
    check(isinstance(value, (list, tuple)) and len(value) == count,
          f"{what} is {shown(value)}, it must be a list of {count} numbers")
    return tuple(_bounded(part, item, key, f"{what}[{k}]") for k, part in enumerate(value))


def _bounded(value, item, key, what):
    """A number in the range of a field; degrees become radians."""
    value = number(value, what)
    low = item.metadata["low"]
    high = item.metadata["high"]
    if key.endswith("_degrees"):
        check(low <= math.radians(value) <= high,
              f"{what} is {value:g}, it must be from {math.degrees(low):.0f} to "
              f"{math.degrees(high):.0f}")
        return math.radians(value)
    check(low <= value <= high, f"{what} is {value:g}, it must be from {low:g} to {high:g}")
    return value
