"""A map of the room from the robot's own range readings: an occupancy grid of log-odds (Moravec and
Elfes 1985; Thrun et al. 2005, chapter 9), as in the paper's Fig. 8. The policy does not use it.
Axis letters: X, Y cells of the grid, S sensors."""

import numpy as np

from robot.ring import ANGLES, CONE, RANGE
from sim import ROBOT_RADIUS

CELL = 0.05  # [m] edge of a cell; all constants here are our choice
FREE = -0.4  # log-odds that a reading adds to the cells nearer than its end
OCCUPIED = 0.85  # log-odds that a reading adds to the cells at its end
MOST = 4.0  # limit of a cell's log-odds, positive or negative
THICKNESS = 0.08  # [m] depth of the cells at the end of a reading


class OccupancyGrid:
    """A map of the floor with the probability that each cell is occupied."""

    def __init__(self, bounds):
        """bounds: (2, 2) lowest and highest (x, y) [m]."""
        x, y = [np.arange(low + CELL / 2, high, CELL) for low, high in zip(*bounds)]
        self.bounds = np.asarray(bounds)
        self.centres = np.stack(np.meshgrid(x, y, indexing="ij"), -1)  # (X, Y, 2) [m]
        self.log_odds = np.zeros(self.centres.shape[:2])  # 0: nothing is known

    def add(self, pose, readings):
        """Adds the range readings (S,) [m] measured at a pose (3,), from the robot's rim, NaN if
        missing. Each cell is updated by the sensor whose cone contains it."""
        x, y = np.moveaxis(self.centres - pose[:2], -1, 0)
        away = np.hypot(x, y)
        bearing = np.arctan2(y, x) - pose[2]
        # The sensors are evenly spaced, so rounding gives the nearest one.
        sensor = np.round(bearing / ANGLES[1]).astype(int) % len(ANGLES)
        off_axis = np.abs(np.angle(np.exp(1j * (bearing - ANGLES[sensor]))))
        reading = np.asarray(readings)[sensor] + ROBOT_RADIUS  # (X, Y) from the robot's centre
        beyond = np.where(off_axis <= CONE / 2, away - reading, np.nan)  # NaN fails both tests
        is_echo = reading < RANGE + ROBOT_RADIUS  # otherwise nothing is in range
        self.log_odds[beyond < -THICKNESS / 2] += FREE
        self.log_odds[(np.abs(beyond) <= THICKNESS / 2) & is_echo] += OCCUPIED
        self.log_odds.clip(-MOST, MOST, out=self.log_odds)

    @property
    def probability(self):
        """Probability (X, Y) that a cell is occupied."""
        return 1 / (1 + np.exp(-self.log_odds))
