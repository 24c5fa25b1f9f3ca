"""The learner: PPO on whole episodes (Schulman et al. 2017; paper Eq. (2), (3), Algorithm 1).

The formulas and the code share their letters: r ratio, A advantage, gamma discount, lam (lambda) of
GAE, eps clip range. Axis letters: R robots, T steps of an episode, M episodes of a minibatch, B its
real steps (those that are not padding), N episodes of an update, K epochs.

There is no entropy bonus: the policy's standard deviation is a parameter, which starts large,
shrinks as the policy learns, and is limited towards the end of a run.
"""

from dataclasses import dataclass

import numpy as np
import torch
from torch import nn
from torch.nn.functional import mse_loss
from torch.nn.utils.rnn import pad_sequence

VALUE_WEIGHT = 0.5  # of the value loss beside the policy loss, our choice
MAX_GRADIENT_NORM = 0.5  # longer gradients are scaled down to it, our choice
STATISTICS = ("policy_loss", "value_loss", "entropy", "kl", "clip_fraction")


@dataclass
class Episode:
    """What the policy saw, did and got in one whole episode, as arrays over its T steps."""
    observations: dict  # of (T, ...) arrays, as the environment gives them
    actions: np.ndarray  # (T, 2) as sampled, before clipping
    log_probs: np.ndarray  # (T,) of the actions, when they were taken
    values: np.ndarray  # (T,) predicted when they were taken
    rewards: np.ndarray  # (T,) scaled
    last_value: float  # predicted for the last observation; 0 if the episode was terminated

    def __len__(self):
        return len(self.actions)


class Collector:
    """Drives R robots with the policy as it is at each step, and hands out whole episodes. Robots
    never wait for each other: an episode under way during an update goes on after it."""

    def __init__(self, env, model, reward_scale, env_seed, action_seed):
        """env: a Gymnasium VectorEnv with same-step autoreset and dict observations; it gets the
        first seed, the generator that draws the actions gets the second."""
        self.env = env
        self.model = model
        self.reward_scale = reward_scale
        self.generator = torch.Generator().manual_seed(action_seed)
        self._observations, _ = env.reset(seed=env_seed)
        self._memory = model.initial_state(env.num_envs)
        self._length = np.zeros(env.num_envs, dtype=int)  # steps of the episodes under way
        self._history = []  # the last steps of all robots, name -> (R, ...) each

    def step(self):
        """Makes one step of all robots. Returns the episodes that it ended, [(Episode, info), ...]:
        info holds the robot's index and the environment's `final_info` of it."""
        seen = self._observations
        _, actions, log_probs, values, self._memory = self.model.act(seen, self._memory,
                                                                     self.generator)
        self._observations, rewards, terminated, truncated, infos = self.env.step(actions.numpy())
        scaled = (rewards * self.reward_scale).astype(np.float32)
        self._history.append(seen | {"actions": actions.numpy(), "log_probs": log_probs.numpy(),
                                     "values": values.numpy(), "rewards": scaled})
        self._length += 1
        last_values = self._last_values(truncated, infos)
        ended = []
        for r in np.flatnonzero(terminated | truncated):
            info = {name: value[r].item() for name, value in infos["final_info"].items()}
            info["robot"] = int(r)
            ended.append((self._take_episode(r, last_values[r]), info))
            self._memory[r] = 0  # memory is cleared at terminated and truncated alike
        self._history = self._history[len(self._history) - self._length.max():]
        return ended

    def _take_episode(self, r, last_value):
        """The whole episode that robot r has ended."""
        history = self._history[-self._length[r]:]
        steps = {name: np.stack([step[name][r] for step in history]) for name in history[0]}
        observations = {name: steps.pop(name) for name in self._observations}
        self._length[r] = 0
        return Episode(observations, **steps, last_value=float(last_value))

    def _last_values(self, truncated, infos):
        """(R,) values to bootstrap from: where time ran out, that of the true last observation with
        the memory of that moment; 0 where an episode was terminated."""
        values = np.zeros(len(truncated))
        robots = np.flatnonzero(truncated)
        if len(robots):
            final = {key: value[robots] for key, value in infos["final_obs"].items()}
            # Of an action only its value is wanted here.
            _, _, _, last_values, _ = self.model.act(final, self._memory[robots], self.generator)
            values[robots] = last_values.numpy()
        return values


def advantages(rewards, values, last_value, gamma, lam):
    """Generalised advantage estimation (Schulman et al. 2016) over one episode:
    A_t = sum_k (gamma lam)^k delta_{t+k}, delta_t = r_t + gamma V_{t+1} - V_t.

    rewards, values: (T,). last_value is V_T: the value of the last observation where time ran out,
    0 where the episode was terminated. Returns (T,).
    """
    next_values = np.append(values[1:], last_value)
    deltas = rewards + gamma * next_values - values
    A = deltas.tolist()  # one number at a time is faster with numbers than with arrays
    for t in reversed(range(len(A) - 1)):
        A[t] += gamma * lam * A[t + 1]
    return np.array(A, np.float32)


def make_minibatch(episodes, batch_advantages, device=None):
    """Pads M episodes and their advantages to the longest, T steps: returns a dict of (M, T, ...)
    tensors. `mask` (M, T) is True at real steps. Images are not padded: (B, H, W, 3)."""
    def pad(sequences):
        return pad_sequence([torch.as_tensor(s) for s in sequences], batch_first=True).to(device)

    observations = {key: pad([episode.observations[key] for episode in episodes])
                    for key in episodes[0].observations if key != "image"}
    images = np.concatenate([episode.observations["image"] for episode in episodes])
    observations["image"] = torch.as_tensor(images).to(device)
    return {"observations": observations,
            "actions": pad([episode.actions for episode in episodes]),
            "log_probs": pad([episode.log_probs for episode in episodes]),
            "advantages": pad(batch_advantages),
            # The values' targets are returns: A + V, by the definition of A.
            "returns": pad([A + e.values for A, e in zip(batch_advantages, episodes)]),
            "mask": pad([np.ones(len(e), bool) for e in episodes])}


def losses(model, batch, eps):
    """The clipped policy loss, Eq. (3), and the value loss of a minibatch, and its STATISTICS.

    Every mean is over the real steps.
    """
    mask = batch["mask"]
    memory = model.initial_state(len(mask))
    distribution, values, _ = model(batch["observations"], memory, mask)
    log_probs = distribution.log_prob(batch["actions"]).sum(-1)[mask]  # (B,)
    log_r = log_probs - batch["log_probs"][mask]
    r = log_r.exp()
    A = batch["advantages"][mask]
    objective = torch.min(r * A, r.clamp(1 - eps, 1 + eps) * A)  # Eq. (3)
    policy_loss = -objective.mean()
    value_loss = mse_loss(values[mask], batch["returns"][mask])
    with torch.no_grad():
        entropy = distribution.entropy().sum(-1)[mask].mean()
        kl = (r - 1 - log_r).mean()  # estimator k3, never negative
        clip_fraction = ((r - 1).abs() > eps).float().mean()
        statistics = torch.stack([policy_loss, value_loss, entropy, kl, clip_fraction])
    return policy_loss, value_loss, statistics


def mean_and_std(numbers, total):
    """Returns mean and standard deviation of all processes' numbers, (n,) in this one."""
    sums = torch.tensor([len(numbers), numbers.sum(), (numbers.astype(float) ** 2).sum()])
    count, first, second = total(sums.double()).tolist()
    mean = first / count
    return mean, max(second / count - mean ** 2, 0) ** 0.5


@torch.no_grad()
def average_gradient(model, statistics, steps, total):
    """Replaces the gradient by its mean over the steps of all processes; returns the same mean of
    the statistics. steps: how many this process has."""
    gradients = [parameter.grad for parameter in model.parameters()]
    parts = [torch.ones(1, device=steps.device), statistics, *gradients]
    sums = total(torch.cat([part.flatten() for part in parts]).mul_(steps))
    means = sums.div_(sums[0].item()).split([part.numel() for part in parts])
    for gradient, mean in zip(gradients, means[2:]):
        gradient.copy_(mean.view_as(gradient))
    return means[1]


def update(model, optimizer, episodes, config, rng, total=lambda tensor: tensor):
    """Learns from episodes: K epochs of minibatches of whole episodes, Algorithm 1. Returns the
    means of the statistics. Raises FloatingPointError for a gradient that is not finite.

    config: has `epochs`, `minibatches`, `gamma`, `lam`, `clip`. rng: numpy Generator, shuffles.
    total: sums a tensor over all processes that learn together, each from its own episodes.
    """
    A = [advantages(e.rewards, e.values, e.last_value, config.gamma, config.lam) for e in episodes]
    errors = np.concatenate(A)  # an advantage is the value's prediction error
    returns = errors + np.concatenate([episode.values for episode in episodes])
    mean, std = mean_and_std(errors, total)
    _, returns_std = mean_and_std(returns, total)
    history = []
    for _ in range(config.epochs):
        for chosen in np.array_split(rng.permutation(len(episodes)), config.minibatches):
            batch = make_minibatch([episodes[k] for k in chosen], [A[k] for k in chosen],
                                   model.log_std.device)
            batch["advantages"] = (batch["advantages"] - mean) / (std + 1e-8)
            policy_loss, value_loss, statistics = losses(model, batch, config.clip)
            optimizer.zero_grad()
            (policy_loss + VALUE_WEIGHT * value_loss).backward()
            history.append(average_gradient(model, statistics, batch["mask"].sum(), total))
            norm = nn.utils.clip_grad_norm_(model.parameters(), MAX_GRADIENT_NORM)
            if not norm.isfinite():
                raise FloatingPointError("the gradient is not finite")
            optimizer.step()
    statistics = dict(zip(STATISTICS, torch.stack(history).mean(0).tolist()))
    # 1 if the values predict the returns, 0 if they know nothing of them.
    statistics["explained_variance"] = 1 - std ** 2 / max(returns_std ** 2, 1e-12)
    return statistics
