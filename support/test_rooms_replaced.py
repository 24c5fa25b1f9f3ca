"""Environments that come and go: what is dropped is freed, a state brings back what was shown."""

import gc
import pickle
import weakref

import numpy as np
import pytest
from gymnasium.error import ResetNeeded

import scenes
from navbot_min import NavVecEnv
from render import Camera
from scenes.test_scenes import square_room
from sim import World


@pytest.fixture
def no_collector():
    """Python without its search for cycles, which with torch loaded comes rarely."""
    gc.collect()
    gc.disable()
    yield
    gc.enable()
    gc.collect()


def test_a_room_that_is_driven_in_no_more_is_freed_at_once(no_collector):
    room = scenes.parse(square_room(1.0, training_targets=[[0.5, 0.0]], new_targets=[]), "room")
    env = NavVecEnv(2, [room], random_starts=1.0)
    env.reset(seed=0)
    env.step(np.ones((2, 2)))
    env.step(np.ones((2, 2)))
    dropped = [weakref.ref(thing) for thing in (env, env.world, env.camera, room)]
    assert all(isinstance(one(), kind)
               for one, kind in zip(dropped, (NavVecEnv, World, Camera, type(room))))
    del env, room
    assert [one() for one in dropped] == [None] * 4


def test_a_state_brings_back_what_is_shown():
    env, other = (NavVecEnv(2, ["env2", "env1"], random_starts=1.0, render_mode="rgb_array")
                  for _ in range(2))
    env.reset(seed=0)
    for _ in range(5):
        env.step(np.array([[0.5, 0.1], [0.2, 1.0]]))
    state = env.state()
    shown = pickle.loads(pickle.dumps(env)).render()
    for _ in range(3):
        env.step(np.ones((2, 2)))
    other.load_state(state)  # never reset
    env.load_state(state)  # driven on since
    for again in (env.render(), other.render()):
        assert all((one == before).all() for one, before in zip(again, shown))


def test_there_is_no_state_before_the_first_reset():
    with pytest.raises(ResetNeeded, match=r"state\(\) was called before reset\(\)"):
        NavVecEnv(1).state()
