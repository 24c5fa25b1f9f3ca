"""A map of the room from what the robot itself measures, an occupancy grid of log-odds (Moravec and
Elfes 1985; Thrun et al. 2005, chapter 9), as in the paper's Fig. 8. The policy drives without it.
Axis letters: X, Y cells of the grid, S sensors."""

import numpy as np

from robot.ring import ANGLES, CONE, RANGE
from sim import ROBOT_RADIUS

CELL = 0.05  # [m] this and all below are our choice
FREE = -0.4  # log-odds that a reading adds to the cells before it
OCCUPIED = 0.85  # log-odds that it adds to the cells where it ends
MOST = 4.0  # log-odds that a cell can have, either way
THICKNESS = 0.08  # [m] depth of the cells in which a reading ends


class OccupancyGrid:
    """How likely each cell of a floor is occupied."""

    def __init__(self, bounds):
        """bounds: (2, 2) lowest and highest (x, y) [m]."""
        x, y = [np.arange(low + CELL / 2, high, CELL) for low, high in zip(*bounds)]
        self.bounds = np.asarray(bounds)
        self.centres = np.stack(np.meshgrid(x, y, indexing="ij"), -1)  # (X, Y, 2) [m]
        self.log_odds = np.zeros(self.centres.shape[:2])  # 0: nothing is known

    def add(self, pose, readings):
        """Adds what the ring hears from a pose (3,): readings (S,) [m] from the rim, NaN if there
        is none. A cell counts for the sensor in whose cone it lies."""
        x, y = np.moveaxis(self.centres - pose[:2], -1, 0)
        away = np.hypot(x, y)
        bearing = np.arctan2(y, x) - pose[2]
        # The nearest sensor, because they lie evenly around the robot.
        sensor = np.round(bearing / ANGLES[1]).astype(int) % len(ANGLES)
        off_axis = np.abs(np.angle(np.exp(1j * (bearing - ANGLES[sensor]))))
        reading = np.asarray(readings)[sensor] + ROBOT_RADIUS  # (X, Y) from the centre
        beyond = np.where(off_axis <= CONE / 2, away - reading, np.nan)  # NaN is neither below
        is_echo = reading < RANGE + ROBOT_RADIUS  # otherwise nothing is there
        self.log_odds[beyond < -THICKNESS / 2] += FREE
        self.log_odds[(np.abs(beyond) <= THICKNESS / 2) & is_echo] += OCCUPIED
        self.log_odds.clip(-MOST, MOST, out=self.log_odds)

    @property
    def probability(self):
        """(X, Y) of being occupied."""
        return 1 / (1 + np.exp(-self.log_odds))
