"""The task: what the robot sees, may do, is paid, and when an episode ends (paper III).

`NavVecEnv` runs R robots at once and is the thing itself; `NavEnv` is one robot. Both are Gymnasium
environments. `python navbot_min.py --env env1` drives one robot by a simple rule and draws it.

Where a number comes from stands behind it: 'paper' is the publication, with its section; 'released'
are the authors' simulator, script and settings, which say what the paper does not (docs/paper.md).

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
from sim import (ARRIVAL_DISTANCE, CONTROL_PERIOD, MAX_ANGULAR_VELOCITY, MAX_LINEAR_VELOCITY,
                 SceneError, World, wrap_angle)
from support import checks
from support.command_line import CommandLine
from support.screen import Screen, Screens

ARRIVAL_REWARD = 100.0  # released config
COLLISION_REWARD = -50.0  # released config
PROGRESS_REWARD = 100.0  # [1/m] c_r of Eq. (4), released config
STEP_COST = 0.05  # c_p of Eq. (4), released config
MAX_EPISODE_STEPS = 200  # 80 s, our choice; the released script allows 1000
MAX_COMMAND = np.array([MAX_LINEAR_VELOCITY, MAX_ANGULAR_VELOCITY])  # [m/s, rad/s]
LOWEST_ACTION = np.array([0.0, -1.0])  # linear, angular, as fractions of the maxima
HIGHEST_ACTION = np.array([1.0, 1.0])
OUTCOMES = ("arrival", "collision", "timeout", "standing")  # the last where a robot gives up
ARRIVAL, COLLISION, TIMEOUT, STANDING = range(4)  # indices into OUTCOMES
RENDER_FPS = 10  # frames a second; a frame is CONTROL_PERIOD, so four times faster than life


def polar_targets(poses, targets):
    """Distance [m] and bearing [rad] in (-pi, pi], (R, 2), of targets (R, 2) from poses (R, 3)."""
    dx = targets[:, 0] - poses[:, 0]
    dy = targets[:, 1] - poses[:, 1]
    bearing = wrap_angle(np.arctan2(dy, dx) - poses[:, 2])
    return np.stack([np.hypot(dx, dy), bearing], -1)


def rewards(before, after, arrived, failed):
    """Eq. (4): rewards (R,) for distances before and after [m]. failed: who has hit something, or
    in a subclass stood too long; arrival wins over it."""
    progress = PROGRESS_REWARD * (before - after) - STEP_COST
    return np.where(arrived, ARRIVAL_REWARD, np.where(failed, COLLISION_REWARD, progress))


class NavVecEnv(VectorEnv):
    """R robots, each on its own way to a target; one that ends its episode starts the next at once.

    An observation is a dict of `image` (R, H, W, 3) uint8 RGB, `target` (R, 2) distance [m] and
    bearing [rad], `velocity` (R, 2) the last command as executed [m/s, rad/s], and `last_reward`
    (R, 1); the last two are 0 at an episode's start. An action (R, 2) holds the linear velocity in
    [0, 1] and the angular in [-1, 1] as fractions of their maxima, and is clipped.

    Arrival and collision terminate an episode (and, in a subclass, standing too long), the step
    limit truncates it. Autoreset is same-step.
    `infos["pose"]` (R, 3) are the poses that the step led to, `infos["command"]` (R, 2) the
    commands that led there. When episodes end, `infos["final_obs"]` holds the last observations
    (R, ...), and `infos["final_info"]` the `outcome` (index into OUTCOMES), `return`, `length`,
    `target_index` (into the scene's targets), `new` (whether that is a new target), `scene`,
    `goal_x` and `goal_y` [m], (R,) each; `observations` is then the next episode's already. As in
    all of Gymnasium there is a mask of the same name after a `_`: whether the entry of robot r
    counts.

    A subclass changes the task by hooks: `sample_episode`, `observe`, `command` and `is_standing`.
    Arrays of its own that change while robots drive it names in `changing`.
    """

    metadata = {"render_modes": ["rgb_array"], "render_fps": RENDER_FPS,
                "autoreset_mode": AutoresetMode.SAME_STEP}
    autoreset_mode = AutoresetMode.SAME_STEP  # where TorchRL looks for it
    changing = ("goals", "starts", "_target", "_steps", "_return")  # arrays that `state` holds

    def __init__(self, num_envs=32, scenes=("env1",), targets="both", random_starts=0.0,
                 max_episode_steps=MAX_EPISODE_STEPS, render_mode=None):
        """scenes: a list of names, paths or Scenes; robot r drives in `scenes[r % len(scenes)]`.
        targets: the episodes' targets, drawn uniformly from `training`, `new` or `both` of them,
        or (R,) indices into `scene.targets`, one for each robot. Two more make it level 1 or 3 of
        the paper: `memorize`, the first target, it and the start pose moved a little each time;
        `anywhere`, from anywhere, as by random_starts, to any reachable place.
        random_starts: the fraction of the episodes to training targets that start anywhere
        reachable, at any heading, 1 m from the target or more (in a smaller room, as far as can
        be); all others start at the start pose.
        max_episode_steps: -1 is no limit.
        render_mode: "rgb_array" or None.
        Raises ValueError for any of these that is not valid.
        """
        checks.check_arguments(num_envs, max_episode_steps, random_starts, render_mode)
        self.num_envs = num_envs
        self.max_episode_steps = max_episode_steps
        self.random_starts = random_starts
        self.render_mode = render_mode
        self.scenes = checks.load_scenes(scenes, most=num_envs)
        self.scene_of = np.arange(num_envs) % len(self.scenes)
        self.world = World([self.scenes[k] for k in self.scene_of])
        self.camera = Camera(self.scenes)
        self._level = {"memorize": 1, "anywhere": 3}.get(str(targets), 2)  # paper II-B
        self._choices = checks.target_choices(targets, self.world.scenes)  # R lists of indices
        self._training_count = np.array([len(s.training_targets) for s in self.world.scenes])
        self._make_spaces()
        self._target = np.zeros(num_envs, dtype=int)  # of the episodes under way
        self.goals = np.zeros((num_envs, 2))  # [m] where these targets are
        self.starts = np.zeros((num_envs, 3))  # poses that these episodes started at
        self._steps = None  # (R,) steps so far; None before the first reset
        self._return = np.zeros(num_envs)  # rewards so far
        self._screens = Screens(num_envs if render_mode else 0)

    def _make_spaces(self):
        """What Gymnasium wants to know of observations and actions."""
        widest = max(np.hypot(*np.ptp(scene.bounds, axis=0)) for scene in self.scenes)
        highest_reward = PROGRESS_REWARD * MAX_LINEAR_VELOCITY * CONTROL_PERIOD + ARRIVAL_REWARD
        self.single_observation_space = Dict({
            "image": Box(0, 255, (H, W, 3), np.uint8),
            "target": Box(np.float32([0, -np.pi]), np.float32([widest, np.pi])),
            "velocity": Box(np.float32(MAX_COMMAND * LOWEST_ACTION), np.float32(MAX_COMMAND)),
            "last_reward": Box(np.float32(-highest_reward), np.float32(highest_reward), (1,))})
        self.single_action_space = Box(np.float32(LOWEST_ACTION), np.float32(HIGHEST_ACTION))
        self.observation_space = batch_space(self.single_observation_space, self.num_envs)
        self.action_space = batch_space(self.single_action_space, self.num_envs)

    def reset(self, *, seed=None, options=None):
        """Starts every robot's episode; `seed` starts the random generator anew.

        options: `target`, an index into the scene's targets, and `start`, a pose (x, y, theta), of
        these first episodes; one for all robots, or one for each. Raises ValueError.
        """
        options = checks.check_options(options, self.world.scenes)
        super().reset(seed=seed)
        robots = np.arange(self.num_envs)
        self._steps = np.zeros(self.num_envs, dtype=int)
        observations = self._begin(robots, options)
        self._screens.see(self.world.poses, observations, self._steps * CONTROL_PERIOD)
        return observations, {"pose": self.world.poses, "command": np.zeros((self.num_envs, 2))}

    def _begin(self, robots, options):
        """Starts a new episode for those robots, (n,) indices. Returns what they see."""
        for r in robots:
            scene = self.world.scenes[r]
            # What `reset` was asked for stands above what was drawn; mostly nothing was.
            episode = checks.asked_episode(self.sample_episode(r), options, r, scene)
            self._target[r], self.goals[r], self.starts[r] = episode
            self._screens.begin(r, scene, self.goals[r])
        self._steps[robots] = 0
        self._return[robots] = 0
        self.world.place(robots, self.starts[robots])
        return self.observe(robots, self.world.poses[robots], self.goals[robots],
                            np.zeros((len(robots), 2)), np.zeros(len(robots)))

    def sample_episode(self, r):
        """What robot r's next episode is: target (index), goal (2,) [m], start pose (3,). A hook:
        draws by `self.np_random`."""
        scene = self.world.scenes[r]
        rng = self.np_random
        choices = self._choices[r]
        target = choices[rng.integers(len(choices))]
        goal = scene.targets[target]
        start = scene.own_start(rng)
        new = target >= len(scene.training_targets)
        if self._level == 1:
            goal = scene.near(goal, rng)
            start = scene.near(start, rng)
        elif self._level == 3:
            goal = scene.any_place(rng)
            start = scene.any_start(goal, rng)
        elif not new and self.random_starts > 0 and rng.random() < self.random_starts:
            start = scene.any_start(goal, rng)
        return target, goal, start

    def observe(self, robots, poses, goals, velocities, last_rewards):
        """What those robots (n,) see: from poses (n, 3) with goals (n, 2) [m], after commands
        (n, 2) [m/s, rad/s] and rewards (n,). Returns the observation, a dict. A hook."""
        return {"image": self.camera.render(self.scene_of[robots], poses, goals),
                "target": polar_targets(poses, goals).astype(np.float32),
                "velocity": velocities.astype(np.float32),
                "last_reward": last_rewards[:, None].astype(np.float32)}

    def command(self, actions):
        """The commands (R, 2) [m/s, rad/s] that actions (R, 2) come to. A hook."""
        return actions.clip(LOWEST_ACTION, HIGHEST_ACTION) * MAX_COMMAND

    def is_standing(self):
        """Which robots (R,) have stood for so long that their episodes end. A hook: here, none."""
        return np.zeros(self.num_envs, dtype=bool)

    def step(self, actions):
        """Drives all robots for one control period with actions (R, 2). Returns observations,
        rewards (R,), terminated (R,), truncated (R,), infos. Raises ValueError, ResetNeeded."""
        if self._steps is None:
            raise ResetNeeded("step() was called before reset()")
        command = self.command(checks.check_actions(actions, self.num_envs))
        before = polar_targets(self.world.poses, self.goals)[:, 0]
        hit = self.world.drive(command)
        poses = self.world.poses
        after = polar_targets(poses, self.goals)[:, 0]
        arrived = after < ARRIVAL_DISTANCE
        standing = self.is_standing() & ~arrived & ~hit
        reward = rewards(before, after, arrived, hit | standing)
        self._steps += 1
        self._return += reward
        terminated = arrived | hit | standing
        truncated = ~terminated & (self._steps == self.max_episode_steps)
        observations = self.observe(np.arange(self.num_envs), poses, self.goals, command, reward)
        infos = {"pose": poses, "command": command}
        ended = np.flatnonzero(terminated | truncated)
        if len(ended):
            outcome = np.select([arrived, hit, standing], [ARRIVAL, COLLISION, STANDING], TIMEOUT)
            # First how they fared: beginning the next episodes clears it.
            infos |= self._final_infos(terminated | truncated, outcome, observations)
            for key, first in self._begin(ended, {}).items():
                observations[key][ended] = first
        self._screens.see(self.world.poses, observations, self._steps * CONTROL_PERIOD)
        return observations, reward, terminated, truncated, infos

    def _final_infos(self, done, outcome, observations):
        """How the episodes fared that are done (R,) bool, and the last that was seen of them."""
        final_info = self.figures(outcome)
        masks = {f"_{key}": done for key in final_info}
        final_obs = {key: value.copy() for key, value in observations.items()}
        return {"final_obs": final_obs, "_final_obs": done,
                "final_info": final_info | masks, "_final_info": done}

    def figures(self, outcome):
        """Figures of the episodes under way, (R,) each, if they end now with that outcome (R,)."""
        return {"outcome": outcome, "return": self._return.copy(), "length": self._steps.copy(),
                "target_index": self._target.copy(), "new": self._target >= self._training_count,
                "scene": self.scene_of.copy(), "goal_x": self.goals[:, 0].copy(),
                "goal_y": self.goals[:, 1].copy()}

    def render(self):
        """With render_mode "rgb_array", the map beside the camera's image of every robot: a tuple
        of R (height, width, 3) uint8 pictures. Raises ResetNeeded."""
        return self._screens.pictures()

    def state(self):
        """All that changes while robots drive, for `load_state`: arrays and numbers alone. Raises
        ResetNeeded."""
        if self._steps is None:
            raise ResetNeeded("state() was called before reset()")
        arrays = {name: getattr(self, name).copy() for name in self.changing}
        arrays |= self._screens.state()
        return arrays | {"world": self.world.state(), "random": self.np_random.bit_generator.state}

    def load_state(self, state):
        """Goes on from a state of an environment that was made in the same way."""
        for name in self.changing:
            setattr(self, name, state[name].copy())
        self._screens.load_state(state, self.world.scenes)
        self.world.load_state(state["world"])
        self.np_random.bit_generator.state = state["random"]


class NavEnv(gym.Env):
    """One robot: `NavVecEnv` with R = 1, the robots' axis taken off, and no autoreset.

    `info` holds the episode's figures at every step, as the last `final_info` of NavVecEnv does.
    Until an arrival or a collision its `outcome` is timeout: by
    `gymnasium.make("navbot_min:NavBot-env1-v0")` the time limit, 200 steps, is that of a wrapper,
    and whether it ends the episode is not known here.
    """

    metadata = {"render_modes": ["rgb_array", "human"], "render_fps": RENDER_FPS}
    vector_class = NavVecEnv  # a subclass with hooks of its own names it here

    def __init__(self, scenes=("env1",), targets="both", random_starts=0.0,
                 max_episode_steps=checks.NO_LIMIT, render_mode=None):
        """As NavVecEnv, but without a time limit of its own unless one is given. render_mode: also
        "human", a window. Raises ValueError."""
        checks.check_render_mode(render_mode, self.metadata["render_modes"])
        self.vector = self.vector_class(1, scenes, targets, random_starts, max_episode_steps)
        self.observation_space = self.vector.single_observation_space
        self.action_space = self.vector.single_action_space
        self.render_mode = render_mode
        self._under_way = False
        self._screen = Screen()

    def reset(self, *, seed=None, options=None):
        """Starts an episode. options: `target` and `start` of it, as in NavVecEnv."""
        super().reset(seed=seed)
        observations, infos = self.vector.reset(seed=seed, options=options)
        self._under_way = True
        self._screen.begin(self.vector.world.scenes[0], self.vector.goals[0])
        info = {key: value[0] for key, value in infos.items()}
        return self._look(observations, info, 0), info

    def step(self, action):
        """As in NavVecEnv, for one action (2,). Raises ValueError, ResetNeeded."""
        if not self._under_way:
            raise ResetNeeded("step() was called before reset(), or after the episode's end")
        action = np.asarray(action, dtype=float)
        observations, rewards, terminated, truncated, infos = self.vector.step(action[None])
        self._under_way = not (terminated[0] or truncated[0])
        if self._under_way:
            figures = self.vector.figures(outcome=np.array([TIMEOUT]))
        else:  # the vector environment has begun the next episode already
            observations = infos["final_obs"]
            figures = infos["final_info"]
        info = {"pose": infos["pose"][0], "command": infos["command"][0]}
        info |= {key: value[0].item() for key, value in figures.items() if key[0] != "_"}
        observation = self._look(observations, info, info["length"])
        return observation, float(rewards[0]), bool(terminated[0]), bool(truncated[0]), info

    def _look(self, observations, info, steps):
        """The one robot's observation. In a window it shows at once."""
        observation = {key: value[0] for key, value in observations.items()}
        self._screen.see(info["pose"], observation["image"], info["command"],
                         steps * CONTROL_PERIOD)
        if self.render_mode == "human":
            self._screen.show(RENDER_FPS)
        return observation

    def render(self):
        """With render_mode "rgb_array" the map beside the camera's image, a (height, width, 3)
        uint8 picture. Raises ResetNeeded."""
        return self._screen.picture() if self.render_mode == "rgb_array" else None

    def close(self):
        """Closes the window, if there is one."""
        self._screen.close()


for _name in scene_files.names():
    _where = "robot.environment:Real" if scene_files.load(_name).reality else "navbot_min:Nav"
    gym.register(f"NavBot-{_name}-v0", entry_point=f"{_where}Env",
                 vector_entry_point=f"{_where}VecEnv", kwargs={"scenes": (_name,)},
                 max_episode_steps=MAX_EPISODE_STEPS)


def main(argv=None):
    """The command line: a demonstration of the world that needs no torch."""
    parser = CommandLine("Drive a robot by the rule 'turn to the target and go', and draw it.")
    parser.add_argument("--env", default="env1", help="a scene's name or file; by default env1")
    options = parser.parse(argv)
    from support.pictures import draw_demo  # loads matplotlib, which the task itself needs not
    from support.traces import TurnToTarget, drive
    try:
        env = NavVecEnv(1, [options.env])
        traces = drive(TurnToTarget(), env, quota=[6], images=True)
        for k, trace in enumerate(traces):
            print(f"episode {k + 1}: {trace}")
        draw_demo(env.scenes[0], traces).savefig("demo.png", dpi=110)
    except (SceneError, OSError) as error:
        parser.error(error)
    print("wrote demo.png: the map with the paths, and what the camera saw")


if __name__ == "__main__":
    main()
