"""Variants of our learner with parts of the released one. Does any reach env1's new target from
one start pose (docs/paper.md)? `python -m experiments.released_learner` trains all of them."""

from contextlib import ExitStack
from dataclasses import replace
from itertools import product
from unittest.mock import patch

import numpy as np
import torch

import ppo
import scenes
import train
from evaluation import Policy, evaluate
from experiments.tables import RESULTS
from model import HIDDEN, Network, orthogonal
from navbot_min import LOWEST_ACTION, NavVecEnv
from ppo import Collector
from support.cli import parse
from support.parallel import in_processes
from support.runs import read_table, write
from train import WINDOW, Config, Training

RESULT = RESULTS / "released_learner.csv"
STEPS = 270_000  # about as many as in the released record of env1
SEEDS = (0, 1, 2)
CLIP = 1.2  # largest ratio in the released update; the smallest is its inverse

CHANGES = ("unwrapped-bearing", "no-annealing", "no-baseline", "one-step-gradients", "beta")
VARIANTS = {"baseline": (), **{change: (change,) for change in CHANGES}, "all": CHANGES,
            "released": (*CHANGES, "one-robot")}  # with the settings of the released update


class UnwrappedBearing(NavVecEnv):
    """Never wraps the bearing: its heading is in [0, 2 pi) at first and in (-pi, pi] afterwards."""

    def observe(self, robots, poses, goals, velocities, last_rewards):
        seen = super().observe(robots, poses, goals, velocities, last_rewards)
        start = self._steps[robots] == 0
        heading = np.where(start, poses[:, 2] % (2 * np.pi), poses[:, 2])
        direction = np.arctan2(goals[:, 1] - poses[:, 1], goals[:, 0] - poses[:, 0])
        seen["target"][:, 1] = direction - heading
        return seen


class StoringCollector(Collector):
    """Stores the policy's memory before each step as one more observation, `memory`."""

    def step(self):
        self._observations["memory"] = self._memory.numpy()
        return super().step()

    def _take_episode(self, r, last_value):
        self._observations["memory"] = None  # only arrays named here are kept in an episode
        return super()._take_episode(r, last_value)


class OneStepGradients(Network):
    """In an update, makes each step a separate sequence that begins with its stored memory."""

    def forward(self, observations, state, mask=None):
        state = state if mask is None else observations["memory"]
        return super().forward(observations, state, mask)

    def remember(self, features, target, last, state):
        if state.dim() == 4:  # driving robots, not (M, T, layers, 2, HIDDEN)
            return super().remember(features, target, last, state)
        steps = [x.flatten(0, 1)[:, None] for x in (features, target, last)]  # (M T, 1, ...)
        x, after = super().remember(*steps, state.flatten(0, 1))
        return x.view(*state.shape[:2], HIDDEN), after


class BoundedBeta:
    """Beta distributions (..., 2) of the linear action in [0, 1] and the angular in [-1, 1]."""

    low = torch.tensor(LOWEST_ACTION, dtype=torch.float32)
    width = 1 - low

    def __init__(self, alpha, beta):
        self.unit = torch.distributions.Beta(alpha, beta)  # on [0, 1]
        self.mean = self.low + self.width * self.unit.mean

    def sample(self, generator):
        # If x and y are gamma-distributed, x / (x + y) is beta-distributed.
        one = torch._standard_gamma(self.unit.concentration1, generator=generator)
        other = torch._standard_gamma(self.unit.concentration0, generator=generator)
        return self.low + self.width * one / (one + other)

    def log_prob(self, actions):
        unit = ((actions - self.low) / self.width).clamp(1e-6, 1 - 1e-6)
        return self.unit.log_prob(unit) - self.width.log()

    def entropy(self):
        return self.unit.entropy() + self.width.log()


class BetaPolicy(Network):
    """Has a BoundedBeta instead of the Gaussian, with both parameters softplus(x) + 1."""

    def __init__(self):
        super().__init__()
        self.action_head = orthogonal(torch.nn.Linear(HIDDEN, 4), 0.01)
        del self.log_std  # not a parameter here
        self.register_buffer("log_std", torch.zeros(2))

    def policy(self, x):
        return BoundedBeta(*(torch.nn.functional.softplus(self.action_head(x)) + 1).chunk(2, -1))

    @torch.no_grad()
    def act(self, observations, state, generator):
        seen = {key: torch.as_tensor(value)[:, None] for key, value in observations.items()}
        distribution, values, state = self(seen, state)
        actions = distribution.sample(generator)
        log_probs = distribution.log_prob(actions).sum(-1)
        return distribution.mean[:, 0], actions[:, 0], log_probs[:, 0], values[:, 0], state


def update_as_released(model, optimizer, episodes, config, rng, total):
    """Makes one update like the released one. Arguments: those of `ppo.update`."""
    returns = torch.tensor(np.concatenate(
        [ppo.advantages(e.rewards, e.values, e.last_value, config.gamma, config.lam)
         for e in episodes]))
    actions = torch.tensor(np.concatenate([e.actions for e in episodes]))
    seen = {key: torch.tensor(np.concatenate([e.observations[key] for e in episodes]))
            for key in episodes[0].observations}
    with torch.no_grad():
        before = log_probs_of(model, seen, actions)
    for _ in range(50):  # Adam steps, each on a random tenth of the data
        chosen = rng.choice(len(returns), max(len(returns) // 10, 1), replace=False)
        some = {key: value[chosen] for key, value in seen.items()}
        r = (log_probs_of(model, some, actions[chosen]) - before[chosen]).exp()
        loss = released_loss(r, returns[chosen, None])
        optimizer.zero_grad()
        loss.backward()
        optimizer.step()
    return {"policy_loss": loss.item()}


def log_probs_of(model, seen, actions):
    """Returns the log-probabilities (B, 2) of actions (B, 2). Each step has its stored memory."""
    steps = {key: value[:, None] for key, value in seen.items()}
    return model(steps, seen["memory"])[0].log_prob(actions[:, None])[:, 0]


def released_loss(r, A):
    """Returns the clipped loss for ratios (B, 2), one per action, and advantages (B, 1)."""
    return -torch.min(r * A, r.clamp(1 / CLIP, CLIP) * A).mean()


class VariedTraining(Training):
    """A Training with a tuple of changes from CHANGES."""

    def __init__(self, changes, config, scenes):
        self.changes = changes
        self.rates = []  # (success on the new target in the last WINDOW episodes, steps)
        super().__init__(config, scenes)
        if "unwrapped-bearing" in changes:
            self.environment = UnwrappedBearing

    def first_network(self):
        parts = {"one-step-gradients": OneStepGradients, "beta": BetaPolicy}
        bases = [part for change, part in parts.items() if change in self.changes]
        with torch.random.fork_rng(devices=[]):
            torch.manual_seed(self.config.seed)
            return type("VariedNetwork", (*bases, Network), {})()

    def begin_stage(self):
        collector = StoringCollector if "one-step-gradients" in self.changes else Collector
        with patch.object(train, "Collector", collector):
            super().begin_stage()
        self.next_stage = np.inf  # with one robot a stage would have 781 steps

    def record(self, row):
        super().record(row)
        if row["kind"] == "new" and len(self.arrivals["new"]) == WINDOW:
            self.rates.append((self.success("new"), row["steps"]))

    def learn(self, episodes):
        with ExitStack() as changed:
            if "no-baseline" in self.changes:  # no value, no GAE, no normalization
                episodes = [replace(episode, values=np.zeros_like(episode.values), last_value=0.0)
                            for episode in episodes]
                changed.enter_context(patch.multiple(ppo, VALUE_WEIGHT=0.0,
                                                     mean_and_std=lambda *numbers: (0.0, 1.0)))
            if "one-robot" in self.changes:
                changed.enter_context(patch.object(train, "update", update_as_released))
            if "no-annealing" in self.changes:  # fixed learning rate, standard deviation
                changed.enter_context(patch.object(self, "progress", lambda: 0.0))
            return super().learn(episodes)


def make_training(name, seed):
    """Returns the VariedTraining of a variant: one start pose, one room, a fixed budget."""
    # The other settings are those that our learner had when results/released_learner.csv was made.
    config = Config(seed=seed, steps=STEPS, fixed_budget=True, random_starts=0.0, mirrored=0.0,
                    robots=32, episodes_per_update=32, learning_rate=6e-4,
                    lam=1.0 if "no-baseline" in VARIANTS[name] else Config.lam)
    if "one-robot" in VARIANTS[name]:
        config = replace(config, robots=1, episodes_per_update=10, learning_rate=1e-4)
    return VariedTraining(VARIANTS[name], config, [scenes.load("env1")])


def learn(name, seed):
    """Trains and evaluates a variant. Returns its row of RESULT."""
    training = make_training(name, seed)
    train.train(training)
    frozen, _ = evaluate(Policy(training.model, "sampled", seed), training.scenes, seed=seed,
                         environment=training.environment)
    rates = training.rates or [(np.nan, 0)]
    peak, peak_steps = max(rates, key=lambda rate: rate[0])
    return {"variant": name, "seed": seed, "steps": training.steps,
            "seconds": round(training.seconds, 1), "peak_success": peak, "peak_steps": peak_steps,
            "last_success": rates[-1][0], "frozen_new": frozen["new"]["success"],
            "frozen_training": frozen["training"]["success"]}


def main(argv=None):
    """Trains the runs that RESULT does not have, and adds a row for each."""
    parse({}, "Train the runs that the table does not have, two at a time.", argv)
    torch.set_num_threads(1)
    rows = read_table(RESULT) if RESULT.exists() else []
    made = {(row["variant"], int(row["seed"])) for row in rows}
    for row in in_processes(learn, [run for run in product(VARIANTS, SEEDS) if run not in made], 2):
        rows.append(row)
        lines = [",".join(map(str, line)) for line in (row, *map(dict.values, rows))]
        write(RESULT, "\n".join(lines) + "\n")


if __name__ == "__main__":
    main()
