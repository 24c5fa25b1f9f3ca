"""Drives episodes: the one loop behind evaluation, film and demo, and what it keeps of them.
R robots, T steps of an episode, H = 48 and W = 64 image rows and columns."""

from dataclasses import dataclass

import numpy as np
from tqdm import tqdm

from sim import CONTROL_PERIOD, Scene, wrap_angle


@dataclass(eq=False)
class Trace:
    """One whole episode. Step t leads from pose and image t to pose and image t + 1."""
    scene: Scene
    target: int  # index into scene.targets; without meaning if episodes lead anywhere
    new: bool  # whether that target is only for tests
    goal: np.ndarray  # (2,) [m]
    poses: np.ndarray  # (T + 1, 3) [m, m, rad]
    commands: np.ndarray  # (T, 2) [m/s, rad/s] as executed
    rewards: np.ndarray  # (T,)
    outcome: str  # one of the environment's `outcomes`
    images: np.ndarray | None = None  # (T + 1, H, W, 3) uint8, if they were asked for
    activations: dict | None = None  # of (T, ...) arrays, what the driver kept in its `activations`
    stops: int = 0  # periods in which the ring's sensors refused to drive on
    label: str = ""  # words below its film

    def __post_init__(self):
        self.start = self.poses[0]
        self.seconds = len(self.commands) * CONTROL_PERIOD
        # A collision stops the robot earlier than its last command says.
        self.metres = float(self.commands[:, 0].sum() * CONTROL_PERIOD)
        self.arrived = self.outcome == "arrival"

    def __str__(self):
        kind = "new" if self.new else "training"
        return (f"{kind} target {tuple(self.goal.tolist())}: {self.outcome} after "
                f"{self.seconds:.1f} s, return {self.rewards.sum():.1f}")


def trace_of(env, r, steps, infos, images):
    """Returns the Trace of robot r's episode, which has just ended. steps: dicts of (R, ...)."""
    columns = {name: np.array([step[name][r] for step in steps]) for name in steps[0]}
    final = {name: value[r] for name, value in infos["final_info"].items()}
    x, y, theta = columns.pop("start")[0]
    return Trace(scene=env.scenes[env.scene_of[r]], target=int(final["target_index"]),
                 new=bool(final["new"]), goal=columns.pop("goal")[0],
                 poses=np.array([(x, y, wrap_angle(theta)), *columns.pop("pose")]),
                 commands=columns.pop("command"), rewards=columns.pop("reward"),
                 outcome=env.outcomes[final["outcome"]],
                 images=np.array([*columns.pop("image"), infos["final_obs"]["image"][r]])
                 if images else None,
                 stops=int(final.get("stops", 0)), activations=columns or None)


class TurnToTarget:
    """The demo's driver: turns to the target, and drives when it is ahead. Blind to walls."""

    def reset(self, env, robots):
        """Remembers nothing."""

    def act(self, env, observations):
        """Returns actions (R, 2)."""
        bearing = observations["target"][:, 1]
        return np.stack([np.maximum(np.cos(bearing), 0), np.clip(2 * bearing, -1, 1)], -1)


def drive(driver, env, quota, seed=0, images=False):
    """Drives until every robot has its quota of episodes; returns their Traces, in the order in
    which they end.

    driver: has `reset(env, robots)`, called with the indices of robots whose episodes begin, and
    `act(env, observations)`, which returns actions (R, 2); and may have `activations`, a dict of
    (R, ...) arrays that are worth keeping of its last `act`. quota: how many episodes count, of
    each robot its first ones; (R,), or one for all. images: whether to keep what the camera saw.

    Which episodes count is fixed before they start: counting the first n that end would favour
    short ones, the collisions. A robot that has its quota drives on, and nothing of it is kept.
    """
    left = np.broadcast_to(quota, env.num_envs).copy()  # (R,) episodes that are still to come
    observations, _ = env.reset(seed=seed)
    driver.reset(env, np.arange(env.num_envs))
    under_way = {r: [] for r in np.flatnonzero(left)}  # robot -> the steps of its episode
    traces = []
    bar = tqdm(total=left.sum(), unit=" episodes", leave=False, disable=None)
    while under_way:
        step = {"start": env.starts.copy(), "goal": env.goals.copy()}
        if images:
            step["image"] = observations["image"].copy()
        actions = driver.act(env, observations)
        step |= {name: value.copy() for name, value in getattr(driver, "activations", {}).items()}
        observations, rewards, terminated, truncated, infos = env.step(actions)
        step |= {"pose": infos["pose"], "command": infos["command"], "reward": rewards}
        for steps in under_way.values():
            steps.append(step)  # one dict for all of them
        done = terminated | truncated
        for r in np.flatnonzero(done & (left > 0)):
            traces.append(trace_of(env, r, under_way.pop(r), infos, images))
            bar.update()
            left[r] -= 1
            if left[r] > 0:
                under_way[r] = []
        if done.any():
            driver.reset(env, np.flatnonzero(done))
    bar.close()
    return traces
