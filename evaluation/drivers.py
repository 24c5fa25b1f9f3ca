"""Drivers: a network or a planner. `support.traces.drive` describes the methods of a driver."""

import numpy as np

from evaluation.planners import ANGLES, PLANNERS, RANGE
from navbot_min import MAX_COMMAND
from scenes.generate import range_readings

ACTIONS = {"sampled": "sampled", "mean": "deterministic (mean)"}  # names for the label


class Policy:
    """Drives with a network, with `sampled` or with deterministic (`mean`) actions."""

    def __init__(self, model, actions, seed):
        """model: has the `act` and `initial_state` of a `model.Network`. Raises KeyError."""
        import torch  # here, because planners and measures do not need it
        self.label = f"policy, {ACTIONS[actions]} actions"
        self.model = model
        self.actions = actions
        self.seed = seed
        self.generator = torch.Generator()
        self.env = None

    def reset(self, env, robots):
        """Clears the memory of these robots."""
        if env is not self.env:  # first call for this environment
            self.env = env
            self.memory = self.model.initial_state(env.num_envs)
            seeds = np.random.SeedSequence([self.seed, env.np_random_seed])
            self.generator.manual_seed(int(seeds.generate_state(1)[0]))
        self.memory[robots] = 0

    def act(self, env, observations):
        """Returns the actions (R, 2), and sets `values` (R,), predicted by the network."""
        mean, sampled, _, self.values, self.memory = self.model.act(observations, self.memory,
                                                                    self.generator)
        return (sampled if self.actions == "sampled" else mean).numpy()


class Planned:
    """Drives with a planner, given its name in PLANNERS. Each robot has a separate planner."""

    def __init__(self, name, seed):
        self.label = f"planner {name}"
        self.planner = PLANNERS[name]
        self.rng = np.random.default_rng(seed)
        self.planners = {}  # robot -> planner of its episode
        self._knowledge = {}  # scene -> knowledge that its planners share

    def reset(self, env, robots):
        """Makes a new planner for each of these robots, given its pose and goal."""
        for r in robots:
            scene = env.world.scenes[r]
            if scene not in self._knowledge:
                self._knowledge[scene] = self.planner.prepare(scene, self.rng)
            self.planners[r] = self.planner(scene, self.rng, self._knowledge[scene])
            self.planners[r].begin(env.world.poses[r], env.goals[r])

    def act(self, env, observations):
        """Returns the actions (R, 2)."""
        readings = range_readings(env.world, ANGLES if self.planner.senses else [], RANGE)
        commands = [self.planners[r].act(pose, readings[r])
                    for r, pose in enumerate(env.world.poses)]
        return np.array(commands) / MAX_COMMAND
