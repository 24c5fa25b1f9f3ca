"""Each test is the shortest proof of one claim about driving oneself."""

import os
import re
import shutil
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pytest

import scenes
from classroom import drive, pool
from evaluation import Planned
from navbot_min import NavVecEnv
from support.pictures import read_table

ROOT = Path(__file__).parent.parent
HAS_SCREEN = all(map(shutil.which, ("Xvfb", "xdotool")))
ENV1 = scenes.load("env1")


class Keys:
    """A cockpit at which these keys are held, and what it showed."""

    pressed = {"up"}

    def __init__(self, *keys):
        self.keys = set(keys)
        self.shown = []

    def show(self, image, text, goal, pose):
        self.shown.append(text)

    def wait_for_release(self):
        pass

    def wait(self, is_over):
        return self.keys

    def close(self):
        pass


@pytest.mark.parametrize("keys, action", [
    ((), (0, 0)), (("up",), (1, 0)), (("up", "left"), (1, 1)), (("right", "x"), (0, -1)),
    (("left", "right"), (0, 0))])
def test_held_keys_become_an_action(keys, action):
    env = NavVecEnv(1, [ENV1])
    seen, _ = env.reset(seed=0)
    you = drive.You(Keys(*keys))
    you.reset(env, [0])
    assert np.array_equal(you.act(env, seen), [action])


def test_it_is_told_what_the_policy_is_told():
    env = NavVecEnv(1, [ENV1])
    env.reset(seed=0)
    cockpit = Keys("up")
    you = drive.You(cockpit)
    you.reset(env, [0])
    seen = {"image": np.zeros((1, 48, 64, 3)), "target": np.array([[2.5, -np.pi / 6]]),
            "last_reward": np.array([[-0.05]])}
    you.act(env, seen)
    you.act(env, seen)
    assert "target 2.50 m, 30 deg to the right" in cockpit.shown[0]
    assert "press an arrow key" in cockpit.shown[0]
    assert "last reward -0.1, 80 s left" in cockpit.shown[1]


def test_all_drivers_have_the_same_tasks():
    ways = [drive.same_tasks(driver, ENV1, 4, seed=7)
            for driver in (Planned("oracle", 0), Planned("straight", 0))]
    for one, other in zip(*ways):
        assert np.array_equal(one.start, other.start) and np.array_equal(one.goal, other.goal)
    assert len({trace.start.tobytes() for trace in ways[0]}) == 4


def test_all_drivers_have_the_same_tasks_where_reality_draws_numbers_all_along():
    lab = scenes.load("lab")
    ways = [drive.same_tasks(Planned(planner, 0), lab, 3, seed=7)
            for planner in ("bug", "straight")]
    assert len({len(trace.rewards) for way in ways for trace in way}) > 1
    for one, other in zip(*ways):
        assert np.array_equal(one.start, other.start) and np.array_equal(one.goal, other.goal)


def test_a_whole_drive_is_compared_on_its_tasks_with_the_others_and_kept(tmp_path, monkeypatch,
                                                                         capsys):
    class Straight(Keys):
        """Someone who turns to the target and goes, by what is shown."""

        def wait(self, is_over):
            bearing = re.search(r"(\d+) deg to the (left|right)", self.shown[-1])
            return {"up", bearing[2]} if int(bearing[1]) > 5 else {"up"}
    cockpit = Straight()
    monkeypatch.setattr(drive, "Cockpit", lambda scene, with_map: cockpit)
    monkeypatch.setattr(drive, "CONTROL_PERIOD", 0)
    drive.main(["--episodes", "3", "--seed", "4", "--name", "anna", "--out", str(tmp_path)])
    said = capsys.readouterr().out
    rows = read_table(tmp_path / "drives.csv")
    assert [row["episode"] for row in rows] == ["0", "1", "2"]
    for row in rows:
        assert (float(row["shortest"]) > 0.2) and (float(row["spl"]) > 0) == (
            row["outcome"] == "arrival")
    begun = [text for text in cockpit.shown if "press an arrow" in text]
    assert len(begun) == 3 and begun[1].startswith(f"episode 1: {rows[0]['outcome']}, reward ")
    for planner in drive.OTHERS:  # on the same tasks: those of seed 4
        arrived = [t.arrived for t in drive.same_tasks(Planned(planner, 0), ENV1, 3, 4)]
        assert re.search(rf"^{planner} +{np.mean(arrived):.0%}", said, re.MULTILINE)
    arrived = np.mean([row["outcome"] == "arrival" for row in rows])
    assert re.search(rf"^anna +{arrived:.0%}", said, re.MULTILINE)
    (tmp_path / "paths.png").unlink()
    (tmp_path / "paths.png").mkdir()
    with pytest.raises(SystemExit) as end:
        drive.main(["--out", str(tmp_path)])
    assert end.value.code == 2 and "is a folder" in capsys.readouterr().err


def test_drives_of_a_class_are_pooled_by_name(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    for file, name, planner, seed in (("class/a", "anna", "oracle", 0),
                                      ("class/b", "ben", "straight", 0),
                                      ("seeds/a", "anna", "oracle", 0),
                                      ("seeds/c", "cem", "bug", 1),
                                      ("twice/a", "anna", "bug", 0), ("twice/b", "anna", "bug", 0)):
        options = drive.Options(name=name, seed=seed)
        traces = drive.same_tasks(Planned(planner, 0), ENV1, 3, seed)
        path = Path(f"{file}.csv")
        path.parent.mkdir(exist_ok=True)
        drive.add_rows(path, options, traces)
    rows = read_table("class/a.csv") + read_table("class/b.csv")
    assert len(rows) == 6
    drivers = pool.by_driver(rows)
    assert list(drivers) == ["ben", "anna"]
    assert drivers["anna"] == pytest.approx((100, 1), abs=0.02)
    figure = pool.draw(drivers, (50.0, 0.4), "a title")
    assert [bar.get_width() for bar in figure.axes[0].patches] == [drivers["ben"][0], 100]
    fewer = Path("class/a.csv").read_text().splitlines(keepends=True)
    broken = "".join(fewer).replace("env1,0,2,", "env1,0,x,")
    for file, text in (("other/notes", "a,b\n1,2\n"), ("broken/a", broken),
                       ("lost/a", "".join(fewer).replace("arrival", "ARRIVED")),
                       ("half/a", "".join(fewer)[:-12]),
                       ("fewer/a", "".join(fewer[:-1])),
                       ("fewer/b", Path("class/b.csv").read_text())):
        Path(file).parent.mkdir(exist_ok=True)
        Path(f"{file}.csv").write_text(text)
    for folder, words in (("seeds", "only drives of the same tasks"),
                          ("fewer", "'anna' drove 2 tasks, and others 3"),
                          ("broken", "line 4: episode is 'x'"),
                          ("lost", "line 2: outcome is 'ARRIVED'"),
                          ("half", "line 4, must have 9 values"),
                          ("twice", "'anna' drives in two files"),
                          ("other", "is no table of drives"), ("none", "there is no CSV file")):
        with pytest.raises(SystemExit) as end:
            pool.main([folder])
        assert end.value.code == 2 and words in capsys.readouterr().err
    pool.main(["class"])
    assert Path("drives.png").exists()


def test_a_task_that_is_driven_again_counts_as_it_was_first_driven():
    rows = [{"name": name, "episode": episode, "outcome": outcome}
            for name, episode, outcome in (("anna", "0", "collision"), ("anna", "1", "arrival"),
                                           ("ben", "0", "timeout"), ("anna", "0", "arrival"))]
    assert pool.first_tries(rows) == rows[:3]


def test_a_second_drive_is_added_to_the_file_of_the_first(tmp_path):
    file = tmp_path / "drives.csv"
    traces = drive.same_tasks(Planned("straight", 0), ENV1, 1, 0)
    drive.add_rows(file, drive.Options(name="anna"), traces)
    drive.add_rows(file, drive.Options(name="ben"), traces)
    assert [row["name"] for row in read_table(file)] == ["anna", "ben"]


def test_drives_in_a_room_of_ones_own_are_pooled_by_what_was_driven(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    shutil.copy(ROOT / "scenes" / "env1.toml", "my_room.toml")
    scene = scenes.load("my_room.toml")
    Path("drives").mkdir()
    drive.add_rows(Path("drives/drives.csv"), drive.Options(env="my_room.toml", name=r"#$\foo$"),
                   drive.same_tasks(Planned("straight", 0), scene, 1, 0))
    pool.main([])
    assert Path("drives.png").exists()


def test_a_python_without_tkinter_is_told_how_to_get_it(monkeypatch):
    monkeypatch.setitem(sys.modules, "tkinter", None)
    assert "python3-tk" in drive.why_no_window()


def test_without_a_display_it_says_what_to_do():
    pytest.importorskip("tkinter")
    environment = {key: value for key, value in os.environ.items()
                   if key not in ("DISPLAY", "WAYLAND_DISPLAY", "MPLBACKEND")}
    ended = subprocess.run([sys.executable, "-m", "classroom.drive"], cwd=ROOT, text=True,
                           env=environment, capture_output=True)
    assert ended.returncode == 2
    assert ended.stderr.startswith("error: no window can be opened here")
    assert "sit before the machine" in ended.stderr and ended.stderr.count("\n") == 1


@pytest.mark.skipif(not HAS_SCREEN, reason="there is no Xvfb or no xdotool")
def test_on_a_screen_the_arrow_keys_drive(tmp_path):
    pytest.importorskip("tkinter")
    read, write = os.pipe()
    screen = subprocess.Popen(["Xvfb", "-displayfd", str(write), "-screen", "0", "1280x800x24"],
                              pass_fds=[write], stderr=subprocess.DEVNULL)
    environment = os.environ | {"DISPLAY": ":" + os.read(read, 9).decode().strip()}
    program = subprocess.Popen([sys.executable, "-m", "classroom.drive", "--episodes", "1",
                                "--map", "--name", "anna", "--out", str(tmp_path)], cwd=ROOT,
                               env=environment, stdout=subprocess.PIPE, text=True)
    try:
        def key(*words):
            return subprocess.run(["xdotool", *words], env=environment, check=False).returncode
        deadline = time.monotonic() + 120
        while key("search", "--onlyvisible", "--name", "navbot_min", "windowfocus"):
            assert time.monotonic() < deadline and program.poll() is None
            time.sleep(0.2)
        time.sleep(2)
        key("keydown", "Up")  # held: it drives until it touches something
        said, _ = program.communicate(timeout=240)
    finally:
        program.kill()
        screen.kill()
    [row] = read_table(tmp_path / "drives.csv")
    assert row["name"] == "anna" and row["outcome"] in ("collision", "arrival")
    # As fast as it can, but for the first and the last period.
    assert float(row["metres"]) == pytest.approx(0.3 * float(row["seconds"]), abs=0.25)
    assert (tmp_path / "paths.png").exists() and "learner (env1.pt)" in said
