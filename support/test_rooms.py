"""Tests of the rooms of a training run: which robot drives in which room, and when."""

import pickle
from itertools import combinations

import gymnasium as gym
import numpy as np
import pytest
import torch

import scenes
import support.random_rooms
import train
from navbot_min import NavVecEnv
from render import Camera
from scenes import generate
from scenes.test_scenes import square_room
from sim import Scene, SceneError
from support import parallel, rooms
from support.film import EpisodeView
from support.run_folder import restore, state_of

ENV1 = scenes.load("env1")


def random_rooms(**options):
    """Returns the RandomRooms of a run with these options."""
    return rooms.RandomRooms(train.Config(env="random", **options), ["a", "b", "c"])


def visited(random, stages):
    """Returns the numbers of the training rooms of the first stages."""
    return {random.number(r, stage) for r in range(random.learning) for stage in range(stages)}


def test_no_two_runs_share_a_training_room_and_no_validation_room_is_trained_on():
    runs = [visited(random_rooms(seed=seed), 40) for seed in range(6)]
    assert all(min(run) > rooms.VALIDATION_ROOMS for run in runs)
    assert not any(one & other for one, other in combinations(runs, 2))
    for option, expected in ((4, 4), (100, 100), (0, 9 * 60)):  # 0: new rooms at every stage
        numbers = visited(random_rooms(rooms=option), 9)
        assert numbers == set(range(1_000_000, 1_000_000 + expected))


@pytest.mark.parametrize("robots, watched", [(1, 0), (2, 1), (16, 1), (64, 4)])
def test_one_robot_in_16_is_watched_and_all_validation_rooms_are_used(robots, watched):
    random = random_rooms(robots=robots)
    indices = [r for r in range(robots) if random.is_watched(r)]
    assert len(indices) == watched
    seen = [random.of_robot(r, stage) for stage in range(3) for r in indices]
    assert all(seen.count(room) == watched for room in "abc")


@pytest.mark.parametrize("targets, in_mirror", [("both", 2), ("memorize", 0), ("anywhere", 0)])
def test_at_level_2_the_last_robots_drive_in_mirrored_rooms(targets, in_mirror):
    given = rooms.GivenRooms(train.Config(robots=8, mirrored=0.25, targets=targets), [ENV1])
    scene_of = [given.of_robot(r, stage=5) for r in range(8)]
    assert scene_of == [ENV1] * (8 - in_mirror) + [ENV1.mirrored()] * in_mirror


def test_a_damaged_copy_of_the_room_is_named(tmp_path):
    (tmp_path / rooms.ROOM).write_text('{"name": "env1"')
    with pytest.raises(SceneError, match="room '.*room.json' cannot be used: "):
        rooms.load_rooms(train.Config(resume=str(tmp_path)))


@pytest.fixture
def quick(monkeypatch):
    """Simple rooms that are quick to make, and stages of 400 steps for 32 robots."""
    def square(seed):
        half = 0.6 + seed % 7 / 10
        return scenes.parse(square_room(half, training_targets=[[0.2, 0.0]], new_targets=[]),
                            f"random-{seed}")
    monkeypatch.setattr(generate, "room", square)
    monkeypatch.setattr(train, "STAGE", 800)
    monkeypatch.setattr(rooms, "VALIDATION_ROOMS", 3)
    yield
    rooms.training_room.cache_clear()


def training(**options):
    """Returns a Training in random rooms at its first stage, with 2 of 32 robots watched."""
    options = dict(env="random", targets="anywhere", robots=32, episodes_per_update=8,
                   minibatches=1, epochs=1) | options
    run = train.Training(train.Config(**options), rooms.validation_scenes())
    run.begin_stage()
    return run


def collect(run):
    """Collects and records episodes, and begins the next stage when it is due."""
    if run.steps >= run.next_stage:
        run.begin_stage()
    episodes, rows = run.collect()
    for row in rows:
        run.record(row)
    return episodes, rows


def test_episodes_of_watched_robots_count_as_new_and_are_never_trained_on(quick):
    run = training()
    watched = {room.name for room in rooms.validation_scenes()}
    kinds = set()
    for _ in range(20):
        episodes, rows = collect(run)
        assert all((row["kind"] == "new") == (row["scene"] in watched) for row in rows)
        lengths = sorted(row["length"] for row in rows if row["scene"] not in watched)
        assert sorted(map(len, episodes)) == lengths
        kinds |= {row["kind"] for row in rows}
    assert kinds == {"training", "new"} and run.stage > 1


def test_processes_share_the_robots_and_each_robot_keeps_its_room(quick, monkeypatch):
    all_scenes = training().env.scenes
    assert len({scene.name for scene in all_scenes}) == 32
    monkeypatch.setattr(parallel, "count", lambda: 2)
    for rank in range(2):
        monkeypatch.setattr(parallel, "rank", lambda: rank)
        assert training().env.scenes == all_scenes[rank::2]


def test_a_training_restored_from_its_state_reaches_the_same_weights(quick):
    whole = training(steps=10 ** 5)
    while whole.stage < 1 or whole.steps < whole.next_stage:
        whole.learn(collect(whole)[0])
    again = training(steps=10 ** 5)
    restore(again, pickle.loads(pickle.dumps(state_of(whole))))
    again.begin_stage()
    while whole.stage < 3:
        episodes, rows = collect(whole)
        others, other_rows = collect(again)
        assert rows == other_rows and whole.env.scenes == again.env.scenes
        assert whole.learn(episodes) == again.learn(others)
    assert whole.arrivals == again.arrivals
    assert all(torch.equal(one, other)
               for one, other in zip(whole.model.parameters(), again.model.parameters()))


def test_in_training_rooms_the_line_from_start_to_goal_is_blocked_more_often_than_in_evaluation():
    rng = np.random.default_rng(0)
    fractions = []
    for room in (generate.room(2), rooms.training_room(2)):
        blocked = []
        for _ in range(200):
            goal = room.any_place(rng)
            line = np.linspace(room.any_start(goal, rng)[:2], goal, 400)  # points 1 cm apart
            blocked.append(room.clearance(line).min() <= 0)
        fractions.append(np.mean(blocked))
    expected = 1 - (1 - fractions[0]) ** rooms.DRAWS  # approximate: it differs between goals
    assert 0.3 < fractions[0] < 0.7 and fractions[1] == pytest.approx(expected, abs=0.1)


def test_the_evaluation_after_training_uses_plain_scenes(quick):
    by_kind = training().rooms.by_kind(0)
    evaluated = by_kind["training"] + by_kind["new"]
    numbers = [1_000_000, 1_000_001, 1_000_002, 0, 1, 2]
    assert [room.name for room in evaluated] == [f"random-{k}" for k in numbers]
    assert all(type(room) is Scene for room in evaluated)


def test_random_rooms_follow_from_the_seed_of_the_environment_and_change(quick, monkeypatch):
    monkeypatch.setattr(support.random_rooms, "EPISODES_PER_ROOM", 2)
    many, same = [gym.make_vec("navbot_min:NavBot-random-v1", num_envs=3,
                               vectorization_mode="vector_entry_point").unwrapped for _ in "12"]
    many.reset(seed=0)
    many.reset(seed=1)
    same.reset(seed=1)
    visited = {many.scenes[0].name: 0}  # room of robot 0 -> episodes that ended in it
    for _ in range(300):
        room = many.scenes[0].name
        _, _, terminated, truncated, _ = many.step(np.ones((3, 2)))
        same.step(np.ones((3, 2)))
        assert many.scenes == same.scenes and (many.goals == same.goals).all()
        visited[room] += int(terminated[0] | truncated[0])
        visited.setdefault(many.scenes[0].name, 0)
    images = many.step(np.ones((3, 2)))[0]["image"]
    expected = Camera(many.scenes).render(many.scene_of, many.world.poses, many.goals)
    assert (images == expected).all()
    *ended, _ = visited.values()
    assert len(ended) > 5 and set(ended) == {2}
    assert min(int(name.removeprefix("random-")) for name in visited) >= rooms.FIRST_ROOM
    with pytest.raises(ValueError, match="in random rooms there are none"):
        many.reset(options={"target": 0})


def test_one_robot_gets_a_random_room_that_follows_from_the_seed():
    env = gym.make("navbot_min:NavBot-random-v1").unwrapped
    other = gym.make("navbot_min:NavBot-random-v1").unwrapped
    seen = []
    for seed in (0, 1, 0):
        observation, _ = env.reset(seed=seed)
        seen.append((env.vector.scenes[0].name, *observation["target"]))
    assert seen[0] == seen[2] and seen[0][0] != seen[1][0]
    other.reset(seed=0)
    assert other.vector.scenes[0].name == seen[0][0]


def test_one_robot_changes_its_room_however_episodes_end_and_its_map_shows_the_room(monkeypatch):
    monkeypatch.setattr(support.random_rooms, "EPISODES_PER_ROOM", 2)
    env = gym.make("navbot_min:NavBot-random-v1", render_mode="rgb_array", max_episode_steps=60)
    visited = []
    for action in [(1, 0), (0, 0)] * 3:  # into a wall; until the wrapper's limit
        seen, info = env.reset(seed=None if visited else 0)
        room = env.unwrapped.vector.scenes[0]
        visited.append(room.name)
        view = EpisodeView(room, (info["goal_x"], info["goal_y"]))
        assert (env.render() == view.frame(info["pose"], seen["image"], (0, 0), 0)).all()
        over = False
        while not over:
            _, _, terminated, over, _ = env.step(np.array(action))
            over |= terminated
        assert terminated == (action == (1, 0))
    assert visited[::2] == visited[1::2] and len(set(visited)) == 3


@pytest.mark.filterwarnings("ignore:.*out of date")
def test_the_error_for_an_old_version_of_an_environment_names_the_new_one():
    with pytest.raises(gym.error.DeprecatedEnv, match="NavBot-env1-v1"):
        gym.make("navbot_min:NavBot-env1-v0")


def test_a_robot_sees_and_hits_the_walls_of_its_new_room():
    env = NavVecEnv(2, ["env1", "random:3"], "anywhere")
    env.reset(seed=0)
    for r, room in ((0, scenes.load("maze4")), (1, generate.room(4))):
        env.world.set_scene(r, room)
        env.camera.set_scene(r, room)
    fresh = NavVecEnv(2, ["maze4", "random:4"], "anywhere")
    rng = np.random.default_rng(0)
    hits = 0
    for _ in range(30):
        poses = np.array([room.any_start((0, 0), rng) for room in fresh.scenes])
        images = [each.camera.render(each.scene_of, poses, poses[:, :2]) for each in (env, fresh)]
        assert (images[0] == images[1]).all()
        for world in (env.world, fresh.world):
            world.place(slice(None), poses)
        hit, other = [world.drive([(0.3, 0.0)] * 2) for world in (env.world, fresh.world)]
        assert (hit == other).all() and (env.world.poses == fresh.world.poses).all()
        hits += hit.sum()
    assert hits > 3
