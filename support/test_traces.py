"""Tests of the loop that drives episodes and of what it records."""

import numpy as np
import pytest

from navbot_min import OUTCOMES, NavVecEnv
from support.traces import TurnToTarget, drive

QUOTA = [2, 0, 1, 3, 2, 1]


def make_env():
    """Returns an environment of six robots in two rooms, whose episodes end with every outcome."""
    return NavVecEnv(6, ["env1", "env2"], random_starts=0.5, max_episode_steps=15)


class RecordingDriver(TurnToTarget):
    """A driver with activations. `begun` lists the robots whose episodes begin."""

    def reset(self, env, robots):
        self.begun = [*getattr(self, "begun", []), robots.tolist()]

    def act(self, env, observations):
        self.activations = {"distance": observations["target"][:, 0]}
        return super().act(env, observations)


def test_traces_are_the_first_whole_episodes_of_each_robot_in_the_order_of_their_ends():
    driver = RecordingDriver()
    driven = drive(driver, make_env(), QUOTA, seed=3, images=True)
    env = make_env()  # the same drive again: all steps of all robots, to be cut into episodes
    seen, infos = env.reset(seed=3)
    begins = [(infos["pose"], seen["image"].copy(), env.goals.copy())]
    steps = []
    ended = []
    for _ in range(150):
        seen, rewards, terminated, truncated, infos = env.step(TurnToTarget().act(env, seen))
        last = infos.get("final_obs", seen)
        steps.append((infos["pose"], last["image"].copy(), infos["command"], rewards,
                      infos.get("final_info")))
        begins.append((env.world.poses, seen["image"].copy(), env.goals.copy()))
        ended.append(terminated | truncated)
    expected = []
    for r, quota in enumerate(QUOTA):
        ends = np.flatnonzero(np.array(ended)[:, r])[:quota]
        expected += zip(ends, [r] * quota, [0, *ends + 1])
    expected.sort()
    assert len(driven) == len(expected) == 9
    assert {trace.outcome for trace in driven} == set(OUTCOMES)
    for trace, (end, r, first) in zip(driven, expected):
        pose, image, goal = begins[first]
        own = steps[first:end + 1]
        final = own[-1][4]
        assert trace.scene == env.scenes[r % 2]
        assert (trace.start == pose[r]).all() and (trace.goal == goal[r]).all()
        assert (trace.poses[1:] == [step[0][r] for step in own]).all()
        assert (trace.images == [image[r], *(step[1][r] for step in own)]).all()
        assert (trace.commands == [step[2][r] for step in own]).all()
        assert (trace.rewards == [step[3][r] for step in own]).all()
        assert (trace.target, trace.new) == (final["target_index"][r], final["new"][r])
        assert trace.outcome == OUTCOMES[final["outcome"][r]]
        away = np.hypot(*(trace.goal - trace.poses[:-1, :2]).T)
        assert trace.activations["distance"] == pytest.approx(away, abs=1e-5)
    resets = [np.flatnonzero(done).tolist() for done in ended if done.any()]
    assert driver.begun == [list(range(6)), *resets[:len(driver.begun) - 1]]
