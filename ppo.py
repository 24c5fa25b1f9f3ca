"""The learner: PPO on whole episodes (Schulman et al. 2017; paper Eq. (2), (3), Algorithm 1).

The letters are those of the formulas and of the code alike: r ratio, A advantage, gamma discount,
lam (lambda) of GAE, eps clip range. Axis letters: R robots, T steps of an episode, M rows of a
minibatch, N episodes of an update, K epochs.
"""

from dataclasses import dataclass
from itertools import chain

import numpy as np
import torch
from torch import distributed
from torch.nn.functional import mse_loss
from torch.nn.utils.rnn import pad_sequence

VALUE_WEIGHT = 0.5  # of the value loss beside the policy loss, our choice
MAX_GRADIENT_NORM = 0.5  # longer gradients are scaled down to it, our choice


@dataclass
class Episode:
    """What the policy saw, did and got in one whole episode, as tensors over its T steps."""
    observations: dict  # of (T, ...) tensors, as the environment gives them
    actions: torch.Tensor  # (T, 2) as sampled, before clipping
    log_probs: torch.Tensor  # (T,) of the actions, when they were taken
    values: torch.Tensor  # (T,) predicted when they were taken
    rewards: torch.Tensor  # (T,) scaled
    last_value: float  # predicted for the last observation; 0 if the episode was terminated

    def __len__(self):
        return len(self.actions)


class Collector:
    """Drives R robots with the policy as it is at each step, and hands out whole episodes.

    Robots never wait for each other. An episode under way while the policy is updated goes on, with
    the log-probabilities that its actions had when they were taken.
    """

    def __init__(self, env, model, reward_scale, seed):
        """env: a Gymnasium VectorEnv with same-step autoreset and dict observations."""
        self.env, self.model, self.reward_scale = env, model, reward_scale
        self._observations, _ = env.reset(seed=seed)
        self._state = model.initial_state(env.num_envs)
        self._length = np.zeros(env.num_envs, dtype=int)  # steps of the episodes under way
        self._steps = {}  # name -> (R, longest episode, ...), the steps of the episodes under way

    def _store(self, **step):
        R = self.env.num_envs
        for name, value in step.items():
            value = torch.as_tensor(value)
            if name not in self._steps:
                self._steps[name] = torch.zeros(R, self.env.max_episode_steps, *value.shape[1:],
                                                dtype=value.dtype)
            self._steps[name][np.arange(R), self._length] = value

    def step(self):
        """One step of all robots. Returns the episodes that it ended, [(Episode, info), ...]."""
        seen = self._observations
        _, actions, log_probs, values, self._state = self.model.act(seen, self._state)
        self._observations, rewards, terminated, truncated, infos = self.env.step(actions.numpy())
        self._store(actions=actions, log_probs=log_probs, values=values,
                    rewards=(rewards * self.reward_scale).astype(np.float32), **seen)
        self._length += 1
        last_values = self._last_values(truncated, infos)
        ended = []
        for r in np.flatnonzero(terminated | truncated):
            T = self._length[r]
            steps = {name: value[r, :T].clone() for name, value in self._steps.items()}
            observations = {name: steps.pop(name) for name in seen}
            info = {name: value[r].item() for name, value in infos["final_info"].items()}
            ended.append((Episode(observations, **steps, last_value=last_values[r]), info))
            self._length[r] = 0
            self._state[r] = 0  # memory is cleared at terminated and truncated alike
        return ended

    def _last_values(self, truncated, infos):
        """(R,) values to bootstrap from: where time ran out, that of the true last observation with
        the memory of that moment; 0 where an episode was terminated."""
        values, robots = np.zeros(len(truncated)), np.flatnonzero(truncated)
        if len(robots):
            final = [infos["final_obs"][r] for r in robots]
            final = {key: np.stack([one[key] for one in final]) for key in final[0]}
            values[robots] = self.model.act(final, self._state[robots])[3].numpy()
        return values


def advantages(rewards, values, last_value, gamma, lam):
    """Generalised advantage estimation (Schulman et al. 2016) over one episode:
    A_t = sum_k (gamma lam)^k delta_{t+k}, delta_t = r_t + gamma V_{t+1} - V_t.

    rewards, values: (T,). last_value is V_T: the value of the last observation where time ran out,
    0 where the episode was terminated. Returns (T,).
    """
    following = torch.cat([values[1:], values.new_tensor([last_value])])
    result = (rewards + gamma * following - values).tolist()  # numbers are faster than tensors here
    for t in reversed(range(len(result) - 1)):
        result[t] += gamma * lam * result[t + 1]
    return values.new_tensor(result)


def rows(lengths):
    """Lists of episodes that together fit in rows as long as the longest, one step between two:
    first fit, the longest first. So hardly a step of a minibatch is padding."""
    filled, free = [], []
    for k in np.argsort(lengths)[::-1]:
        row = next((i for i, room in enumerate(free) if room > lengths[k]), len(free))
        if row == len(free):
            filled.append([])
            free.append(max(lengths) + 1)
        filled[row].append(k)
        free[row] -= lengths[k] + 1
    return filled


def lay(episodes, batch_advantages, device=None):
    """A minibatch of episodes end to end in M rows of T steps, zeros between: a dict of (M, T, ...)
    on the device, `mask` is which are real. Images have no zeros between them: (B, H, W, 3)."""
    order = rows([len(e) for e in episodes])

    def stack(sequences):
        parts = [[part for k in row for part in (sequences[k], torch.zeros_like(sequences[k][:1]))]
                 for row in order]
        return pad_sequence([torch.cat(row) for row in parts], batch_first=True).to(device)
    observations = {key: stack([e.observations[key] for e in episodes])
                    for key in episodes[0].observations if key != "image"}
    images = [episodes[k].observations["image"] for k in chain(*order)]
    observations["image"] = torch.cat(images).to(device)
    returns = [A + e.values for A, e in zip(batch_advantages, episodes)]
    return {"observations": observations, "actions": stack([e.actions for e in episodes]),
            "log_probs": stack([e.log_probs for e in episodes]),
            "advantages": stack(batch_advantages), "returns": stack(returns),
            "mask": stack([torch.ones(len(e), dtype=torch.bool) for e in episodes])}


def losses(model, batch, eps):
    """The clipped policy loss, Eq. (3), and the value loss of a minibatch, and statistics.

    Every mean is over the real steps alone.
    """
    mask = batch["mask"]
    state = model.initial_state(len(mask))
    distribution, values, _ = model(batch["observations"], state, mask)
    log_probs = distribution.log_prob(batch["actions"]).sum(-1)[mask]
    log_r = log_probs - batch["log_probs"][mask]
    r, A = log_r.exp(), batch["advantages"][mask]
    policy_loss = -torch.min(r * A, r.clamp(1 - eps, 1 + eps) * A).mean()  # Eq. (3)
    value_loss = mse_loss(values[mask], batch["returns"][mask])
    with torch.no_grad():
        statistics = {"policy_loss": policy_loss, "value_loss": value_loss,
                      "entropy": distribution.entropy().sum(-1)[mask].mean(),
                      "kl": (r - 1 - log_r).mean(),  # estimator k3, never negative
                      "clip_fraction": ((r - 1).abs() > eps).float().mean()}
    return policy_loss, value_loss, statistics


def total(tensor):
    """The sum of that tensor over all processes."""
    if distributed.is_initialized():
        distributed.all_reduce(tensor)
    return tensor


def average_gradients(model, steps):
    """Makes the gradients those of the minibatches of all processes together, whose losses are
    means over so many steps each."""
    if distributed.is_initialized():
        all_steps = total(model.log_std.new_tensor(steps))
        for parameter in model.parameters():
            total(parameter.grad.mul_(steps / all_steps))


def update(model, optimizer, episodes, config, rng):
    """K epochs of minibatches of whole episodes, Algorithm 1. Returns the statistics' means.

    config: has `epochs`, `minibatches`, `gamma`, `lam`, `clip`. rng: numpy Generator, shuffles.
    """
    A = [advantages(e.rewards, e.values, e.last_value, config.gamma, config.lam) for e in episodes]
    values, every_A, totals = torch.cat([e.values for e in episodes]), torch.cat(A).double(), {}
    n, first, second = total(torch.stack([every_A ** 0, every_A, every_A ** 2]).sum(1)).tolist()
    mean, std = first / n, max(second / n - (first / n) ** 2, 0) ** 0.5
    for _ in range(config.epochs):
        for chosen in np.array_split(rng.permutation(len(episodes)), config.minibatches):
            batch = lay([episodes[k] for k in chosen], [A[k] for k in chosen], model.log_std.device)
            batch["advantages"] = (batch["advantages"] - mean) / (std + 1e-8)
            policy_loss, value_loss, statistics = losses(model, batch, config.clip)
            optimizer.zero_grad()
            (policy_loss + VALUE_WEIGHT * value_loss).backward()
            average_gradients(model, int(batch["mask"].sum()))
            torch.nn.utils.clip_grad_norm_(model.parameters(), MAX_GRADIENT_NORM)
            optimizer.step()
            for name, value in statistics.items():
                totals.setdefault(name, []).append(value.item())
    statistics = {name: float(np.mean(value)) for name, value in totals.items()}
    returns = torch.cat(A) + values
    statistics["explained_variance"] = float(1 - (returns - values).var() / returns.var())
    return statistics
