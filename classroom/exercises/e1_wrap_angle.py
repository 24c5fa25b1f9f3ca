"""Exercise 1: one number for one direction.

An angle and the same angle a whole turn on are one direction, and a network learns faster when one
thing has one number. The project does it in `sim.py`, `wrap_angle`.
"""

import numpy as np


def wrap_angle(angle):
    """The same direction [rad] in (-pi, pi]: what is straight behind is pi, exactly, and never -pi.
    angle: a number or an array."""
    raise NotImplementedError("your turn")


# ------------------------------------------- python -m pytest classroom/exercises/e1_wrap_angle.py


def test_angles_inside_stay():
    assert np.allclose(wrap_angle(np.array([-3.0, 0.0, 1.5])), [-3.0, 0.0, 1.5])


def test_a_turn_more_or_less_is_taken_off():
    assert np.allclose(wrap_angle(np.array([1.5 * np.pi, -1.5 * np.pi])), [-np.pi / 2, np.pi / 2])


def test_behind_is_pi_from_both_sides():
    assert wrap_angle(-np.pi) == wrap_angle(np.pi) == np.pi
    assert np.array_equal(wrap_angle(np.array([-np.pi, np.pi])), [np.pi, np.pi])


def test_it_is_the_same_direction_however_often_it_turned():
    angles = np.linspace(-500, 500, 1001)
    wrapped = wrap_angle(angles)
    assert np.allclose(np.exp(1j * wrapped), np.exp(1j * angles))
    assert np.all(wrapped > -np.pi) and np.all(wrapped <= np.pi)
