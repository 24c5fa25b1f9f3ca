"""The ring of ultrasonic sensors, and the stop between policy and wheels (paper IV-C). A sensor
hears the nearest thing in its cone. If that stands in the way of a command, forward motion is
refused, turning is not. Axis letters: R robots, S sensors, P places on a way."""

import numpy as np

from scenes.generate import range_readings
from sim import CONTROL_PERIOD, ROBOT_RADIUS

SENSORS = 24  # evenly around the robot, the first ahead; all numbers are our choice
ANGLES = np.arange(SENSORS) * 2 * np.pi / SENSORS  # [rad] counter-clockwise from ahead
CONE = np.radians(15)  # what a sensor hears, from edge to edge, as a HC-SR04 does: no gap is left
RAYS = np.array([-0.5, 0.0, 0.5]) * CONE  # [rad] of a cone that are measured
RANGE = 2.0  # [m] from the robot's rim; beyond it a reading is RANGE
BLIND = 0.02  # [m] from the rim; nothing nearer is heard, and there is no reading
LONGER = 0.2  # [s] that a way is looked ahead beyond one period, for wheels that lag
BESIDE = 0.02  # [m] that is kept free around the robot's disc, for noisy readings
MOMENTS = np.linspace(0, CONTROL_PERIOD + LONGER, 9)  # (P,) [s] at which the way is looked at


def listen(world):
    """Returns what the sensors of R robots hear, (R, S) [m] from the rim; NaN in the blind zone.
    world: a sim.World."""
    rays = (ANGLES[:, None] + RAYS).ravel()
    exact = range_readings(world, rays, RANGE + ROBOT_RADIUS)  # (R, S * 3)
    nearest = exact.reshape(len(exact), SENSORS, len(RAYS)).min(2) - ROBOT_RADIUS
    return np.where(nearest < BLIND, np.nan, nearest)


def is_blocked(readings, commands):
    """Returns whether what is heard, readings (..., S) [m], stands in the way of commands (..., 2)
    [m/s, rad/s]: the way would bring it nearer, and nearer than BESIDE to the disc. A reading is
    taken to be in the middle of its cone; without one above 0, a thing may be at the rim."""
    v, w = np.moveaxis(np.asarray(commands)[..., None], -2, 0)  # (..., 1) each
    # Where the robot will be, (..., P) complex numbers, x + iy [m], from its place and heading: the
    # end of a chord of the circle, in half of the angle that it has turned.
    turned = w * MOMENTS
    way = v * MOMENTS * np.sinc(turned / 2 / np.pi) * np.exp(0.5j * turned)
    away = ROBOT_RADIUS + np.where(readings > 0, readings, 0)  # (..., S) [m] from the centre
    things = away * np.exp(1j * ANGLES)
    nearest = np.abs(things[..., None] - way[..., None, :]).min(-1)
    in_way = (nearest < ROBOT_RADIUS + BESIDE) & (nearest < away - 1e-9)
    return (in_way & (np.cos(ANGLES) > 1e-9)).any(-1)  # behind the robot nothing is in the way
