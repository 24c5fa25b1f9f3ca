"""Drives episodes and records them: the loop that evaluation, film and demo share. Axis letters:
R robots, T steps of an episode, H = 48 and W = 64 image rows and columns."""

from dataclasses import dataclass

import numpy as np
from tqdm import tqdm

from sim import CONTROL_PERIOD, Scene, wrap_angle


@dataclass(eq=False)
class Trace:
    """One whole episode. Step t leads from pose and image t to pose and image t + 1."""
    scene: Scene
    target: int  # index into scene.targets; has no meaning for random targets
    new: bool  # whether this is a new target
    goal: np.ndarray  # (2,) [m]
    poses: np.ndarray  # (T + 1, 3) [m, m, rad]
    commands: np.ndarray  # (T, 2) [m/s, rad/s], as executed
    rewards: np.ndarray  # (T,)
    outcome: str  # one of the environment's `outcomes`
    images: np.ndarray | None = None  # (T + 1, H, W, 3) uint8, if requested
    activations: dict | None = None  # (T, ...) arrays from the driver's `activations`
    stops: int = 0  # steps in which the ring of range sensors stopped the robot
    label: str = ""  # caption of its film

    def __post_init__(self):
        self.start = self.poses[0]
        self.seconds = len(self.commands) * CONTROL_PERIOD
        # A robot that collides stops during its last step, so this is slightly too large.
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
    """The demo's driver: turns to the target, and drives if it is ahead. It ignores walls."""

    def reset(self, env, robots):
        """Does nothing: this driver has no memory."""

    def act(self, env, observations):
        """Returns actions (R, 2)."""
        bearing = observations["target"][:, 1]
        return np.stack([np.maximum(np.cos(bearing), 0), np.clip(2 * bearing, -1, 1)], -1)


def drive(driver, env, quota, seed=0, images=False):
    """Drives until every robot has completed its quota of episodes. Returns their Traces, in the
    order in which they end.

    driver: has `reset(env, robots)`, called with the indices of robots whose episodes begin, and
    `act(env, observations)`, which returns actions (R, 2). It may have `activations`, a dict of
    (R, ...) arrays to record from its last `act`. quota: number of each robot's first episodes to
    record, (R,) or one number for all. images: whether to record the camera images.

    The quotas are fixed before the episodes start: the first n episodes to end would be mostly
    short ones, collisions. After its quota a robot continues, but is no longer recorded.
    """
    left = np.broadcast_to(quota, env.num_envs).copy()  # (R,) episodes still to record
    observations, _ = env.reset(seed=seed)
    driver.reset(env, np.arange(env.num_envs))
    under_way = {r: [] for r in np.flatnonzero(left)}  # robot -> steps of its episode
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
            steps.append(step)  # all robots share the dict
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
