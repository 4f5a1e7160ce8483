"""Minimum-error seams by dynamic programming (Efros and Freeman 2001, section 2.1)."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from nrbench.errors import BadInput

from .seam_kernels import cheapest_path


def dynamic_seam(error: NDArray[Any]) -> NDArray[np.int64]:
    """Compute the seam from top to bottom with the least sum of errors.

    For a seam from left to right, pass the transpose of the error surface.

    Parameters
    ----------
    error
        ``(h, w)``: difference of the two patches at each pixel of their overlap. Infinity forbids a pixel.

    Returns
    -------
    NDArray
        ``(h,)``: for each row the first column, 0 to w - 1, that belongs to the patch on the right. Columns of adjacent
        rows differ by at most 1. Ties are always broken in the same order. O(h w).

    Raises
    ------
    BadInput
        If the surface is not two-dimensional, is empty, or contains NaN.

    Examples
    --------
    >>> dynamic_seam(np.array([[1, 0, 1], [1, 1, 0], [1, 0, 1]]))
    array([1, 2, 1])
    """
    surface = np.ascontiguousarray(error, np.float64)
    if surface.ndim != 2 or not surface.size or np.isnan(surface).any():
        raise BadInput(
            f"seam through an error surface of shape {surface.shape}: "
            "give at least one row and one column of numbers, without NaN"
        )
    return cheapest_path(surface)


def corner_seam(difference: NDArray[np.float64]) -> tuple[NDArray[np.bool_], float]:
    """Compute the cheapest cut between two pieces that overlap in a quarter of a tile.

    The cut is a staircase from the first pixel to the last one. It moves right or down at each pixel, so that every
    pixel lies on one side. It avoids the edges of the quarter, except near its two ends. In coordinates
    (x + y, x - y) the cut is a seam from top to bottom whose columns change by 1.

    Parameters
    ----------
    difference
        ``(h, w)``, both at least 3: difference of the two pieces at each pixel.

    Returns
    -------
    taken
        ``bool (h, w)``: the pixels of the horizontal piece. In each column these are the pixels above the cut and the
        first one on it.
    cost
        Sum of ``difference`` along the cut.
    """
    rows, columns = difference.shape
    y, x = np.indices(difference.shape)
    free = ((x > 0) | (y < 2)) & ((y > 0) | (x < 2)) & ((x < columns - 1) | (y > rows - 3))
    free &= (y < rows - 1) | (x > columns - 3)
    surface = np.full((rows + columns - 1, rows + columns - 1), np.inf)
    along, aside = np.asarray(x + y), np.asarray(x - y + rows - 1)
    surface[along[free], aside[free]] = difference[free]
    path, step = dynamic_seam(surface), np.arange(rows + columns - 1)
    cut_x, cut_y = (step + path - rows + 1) // 2, (step - path + rows - 1) // 2
    first = np.take(cut_y, np.searchsorted(cut_x, np.arange(columns)))
    return y <= first, float(difference[cut_y, cut_x].sum())
