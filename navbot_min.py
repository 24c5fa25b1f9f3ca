"""The task: what the robot sees, may do, is paid, and when an episode ends (paper III).

`NavVecEnv` runs R robots at once and is the thing itself; `NavEnv` is one robot. Both are Gymnasium
environments. `python navbot_min.py --env env1` drives one robot by a simple rule and draws it.

Axis letters: R robots, H = 48 and W = 64 image rows and columns.
"""

import gymnasium as gym
import numpy as np
from gymnasium.error import ResetNeeded
from gymnasium.spaces import Box, Dict
from gymnasium.vector import AutoresetMode, VectorEnv
from gymnasium.vector.utils import batch_space

from command_line import CommandLine
from pictures import draw_demo
from render import Camera, H, W
from scene_file import SCENE_FOLDER, load_scene
from sim import (ARRIVAL_DISTANCE, CONTROL_PERIOD, MAX_ANGULAR_VELOCITY, MAX_LINEAR_VELOCITY,
                 ROBOT_RADIUS, Scene, SceneError, World, wrap_angle)

ARRIVAL_REWARD, COLLISION_REWARD = 100.0, -50.0  # released config
PROGRESS_REWARD, STEP_COST = 100.0, 0.05  # c_r [1/m] and c_p of Eq. (4), released config
MAX_EPISODE_STEPS = 200  # 80 s, our choice; the released script allows 1000
MAX_COMMAND = np.array([MAX_LINEAR_VELOCITY, MAX_ANGULAR_VELOCITY])  # [m/s, rad/s]
OUTCOMES = ("arrival", "collision", "timeout")


def polar_targets(poses, targets):
    """Distance [m] and bearing [rad] in (-pi, pi], (R, 2), of targets (R, 2) from poses (R, 3)."""
    dx, dy = (targets - poses[:, :2]).T
    return np.stack([np.hypot(dx, dy), wrap_angle(np.arctan2(dy, dx) - poses[:, 2])], -1)


def rewards(before, after, arrived, hit):
    """Eq. (4): rewards (R,) for distances before and after [m]; arrival wins over collision."""
    progress = PROGRESS_REWARD * (before - after) - STEP_COST
    return np.where(arrived, ARRIVAL_REWARD, np.where(hit, COLLISION_REWARD, progress))


class NavVecEnv(VectorEnv):
    """R robots, each on its own way to a target; one that ends its episode starts the next at once.

    An observation is a dict of `image` (R, H, W, 3) uint8 RGB, `target` (R, 2) distance [m] and
    bearing [rad], `velocity` (R, 2) the last command as executed [m/s, rad/s], and `reward` (R, 1)
    the last reward; the last two are 0 at an episode's start. An action (R, 2) holds the linear
    velocity in [0, 1] and the angular in [-1, 1] as fractions of their maxima, and is clipped.

    Arrival and collision terminate an episode, the step limit truncates it. Autoreset is same-step.
    `infos["pose"]` (R, 3) are the poses that the step led to. At an episode's end
    `infos["final_obs"][r]` is the episode's last observation and `infos["final_info"]` holds
    its `outcome`, `return`, `length`, `target` (index into the scene's targets) and `new`.
    `goals` (R, 2) and `starts` (R, 3) are those of the episodes under way.
    """

    metadata = {"render_modes": [], "autoreset_mode": AutoresetMode.SAME_STEP}

    def __init__(self, num_envs=32, env="env1", targets="both", random_starts=0.0,
                 max_episode_steps=MAX_EPISODE_STEPS):
        """env: a scene's name, path or Scene, or a list of these that robots take in turn.
        targets: the episodes' targets, drawn uniformly from `training`, `new` or `both` of them,
        or (R,) indices into `scene.targets`, one for each robot.
        random_starts: the fraction of the episodes to training targets that start anywhere
        reachable, at any heading, 1 m from the target or more (in a smaller room, as far as can
        be); all others start at the start pose.
        Raises ValueError for any of these that is not valid.
        """
        for name, value in (("num_envs", num_envs), ("max_episode_steps", max_episode_steps)):
            if not isinstance(value, (int, np.integer)) or value < 1:
                raise ValueError(f"{name} is {value!r}, it must be a whole number from 1 up")
        if not 0 <= random_starts <= 1:
            raise ValueError(f"random_starts is {random_starts!r}, it must be from 0 to 1")
        envs = env if isinstance(env, (list, tuple)) else [env]
        rooms = [room if isinstance(room, Scene) else load_scene(room) for room in envs]
        self.num_envs, self.max_episode_steps = num_envs, max_episode_steps
        self.random_starts = random_starts
        self.room = np.arange(num_envs) % len(rooms)
        self.world = World([rooms[k] for k in self.room])
        self.camera = Camera(rooms)
        self._choices = self._target_choices(targets)
        widest = max(np.hypot(*np.ptp(room.bounds, axis=0)) for room in rooms)
        most = PROGRESS_REWARD * MAX_LINEAR_VELOCITY * CONTROL_PERIOD + ARRIVAL_REWARD
        self.single_observation_space = Dict({
            "image": Box(0, 255, (H, W, 3), np.uint8),
            "target": Box(np.float32([0, -np.pi]), np.float32([widest, np.pi])),
            "velocity": Box(np.float32(MAX_COMMAND * (0, -1)), np.float32(MAX_COMMAND)),
            "reward": Box(np.float32(-most), np.float32(most), (1,))})
        self.single_action_space = Box(np.float32([0, -1]), np.float32([1, 1]))
        self.observation_space = batch_space(self.single_observation_space, num_envs)
        self.action_space = batch_space(self.single_action_space, num_envs)
        self._steps = None  # (R,) steps of the episodes under way; None before the first reset

    def _target_choices(self, targets):
        """The target indices, one array a robot, that its episodes draw from."""
        named, choices = isinstance(targets, str), []
        for r, scene in enumerate(self.world.scenes):
            training, both = len(scene.training_targets), range(len(scene.targets))
            sets = {"training": both[:training], "new": both[training:], "both": both}
            if targets not in sets if named else (
                    np.shape(targets) != (self.num_envs,) or targets[r] not in both):
                raise ValueError(f"targets is {targets!r}, it must be one of {', '.join(sets)}, or "
                                 f"hold an index into its scene's targets for each robot")
            choices.append(np.array(sets[targets] if named else [targets[r]]))
        return choices

    def reset(self, *, seed=None, options=None):
        """Starts every robot's episode; `seed` starts the random generator anew."""
        super().reset(seed=seed)
        R, robots = self.num_envs, np.arange(self.num_envs)
        self._target, self.goals, self.starts = np.zeros(R, int), np.zeros((R, 2)), np.zeros((R, 3))
        self._steps, self._return = np.zeros(R, int), np.zeros(R)
        self._begin(robots)
        observations = self._observe(robots, self.world.poses, self.goals, np.zeros((R, 2)),
                                     np.zeros(R))
        return observations, {"pose": self.world.poses}

    def _begin(self, robots):
        """Starts a new episode for those robots, (n,) indices."""
        for r in robots:
            self._target[r], self.goals[r], self.starts[r] = self.draw(r)
        self._steps[robots], self._return[robots] = 0, 0
        self.world.place(robots, self.starts[robots])

    def draw(self, r):
        """What robot r's next episode is: target (index), goal (2,) [m], start pose (3,)."""
        scene, rng, choices = self.world.scenes[r], self.np_random, self._choices[r]
        target = choices[rng.integers(len(choices))]
        new, start = target >= len(scene.training_targets), scene.start
        if not new and self.random_starts > 0 and rng.random() < self.random_starts:
            away = scene.starts[target]
            start = (*away[rng.integers(len(away))], rng.uniform(-np.pi, np.pi))
        return target, scene.targets[target], start

    def _observe(self, robots, poses, targets, velocity, reward):
        return {"image": self.camera.render(self.room[robots], poses, targets),
                "target": polar_targets(poses, targets).astype(np.float32),
                "velocity": velocity.astype(np.float32),
                "reward": reward[:, None].astype(np.float32)}

    def _command(self, actions):
        """Commands (R, 2) [m/s, rad/s] from actions. Raises ValueError, ResetNeeded."""
        if self._steps is None:
            raise ResetNeeded("step() was called before reset()")
        actions = np.asarray(actions, dtype=float)
        if actions.shape != (self.num_envs, 2):
            raise ValueError(f"the actions have shape {actions.shape}, it must be "
                             f"({self.num_envs}, 2): linear in [0, 1], angular in [-1, 1]")
        if not np.isfinite(actions).all():
            raise ValueError(f"the action of robot {np.isfinite(actions).all(1).argmin()} is not "
                             "finite: linear must be in [0, 1], angular in [-1, 1]")
        return actions.clip([0, -1], [1, 1]) * MAX_COMMAND

    def step(self, actions):
        """Drives all robots for one control period with actions (R, 2)."""
        command = self._command(actions)
        before = polar_targets(self.world.poses, self.goals)[:, 0]
        hit = self.world.drive(command)
        poses = self.world.poses
        after = polar_targets(poses, self.goals)[:, 0]
        arrived = after < ARRIVAL_DISTANCE
        reward = rewards(before, after, arrived, hit)
        self._steps += 1
        self._return += reward
        terminated = arrived | hit
        truncated = ~terminated & (self._steps >= self.max_episode_steps)
        done, outcome = terminated | truncated, np.where(arrived, 0, np.where(hit, 1, 2))
        observations, infos = self._end(done, outcome, poses, command, reward)
        return observations, reward, terminated, truncated, {"pose": poses} | infos

    def _end(self, done, outcome, poses, command, reward):
        """Ends the episodes that are done (R,) bool and starts the next ones. Returns what all
        robots see now, and the infos of those that are done: what they saw and how they fared."""
        R, ended = self.num_envs, np.flatnonzero(done)
        training = np.array([len(scene.training_targets) for scene in self.world.scenes])
        final_info = {"outcome": np.array(OUTCOMES)[outcome], "return": self._return.copy(),
                      "length": self._steps.copy(), "target": self._target.copy(),
                      "new": self._target >= training}
        targets = self.goals.copy()
        self._begin(ended)
        # One picture for the last observations of all and the first ones of those that start.
        seen = self._observe(np.append(np.arange(R), ended),
                             np.concatenate([poses, self.world.poses[ended]]),
                             np.concatenate([targets, self.goals[ended]]),
                             np.pad(command, ((0, len(ended)), (0, 0))),
                             np.pad(reward, (0, len(ended))))
        if not len(ended):
            return seen, {}
        final_obs = np.full(R, None, dtype=object)
        for r in ended:
            final_obs[r] = {key: value[r].copy() for key, value in seen.items()}
        for value in seen.values():
            value[ended] = value[R:]
        infos = {"final_obs": final_obs, "_final_obs": done, "_final_info": done,
                 "final_info": final_info | {f"_{key}": done for key in final_info}}
        return {key: value[:R] for key, value in seen.items()}, infos


class NavEnv(gym.Env):
    """One robot: `NavVecEnv` with R = 1, the robots' axis taken off, and no autoreset."""

    metadata = {"render_modes": []}

    def __init__(self, env="env1", targets="both", random_starts=0.0,
                 max_episode_steps=MAX_EPISODE_STEPS):
        self.vector = NavVecEnv(1, env, targets, random_starts, max_episode_steps)
        self.observation_space = self.vector.single_observation_space
        self.action_space = self.vector.single_action_space
        self._under_way = False

    def reset(self, *, seed=None, options=None):
        super().reset(seed=seed)
        observations, infos = self.vector.reset(seed=seed)
        self._under_way = True
        return {key: value[0] for key, value in observations.items()}, {"pose": infos["pose"][0]}

    def step(self, action):
        """As in NavVecEnv; `info` holds the episode's `outcome` and so on when it ends."""
        if not self._under_way:
            raise ResetNeeded("step() was called before reset(), or after the episode's end")
        action = np.asarray(action)[None]
        observations, reward, terminated, truncated, infos = self.vector.step(action)
        observation = {key: value[0] for key, value in observations.items()}
        info = {"pose": infos["pose"][0]}
        if terminated[0] or truncated[0]:
            self._under_way = False
            observation = infos["final_obs"][0]
            info |= {key: value[0].item() for key, value in infos["final_info"].items()
                     if not key.startswith("_")}
        return observation, float(reward[0]), bool(terminated[0]), bool(truncated[0]), info


for _path in sorted(SCENE_FOLDER.glob("*.toml")):
    gym.register(f"NavBot-{_path.stem}-v0", entry_point=NavEnv, vector_entry_point=NavVecEnv,
                 kwargs={"env": _path.stem})


def turn_to_target(observation):
    """The demo's rule, (2,) action: turn to the target, drive when it is ahead. Blind to walls."""
    bearing = observation["target"][1]
    return np.array([max(0.0, np.cos(bearing)), np.clip(2 * bearing, -1, 1)])


def drive_episode(env, seed):
    """One episode of `turn_to_target`: its poses (T + 1, 3), images (T + 1, H, W, 3), last info."""
    observation, info = env.reset(seed=seed)
    poses, images, over = [info["pose"]], [observation["image"]], False
    while not over:
        observation, _, terminated, truncated, info = env.step(turn_to_target(observation))
        over = terminated or truncated
        poses.append(info["pose"])
        images.append(observation["image"])
    return np.array(poses), np.array(images), info


def main(argv=None):
    """The command line: a demonstration of the world that needs no torch."""
    parser = CommandLine("Drive a robot by the rule 'turn to the target and go', and draw it.")
    parser.add_argument("--env", default="env1", help="a scene's name, or a path to a scene file")
    options = parser.parse(argv)
    try:
        env = NavEnv(options.env)
        scene, episodes = env.vector.world.scenes[0], []
        for k in range(6):
            episodes.append(drive_episode(env, seed=0 if k == 0 else None))
            info = episodes[-1][2]
            print(f"episode {k + 1}: {'new' if info['new'] else 'training'} target "
                  f"{scene.targets[info['target']].tolist()}: {info['outcome']} after "
                  f"{info['length'] * CONTROL_PERIOD:.1f} s, return {info['return']:.1f}")
        draw_demo(scene, episodes).savefig("demo.png", dpi=110)
    except (SceneError, OSError) as error:
        parser.error(error)
    print("wrote demo.png: the map with the paths, and what the camera saw")


if __name__ == "__main__":
    main()
