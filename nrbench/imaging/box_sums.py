"""Sums over all boxes of an image, by integral images."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

Table = NDArray[np.float64]
"""``float64 (H + 1, W + 1, ...)``: the sums over all pixels above and to the left."""


def integral_image(values: NDArray[Any]) -> Table:
    """Return the integral image of ``(H, W)``, or of each channel of ``(H, W, C)``; exact for whole numbers.

    :func:`skimage.transform.integral_image` also sums over channels and has no border of zeros. Applied to each channel
    and padded, it returns the same bits in 1.1 to 1.5 times the time.
    """
    table = np.zeros((values.shape[0] + 1, values.shape[1] + 1, *values.shape[2:]))
    np.cumsum(np.cumsum(values, 0, dtype=np.float64), 1, out=table[1:, 1:])
    return table


def box_sums_from(table: Table, size: tuple[int, int]) -> Table:
    """Return the sums over all boxes of ``size`` (rows, columns) from an integral image.

    ``(H - rows + 1, W - columns + 1, ...)`` for an image ``(H, W, ...)``, at the position of the first pixel of each
    box. The time is O(H W) for any size.
    """
    rows, columns = size
    bands = table[rows:] - table[: len(table) - rows]
    return np.asarray(bands[:, columns:] - bands[:, : bands.shape[1] - columns])


def box_sums(values: NDArray[Any], size: tuple[int, int]) -> Table:
    """Return the sums over all boxes of ``size`` (rows, columns) of an image; see :func:`box_sums_from`."""
    return box_sums_from(integral_image(values), size)
