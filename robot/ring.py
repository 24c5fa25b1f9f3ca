"""The ring of ultrasonic sensors, which can stop the robot (paper IV-C). Each sensor measures the
distance to the nearest obstacle in its cone. If an obstacle blocks the path of a command, the ring
refuses forward motion but allows turning. Axis letters: R robots, S sensors, P points of a path."""

import numpy as np

from scenes.generate import range_readings
from sim import CONTROL_PERIOD, ROBOT_RADIUS

SENSORS = 24  # evenly spaced, the first one ahead; all these numbers are our choice
ANGLES = np.arange(SENSORS) * 2 * np.pi / SENSORS  # [rad] counter-clockwise from straight ahead
CONE = np.radians(15)  # [rad] width of a cone, as of an HC-SR04; the cones leave no gap
RAYS = np.array([-0.5, 0.0, 0.5]) * CONE  # [rad] the rays measured in each cone
RANGE = 2.0  # [m] from the robot's rim, the largest reading
BLIND = 0.02  # [m] from the rim; a nearer obstacle gives no reading
LONGER = 0.2  # [s] checked beyond one period, because wheels may lag
BESIDE = 0.02  # [m] margin around the robot's disc, because readings may be noisy
MOMENTS = np.linspace(0, CONTROL_PERIOD + LONGER, 9)  # (P,) [s] times at which the path is checked


def listen(world, measure=range_readings):
    """Returns the range readings (R, S) [m] in a world, from the rim; NaN if too close. measure:
    the function that measures along rays; this one needs a sim.World."""
    rays = (ANGLES[:, None] + RAYS).ravel()
    exact = measure(world, rays, RANGE + ROBOT_RADIUS)  # (R, S * 3)
    nearest = exact.reshape(len(exact), SENSORS, len(RAYS)).min(2) - ROBOT_RADIUS
    return np.where(nearest < BLIND, np.nan, nearest)


def is_blocked(readings, commands):
    """Returns whether an obstacle in the readings (..., S) [m] blocks commands (..., 2) [m/s,
    rad/s]: the path comes closer to it, within the margin around the disc. Each obstacle is placed
    in the middle of its cone; if its reading is missing or not above 0, at the robot's rim."""
    v, w = np.moveaxis(np.asarray(commands)[..., None], -2, 0)  # (..., 1) each
    # Next positions in the robot's axes, (..., P) as x + iy [m]: ends of the chords of an arc.
    turned = w * MOMENTS
    path = v * MOMENTS * np.sinc(turned / 2 / np.pi) * np.exp(0.5j * turned)
    away = ROBOT_RADIUS + np.where(readings > 0, readings, 0)  # (..., S) [m] from the centre
    obstacles = away * np.exp(1j * ANGLES)
    nearest = np.abs(obstacles[..., None] - path[..., None, :]).min(-1)
    in_path = (nearest < ROBOT_RADIUS + BESIDE) & (nearest < away - 1e-9)
    return (in_path & (np.cos(ANGLES) > 1e-9)).any(-1)  # obstacles behind the robot do not count
