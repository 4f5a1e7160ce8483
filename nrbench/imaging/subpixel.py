"""Find the sub-pixel position of a peak: the vertex of the parabola through three samples."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray


def find_vertex(
    before: ArrayLike, middle: ArrayLike, after: ArrayLike, climb: bool = False
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Find the vertex of the parabola through three equally spaced samples.

    Parameters
    ----------
    before, middle, after
        The samples at -1, 0 and 1; arrays of one shape, or numbers.
    climb
        If the middle sample is no maximum, return half a step towards the higher neighbor instead of 0.

    Returns
    -------
    offset
        The position of the vertex, in [-0.5, 0.5] steps from the middle sample.
    rise
        The height of the parabola at this position above the middle sample.

    Examples
    --------
    >>> from nrbench.imaging.subpixel import find_vertex
    >>> [float(value) for value in find_vertex(0.0, 3.0, 2.0)]
    [0.25, 0.125]
    """
    before, middle, after = (np.asarray(sample, np.float64) for sample in (before, middle, after))
    slope, bend = (after - before) / 2, 2 * middle - before - after
    offset = np.clip(slope / np.maximum(bend, 1e-12), -0.5, 0.5)
    if not climb:
        offset = np.where((middle >= before) & (middle >= after) & (bend > 0), offset, np.zeros_like(offset))
    return offset, slope * offset - bend * offset**2 / 2
