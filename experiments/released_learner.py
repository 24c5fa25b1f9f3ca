"""Why does training from one start pose never reach env1's new target here, where the released
record has 61 of the last 100 episodes? One change at a time, this goes from our learner towards the
one that was released with the paper (docs/paper.md).

`python -m experiments.released_learner` trains every variant with three seeds, env1's one start
pose and a fixed budget of steps, two runs at a time, and writes results/released_learner.csv. A run
that is there already is not trained again.
"""

import csv
import json
import math
import os
import shutil
import subprocess
import sys
from concurrent.futures import ThreadPoolExecutor
from dataclasses import asdict, dataclass
from itertools import product
from pathlib import Path

import numpy as np
import torch
from torch import nn
from torch.distributions import Beta, Normal

import ppo
import scenes
from evaluation import Policy, evaluate
from model import HIDDEN, Network, orthogonal
from navbot_min import LOWEST_ACTION, NavVecEnv
from support.adam import Adam
from support.command_line import CommandLine, option
from support.pictures import read_table
from support.processes import OneProcess
from support.run_folder import RunFolder
from support.weights import save_model
from support.record import WINDOW
from train import Config, Training, train

RESULT = Path(__file__).parent.parent / "results" / "released_learner.csv"
RUNS = Path("runs") / "released-learner"
STEPS = 270_000  # about as many as the released record of env1 has
SEEDS = (0, 1, 2)
EPISODES = 1000  # of the frozen evaluation, to targets of each kind
OUR_GRADIENT = ppo.gradient


# ------------------------------------------------------------------------------- the single changes


class UnwrappedBearing(NavVecEnv):
    """The bearing is never wrapped, and the heading is taken in [0, 2 pi) at an episode's start but
    in (-pi, pi] afterwards: it jumps by 2 pi after the first step."""

    def observe(self, robots, poses, goals, velocities, last_rewards):
        seen = super().observe(robots, poses, goals, velocities, last_rewards)
        first = self._steps[robots] == 0
        heading = np.where(first, np.mod(poses[:, 2], 2 * np.pi), poses[:, 2])
        direction = np.arctan2(goals[:, 1] - poses[:, 1], goals[:, 0] - poses[:, 0])
        seen["target"][:, 1] = direction - heading
        return seen


class StoredMemory(NavVecEnv):
    """Shows, beside what the camera sees, the policy's own memory before each step, so that it is
    stored with the episode: gradients of one step begin there."""

    collector = None  # set once there is one

    def observe(self, robots, poses, goals, velocities, last_rewards):
        seen = super().observe(robots, poses, goals, velocities, last_rewards)
        seen["memory"] = np.zeros((len(robots), 2, 2, HIDDEN), np.float32)
        if self.collector is not None:
            later = self._steps[robots] > 0  # an episode begins with an empty memory
            seen["memory"][later] = self.collector._memory[robots[later]].numpy()
        return seen


class OneStepGradients(Network):
    """In an update every step is a sequence of its own that begins with its stored memory."""

    def forward(self, observations, state, mask=None):
        if mask is None:
            return super().forward(observations, state)
        steps = {key: value[mask][:, None] for key, value in observations.items()
                 if key != "image"}  # (B, 1, ...)
        steps["image"] = observations["image"][:, None]
        distribution, values, _ = super().forward(steps, steps["memory"][:, 0])
        return in_rows(distribution, mask), rows_of(values[:, 0], mask), state


class BetaPolicy(Network):
    """A Beta distribution over the actions' bounds instead of the Gaussian, as the released
    learner's library has it: both parameters are softplus(x) + 1."""

    def __init__(self, *arguments):
        super().__init__(*arguments)
        self.action = orthogonal(nn.Linear(HIDDEN, 4), 0.01)

    def policy(self, x):
        alpha, beta = (nn.functional.softplus(self.action(x)) + 1).chunk(2, -1)
        return BoundedBeta(alpha, beta)

    def limit_std(self, share):
        """It has no standard deviation of its own."""

    @torch.no_grad()
    def act(self, observations, state, generator):
        seen = {key: torch.as_tensor(value)[:, None] for key, value in observations.items()}
        distribution, values, state = self(seen, state)
        distribution = distribution[:, 0]
        actions = distribution.sample(generator)
        log_probs = distribution.log_prob(actions).sum(-1)
        return distribution.mean, actions, log_probs, values[:, 0], state


class OneStepBeta(OneStepGradients, BetaPolicy):
    """Both."""


class BoundedBeta:
    """Beta distributions (..., 2) of the linear action in [0, 1] and the angular in [-1, 1]."""

    low = torch.tensor(LOWEST_ACTION, dtype=torch.float32)
    width = 1 - low

    def __init__(self, alpha, beta):
        self.alpha = alpha
        self.beta = beta
        self.unit = Beta(alpha, beta)  # on [0, 1]
        self.mean = self.low + self.width * self.unit.mean

    def __getitem__(self, index):
        return BoundedBeta(self.alpha[index], self.beta[index])

    def sample(self, generator):
        """One action each: of two gamma-distributed numbers the first one's share is beta."""
        one = torch._standard_gamma(self.alpha, generator=generator)
        other = torch._standard_gamma(self.beta, generator=generator)
        return self.low + self.width * one / (one + other)

    def log_prob(self, actions):
        unit = ((actions - self.low) / self.width).clamp(1e-6, 1 - 1e-6)
        return self.unit.log_prob(unit) - self.width.log()

    def entropy(self):
        return self.unit.entropy() + self.width.log()


def rows_of(steps, mask):
    """(M, T, ...) from the values of the real steps (B, ...), zeros elsewhere."""
    rows = steps.new_zeros(*mask.shape, *steps.shape[1:])
    rows[mask] = steps
    return rows


def in_rows(distribution, mask):
    """The distribution of the real steps (B, 1, 2) as one of rows (M, T, 2)."""
    if isinstance(distribution, BoundedBeta):
        filler = torch.ones(*mask.shape, 2)
        alpha = filler.masked_scatter(mask[..., None], distribution.alpha[:, 0])
        beta = filler.masked_scatter(mask[..., None], distribution.beta[:, 0])
        return BoundedBeta(alpha, beta)
    mean = rows_of(distribution.mean[:, 0], mask)
    return Normal(mean, distribution.stddev[0, 0])


# ------------------------------------------------------------------------------------- the variants


@dataclass
class Variant:
    """How a variant differs from our learner."""
    wrapped: bool = True  # the bearing
    annealing: bool = True  # of the learning rate and the standard deviation
    baseline: bool = True  # the value, GAE and normalised advantages
    through_time: bool = True  # gradients through all steps of an episode
    gaussian: bool = True
    one_robot: bool = False  # and the released settings of an update


VARIANTS = {
    "baseline": Variant(),
    "unwrapped-bearing": Variant(wrapped=False),
    "no-annealing": Variant(annealing=False),
    "no-baseline": Variant(baseline=False),
    "one-step-gradients": Variant(through_time=False),
    "beta": Variant(gaussian=False),
    "all": Variant(False, False, False, False, False),
    "released": Variant(False, False, False, False, False, one_robot=True)}


def gradient_of_returns(model, batch, eps):
    """As `ppo.gradient`, with the discounted returns as they are for advantages."""
    batch["advantages"] = batch["returns"]
    return OUR_GRADIENT(model, batch, eps)


class VariedTraining(Training):
    """A Training of a variant."""

    def __init__(self, variant, config, rooms):
        self.variant = variant
        super().__init__(config, rooms, OneProcess())
        network = {(True, True): Network, (True, False): BetaPolicy,
                   (False, True): OneStepGradients, (False, False): OneStepBeta}[
                       variant.through_time, variant.gaussian]
        with torch.random.fork_rng(devices=[]):
            torch.manual_seed(config.seed)
            self.model = network(config.memory, config.without)
        self.collector.model = self.model
        self.optimizer = Adam(self.model)
        if not variant.through_time:
            self.env.collector = self.collector

    def make_env(self, rooms):
        parts = []
        if not self.variant.wrapped:
            parts.append(UnwrappedBearing)
        if not self.variant.through_time:
            parts.append(StoredMemory)
        kind = type("VariedEnv", (*parts, NavVecEnv), {})
        return kind(len(rooms), rooms, "both", self.config.random_starts)

    def learn(self):
        if self.variant.one_robot:
            statistics = self.learn_as_released()
        elif self.variant.annealing and self.variant.baseline:
            return super().learn()
        else:
            statistics = self.learn_without()
        self.buffer = []
        return statistics

    def learn_without(self):
        """An update without annealing or without a baseline: A are the discounted returns as they
        are, and no value is learnt."""
        left = max(1 - self.record.steps / self.config.steps, 0)
        rate = self.config.learning_rate * (left if self.variant.annealing else 1)
        if self.variant.baseline:
            return ppo.update(self.model, self.optimizer, rate, self.buffer, self.config, self.rng,
                              self.processes)
        for episode in self.buffer:
            episode.values = np.zeros_like(episode.values)
            episode.last_value = 0.0
        config = Config(**asdict(self.config) | {"lam": 1.0})
        kept = ppo.VALUE_WEIGHT, ppo.gradient
        ppo.VALUE_WEIGHT = 0.0
        ppo.gradient = gradient_of_returns
        try:
            statistics = ppo.update(self.model, self.optimizer, rate, self.buffer, config, self.rng,
                                    self.processes)
        finally:
            ppo.VALUE_WEIGHT, ppo.gradient = kept
        if self.variant.annealing:
            self.anneal_std(left)
        return statistics

    def anneal_std(self, left):
        """As in Training.learn."""
        from train import ANNEALING, FINAL_STD
        self.model.limit_std(FINAL_STD + (1 - FINAL_STD) * min(left / ANNEALING, 1))

    def learn_as_released(self):
        """50 steps of Adam, each on a random tenth of the steps of 10 episodes; the ratio is
        clipped to [1 / 1.2, 1.2], and the objective averaged over the two actions."""
        gamma = self.config.gamma
        returns = torch.tensor(np.concatenate(
            [ppo.advantages(e.rewards, np.zeros_like(e.values), 0.0, gamma, 1.0)
             for e in self.buffer]))
        actions = torch.tensor(np.concatenate([e.actions for e in self.buffer]))
        seen = {key: torch.tensor(np.concatenate([e.observations[key] for e in self.buffer]))
                for key in self.buffer[0].observations}
        with torch.no_grad():
            before = self.log_probs_of(seen, actions)
        for _ in range(50):
            chosen = self.rng.choice(len(returns), max(len(returns) // 10, 1), replace=False)
            some = {key: value[chosen] for key, value in seen.items()}
            r = (self.log_probs_of(some, actions[chosen]) - before[chosen]).exp()  # (B, 2)
            A = returns[chosen, None]
            loss = -torch.min(r * A, r.clamp(1 / 1.2, 1.2) * A).mean()
            gradients = torch.autograd.grad(loss, list(self.model.parameters()),
                                            materialize_grads=True)
            self.optimizer.step(torch.cat([one.flatten() for one in gradients]),
                                self.config.learning_rate)
        return {"policy_loss": loss.item()}

    def log_probs_of(self, seen, actions):
        """Log-probabilities (B, 2) of actions (B, 2), each step on its own."""
        steps = {key: value[:, None] for key, value in seen.items()}
        distribution, _, _ = self.model(steps, seen["memory"])
        return distribution.log_prob(actions[:, None])[:, 0]


def config_of(variant, seed, steps):
    """The Config of a run: one start pose, one room, all the steps."""
    # Otherwise the settings that our learner had when results/released_learner.csv was made.
    config = Config(seed=seed, steps=steps, fixed_budget=True, workers=1, random_starts=0.0,
                    mirrored=0.0, robots=32, episodes_per_update=32, learning_rate=6e-4)
    if variant.one_robot:
        config.robots = 1
        config.episodes_per_update = 10
        config.learning_rate = 1e-4
    return config


# -------------------------------------------------------------------------------------- the program


def run(name, seed, steps):
    """Trains and evaluates one run; its folder then holds `row.json`."""
    torch.set_num_threads(1)
    config = config_of(VARIANTS[name], seed, steps)
    room = scenes.load("env1")
    training = VariedTraining(VARIANTS[name], config, [room])
    config.out = str(RUNS / f"{name}-seed{seed}")
    folder = RunFolder(config, training.record)
    train(training, folder)
    save_model(folder.path / "model.pt", training.model, [room])
    frozen = evaluate_varied(training, room, seed)
    peak, peak_steps, last = rolling(folder.path / "episodes.csv")
    row = {"variant": name, "seed": seed, "steps": training.record.steps,
           "seconds": round(training.record.seconds, 1),
           "peak_success": peak, "peak_steps": peak_steps, "last_success": last,
           "frozen_new": frozen["new"]["success"],
           "frozen_training": frozen["training"]["success"]}
    folder.write("row.json", json.dumps(row, indent=2))


def evaluate_varied(training, room, seed):
    """The frozen evaluation: what the policy sees is as in its training."""
    environment = NavVecEnv if training.variant.wrapped else UnwrappedBearing
    frozen, _ = evaluate(Policy(training.model, "sampled", seed), [room], EPISODES, seed=seed,
                         environment=environment)
    return frozen


def rolling(path):
    """The best success rate of 100 successive episodes to the new target, the steps at which that
    was, and the last such rate. NaN where there were no 100."""
    episodes = [row for row in read_table(path) if row["kind"] == "new"]
    arrived = [row["outcome"] == "arrival" for row in episodes]
    rates = [np.mean(arrived[k - WINDOW:k]) for k in range(WINDOW, len(arrived) + 1)]
    if not rates:
        return math.nan, 0, math.nan
    best = int(np.argmax(rates))
    return float(rates[best]), int(episodes[best + WINDOW - 1]["steps"]), float(rates[-1])


@dataclass
class Options:
    """What to train."""
    variant: str = option("", "train this variant alone; by default all", choices=["", *VARIANTS])
    seed: int = option(-1, "with --variant, train this seed alone; by default all", -1)
    steps: int = option(STEPS, "steps of each run", 1, 10 ** 9)
    jobs: int = option(2, "so many runs at a time, a core each", 1, 64)


def call(name, seed, steps):
    """One run in a process of its own, unless it is done; returns its row."""
    done = RUNS / f"{name}-seed{seed}" / "row.json"
    if not done.exists():
        shutil.rmtree(done.parent, ignore_errors=True)  # of a run that was interrupted
        subprocess.run([sys.executable, "-m", "experiments.released_learner", "--variant", name,
                        "--seed", str(seed), "--steps", str(steps)], check=True,
                       env=os.environ | {"OMP_NUM_THREADS": "1"}, capture_output=True)
        print(f"{done.parent} done", flush=True)
    return json.loads(done.read_text())


def main(argv=None):
    """The command line."""
    parser = CommandLine("Train the steps from our learner towards the released one.")
    options = parser.read(Options, argv)
    for folder in (RUNS, RESULT.parent):
        parser.must_write_to(folder)
    if options.seed >= 0:
        if not options.variant:
            parser.error("--seed is given without --variant, it must name one of "
                         + ", ".join(VARIANTS))
        run(options.variant, options.seed, options.steps)
        return
    names = [options.variant] if options.variant else list(VARIANTS)
    tasks = [(name, seed, options.steps) for seed, name in product(SEEDS, names)]
    try:
        with ThreadPoolExecutor(options.jobs) as pool:
            rows = list(pool.map(call, *zip(*tasks)))
    except subprocess.CalledProcessError as error:
        reason = error.stderr.decode().strip().splitlines()[-1]
        parser.error(f"'{' '.join(error.cmd[1:])}' failed: {reason}")
    rows.sort(key=lambda row: (list(VARIANTS).index(row["variant"]), row["seed"]))
    with open(RESULT, "w", newline="") as file:
        writer = csv.DictWriter(file, rows[0])
        writer.writeheader()
        writer.writerows(rows)


if __name__ == "__main__":
    main()
