"""What a real camera does to an image that the simulated one paints.

Axis letters: R robots, H = 48 and W = 64 image rows and columns. Images are (R, H, W, 3) arrays of
floats, colours from 0 to 255.
"""

import numpy as np

BLUR_REACH = 6  # [px] beyond it a Gaussian of 3 px is left out


def shift_rows(images, rows):
    """The images moved down by (R,) rows, which need not be whole; what comes in repeats the edge.
    A camera that looks up by a small angle sees this, FOCAL tan(angle) rows of it."""
    H = images.shape[1]
    source = np.clip(np.arange(H) - rows[:, None], 0, H - 1)  # (R, H)
    above = np.floor(source).astype(int)
    below = np.minimum(above + 1, H - 1)
    share = (source - above)[..., None, None].astype(images.dtype)
    robot = np.arange(len(images))[:, None]
    return images[robot, above] * (1 - share) + images[robot, below] * share


def blurred(images, sigma):
    """The images under Gaussians with standard deviations (R,) [px]; the edge is repeated."""
    reach = min(int(np.ceil(3 * sigma.max())), BLUR_REACH)
    offset = np.arange(-reach, reach + 1)
    weights = np.exp(-0.5 * (offset / np.maximum(sigma, 1e-6)[:, None]) ** 2)  # (R, 2 reach + 1)
    weights /= weights.sum(1, keepdims=True)
    weights = weights.astype(images.dtype)
    for axis in (1, 2):  # rows, then columns
        padding = [(0, 0)] * 4
        padding[axis] = (reach, reach)
        padded = np.pad(images, padding, mode="edge")
        size = images.shape[axis]
        images = sum(weights[:, k, None, None, None] * padded.take(range(k, k + size), axis)
                     for k in range(2 * reach + 1))
    return images


def noisy(images, sigma, rng):
    """The images with normal noise of standard deviations (R,) on each colour of each pixel."""
    noise = rng.standard_normal(images.shape, dtype=np.float32)
    return images + sigma[:, None, None, None].astype(np.float32) * noise
