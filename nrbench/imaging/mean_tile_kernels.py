"""Compiled loops of folding: mean tiles, and values between their samples and between pixels."""

from __future__ import annotations

import numpy as np

from nrbench.jit import Float32x2, Float32x3, Float64x2, kernel


@kernel
def accumulate_pixels(pixels: Float32x2, uv: Float64x2, rows: int, columns: int) -> Float64x2:
    """Return the sum of the pixels' bilinear weights and the sums of their weighted values, for each sample of a tile.

    Parameters
    ----------
    pixels
        ``(n, C)``.
    uv
        ``(n, 2)``: their cell coordinates.
    rows, columns
        Samples of the tile along v and u.

    Returns
    -------
    NDArray
        ``(rows * columns, 1 + C)``: weights first. Time is linear in the number of pixels.
    """
    sums = np.zeros((rows * columns, 1 + pixels.shape[1]))
    for n in range(len(pixels)):
        u, v = uv[n, 0] % 1.0 * columns, uv[n, 1] % 1.0 * rows
        left, top = int(u), int(v)
        u -= left
        v -= top
        for dx in range(2):
            for dy in range(2):
                share = (u if dx else 1.0 - u) * (v if dy else 1.0 - v)
                at = (top + dy) % rows * columns + (left + dx) % columns
                sums[at, 0] += share
                for c in range(pixels.shape[1]):
                    sums[at, 1 + c] += share * pixels[n, c]
    return sums


@kernel
def interpolate_tile(values: Float32x3, uv: Float64x2) -> Float32x2:
    """Return the bilinear values of a tile ``(V, U, C)`` at cell coordinates ``(n, 2)``, as ``(n, C)``."""
    rows, columns, channels = values.shape
    found = np.zeros((len(uv), channels), np.float32)
    for n in range(len(uv)):
        u, v = uv[n, 0] % 1.0 * columns, uv[n, 1] % 1.0 * rows
        left, top = int(u), int(v)
        u -= left
        v -= top
        for dx in range(2):
            for dy in range(2):
                share = np.float32((u if dx else 1.0 - u) * (v if dy else 1.0 - v))
                y, x = (top + dy) % rows, (left + dx) % columns
                for c in range(channels):
                    found[n, c] += share * values[y, x, c]
    return found


@kernel
def interpolate_image(image: Float32x3, xy: Float64x2) -> Float32x2:
    """Return the bilinear values of an image ``(H, W, C)`` at places ``(n, 2)`` px inside it, as ``(n, C)``."""
    height, width, channels = image.shape
    found = np.empty((len(xy), channels), np.float32)
    for n in range(len(xy)):
        left, top = min(int(xy[n, 0]), width - 2), min(int(xy[n, 1]), height - 2)
        x, y = np.float32(xy[n, 0] - left), np.float32(xy[n, 1] - top)
        for c in range(channels):
            above = image[top, left, c] * (np.float32(1) - x) + image[top, left + 1, c] * x
            below = image[top + 1, left, c] * (np.float32(1) - x) + image[top + 1, left + 1, c] * x
            found[n, c] = above * (np.float32(1) - y) + below * y
    return found
