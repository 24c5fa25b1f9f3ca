"""A simulation as a Robot: one robot with the interface of a real one, in the lab or in MuJoCo."""

import numpy as np

from navbot_min import MAX_COMMAND
from robot.environment import RealVecEnv
from robot.robot import Stamped
from sim import CONTROL_PERIOD


class LabRobot:
    """A Robot that drives in a Scene. Its clock runs only in `sleep_until`. After an arrival or a
    collision, by its true pose, it stands still and repeats its last measurements."""

    def __init__(self, scene, target, seed=0, environment=RealVecEnv):
        """target: an index into `scene.targets`, the position of the cube. environment: RealVecEnv
        or robot.mujoco_robot.MujocoVecEnv."""
        self.env = environment(1, [scene], "both", max_episode_steps=-1)
        seen, _ = self.env.reset(seed=seed, options={"target": target})
        self.goal = self.env.goals[0].copy()
        self.outcome = ""  # "arrival" or "collision", by the true pose
        self.true_poses = [self.env.world.poses[0]]
        self._periods = 0
        self._command = np.zeros(2)
        self._sense(seen["image"][0], self.env.estimates[0])

    def _sense(self, image, estimate):
        """Measures with all sensors. estimate: the pose (3,) by odometry."""
        age = 0
        if not self.outcome:  # otherwise the world already holds the next episode
            age = CONTROL_PERIOD * (self.env.is_late[0] and self._periods > 0)
            [self._readings] = self.env.ranges()
        self._image = Stamped(image.copy(), self.now() - age)
        self._odometry = Stamped(np.array(estimate), self.now())

    def now(self):
        return self._periods * CONTROL_PERIOD

    def sleep_until(self, time):
        while self.now() < time - 1e-9:
            self._periods += 1
            if self.outcome:
                continue
            action = self._command / MAX_COMMAND
            seen, _, [terminated], _, infos = self.env.step(action[None])
            self.true_poses.append(infos["pose"][0])
            estimate = self.env.estimates[0]
            if terminated:  # the environment has already begun the next episode
                end = infos["final_info"]
                self.outcome = self.env.outcomes[end["outcome"][0]]
                seen = infos["final_obs"]
                estimate = [end[f"estimate_{part}"][0] for part in ("x", "y", "theta")]
            self._sense(seen["image"][0], estimate)

    def image(self):
        return self._image

    def odometry(self):
        return self._odometry

    def ranges(self):
        return Stamped(self._readings, self._odometry.time)

    def send(self, linear, angular):
        self._command = np.array([linear, angular])
