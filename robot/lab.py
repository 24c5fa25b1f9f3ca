"""The lab as a Robot: one robot of the simulated world, asked and told as a real one is."""

import numpy as np

from navbot_min import MAX_COMMAND, OUTCOMES
from robot import ring
from robot.environment import RealVecEnv
from robot.robot import Stamped
from sim import CONTROL_PERIOD


class LabRobot:
    """A Robot (`robot.robot.Robot`) that drives in a Scene. Its clock stands still but in
    `sleep_until`. After an arrival or a collision, by its true pose, it stands, and measures what
    it measured last."""

    def __init__(self, scene, target, seed=0, start=None):
        """target: an index into `scene.targets`, where the cube stands. start: a pose (3,); by
        default the scene's."""
        self.env = RealVecEnv(1, [scene], "both", max_episode_steps=-1)
        options = {"target": target}
        if start is not None:
            options["start"] = start
        seen, _ = self.env.reset(seed=seed, options=options)
        self.goal = self.env.goals[0].copy()
        self.outcome = ""  # "arrival" or "collision", by the true pose
        self.true_poses = [self.env.world.poses[0]]
        self._periods = 0
        self._command = np.zeros(2)
        self._measure(seen["image"][0], self.env.estimates[0])

    def _measure(self, image, estimate):
        """What the sensors say now. estimate: the pose (3,) by odometry."""
        env = self.env
        age = 0 if self.outcome else env.image_ages[0]
        taken = self.now() - age * CONTROL_PERIOD
        self._image = Stamped(image.copy(), taken)
        self._odometry = Stamped(np.array(estimate), self.now())
        if not self.outcome:  # else the world is the next episode's
            [readings] = ring.listen(env.world, env.range_noise, env.range_dropouts, env.np_random)
            self._readings = readings
        self._ranges = Stamped(self._readings, self.now())

    def now(self):
        return self._periods * CONTROL_PERIOD

    def sleep_until(self, time):
        while self.now() < time - 1e-9:
            self._periods += 1
            if not self.outcome:
                self._move()

    def _move(self):
        """One period of driving."""
        action = self._command / MAX_COMMAND
        seen, _, terminated, _, infos = self.env.step(action[None])
        self.true_poses.append(infos["pose"][0])
        estimate = self.env.estimates[0]
        if terminated[0]:  # the environment has begun another episode, which is not ours
            end = infos["final_info"]
            self.outcome = OUTCOMES[end["outcome"][0]]
            seen = infos["final_obs"]
            estimate = [end[f"estimate_{part}"][0] for part in ("x", "y", "theta")]
        self._measure(seen["image"][0], estimate)

    def image(self):
        return self._image

    def odometry(self):
        return self._odometry

    def ranges(self):
        return self._ranges

    def send(self, linear, angular):
        self._command = np.array([linear, angular])
