"""Textures for the materials of walls. All of them are our choice."""

import numpy as np

TEXEL = 0.025  # [m] one texture element
PERIOD = 48  # texels after which a texture repeats along a wall, 1.2 m
SUN = np.array((0.5, -0.1, 0.9)) / np.linalg.norm((0.5, -0.1, 0.9))  # released world
FLOOR = (118, 118, 118)  # colours, our choice
SKY = (178, 178, 178)  # 0.7 of white, released world
BLUE = (20, 20, 235)


def light(normal):
    """Returns the brightness of a face with a (..., 3) outward normal, by Lambert's law."""
    return 0.5 + 0.5 * np.clip(2 * (np.asarray(normal) @ SUN), 0, 1)


def texture(material, above):
    """Returns the colours [0, 255] of a wall, (PERIOD, above, 3). Axes: texels along the wall,
    texels above its bottom. above: a multiple of 8."""
    rng = np.random.default_rng(sum(material.encode()))
    u, v = np.meshgrid(np.arange(PERIOD), np.arange(above), indexing="ij")
    if material == "wall":  # grey-brown ceiling tiles, 0.6 m, grainy
        colour = np.array((186, 176, 168)) + rng.normal(0, 7, (PERIOD, above, 1))
        colour[(u % 24 == 0) | (v % 24 == 0)] -= 45
    elif material == "brick":  # courses of 10 cm, bricks of 30 cm, every other course shifted
        course = v // 4
        shifted = u + 6 * (course % 2)
        brick = shifted // 12 % (PERIOD // 12)
        tone = rng.normal(0, 1, (PERIOD // 12, above // 4, 1))[brick, course]
        colour = np.array((178, 74, 62)) + tone * (22, 14, 14)
        colour += rng.normal(0, 6, (PERIOD, above, 1))
        colour[(shifted % 12 == 0) | (v % 4 == 0)] = (176, 158, 150)  # mortar
    else:  # wood: upright orange-brown planks of 15 cm with grain along them
        tone = rng.normal(0, 14, (PERIOD // 6, 1))[u // 6]
        grain = rng.normal(0, 7, (PERIOD, above // 8, 1)).repeat(8, 1)
        colour = np.array((206, 126, 48)) + tone + grain
        colour[u % 6 == 0] *= 0.72
    return colour
