"""The learner: PPO on whole episodes (Schulman et al. 2017; paper Eq. (2), (3), Algorithm 1).

The letters are those of the formulas and of the code alike: r ratio, A advantage, gamma discount,
lam (lambda) of GAE, eps clip range. Axis letters: R robots, T steps of an episode, M rows of a
minibatch, B its real steps, N episodes of an update, K epochs.

There is no entropy bonus: the policy's standard deviation is a parameter of its own, which starts
large and shrinks as fast as that pays. Towards the end of a run `train.py` limits it.
"""

from dataclasses import dataclass

import numpy as np
import torch
from torch.nn.functional import mse_loss
from torch.nn.utils.rnn import pad_sequence

VALUE_WEIGHT = 0.5  # of the value loss beside the policy loss, our choice
MAX_GRADIENT_NORM = 0.5  # longer gradients are scaled down to it, our choice
STATISTICS = ("policy_loss", "value_loss", "entropy", "kl", "clip_fraction")


def check_finite(name, *numbers):
    """Raises FloatingPointError, with that name, unless these tensors hold finite numbers alone."""
    for tensor in numbers:
        if not torch.isfinite(tensor).all():
            raise FloatingPointError(name)


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
    """Drives R robots with the policy as it is at each step, and hands out whole episodes.

    Robots never wait for each other. An episode under way while the policy is updated goes on, with
    the log-probabilities that its actions had when they were taken.
    """

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
        """One step of all robots. Returns the episodes that it ended, [(Episode, info), ...], where
        info holds the environment's `final_info` of that robot."""
        seen = self._observations
        action = self.model.act(seen, self._memory, self.generator)
        _, actions, log_probs, values, self._memory = action
        numbers = [value for name, value in seen.items() if name != "image"]  # whose are whole
        check_finite("an observation or an action", actions, *map(torch.as_tensor, numbers))
        self._observations, rewards, terminated, truncated, infos = self.env.step(actions.numpy())
        scaled = (rewards * self.reward_scale).astype(np.float32)
        self._history.append(seen | {"actions": actions.numpy(), "log_probs": log_probs.numpy(),
                                     "values": values.numpy(), "rewards": scaled})
        self._length += 1
        last_values = self._last_values(truncated, infos)
        ended = []
        for r in np.flatnonzero(terminated | truncated):
            info = {name: value[r].item() for name, value in infos["final_info"].items()}
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

    def state(self):
        """All that changes while robots drive, the environment's state included."""
        return {"env": self.env.state(), "generator": self.generator.get_state(),
                "observations": {key: value.copy() for key, value in self._observations.items()},
                "memory": self._memory.clone(), "length": self._length.copy(),
                "history": list(self._history)}  # what a step holds never changes

    def load_state(self, state):
        """Goes on from a state of a collector that was made in the same way."""
        self.env.load_state(state["env"])
        self.generator.set_state(state["generator"])
        self._observations = dict(state["observations"])
        self._memory = state["memory"].to(self._memory.device, copy=True)
        self._length = state["length"].copy()
        self._history = list(state["history"])


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


def pack_rows(lengths):
    """Rows of a minibatch: lists of episodes, as indices into `lengths`, that lie end to end, and a
    step after each that parts it from the next, in rows as long as the longest one.

    The longest first, each into the first row that has room. So about a fifth of the steps is
    padding, where an episode a row would have two fifths (docs/code.md).
    """
    rows = []
    free = []  # steps that are left in each row
    for k in np.argsort(lengths)[::-1]:
        row = next((row for row, room in enumerate(free) if room > lengths[k]), len(rows))
        if row == len(rows):  # it fits nowhere
            rows.append([])
            free.append(max(lengths) + 1)
        rows[row].append(k)
        free[row] -= lengths[k] + 1
    return rows


def make_minibatch(episodes, batch_advantages, device=None):
    """Episodes and their advantages packed in M rows of T steps: a dict of (M, T, ...) on the
    device, zeros between episodes. `mask` is which steps are real. Images have no zeros between
    them, (B, H, W, 3), in the order of the real steps."""
    rows = pack_rows([len(episode) for episode in episodes])

    def pack(sequences):
        """(M, T, ...) from a (length, ...) array for each episode."""
        parted = [np.concatenate([steps, np.zeros_like(steps[:1])]) for steps in sequences]
        packed = [torch.as_tensor(np.concatenate([parted[k] for k in row])) for row in rows]
        return pad_sequence(packed, batch_first=True).to(device)

    observations = {key: pack([episode.observations[key] for episode in episodes])
                    for key in episodes[0].observations if key != "image"}
    images = [episodes[k].observations["image"] for row in rows for k in row]
    observations["image"] = torch.as_tensor(np.concatenate(images)).to(device)
    return {"observations": observations,
            "actions": pack([episode.actions for episode in episodes]),
            "log_probs": pack([episode.log_probs for episode in episodes]),
            "advantages": pack(batch_advantages),
            # What the values should have foretold: a return is A + V, by the definition of A.
            "returns": pack([A + e.values for A, e in zip(batch_advantages, episodes)]),
            "mask": pack([np.ones(len(e), bool) for e in episodes])}


def losses(model, batch, eps):
    """The clipped policy loss, Eq. (3), and the value loss of a minibatch, and its STATISTICS.

    Every mean is over the real steps alone.
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


def gradient(model, batch, eps):
    """The gradient of a minibatch's loss, one vector of all weights, and its STATISTICS."""
    policy_loss, value_loss, statistics = losses(model, batch, eps)
    loss = policy_loss + VALUE_WEIGHT * value_loss
    gradients = torch.autograd.grad(loss, list(model.parameters()), materialize_grads=True)
    return torch.cat([one.flatten() for one in gradients]), statistics


def update(model, optimizer, learning_rate, episodes, config, rng, processes):
    """K epochs of minibatches of whole episodes, Algorithm 1. Returns the statistics' means.

    config: has `epochs`, `minibatches`, `gamma`, `lam`, `clip`. rng: numpy Generator, shuffles.
    processes: those that share the work (support/processes.py); one alone does all of it.
    """
    A = [advantages(e.rewards, e.values, e.last_value, config.gamma, config.lam) for e in episodes]
    errors = np.concatenate(A)  # of the values, in foretelling the returns
    lengths = np.array([len(episode) for episode in episodes])
    history = []
    for _ in range(config.epochs):
        for chosen in np.array_split(rng.permutation(len(episodes)), config.minibatches):
            mine = processes.share(chosen, lengths)  # alone: all of them
            batch = make_minibatch([episodes[k] for k in mine], [A[k] for k in mine],
                                   model.log_std.device)
            # Padding too, which is not used.
            batch["advantages"] = (batch["advantages"] - errors.mean()) / (errors.std() + 1e-8)
            slope, statistics = gradient(model, batch, config.clip)
            weight = lengths[mine].sum() / lengths[chosen].sum()
            slope, statistics = processes.average(slope, statistics, weight)  # alone: the same
            check_finite("the loss", statistics)
            check_finite("the gradient", slope)
            norm = slope.norm().item()
            if norm > MAX_GRADIENT_NORM:
                slope *= MAX_GRADIENT_NORM / norm
            optimizer.step(slope, learning_rate)
            history.append(statistics)
    check_finite("a weight", *model.parameters())
    statistics = dict(zip(STATISTICS, torch.stack(history).mean(0).tolist()))
    # 1 where the values foretold the returns, 0 where they knew nothing of them.
    returns = errors + np.concatenate([episode.values for episode in episodes])
    statistics["explained_variance"] = float(1 - errors.var() / max(returns.var(), 1e-12))
    return statistics
