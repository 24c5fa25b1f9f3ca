"""Gymnasium's own wrappers take our environments. Each test is one of them, as people use it."""

import gymnasium as gym
import numpy as np
import pytest
import torch
from gymnasium import wrappers
from gymnasium.wrappers import vector as vector_wrappers
from moviepy import VideoFileClip

from navbot_min import TIMEOUT, NavVecEnv

ID = "navbot_min:NavBot-env1-v0"
STILL = np.zeros(2)


def drive(env, action):
    """Steps to the end of an episode; returns how many, and the last info."""
    env.reset(seed=0)
    length = 0
    over = False
    while not over:
        _, _, terminated, truncated, info = env.step(action)
        over = np.all(np.asarray(terminated | truncated))
        length += 1
    return length, info


def test_a_video_has_a_frame_for_every_step_and_the_first_sight(tmp_path):
    env = wrappers.RecordVideo(gym.make(ID, render_mode="rgb_array", max_episode_steps=12),
                               tmp_path / "films", disable_logger=True)
    length, _ = drive(env, STILL)
    env.close()
    video, = tmp_path.glob("films/*.mp4")
    with VideoFileClip(str(video)) as clip:
        frames = list(clip.iter_frames())
        assert clip.fps == env.metadata["render_fps"] and len(frames) == length + 1 == 13


def test_pictures_can_be_observed_and_shown_in_pygames_window(monkeypatch):
    monkeypatch.setenv("SDL_VIDEODRIVER", "dummy")
    env = wrappers.AddRenderObservation(gym.make(ID, render_mode="rgb_array"), render_only=True)
    picture, _ = env.reset(seed=0)
    assert env.observation_space.contains(picture) and (picture == env.unwrapped.render()).all()
    shown = wrappers.HumanRendering(gym.make(ID, render_mode="rgb_array"))
    shown.reset(seed=0)
    shown.step(STILL)
    assert shown.screen_size == picture.shape[1::-1]
    shown.close()


def test_statistics_of_episodes_are_ours():
    env = wrappers.RecordEpisodeStatistics(gym.make(ID, max_episode_steps=9))
    length, info = drive(env, STILL)
    assert info["episode"]["l"] == length == 9
    assert info["episode"]["r"] == pytest.approx(info["return"], abs=1e-4)
    many = vector_wrappers.RecordEpisodeStatistics(NavVecEnv(3, max_episode_steps=9))
    _, infos = drive(many, np.zeros((3, 2)))
    assert (infos["episode"]["l"] == 9).all()
    assert infos["episode"]["r"] == pytest.approx(infos["final_info"]["return"], abs=1e-4)


@pytest.mark.parametrize("make", [
    lambda: NavVecEnv(2, max_episode_steps=4),
    lambda: gym.make_vec(ID, num_envs=2, max_episode_steps=4)])
def test_tensors_come_out_of_numpy_to_torch_at_an_episodes_end_too(make):
    env = vector_wrappers.NumpyToTorch(make())
    length, infos = drive(env, torch.zeros(2, 2))
    assert length == 4
    figures = infos.get("final_info", infos)
    assert torch.equal(figures["outcome"], torch.tensor([TIMEOUT, TIMEOUT]))
