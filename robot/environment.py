"""The task with the errors of a real robot, from a scene's `reality`, and with range sensors that
stop the robot. docs/robot.md shows the order of the calculation. Axis letters: R robots, H = 48 and
W = 64 image rows and columns."""

import math
from dataclasses import asdict

import numpy as np

from navbot_min import COLLISION, OUTCOMES, NavEnv, NavVecEnv, polar_targets
from render import FOCAL, H, W
from robot import ring
from robot.appearance import DRAWN_APPEARANCES, Cameras
from scenes.reality import ERRORS, Reality
from sim import ARRIVAL_DISTANCE, CONTROL_PERIOD, wrap_angle

WHEELBASE = 0.23  # [m] distance between the wheels of a Kobuki
STANDING_STEPS = round(10 / CONTROL_PERIOD)  # 10 s without forward motion, our choice
STANDING_SPEED = 0.01  # [m/s] slower counts as no forward motion, our choice
STANDING = len(OUTCOMES)  # index of the outcome that ends such an episode
FACTORS = ("exposure", "white_balance", "wheel_gains")  # errors given as factors
GUESS = {  # the largest random errors: our choice, 1.9 to 5 times the lab's
    "exposure": 0.5, "white_balance": 0.2, "camera_yaw": math.radians(4),
    "camera_pitch": math.radians(4), "distance_drift": 0.06, "turn_drift": 0.06,
    "wheel_gains": 0.08, "image_delay": 1.0}


def shift_rows(images, rows):
    """Returns images (R, H, W, 3) of floats moved down by (R,) rows, whole or fractional: the
    view of a camera that is tilted up. New rows repeat the edge row."""
    source = np.clip(np.arange(H) - rows[:, None], 0, H - 1)  # (R, H)
    above = np.floor(source).astype(int)
    below = np.minimum(above + 1, H - 1)
    fraction = (source - above)[..., None, None].astype(images.dtype)
    robot = np.arange(len(images))[:, None]
    return images[robot, above] * (1 - fraction) + images[robot, below] * fraction


class RealVecEnv(NavVecEnv):
    """NavVecEnv with the errors of each scene's `reality`. Each error is an attribute with the same
    name. It holds the values for the current episodes: (R,), or (R, count) if it has several.

    With the ring an episode can also end as `standing`. `final_info` also holds `stops`, the number
    of periods in which the ring refused forward motion, and the pose by odometry: `estimate_x`,
    `estimate_y` and `estimate_theta`. The hook `reward` is called twice per step: with true
    distances for the reward of the step, and with distances by odometry for the observed one.
    """

    outcomes = (*OUTCOMES, "standing")
    has_ring = False  # True: range sensors stop the robot

    def __init__(self, num_envs=32, scenes=("lab",), *args, **options):
        """Takes the arguments of NavVecEnv."""
        super().__init__(num_envs, scenes, *args, **options)
        R = num_envs
        self.appearance = np.full(R, "simulation", object)
        # One scene per robot, so that each robot can have a different appearance.
        self.scenes = self.world.scenes
        self.scene_of = np.arange(R)
        self.camera = Cameras(self.scenes, self.appearance)
        for name, item in ERRORS.items():
            setattr(self, name, np.zeros((R, *np.shape(item.default))))
        self.estimates = np.zeros((R, 3))  # poses by odometry
        self._last_estimates = np.zeros((R, 3))  # the same before the last period
        self.asked = np.zeros((R, 2))  # [m/s, rad/s] commands to the wheels
        self.stops = np.zeros(R, int)  # periods stopped by the ring in the current episodes
        self._drift = np.zeros((R, 2))  # relative errors of distance and turn
        self.is_late = np.zeros(R, bool)  # True: images except the first are late
        self._last_images = np.zeros((R, H, W, 3), np.uint8)  # images of the last period
        self._last_poses = np.zeros((R, 3))  # true poses before the last period
        self._standing = np.zeros(R, int)  # periods since the last forward motion
        self._failed = np.zeros(R, bool)  # the result of the last `drive`
        self._is_new = np.zeros(R, bool)  # True until the first observation of an episode

    @staticmethod
    def check_rooms(scenes):
        """Accepts every room."""

    def draw_errors(self, r):
        """Returns the appearance and all errors of robot r's next episode, as a dict."""
        return asdict(self.scenes[r].reality or Reality())

    def command(self, actions):
        """Returns the motion (R, 2) [m/s, rad/s] that results from actions (R, 2): clipped, stopped
        by the ring, changed by the wheels. Without errors it is exactly the command."""
        self.asked = super().command(actions)
        if self.has_ring:
            refused = ring.is_blocked(self.ranges(), self.asked) & (self.asked[:, 0] > 0)
            self.stops += refused
            self.asked[refused, 0] = 0
        v, w = self.asked.T
        left, right = self.wheel_gains.T
        mean = (left + right) / 2
        apart = (right - left) / WHEELBASE
        return np.stack([v * mean + w * apart * (WHEELBASE / 2) ** 2, w * mean + v * apart], -1)

    def ranges(self):
        """Returns the readings (R, SENSORS) [m] of the ring, whether or not it stops the robot."""
        return ring.listen(self.world)

    def drive(self, commands):
        """Drives all robots for one control period. Returns (R,) bool: True for robots that have
        collided or, with the ring, have not moved forward for STANDING_STEPS."""
        self._last_poses = self.world.poses
        collided = super().drive(commands)
        is_standing = self.has_ring & ~collided & (commands[:, 0] < STANDING_SPEED)
        self._standing = np.where(is_standing, self._standing + 1, 0)
        self._failed = collided | (self._standing >= STANDING_STEPS)
        self._last_estimates = self.estimates
        self.estimates = self._odometry(self.world.poses)
        return self._failed

    def _begin(self, robots, options):
        self._is_new[robots] = True
        return super()._begin(robots, options)

    def observe(self, robots, poses, goals, velocities, last_rewards):
        """Returns observations of these robots (n,): images with their cameras' errors, target and
        last reward by odometry, and the velocity of the command that the wheels got."""
        is_new = self._is_new[robots].all()  # either all these episodes begin or none
        if is_new:
            for r in robots:
                self._begin_episode(r)
            self.estimates[robots] = poses
            self._is_new[robots] = False
        elif self._steps.any():
            before = polar_targets(self._last_estimates[robots], goals)[:, 0]
            after = polar_targets(self.estimates[robots], goals)[:, 0]
            ended = self._failed[robots] | (polar_targets(poses, goals)[:, 0] < ARRIVAL_DISTANCE)
            # Except at the end of an episode, the true reward would reveal the true distance.
            believed = self.reward(before, after, False & ended, False & ended)
            last_rewards = np.where(ended, last_rewards, believed)
        camera_poses = poses.copy()
        camera_poses[:, 2] += self.camera_yaw[robots]
        seen = super().observe(robots, camera_poses, goals, self.asked[robots], last_rewards)
        seen["target"] = polar_targets(self.estimates[robots], goals).astype(np.float32)
        gains = self.exposure[robots, None] * self.white_balance[robots]  # (n, 3)
        rows = FOCAL * np.tan(self.camera_pitch[robots])
        images = shift_rows(seen["image"].astype(np.float32), rows)
        images = images * gains[:, None, None].astype(np.float32)
        images = images.clip(0, 255).round().astype(np.uint8)
        is_old = self.is_late[robots, None, None, None] & (not is_new)
        seen["image"] = np.where(is_old, self._last_images[robots], images)
        self._last_images[robots] = images
        return seen

    def _begin_episode(self, r):
        """Draws the errors of robot r's new episode and clears its counters."""
        for name, value in self.draw_errors(r).items():
            getattr(self, name)[r] = value
        sigmas = np.array([self.distance_drift[r], self.turn_drift[r]])
        self._drift[r] = sigmas * self.np_random.standard_normal(2)
        self.is_late[r] = self.np_random.random() < self.image_delay[r]
        for array in (self.asked, self.stops, self._standing):
            array[r] = 0

    def _odometry(self, poses):
        """Returns the poses (R, 3) by odometry after a period that ends at true poses (R, 3)."""
        dx, dy = (poses - self._last_poses)[:, :2].T
        turn = wrap_angle(poses[:, 2] - self._last_poses[:, 2])
        middle = self._last_poses[:, 2] + turn / 2
        ahead = dx * np.cos(middle) + dy * np.sin(middle)
        ahead = ahead * (1 + self._drift[:, 0])
        turn = turn * (1 + self._drift[:, 1])
        x, y, heading = self.estimates.T
        middle = heading + turn / 2
        return np.stack([x + ahead * np.cos(middle), y + ahead * np.sin(middle),
                         wrap_angle(heading + turn)], -1)

    def episode_info(self, outcome):
        standing = (outcome == COLLISION) & (self._standing >= STANDING_STEPS)
        info = super().episode_info(np.where(standing, STANDING, outcome))
        x, y, theta = self.estimates.T.copy()
        return info | {"stops": self.stops.copy(), "estimate_x": x, "estimate_y": y,
                       "estimate_theta": theta}


class RealEnv(NavEnv):
    """One robot: RealVecEnv with R = 1."""
    vector_class = RealVecEnv


class RandomVecEnv(RealVecEnv):
    """RealVecEnv for a robot with unknown errors: each episode draws an appearance and all errors,
    uniformly up to GUESS (factors log-uniformly)."""

    def draw_errors(self, r):
        drawn = {"appearance": self.np_random.integers(DRAWN_APPEARANCES)}
        for name, item in ERRORS.items():
            no_error = np.array(item.default)
            low = 0.0 if item.metadata["low"] == 0 else -GUESS[name]
            error = self.np_random.uniform(low, GUESS[name], no_error.shape)
            drawn[name] = np.exp(error) if name in FACTORS else no_error + error
        return drawn


class RingVecEnv(RealVecEnv):
    """RealVecEnv with the ring of ultrasonic sensors, which stops the robot."""
    has_ring = True


class RandomRingVecEnv(RandomVecEnv):
    """RandomVecEnv with the same ring."""
    has_ring = True


def environment_of(scenes, ring=False, reality=""):
    """Returns the environment class for these Scenes: NavVecEnv if they have no errors. ring: True
    if ultrasonic sensors stop the robot. reality: "random", or "" for the errors of the scenes."""
    if reality == "random":
        return RandomRingVecEnv if ring else RandomVecEnv
    if ring:
        return RingVecEnv
    return RealVecEnv if any(scene.reality for scene in scenes) else NavVecEnv
