"""The task where reality interferes: `NavVecEnv` with the errors of a scene's `reality`, and with
the sensors that stop the robot.

Policy, stop, wheels, world, camera and odometry follow one another in every control period:

    action -> wanted command -> the ring's stop -> wheels -> the world moves
    true pose -> camera -> image;   true motion -> odometry -> estimated pose -> target

Episodes are judged by the true pose: arrival, collision and reward. The policy sees the estimate.

Axis letters: R robots, H = 48 and W = 64 image rows and columns, S sensors.
"""

import math

import numpy as np

from navbot_min import (ARRIVAL_REWARD, COLLISION_REWARD, NavEnv, NavVecEnv, polar_targets,
                        rewards)
from render import FOCAL, H, W
from robot import lens, ring
from robot.looks import DRAWN_LOOKS, drawn_cameras, own_cameras
from scenes.reality import KNOBS, Reality
from sim import CONTROL_PERIOD, wrap_angle
from support.checks import load_scenes

WHEELBASE = 0.23  # [m] between the wheels of a Kobuki
STANDING_STEPS = round(10 / CONTROL_PERIOD)  # 10 s without motion ahead end an episode, our choice
STANDING_SPEED = 0.01  # [m/s] slower is no motion ahead, our choice
SHORTEST_PERIOD = 0.25  # of a control period, our choice
SHORTEST_LAG = 1e-9  # [s] so that nothing is divided by 0
SIMULATION = Reality()
REALITIES = ("", "random")  # "": as a scene says
GUESS = {  # the largest errors that are drawn: our choice, 1.7 to 5 times the lab's
    "exposure": 0.5, "white_balance": 0.2, "light_change": 0.2, "image_noise": 12.0, "blur": 1.0,
    "camera_yaw": math.radians(4), "camera_pitch": math.radians(4), "distance_drift": 0.06,
    "turn_drift": 0.06, "veer": 0.03, "lag": 0.25, "wheel_gains": 0.08, "dead_zone": 0.02,
    "period_jitter": 0.1, "image_delay": 1.0, "dropped_images": 0.1, "range_noise": 0.02,
    "range_dropouts": 0.005}


def drawn_knobs(rng):
    """Values of all knobs, drawn up to GUESS: those that may be too small or too large evenly on
    both sides, all others evenly from 0 up."""
    drawn = {}
    for name, item in KNOBS.items():
        neutral = np.array(item.default)
        low = 0.0 if item.metadata["low"] == 0 else -GUESS[name]
        error = rng.uniform(low, GUESS[name], neutral.shape)
        is_factor = name in ("exposure", "white_balance", "wheel_gains")
        drawn[name] = np.exp(error) if is_factor else neutral + error
    return drawn


class RealVecEnv(NavVecEnv):
    """NavVecEnv with the errors of each scene's `reality`. Every knob is an attribute of its name
    with the values of the episodes under way, (R,), or (R, count) where it has several.

    `final_info` also holds `stops`, in how many periods of the episode the ring refused to drive
    on, and where odometry has the robot: `estimate_x`, `estimate_y` [m], `estimate_theta` [rad].
    """

    changing = (*NavVecEnv.changing, *KNOBS, "estimates", "asked", "stops", "_light", "_drift",
                "_delayed", "_before", "_distances", "_wheels", "_taken", "_shown", "_stood",
                "image_ages")
    has_ring = False  # whether its sensors stop the robot

    def __init__(self, num_envs=32, scenes=("lab",), *args, **options):
        """As NavVecEnv."""
        super().__init__(num_envs, scenes, *args, **options)
        R = num_envs
        realities = [scene.reality or SIMULATION for scene in self.world.scenes]
        self.camera = own_cameras(self.scenes)
        self.of_scene = {name: np.array([getattr(reality, name) for reality in realities], float)
                         for name in KNOBS}
        for name, values in self.of_scene.items():
            setattr(self, name, values.copy())
        self.estimates = np.zeros((R, 3))  # poses by odometry
        self.asked = np.zeros((R, 2))  # [m/s, rad/s] what the wheels were told
        self.stops = np.zeros(R, int)  # in this episode
        self._light = np.ones(R)  # factor of all colours in this episode
        self._drift = np.zeros((R, 3))  # errors of distance, turn and heading in this episode
        self._delayed = np.zeros(R, bool)  # whether images are a period old in this episode
        self._before = np.zeros((R, 3))  # true poses when odometry looked last
        self._distances = np.zeros(R)  # [m] to the targets by odometry, then
        self._wheels = np.zeros((R, 2))  # [m/s] speeds of the left and the right wheel
        self._taken = np.zeros((R, H, W, 3), np.uint8)  # the last image
        self._shown = np.zeros((R, H, W, 3), np.uint8)  # the last one that got to the policy
        self.image_ages = np.zeros(R, int)  # periods since that one was taken
        self._stood = np.zeros(R, int)  # periods without motion ahead, the last ones

    def draw_knobs(self, r):
        """The values of all knobs in robot r's next episode, name -> value."""
        return {name: values[r] for name, values in self.of_scene.items()}

    # ---------------------------------------------------------------- from the policy to the wheels

    def command(self, actions):
        """The motion (R, 2) [m/s, rad/s], as a mean over one nominal period, that actions (R, 2)
        come to: limited, stopped by the ring, as the wheels turn, and for as long as the period
        really is."""
        self.asked = self.stopped(super().command(actions))
        motion = self.turned(self.asked)
        self._stood = np.where(motion[:, 0] < STANDING_SPEED, self._stood + 1, 0)
        jitter = self.period_jitter * self.np_random.standard_normal(self.num_envs)
        return motion * np.maximum(1 + jitter, SHORTEST_PERIOD)[:, None]

    def stopped(self, wanted):
        """Commands (R, 2) after the ring has refused to drive on where the way is blocked."""
        if not self.has_ring:
            return wanted
        readings = ring.listen(self.world, self.range_noise, self.range_dropouts, self.np_random)
        refused = ring.is_blocked(readings, wanted) & (wanted[:, 0] > 0)
        self.stops = self.stops + refused
        return np.where(refused[:, None] & (True, False), 0.0, wanted)

    def turned(self, commands):
        """The mean motion (R, 2) over a period in which the wheels follow commands (R, 2). Those of
        a simulation follow exactly."""
        v = commands[:, :1]
        w = commands[:, 1:]
        told = v + w * WHEELBASE / 2 * (-1, 1)  # (R, 2) [m/s] left, right
        told = np.where(np.abs(told) < self.dead_zone[:, None], 0, told)
        told = told * self.wheel_gains
        # A first-order lag. A wheel's speed nears what it was told like exp(-t / lag).
        lag = np.maximum(self.lag, SHORTEST_LAG)[:, None]
        left_over = np.exp(-CONTROL_PERIOD / lag)
        difference = self._wheels - told
        mean = told + difference * (1 - left_over) * lag / CONTROL_PERIOD
        self._wheels = told + difference * left_over
        motion = np.stack([mean.mean(1), (mean[:, 1] - mean[:, 0]) / WHEELBASE], -1)
        exact = (self.lag == 0) & (self.dead_zone == 0) & (self.wheel_gains == 1).all(1)
        return np.where(exact[:, None], commands, motion)

    def is_standing(self):
        """Which robots (R,) have stood so long that their episodes end: only with the ring, which
        may leave them no way on."""
        return self.has_ring & (self._stood >= STANDING_STEPS)

    # ----------------------------------------------------------------- from the world to the policy

    def observe(self, robots, poses, goals, velocities, last_rewards):
        """What those robots see: an image as their cameras take it, the target as their odometry
        has it, and the velocity that they asked their wheels for."""
        robots = np.asarray(robots)
        new = robots[self._steps[robots] == 0]
        for r in new:
            self._begin_reality(r)
        self._measure(robots, new, poses)
        target = polar_targets(self.estimates[robots], goals)
        paid = self._believed_rewards(robots, new, target[:, 0], last_rewards)
        seen = super().observe(robots, self._mounted(robots, poses), goals, self.asked[robots],
                               paid)
        seen["image"] = self._delivered(robots, new, self._exposed(robots, seen["image"]))
        seen["target"] = target.astype(np.float32)
        return seen

    def _believed_rewards(self, robots, new, distances, true):
        """The last rewards (n,) as the robots know them: what was paid for nearing by their
        odometry, for the true ones would tell how far the target truly is. An end is felt.
        distances: (n,) [m] to the targets by odometry."""
        nearing = rewards(self._distances[robots], distances, False, False)
        self._distances[robots] = distances
        is_end = np.isin(true, (ARRIVAL_REWARD, COLLISION_REWARD))
        return np.where(np.isin(robots, new) | is_end, true, nearing)

    def _begin_reality(self, r):
        """Draws what is robot r's own in the episode that begins."""
        rng = self.np_random
        for name, value in self.draw_knobs(r).items():
            getattr(self, name)[r] = value
        self._light[r] = np.exp(self.light_change[r] * rng.standard_normal())
        sigmas = np.array([self.distance_drift[r], self.turn_drift[r], self.veer[r]])
        self._drift[r] = sigmas * rng.standard_normal(3)
        self._delayed[r] = rng.random() < self.image_delay[r]
        for array in (self.asked, self._wheels, self.stops, self._stood):
            array[r] = 0

    def _measure(self, robots, new, poses):
        """Odometry: adds what the robots have moved, with its errors, to the estimated poses. New
        episodes begin at the true pose."""
        before = self._before[robots]
        turn = wrap_angle(poses[:, 2] - before[:, 2])
        middle = before[:, 2] + turn / 2
        step = poses[:, :2] - before[:, :2]
        ahead = step[:, 0] * np.cos(middle) + step[:, 1] * np.sin(middle)
        distance, bend, veer = self._drift[robots].T
        turn = turn * (1 + bend) + veer * np.abs(ahead)
        ahead = ahead * (1 + distance)
        estimate = self.estimates[robots]
        middle = estimate[:, 2] + turn / 2
        motion = np.stack([ahead * np.cos(middle), ahead * np.sin(middle), turn], -1)
        estimate = estimate + motion
        estimate[:, 2] = wrap_angle(estimate[:, 2])
        begins = np.isin(robots, new)[:, None]
        self.estimates[robots] = np.where(begins, poses, estimate)
        self._before[robots] = poses

    def _mounted(self, robots, poses):
        """The poses (n, 3) that the cameras look along."""
        looking = poses.copy()
        looking[:, 2] += self.camera_yaw[robots]
        return looking

    def _exposed(self, robots, images):
        """The images (n, H, W, 3) uint8 as the cameras take them. What has no effect is left out,
        and so a simulation's images stay as they are, exactly."""
        taken = images.astype(np.float32)
        pitch = self.camera_pitch[robots]
        if pitch.any():
            taken = lens.shift_rows(taken, FOCAL * np.tan(pitch))
        blur = self.blur[robots]
        if blur.any():
            taken = lens.blurred(taken, blur)
        gain = self.exposure[robots] * self._light[robots]
        gains = gain[:, None] * self.white_balance[robots]  # (n, 3)
        taken = taken * gains[:, None, None].astype(np.float32)
        noise = self.image_noise[robots]
        if noise.any():
            taken = lens.noisy(taken, noise, self.np_random)
        return taken.clip(0, 255).round().astype(np.uint8)

    def _delivered(self, robots, new, images):
        """What of these images (n, H, W, 3) gets to the policy: some come a period late, some not
        at all."""
        begins = np.isin(robots, new)
        late = self._delayed[robots] & ~begins
        dropped = (self.np_random.random(len(robots)) < self.dropped_images[robots])
        dropped &= ~begins
        arriving = np.where(late[:, None, None, None], self._taken[robots], images)
        shown = np.where(dropped[:, None, None, None], self._shown[robots], arriving)
        self._taken[robots] = images
        self._shown[robots] = shown
        ages = np.where(dropped, self.image_ages[robots] + 1, late)
        self.image_ages[robots] = ages
        return shown

    def figures(self, outcome):
        x, y, theta = self.estimates.T.copy()
        return super().figures(outcome) | {"stops": self.stops.copy(), "estimate_x": x,
                                           "estimate_y": y, "estimate_theta": theta}


class RealEnv(NavEnv):
    """One robot: RealVecEnv with R = 1."""

    vector_class = RealVecEnv


class RandomVecEnv(RealVecEnv):
    """Reality of which only the size is guessed: in every episode the knobs are drawn anew, up to
    GUESS, and one of DRAWN_LOOKS looks."""

    changing = (*RealVecEnv.changing, "looks")

    def __init__(self, num_envs=32, scenes=("env2",), *args, **options):
        """As NavVecEnv."""
        given = load_scenes(scenes, most=num_envs)
        each = [given[r % len(given)] for r in range(num_envs)]  # one for each robot
        super().__init__(num_envs, each, *args, **options)
        self.looks = np.zeros(num_envs, int)  # indices into the drawn looks
        self.camera = drawn_cameras(self.scenes, self.looks)

    def draw_knobs(self, r):
        self.looks[r] = self.np_random.integers(DRAWN_LOOKS)
        return drawn_knobs(self.np_random)

    def load_state(self, state):
        super().load_state(state)
        self.camera.look_of = self.looks


class RingVecEnv(RealVecEnv):
    """The same with the ultrasonic sensors, which stop the robot."""

    has_ring = True


class RandomRingVecEnv(RandomVecEnv):
    """Both."""

    has_ring = True


def environment_of(scenes, ring=False, reality=""):
    """The environment's class for those Scenes: NavVecEnv where reality does not interfere.

    ring: whether ultrasonic sensors stop the robot. reality: "random" draws it anew each episode;
    "" is as the scenes say.
    """
    if reality == "random":
        return RandomRingVecEnv if ring else RandomVecEnv
    if ring:
        return RingVecEnv
    return RealVecEnv if any(scene.reality for scene in scenes) else NavVecEnv
