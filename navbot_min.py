"""The task: observations, actions, rewards, and the end of an episode (paper III).

`NavVecEnv` defines the task and runs R robots at once; `NavEnv` is one robot. Both are Gymnasium
environments. `python navbot_min.py --env env1` drives one robot by a simple rule and draws its
path. The comment after each constant gives its source: 'paper' with the section, or 'released', the
authors' code and settings, for what the paper leaves out (docs/paper.md).

Axis letters: R robots, H = 48 and W = 64 image rows and columns.
"""

import gymnasium as gym
import numpy as np
from gymnasium.error import ResetNeeded
from gymnasium.spaces import Box, Dict
from gymnasium.vector import AutoresetMode, VectorEnv
from gymnasium.vector.utils import batch_space

import scenes as scene_files
from render import Camera, H, W
from sim import (ARRIVAL_DISTANCE, MAX_ANGULAR_VELOCITY, MAX_LINEAR_VELOCITY,
                 Scene, World, wrap_angle)
from support.checks import (NO_LIMIT, asked_episode, check_arguments, check_options,
                            check_render_mode, refuse_reality, target_choices)

ARRIVAL_REWARD = 100.0  # released config
COLLISION_REWARD = -50.0  # released config
PROGRESS_REWARD = 100.0  # [1/m] c_r of Eq. (4), released config
STEP_COST = 0.05  # c_p of Eq. (4), released config
MAX_EPISODE_STEPS = 200  # 80 s, our choice; the released script has 1000
MAX_COMMAND = np.array([MAX_LINEAR_VELOCITY, MAX_ANGULAR_VELOCITY])  # [m/s, rad/s]
LOWEST_ACTION = np.array([0.0, -1.0])  # linear, angular, as fractions of the maxima
HIGHEST_ACTION = np.array([1.0, 1.0])
FARTHEST = 100.0  # [m] upper bound on the observed distance in every room, our choice
OUTCOMES = ("arrival", "collision", "timeout")
ARRIVAL, COLLISION, TIMEOUT = range(3)  # indices into OUTCOMES
UNDER_WAY = -1  # the outcome of an episode that has not ended
RENDER_FPS = 10  # frames per second; one frame per control period, so four times real time


def polar_targets(poses, targets):
    """Returns distance [m] and bearing [rad] in (-pi, pi] of targets (R, 2) from poses (R, 3), as
    an (R, 2) array."""
    dx = targets[:, 0] - poses[:, 0]
    dy = targets[:, 1] - poses[:, 1]
    bearing = wrap_angle(np.arctan2(dy, dx) - poses[:, 2])
    return np.stack([np.hypot(dx, dy), bearing], -1)


def rewards(before, after, arrived, failed):
    """Returns the rewards (R,) of Eq. (4). before, after: distances to the target [m] before and
    after the step. arrived, failed (collided): (R,) bool; an arrival takes precedence."""
    progress = PROGRESS_REWARD * (before - after) - STEP_COST
    return np.where(arrived, ARRIVAL_REWARD, np.where(failed, COLLISION_REWARD, progress))


# The levels of paper II-B. Each draws an episode and returns the target's index in `scene.targets`,
# the goal (2,) [m] and the start pose (3,). choices: indices of targets. rng: numpy Generator.


def level_1(scene, choices, rng):
    """Draws a start pose and a target, both slightly perturbed."""
    target = choices[rng.integers(len(choices))]
    start = scene.own_start(rng)
    goal = scene.near(scene.targets[target], rng)
    return target, goal, scene.near(start, rng)


def level_2(scene, choices, rng, random_starts=0.0):
    """Draws a start pose and a target. random_starts: fraction of the episodes to training targets
    that start at a random reachable pose instead, at least 1 m from the target."""
    target = choices[rng.integers(len(choices))]
    goal = scene.targets[target]
    start = scene.own_start(rng)
    new = target >= len(scene.training_targets)
    if not new and random_starts > 0 and rng.random() < random_starts:
        start = scene.any_start(goal, rng)
    return target, goal, start


def level_3(scene, choices, rng):
    """Draws a random start and a random target. The returned index has no meaning."""
    target = choices[rng.integers(len(choices))]
    goal = scene.any_place(rng)
    return target, goal, scene.any_start(goal, rng)


LEVELS = {"memorize": level_1, "anywhere": level_3}  # by `targets`; any other value is level 2


class NavVecEnv(VectorEnv):
    """R robots, each driving to a target. When a robot's episode ends, its next one begins.

    An observation is a dict of `image` (R, H, W, 3) uint8 RGB; `target` (R, 2), distance [m] and
    bearing [rad]; `velocity` (R, 2), the last executed command [m/s, rad/s]; and `last_reward`
    (R, 1). The last two are 0 when an episode starts. An action (R, 2) is the linear velocity in
    [0, 1] and the angular velocity in [-1, 1], as fractions of their maxima. It is clipped.

    Arrival and collision terminate an episode; the step limit truncates it. `infos` holds the
    `pose` (R, 3) after the step and the `command` (R, 2). Autoreset is same-step: when an episode
    ends, `observations`, `goals` and `starts` are already new ones, `infos["final_obs"]` holds the
    last observation and `infos["final_info"]` its `episode_info`. The key `_name` masks `name`.

    A subclass changes the task by overriding the hooks `sample_episode`, `observe`, `command`,
    `drive` and `reward`.
    """

    metadata = {"autoreset_mode": AutoresetMode.SAME_STEP}
    autoreset_mode = AutoresetMode.SAME_STEP  # TorchRL looks for it here
    outcomes = OUTCOMES

    def __init__(self, num_envs=32, scenes=("env1",), targets="both", random_starts=0.0,
                 max_episode_steps=MAX_EPISODE_STEPS, level=None):
        """scenes: a list of names, paths or Scenes; robot r drives in `scenes[r % len(scenes)]`.
        targets: each episode's target is drawn from the `training` or `new` ones or `both`;
        `memorize` is level 1 with the first target, `anywhere` is level 3; or (R,) indices into
        `scene.targets`, one per robot. random_starts: see `level_2`. max_episode_steps: -1 for no
        limit. level: the function that draws episodes; the default follows from `targets`.
        Raises ValueError, SceneError.
        """
        check_arguments(num_envs, scenes, random_starts, max_episode_steps)
        self.num_envs = num_envs
        self.max_episode_steps = max_episode_steps
        self.random_starts = random_starts
        self.scenes = [scene if isinstance(scene, Scene) else scene_files.load(scene)
                       for scene in scenes]
        self.check_rooms(self.scenes)
        self.scene_of = np.arange(num_envs) % len(self.scenes)
        self.world = World([self.scenes[k] for k in self.scene_of])
        self.camera = Camera(self.scenes)
        self.level = level or LEVELS.get(str(targets))
        self._choices = [target_choices(targets, r, scene)
                         for r, scene in enumerate(self.world.scenes)]
        self.single_observation_space = Dict({
            "image": Box(0, 255, (H, W, 3), np.uint8),
            "target": Box(np.float32([0, -np.pi]), np.float32([FARTHEST, np.pi])),
            "velocity": Box(np.float32(MAX_COMMAND * LOWEST_ACTION), np.float32(MAX_COMMAND)),
            "last_reward": Box(np.float32(-ARRIVAL_REWARD), np.float32(ARRIVAL_REWARD), (1,))})
        self.single_action_space = Box(np.float32(LOWEST_ACTION), np.float32(HIGHEST_ACTION))
        self.observation_space = batch_space(self.single_observation_space, num_envs)
        self.action_space = batch_space(self.single_action_space, num_envs)
        self._target = np.zeros(num_envs, dtype=int)  # of the episodes under way
        self.goals = np.zeros((num_envs, 2))  # [m] positions of these targets
        self.starts = np.zeros((num_envs, 3))  # poses at which these episodes started
        self._steps = None  # (R,) steps in the current episodes; None before the first reset
        self._return = np.zeros(num_envs)  # sums of their rewards

    @staticmethod
    def check_rooms(scenes):
        """Raises SceneError for a room that simulates a robot's errors: this class has none."""
        refuse_reality(scenes)

    def reset(self, *, seed=None, options=None):
        """Starts an episode for every robot. options, shared or per robot: `target`, an index into
        the scene's targets, from the start pose; `goal`, a place; `start`. Raises ValueError."""
        options = check_options(options or {}, self.world.scenes)
        super().reset(seed=seed)
        self._steps = np.zeros(self.num_envs, dtype=int)
        observations = self._begin(np.arange(self.num_envs), options)
        return observations, {"pose": self.world.poses, "command": np.zeros((self.num_envs, 2))}

    def _begin(self, robots, options):
        """Starts new episodes for these robots, (n,) indices. Returns their observations.
        options: as in `reset`, as arrays; they replace drawn values."""
        for r in robots:
            episode = asked_episode(self.sample_episode(r), options, r, self.world.scenes[r])
            self._target[r], self.goals[r], self.starts[r] = episode
        self._steps[robots] = 0
        self._return[robots] = 0
        self.world.place(robots, self.starts[robots])
        return self.observe(robots, self.world.poses[robots], self.goals[robots],
                            np.zeros((len(robots), 2)), np.zeros(len(robots)))

    def sample_episode(self, r):
        """Draws robot r's next episode with `self.np_random`. Returns target (index), goal (2,) [m]
        and start pose (3,). Hook."""
        scene = self.world.scenes[r]
        if self.level is None:
            return level_2(scene, self._choices[r], self.np_random, self.random_starts)
        return self.level(scene, self._choices[r], self.np_random)

    def observe(self, robots, poses, goals, velocities, last_rewards):
        """Returns observations of these robots (n,) at poses (n, 3) with goals (n, 2) [m], after
        commands (n, 2) [m/s, rad/s] and rewards (n,). Hook."""
        return {"image": self.camera.render(self.scene_of[robots], poses, goals),
                "target": polar_targets(poses, goals).astype(np.float32),
                "velocity": velocities.astype(np.float32),
                "last_reward": last_rewards[:, None].astype(np.float32)}

    def command(self, actions):
        """Returns the commands (R, 2) [m/s, rad/s] for actions (R, 2). Hook."""
        return actions.clip(LOWEST_ACTION, HIGHEST_ACTION) * MAX_COMMAND

    def drive(self, commands):
        """Drives all robots for one control period. Returns (R,) bool: True for robots that failed,
        which ends their episodes. Here a failure is a collision. Hook."""
        return self.world.drive(commands)

    def reward(self, before, after, arrived, failed):
        """Returns the rewards (R,); the arguments are those of `rewards`. Hook."""
        return rewards(before, after, arrived, failed)

    def step(self, actions):
        """Drives all robots for one control period with actions (R, 2). Returns observations,
        rewards (R,), terminated (R,), truncated (R,), infos. Raises ValueError, ResetNeeded."""
        if self._steps is None:
            raise ResetNeeded("step() was called before reset()")
        actions = np.asarray(actions, dtype=float)
        if actions.shape != (self.num_envs, 2) or not np.isfinite(actions).all():
            raise ValueError(f"actions must be finite numbers of shape ({self.num_envs}, 2); they "
                             f"are {actions}")
        command = self.command(actions)
        before = polar_targets(self.world.poses, self.goals)[:, 0]
        failed = self.drive(command)
        poses = self.world.poses
        after = polar_targets(poses, self.goals)[:, 0]
        arrived = after < ARRIVAL_DISTANCE
        reward = self.reward(before, after, arrived, failed)
        self._steps += 1
        self._return += reward
        terminated = arrived | failed
        truncated = ~terminated & (self._steps == self.max_episode_steps)
        observations = self.observe(np.arange(self.num_envs), poses, self.goals, command, reward)
        infos = {"pose": poses, "command": command}
        done = terminated | truncated
        if done.any():
            outcome = np.select([arrived, failed], [ARRIVAL, COLLISION], TIMEOUT)
            # Collect the statistics before the next episodes begin and clear them.
            final_info = self.episode_info(outcome)
            final_info |= {f"_{key}": done for key in final_info}
            infos |= {"final_info": final_info, "_final_info": done, "_final_obs": done,
                      "final_obs": {key: value.copy() for key, value in observations.items()}}
            ended = np.flatnonzero(done)
            for key, first in self._begin(ended, {}).items():
                observations[key][ended] = first
        return observations, reward, terminated, truncated, infos

    def episode_info(self, outcome):
        """Returns statistics (R,) of the current episodes, given their outcome (R,), an index into
        `outcomes`."""
        return {"outcome": outcome, "is_success": outcome == ARRIVAL,
                "return": self._return.copy(), "length": self._steps.copy(),
                "target_index": self._target.copy(),
                "new": self._target >= [len(s.training_targets) for s in self.world.scenes],
                "scene": self.scene_of.copy(), "goal_x": self.goals[:, 0].copy(),
                "goal_y": self.goals[:, 1].copy()}


class NavEnv(gym.Env):
    """One robot: `NavVecEnv` with R = 1, without the robot axis and without autoreset. `info` holds
    pose, command and `NavVecEnv.episode_info` at every step. `gymnasium.make` adds the limit of 200
    steps as a wrapper; when the wrapper truncates an episode, `outcome` is still UNDER_WAY."""

    metadata = {"render_modes": ["rgb_array", "human"], "render_fps": RENDER_FPS}
    vector_class = NavVecEnv  # a subclass names its own

    def __init__(self, *arguments, max_episode_steps=NO_LIMIT, render_mode=None, **others):
        """Takes the other arguments of NavVecEnv, but has no time limit by default. render_mode:
        "rgb_array" (`render` returns a picture) or "human" (a window). Raises ValueError."""
        check_render_mode(render_mode, self.metadata["render_modes"])
        self.vector = self.vector_class(1, *arguments, max_episode_steps=max_episode_steps,
                                        **others)
        self.observation_space = self.vector.single_observation_space
        self.action_space = self.vector.single_action_space
        self.render_mode = render_mode
        self._last = None  # observation and info of the last step; None before the first reset
        self._is_over = True
        self._room = None  # Scene of the episode under way
        self._screen = None  # the pictures of `render`

    def reset(self, *, seed=None, options=None):
        """Starts an episode. options: as in NavVecEnv."""
        super().reset(seed=seed)
        self.vector.np_random = self.np_random  # a user may have set another generator
        observations, infos = self.vector.reset(options=options)
        self._is_over = False
        self._room = self.vector.world.scenes[0]
        return self._look(observations, infos, self.vector.episode_info(np.array([UNDER_WAY])))

    def step(self, action):
        """Makes one step, as in NavVecEnv, with one action (2,). Raises ValueError, ResetNeeded."""
        if self._is_over:
            raise ResetNeeded("step() was called before reset(), or after the episode's end")
        observations, rewards, terminated, truncated, infos = self.vector.step(np.array([action]))
        self._is_over = bool(terminated[0] or truncated[0])
        if self._is_over:  # the vector environment has begun the next episode
            observation, info = self._look(infos["final_obs"], infos, infos["final_info"])
        else:
            statistics = self.vector.episode_info(np.array([UNDER_WAY]))
            observation, info = self._look(observations, infos, statistics)
        return observation, float(rewards[0]), bool(terminated[0]), bool(truncated[0]), info

    def _look(self, observations, infos, statistics):
        """Returns the robot's observation and info, and updates the window if there is one."""
        info = {"pose": infos["pose"][0], "command": infos["command"][0]}
        info |= {key: value[0].item() for key, value in statistics.items() if key[0] != "_"}
        self._last = {key: value[0] for key, value in observations.items()}, info
        if self.render_mode == "human":
            self.render()
        return self._last

    def render(self):
        """Draws the map and the camera image side by side. With render_mode "rgb_array", returns a
        (height, width, 3) uint8 picture; with "human", shows it. Raises ResetNeeded."""
        if self.render_mode is None:
            return None
        if self._last is None:
            raise ResetNeeded("render() was called before reset()")
        if self._screen is None:
            from support.film import Screen  # loads matplotlib, which the task does not need
            self._screen = Screen(self.render_mode, RENDER_FPS)
        return self._screen.draw(self._room, *self._last)

    def close(self):
        """Closes the window, if there is one."""
        if self._screen is not None:
            self._screen.close()

    def __getstate__(self):
        return self.__dict__ | {"_screen": None}  # a copy makes its own


for _name in set(scene_files.names()) - {"lab"}:  # the lab is robot:NavBot-lab-v1
    gym.register(f"NavBot-{_name}-v1", entry_point="navbot_min:NavEnv",
                 vector_entry_point="navbot_min:NavVecEnv", kwargs={"scenes": (_name,)},
                 max_episode_steps=MAX_EPISODE_STEPS)
gym.register("NavBot-random-v1", entry_point="support.random_rooms:RandomRoomsEnv",
             vector_entry_point="support.random_rooms:RandomRoomsVecEnv",
             max_episode_steps=MAX_EPISODE_STEPS)


if __name__ == "__main__":
    from support.demo import main  # loads matplotlib, which the task does not need
    main(NavVecEnv)
