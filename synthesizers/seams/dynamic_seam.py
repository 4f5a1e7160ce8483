"""Minimum-error seams by dynamic programming (Efros and Freeman 2001, section 2.1).

Two patches that overlap are joined along the line on which they differ least. Here the line runs from top to bottom,
between an old side (left) and a new side (right); for a seam from left to right, hand over the transpose and transpose
the mask.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from nrbench.errors import BadInput

from .dynamic_seam_kernels import cheapest_path


def dynamic_seam(error: NDArray[Any]) -> NDArray[np.int64]:
    """Return the seam with the least sum of errors, one column a row.

    Parameters
    ----------
    error
        ``(h, w)``: how much the two patches differ at each pixel of their overlap; infinity forbids a pixel.

    Returns
    -------
    NDArray
        ``(h,)``: for each row the first column, 0 to w - 1, that belongs to the new side; neighbouring rows differ by
        at most 1. Of equal seams always the same one is taken. O(h w).

    Raises
    ------
    BadInput
        When the surface is not two-dimensional, is empty, or holds NaN.
    """
    surface = np.ascontiguousarray(error, np.float64)
    if surface.ndim != 2 or not surface.size or np.isnan(surface).any():
        raise BadInput(
            f"seam through an error surface of shape {surface.shape}: "
            "give at least one row and one column of numbers, without NaN"
        )
    return cheapest_path(surface)


def seam_mask(path: NDArray[np.int64], width: int, feather: float = 0.0) -> NDArray[np.float32]:
    """Return the new side's weight at each pixel of the overlap.

    Parameters
    ----------
    path
        ``(h,)``: for each row the first column that belongs to the new side.
    width
        Columns of the overlap.
    feather
        Width in px of the linear ramp from the old side to the new one, centred on the border between the two; 0 cuts.

    Returns
    -------
    NDArray
        ``float32 (h, width)`` in [0, 1]: 0 is the old side, 1 the new one, at least 0.5 from ``path`` on.

    Raises
    ------
    BadInput
        When the feather is negative.
    """
    if not feather >= 0:
        raise BadInput(f"feather {feather} px; choose 0 (a sharp cut) or more")
    beyond = np.arange(width) + 0.5 - path[:, np.newaxis]
    ramp = beyond / feather + 0.5 if feather else beyond > 0
    return np.clip(ramp, 0, 1).astype(np.float32)
