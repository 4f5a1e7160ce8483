"""Compiled loops on the topography of a surface: how far its peaks stand out, and whether ridges join them."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from nrbench.detectors.autocorrelation.union_find import root
from nrbench.jit import kernel


@kernel("int32[:, ::1](int32[:, ::1], int64[::1])")
def prominences(surface: NDArray[np.int32], order: NDArray[np.int64]) -> NDArray[np.int32]:
    """Return how far each peak stands above the highest pass to a higher one.

    Parameters
    ----------
    surface
        ``(2h+1, w)``: the right half of a surface that is symmetric about its origin at ``[h, 0]``.
    order
        The pixels' flat indices from the highest to the lowest.

    Returns
    -------
    NDArray
        ``(2h+1, w)``: 0 where there is no peak, and in the first column above the origin, which repeats what is below;
        the highest peak stands above the lowest pixel. Adjoining pixels of equal height make one peak.
    """
    rows, columns = surface.shape
    middle = rows // 2
    height = surface.ravel()
    parent = np.full(height.size, -1, np.int64)
    found = np.zeros(height.size, np.int32)
    highest = -1
    for pixel in order:
        y, x = pixel // columns, pixel % columns
        # The first column holds its pixels twice, above and below the origin: those above are left out.
        if x == 0 and y < middle:
            continue
        highest = pixel if highest < 0 else highest
        parent[pixel] = pixel
        for step in range(9):
            near_y, near_x = y + step // 3 - 1, x + step % 3 - 1
            if near_x < 0 or (near_x == 0 and near_y < middle):
                near_y, near_x = rows - 1 - near_y, -near_x
            if near_x >= columns or near_y < 0 or near_y >= rows:
                continue
            near = near_y * columns + near_x
            if parent[near] < 0:
                continue
            # A root is the peak of its hill: the pixel that was reached first.
            one, other = root(parent, pixel), root(parent, near)
            if one == other:
                continue
            if height[one] < height[other] or (height[one] == height[other] and one == pixel):
                one, other = other, one
            found[other] = height[other] - height[pixel]
            parent[other] = one
    found[highest] = height[highest] - height[order[-1]]
    return found.reshape(surface.shape)


@kernel("float64[::1](float32[:, ::1], int64[::1])")
def highest_ridge(tile: NDArray[np.float32], order: NDArray[np.int64]) -> NDArray[np.float64]:
    """Return the ridge that joins the peaks of a periodic surface: of all paths, the one that stays highest.

    Parameters
    ----------
    tile
        One cell of the surface, ``(V, U)``; it wraps round, its peak is at ``[0, 0]``.
    order
        The pixels' flat indices from the highest to the lowest.

    Returns
    -------
    NDArray
        ``(3,)``: the ridge's lowest point, and whole tiles along x and y from one peak to the next that it joins.
    """
    rows, columns = tile.shape
    height = tile.ravel()
    parent = np.full(tile.size, -1, np.int64)
    # From each pixel to its parent, in whole tiles; and from each region to its repetition that it has met.
    across, down = np.zeros(tile.size, np.int64), np.zeros(tile.size, np.int64)
    met_x, met_y = np.zeros(tile.size, np.int64), np.zeros(tile.size, np.int64)
    for pixel in order:
        parent[pixel] = pixel
        y, x = pixel // columns, pixel % columns
        for step in range(9):
            near_y, near_x = y + step // 3 - 1, x + step % 3 - 1
            near = near_y % rows * columns + near_x % columns
            if parent[near] < 0 or step == 4:
                continue
            shift_x, shift_y = near_x // columns, near_y // rows
            one, other = pixel, near
            while parent[one] != one:
                shift_x, shift_y = shift_x - across[one], shift_y - down[one]
                one = parent[one]
            while parent[other] != other:
                shift_x, shift_y = shift_x + across[other], shift_y + down[other]
                other = parent[other]
            if one != other:
                parent[other], across[other], down[other] = one, -shift_x, -shift_y
                shift_x, shift_y = met_x[other], met_y[other]
            if met_x[one] == 0 and met_y[one] == 0:
                met_x[one], met_y[one] = shift_x, shift_y
        if parent[0] >= 0:
            first = 0
            while parent[first] != first:
                first = parent[first]
            if met_x[first] != 0 or met_y[first] != 0:
                return np.array((float(height[pixel]), float(met_x[first]), float(met_y[first])))
    return np.array((float(height[order[-1]]), 1.0, 0.0))
