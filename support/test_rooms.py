"""Each test is the shortest proof of one claim about which rooms a training drives in, and when."""

import pickle
from itertools import combinations

import numpy as np
import pytest
import torch

import scenes
import train
from scenes import generate
from scenes.test_scenes import square_room
from sim import Scene
from support import parallel, rooms

ENV1 = scenes.load("env1")


def random_rooms(**options):
    """RandomRooms of a training with these options."""
    return rooms.RandomRooms(train.Config(env="random", **options), ["a", "b", "c"])


def visited(stays, stages):
    """The numbers of the rooms that are learned in at the first stages."""
    return {stays.number(r, stage) for r in range(stays.learning) for stage in range(stages)}


def test_no_room_is_learned_in_by_two_runs_and_none_is_for_validation():
    runs = [visited(random_rooms(seed=seed), 40) for seed in range(6)]
    assert all(min(run) > rooms.VALIDATION_ROOMS for run in runs)
    assert not any(one & other for one, other in combinations(runs, 2))
    for given, learned_in in ((4, 4), (100, 100), (0, 9 * 60)):  # 0: new ones at every stage
        numbers = visited(random_rooms(rooms=given), 9)
        assert numbers == set(range(1_000_000, 1_000_000 + learned_in))


@pytest.mark.parametrize("robots, watching", [(1, 0), (2, 1), (16, 1), (64, 4)])
def test_one_robot_of_16_watches_and_all_rooms_for_validation_have_their_turn(robots, watching):
    stays = random_rooms(robots=robots)
    watchers = [r for r in range(robots) if stays.is_watched(r)]
    assert len(watchers) == watching
    seen = [stays.of_robot(r, stage) for stage in range(3) for r in watchers]
    assert all(seen.count(room) == watching for room in "abc")


@pytest.mark.parametrize("targets, in_mirror", [("both", 2), ("memorize", 0), ("anywhere", 0)])
def test_the_last_robots_drive_in_mirrored_rooms_of_level_2(targets, in_mirror):
    stays = rooms.GivenRooms(train.Config(robots=8, mirrored=0.25, targets=targets), [ENV1])
    driven = [stays.of_robot(r, stage=5) for r in range(8)]
    assert driven == [ENV1] * (8 - in_mirror) + [ENV1.mirrored()] * in_mirror


@pytest.fixture
def quick(monkeypatch):
    """Rooms that are made at once, and stages of 400 steps of 32 robots."""
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
    """A training in random rooms, with 2 watching robots of 32, at its first stage."""
    options = dict(env="random", targets="anywhere", robots=32, episodes_per_update=8,
                   minibatches=1, epochs=1) | options
    run = train.Training(train.Config(**options), rooms.validation_scenes())
    run.begin_stage()
    return run


def collect(run):
    """Collects and counts episodes, at the next stage if it is time for it."""
    if run.steps >= run.next_stage:
        run.begin_stage()
    episodes, rows = run.collect()
    for row in rows:
        run.record(row)
    return episodes, rows


def test_what_a_watching_robot_does_is_new_and_never_learned_from(quick):
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


def test_processes_share_the_robots_and_each_robot_has_its_room(quick, monkeypatch):
    everyone = training().env.scenes
    assert len({scene.name for scene in everyone}) == 32
    monkeypatch.setattr(parallel, "count", lambda: 2)
    for rank in range(2):
        monkeypatch.setattr(parallel, "rank", lambda: rank)
        assert training().env.scenes == everyone[rank::2]


def test_a_training_goes_on_from_its_state_to_the_same_weights(quick):
    whole = training(steps=10 ** 5)
    while whole.stage < 1 or whole.steps < whole.next_stage:
        whole.learn(collect(whole)[0])
    again = training(steps=10 ** 5)
    again.load_state(pickle.loads(pickle.dumps(whole.state())))
    again.begin_stage()
    while whole.stage < 3:
        episodes, rows = collect(whole)
        others, other_rows = collect(again)
        assert rows == other_rows and whole.env.scenes == again.env.scenes
        assert whole.learn(episodes) == again.learn(others)
    assert whole.arrivals == again.arrivals
    assert all(torch.equal(one, other)
               for one, other in zip(whole.model.parameters(), again.model.parameters()))


def test_a_start_to_learn_from_is_mostly_behind_something_and_an_examined_one_is_not():
    rng = np.random.default_rng(0)
    fractions = []
    for room in (generate.room(2), rooms.training_room(2)):
        behind = []
        for _ in range(200):
            goal = room.any_place(rng)
            line = np.linspace(room.any_start(goal, rng)[:2], goal, 400)  # points 1 cm apart
            behind.append(room.clearance(line).min() <= 0)
        fractions.append(np.mean(behind))
    expected = 1 - (1 - fractions[0]) ** rooms.DRAWS  # roughly: it differs from goal to goal
    assert 0.3 < fractions[0] < 0.7 and fractions[1] == pytest.approx(expected, abs=0.1)


def test_the_evaluation_after_training_is_in_plain_rooms(quick):
    by_kind = training().rooms.by_kind(0)
    evaluated = by_kind["training"] + by_kind["new"]
    numbers = [1_000_000, 1_000_001, 1_000_002, 0, 1, 2]
    assert [room.name for room in evaluated] == [f"random-{k}" for k in numbers]
    assert all(type(room) is Scene for room in evaluated)
