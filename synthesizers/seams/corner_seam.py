"""Minimum-error cuts from a corner: where two pieces that share one join inside a quarter of a tile."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from .dynamic_seam import dynamic_seam


def corner_seam(difference: NDArray[np.float64]) -> tuple[NDArray[np.bool_], float]:
    """Return the best cut from the first pixel to the last of a quarter, and what it costs.

    The cut is a staircase, right or down at each pixel, so that every pixel lies on one side; it leaves the outer edges
    to the pieces whose they are, and the inner ones as well. In coordinates (x + y, x - y) it is a seam from top to
    bottom whose columns change by 1.

    Parameters
    ----------
    difference
        ``(h, w)``, each at least 3: how much the pieces differ.

    Returns
    -------
    taken
        ``bool (h, w)``: the pixels above the cut and on it where it first meets their column, which the horizontal
        piece takes.
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
    over, under = (step + path - rows + 1) // 2, (step - path + rows - 1) // 2
    first = np.take(under, np.searchsorted(over, np.arange(columns)))
    return y <= first, float(difference[under, over].sum())
