"""The learner: PPO on whole episodes (Schulman et al. 2017; paper Eq. (2), (3), Algorithm 1).

The code uses the letters of the formulas: A advantage, gamma discount, lam (lambda) of GAE, eps
clip range. Axis letters: R robots, T steps of an episode, M episodes of a minibatch, B its
real steps (those that are not padding), N episodes per update, K epochs.

Instead of an entropy bonus, the standard deviation of the actions is a parameter that starts large
and shrinks as the policy learns, within the limits of `Training.limit_std`.
"""

from dataclasses import dataclass

import numpy as np
import torch
from torch import nn
from torch.nn.functional import mse_loss
from torch.nn.utils.rnn import pad_sequence

VALUE_WEIGHT = 0.5  # weight of the value loss, our choice
MAX_GRADIENT_NORM = 0.5  # larger gradients are scaled down to this norm, our choice
STATISTICS = ("policy_loss", "value_loss", "entropy", "kl", "clip_fraction")


@dataclass
class Episode:
    """Observations, actions and rewards of one whole episode, as arrays over its T steps."""
    observations: dict  # name -> (T, ...) array, as the environment returns it
    actions: np.ndarray  # (T, 2) as sampled, before clipping
    log_probs: np.ndarray  # (T,) of the actions, when they were taken
    values: np.ndarray  # (T,) predicted at the same steps
    rewards: np.ndarray  # (T,) scaled
    last_value: float  # value of the last observation; 0 if the episode was terminated

    def __len__(self):
        return len(self.actions)


class Collector:
    """Drives R robots with the current policy and returns whole episodes. Robots never wait for
    each other: an episode that is under way during an update continues after it."""

    def __init__(self, env, model, reward_scale, env_seed, action_seed):
        """env: a Gymnasium VectorEnv with same-step autoreset and dict observations. env_seed seeds
        it; action_seed seeds the sampled actions."""
        self.env = env
        self.model = model
        self.reward_scale = reward_scale
        self.generator = torch.Generator().manual_seed(action_seed)
        self._observations, _ = env.reset(seed=env_seed)
        self._memory = model.initial_state(env.num_envs)
        self._length = np.zeros(env.num_envs, dtype=int)  # (R,) steps in the current episodes
        self._history = []  # the last steps of all robots, each a dict name -> (R, ...)

    def step(self):
        """Makes one step with all robots. Returns the episodes that end with it, as a list of
        (Episode, info); info holds the robot's index and its `final_info`."""
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
            self._memory[r] = 0  # clear the memory after either ending
        # Keep only the steps of episodes that are still under way.
        self._history = self._history[len(self._history) - self._length.max():]
        return ended

    def _take_episode(self, r, last_value):
        """Returns the episode that robot r has just finished."""
        history = self._history[-self._length[r]:]
        steps = {name: np.stack([step[name][r] for step in history]) for name in history[0]}
        observations = {name: steps.pop(name) for name in self._observations}
        self._length[r] = 0
        return Episode(observations, **steps, last_value=float(last_value))

    def _last_values(self, truncated, infos):
        """Returns the values (R,) to bootstrap from: for truncated episodes the value of the true
        last observation, with the memory at that step; 0 for all others."""
        values = np.zeros(len(truncated))
        robots = np.flatnonzero(truncated)
        if len(robots):
            final = {key: value[robots] for key, value in infos["final_obs"].items()}
            _, _, _, last_values, _ = self.model.act(final, self._memory[robots], self.generator)
            values[robots] = last_values.numpy()
        return values


def advantages(rewards, values, last_value, gamma, lam):
    """Returns the advantages (T,) of one episode by generalised advantage estimation (Schulman et
    al. 2016): A_t = sum_k (gamma lam)^k delta_{t+k}, delta_t = r_t + gamma V_{t+1} - V_t.

    rewards, values: (T,). last_value: V_T, the value of the last observation if the episode was
    truncated, 0 if it was terminated.
    """
    next_values = np.append(values[1:], last_value)
    deltas = rewards + gamma * next_values - values
    A = deltas.tolist()  # a loop is faster over a list than over an array
    for t in reversed(range(len(A) - 1)):
        A[t] += gamma * lam * A[t + 1]
    return np.array(A, np.float32)


def make_minibatch(episodes, batch_advantages, device=None):
    """Pads M episodes and their advantages to the longest one, T steps. Returns a dict of tensors
    (M, T, ...); `mask` (M, T) is True for real steps. Images are not padded: (B, H, W, 3)."""
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
            # Value targets: A + V, by the definition of A.
            "returns": pad([A + e.values for A, e in zip(batch_advantages, episodes)]),
            "mask": pad([np.ones(len(e), bool) for e in episodes])}


def losses(model, batch, eps):
    """Returns the clipped policy loss of a minibatch, Eq. (3), its value loss and its STATISTICS.
    All means are over the real steps."""
    mask = batch["mask"]
    memory = model.initial_state(len(mask))
    distribution, values, _ = model(batch["observations"], memory, mask)
    log_probs = distribution.log_prob(batch["actions"]).sum(-1)[mask]  # (B,)
    log_ratio = log_probs - batch["log_probs"][mask]
    ratio = log_ratio.exp()
    A = batch["advantages"][mask]
    objective = torch.min(ratio * A, ratio.clamp(1 - eps, 1 + eps) * A)  # Eq. (3)
    policy_loss = -objective.mean()
    value_loss = mse_loss(values[mask], batch["returns"][mask])
    with torch.no_grad():
        entropy = distribution.entropy().sum(-1)[mask].mean()
        kl = (ratio - 1 - log_ratio).mean()  # never negative (Schulman 2020, estimator k3)
        clip_fraction = ((ratio - 1).abs() > eps).float().mean()
        statistics = torch.stack([policy_loss, value_loss, entropy, kl, clip_fraction])
    return policy_loss, value_loss, statistics


def mean_and_std(numbers, total):
    """Returns mean and standard deviation over all processes. numbers: (n,), those of this one."""
    sums = torch.tensor([len(numbers), numbers.sum(), (numbers.astype(float) ** 2).sum()])
    count, first, second = total(sums.double()).tolist()
    mean = first / count
    return mean, max(second / count - mean ** 2, 0) ** 0.5


@torch.no_grad()
def average_gradient(model, statistics, steps, total):
    """Replaces the gradient by its mean over the steps of all processes. Returns the same mean of
    the statistics. steps: number of steps in this process."""
    gradients = [parameter.grad for parameter in model.parameters()]
    parts = [torch.ones(1, device=steps.device), statistics, *gradients]
    sums = total(torch.cat([part.flatten() for part in parts]).mul_(steps))  # sums[0]: all steps
    means = sums.div_(sums[0].item()).split([part.numel() for part in parts])
    for gradient, mean in zip(gradients, means[2:]):
        gradient.copy_(mean.view_as(gradient))
    return means[1]


def update(model, optimizer, episodes, config, rng, total=lambda tensor: tensor):
    """Updates the model: K epochs over minibatches of whole episodes, Algorithm 1. Returns mean
    statistics. Raises FloatingPointError if a gradient is not finite.

    config: has `epochs`, `minibatches`, `gamma`, `lam`, `clip`. rng: numpy Generator for shuffles.
    total: sums a tensor over all training processes; each learns from its own episodes.
    """
    A = [advantages(e.rewards, e.values, e.last_value, config.gamma, config.lam) for e in episodes]
    all_A = np.concatenate(A)
    returns = all_A + np.concatenate([episode.values for episode in episodes])
    mean, std = mean_and_std(all_A, total)
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
    # An advantage is the error of a predicted value: 1 means no errors, 0 no better than the mean.
    statistics["explained_variance"] = 1 - std ** 2 / max(returns_std ** 2, 1e-12)
    return statistics
