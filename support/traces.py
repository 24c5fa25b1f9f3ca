"""Drives episodes: the one loop behind evaluation, film and demo, and what it keeps of them.

Axis letters: R robots, T steps of an episode, H = 48 and W = 64 image rows and columns.
"""

from dataclasses import dataclass

import numpy as np
from tqdm import tqdm

from sim import CONTROL_PERIOD, Scene, wrap_angle

OUTCOMES = ("arrival", "collision", "timeout", "standing")  # as the environment numbers them


@dataclass(eq=False)
class Trace:
    """One whole episode. Step t leads from pose and image t to pose and image t + 1."""
    scene: Scene
    target: int  # index into scene.targets; without meaning where episodes lead anywhere
    new: bool  # whether that target is for tests alone
    goal: np.ndarray  # (2,) [m]
    poses: np.ndarray  # (T + 1, 3) [m, m, rad]
    commands: np.ndarray  # (T, 2) [m/s, rad/s] as executed
    rewards: np.ndarray  # (T,)
    outcome: str  # one of OUTCOMES
    images: np.ndarray | None = None  # (T + 1, H, W, 3) uint8, where they were asked for
    thoughts: dict | None = None  # of (T, ...) arrays, what the driver kept in its `thoughts`
    stops: int = 0  # periods in which the ring's sensors refused to drive on
    label: str = ""  # what a film says of the episode

    def __str__(self):
        kind = "new" if self.new else "training"
        return (f"{kind} target {tuple(self.goal.tolist())}: {self.outcome} after "
                f"{self.seconds:.1f} s, return {self.total_reward:.1f}")

    @property
    def start(self):
        """The first pose (3,)."""
        return self.poses[0]

    @property
    def metres(self):
        """The way driven [m], as commanded: in a collision the robot stops a little earlier."""
        return float(self.commands[:, 0].sum() * CONTROL_PERIOD)

    @property
    def seconds(self):
        """How long the episode took [s]."""
        return len(self.commands) * CONTROL_PERIOD

    @property
    def arrived(self):
        """Whether the robot reached its goal."""
        return self.outcome == "arrival"

    @property
    def total_reward(self):
        """The episode's return, not discounted."""
        return float(self.rewards.sum())


class Recording:
    """What is kept of robot r's episode while it is under way."""

    def __init__(self, env, r, observations, images):
        """observations: what the robots see as the episode begins. images: whether to keep them."""
        x, y, theta = env.starts[r]
        self.r = r
        self.scene = env.scenes[env.scene_of[r]]
        self.goal = env.goals[r].copy()
        self.poses = [np.array([x, y, wrap_angle(theta)])]
        self.commands = []
        self.rewards = []
        self.thoughts = []
        self.images = None
        if images:
            self.images = [observations["image"][r].copy()]

    def add(self, observations, rewards, done, infos, thoughts):
        """One step, as the environment returns it. done: (R,) whether episodes ended by it.
        thoughts: of (R, ...) arrays, the driver's as it chose that step."""
        r = self.r
        self.thoughts.append({name: value[r].copy() for name, value in thoughts.items()})
        self.poses.append(infos["pose"][r].copy())
        self.commands.append(infos["command"][r].copy())
        self.rewards.append(rewards[r])
        if self.images is None:
            return
        if done[r]:  # the observations are those of the next episode already
            self.images.append(infos["final_obs"]["image"][r].copy())
        else:
            self.images.append(observations["image"][r].copy())

    def trace(self, final_info):
        """The Trace of the episode, which has ended."""
        return Trace(
            scene=self.scene,
            target=int(final_info["target_index"][self.r]),
            new=bool(final_info["new"][self.r]),
            goal=self.goal,
            poses=np.array(self.poses),
            commands=np.array(self.commands),
            rewards=np.array(self.rewards),
            outcome=OUTCOMES[final_info["outcome"][self.r]],
            images=None if self.images is None else np.array(self.images),
            thoughts={name: np.array([step[name] for step in self.thoughts])
                      for name in self.thoughts[0]} or None,
            stops=int(final_info["stops"][self.r]) if "stops" in final_info else 0)


class TurnToTarget:
    """The demo's driver: turns to the target, and drives when it is ahead. Blind to walls."""

    label = "turn to the target and go"

    def reset(self, env, robots):
        """Remembers nothing, so an episode's start changes nothing."""

    def act(self, env, observations):
        """Actions (R, 2) from what the robots see."""
        bearing = observations["target"][:, 1]
        linear = np.maximum(np.cos(bearing), 0)
        angular = np.clip(2 * bearing, -1, 1)
        return np.stack([linear, angular], -1)


def drive(driver, env, quota, seed=0, images=False):
    """Drives until every robot has its quota of episodes; returns their Traces, in the order in
    which they end.

    driver: has `reset(env, robots)`, called with the indices of robots whose episodes begin, and
    `act(env, observations)`, which returns actions (R, 2); and may have `thoughts`, a dict of
    (R, ...) arrays that are worth keeping of its last `act`. env: a NavVecEnv. quota: (R,) how many
    episodes count, of each robot its first ones. seed: of the environment's random numbers.
    images: whether to keep what the camera saw. Raises ValueError for a quota of another shape.

    Which episodes count is fixed before they start: counting the first n that end would favour
    short ones, the collisions. A robot that has its quota drives on, and nothing of it is kept.
    """
    left = np.array(quota)  # (R,) episodes that are still to come
    if left.shape != (env.num_envs,):
        raise ValueError(f"quota has shape {left.shape}, it must be ({env.num_envs},): a number of "
                         "episodes for each robot")
    observations, _ = env.reset(seed=seed)
    driver.reset(env, np.arange(env.num_envs))
    under_way = {}  # robot -> the Recording of its episode
    for r in np.flatnonzero(left):
        under_way[r] = Recording(env, r, observations, images)
    traces = []
    bar = tqdm(total=left.sum(), unit=" episodes", leave=False, disable=None)
    while under_way:
        actions = driver.act(env, observations)
        observations, rewards, terminated, truncated, infos = env.step(actions)
        done = terminated | truncated
        for recording in under_way.values():
            recording.add(observations, rewards, done, infos, getattr(driver, "thoughts", {}))
        for r in np.flatnonzero(done & (left > 0)):
            traces.append(under_way.pop(r).trace(infos["final_info"]))
            bar.update()
            left[r] -= 1
            if left[r] > 0:
                under_way[r] = Recording(env, r, observations, images)
        if done.any():
            driver.reset(env, np.flatnonzero(done))
    bar.close()
    return traces
