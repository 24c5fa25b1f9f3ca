"""Proofs of the pictures and the film."""

import sys
from dataclasses import replace
from itertools import combinations
from types import SimpleNamespace

import numpy as np
import pytest
from matplotlib.colors import to_rgb
from matplotlib.patches import Circle
from PIL import Image

import navbot_min
import scenes
from render import CUBE_SIZE, Camera, H, W
from sim import ROBOT_RADIUS
from support import film, pictures
from support.pictures import PALETTE
from support.traces import Trace

ENV1 = scenes.load("env1")
ENV2 = scenes.load("env2")


def trace(goal, places, outcome="arrival", images=False):
    """An episode in env1 through those places (T + 1, 2), heading along x."""
    poses = np.column_stack([places, np.zeros(len(places))])
    T = len(poses) - 1
    views = np.random.default_rng(0).integers(0, 256, (T + 1, H, W, 3), dtype=np.uint8)
    return Trace(scene=ENV1, target=0, new=False, goal=np.array(goal), poses=poses,
                 commands=np.tile((0.3, 0.0), (T, 1)), rewards=np.zeros(T), outcome=outcome,
                 images=views if images else None)


# ---------------------------------------------------------------------------------- the palette

# How each colour looks to who lacks one kind of cone, on linear RGB (Machado et al. 2009).
EYES = {"all cones": np.eye(3),
        "protanopia": [(0.152286, 1.052583, -0.204868), (0.114503, 0.786281, 0.099216),
                       (-0.003882, -0.048116, 1.051998)],
        "deuteranopia": [(0.367322, 0.860646, -0.227968), (0.280085, 0.672501, 0.047413),
                         (-0.011820, 0.042940, 0.968881)],
        "tritanopia": [(1.255528, -0.076749, -0.178779), (-0.078411, 0.930809, 0.147602),
                       (0.004733, 0.691367, 0.303900)]}
TOGETHER = [  # meanings that meet in one picture
    ("training", "new", "arrival", "collision", "timeout", "robot", "wall", "brick", "wood"),
    ("one-start", "varied", "paper"),
    ("run", "paper", "robot"),
    ("cube", "robot", "wall", "brick", "wood")]


def lab(colour, eye):
    """CIELAB of a colour as that eye sees it."""
    rgb = np.array(to_rgb(colour))
    linear = np.where(rgb <= 0.04045, rgb / 12.92, ((rgb + 0.055) / 1.055) ** 2.4)
    linear = np.clip(np.array(EYES[eye]) @ linear, 0, 1)
    to_xyz = np.array([(0.4124564, 0.3575761, 0.1804375), (0.2126729, 0.7151522, 0.0721750),
                       (0.0193339, 0.1191920, 0.9503041)])
    xyz = to_xyz @ linear / (0.95047, 1, 1.08883)
    f = np.where(xyz > 0.008856, np.cbrt(xyz), 7.787 * xyz + 16 / 116)
    return np.array((116 * f[1] - 16, 500 * (f[0] - f[1]), 200 * (f[1] - f[2])))


def test_no_colour_has_two_meanings():
    assert len({to_rgb(colour) for colour in PALETTE.values()}) == len(PALETTE)


@pytest.mark.parametrize("eye", EYES)
def test_colours_that_meet_in_a_picture_differ_for_every_eye(eye):
    for meanings in TOGETHER:
        for one, other in combinations(meanings, 2):
            distance = np.linalg.norm(lab(PALETTE[one], eye) - lab(PALETTE[other], eye))
            assert distance > 15, (one, other)  # 2.3 is just noticeable


# ----------------------------------------------------------------------------------- the curves


@pytest.mark.parametrize("n", (0, 99, 100, 101, 200, 301, 400))
@pytest.mark.parametrize("window", (100, 200))
def test_every_point_of_a_curve_is_a_mean_over_a_full_window(n, window):
    rng = np.random.default_rng(n)
    rows = [{"outcome": str(rng.choice(["arrival", "timeout"])), "return": str(rng.normal())}
            for _ in range(n)]
    ends, success, reward = pictures.curve(rows, window)
    full = [end for end in range(1, n + 1) if end >= window and (end % window == 0 or end == n)]
    assert ends == full
    for end, percent, mean in zip(ends, success, reward):
        last = [rows[k] for k in range(end - 100, end)]
        assert percent == pytest.approx(sum(row["outcome"] == "arrival" for row in last))
        whole = [float(rows[k]["return"]) for k in range(end - window, end)]
        assert len(whole) == window
        assert mean == pytest.approx(sum(whole) / window)


def test_the_curves_of_a_run_lie_over_those_of_the_paper():
    rows = [{"kind": kind, "outcome": "arrival", "return": 1.0}
            for kind in ("training", "new") for _ in range(450)]
    figure = pictures.draw_curves(rows, "env1", 0.6)
    paper, run = figure.axes[0].lines[:2]  # success, training targets
    assert (paper.get_color(), run.get_color()) == (PALETTE["paper"], PALETTE["run"])
    assert paper.get_xdata()[-1] == 5533 and paper.get_ydata()[-1] == 77  # the released record
    assert run.get_xdata().tolist() == [200, 400, 450]
    assert run.get_ydata().tolist() == [100, 100, 100]
    assert np.isnan(figure.axes[2].lines[0].get_ydata()[-1])  # the paper's mean over 133 episodes
    stop = [axes for axes in figure.axes if any("stops" in line.get_label() for line in axes.lines)]
    assert stop == [figure.axes[1]]  # the rule looks at new targets alone


@pytest.mark.parametrize("n", ((199, 99), (199, 100), (200, 99)))
def test_a_legend_names_this_run_only_where_one_is_drawn_and_a_panel_without_it_says_why(n):
    rows = [{"kind": kind, "outcome": "arrival", "return": 1.0}
            for kind, episodes in zip(("training", "new"), n) for _ in range(episodes)]
    figure = pictures.draw_curves(rows, "env1", 0.6)
    names = [text.get_text() for text in figure.legends[0].get_texts()]
    drawn = [[line for line in axes.lines if line.get_label() == "this run"]
             for axes in figure.axes]
    assert ("this run" in names) == any(drawn)
    assert [bool(lines) for lines in drawn] == [n[0] == 200, n[1] == 100] * 2
    assert [not axes.texts for axes in figure.axes] == [bool(lines) for lines in drawn]


# ------------------------------------------------------------------------------------ the paths


def drawn_lengths(axes):
    """Places of each path that is drawn."""
    return {len(line.get_xdata()) for line in axes.lines if len(line.get_xdata()) > 2}


def test_paths_are_drawn_evenly_not_those_that_ended_first():
    traces = [trace(ENV1.targets[2], np.tile((-1.0, -3.0), (k + 3, 1))) for k in range(100)]
    drawn = drawn_lengths(pictures.draw_trajectories(ENV1, traces, most=20).axes[0])
    assert max(drawn) == 102 and 15 < len(drawn) <= 20 and max(np.diff(sorted(drawn))) < 8


def test_a_panel_for_each_target_that_was_driven_to_and_one_for_all_goals_anywhere():
    goals = [ENV1.targets[2], ENV1.targets[0], (-1.0, -3.0), (-2.0, -3.0)]
    traces = [trace(goal, np.tile((-1.0, -3.0), (k + 3, 1))) for k, goal in enumerate(goals)]
    panels = pictures.draw_trajectories(ENV1, traces).axes
    assert [drawn_lengths(axes) for axes in panels] == [{4}, {3}, {5, 6}]
    assert "goals anywhere" in panels[2].get_title()


def test_the_robot_is_drawn_at_the_start_only_where_all_start_there():
    def robots(traces):
        axes = pictures.draw_trajectories(ENV1, traces).axes[0]
        return [circle.center for circle in axes.patches
                if isinstance(circle, Circle) and circle.radius == ROBOT_RADIUS]
    here, there = ([trace(ENV1.targets[0], [(x, -3.0), (-1.5, -3.5)])] for x in (-1.0, -1.1))
    assert robots(here * 2) == [(-1.0, -3.0)]
    assert robots(here + there) == []


# ------------------------------------------------------------------------------------ the floor


def test_a_patch_of_the_floor_shows_its_mean_success_and_is_grey_under_five_episodes():
    corner = ENV2.bounds[0]
    counts = {(4, 3): 8, (5, 3): 4, (6, 6): 5}  # patches, from the corner, and their episodes
    goals = np.concatenate([np.tile(corner + 0.25 * np.array(patch), (n, 1))
                            for patch, n in counts.items()])
    success = [k % 4 == 0 for k in range(len(goals))]
    axes = pictures.Figure().subplots()
    mesh, grey = pictures.paint_floor(axes, ENV2, goals, success, 0.25)
    shown = mesh.get_array()
    expected = np.full(shown.shape, np.nan)
    expected[3, 4] = 25.0  # rows are y
    expected[6, 6] = 40.0
    assert np.array_equal(np.ma.filled(shown, np.nan), expected, equal_nan=True)
    few = axes.collections[0].get_array()
    assert grey and np.argwhere(~np.ma.getmaskarray(few)).tolist() == [[3, 5]]


# ------------------------------------------------------------------------------------- the film


def dark(frame):
    """Pixels of the frame (y, x) in the robot's colour."""
    colour = np.array(to_rgb(PALETTE["robot"])) * 255
    return np.argwhere(np.abs(frame - colour).max(-1) < 3)


def on_map(place):
    """Pixel (y, x) of a frame at which a place (2,) [m] of env1 lies."""
    left, top, width, height = film.MAP
    low, high = ENV1.bounds
    scale = min((width, height) / (high - low))  # [px/m], the map stands at the left, in the middle
    middle = top + height / 2
    return np.array((middle - (place[1] - (low + high)[1] / 2) * scale,
                     left + (place[0] - low[0]) * scale))


def test_a_frame_has_an_even_size_the_robot_where_its_pose_says_and_the_camera_enlarged():
    view = film.EpisodeView(ENV1, ENV1.targets[0])
    image = np.random.default_rng(0).integers(0, 256, (H, W, 3), dtype=np.uint8)
    for place in ((-1.0, -3.0), (-3.5, -3.2)):
        frame = view.frame((*place, 0.5), image, (0.3, -1.0), 4.0)
        assert frame.dtype == np.uint8 and frame.flags.c_contiguous
        assert frame.shape[0] % 2 == 0 and frame.shape[1] % 2 == 0 and frame.shape[2] == 3
        y, x = on_map(place)
        robot = [pixel for pixel in dark(frame) if np.hypot(pixel[0] - y, pixel[1] - x) < 20]
        assert len(robot) > 400
        assert np.hypot(*(np.mean(robot, axis=0) - (y, x))) < 2
        column, row = film.CAMERA_CORNER
        for i, k in ((0, 0), (H - 1, W - 1), (17, 40)):
            pixels = frame[row + film.ZOOM * i:row + film.ZOOM * (i + 1),
                           column + film.ZOOM * k:column + film.ZOOM * (k + 1)]
            assert (pixels == image[i, k]).all()


def test_the_target_of_a_film_is_a_blue_cube_in_a_ring_and_no_other_is_shown():
    image = np.zeros((H, W, 3), np.uint8)
    for goal in (ENV1.targets[0], ENV1.targets[2], (-2.0, -3.0)):
        frame = film.EpisodeView(ENV1, goal).frame((-0.4, -2.6, 0), image, (0, 0), 0).astype(int)

        def colour_at(place):
            y, x = on_map(place).round().astype(int)
            return tuple(frame[y, x])
        assert colour_at(goal) == tuple(round(255 * part) for part in to_rgb(PALETTE["cube"]))
        ring = np.add(goal, (pictures.RING * CUBE_SIZE, 0))
        assert max(colour_at(ring)) < 120  # dark, whichever kind the target is
        for other in ENV1.targets:
            if tuple(other) != tuple(goal):
                assert colour_at(other) == (255, 255, 255)


@pytest.mark.parametrize("place, shown", ((ENV1.targets[0], True), ((1000.0, 0.0), False)))
def test_a_film_says_that_the_cube_is_blue_only_where_its_camera_shows_it(place, shown):
    poses = np.array([(-2.5, -3.8, np.pi), (-3.0, -3.8, np.pi)])
    images = Camera([ENV1]).render(np.zeros(2, int), poses, np.array([place, place]))
    assert film.show_cube(images) is shown
    assert ("blue" in film.caption("new", shown)) is shown
    driven = replace(trace(ENV1.targets[0], poses[:, :2]), images=images)
    y, x = on_map(ENV1.targets[0]).round().astype(int)
    blue = tuple(round(255 * part) for part in to_rgb(PALETTE["cube"]))
    for frame in film.frames_of(driven):
        assert tuple(frame[y, x]) == (blue if shown else (255, 255, 255))


def test_a_trail_grows_with_every_frame_and_frames_that_were_given_stay():
    image = np.zeros((H, W, 3), np.uint8)
    places = [(-1.0, -3.0), (-2.0, -3.0), (-3.0, -3.0)]

    def frames():
        view = film.EpisodeView(ENV1, ENV1.targets[0])
        return [view.frame((*place, 0), image, (0.3, 0), 0) for place in places]
    first, second, third = frames()
    y, x = on_map((-1.5, -3.0)).round().astype(int)
    assert [tuple(frame[y, x]) == (255, 255, 255) for frame in (first, second, third)] == [
        True, False, False]
    assert np.array_equal(frames()[0], first)  # an episode's view begins with no trail


def test_a_film_has_a_frame_for_each_pose_and_shows_as_many_a_second_as_the_environments(tmp_path):
    places = np.linspace((-0.4, -2.6), (-3.5, -3.0), 8)
    film.write_film(trace(ENV1.targets[0], places, images=True), tmp_path / "a.gif")
    with Image.open(tmp_path / "a.gif") as gif:
        assert gif.n_frames == 8 and gif.size == film.SIZE
        durations = []
        for k in range(gif.n_frames):
            gif.seek(k)
            durations.append(gif.info["duration"])
    assert durations == [1000 / navbot_min.RENDER_FPS] * 7 + [film.HOLD]


def test_a_window_shows_frames_and_stays_closed(monkeypatch):
    shown = []
    root = SimpleNamespace(title=lambda text: None, protocol=lambda name, call: None,
                           update=lambda: None, destroy=lambda: shown.append("destroyed"))
    label = SimpleNamespace(pack=lambda: None, configure=lambda image: shown.append(image))
    tkinter = SimpleNamespace(Tk=lambda: root, Label=lambda root: label,
                              PhotoImage=lambda data: data)
    monkeypatch.setitem(sys.modules, "tkinter", tkinter)
    window = film.Window()
    frame = np.arange(24, dtype=np.uint8).reshape(2, 4, 3)
    window.show(frame, fps=1000)
    window.close()
    window.show(frame, fps=1000)
    window.close()
    assert shown == [b"P6 4 2 255 " + bytes(range(24)), "destroyed"]


def test_where_no_window_can_be_opened_one_sentence_says_it(monkeypatch):
    monkeypatch.setitem(sys.modules, "tkinter", None)
    with pytest.raises(RuntimeError, match="no window can be opened here .*rgb_array"):
        film.Window()
