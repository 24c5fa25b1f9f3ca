"""The one loop that drives episodes: what it counts, and what it keeps of it."""

import numpy as np
import pytest

import scenes
from navbot_min import OUTCOMES, NavEnv, NavVecEnv
from sim import CONTROL_PERIOD
from support import traces
from support.traces import TurnToTarget, drive

ENV1 = scenes.load("env1")


class Script:
    """An environment whose robots' episodes have the lengths of a script, one list a robot, again
    and again. Pose, command, reward and image tell which step of which episode they are of."""

    scenes = ["a room", "another room"]

    def __init__(self, lengths):
        self.lengths = lengths
        self.num_envs = len(lengths)
        self.scene_of = np.arange(self.num_envs) % 2

    def begin(self, r):
        self.episode[r] += 1
        self.step_count[r] = 0
        self.starts[r] = self.code(r), 0, 0.5
        self.goals[r] = self.code(r), 1

    def code(self, r):
        """A number that no other step of robot r has: 100 an episode, 1 a step."""
        return 100 * self.episode[r] + self.step_count[r]

    def see(self):
        codes = np.array([self.code(r) for r in range(self.num_envs)])
        return {"image": np.broadcast_to(codes[:, None, None, None] % 256,
                                         (self.num_envs, 2, 2, 3)).astype(np.uint8)}

    def reset(self, seed):
        self.episode = np.full(self.num_envs, -1)
        self.step_count = np.zeros(self.num_envs, int)
        self.starts = np.zeros((self.num_envs, 3))
        self.goals = np.zeros((self.num_envs, 2))
        for r in range(self.num_envs):
            self.begin(r)
        return self.see(), {}

    def step(self, actions):
        self.step_count += 1
        codes = np.array([self.code(r) for r in range(self.num_envs)], float)
        lengths = [own[k % len(own)] for own, k in zip(self.lengths, self.episode)]
        done = self.step_count == lengths
        infos = {"pose": np.stack([codes, codes * 0, codes * 0], -1),
                 "command": np.stack([codes, codes * 0], -1)}
        if done.any():
            infos["final_obs"] = self.see()
            infos["final_info"] = {"outcome": self.episode % 3, "new": self.episode > 0,
                                   "target_index": self.episode.copy()}
        for r in np.flatnonzero(done):
            self.begin(r)
        return self.see(), codes, done, np.zeros_like(done), infos


class Idle:
    """A driver that notes whose episodes begin."""

    def __init__(self):
        self.begun = []

    def reset(self, env, robots):
        self.begun.append(robots.tolist())

    def act(self, env, observations):
        return np.zeros((env.num_envs, 2))


def test_each_robots_first_episodes_count_whole_and_in_order():
    env = Script([[3], [1], [5, 2]])
    driven = drive(Idle(), env, [1, 2, 2], images=True)
    assert [(trace.scene, trace.target, len(trace.commands)) for trace in driven] == [
        ("another room", 0, 1), ("another room", 1, 1), ("a room", 0, 3), ("a room", 0, 5),
        ("a room", 1, 2)]
    for trace in driven:
        first = 100 * trace.target
        codes = first + np.arange(len(trace.poses))
        assert trace.start.tolist() == [first, 0, 0.5] and trace.goal.tolist() == [first, 1]
        assert (trace.poses[:, 0] == codes).all() and (trace.images[:, 0, 0, 0] == codes).all()
        assert (trace.commands[:, 0] == codes[1:]).all() and (trace.rewards == codes[1:]).all()
        assert trace.outcome == OUTCOMES[trace.target] and trace.new is (trace.target > 0)


def test_a_driver_is_told_whose_episodes_begin_also_of_robots_that_have_their_quota():
    driver = Idle()
    drive(driver, Script([[4], [1]]), [1, 1])
    assert driver.begun == [[0, 1], [1], [1], [1], [0, 1]]


def test_nothing_is_kept_of_a_robot_that_has_its_quota(monkeypatch):
    kept = []

    class Spy(traces.Recording):
        def add(self, *step):
            super().add(*step)
            kept.append((self.r, len(self.images)))
    monkeypatch.setattr(traces, "Recording", Spy)
    drive(Idle(), Script([[9], [2], [1]]), [1, 1, 0], images=True)
    assert [r for r, _ in kept] == [0, 1, 0, 1] + 7 * [0]


def test_a_quota_is_one_number_for_each_robot():
    with pytest.raises(ValueError, match=r"shape \(2,\), it must be \(3,\)"):
        drive(Idle(), Script([[1]] * 3), [1, 1])


def test_traces_of_the_real_environment_are_those_of_single_robots():
    env = NavVecEnv(6, [ENV1], "both", random_starts=0.5, max_episode_steps=30)
    driven = drive(TurnToTarget(), env, [2] * 6, seed=3, images=True)
    assert len(driven) == 12 and len({trace.outcome for trace in driven}) > 1
    assert traces.OUTCOMES == OUTCOMES
    for trace in driven:
        alone = NavEnv([ENV1], max_episode_steps=30)
        seen, info = alone.reset(options={"target": trace.target, "start": trace.start})
        total = 0.0
        metres = 0.0
        for t, command in enumerate(trace.commands):
            assert np.allclose(info["pose"], trace.poses[t], atol=1e-9)
            assert np.array_equal(seen["image"], trace.images[t])
            seen, reward, terminated, truncated, info = alone.step(command / (0.3, 1.0))
            total += reward
            metres += command[0] * 0.4
            assert (terminated or truncated) == (t == len(trace.commands) - 1)
        assert np.allclose(info["pose"], trace.poses[-1], atol=1e-9)
        assert np.array_equal(seen["image"], trace.images[-1])
        assert (trace.outcome, trace.new) == (OUTCOMES[info["outcome"]], info["new"])
        assert trace.total_reward == pytest.approx(total) and trace.metres == pytest.approx(metres)
        assert trace.seconds == pytest.approx(info["length"] * CONTROL_PERIOD)
        assert trace.arrived is (trace.outcome == "arrival")


def test_images_are_kept_where_they_are_asked_for_alone():
    driven = drive(Idle(), Script([[2]]), [1])
    assert driven[0].images is None


def test_a_trace_holds_what_its_driver_thought_at_every_step():
    class Thinker(TurnToTarget):
        def act(self, env, observations):
            self.thoughts = {"target": observations["target"]}
            return super().act(env, observations)

    env = NavVecEnv(3, ["env1"])
    for trace in drive(Thinker(), env, quota=[2, 1, 2]):
        distance = np.hypot(*(trace.goal - trace.poses[:-1, :2]).T)
        assert np.allclose(trace.thoughts["target"][:, 0], distance, atol=1e-5)
    assert drive(TurnToTarget(), env, quota=[1, 0, 0])[0].thoughts is None
