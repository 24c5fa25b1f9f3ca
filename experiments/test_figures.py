"""Tests of the figures and the diagrams."""

import numpy as np
import pandas as pd

import scenes
from experiments import diagrams, figures
from experiments.tables import LAB, ROOMS_LEARNT, read
from support.pictures import PALETTE


def test_memorizing_and_reasoning_shows_every_seed_of_both_ways_and_the_frozen_policies():
    curves = pd.DataFrame([{"env": env, "way": way, "seed": seed, "kind": kind, "steps": 1000 * k,
                            "success": 10 * k}
                           for env in figures.ENVS for way in figures.WAYS for seed in range(5)
                           for kind in ("training", "new") for k in range(seed + 2)])
    seeds = curves[["env", "way", "seed"]].drop_duplicates().assign(steps=5000, new_success=70)
    for axes in figures.draw_memorizing_reasoning(curves, seeds).axes:
        places = set()
        for way in figures.WAYS:
            lines = [line for line in axes.lines if line.get_color() == PALETTE[way]]
            assert [len(line.get_xdata()) for line in lines] == [2, 3, 4, 5, 6, 5]
            assert lines[4].get_xydata()[-1].tolist() == [5, 50]
            assert set(lines[5].get_ydata()) == {70}
            places |= set(lines[5].get_xdata())
        # The frozen policies are right of the curves and next to each other, so none is hidden.
        assert len(places) == 2 and 5 < min(places) and max(places) < axes.get_xlim()[1]


def test_a_patch_of_the_floor_weights_episodes_not_seeds_equally():
    scene = scenes.load("env1")
    x, y = scene.bounds[0] + 0.25 * np.array((6, 4))
    floor = pd.DataFrame([{"env": "env1", "way": way, "x": x, "y": y, "n": n, "success": success}
                          for way in figures.WAYS for n, success in ((4, 100), (12, 0))])
    for panel in figures.draw_floors(floor, [scene]).axes[:2]:
        assert panel.collections[-1].get_array().compressed().tolist() == [25]


def test_success_against_the_number_of_training_rooms_is_the_mean_of_the_seeds():
    level3 = pd.DataFrame([{"way": way, "seed": seed, "training_success": 99 - k - seed,
                            "validation_success": k + seed}
                           for k, way in enumerate(["any-room", *ROOMS_LEARNT]) for seed in (1, 3)])
    rooms = pd.DataFrame([row | {"targets": targets, "success": row["validation_success"] + more}
                          for row in level3.to_dict("records")
                          for targets, more in (("anywhere", 10), ("anywhere", 30), ("new", 0))])
    axes, = figures.draw_rooms_learnt(level3, rooms).axes
    means = [line.get_ydata() for line in axes.lines[1::2]]
    k = np.arange(1, 7)
    assert np.allclose(means, [97 - k, k + 22, k + 2])


def test_fig_4_and_5_show_median_and_range_of_the_seeds_as_long_as_all_of_them_train():
    curves = pd.DataFrame([{"env": "env1", "way": way, "seed": seed, "kind": kind,
                            "episodes": 100 + 50 * k, "success": value + k, "return": value - k}
                           for way in figures.WAYS for kind in ("training", "new")
                           for seed, value in enumerate((10, 70, 20)) for k in range(seed + 2)])
    for axes, sign in zip(figures.draw_learning(curves, "env1").axes, (1, 1, -1, -1)):
        _, *medians = axes.lines  # after the paper's curve
        for line, band in zip(medians, axes.collections, strict=True):
            assert line.get_xydata().tolist() == [[100, 20], [150, 20 + sign]]
            corners = set(map(tuple, band.get_paths()[0].vertices))
            assert corners == {(100, 10), (150, 10 + sign), (150, 70 + sign), (100, 70)}


def test_each_training_has_a_row_in_the_lab_with_a_dot_for_each_seed_and_their_mean():
    lab = read("lab.csv")
    success, *_ = figures.draw_lab(lab).axes
    names = [name.get_text().replace("\n", " ") for name in success.get_yticklabels()]
    row = max(k for k, name in enumerate(names) if name == LAB["from-scratch"])
    expected = lab.query("way == 'from-scratch' and allowed == 3000").new_success
    [mean], dots = [line.get_xdata() for line in success.lines if set(line.get_ydata()) == {row}]
    assert mean == expected.mean() and sorted(dots) == sorted(expected)
    assert len(names) == len(lab.groupby(["way", "allowed"]))


def test_the_benchmark_is_drawn_in_microseconds_at_every_measured_count():
    rates = {"1": 1000.0, "32": 10000.0, "256": 20000.0}
    measured = dict.fromkeys(["env_sps", "camera_fps", "world_sps", "camera_fps_boxes"], rates)
    left, right = figures.draw_benchmark(measured).axes
    assert len(left.lines) == 3 and len(right.lines) == 1
    for line in (*left.lines, *right.lines):
        assert line.get_xydata().tolist() == [[1, 1000], [32, 100], [256, 50]]


def test_a_picture_is_written_to_the_folder_that_the_pages_link(tmp_path, monkeypatch):
    monkeypatch.setattr(figures, "ROOT", tmp_path)
    (tmp_path / "pictures").mkdir()
    figures.main(["--only", "benchmark.png"])
    assert [path.name for path in (tmp_path / "pictures").iterdir()] == ["benchmark.png"]


def test_the_network_is_drawn_with_the_sizes_in_the_paper():
    page, = diagrams.draw_network(np.zeros((48, 64, 3))).axes
    words = {text.get_text() for text in page.texts}
    assert {"conv 8x6\nstride 4", "16x12\n32 maps", "conv 4x3\nstride 2", "8x6\n64 maps",
            "max-pool\n2x2", "4x3\n64 maps", "conv 2x2\nstride 2", "2x2\n64 maps", "256\nvalues",
            "32\nvalues", "34", "256", "259", "LSTM\n256", "dense\n256"} <= words


def test_the_texts_of_a_diagram_are_inside_and_do_not_overlap():
    for name, draw in diagrams.DIAGRAMS.items():
        figure = draw()
        figure.draw_without_rendering()
        texts = [text for part in (figure, *figure.axes) for text in part.texts if text.get_text()]
        boxes = [text.get_window_extent() for text in texts]
        for k, box in enumerate(boxes):
            assert figure.bbox.padded(1).count_contains(box.get_points()) == 2, (name, texts[k])
            assert not box.count_overlaps(boxes[:k]), (name, texts[k])
