"""Find the marks that a metric drew over an output."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

_LEVELS = 3
"""Channels that differ by more levels than this make a pixel colored, or different from the output."""


def find_marks(layer: NDArray[np.uint8], output: NDArray[np.uint8]) -> NDArray[np.bool_]:
    """Return where a metric's picture has marks, ``(H, W)``.

    A metric draws its marks in color over the output, or over a gray copy of it. Pixels that are gray, or equal to the
    output, are no marks.

    Parameters
    ----------
    layer, output
        The picture and the output, ``(H, W, 3)``.
    """
    # planes are contiguous, which is many times faster than a reduction over the last axis
    planes, below = (np.ascontiguousarray(np.moveaxis(picture, -1, 0)) for picture in (layer, output))
    spread = planes.max(0) - planes.min(0)
    apart = (np.maximum(planes, below) - np.minimum(planes, below)).max(0)
    marked: NDArray[np.bool_] = (spread > _LEVELS) & (apart > _LEVELS)
    return marked
