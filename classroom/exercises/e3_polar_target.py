"""Exercise 3: the target from the robot's point of view.

The robot does not know its position in the room. It observes the distance to the target and the
direction relative to its heading, so what it learns in one corner is valid in every other. In the
project: `polar_targets` in `navbot_min.py`.
"""

import numpy as np


def polar_target(pose, target):
    """Returns the distance [m] and the bearing [rad], in (-pi, pi], of the target (x, y) from the
    pose (x, y, theta). The bearing is 0 straight ahead and positive to the left."""
    raise NotImplementedError("your turn")


# ------------------------------------------ python -m pytest classroom/exercises/e3_polar_target.py


def test_a_target_straight_ahead_has_bearing_0():
    assert np.allclose(polar_target((1.0, 2.0, 0.0), (4.0, 2.0)), (3.0, 0.0))


def test_left_is_positive():
    assert np.allclose(polar_target((0.0, 0.0, 0.0), (0.0, 2.0)), (2.0, np.pi / 2))
    assert np.allclose(polar_target((0.0, 0.0, np.pi / 2), (2.0, 0.0)), (2.0, -np.pi / 2))


def test_the_bearing_is_wrapped():
    distance, bearing = polar_target((0.0, 0.0, 3.0), (-1.0, -0.1))
    assert np.isclose(distance, np.hypot(1.0, 0.1))
    assert np.isclose(bearing, np.arctan2(-0.1, -1.0) - 3.0 + 2 * np.pi)
    _, bearing = polar_target((0.0, 0.0, -3.0), (-1.0, 0.1))
    assert np.isclose(bearing, np.arctan2(0.1, -1.0) + 3.0 - 2 * np.pi)
    assert np.isclose(polar_target((0.0, 0.0, 0.0), (-1.0, 0.0))[1], np.pi)


def test_driving_the_distance_in_that_direction_reaches_the_target():
    rng = np.random.default_rng(0)
    for _ in range(100):
        x, y, theta, goal_x, goal_y = rng.uniform(-4, 4, 5)
        distance, bearing = polar_target((x, y, theta), (goal_x, goal_y))
        assert np.isclose(x + distance * np.cos(theta + bearing), goal_x)
        assert np.isclose(y + distance * np.sin(theta + bearing), goal_y)
