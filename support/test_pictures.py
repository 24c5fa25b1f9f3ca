"""Tests of the pictures and the film."""

import numpy as np
import pytest
from matplotlib.colors import to_rgb
from matplotlib.figure import Figure

import scenes
from render import H, W
from support import film, pictures
from support.pictures import PALETTE
from support.traces import Trace

ENV1 = scenes.load("env1")


def trace(goal, places):
    """Returns an episode through the places (T + 1, 2), heading along x, that arrives."""
    poses = np.column_stack([places, np.zeros(len(places))])
    T = len(poses) - 1
    images = np.random.default_rng(0).integers(0, 256, (T + 1, H, W, 3), dtype=np.uint8)
    return Trace(ENV1, target=0, new=False, goal=np.array(goal), poses=poses, images=images,
                 commands=np.tile((0.3, 0.0), (T, 1)), rewards=np.zeros(T), outcome="arrival")


def test_curves_are_means_over_full_windows_and_a_panel_without_one_has_a_note():
    rng = np.random.default_rng(0)
    rows = [{"kind": kind, "outcome": str(rng.choice(["arrival", "timeout"])),
             "return": str(rng.normal())} for kind in ["training"] * 450 + ["new"] * 99]
    axes = pictures.draw_curves(rows, "env1", 0.6).axes  # success, training and new; rewards
    arrived = [row["outcome"] == "arrival" for row in rows]
    returns = [float(row["return"]) for row in rows]
    for panel, values, window in ((axes[0], arrived, 100), (axes[2], returns, 200)):
        _, run = panel.lines  # the paper's, and this run
        assert run.get_xdata().tolist() == [200, 400, 450]
        means = [np.mean(values[end - window:end]) for end in (200, 400, 450)]
        assert np.allclose(run.get_ydata(), np.multiply(means, 100 if panel is axes[0] else 1))
    assert [[text.get_text() for text in panel.texts] for panel in axes] == [
        [], ["this run: fewer than 100 episodes"]] * 2


def test_each_target_has_a_panel_with_evenly_chosen_paths_and_random_targets_share_one():
    goals = [ENV1.targets[0], (-1.0, -3.0), (-2.0, -3.0), *[ENV1.targets[2]] * 100]
    traces = [trace(goal, np.full((k + 3, 2), min(k, 3))) for k, goal in enumerate(goals)]
    first, third, anywhere = pictures.draw_trajectories(ENV1, traces, most=20).axes
    lengths = [[len(line.get_xdata()) for line in axes.lines if len(line.get_xdata()) > 2]
               for axes in (first, third, anywhere)]
    assert lengths[0] == [3] and lengths[2] == [4, 5] and len(lengths[1]) == 20
    assert lengths[1][0] == 6 and lengths[1][-1] == 105 and max(np.diff(lengths[1])) < 8


def test_a_patch_of_the_floor_shows_its_mean_success_if_it_has_five_episodes():
    counts = {(4, 3): 8, (5, 3): 4, (6, 6): 5}  # patches, from the corner, and their episodes
    goals = np.concatenate([np.tile(ENV1.bounds[0] + 0.25 * np.array(patch), (n, 1))
                            for patch, n in counts.items()])
    success = [k % 4 == 0 for k in range(len(goals))]
    percent = pictures.paint_floor(Figure().subplots(), ENV1, goals, success, 0.25).get_array()
    shown = {(x, y): percent[y, x] for y, x in np.argwhere(~np.ma.getmaskarray(percent))}
    assert shown == {(4, 3): 25.0, (6, 6): 40.0}


def on_map(place):
    """Returns the pixel (y, x) of a frame at a place (2,) [m] of env1."""
    left, bottom, width, height = film.MAP
    low, high = ENV1.bounds
    scale = min((width, height) / (high - low))  # [px/m]
    y = film.SIZE[1] - bottom - height / 2 - (place[1] - (low + high)[1] / 2) * scale
    return round(y), round(left + (place[0] - low[0]) * scale)


@pytest.mark.parametrize("goal", (ENV1.targets[0], ENV1.targets[2], (-2.0, -2.0)))
def test_a_frame_shows_robot_trail_image_and_only_the_target_of_the_episode(goal):
    driven = trace(goal, [(-1.0, -3.0), (-2.0, -3.0), (-3.5, -3.0)])
    view = film.EpisodeView(ENV1, goal)
    steps = list(zip(driven.poses, driven.images))
    frames = [view.frame(pose, image, (0.3, -1.0), 10) for pose, image in steps]
    between = [frame[on_map((-1.5, -3.0))].min() == 255 for frame in frames]
    assert between == [True, False, False]  # the trail grows, and earlier frames stay as is
    for (pose, image), frame in zip(steps, frames):
        assert frame.dtype == np.uint8 and frame.shape == (312, 760, 3)  # even, for video encoders
        dark = np.argwhere((frame == np.array(to_rgb(PALETTE["robot"])) * 255).all(-1))
        robot = dark[np.hypot(*(dark - on_map(pose)).T) < 20]
        assert len(robot) > 400 and np.hypot(*(robot.mean(0) - on_map(pose))) < 2
        x, y = film.CAMERA_CORNER
        camera = frame[y:y + film.ZOOM * H, x:x + film.ZOOM * W]
        assert (camera == image.repeat(film.ZOOM, 0).repeat(film.ZOOM, 1)).all()
    for target in (*ENV1.targets, goal):
        blue = (frame[on_map(target)] == (20, 20, 235)).all()
        assert blue == np.array_equal(target, goal)


def test_without_a_display_a_window_raises_an_error():
    import matplotlib.pyplot as plt
    plt.switch_backend("agg")
    with pytest.raises(RuntimeError, match="no window .* must be rgb_array"):
        film.Window()
