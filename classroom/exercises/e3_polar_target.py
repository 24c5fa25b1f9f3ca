"""Exercise 3: where the target is, as the robot sees it.

The robot is not told where it is in the room, but how far off its target is and in which direction
from its nose: so what it learns in one corner holds in every other. The project does it in
`navbot_min.py`, `polar_targets`.
"""

import numpy as np


def polar_target(pose, target):
    """Distance [m] and bearing [rad] in (-pi, pi] of the target (x, y) from the pose (x, y, theta).
    The bearing is 0 straight ahead and grows to the left."""
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


def test_driving_that_way_leads_there():
    rng = np.random.default_rng(0)
    for _ in range(100):
        x, y, theta, goal_x, goal_y = rng.uniform(-4, 4, 5)
        distance, bearing = polar_target((x, y, theta), (goal_x, goal_y))
        assert np.isclose(x + distance * np.cos(theta + bearing), goal_x)
        assert np.isclose(y + distance * np.sin(theta + bearing), goal_y)
