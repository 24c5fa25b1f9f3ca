"""Who drives: a network, or a planner. `support.traces.drive` asks either for actions.

A driver of your own needs the same three: `label`, text that says who drives; `reset(env, robots)`,
called with the indices of robots whose episodes begin now, so that `env.goals`, `env.starts` and
`env.world.poses` are set; and `act(env, observations)`, which returns actions (R, 2), fractions of
the maximum velocities.
"""

import numpy as np

from evaluation.planners import ANGLES, PLANNERS, RANGE
from navbot_min import MAX_COMMAND
from support.ranges import range_readings

ACTIONS = {"sampled": "sampled", "mean": "deterministic (mean)"}  # and what they are called


class Policy:
    """Drives with a network, by `sampled` or by deterministic (`mean`) actions."""

    def __init__(self, model, actions, seed):
        """model: a `model.Network`, or what has its `act` and `initial_state`. seed: of the sampled
        actions, with the seed of the environment that it drives in. Raises ValueError for other
        actions."""
        import torch  # here, for planners and measures do without it
        if actions not in ACTIONS:
            raise ValueError(f"actions is {actions!r}, it must be one of {', '.join(ACTIONS)}")
        self.label = f"policy, {ACTIONS[actions]} actions"
        self.model = model
        self.actions = actions
        self.seed = seed
        self.generator = torch.Generator()
        self.env = None
        self.memory = None

    def reset(self, env, robots):
        """Clears the memory of those robots."""
        if env is not self.env:  # it begins to drive there
            self.env = env
            self.memory = self.model.initial_state(env.num_envs)
            seeds = np.random.SeedSequence([self.seed, env.np_random_seed])
            self.generator.manual_seed(int(seeds.generate_state(1)[0]))
        self.memory[robots] = 0

    def act(self, env, observations):
        mean, sampled, _, _, self.memory = self.model.act(observations, self.memory, self.generator)
        chosen = sampled if self.actions == "sampled" else mean
        return chosen.numpy()


class Planned:
    """Drives with a planner, each robot with one of its own."""

    def __init__(self, name, seed):
        """name: a key of PLANNERS. seed: of the planners' random numbers."""
        self.label = f"planner {name}"
        self.planner = PLANNERS[name]
        self.rng = np.random.default_rng(seed)
        self.planners = {}  # robot -> planner of its episode
        self._knowledge = {}  # a scene, by identity -> the scene, and what is known of it

    def knowledge(self, scene):
        """What the planner knows of a scene before it drives there, computed once."""
        if id(scene) not in self._knowledge:
            self._knowledge[id(scene)] = (scene, self.planner.prepare(scene, self.rng))
        return self._knowledge[id(scene)][1]

    def reset(self, env, robots):
        """Each of those robots gets a new planner, which is told its pose and its goal."""
        poses = env.world.poses
        for r in robots:
            scene = env.scenes[env.scene_of[r]]
            planner = self.planner(scene, self.rng, self.knowledge(scene))
            planner.begin(poses[r], env.goals[r])
            self.planners[r] = planner

    def act(self, env, observations):
        angles = ANGLES if self.planner.senses else []
        readings = range_readings(env.world, angles, RANGE)
        commands = [self.planners[r].act(pose, readings[r])
                    for r, pose in enumerate(env.world.poses)]
        return np.array(commands) / MAX_COMMAND
