"""Exercise 1: one number for each direction.

An angle plus a whole turn is the same direction. A network learns faster if each direction has only
one number. In the project: `wrap_angle` in `sim.py`.
"""

import numpy as np


def wrap_angle(angle):
    """Returns the same direction [rad] in (-pi, pi]. Straight behind is exactly pi, never -pi.
    angle: a number or an array."""
    raise NotImplementedError("your turn")


# ------------------------------------------- python -m pytest classroom/exercises/e1_wrap_angle.py


def test_angles_in_the_range_do_not_change():
    assert np.allclose(wrap_angle(np.array([-3.0, 0.0, 1.5])), [-3.0, 0.0, 1.5])


def test_a_whole_turn_is_removed():
    assert np.allclose(wrap_angle(np.array([1.5 * np.pi, -1.5 * np.pi])), [-np.pi / 2, np.pi / 2])


def test_behind_is_pi_from_both_sides():
    assert wrap_angle(-np.pi) == wrap_angle(np.pi) == np.pi
    assert np.array_equal(wrap_angle(np.array([-np.pi, np.pi])), [np.pi, np.pi])


def test_any_number_of_turns_gives_the_same_direction():
    angles = np.linspace(-500, 500, 1001)
    wrapped = wrap_angle(angles)
    assert np.allclose(np.exp(1j * wrapped), np.exp(1j * angles))
    assert np.all(wrapped > -np.pi) and np.all(wrapped <= np.pi)
