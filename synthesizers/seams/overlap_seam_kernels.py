"""The compiled loops of L-shaped cuts, and the error surface of two pictures."""

from __future__ import annotations

import numpy as np

from nrbench.jit import Float64View2, Float64x2, Int64x1, UInt8x2, UInt8x3, kernel


@kernel
def squared_differences(old: UInt8x3, new: UInt8x3) -> Float64x2:
    """Return the squared difference of two pictures ``(h, w, C)`` at each pixel, summed over channels: ``(h, w)``."""
    height, width, channels = old.shape
    error = np.empty((height, width))
    for y in range(height):
        for x in range(width):
            total = 0
            for c in range(channels):
                difference = int(old[y, x, c]) - int(new[y, x, c])
                total += difference * difference
            error[y, x] = total
    return error


@kernel
def path_costs(error: Float64View2) -> Float64x2:
    """Return, for each pixel, the least sum of errors over 8-connected paths from the lowest row up to it. O(h w)."""
    rows, columns = error.shape
    total = np.empty((rows, columns))
    total[rows - 1] = error[rows - 1]
    for i in range(rows - 2, -1, -1):
        for j in range(columns):
            least = total[i + 1, j]
            if j > 0:
                least = min(least, total[i + 1, j - 1])
            if j < columns - 1:
                least = min(least, total[i + 1, j + 1])
            total[i, j] = error[i, j] + least
    return total


@kernel
def follow_path(total: Float64x2, row: int, column: int) -> Int64x1:
    """Return the columns of the path of least cost from a pixel down to the lowest row, one for each row from ``row``.

    Parameters
    ----------
    total
        Costs from :func:`path_costs`. Of steps of equal cost the straight one is preferred, then the left one.
    row, column
        The pixel.
    """
    rows, columns = total.shape
    path = np.empty(rows - row, np.int64)
    path[0] = column
    for i in range(row + 1, rows):
        before = path[i - row - 1]
        best = before
        if before > 0 and total[i, before - 1] < total[i, best]:
            best = before - 1
        if before < columns - 1 and total[i, before + 1] < total[i, best]:
            best = before + 1
        path[i - row] = best
    return path


@kernel
def cut_corner(error: Float64x2, overlap: int) -> tuple[UInt8x2, float]:
    """Return the mask and the cost of an L-shaped cut; see :func:`~.overlap_seam.l_shaped_seam`. O((h + w) overlap).

    Of meeting pixels of equal cost the first one is chosen, row by row.
    """
    height, width = error.shape
    upright, level = path_costs(error[:, :overlap]), path_costs(error[:overlap].T)
    cost, row, column = np.inf, 0, 0
    for i in range(overlap):
        for j in range(overlap):
            both = upright[i, j] + level[j, i] - error[i, j]
            if both < cost:
                cost, row, column = both, i, j
    first, below = follow_path(upright, row, column), follow_path(level, column, row)
    mask = np.ones((height, width), np.uint8)
    for y in range(height):
        for x in range(width):
            if (y < row and x < column) or (y >= row and x < first[y - row]) or (x >= column and y < below[x - column]):
                mask[y, x] = 0
    return mask, cost
