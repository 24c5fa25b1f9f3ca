"""The learner: PPO on whole episodes (Schulman et al. 2017; paper Eq. (2), (3), Algorithm 1).

The letters are those of the formulas and of the code alike: r ratio, A advantage, gamma discount,
lam (lambda) of GAE, eps clip range. Axis letters: R robots, T steps of an episode, M episodes of a
minibatch, N episodes of an update, K epochs.
"""

from dataclasses import dataclass

import numpy as np
import torch
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


def pad(episodes, batch_advantages):
    """M episodes as one minibatch, padded with zeros to the longest: a dict of (M, T, ...). Only
    images, by far the largest, are not padded: (B, H, W, 3), one for each real step."""
    def stack(sequences):
        return pad_sequence(list(sequences), batch_first=True)

    def join(key):
        return (torch.cat if key == "image" else stack)([e.observations[key] for e in episodes])
    return {
        "observations": {key: join(key) for key in episodes[0].observations},
        "actions": stack(e.actions for e in episodes),
        "log_probs": stack(e.log_probs for e in episodes),
        "advantages": stack(batch_advantages),
        "returns": stack(A + e.values for A, e in zip(batch_advantages, episodes)),
        "mask": stack(torch.ones(len(e), dtype=torch.bool) for e in episodes)}


def losses(model, batch, eps):
    """The clipped policy loss, Eq. (3), and the value loss of a padded minibatch, and statistics.

    Every mean is over the real steps alone.
    """
    mask = batch["mask"]
    state = model.initial_state(len(mask))  # every sequence is a whole episode, from its first step
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


def update(model, optimizer, episodes, config, rng):
    """K epochs of minibatches of whole episodes, Algorithm 1. Returns the statistics' means.

    config: has `epochs`, `minibatches`, `gamma`, `lam`, `clip`. rng: numpy Generator, shuffles.
    """
    A = [advantages(e.rewards, e.values, e.last_value, config.gamma, config.lam) for e in episodes]
    values = torch.cat([e.values for e in episodes])
    returns = torch.cat(A) + values
    std, mean = torch.std_mean(torch.cat(A), correction=0)
    totals = {}
    for _ in range(config.epochs):
        order = rng.permutation(len(episodes))
        for chosen in np.array_split(order, min(config.minibatches, len(order))):
            batch = pad([episodes[k] for k in chosen], [A[k] for k in chosen])
            batch["advantages"] = (batch["advantages"] - mean) / (std + 1e-8)
            policy_loss, value_loss, statistics = losses(model, batch, config.clip)
            optimizer.zero_grad()
            (policy_loss + VALUE_WEIGHT * value_loss).backward()
            torch.nn.utils.clip_grad_norm_(model.parameters(), MAX_GRADIENT_NORM)
            optimizer.step()
            for name, value in statistics.items():
                totals.setdefault(name, []).append(value.item())
    statistics = {name: float(np.mean(value)) for name, value in totals.items()}
    statistics["explained_variance"] = float(1 - (returns - values).var() / returns.var())
    return statistics
