"""A map of the room from what the robot itself measures: an occupancy grid of log-odds (Moravec and
Elfes 1985; Thrun et al. 2005, chapter 9). For showing alone, as in the paper's Fig. 8: the policy
drives without it.

Axis letters: X, Y cells of the grid, S sensors.
"""

import numpy as np

from robot.ring import ANGLES, CONE, RANGE
from sim import ROBOT_RADIUS

CELL = 0.05  # [m] our choice
FREE = -0.4  # log-odds that a reading adds to the cells before it, our choice
OCCUPIED = 0.85  # log-odds that it adds to the cells where it ends, our choice
MOST = 4.0  # log-odds that a cell can have, either way, our choice
THICKNESS = 0.08  # [m] so deep are the cells in which a reading ends, our choice


class OccupancyGrid:
    """How likely each cell of a floor is occupied."""

    def __init__(self, bounds):
        """bounds: (2, 2) lowest and highest (x, y) [m]."""
        low, high = bounds
        x, y = [np.arange(a + CELL / 2, b, CELL) for a, b in zip(low, high)]
        self.bounds = np.asarray(bounds)
        self.centres = np.stack(np.meshgrid(x, y, indexing="ij"), -1)  # (X, Y, 2) [m]
        self.log_odds = np.zeros(self.centres.shape[:2])  # 0: nothing is known

    def add(self, pose, readings):
        """What the ring hears from a pose (3,): readings (S,) [m] from the rim, NaN where there is
        none. A cell counts for the sensor in whose cone it lies."""
        offset = self.centres - pose[:2]
        away = np.hypot(offset[..., 0], offset[..., 1])
        bearing = np.arctan2(offset[..., 1], offset[..., 0]) - pose[2]
        # The nearest sensor, for they lie evenly around the robot.
        sensor = np.round(bearing / (ANGLES[1] - ANGLES[0])).astype(int) % len(ANGLES)
        off_axis = np.abs(np.angle(np.exp(1j * (bearing - ANGLES[sensor]))))
        reading = np.asarray(readings)[sensor] + ROBOT_RADIUS  # (X, Y) from the centre
        heard = (off_axis <= CONE / 2) & np.isfinite(reading)
        before = heard & (away < reading - THICKNESS / 2)
        at_end = heard & (np.abs(away - reading) <= THICKNESS / 2)
        at_end &= reading < RANGE + ROBOT_RADIUS  # else nothing is there
        self.log_odds[before] += FREE
        self.log_odds[at_end] += OCCUPIED
        self.log_odds.clip(-MOST, MOST, out=self.log_odds)

    @property
    def probability(self):
        """(X, Y) of being occupied."""
        return 1 / (1 + np.exp(-self.log_odds))
