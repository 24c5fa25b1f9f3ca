"""What walls look like: a texture for each material, our choice."""

import numpy as np

TEXEL = 0.025  # [m] one texture element
PERIOD = 48  # texels after which a texture repeats along a wall, 1.2 m
ABOVE = 160  # texels above a wall's foot; render.py says why so many


def texture(material):
    """(PERIOD, ABOVE, 3) colours [0, 255] of a wall, by texels along it and above its foot."""
    rng = np.random.default_rng(sum(material.encode()))
    u, v = np.meshgrid(np.arange(PERIOD), np.arange(ABOVE), indexing="ij")
    if material == "wall":  # grey-brown ceiling tiles, 0.6 m, grainy
        colour = np.array((186, 176, 168)) + rng.normal(0, 7, (PERIOD, ABOVE, 1))
        colour[(u % 24 == 0) | (v % 24 == 0)] -= 45
    elif material == "brick":  # courses of 10 cm, bricks of 30 cm, every other course shifted
        course = v // 4
        shifted = u + 6 * (course % 2)
        brick = shifted // 12 % (PERIOD // 12)
        tone = rng.normal(0, 1, (PERIOD // 12, ABOVE // 4, 1))[brick, course]
        colour = np.array((178, 74, 62)) + tone * (22, 14, 14)
        colour += rng.normal(0, 6, (PERIOD, ABOVE, 1))
        colour[(shifted % 12 == 0) | (v % 4 == 0)] = (176, 158, 150)  # mortar
    else:  # wood: upright orange-brown planks of 15 cm with grain along them
        tone = rng.normal(0, 14, (PERIOD // 6, 1))[u // 6]
        grain = rng.normal(0, 7, (PERIOD, ABOVE // 8, 1)).repeat(8, 1)
        colour = np.array((206, 126, 48)) + tone + grain
        colour[u % 6 == 0] *= 0.72
    return colour
