"""Proofs of the figures of the results and of the drawings that explain."""

import numpy as np
import pytest

import render
import scenes
from experiments import diagrams, figures
from model import Network
from ppo import pack_rows
from render import Camera
from sim import CAMERA_HEIGHT
from support.pictures import PALETTE

ENV1 = scenes.load("env1")


# ------------------------------------------------------------------------------------ the figures


def test_memorizing_and_reasoning_shows_every_seed_of_both_ways_and_the_frozen_policies():
    curves = [{"env": env, "way": way, "seed": seed, "kind": kind, "steps": str(1000 * k),
               "episodes": str(50 * k), "success": str(k / 10)}
              for env in figures.ENVS for way in figures.WAYS for seed in figures.SEEDS
              for kind in ("training", "new") for k in range(int(seed) + 2)]
    seeds = [{"env": env, "way": way, "steps": "5000", "new_success": "0.7"}
             for env in figures.ENVS for way in figures.WAYS for seed in figures.SEEDS]
    for axes in figures.draw_memorizing_reasoning(curves, seeds).axes:
        beside = set()
        for way in figures.WAYS:
            lines = [line for line in axes.lines if line.get_color() == PALETTE[way]]
            assert [len(line.get_xdata()) for line in lines] == [2, 3, 4, 5, 6, 5]
            assert lines[4].get_ydata()[-1] == 50 and lines[4].get_xdata()[-1] == 5
            assert set(lines[5].get_ydata()) == {70.0}
            beside |= set(lines[5].get_xdata())
        # The frozen stand beside the curves, one way's beside the other's: nothing hides them.
        assert len(beside) == 2 and 5 < min(beside) and max(beside) < axes.get_xlim()[1]


def test_a_patch_of_the_floors_weighs_every_episode_alike_not_every_seed():
    x, y = ENV1.bounds[0] + 0.25 * np.array((6, 4))
    rows = [{"env": "env1", "way": way, "x": str(x), "y": str(y), "n": n, "success": success}
            for way in figures.WAYS for n, success in (("4", "1.0"), ("12", "0.0"))]
    axes = figures.draw_floors(rows, [ENV1], 0.25).axes
    for panel in axes[:2]:
        shown = panel.collections[1].get_array().compressed()
        assert shown.tolist() == [25.0]


def test_the_benchmark_is_drawn_as_microseconds_at_every_count_that_was_measured():
    rates = {"1": 1000.0, "32": 10000.0, "256": 20000.0}
    boxes = {"4": 50000.0, "8": 40000.0, "16": 20000.0, "24": 12500.0, "40": 10000.0}
    measured = dict.fromkeys(figures.STAGES, rates) | {"camera_fps_boxes": boxes}
    left, right = figures.draw_benchmark(measured).axes
    for line in left.lines:
        assert list(line.get_xdata()) == [1, 32, 256]
        assert np.allclose(line.get_ydata(), [1000, 100, 50])
    assert list(right.lines[0].get_xdata()) == [4, 8, 16, 24, 40]
    assert np.allclose(right.lines[0].get_ydata(), [20, 25, 50, 80, 100])


# ----------------------------------------------------------------------------------- the drawings


def test_the_network_is_drawn_with_the_sizes_of_the_paper():
    layers = diagrams.layer_shapes(Network())
    assert [out for _, _, out in layers] == [
        (32, 12, 16), (64, 6, 8), (64, 3, 4), (64, 2, 2), (256,), (32,),  # Fig. 2, height first
        (256,), (256,), (256,), (2,), (1,)]
    assert [size for _, size, _ in layers[6:]] == [(34,), (259,), (256,), (256,), (256,)]
    words = [diagrams.operation(module) for module, _, _ in layers[:6]]
    assert words == ["conv 8x6\nstride 4", "conv 4x3\nstride 2", "max-pool\n2x2",
                     "conv 2x2\nstride 2", "flatten", "dense"]


@pytest.mark.parametrize("pose", ((-2.0, -3.1, 2.6), (-0.4, -2.6, 4.2), (-2.0, -3.1, 0.4)))
def test_the_depths_that_are_drawn_put_the_walls_feet_where_the_camera_shows_them(pose):
    inverse, far_along, which = diagrams.nearest_faces(ENV1, pose)
    image = Camera([ENV1]).render(np.array([0]), np.array([pose]), np.array([(1000.0, 0.0)]))[0]
    foot = render.H / 2 + CAMERA_HEIGHT * inverse * render.FOCAL  # from the upper edge
    for column, row in enumerate(foot):
        floor = (image[:, column] == render.FLOOR).all(-1)
        below = np.arange(render.H) + 0.5 > row  # pixels whose middle is below the foot
        assert (floor[render.H // 2:] == below[render.H // 2:]).all()
    for face in set(which):  # the claim of the drawing
        chosen = [column for column in range(render.W) if which[column] == face]
        assert np.allclose(np.diff(inverse[chosen], 2), 0, atol=1e-6)
        assert np.allclose(np.diff(far_along[chosen], 2), 0, atol=1e-4)


def test_packed_episodes_are_drawn_once_each_a_clearing_step_apart():
    lengths = [10, 48, 23, 24, 7, 36]
    below = diagrams.draw_packing(lengths).axes[1]
    bars = [(bar.get_y(), bar.get_x(), bar.get_width()) for bar in below.patches
            if bar.get_facecolor()[:3] != (1, 1, 1)]
    bars.sort()
    episodes = bars[0::2]
    clearing = bars[1::2]
    assert sorted(width for _, _, width in episodes) == sorted(lengths)
    for (row, left, width), (same_row, after, one) in zip(episodes, clearing):
        assert (same_row, after, one) == (row, left + width, 1)
    for (row, left, _), (_, before, _) in zip(episodes[1:], clearing):
        assert left == 0 or left == before + 1
    assert len({row for row, _, _ in bars}) == len(pack_rows(lengths))


def test_every_drawing_is_drawn_without_a_letter_outside_or_over_another():
    for name, figure in diagrams.draw_all():
        figure.draw_without_rendering()
        inside = figure.bbox.padded(1)
        texts = [text for axes in figure.axes for text in axes.texts if text.get_text()]
        texts += [text for text in figure.texts if text.get_text()]
        boxes = [text.get_window_extent() for text in texts]
        for k, (text, box) in enumerate(zip(texts, boxes)):
            assert inside.contains(box.x0, box.y0) and inside.contains(box.x1, box.y1), (
                name, text.get_text())
            for other, place in zip(texts[:k], boxes):
                assert not box.overlaps(place), (name, text.get_text(), other.get_text())
