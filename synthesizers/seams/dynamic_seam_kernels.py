"""The compiled loop of minimum-error seams."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from nrbench.jit import kernel


@kernel("int64[::1](float64[:, ::1])")
def cheapest_path(error: NDArray[np.float64]) -> NDArray[np.int64]:
    """Return the column, row by row, of the 8-connected path from top to bottom with the least sum of errors.

    Dynamic programming (Efros and Freeman 2001, section 2.1): E[i, j] = e[i, j] + min of E[i-1, j-1], E[i-1, j] and
    E[i-1, j+1]. Of equal ways the straight one, then the left one is taken, and of equal ends the leftmost. O(h w).

    Parameters
    ----------
    error
        ``(h, w)``, at least one row and one column; infinity forbids a pixel.

    Returns
    -------
    NDArray
        ``(h,)``: columns from 0 to w - 1, neighbouring rows at most 1 apart.
    """
    rows, columns = error.shape
    total = error[0].copy()
    below = np.empty(columns, np.float64)
    came = np.zeros((rows, columns), np.int8)
    for i in range(1, rows):
        for j in range(columns):
            least, step = total[j], np.int8(0)
            if j > 0 and total[j - 1] < least:
                least, step = total[j - 1], np.int8(-1)
            if j < columns - 1 and total[j + 1] < least:
                least, step = total[j + 1], np.int8(1)
            below[j] = error[i, j] + least
            came[i, j] = step
        total, below = below, total
    path = np.empty(rows, np.int64)
    path[rows - 1] = np.argmin(total)
    for i in range(rows - 1, 0, -1):
        path[i - 1] = path[i] + came[i, path[i]]
    return path
