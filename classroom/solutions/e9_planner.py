"""A solution of exercise 9, one of many."""

import math

import numpy as np

from evaluation.planners import MARGIN, Planner, polar, room_ahead

DIRECTIONS = np.radians(np.arange(-90, 91, 10))
ENOUGH = 0.8  # [m] more free space brings no benefit


class Mine(Planner):
    """Drives in the free direction that is nearest to the goal's, and prefers the direction of the
    last step."""

    senses = True

    def begin(self, pose, goal):
        super().begin(pose, goal)
        self.last = 0.0  # [rad] direction of the last step, in room coordinates

    def act(self, pose, readings):
        distance, bearing = polar(pose, self.goal)
        room = np.array([room_ahead(readings, direction) for direction in DIRECTIONS])
        wanted = min(distance, ENOUGH)
        towards = np.abs(np.angle(np.exp(1j * (DIRECTIONS - bearing))))
        as_before = np.abs(np.angle(np.exp(1j * (DIRECTIONS + pose[2] - self.last))))
        cost = towards + 0.7 * as_before + 6 * np.maximum(wanted - room, 0)
        best = cost.argmin()
        if room[best] < MARGIN:  # in a corner: turn on the spot
            return 0.0, math.copysign(1.0, bearing)
        self.last = pose[2] + DIRECTIONS[best]
        w = float(np.clip(2 * DIRECTIONS[best], -1, 1))
        ahead = room_ahead(readings, 0.0)
        v = 0.3 * max(0.0, 1 - abs(DIRECTIONS[best])) * float(np.clip(ahead / 0.3, 0, 1))
        return v, w
