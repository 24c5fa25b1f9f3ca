"""The interface of a real robot, and the loop in which a policy drives it. Between policy and
wheels, the ring refuses forward motion if the path may be blocked, and the watchdog stops the
wheels while a measurement is missing or old. Implementations: robot/lab.py (our simulation or
MuJoCo) and robot/ros_adapter.py (ROS 2)."""

from dataclasses import dataclass, field
from typing import NamedTuple, Protocol

import numpy as np

from navbot_min import (HIGHEST_ACTION, LOWEST_ACTION, MAX_COMMAND, MAX_EPISODE_STEPS,
                        polar_targets, rewards)
from render import H, W
from robot.ring import SENSORS, is_blocked
from sim import ARRIVAL_DISTANCE, CONTROL_PERIOD

WATCHDOG = 2 * CONTROL_PERIOD + 1e-6  # [s] an older measurement counts as missing


class Stamped(NamedTuple):
    """A measurement and its time [s], by the robot's own clock."""
    value: object
    time: float


class Robot(Protocol):
    """The methods that a robot needs. A sensor returns None before its first measurement."""

    def now(self):
        """Returns the time [s] of the monotonic clock that all its time stamps use."""

    def sleep_until(self, time):
        """Waits until this time [s]."""

    def image(self):
        """Returns the last image, Stamped: (48, 64, 3) uint8 RGB."""

    def odometry(self):
        """Returns the last pose by odometry, Stamped: x [m], y [m], theta [rad], any origin."""

    def ranges(self):
        """Returns 24 range readings [m], Stamped: from the rim, counter-clockwise from ahead."""

    def send(self, linear, angular):
        """Sends velocities [m/s, rad/s] to the wheels. They hold until the next call."""


@dataclass
class Drive:
    """Record of a drive, period by period."""
    outcome: str = "timeout"  # or "arrival", by odometry
    poses: list = field(default_factory=list)  # by odometry, (3,) each
    readings: list = field(default_factory=list)  # from the ring, (SENSORS,) each; NaN if missing
    stops: int = 0  # periods in which the ring refused forward motion
    waits: int = 0  # periods in which the watchdog stopped the wheels


def drive(robot, policy, goal, periods=MAX_EPISODE_STEPS):
    """Drives a Robot until it arrives at the goal (x, y) [m] by odometry, or for at most this many
    control periods. Returns a Drive. Raises ValueError for an invalid goal. Stops the wheels at the
    end, also after an exception.

    policy: its `reset()` begins an episode, its `act(observation)` returns an action (2,)."""
    place = np.array(goal, dtype=float)
    if place.shape != (2,) or not np.isfinite(place).all():
        raise ValueError(f"goal is {goal!r}, it must be two finite numbers, x and y [m]")
    log = Drive()
    policy.reset()
    command = np.zeros(2)
    reward = 0.0
    before = None  # [m] distance to the goal one period earlier
    try:
        due = robot.now()
        for _ in range(periods):
            robot.sleep_until(due)
            due = max(due + CONTROL_PERIOD, robot.now())  # a late robot does not catch up
            image, pose = image_and_pose(robot)
            if image is None:
                command = obey(robot, np.full(2, np.nan), log)
                continue
            log.poses.append(pose)
            [target] = polar_targets(pose[None], place[None])
            distance = target[0]
            if distance < ARRIVAL_DISTANCE:
                log.outcome = "arrival"
                break
            if before is not None:
                reward = rewards(before, distance, arrived=False, failed=False)
            before = distance
            seen = {"image": image, "target": target.astype(np.float32),
                    "velocity": command.astype(np.float32), "last_reward": np.float32([reward])}
            command = obey(robot, policy.act(seen), log)
    finally:
        robot.send(0.0, 0.0)
    return log


def obey(robot, action, log):
    """Sends the wheels an action (2,), limited by watchdog and ring. Returns the command (2,)."""
    command = np.clip(action, LOWEST_ACTION, HIGHEST_ACTION) * MAX_COMMAND
    image, _ = image_and_pose(robot)  # what the policy saw may be too old by now
    if image is None or not np.isfinite(command).all():
        log.waits += 1
        robot.send(0.0, 0.0)
        return np.zeros(2)
    readings = np.array(fresh(robot, robot.ranges(), np.full(SENSORS, np.nan)), dtype=float)
    log.readings.append(readings)
    if command[0] > 0 and is_blocked(readings, command):
        log.stops += 1
        command = np.array([0.0, command[1]])
    robot.send(*command.tolist())
    return command


def image_and_pose(robot):
    """Returns the robot's last image and pose (3,). If either is invalid, the image is None."""
    image = fresh(robot, robot.image(), np.zeros(0))
    pose = np.array(fresh(robot, robot.odometry(), np.full(3, np.nan)), dtype=float)
    is_image = image.shape == (H, W, 3) and image.dtype == np.uint8
    return image if is_image and np.isfinite(pose).all() else None, pose


def fresh(robot, stamped, missing):
    """Returns the value of a Stamped, or `missing` if it is None, too old or from the future."""
    is_fresh = stamped is not None and 0 <= robot.now() - stamped.time <= WATCHDOG
    return stamped.value if is_fresh else missing
