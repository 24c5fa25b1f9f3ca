"""The drivers, a network or a planner. `support.traces.drive` says what your own driver needs."""

import numpy as np

from evaluation.planners import ANGLES, PLANNERS, RANGE
from navbot_min import MAX_COMMAND
from scenes.generate import range_readings

ACTIONS = {"sampled": "sampled", "mean": "deterministic (mean)"}  # and what they are called


class Policy:
    """Drives with a network, by `sampled` or by deterministic (`mean`) actions."""

    def __init__(self, model, actions, seed):
        """model: has the `act` and `initial_state` of a `model.Network`. Raises KeyError."""
        import torch  # here, because planners and measures do without it
        self.label = f"policy, {ACTIONS[actions]} actions"
        self.model = model
        self.actions = actions
        self.seed = seed
        self.generator = torch.Generator()
        self.env = None

    def reset(self, env, robots):
        """Clears the memory of these robots."""
        if env is not self.env:  # it begins to drive there
            self.env = env
            self.memory = self.model.initial_state(env.num_envs)
            seeds = np.random.SeedSequence([self.seed, env.np_random_seed])
            self.generator.manual_seed(int(seeds.generate_state(1)[0]))
        self.memory[robots] = 0

    def act(self, env, observations):
        """Returns the actions (R, 2). `values` (R,) are those that the network expects."""
        mean, sampled, _, self.values, self.memory = self.model.act(observations, self.memory,
                                                                    self.generator)
        return (sampled if self.actions == "sampled" else mean).numpy()


class Planned:
    """Drives with a planner, by its name in PLANNERS; each robot has its own."""

    def __init__(self, name, seed):
        self.label = f"planner {name}"
        self.planner = PLANNERS[name]
        self.rng = np.random.default_rng(seed)
        self.planners = {}  # robot -> planner of its episode
        self._knowledge = {}  # scene -> what its planners know of it

    def reset(self, env, robots):
        """Gives each of these robots a new planner and tells it its pose and its goal."""
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
