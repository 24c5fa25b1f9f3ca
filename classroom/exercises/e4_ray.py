"""Exercise 4: the distance at which a ray meets a wall.

A camera with 64 columns casts 64 such rays. The nearer the wall, the taller it appears. The project
does this for all robots, columns and walls at once: `render.py`.
"""

import math

import pytest


def ray_length(origin, angle, p, q):
    """Returns the distance [m] from the origin (x, y), in the direction angle [rad], to the wall
    from p (x, y) to q (x, y). Returns math.inf if the ray misses the wall or is parallel to it.

    A point of the ray is origin + t (cos angle, sin angle) with t >= 0. A point of the wall is
    p + u (q - p) with u from 0 to 1. Setting both equal gives two equations in t and u.
    """
    raise NotImplementedError("your turn")


# --------------------------------------------------- python -m pytest classroom/exercises/e4_ray.py


def test_a_wall_across_the_ray():
    assert ray_length((0, 0), 0.0, (2, -1), (2, 1)) == pytest.approx(2)
    assert ray_length((1, 1), math.pi / 2, (0, 4), (3, 4)) == pytest.approx(3)


def test_a_ray_at_an_angle_is_longer():
    assert ray_length((0, 0), math.pi / 4, (2, -5), (2, 5)) == pytest.approx(2 * math.sqrt(2))


def test_a_wall_behind_the_ray_or_next_to_it_is_not_met():
    assert ray_length((0, 0), math.pi, (2, -1), (2, 1)) == math.inf
    assert ray_length((0, 0), 0.0, (2, 1), (2, 3)) == math.inf
    assert ray_length((0, 0), 0.0, (2, 3), (2, 1)) == math.inf


def test_a_wall_along_the_ray_is_not_met():
    assert ray_length((0, 0), 0.0, (1, 1), (3, 1)) == math.inf


def test_in_the_middle_of_a_round_room_all_rays_have_the_same_length():
    corners = [(math.cos(k * math.pi / 180), math.sin(k * math.pi / 180)) for k in range(361)]
    for degrees in range(0, 360, 7):
        lengths = [ray_length((0, 0), math.radians(degrees + 0.5), p, q)
                   for p, q in zip(corners, corners[1:])]
        assert min(lengths) == pytest.approx(math.cos(math.pi / 360))
