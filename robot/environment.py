"""The task with a robot's errors, those of a scene's `reality`, and with the sensors that stop the
robot. docs/robot.md shows the order of it all. Axis letters: R robots, H = 48 and W = 64 image rows
and columns."""

import math
from dataclasses import asdict

import numpy as np

from navbot_min import COLLISION, OUTCOMES, NavEnv, NavVecEnv, polar_targets
from render import FOCAL, H, W
from robot import ring
from robot.appearance import DRAWN_APPEARANCES, Cameras
from scenes.reality import ERRORS, Reality
from sim import ARRIVAL_DISTANCE, CONTROL_PERIOD, wrap_angle

WHEELBASE = 0.23  # [m] between the wheels of a Kobuki
STANDING_STEPS = round(10 / CONTROL_PERIOD)  # 10 s without motion ahead end an episode, our choice
STANDING_SPEED = 0.01  # [m/s] slower is no motion ahead, our choice
STANDING = len(OUTCOMES)  # index of the lab's own outcome
FACTORS = ("exposure", "white_balance", "wheel_gains")  # errors that are factors
GUESS = {  # the largest errors that are drawn: our choice, 1.9 to 5 times the lab's
    "exposure": 0.5, "white_balance": 0.2, "camera_yaw": math.radians(4),
    "camera_pitch": math.radians(4), "distance_drift": 0.06, "turn_drift": 0.06,
    "wheel_gains": 0.08, "image_delay": 1.0}


def shift_rows(images, rows):
    """Returns images (R, H, W, 3) of floats moved down by (R,) rows, whole or not, as a camera that
    looks up sees them. What comes in repeats the edge."""
    source = np.clip(np.arange(H) - rows[:, None], 0, H - 1)  # (R, H)
    above = np.floor(source).astype(int)
    below = np.minimum(above + 1, H - 1)
    share = (source - above)[..., None, None].astype(images.dtype)
    robot = np.arange(len(images))[:, None]
    return images[robot, above] * (1 - share) + images[robot, below] * share


class RealVecEnv(NavVecEnv):
    """NavVecEnv with the errors of each scene's `reality`. Every error is an attribute of its name
    with the values of the episodes under way, (R,), or (R, count) if it has several.

    With the ring an episode can also end as `standing`. `final_info` also holds `stops`, in how
    many periods the ring refused to drive on, and the pose by odometry, `estimate_x`, `estimate_y`
    and `estimate_theta`. A subclass's `reward` is asked twice in a step: for what is paid, by the
    true pose, and for what the robot believes.
    """

    outcomes = (*OUTCOMES, "standing")
    has_ring = False  # whether its sensors stop the robot

    def __init__(self, num_envs=32, scenes=("lab",), *args, **options):
        """As NavVecEnv."""
        super().__init__(num_envs, scenes, *args, **options)
        R = num_envs
        self.appearance = np.full(R, "simulation", object)
        # Each robot has a scene of its own, so that each can have its own appearance.
        self.scenes = self.world.scenes
        self.scene_of = np.arange(R)
        self.camera = Cameras(self.scenes, self.appearance)
        for name, item in ERRORS.items():
            setattr(self, name, np.zeros((R, *np.shape(item.default))))
        self.estimates = np.zeros((R, 3))  # poses by odometry
        self.asked = np.zeros((R, 2))  # [m/s, rad/s] what the wheels were told
        self.stops = np.zeros(R, int)  # in this episode
        self._drift = np.zeros((R, 2))  # errors of distance and turn in this episode
        self.is_late = np.zeros(R, bool)  # whether images after the first are a period old
        self._taken = np.zeros((R, H, W, 3), np.uint8)  # the last images
        self._before = np.zeros((R, 3))  # true poses before the last period
        self._stood = np.zeros(R, int)  # periods without motion ahead, the last ones
        self._failed = np.zeros(R, bool)  # what `drive` has returned

    @staticmethod
    def check_rooms(scenes):
        """Accepts every room."""

    def draw_errors(self, r):
        """Returns the appearance and all errors of robot r's next episode, by name."""
        return asdict(self.scenes[r].reality or Reality())

    def command(self, actions):
        """Returns the motion (R, 2) [m/s, rad/s] that actions (R, 2) come to: limited, stopped by
        the ring, and as the wheels turn. Without an error it is exactly the command."""
        self.asked = super().command(actions)
        if self.has_ring:
            refused = ring.is_blocked(ring.listen(self.world), self.asked) & (self.asked[:, 0] > 0)
            self.stops += refused
            self.asked[refused, 0] = 0
        v, w = self.asked.T
        left, right = self.wheel_gains.T
        mean = (left + right) / 2
        apart = (right - left) / WHEELBASE
        return np.stack([v * mean + w * apart * (WHEELBASE / 2) ** 2, w * mean + v * apart], -1)

    def drive(self, commands):
        """Drives all robots for one control period. Returns (R,) bool: which of them collided or,
        with the ring, which may leave a robot no way, have stood for STANDING_STEPS."""
        self._before = self.world.poses
        collided = super().drive(commands)
        stands = self.has_ring & ~collided & (commands[:, 0] < STANDING_SPEED)
        self._stood = np.where(stands, self._stood + 1, 0)
        self._failed = collided | (self._stood >= STANDING_STEPS)
        return self._failed

    def observe(self, robots, poses, goals, velocities, last_rewards):
        """Returns what these robots (n,) see: the image as their cameras take it, the target and
        the last reward by their odometry, and the velocity that they asked their wheels for."""
        begins = not self._steps[robots].any()  # all of these episodes begin, or none of them
        if begins:
            for r in robots:
                self._begin_reality(r)
            self.estimates[robots] = poses
        else:
            before = polar_targets(self.estimates, goals)[:, 0]
            self.estimates = self._measured(poses)
            after = polar_targets(self.estimates, goals)[:, 0]
            ended = self._failed | (polar_targets(poses, goals)[:, 0] < ARRIVAL_DISTANCE)
            # An end is felt. The true reward for nearing would tell how far the target truly is.
            believed = self.reward(before, after, False & ended, False & ended)
            last_rewards = np.where(ended, last_rewards, believed)
        looking = poses.copy()
        looking[:, 2] += self.camera_yaw[robots]
        seen = super().observe(robots, looking, goals, self.asked[robots], last_rewards)
        seen["target"] = polar_targets(self.estimates[robots], goals).astype(np.float32)
        gains = self.exposure[robots, None] * self.white_balance[robots]  # (n, 3)
        rows = FOCAL * np.tan(self.camera_pitch[robots])
        images = shift_rows(seen["image"].astype(np.float32), rows)
        images = images * gains[:, None, None].astype(np.float32)
        images = images.clip(0, 255).round().astype(np.uint8)
        is_old = self.is_late[robots, None, None, None] & (not begins)
        seen["image"] = np.where(is_old, self._taken[robots], images)
        self._taken[robots] = images
        return seen

    def _begin_reality(self, r):
        """Draws what is robot r's own in the episode that begins."""
        for name, value in self.draw_errors(r).items():
            getattr(self, name)[r] = value
        sigmas = np.array([self.distance_drift[r], self.turn_drift[r]])
        self._drift[r] = sigmas * self.np_random.standard_normal(2)
        self.is_late[r] = self.np_random.random() < self.image_delay[r]
        for array in (self.asked, self.stops, self._stood):
            array[r] = 0

    def _measured(self, poses):
        """Returns the poses (R, 3) by odometry, after what truly led to poses (R, 3)."""
        ahead, aside = (poses - self._before)[:, :2].T
        turn = wrap_angle(poses[:, 2] - self._before[:, 2])
        middle = self._before[:, 2] + turn / 2
        ahead = ahead * np.cos(middle) + aside * np.sin(middle)
        ahead = ahead * (1 + self._drift[:, 0])
        turn = turn * (1 + self._drift[:, 1])
        x, y, heading = self.estimates.T
        middle = heading + turn / 2
        return np.stack([x + ahead * np.cos(middle), y + ahead * np.sin(middle),
                         wrap_angle(heading + turn)], -1)

    def episode_info(self, outcome):
        stood = (outcome == COLLISION) & (self._stood >= STANDING_STEPS)
        info = super().episode_info(np.where(stood, STANDING, outcome))
        x, y, theta = self.estimates.T.copy()
        return info | {"stops": self.stops.copy(), "estimate_x": x, "estimate_y": y,
                       "estimate_theta": theta}


class RealEnv(NavEnv):
    """One robot: RealVecEnv with R = 1."""
    vector_class = RealVecEnv


class RandomVecEnv(RealVecEnv):
    """Errors of which only the size is guessed: in every episode the appearance and the errors
    are drawn again, evenly, up to GUESS. Of factors the logarithm is drawn."""

    def draw_errors(self, r):
        drawn = {"appearance": self.np_random.integers(DRAWN_APPEARANCES)}
        for name, item in ERRORS.items():
            no_error = np.array(item.default)
            low = 0.0 if item.metadata["low"] == 0 else -GUESS[name]
            error = self.np_random.uniform(low, GUESS[name], no_error.shape)
            drawn[name] = np.exp(error) if name in FACTORS else no_error + error
        return drawn


class RingVecEnv(RealVecEnv):
    """RealVecEnv with the ultrasonic sensors, which stop the robot."""
    has_ring = True


class RandomRingVecEnv(RandomVecEnv):
    """RandomVecEnv with the same sensors."""
    has_ring = True


def environment_of(scenes, ring=False, reality=""):
    """Returns the class of environment for these Scenes: NavVecEnv if nothing errs. ring: whether
    ultrasonic sensors stop the robot. reality: "random", or "" for the errors of the scenes."""
    if reality == "random":
        return RandomRingVecEnv if ring else RandomVecEnv
    if ring:
        return RingVecEnv
    return RealVecEnv if any(scene.reality for scene in scenes) else NavVecEnv
