"""Exercise 4: how far a ray goes until it meets a wall.

A camera of 64 columns is 64 such questions, one for each column; how near a wall is says how high
it looks. The project does it for all robots, columns and walls at once in `render.py`.
"""

import math

import pytest


def ray_length(origin, angle, p, q):
    """How far [m] a ray goes from the origin (x, y) in the direction angle [rad] until it meets the
    wall from p (x, y) to q (x, y); math.inf where it does not, and where it runs along the wall.

    A point of the ray is origin + t (cos angle, sin angle), t >= 0, one of the wall p + u (q - p)
    with u from 0 to 1. Where both are the same point, there are two equations for t and u.
    """
    raise NotImplementedError("your turn")


# --------------------------------------------------- python -m pytest classroom/exercises/e4_ray.py


def test_a_wall_across_the_way():
    assert ray_length((0, 0), 0.0, (2, -1), (2, 1)) == pytest.approx(2)
    assert ray_length((1, 1), math.pi / 2, (0, 4), (3, 4)) == pytest.approx(3)


def test_a_wall_at_an_angle_is_met_later():
    assert ray_length((0, 0), math.pi / 4, (2, -5), (2, 5)) == pytest.approx(2 * math.sqrt(2))


def test_what_is_behind_or_beside_is_not_met():
    assert ray_length((0, 0), math.pi, (2, -1), (2, 1)) == math.inf
    assert ray_length((0, 0), 0.0, (2, 1), (2, 3)) == math.inf
    assert ray_length((0, 0), 0.0, (2, 3), (2, 1)) == math.inf


def test_a_wall_along_the_ray_is_not_met():
    assert ray_length((0, 0), 0.0, (1, 1), (3, 1)) == math.inf


def test_in_the_middle_of_a_round_room_every_way_is_as_long():
    corners = [(math.cos(k * math.pi / 180), math.sin(k * math.pi / 180)) for k in range(361)]
    for degrees in range(0, 360, 7):
        lengths = [ray_length((0, 0), math.radians(degrees + 0.5), p, q)
                   for p, q in zip(corners, corners[1:])]
        assert min(lengths) == pytest.approx(math.cos(math.pi / 360))
