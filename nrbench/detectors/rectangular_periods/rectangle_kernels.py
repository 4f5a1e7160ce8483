"""The compiled loop that tells a rectangle's inner peaks from bumps on the ridges between its corners."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from nrbench.detectors.autocorrelation.union_find import root
from nrbench.jit import kernel


@kernel("float64(int32[:, ::1], boolean[:, ::1], int64[::1])")
def inner_relief(tile: NDArray[np.int32], inside: NDArray[np.bool_], order: NDArray[np.int64]) -> float:
    """Return how far an inner peak stands above its highest pass to the corners' peak, over how far that one does.

    Parameters
    ----------
    tile
        One rectangle of a surface, ``(H, W)``; it wraps round.
    inside
        ``(H, W)``: the pixels that are not near a corner; the corners' peak is the highest of the others.
    order
        The pixels' flat indices from the highest to the lowest.

    Returns
    -------
    float
        That of the inner peak for which it is largest; 0 where there is none, infinite where the corners have no peak.

    Notes
    -----
    The surface is flooded from above; O(n log n).
    """
    rows, columns = tile.shape
    height, inner = tile.ravel(), inside.ravel()
    parent = np.full(tile.size, -1, np.int64)
    peak = np.full(tile.size, -1, np.int64)
    corner, relief = -1, 0.0
    for pixel in order:
        parent[pixel] = pixel
        if inner[pixel]:
            peak[pixel] = pixel
        elif corner < 0:
            corner = pixel
        y, x = pixel // columns, pixel % columns
        for step in range(9):
            near = (y + step // 3 - 1) % rows * columns + (x + step % 3 - 1) % columns
            if parent[near] < 0:
                continue
            one, other = root(parent, pixel), root(parent, near)
            if one == other:
                continue
            top = root(parent, corner) if corner >= 0 else corner
            if one == top:
                one, other = other, one
            if other == top:
                if peak[one] >= 0:
                    if height[corner] == height[pixel]:
                        return np.inf if height[peak[one]] > height[pixel] else relief
                    relief = max(relief, (height[peak[one]] - height[pixel]) / (height[corner] - height[pixel]))
            elif peak[one] >= 0 and (peak[other] < 0 or height[peak[one]] > height[peak[other]]):
                peak[other] = peak[one]
            parent[one] = other
    return relief
