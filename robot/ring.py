"""The ring of ultrasonic sensors, and the stop between policy and wheels (paper IV-C).

A sensor hears the nearest thing in its cone. What stops the robot is not what it sees but what it
hears: where a thing stands in the way of a command, forward motion is refused. Turning is not.

Axis letters: R robots, S sensors, P places on a way.
"""

import numpy as np

from sim import CONTROL_PERIOD, ROBOT_RADIUS
from support.ranges import range_readings

SENSORS = 24  # evenly around the robot, the first ahead; all numbers are our choice
ANGLES = np.arange(SENSORS) * 2 * np.pi / SENSORS  # [rad] counter-clockwise from ahead
CONE = np.radians(15)  # what a sensor hears, from edge to edge, as a HC-SR04 does: no gap is left
RAYS = np.array([-0.5, 0.0, 0.5]) * CONE  # [rad] of a cone that are measured
RANGE = 2.0  # [m] from the robot's rim; beyond it a reading is RANGE
BLIND = 0.02  # [m] from the rim; nothing nearer is heard, and there is no reading
LONGER = 0.2  # [s] that a way is looked ahead beyond one period, for the wheels' lag
BESIDE = 0.02  # [m] that is kept free around the robot's disc, for noise
OLDEST = 2 * CONTROL_PERIOD  # [s] older readings count as none
SLACK = 1e-6  # [s] of rounding, in an age
AHEAD = np.cos(ANGLES) > 1e-9  # (S,) which sensors face ahead
MOMENTS = np.linspace(0, CONTROL_PERIOD + LONGER, 9)  # (P,) [s] at which the way is looked at


def listen(world, noise, dropouts, rng):
    """What the sensors of R robots hear, (R, S) [m] from the rim; NaN where there is no reading.

    world: a sim.World. noise: (R,) [m] standard deviations. dropouts: (R,) shares.
    """
    rays = (ANGLES[:, None] + RAYS).ravel()
    exact = range_readings(world, rays, RANGE + ROBOT_RADIUS)  # (R, S * 3)
    nearest = exact.reshape(len(exact), SENSORS, len(RAYS)).min(2) - ROBOT_RADIUS
    heard = nearest + noise[:, None] * rng.standard_normal(nearest.shape)
    heard = np.where(nearest < RANGE, np.clip(heard, 0, RANGE), RANGE)  # where nothing is, no echo
    lost = rng.random(nearest.shape) < dropouts[:, None]
    return np.where(lost | (nearest < BLIND), np.nan, heard)


def way(commands):
    """Where commands (..., 2) [m/s, rad/s] lead: (..., P) complex numbers, x + iy [m], from the
    robot's place and heading. A bend is a chord of the circle, in half of its angle."""
    v = commands[..., :1]
    w = commands[..., 1:]
    angle = w * MOMENTS  # (..., P) that the robot has turned
    return v * MOMENTS * np.sinc(angle / 2 / np.pi) * np.exp(0.5j * angle)


def is_blocked(readings, commands, ages=0.0):
    """Whether what is heard stands in the way of commands (..., 2) [m/s, rad/s]: the way would
    bring it nearer, and nearer than BESIDE to the disc. A reading is taken to be in the middle of
    its cone.

    readings: (..., S) [m]; ages: of them [s]. A sensor that faces ahead and has no reading counts
    as blocked: 0, NaN, none at all, or one that is too old or of the future.
    """
    if readings is None or np.shape(readings)[-1:] != (SENSORS,):
        return True
    readings = np.asarray(readings, dtype=float)
    ages = np.asarray(ages)
    valid = (readings > 0) & (ages <= OLDEST + SLACK) & (ages >= -SLACK)  # false for NaN
    away = ROBOT_RADIUS + np.where(valid, readings, 0)  # (..., S) [m] from the robot's centre
    things = away * np.exp(1j * ANGLES)
    nearest = np.abs(things[..., None] - way(np.asarray(commands))[..., None, :]).min(-1)
    in_way = (nearest < ROBOT_RADIUS + BESIDE) & (nearest < away - 1e-9)
    return (AHEAD & (~valid | in_way)).any(-1)
