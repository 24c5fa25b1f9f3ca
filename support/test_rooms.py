"""Each test is the shortest proof of one claim about which rooms a training drives in, and when."""

import gc
import pickle
import weakref
from itertools import combinations

import numpy as np
import pytest
import torch

import scenes
import train
from scenes import generate
from scenes.test_scenes import square_room
from sim import Scene
from support import rooms
from support.processes import OneProcess

ENV1 = scenes.load("env1")


def random_rooms(**options):
    """RandomRooms of a training with these options."""
    return rooms.RandomRooms(train.Config(env="random", **options), [ENV1])


def visited(stays, moves):
    """The rooms' numbers that are learnt in, a list for each time between two moves."""
    numbers = [[stays.number(r) for r in range(stays.learning)]]
    for k in range(moves):
        assert not stays.move((k + 1) * 50_000 - 1)
        assert stays.move((k + 1) * 50_000)
        numbers.append([stays.number(r) for r in range(stays.learning)])
    return numbers


# ------------------------------------------------------------------------------------ by numbers


def test_no_room_is_learnt_in_by_two_runs_and_none_is_for_validation():
    runs = [set(sum(visited(random_rooms(seed=seed), 40), [])) for seed in range(6)]
    assert all(min(run) > rooms.VALIDATION_ROOMS for run in runs)
    assert not any(one & other for one, other in combinations(runs, 2))
    for robots in (1, 64, 4096):
        longest = random_rooms(seed=0, robots=robots)
        longest.moves = longest.due(10 ** 9)
        assert max(map(longest.number, range(longest.learning))) < min(runs[1])
    assert [room.name for room in rooms.validation_scenes()] == [f"random-{k}" for k in range(16)]


@pytest.mark.parametrize("count", [4, 100])
def test_of_so_many_rooms_each_is_learnt_in_and_no_other(count):
    numbers = visited(random_rooms(rooms=count), 12)
    assert set(sum(numbers, [])) == set(range(1_000_000, 1_000_000 + count))


def test_of_ever_new_rooms_every_robot_gets_one_at_every_move():
    numbers = visited(random_rooms(), 8)
    assert all(len(set(now)) == 60 for now in numbers)
    assert len(set(sum(numbers, []))) == 9 * 60


@pytest.mark.parametrize("robots, watching", [(1, 0), (2, 1), (15, 1), (16, 1), (64, 4)])
def test_one_robot_of_16_watches_and_all_rooms_for_validation_have_their_turn(robots, watching):
    stays = rooms.RandomRooms(train.Config(env="random", robots=robots), ["a", "b", "c"])
    watchers = [r for r in range(robots) if stays.is_watched(r)]
    assert len(watchers) == watching
    seen = []
    for stays.moves in range(3):
        seen += map(stays.of_robot, watchers)
    assert all(seen.count(room) == watching for room in "abc")


# ---------------------------------------------------------------------------------- in a training


@pytest.fixture
def quick(monkeypatch):
    """Rooms that are made at once, and moves of 32 robots after every 400 steps."""
    def square(seed):
        half = 0.6 + seed % 7 / 10
        return scenes.parse(square_room(half, training_targets=[[0.2, 0.0]], new_targets=[]),
                            f"random-{seed}")
    monkeypatch.setattr(generate, "room", square)
    monkeypatch.setattr(rooms, "EVERY", 800)
    monkeypatch.setattr(rooms, "VALIDATION_ROOMS", 3)


def training(processes=OneProcess(), **options):
    """A training in random rooms, with 2 watching robots of 32."""
    options = dict(env="random", targets="anywhere", robots=32, episodes_per_update=8,
                   minibatches=1, epochs=1) | options
    return train.Training(train.Config(**options), rooms.validation_scenes(), processes)


def names(run):
    """The rooms of a training's robots."""
    return [scene.name for scene in run.env.scenes]


def one_of(count, rank):
    """The process of that rank, of so many, without the others."""
    processes = OneProcess()
    processes.rank = rank
    processes.count = count
    return processes


def test_every_robot_drives_as_long_in_a_room_whatever_their_number():
    for robots, steps in ((64, 50_000), (16, 12_500), (1024, 800_000)):
        stays = random_rooms(robots=robots)
        assert not stays.move(steps - 1) and stays.move(steps)
        assert stays.move(5 * steps) and stays.moves == 5  # after an update of very many episodes


@pytest.mark.parametrize("count, rank", [(1, 0), (2, 0), (2, 1)])
def test_what_a_watching_robot_does_is_new_and_never_learnt_from(quick, count, rank):
    run = training(one_of(count, rank))
    watched = {room.name for room in rooms.validation_scenes()}
    kinds = set()
    for _ in range(20):
        rows = run.collect()
        assert all((row["kind"] == "new") == (row["scene"] in watched) for row in rows)
        learnt = [row for row in rows if row["scene"] not in watched]
        assert [len(episode) for episode in run.buffer] == [row["length"] for row in learnt]
        kinds |= {row["kind"] for row in rows}
    assert kinds == {"training", "new"} and run.rooms.moves > 1


def test_processes_share_the_robots_and_each_robot_has_its_room(quick):
    alone = training()
    shares = [training(one_of(2, rank)) for rank in range(2)]
    for _ in range(3):
        assert [names(share) for share in shares] == [names(alone)[0::2], names(alone)[1::2]]
        assert len(set(names(alone))) == 32
        for run in (alone, *shares):
            assert run.rooms.move((run.rooms.moves + 1) * 400)
            run.enter_rooms()


def test_a_move_drops_the_episodes_under_way_and_nothing_else(quick):
    run = training()
    moves = 0
    for _ in range(20):
        steps = run.record.steps
        under_way = run.collector._length.sum()
        rows = run.collect()
        if run.rooms.moves > moves:
            under_way = 0
            moves += 1
        driven = run.record.steps - steps
        ended = sum(row["length"] for row in rows)
        assert ended + run.collector._length.sum() == under_way + driven
    assert moves > 2


def test_a_training_in_random_rooms_goes_on_from_its_state_over_a_move(quick):
    whole = training(steps=10 ** 5)
    while whole.rooms.moves < 2:
        whole.collect()
        whole.learn()
    state = pickle.loads(pickle.dumps(whole.state()))
    again = training(steps=10 ** 5)
    again.load_state(state)
    while whole.rooms.moves < 4:
        assert names(again) == names(whole)
        assert str(again.collect()) == str(whole.collect())
        assert again.learn() == whole.learn()
    assert all(torch.equal(one, other)
               for one, other in zip(whole.model.parameters(), again.model.parameters()))


def test_memory_does_not_grow_over_30_moves(quick):
    run = training()
    gc.collect()
    gc.disable()  # with torch loaded Python looks for cycles rarely
    try:
        left = []
        for k in range(30):
            left.append([weakref.ref(thing) for thing in (run.env, run.env.world, run.collector)])
            left[-1] += [weakref.ref(run.rooms.of_robot(r)) for r in range(30)]
            assert run.rooms.move((k + 1) * 400)
            run.enter_rooms()
            run.collect()
        # By 5 moves all that are learnt from have moved on.
        assert not any(thing() for things in left[:-4] for thing in things)
    finally:
        gc.enable()


def test_a_start_to_learn_from_is_mostly_behind_something_and_an_exams_is_not():
    room = generate.room(2)
    rng = np.random.default_rng(0)

    def share_behind(scene):
        """By points on the line, 1 cm apart."""
        behind = []
        for _ in range(300):
            goal = scene.any_place(rng)
            start = scene.any_start(goal, rng)
            line = np.linspace(start[:2], goal, 400)
            behind.append(scene.clearance(line).min() <= 0)
        return np.mean(behind)
    plain = share_behind(room)
    expected = 1 - (1 - plain) ** rooms.DRAWS  # roughly: it differs from goal to goal
    assert 0.3 < plain < 0.7
    assert share_behind(rooms.as_training_room(room)) == pytest.approx(expected, abs=0.1)


def test_the_exam_at_the_end_is_in_plain_rooms(quick):
    run = training()
    by_kind = run.rooms.by_kind()
    assert [room.name for room in by_kind["training"]] == [f"random-{1_000_000 + k}"
                                                           for k in range(rooms.VALIDATION_ROOMS)]
    assert all(type(room) is Scene for kind in by_kind.values() for room in kind)
    assert all(type(room) is rooms.TrainingRoom for room in run.env.scenes[:30])
