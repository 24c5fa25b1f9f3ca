"""What `python -m experiments.benchmark --peers` times beside this project: two simulators, two
learners.

A simulator runs headless with random actions, its images brought to 64x48. A learner gets this
project's environment, with targets to train on alone, so that every step is learnt from, and our
network's sizes; once with its own settings, as it comes, and once with our robots, epochs and
minibatches, which is the same work. Each peer takes `rate(call, count)`, which times it, and
returns steps a second; it raises ImportError where its packages are missing.

Axis letters: R robots, T steps of an update.
"""

import os
from dataclasses import dataclass
from functools import partial

import numpy as np
import torch

from model import FEATURES, HIDDEN, LAST, REWARD_SCALE, TARGET, Network, make_network
from navbot_min import MAX_EPISODE_STEPS, NavEnv, NavVecEnv
from ppo import MAX_GRADIENT_NORM, VALUE_WEIGHT
from train import Config


@dataclass
class Settings:
    """How a learner works."""
    robots: int
    steps: int  # of each robot for an update
    epochs: int
    minibatches: int  # of an epoch


# So many steps of our robots are about as many as an update's episodes have.
OUR_WORK = Settings(Config.robots, 32, Config.epochs, Config.minibatches)
RECURRENT_PPO = Settings(8, 128, 10, 8)  # its defaults: minibatches of 128 steps
CLEANRL = Settings(8, 128, 4, 4)  # of CleanRL's PPO with an LSTM


# --------------------------------------------------------------------------------------- simulators


def miniworld(rate):
    """MiniWorld (OpenGL; without a GPU in software), its four rooms."""
    import pyglet
    pyglet.options["headless"] = True
    import gymnasium
    import miniworld  # noqa: F401  registers its environments
    env = gymnasium.make("MiniWorld-FourRooms-v0", obs_width=64, obs_height=48,
                         disable_env_checker=True)
    env.reset(seed=0)

    def step():
        _, _, terminated, truncated, _ = env.step(env.action_space.sample())
        if terminated or truncated:
            env.reset()

    return rate(step, 1)


def vizdoom(rate):
    """ViZDoom (C++), `my way home` at its lowest resolution, every other or third pixel taken."""
    import vizdoom
    game = vizdoom.DoomGame()
    game.load_config(os.path.join(vizdoom.scenarios_path, "my_way_home.cfg"))
    game.set_screen_resolution(vizdoom.ScreenResolution.RES_160X120)
    game.set_screen_format(vizdoom.ScreenFormat.RGB24)
    game.set_window_visible(False)
    game.init()
    actions = np.eye(game.get_available_buttons_size(), dtype=int).tolist()
    rng = np.random.default_rng(0)
    rows = np.arange(48) * 5 // 2
    columns = np.arange(64) * 5 // 2

    def step():
        game.make_action(actions[rng.integers(len(actions))])
        if game.is_episode_finished():
            game.new_episode()
        return game.get_state().screen_buffer[rows][:, columns]

    return rate(step, 1)


# ------------------------------------------------------------------------------------- RecurrentPPO


def features_extractor():
    """Our CNN as stable-baselines3 asks for it: a class."""
    from stable_baselines3.common.torch_layers import BaseFeaturesExtractor

    class Features(BaseFeaturesExtractor):
        def __init__(self, space):
            super().__init__(space, FEATURES + TARGET + LAST)
            cnn = Network().cnn
            self.cnn = cnn.to(memory_format=torch.contiguous_format)  # as sb3 asks

        def forward(self, seen):
            images = seen["image"] * 255  # sb3 gives channels first, from 0 to 1
            features = self.cnn(images.contiguous(memory_format=torch.channels_last))
            return torch.cat([features, seen["target"], seen["velocity"], seen["last_reward"]], -1)

    return Features


def recurrent_ppo(rate, settings):
    """sb3-contrib's RecurrentPPO."""
    from sb3_contrib import RecurrentPPO
    from stable_baselines3.common.vec_env import DummyVecEnv

    def make_env():
        return NavEnv(["env1"], "training", Config.random_starts, MAX_EPISODE_STEPS)

    count = settings.robots * settings.steps
    learner = RecurrentPPO(
        "MultiInputLstmPolicy", DummyVecEnv([make_env] * settings.robots),
        n_steps=settings.steps, n_epochs=settings.epochs,
        batch_size=count // settings.minibatches, device="cpu", seed=0,
        policy_kwargs={
            "features_extractor_class": features_extractor(), "lstm_hidden_size": HIDDEN,
            "n_lstm_layers": 2, "shared_lstm": True, "enable_critic_lstm": False,
            "net_arch": [HIDDEN]})
    learner.policy.features_extractor.to(memory_format=torch.channels_last)

    def learn():
        learner.learn(count, reset_num_timesteps=False)

    return rate(learn, count, timings=3)


# ------------------------------------------------------------------------------------ CleanRL-style


class CleanRLStyle:
    """PPO with an LSTM as CleanRL's single file does it: T steps of R robots, then the convolutions
    at once and the LSTMs step by step, the memory cleared where an episode starts."""

    def __init__(self, settings):
        R = settings.robots
        self.settings = settings
        self.net = make_network(seed=0)
        self.env = NavVecEnv(R, ["env1"], "training", Config.random_starts)
        self.optimizer = torch.optim.Adam(self.net.parameters(), Config.learning_rate, eps=1e-5)
        self.seen = tensors(self.env.reset(seed=0)[0])
        self.start = torch.zeros(R)  # 1 where an episode starts with this step
        self.memory = self.net.initial_state(R)
        self.real = torch.ones(R, 1, dtype=torch.bool)

    def forward(self, seen, starts, memory):
        """Steps (T, R, ...) -> distribution (T, R, 2), values (T, R), memory after them."""
        T, R = starts.shape
        features = self.net.see(seen["image"].flatten(0, 1)).unflatten(0, (T, R))
        last = torch.cat([seen["velocity"], seen["last_reward"]], -1)
        outputs = []
        for t in range(T):
            memory = memory * (1 - starts[t])[:, None, None, None]
            step = (features[t][:, None], seen["target"][t][:, None], last[t][:, None])
            y, memory = self.net.remember(*step, memory, self.real[:R])
            outputs.append(y[:, 0])
        x = torch.relu(self.net.dense(torch.stack(outputs)))
        return self.net.policy(x), self.net.value(x)[..., 0], memory

    @torch.no_grad()
    def step(self):
        """One step of all robots, as it is stored."""
        one = {key: value[None] for key, value in self.seen.items()}
        distribution, values, self.memory = self.forward(one, self.start[None], self.memory)
        action = distribution.sample()
        stored = {**one, "start": self.start[None], "action": action, "value": values,
                  "log_prob": distribution.log_prob(action).sum(-1)}
        after, rewards, terminated, truncated, _ = self.env.step(action[0].numpy())
        self.seen = tensors(after)
        self.start = torch.as_tensor(terminated | truncated).float()
        stored["reward"] = torch.as_tensor(rewards).float()[None]
        return stored

    def advantages(self, steps):
        """(T, R), a plain return over the value: enough for a timing."""
        A = torch.zeros_like(steps["reward"])
        following = torch.zeros(self.settings.robots)
        going_on = 1 - self.start
        for t in reversed(range(self.settings.steps)):
            following = REWARD_SCALE * steps["reward"][t] + 0.99 * following * going_on
            A[t] = following - steps["value"][t]
            going_on = 1 - steps["start"][t]
        return A

    def losses(self, steps, A, robots, memory):
        """The sum of the policy loss and the value loss of some of the robots."""
        part = {key: value[:, robots] for key, value in steps.items()}
        distribution, values, _ = self.forward(part, part["start"], memory[robots])
        r = (distribution.log_prob(part["action"]).sum(-1) - part["log_prob"]).exp()
        normalised = (A[:, robots] - A.mean()) / A.std()
        objective = torch.min(r * normalised, r.clamp(0.8, 1.2) * normalised)
        value_loss = (values - A[:, robots] - part["value"]).square().mean()
        return -objective.mean() + VALUE_WEIGHT * value_loss

    def learn(self):
        """T steps of all robots, and the update by them."""
        before = self.memory
        stored = [self.step() for _ in range(self.settings.steps)]
        steps = {key: torch.cat([one[key] for one in stored]) for key in stored[0]}
        A = self.advantages(steps)
        for _ in range(self.settings.epochs):
            for robots in torch.randperm(self.settings.robots).chunk(self.settings.minibatches):
                loss = self.losses(steps, A, robots, before)
                self.optimizer.zero_grad()
                loss.backward()
                torch.nn.utils.clip_grad_norm_(self.net.parameters(), MAX_GRADIENT_NORM)
                self.optimizer.step()


def tensors(observations):
    """Observations as tensors."""
    return {key: torch.as_tensor(value) for key, value in observations.items()}


def cleanrl_style(rate, settings):
    """A loop in the style of CleanRL."""
    return rate(CleanRLStyle(settings).learn, settings.robots * settings.steps, timings=3)


# name -> ("env" or "training": what of ours it is compared with, the peer)
PEERS = {"MiniWorld": ("env", miniworld),
         "ViZDoom": ("env", vizdoom),
         "RecurrentPPO, as it comes": ("training", partial(recurrent_ppo, settings=RECURRENT_PPO)),
         "RecurrentPPO, our work": ("training", partial(recurrent_ppo, settings=OUR_WORK)),
         "CleanRL-style, as it comes": ("training", partial(cleanrl_style, settings=CLEANRL)),
         "CleanRL-style, our work": ("training", partial(cleanrl_style, settings=OUR_WORK))}
