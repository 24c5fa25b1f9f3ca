"""Other people's libraries drive our environments: which of them can.

`python -m experiments.clients` runs TorchRL, stable-baselines3, sb3-contrib and the wrappers of
Gymnasium that need packages of their own, prints a row for each and writes `results/clients.csv`.
It wants an environment of its own: `pip install -r experiments/requirements-clients.txt`.

A row passes if what its function says holds; else its result is the error, in one sentence.
"""

import csv
import io
import os
import tempfile
import warnings
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path

import gymnasium as gym
import numpy as np
import torch

from navbot_min import NavEnv, NavVecEnv
from support.command_line import CommandLine
from support.run_folder import write

ROOT = Path(__file__).parent.parent
COLUMNS = ("client", "version", "what", "result")
PACKAGES = ("array-api-compat", "moviepy", "pygame", "sb3-contrib", "stable-baselines3",
            "tensordict", "torchrl")  # beside our own requirements

ID = "navbot_min:NavBot-env1-v0"
ROBOTS = 4
SHORT = 5  # steps of an episode that has to end by its time limit
TRAINING_STEPS = 512


# ----------------------------------------------------------------------------------------- TorchRL


class Remembering(NavVecEnv):
    """Keeps the last observations of the episodes that ended last, for a comparison."""

    def step(self, actions):
        observations, reward, terminated, truncated, infos = super().step(actions)
        if "final_obs" in infos:
            self.last_seen = {key: value.copy() for key, value in infos["final_obs"].items()}
        return observations, reward, terminated, truncated, infos


class ForTorchRL(Remembering):
    """Gives the last observations in `final_info` too. There TorchRL looks for them where an
    observation is a dict; without it they become zeros, with Gymnasium's SyncVectorEnv as well."""

    def step(self, actions):
        observations, reward, terminated, truncated, infos = super().step(actions)
        if "final_obs" in infos:
            infos["final_info"] = infos["final_info"] | infos["final_obs"]
        return observations, reward, terminated, truncated, infos


def torchrl_one():
    """TorchRL's own checks of the specifications of one robot, made by the environment's name."""
    from torchrl.envs import GymEnv
    from torchrl.envs.utils import check_env_specs
    check_env_specs(GymEnv(ID))


def torchrl_many():
    """The same checks of several robots, whose episodes end and start anew within them."""
    from torchrl.envs import GymWrapper
    from torchrl.envs.utils import check_env_specs
    check_env_specs(GymWrapper(NavVecEnv(ROBOTS, ["env1"], max_episode_steps=2)))


def torchrl_rollout_one():
    """A rollout of one robot ends at the time limit that its maker was given."""
    from torchrl.envs import GymEnv
    rollout = GymEnv(ID, max_episode_steps=SHORT).rollout(2 * SHORT)
    truncated = rollout["next", "truncated"][:, 0].tolist()
    assert truncated == [False] * (SHORT - 1) + [True], f"truncated was {truncated}"


def torchrl_rollout_many():
    """A rollout of several robots holds the last observations of their episodes."""
    compare_last_seen(ForTorchRL)


def torchrl_rollout_plain():
    """The same of our environment as it is, which gives them in `final_obs`, as Gymnasium does."""
    compare_last_seen(Remembering)


def compare_last_seen(environment):
    """Raises AssertionError unless TorchRL's rollout ends with what the environment saw last."""
    from torchrl.envs import GymWrapper
    env = environment(ROBOTS, ["env1"], max_episode_steps=SHORT)
    wrapped = GymWrapper(env)
    wrapped.set_seed(0)
    rollout = wrapped.rollout(SHORT)
    assert rollout["next", "done"][:, -1].all(), "not all episodes ended at the time limit"
    for key, last_seen in env.last_seen.items():
        read = rollout["next", key][:, -1].numpy()
        blank = "all zeros" if not read.any() else "another"
        assert np.array_equal(read, last_seen), (
            f"the last `{key}` of an episode is {blank}, not the one that the environment gave")


# ------------------------------------------------------------------------------- stable-baselines3


def two_robots():
    """stable-baselines3's vector environment of two robots."""
    from stable_baselines3.common.vec_env import DummyVecEnv
    return DummyVecEnv([lambda: gym.make(ID)] * 2)


def sb3_check():
    """stable-baselines3's checker of environments."""
    from stable_baselines3.common.env_checker import check_env
    check_env(NavEnv(["env1"]))


def sb3_ppo():
    """Some steps of PPO."""
    from stable_baselines3 import PPO
    learner = PPO("MultiInputPolicy", two_robots(), n_steps=128, n_epochs=2, device="cpu", seed=0)
    learner.learn(TRAINING_STEPS)
    assert learner.num_timesteps >= TRAINING_STEPS, f"only {learner.num_timesteps} steps were made"


def sb3_recurrent_ppo():
    """Some steps of PPO with an LSTM."""
    from sb3_contrib import RecurrentPPO
    learner = RecurrentPPO("MultiInputLstmPolicy", two_robots(), n_steps=128, n_epochs=2,
                           device="cpu", seed=0)
    learner.learn(TRAINING_STEPS)
    assert learner.num_timesteps >= TRAINING_STEPS, f"only {learner.num_timesteps} steps were made"


# --------------------------------------------------------------------------------------- Gymnasium


def drive(env):
    """One episode of random actions."""
    env.action_space.seed(0)
    env.reset(seed=0)
    over = False
    while not over:
        _, _, terminated, truncated, _ = env.step(env.action_space.sample())
        over = terminated or truncated


def record_video():
    """RecordVideo writes an episode's film with a frame for each of its T + 1 poses."""
    from moviepy import VideoFileClip
    with tempfile.TemporaryDirectory() as folder, warnings.catch_warnings():
        warnings.simplefilter("ignore")  # that the folder is there already
        env = gym.make(ID, max_episode_steps=SHORT, render_mode="rgb_array")
        env = gym.wrappers.RecordVideo(env, folder, episode_trigger=lambda episode: True)
        drive(env)
        env.close()
        with VideoFileClip(f"{folder}/rl-video-episode-0.mp4") as film:
            frames = round(film.duration * env.metadata["render_fps"])
    assert frames == SHORT + 1, f"the film has {frames} frames for {SHORT} steps"


def human_rendering():
    """HumanRendering shows the frames of `rgb_array` in a window (one without a screen, here)."""
    os.environ.setdefault("SDL_VIDEODRIVER", "dummy")
    env = gym.make(ID, max_episode_steps=SHORT, render_mode="rgb_array")
    env = gym.wrappers.HumanRendering(env)
    drive(env)
    env.close()


def numpy_to_torch():
    """The vector wrapper NumpyToTorch makes tensors of all infos, at an episode's end too."""
    from gymnasium.wrappers.vector import NumpyToTorch
    env = NumpyToTorch(gym.make_vec(ID, num_envs=ROBOTS, max_episode_steps=1))
    env.reset(seed=0)
    infos = env.step(torch.zeros(ROBOTS, 2))[4]
    values = [*infos["final_obs"].values(), *infos["final_info"].values(), infos["pose"]]
    assert all(isinstance(value, torch.Tensor) for value in values), "not all infos are tensors"


CLIENTS = (  # the package, what is run, the function that runs it
    ("torchrl", "`check_env_specs` of `GymEnv` on NavEnv", torchrl_one),
    ("torchrl", "a rollout of NavEnv to its time limit", torchrl_rollout_one),
    ("torchrl", "`check_env_specs` of `GymWrapper` on NavVecEnv", torchrl_many),
    ("torchrl", "a rollout of NavVecEnv, last observations as given", torchrl_rollout_plain),
    ("torchrl", "the same with last observations in `final_info` too", torchrl_rollout_many),
    ("stable-baselines3", "`check_env` on NavEnv", sb3_check),
    ("stable-baselines3", f"PPO, MultiInputPolicy, {TRAINING_STEPS} steps", sb3_ppo),
    ("sb3-contrib", f"RecurrentPPO, MultiInputLstmPolicy, {TRAINING_STEPS} steps",
     sb3_recurrent_ppo),
    ("gymnasium", "`RecordVideo` on NavEnv writes an mp4", record_video),
    ("gymnasium", "`HumanRendering` on NavEnv", human_rendering),
    ("gymnasium", "vector `NumpyToTorch` on NavVecEnv at an episode's end", numpy_to_torch))


def examine(check):
    """'passed', or 'failed: ' and the first line of the error."""
    try:
        check()
    except Exception as error:  # whatever it is, it is this client's row
        lines = str(error).splitlines() or [type(error).__name__]
        return f"failed: {lines[0]}"
    return "passed"


def main(argv=None):
    """The command line."""
    parser = CommandLine("Try which other libraries can drive the environments.")
    parser.parse(argv)
    if not __debug__:
        parser.error("python -O leaves out what the clients are checked by, it must be left out")
    parser.must_write_to(ROOT / "results")
    try:
        for package in PACKAGES:
            version(package)
    except PackageNotFoundError:
        parser.error(f"{package} is not installed, `pip install -r "
                     "experiments/requirements-clients.txt` brings all that is needed")
    table = io.StringIO()
    lines = csv.writer(table, lineterminator="\n")
    lines.writerow(COLUMNS)
    for package, what, check in CLIENTS:
        row = (package, version(package), what, examine(check))
        print(f"{row[0]:18} {row[1]:8} {row[2]:55} {row[3]}", flush=True)
        lines.writerow(row)
    write(ROOT / "results" / "clients.csv", table.getvalue().rstrip())
    print("wrote results/clients.csv")


if __name__ == "__main__":
    main()
