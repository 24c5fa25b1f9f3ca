"""A solution of exercise 4."""

import math


def ray_length(origin, angle, p, q):
    """Let d be the ray's direction, w the wall's, and o the vector from the origin to p. Then
    t d - u w = o. The cross product of both sides with w gives t, that with d gives u."""
    d = math.cos(angle), math.sin(angle)
    w = q[0] - p[0], q[1] - p[1]
    o = p[0] - origin[0], p[1] - origin[1]
    across = cross(d, w)
    if abs(across) < 1e-12:  # parallel
        return math.inf
    t = cross(o, w) / across
    u = cross(o, d) / across
    return t if t >= 0 and 0 <= u <= 1 else math.inf


def cross(a, b):
    """Returns the cross product of two vectors in the plane."""
    return a[0] * b[1] - a[1] * b[0]
