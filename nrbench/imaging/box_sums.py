"""Sums over all boxes of an image, by integral images."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

Table = NDArray[np.float64]
"""``float64 (H + 1, W + 1, ...)``: the sums over all that lies above and to the left."""


def integral(values: NDArray[Any]) -> Table:
    """Return the integral image of ``(H, W)`` or, each channel by itself, ``(H, W, C)``; exact for whole numbers."""
    table = np.zeros((values.shape[0] + 1, values.shape[1] + 1, *values.shape[2:]))
    np.cumsum(np.cumsum(values, 0, dtype=np.float64), 1, out=table[1:, 1:])
    return table


def boxes_of(table: Table, size: tuple[int, int]) -> Table:
    """Return the sums over all boxes of ``size`` (rows, columns), by the place of their first pixel.

    ``(H - rows + 1, W - columns + 1, ...)`` for the integral image of ``(H, W, ...)``; O(H W) whatever the size.
    """
    rows, columns = size
    bands = table[rows:] - table[: len(table) - rows]
    return np.asarray(bands[:, columns:] - bands[:, : bands.shape[1] - columns])


def box_sums(values: NDArray[Any], size: tuple[int, int]) -> Table:
    """Return the sums over all boxes of ``size`` (rows, columns) where one size is asked; see :func:`boxes_of`."""
    return boxes_of(integral(values), size)
