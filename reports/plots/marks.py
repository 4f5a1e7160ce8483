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
    spread = layer.max(-1).astype(np.int16) - layer.min(-1)
    apart = np.abs(layer.astype(np.int16) - output).max(-1)
    marked: NDArray[np.bool_] = (spread > _LEVELS) & (apart > _LEVELS)
    return marked
