"""Other projects' learners in this environment, with a network of the same size: RecurrentPPO of
Stable-Baselines3-contrib and a loop in the style of CleanRL. Both learn from every step.

`pip install -r experiments/requirements-peers.txt`, then `python -m experiments.peers`, makes the
missing rows of results/peers.csv. Axis letters: R robots, T steps of an update."""

import time
from collections import namedtuple

import numpy as np
import pandas as pd
import torch

import scenes
from evaluation import Policy, evaluate
from experiments.runs import PAPER_ROOMS, TEST_ROOMS
from experiments.tables import RESULTS
from model import (FEATURES, HIDDEN, IMAGE_MEAN, IMAGE_SCALE, LAST, MAX_COMMAND, REWARD_SCALE,
                   TARGET, TARGET_SCALE, make_cnn, make_network)
from navbot_min import NavVecEnv
from ppo import MAX_GRADIENT_NORM, VALUE_WEIGHT
from support.cli import parse
from support.random_rooms import RandomRoomsVecEnv
from support.rooms import validation_scenes
from support.runs import write
from train import Config

try:
    from sb3_contrib import RecurrentPPO
    from stable_baselines3.common.torch_layers import BaseFeaturesExtractor
    from stable_baselines3.common.vec_env import VecEnv
except ImportError:  # without them, only the CleanRL-style loop is available
    RecurrentPPO = None
    BaseFeaturesExtractor = object
    VecEnv = object

Settings = namedtuple("Settings", "robots steps epochs minibatches learning_rate clip decays")
# 32 steps per robot are about as many as the episodes of one of our updates have.
OUR_WORK = Settings(Config.robots, 32, Config.epochs, Config.minibatches, Config.learning_rate,
                    Config.clip, True)


def level_2(robots):
    """Returns the environment of our training in env1: half of the robots in the mirrored room. It
    has no new targets."""
    room = scenes.load("env1")
    rooms = [room] * (robots - robots // 2) + [room.mirrored()] * (robots // 2)
    return NavVecEnv(robots, rooms, "training", Config.random_starts)


class StableBaselinesEnv(VecEnv):
    """A NavVecEnv as a vector environment of Stable-Baselines3. Rewards are multiplied by a scale:
    values of about 1 are learned faster."""

    def __init__(self, env, reward_scale=REWARD_SCALE):
        self.env = env
        self.reward_scale = reward_scale
        super().__init__(env.num_envs, env.single_observation_space, env.single_action_space)

    def reset(self):
        observations, _ = self.env.reset(seed=self._seeds[0])
        self._reset_seeds()
        return observations

    def step_async(self, actions):
        self.actions = actions

    def step_wait(self):
        observations, rewards, terminated, truncated, infos = self.env.step(self.actions)
        done = terminated | truncated
        each = [{} for _ in done]
        for r in np.flatnonzero(done):
            info = {key: value[r] for key, value in infos["final_info"].items()}
            last = {key: value[r] for key, value in infos["final_obs"].items()}
            each[r] = info | {"terminal_observation": last, "TimeLimit.truncated": truncated[r],
                              "episode": {"r": info["return"], "l": info["length"]}}
        return observations, np.float32(self.reward_scale * rewards), done, each

    def get_attr(self, attr_name, indices=None):
        return [getattr(self.env, attr_name)] * self.num_envs

    def env_is_wrapped(self, wrapper_class, indices=None):
        return [False] * self.num_envs

    def close(self):
        self.env.close()

    def set_attr(self, attr_name, value, indices=None):
        raise NotImplementedError("the robots share one environment: set it there")

    def env_method(self, method_name, *arguments, indices=None, **options):
        raise NotImplementedError("the robots share one environment: call it there")


class Features(BaseFeaturesExtractor):
    """Our CNN and the other inputs as a feature extractor of Stable-Baselines3."""

    def __init__(self, space):
        super().__init__(space, FEATURES + TARGET + LAST)
        self.cnn = make_cnn().to(memory_format=torch.contiguous_format)  # for its first weights

    def forward(self, seen):
        images = (seen["image"] - IMAGE_MEAN) / IMAGE_SCALE  # channels first
        features = self.cnn(images.contiguous(memory_format=torch.channels_last))
        return torch.cat([features, seen["target"] * TARGET_SCALE,
                          seen["velocity"] / torch.tensor(MAX_COMMAND),
                          seen["last_reward"] * REWARD_SCALE], -1)


def recurrent_ppo(settings, env, seed=0):
    """Returns a RecurrentPPO with our network's sizes. Its two LSTMs both get all inputs."""
    rate = settings.learning_rate
    learner = RecurrentPPO(
        "MultiInputLstmPolicy", StableBaselinesEnv(env),
        learning_rate=(lambda left: left * rate) if settings.decays else rate,
        n_steps=settings.steps, n_epochs=settings.epochs, clip_range=settings.clip,
        batch_size=settings.robots * settings.steps // settings.minibatches, seed=seed,
        device="cpu",
        policy_kwargs=dict(features_extractor_class=Features, normalize_images=False,
                           lstm_hidden_size=HIDDEN, n_lstm_layers=2, shared_lstm=True,
                           enable_critic_lstm=False, net_arch=[HIDDEN]))
    learner.policy.features_extractor.to(memory_format=torch.channels_last)
    return learner


class Predicted:
    """A driver with the policy of a learner of Stable-Baselines3."""
    label = "a policy of Stable-Baselines3"

    def __init__(self, learner, actions):
        """actions: `sampled` or `mean`."""
        self.learner = learner
        self.is_mean = actions == "mean"
        self.env = None

    def reset(self, env, robots):
        """Clears the memory of these robots."""
        if env is not self.env:
            self.env = env
            self.memory = None
            self.begins = np.ones(env.num_envs, bool)
        self.begins[robots] = True

    def act(self, env, observations):
        """Returns the actions (R, 2)."""
        actions, self.memory = self.learner.predict(observations, self.memory, self.begins,
                                                    deterministic=self.is_mean)
        self.begins[:] = False
        return actions


class CleanRLStyle:
    """PPO with an LSTM as in CleanRL's single file: T steps of R robots, then an update."""

    def __init__(self, settings, env, seed=0):
        self.settings = settings
        self.num_timesteps = 0
        self.net = make_network(seed)
        torch.manual_seed(seed)  # for actions and shuffles, as in CleanRL
        self.optimizer = torch.optim.Adam(self.net.parameters(), eps=1e-5)
        self.env = env
        self.memory = self.net.initial_state(settings.robots)
        seen = env.reset(seed=seed)[0] | {"start": np.ones(settings.robots, np.float32)}
        self.seen = {key: torch.as_tensor(value)[None] for key, value in seen.items()}

    def forward(self, steps, memory):
        """Steps (T, R, ...), memory -> action distribution (T, R, 2), values (T, R), memory."""
        features = self.net.see(steps["image"].flatten(0, 1)).unflatten(0, steps["start"].shape)
        target = steps["target"] * TARGET_SCALE
        velocity = steps["velocity"] / self.net.command_scale
        last = torch.cat([velocity, steps["last_reward"] * REWARD_SCALE], -1)
        outputs = []
        for t, start in enumerate(steps["start"]):
            memory = memory * (1 - start)[:, None, None, None]
            y, memory = self.net.remember(features[t, :, None], target[t, :, None],
                                          last[t, :, None], memory)
            outputs.append(y[:, 0])
        x = torch.relu(self.net.dense(torch.stack(outputs)))
        return self.net.policy(x), self.net.value_head(x)[..., 0], memory

    @torch.no_grad()
    def collect(self):
        """Returns T steps, name -> (T, R, ...). The time limit terminates, as in CleanRL."""
        history = []
        for _ in range(self.settings.steps):
            distribution, values, self.memory = self.forward(self.seen, self.memory)
            actions = distribution.sample()
            observations, rewards, terminated, truncated, _ = self.env.step(actions[0].numpy())
            history.append(self.seen | {
                "action": actions, "log_prob": distribution.log_prob(actions).sum(-1),
                "value": values, "reward": torch.as_tensor(REWARD_SCALE * rewards)[None].float()})
            seen = observations | {"start": np.float32(terminated | truncated)}
            self.seen = {key: torch.as_tensor(value)[None] for key, value in seen.items()}
        steps = {key: torch.cat([step[key] for step in history]) for key in history[0]}
        values = torch.cat([steps["value"], self.forward(self.seen, self.memory)[1]])
        continues = 1 - torch.cat([steps["start"], self.seen["start"]])[1:]
        A = steps["reward"] + Config.gamma * values[1:] * continues - values[:-1]
        for t in reversed(range(len(A) - 1)):
            A[t] += Config.gamma * Config.lam * continues[t] * A[t + 1]
        return steps | {"advantage": A}

    def learn(self, total):
        """Learns from this many steps. Minibatches are robots. The learning rate decays to 0."""
        settings = self.settings
        eps = settings.clip
        updates = total // (settings.robots * settings.steps)
        self.num_timesteps = updates * settings.robots * settings.steps
        for k in range(updates):
            self.optimizer.param_groups[0]["lr"] = settings.learning_rate * (1 - k / updates)
            memory = self.memory
            steps = self.collect()
            for _ in range(settings.epochs):
                for robots in torch.randperm(settings.robots).chunk(settings.minibatches):
                    part = {key: value[:, robots] for key, value in steps.items()}
                    distribution, values, _ = self.forward(part, memory[robots])
                    r = (distribution.log_prob(part["action"]).sum(-1) - part["log_prob"]).exp()
                    A = part["advantage"]
                    error = values - part["value"]
                    errors = torch.max((error - A) ** 2, (error.clamp(-eps, eps) - A) ** 2)
                    value_loss = errors.mean() / 2  # values are clipped too, as in CleanRL
                    A = (A - A.mean()) / (A.std() + 1e-8)
                    objective = torch.min(r * A, r.clamp(1 - eps, 1 + eps) * A)
                    entropy = distribution.entropy().sum(-1).mean()
                    self.optimizer.zero_grad()  # 0.01: entropy weight of CleanRL
                    (VALUE_WEIGHT * value_loss - objective.mean() - 0.01 * entropy).backward()
                    torch.nn.utils.clip_grad_norm_(self.net.parameters(), MAX_GRADIENT_NORM)
                    self.optimizer.step()


# name -> function or class that makes a learner, its Settings
PEERS = {
    "CleanRL-style, as it comes": (CleanRLStyle, Settings(8, 128, 4, 4, 2.5e-4, 0.1, True)),
    "CleanRL-style, our work": (CleanRLStyle, OUR_WORK)}
if RecurrentPPO is not None:  # its default minibatches have 128 steps
    PEERS = {
        "RecurrentPPO, as it comes": (recurrent_ppo, Settings(8, 128, 10, 8, 3e-4, 0.2, False)),
        "RecurrentPPO, our work": (recurrent_ppo, OUR_WORK)} | PEERS
LEVELS = {  # level of the paper -> environment, steps
    2: (level_2, PAPER_ROOMS["env1"]), 3: (RandomRoomsVecEnv, 500_000)}
SEEDS = {(2, name): 3 for name in PEERS} | {(3, "RecurrentPPO, our work"): 1}  # number of seeds


def driver(learner, actions):
    """Returns a driver with the policy of a learner."""
    if isinstance(learner, CleanRLStyle):
        return Policy(learner.net, actions, seed=0)
    return Predicted(learner, actions)


def success(level, learner):
    """Returns the success rates of a learner's frozen policy, as columns. Actions are sampled:
    these learners keep much noise, and then the mean action may be to stand still."""
    if level == 2:
        result, _ = evaluate(driver(learner, "sampled"), ["env1"], 1000, "start")
        rates = {f"{kind}_success": result[kind]["success"] for kind in ("training", "new")}
        tests = {"anywhere": (["env1"], 500, "sampled"), "anywhere_mean": (["env1"], 500, "mean")}
    else:
        rates = {}
        tests = {"validation": (validation_scenes(), 1000, "sampled")}
        tests |= {room: ([room], 100, "sampled") for room in TEST_ROOMS}
        tests["validation_mean"] = (validation_scenes(), 1000, "mean")
    for name, (rooms, episodes, actions) in tests.items():
        result, _ = evaluate(driver(learner, actions), rooms, episodes, "anywhere")
        rates[f"{name}_success"] = result["anywhere"]["success"]
    return rates


def main(argv=None):
    """Runs the command line: trains each peer that results/peers.csv lacks."""
    _, parser = parse({}, "Train the learners of other projects in this environment.", argv)
    if RecurrentPPO is None:
        parser.error("sb3_contrib is missing: pip install -r experiments/requirements-peers.txt")
    torch.set_num_threads(1)
    path = RESULTS / "peers.csv"
    rows = pd.read_csv(path).to_dict("records") if path.exists() else []
    made = {(row["level"], row["learner"], row["seed"]) for row in rows}
    for (level, name), count in SEEDS.items():
        for seed in set(range(count)) - {seed for *key, seed in made if key == [level, name]}:
            make, settings = PEERS[name]
            make_env, steps = LEVELS[level]
            learner = make(settings, make_env(settings.robots), seed)
            begin = time.perf_counter()
            learner.learn(steps)
            row = {"level": level, "learner": name, "seed": seed,
                   "steps": learner.num_timesteps, "seconds": round(time.perf_counter() - begin, 1)}
            rows.append(row | success(level, learner))
            write(path, pd.DataFrame(rows).to_csv(index=False))


if __name__ == "__main__":
    main()
