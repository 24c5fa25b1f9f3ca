"""What `benchmark.py --peers` times beside this project: two simulators, two learners.

A simulator runs headless with random actions, its images brought to 64x48. A learner gets this
project's environment, with targets to train on alone, so that every step is learnt from, and our
network's sizes; once with its own settings, as it comes, and once with our robots, epochs and
minibatches, which is the same work. Each peer takes `rate(call, count)`, which times it, and
returns steps a second.
"""

from functools import partial

import numpy as np
import torch

from model import FEATURES, HIDDEN, Network
from navbot_min import NavEnv, NavVecEnv
from ppo import MAX_GRADIENT_NORM, VALUE_WEIGHT
from train import Config

# R robots, T steps of an update: together about as many as 32 episodes have.
OURS = dict(R=Config.robots, T=32, epochs=Config.epochs, minibatches=Config.minibatches)


def miniworld(rate):
    """MiniWorld (OpenGL; without a GPU in software), its four rooms."""
    import pyglet
    pyglet.options["headless"] = True
    import gymnasium
    import miniworld  # noqa: F401
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
    import os

    import vizdoom
    game = vizdoom.DoomGame()
    game.load_config(os.path.join(vizdoom.scenarios_path, "my_way_home.cfg"))
    game.set_screen_resolution(vizdoom.ScreenResolution.RES_160X120)
    game.set_screen_format(vizdoom.ScreenFormat.RGB24)
    game.set_window_visible(False)
    game.init()
    actions = np.eye(game.get_available_buttons_size(), dtype=int).tolist()
    rng, rows, columns = np.random.default_rng(0), np.arange(48) * 5 // 2, np.arange(64) * 5 // 2

    def step():
        game.make_action(actions[rng.integers(len(actions))])
        if game.is_episode_finished():
            game.new_episode()
        return game.get_state().screen_buffer[rows][:, columns]
    return rate(step, 1)


def recurrent_ppo(rate, R, T, epochs, minibatches):
    """sb3-contrib's RecurrentPPO. It comes with 128 steps, 10 epochs, minibatches of 128 steps."""
    from sb3_contrib import RecurrentPPO
    from stable_baselines3.common.torch_layers import BaseFeaturesExtractor
    from stable_baselines3.common.vec_env import DummyVecEnv

    class Features(BaseFeaturesExtractor):
        def __init__(self, space):
            super().__init__(space, FEATURES + 5)
            self.cnn = Network().cnn.to(memory_format=torch.contiguous_format)  # sb3 asks

        def forward(self, seen):
            images = seen["image"] * 255  # sb3 gives channels first, from 0 to 1
            return torch.cat([self.cnn(images.contiguous(memory_format=torch.channels_last)),
                              seen["target"], seen["velocity"], seen["reward"]], -1)
    env = DummyVecEnv([lambda: NavEnv("env1", "training", Config.random_starts)] * R)
    learner = RecurrentPPO(
        "MultiInputLstmPolicy", env, n_steps=T, n_epochs=epochs, batch_size=R * T // minibatches,
        device="cpu", seed=0, policy_kwargs=dict(
            features_extractor_class=Features, lstm_hidden_size=HIDDEN, n_lstm_layers=2,
            shared_lstm=True, enable_critic_lstm=False, net_arch=[HIDDEN]))
    learner.policy.features_extractor.to(memory_format=torch.channels_last)
    return rate(lambda: learner.learn(R * T, reset_num_timesteps=False), R * T, timings=3)


def cleanrl_style(rate, R, T, epochs, minibatches):
    """PPO with an LSTM as CleanRL's single file does it: T steps of R robots, then the convolutions
    at once and the LSTMs step by step, the memory cleared where an episode starts. CleanRL takes
    128 steps of 8 robots, 4 epochs of 4 minibatches."""
    torch.manual_seed(0)
    net, env = Network(), NavVecEnv(R, "env1", "training", Config.random_starts)
    optimizer = torch.optim.Adam(net.parameters(), Config.learning_rate, eps=1e-5)
    seen, now = env.reset(seed=0)[0], {"state": net.initial_state(R), "start": torch.zeros(R)}
    now["seen"] = {key: torch.as_tensor(value) for key, value in seen.items()}

    def policy(seen, starts, state):  # (T, R, ...)
        x = net.see(seen["image"].flatten(0, 1)).unflatten(0, starts.shape)
        x = torch.cat([x, seen["target"]], -1)[:, :, None]
        last = torch.cat([seen["velocity"], seen["reward"]], -1)[:, :, None]
        real, outputs = torch.ones(len(state), 1, dtype=torch.bool), []
        for t, start in enumerate(starts):
            before = state * (1 - start)[:, None, None, None]
            y, first = net.memories[0](x[t], before[:, 0], real)
            y, second = net.memories[1](torch.cat([y, last[t]], -1), before[:, 1], real)
            state = torch.stack([first, second], 1)
            outputs.append(y[:, 0])
        y = torch.relu(net.dense(torch.stack(outputs)))
        linear, angular = net.action(y).unbind(-1)
        mean = torch.stack([linear.sigmoid(), angular.tanh()], -1)
        return torch.distributions.Normal(mean, net.log_std.exp()), net.value(y)[..., 0], state

    def learn():
        state, steps = now["state"], []
        for _ in range(T):
            seen, start = now["seen"], now["start"]
            with torch.no_grad():
                one = {key: value[None] for key, value in seen.items()}
                distribution, values, now["state"] = policy(one, start[None], now["state"])
                action = distribution.sample()[0]
                log_prob = distribution.log_prob(action)[0].sum(-1)
            after, reward, terminated, truncated, _ = env.step(action.numpy())
            reward = torch.as_tensor(reward).float()
            steps.append((seen, start, action, log_prob, values[0], reward))
            now["seen"] = {key: torch.as_tensor(value) for key, value in after.items()}
            now["start"] = torch.as_tensor(terminated | truncated).float()
        seen = {key: torch.stack([step[0][key] for step in steps]) for key in seen}
        starts, actions, log_probs, values, rewards = (
            torch.stack([step[k] for step in steps]) for k in range(1, 6))
        A, returns = torch.zeros(T, R), torch.zeros(R)
        for t in reversed(range(T)):  # a plain return is enough for a timing
            returns = rewards[t] * 0.01 + 0.99 * returns * (1 - (starts[t + 1] if t < T - 1 else 0))
            A[t] = returns - values[t]
        for _ in range(epochs):
            for robots in torch.randperm(R).chunk(minibatches):
                part = {key: value[:, robots] for key, value in seen.items()}
                distribution, new_values, _ = policy(part, starts[:, robots], state[robots])
                r = (distribution.log_prob(actions[:, robots]).sum(-1) - log_probs[:, robots]).exp()
                a = (A[:, robots] - A.mean()) / A.std()
                loss = (-torch.min(r * a, r.clamp(0.8, 1.2) * a).mean() + VALUE_WEIGHT
                        * (new_values - A[:, robots] - values[:, robots]).square().mean())
                optimizer.zero_grad()
                loss.backward()
                torch.nn.utils.clip_grad_norm_(net.parameters(), MAX_GRADIENT_NORM)
                optimizer.step()
    return rate(learn, R * T, timings=3)


PEERS = {"MiniWorld": ("env", miniworld), "ViZDoom": ("env", vizdoom)}
for _name, _peer, _own in (
        ("RecurrentPPO", recurrent_ppo, dict(R=8, T=128, epochs=10, minibatches=8)),
        ("CleanRL-style", cleanrl_style, dict(R=8, T=128, epochs=4, minibatches=4))):
    PEERS[f"{_name}, as it comes"] = ("training", partial(_peer, **_own))
    PEERS[f"{_name}, our work"] = ("training", partial(_peer, **OURS))
