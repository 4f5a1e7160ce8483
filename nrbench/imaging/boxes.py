"""Upright boxes of an image: the sums over all of one size, and the largest one inside a mask."""

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


def largest_box(inside: NDArray[np.bool_]) -> tuple[int, int, int, int]:
    """Return first and last row and column, half-open, of a box whose borders hold True values alone.

    The worst border of the mask is removed until none holds a False value. Where False values lie along the borders of
    the mask, the box is close to the largest one without any. Holes in the middle are not seen.
    """
    y0, y1, x0, x1 = 0, inside.shape[0], 0, inside.shape[1]
    while y1 - y0 > 1 and x1 - x0 > 1:
        box = inside[y0:y1, x0:x1]
        worst = [float((~border).mean()) for border in (box[0], box[-1], box[:, 0], box[:, -1])]
        side = int(np.argmax(worst))
        if worst[side] == 0:
            break
        y0, y1, x0, x1 = y0 + (side == 0), y1 - (side == 1), x0 + (side == 2), x1 - (side == 3)
    return y0, y1, x0, x1
