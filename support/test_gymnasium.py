"""Tests of the environments with Gymnasium: what its wrappers, and libraries that build on it,
expect of an environment."""

import gymnasium as gym
import numpy as np
import pytest
import torch
from gymnasium import wrappers
from gymnasium.wrappers import vector as vector_wrappers

import scenes
from navbot_min import TIMEOUT, NavEnv, NavVecEnv
from scenes.test_scenes import square_room

ID = "navbot_min:NavBot-env1-v1"
STILL = np.zeros(2)


def drive(env, action):
    """Drives one episode. Returns its length and the last info."""
    env.reset(seed=0)
    length = 0
    over = False
    while not over:
        _, _, terminated, truncated, info = env.step(action)
        over = np.all(np.asarray(terminated | truncated))
        length += 1
    return length, info


def test_gymnasium_records_the_same_episode_statistics_in_numpy_and_torch():
    env = wrappers.RecordEpisodeStatistics(gym.make(ID, max_episode_steps=9))
    length, info = drive(env, STILL)
    assert info["episode"]["l"] == length == 9
    assert info["episode"]["r"] == pytest.approx(info["return"], abs=1e-4)
    many = vector_wrappers.RecordEpisodeStatistics(NavVecEnv(3, max_episode_steps=9))
    _, infos = drive(vector_wrappers.NumpyToTorch(many), torch.zeros(3, 2))
    assert (infos["episode"]["l"] == 9).all()
    assert torch.allclose(infos["episode"]["r"].double(), infos["final_info"]["return"], atol=1e-4)
    assert torch.equal(infos["final_info"]["outcome"], torch.tensor([TIMEOUT] * 3))


def test_info_always_has_the_same_keys_and_types_and_distinguishes_arrival_from_collision():
    room = scenes.parse(square_room(training_targets=[[0.5, 0.0], [-1.0, 0.0]]), "room")
    env = NavEnv([room])
    for target, expected in ((0, True), (1, False)):  # ahead: arrival; behind: it hits the wall
        infos = [env.reset(seed=0, options={"target": target})[1]]
        over = False
        while not over:
            _, _, over, _, info = env.step([1.0, 0.0])
            assert info["is_success"] is (over and expected)
            infos.append(info)
        kinds = [{key: type(value) for key, value in info.items()} for info in infos]
        assert kinds == [kinds[0]] * len(infos)
        assert [info["length"] for info in infos] == list(range(len(infos)))


def test_a_generator_set_by_the_user_draws_the_episodes():
    first, second = NavEnv(targets="anywhere"), NavEnv(targets="anywhere")
    for env, seed in ((first, 1), (second, 2)):
        env.reset(seed=seed)
        env.np_random = np.random.default_rng(5)
    one, _ = first.reset()
    other, _ = second.reset()
    assert (one["image"] == other["image"]).all() and (one["target"] == other["target"]).all()
