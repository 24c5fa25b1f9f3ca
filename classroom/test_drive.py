"""Each test is the shortest proof of one claim about drives and their comparison in a class."""

import base64
import json
import re
import threading

import numpy as np
import pytest

import scenes
from classroom import drive, pool
from evaluation import Planned
from support.runs import read_table
from support.test_cli import refusal

SEEN = {"image": np.arange(48 * 64 * 3, dtype=np.uint8).reshape(1, 48, 64, 3),
        "target": np.array([[2.5, -np.pi / 6]]), "velocity": np.zeros((1, 2)),
        "last_reward": np.array([[-0.05]])}


@pytest.fixture
def you(monkeypatch):
    """A driver at the start of an episode, with a short control period."""
    monkeypatch.setattr(drive, "CONTROL_PERIOD", 0.05)
    driver = drive.You(has_map=False)
    driver.reset(None, [0])
    return driver


def page(you, *requests):
    """Sends requests from another thread, as a page does."""
    def send():
        for request in requests:
            you.ask(request)
    threading.Thread(target=send, daemon=True).start()


@pytest.mark.parametrize("keys, action", [
    ([], (0, 0)), (["ArrowUp"], (1, 0)), (["ArrowUp", "ArrowLeft"], (1, 1)),
    (["ArrowRight", "x"], (0, -1)), (["ArrowLeft", "ArrowRight"], (0, 0))])
def test_held_keys_become_an_action(you, keys, action):
    page(you, {"keys": keys}, {"run": True})
    assert np.array_equal(you.act(None, SEEN), [action])
    assert np.array_equal(you.act(None, SEEN), [action])


def test_a_short_press_counts_for_one_control_period(you):
    you.message = ""
    page(you, {"keys": ["ArrowUp"]}, {"keys": []})
    assert np.array_equal(you.act(None, SEEN), [(1, 0)])
    assert np.array_equal(you.act(None, SEEN), [(0, 0)])


def test_the_page_shows_the_observation_and_nothing_else(you):
    page(you, {"run": True})
    you.act(None, SEEN)
    state = json.loads(next(you.follow()).partition("data: ")[2])
    assert (state["distance"], state["bearing"]) == (2.5, pytest.approx(-np.pi / 6))
    assert base64.b64decode(state["image"]) == SEEN["image"].tobytes()
    assert not {"pose", "goal"} & state.keys()


def test_all_drivers_have_the_same_tasks_even_in_a_room_that_draws_numbers_at_each_step():
    drives = [list(drive.same_tasks(Planned(planner, 0), scenes.load("lab"), 3, seed=7))
              for planner in ("bug", "straight")]
    assert len({len(trace.rewards) for traces in drives for trace in traces}) > 1
    for one, other in zip(*drives):
        assert np.array_equal(one.start, other.start) and np.array_equal(one.goal, other.goal)
    assert len({trace.start.tobytes() for trace in drives[0]}) == 3


class Straight(drive.You):
    """Turns to the target and drives, using only what the page shows."""

    def show(self, env, observations):
        self.bearing = observations["target"][0, 1]

    def listen(self, seconds):
        self.message = ""
        side = "ArrowLeft" if self.bearing > 0 else "ArrowRight"
        return {"ArrowUp", side} if abs(self.bearing) > 0.1 else {"ArrowUp"}


def test_a_drive_is_saved_and_compared_and_first_tries_are_pooled(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(drive, "You", Straight)
    monkeypatch.setattr(drive, "CONTROL_PERIOD", 1e-4)
    arguments = ["--no-browser", "--port", "0", "--episodes", "3", "--seed", "4", "--name", "Zoë"]
    drive.main(arguments)
    printed = capsys.readouterr().out
    drive.main(arguments)  # appends to the first
    rows = read_table("drives/drives.csv")
    assert [row["episode"] for row in rows] == list("012012")
    arrived = {"Zoë": [row["outcome"] == "arrival" for row in rows]}
    for planner in drive.OTHERS:
        traces = drive.same_tasks(Planned(planner, 0), scenes.load("env1"), 3, seed=4)
        arrived[planner] = [trace.arrived for trace in traces]
    for name, outcomes in arrived.items():
        assert re.search(rf"^{name} +{np.mean(outcomes):.0%}", printed, re.MULTILINE)
    assert (tmp_path / "drives" / "paths.png").stat().st_size > 10_000
    tries = [(0, "collision", 0), (1, "arrival", 0.5), (2, "arrival", 1), (0, "arrival", 0.5)]
    save(tmp_path / "drives/b.csv", *[row(r"#$\foo$", "env1", 4, *each) for each in tries])
    capsys.readouterr()
    pool.main([])
    pooled = capsys.readouterr().out.splitlines()
    assert set(printed.splitlines()[1:3]) < set(pooled) and (tmp_path / "drives.png").exists()
    assert [r"#$\foo$", "67%", "[", "21%,", "94%]", "0.50", "8.0"] in map(str.split, pooled)


def row(name="anna", env="env1", seed=0, episode=0, outcome="arrival", spl=0.5):
    return f"{name},{env},{seed},{episode},{outcome},8.0,2.4,1.2,{spl}\n"


def save(path, *rows):
    header = "name,env,seed,episode,outcome,seconds,metres,shortest,spl\n"
    path.write_text(header + "".join(rows), encoding="utf-8-sig")


@pytest.mark.parametrize("files, words", [
    ([], "contains drives of no task: all must"),
    ([[row()], [row("ben"), row("ben", episode="x")]], "1.csv', line 3, is not a drive"),
    ([[row()[:-5]]], "0.csv', line 2"),
    ([[row()], [row("ben", seed=1)]], "1 tasks in env1 with seed 0 and 1 tasks in env1 with seed"),
    ([[row(), row(episode=1), row("ben")]], "of 1 tasks in env1 with seed 0 and 2 tasks"),
    ([[row()], [row()]], "'anna' is in two files")])
def test_an_error_names_drives_that_cannot_be_pooled(tmp_path, capsys, files, words):
    for k, rows in enumerate(files):
        save(tmp_path / f"{k}.csv", *rows)
    assert words in refusal(pool.main, [str(tmp_path)], capsys)


@pytest.mark.parametrize("fails, words", [
    ("drive_yourself", "not saved"), ("policy_for", "is saved")])
def test_ctrl_c_says_whether_the_drive_is_saved(fails, words, tmp_path, monkeypatch, capsys):
    def interrupted(*_):
        raise KeyboardInterrupt
    monkeypatch.setattr(drive, "You", Straight)
    monkeypatch.setattr(drive, "CONTROL_PERIOD", 1e-4)
    monkeypatch.setattr(drive, fails, interrupted)
    with pytest.raises(SystemExit) as end:
        drive.main(["--no-browser", "--port", "0", "--episodes", "1", "--out", str(tmp_path)])
    printed = capsys.readouterr().err
    assert end.value.code == 130 and words in printed and "Traceback" not in printed
    assert (tmp_path / "drives.csv").exists() is (fails == "policy_for")
