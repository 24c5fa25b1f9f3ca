"""What a robot has to offer, so that a policy can drive it, and the loop that does.

`drive(robot, policy, goal)` asks the robot for what it has measured last, the policy for an action,
and sends the wheels a command, once in every control period. Three things stand between the policy
and the wheels:

- the ring: where the way ahead is blocked, or that is not known, forward motion is refused;
- the watchdog: where the last image or odometry is more than two periods old, missing or broken,
  the wheels stop until it comes;
- the end, however it comes: Ctrl-C or an error stops the wheels before anything else.

The lab is a Robot, too (`robot/lab.py`). A real one needs the same six methods (docs/robot.md).
"""

from dataclasses import dataclass, field
from typing import NamedTuple, Protocol

import numpy as np

from navbot_min import (HIGHEST_ACTION, LOWEST_ACTION, MAX_COMMAND, MAX_EPISODE_STEPS,
                        polar_targets, rewards)
from render import H, W
from robot.ring import SENSORS, SLACK, is_blocked
from sim import ARRIVAL_DISTANCE, CONTROL_PERIOD

WATCHDOG = 2 * CONTROL_PERIOD  # [s] what is older stops the wheels


class Stamped(NamedTuple):
    """What a sensor measured, and when [s], by the robot's own clock."""
    value: object
    time: float


class Robot(Protocol):
    """What a robot of one's own has to offer."""

    def now(self):
        """The time [s], by the clock that all of its time stamps are of, one that is never set."""

    def sleep_until(self, time):
        """Waits until that time [s]."""

    def image(self):
        """The camera's last image, Stamped: (48, 64, 3) uint8 RGB; None before the first."""

    def odometry(self):
        """The last pose (x [m], y [m], theta [rad]) by odometry, Stamped, from wherever it begins;
        None before the first."""

    def ranges(self):
        """The last readings of the ring's 24 sensors [m], Stamped, from the robot's rim, the first
        ahead and the others counter-clockwise; None before the first."""

    def send(self, linear, angular):
        """Tells the wheels a velocity [m/s, rad/s], which holds until the next."""


@dataclass
class Drive:
    """How a drive went, period by period."""
    outcome: str = "timeout"  # or "arrival", by odometry
    poses: list = field(default_factory=list)  # by odometry, (3,) each
    commands: list = field(default_factory=list)  # sent to the wheels, (2,) each
    readings: list = field(default_factory=list)  # of the ring, (SENSORS,) each; NaN without one
    stops: int = 0  # periods in which the ring refused forward motion
    waits: int = 0  # periods in which the watchdog stopped the wheels


def numbers_of(stamped, shape):
    """A Stamped value as an array of floats of that shape; None where it is no such thing."""
    try:
        numbers = np.asarray(stamped.value, dtype=float)
    except (AttributeError, TypeError, ValueError):
        return None
    return numbers if numbers.shape == shape else None


def age_of(stamped, now):
    """How old a Stamped value is [s]; NaN where it has no time."""
    try:
        return now - float(stamped.time)
    except (AttributeError, TypeError, ValueError):
        return np.nan


def is_fresh(age):
    """Whether an age [s] is neither too old nor of the future, and a number at all."""
    return -SLACK <= age <= WATCHDOG + SLACK


def is_image(image):
    """Whether the camera has brought an image as the policy wants it."""
    value = getattr(image, "value", None)
    return isinstance(value, np.ndarray) and value.shape == (H, W, 3) and value.dtype == np.uint8


def checked_goal(goal):
    """A goal as an array (2,). Raises ValueError."""
    numbers = numbers_of(Stamped(goal, 0.0), (2,))
    if numbers is None or not np.isfinite(numbers).all():
        raise ValueError(f"goal is {goal!r}, it must be two finite numbers, x and y [m]")
    return numbers


def drive(robot, policy, goal, periods=MAX_EPISODE_STEPS):
    """Drives a Robot until its odometry says that it has arrived at the goal (x, y) [m], or for so
    many control periods. Returns a Drive. Raises ValueError for a goal that is none.

    policy: has `reset()` and `act(observation)`, which returns an action (2,), as
    `TorchPolicy` and `OnnxPolicy` have. The wheels stand when this ends, however it ends.
    """
    log = Drive()
    goal = checked_goal(goal)
    policy.reset()
    command = np.zeros(2)
    reward = 0.0
    before = None  # [m] distance to the goal a period ago
    try:
        due = robot.now()
        for _ in range(periods):
            robot.sleep_until(due)
            due = next_period(due, robot.now())
            measured = image_and_pose(robot)
            if measured is None:
                command = wait(robot, log)
                continue
            image, pose = measured
            log.poses.append(pose)
            target = polar_targets(pose[None], goal[None])
            distance = target[0, 0]
            if distance < ARRIVAL_DISTANCE:
                log.outcome = "arrival"
                break
            if before is not None:
                reward = rewards(np.array([before]), np.array([distance]), False, False)[0]
            before = distance
            seen = as_observation(image, target[0], command, reward)
            command = obey(robot, policy.act(seen), log)
    finally:
        robot.send(0.0, 0.0)
    return log


def next_period(due, now):
    """When the next control period begins [s], after the one that was due: whoever is late does not
    catch up, and a clock that was set back does not make it wait."""
    return min(max(due + CONTROL_PERIOD, now), now + CONTROL_PERIOD)


def wait(robot, log):
    """Stops the wheels for a period. Returns the command (2,) that this is."""
    log.waits += 1
    robot.send(0.0, 0.0)
    return np.zeros(2)


def obey(robot, action, log):
    """Tells the wheels what is left of a policy's action (2,) after watchdog and ring. Returns this
    command (2,) [m/s, rad/s]."""
    command = np.clip(action, LOWEST_ACTION, HIGHEST_ACTION) * MAX_COMMAND
    took_too_long = image_and_pose(robot) is None  # for what it saw is out of date by now
    if took_too_long or not np.isfinite(command).all():
        return wait(robot, log)
    command = after_ring(robot, command, log)
    robot.send(*command.tolist())
    log.commands.append(command)
    return command


def as_observation(image, target, command, reward):
    """What one robot's policy sees (navbot_min.py): image (H, W, 3) uint8, target (2,) [m, rad],
    last command (2,) [m/s, rad/s], last reward."""
    return {"image": image, "target": target.astype(np.float32),
            "velocity": command.astype(np.float32), "last_reward": np.float32([reward])}


def image_and_pose(robot):
    """The robot's last image and its last pose (3,), by odometry; None where one is missing, broken
    or too old."""
    image = robot.image()
    odometry = robot.odometry()
    pose = numbers_of(odometry, (3,))
    if not is_image(image) or pose is None or not np.isfinite(pose).all():
        return None
    now = robot.now()
    if not (is_fresh(age_of(image, now)) and is_fresh(age_of(odometry, now))):
        return None
    return image.value, pose


def after_ring(robot, command, log):
    """The command (2,) after the ring: without forward motion where the way ahead is blocked."""
    ranges = robot.ranges()
    readings = numbers_of(ranges, (SENSORS,))
    log.readings.append(np.full(SENSORS, np.nan) if readings is None else readings)
    if command[0] > 0 and is_blocked(readings, command, age_of(ranges, robot.now())):
        log.stops += 1
        return np.array([0.0, command[1]])
    return command
