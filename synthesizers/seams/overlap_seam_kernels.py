"""The compiled loops of L-shaped cuts, and the error surface of two pictures."""

from __future__ import annotations

import numpy as np

from nrbench.jit import Float64x2, UInt8x2, UInt8x3, kernel

from .seam_kernels import follow_path, path_costs


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
