"""The ring of ultrasonic sensors, and the stop between policy and wheels (paper IV-C).

A sensor hears the nearest thing in its cone. What stops the robot is not what it sees but what it
hears: closer than a limit in the way ahead, forward motion is refused. Turning is not.

Axis letters: R robots, S sensors.
"""

import numpy as np

from sim import CONTROL_PERIOD, MAX_LINEAR_VELOCITY, ROBOT_RADIUS
from support.ranges import range_readings

SENSORS = 24  # evenly around the robot, the first ahead; all numbers are our choice
ANGLES = np.arange(SENSORS) * 2 * np.pi / SENSORS  # [rad] counter-clockwise from ahead
CONE = np.radians(15)  # what a sensor hears, from edge to edge, as a HC-SR04 does: no gap is left
RAYS = np.array([-0.5, 0.0, 0.5]) * CONE  # [rad] of a cone that are measured
RANGE = 2.0  # [m] from the robot's rim; beyond it a reading is RANGE
BLIND = 0.02  # [m] from the rim; nothing nearer is heard, and there is no reading
MARGIN = 0.06  # [m] beyond the way of one period at full speed, for noise and lag
BESIDE = 0.05  # [m] on both sides of it: where the robot turns, its way bends by half of that
OLDEST = 2 * CONTROL_PERIOD  # [s] older readings count as none


def limits():
    """The readings (S,) [m], from the rim, within which a thing stands in the way ahead: where each
    sensor's middle ray leaves the floor that a disc BESIDE larger than the robot's sweeps as it
    drives straight for one period at full speed, and MARGIN more. 0 for sensors that do not face
    ahead."""
    way = MAX_LINEAR_VELOCITY * CONTROL_PERIOD + MARGIN - BESIDE
    radius = ROBOT_RADIUS + BESIDE
    found = []
    for angle in ANGLES:
        forward = np.cos(angle)
        across = abs(np.sin(angle))
        leaves = ROBOT_RADIUS  # [m] from the robot's centre
        if forward > 1e-9 and forward * radius > across * way:  # through the last disc
            leaves = forward * way + np.sqrt(radius ** 2 - (across * way) ** 2)
        elif forward > 1e-9:  # through a side
            leaves = radius / across
        found.append(leaves - ROBOT_RADIUS)
    return np.array(found)


LIMITS = limits()


def listen(world, noise, dropouts, rng):
    """What the sensors of R robots hear, (R, S) [m] from the rim; NaN where there is no reading.

    world: a sim.World. noise: (R,) [m] standard deviations. dropouts: (R,) shares.
    """
    rays = (ANGLES[:, None] + RAYS).ravel()
    exact = range_readings(world, rays, RANGE + ROBOT_RADIUS)  # (R, S * 3)
    nearest = exact.reshape(len(exact), SENSORS, len(RAYS)).min(2) - ROBOT_RADIUS
    heard = nearest + noise[:, None] * rng.standard_normal(nearest.shape)
    lost = rng.random(nearest.shape) < dropouts[:, None]
    return np.where(lost | (nearest < BLIND), np.nan, np.clip(heard, 0, RANGE))


def is_blocked(readings, ages=0.0):
    """Whether the way ahead is blocked, by readings (..., S) [m] and their ages [s]. Whatever is no
    reading counts as blocked: 0, NaN, none at all, or one that is too old."""
    if readings is None or np.shape(readings)[-1:] != (SENSORS,):
        return True
    readings = np.asarray(readings, dtype=float)
    valid = (readings > 0) & (np.asarray(ages) <= OLDEST)  # false for NaN
    in_way = LIMITS > 0
    return (in_way & (~valid | (readings < LIMITS))).any(-1)
