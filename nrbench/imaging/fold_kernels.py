"""Compiled loops of folding: pixels shared among the samples of a tile, and read from them."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from nrbench.jit import kernel


@kernel("float64[:, ::1](float32[:, ::1], float64[:, ::1], int64, int64)")
def share_out(pixels: NDArray[np.float32], uv: NDArray[np.float64], rows: int, columns: int) -> NDArray[np.float64]:
    """Return, for each of a tile's samples, the pixels' bilinear shares and what they bring, summed.

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
        ``(rows * columns, 1 + C)``: shares first. Time is linear in the pixels.
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


@kernel("float32[:, ::1](float32[:, :, ::1], float64[:, ::1])")
def read(values: NDArray[np.float32], uv: NDArray[np.float64]) -> NDArray[np.float32]:
    """Return a tile's values ``(V, U, C)`` at cell coordinates ``(n, 2)``, bilinear, as ``(n, C)``."""
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
