"""Whether a rectangular period is the lattice's own, or holds several of its cells."""

from __future__ import annotations

import numpy as np
import scipy.ndimage

from nrbench.imaging.correlation import Correlation
from nrbench.imaging.fold import fold
from nrbench.lattice.geometry import Lattice

CELLS = 4
"""Rectangles along each axis that are looked at: enough to average, and no more than a large image allows."""
CORNER = 0.125
"""Within this share of its sides from a corner, a rectangle's repetition is that of the corner."""


def inner_repetition(gamma: Correlation, width: float, height: float, reach: tuple[int, int]) -> float:
    """Return how nearly an image repeats at some place inside a rectangle as it does at the corners.

    The autocorrelation is averaged over rectangles, the one around lag 0 left out; heights are above its median.

    Parameters
    ----------
    gamma
        The right half of an autocorrelation, ``(2H-1, W)``.
    width, height
        Sides of the rectangle, px.
    reach
        Largest lag along x and y, px, that is looked at.

    Returns
    -------
    float
        The highest peak inside over that at the corners: about 1 where the rectangle holds several cells (a running
        bond's holds two); infinite where the corners do not stand out at all.
    """
    middle = gamma.shape[0] // 2
    x_end, y_end = (min(end, round((CELLS + 0.5) * side)) for end, side in zip(reach, (width, height), strict=True))
    right = gamma[middle - y_end : middle + y_end + 1, : x_end + 1]
    y, x = np.indices(right.shape)
    others = (x >= width / 2) | (np.abs(y - y_end) >= height / 2)
    tile = fold(right[..., np.newaxis], Lattice((width, 0), (0, height), (0, y_end)), others).values[..., 0]
    tile = tile - np.median(tile)
    rows, columns = (np.abs(np.fft.fftfreq(n)) > CORNER for n in tile.shape)
    peaks = (tile == scipy.ndimage.maximum_filter(tile, 3, mode="wrap")) & (rows[:, np.newaxis] | columns)
    corner = float(tile[~rows][:, ~columns].max())
    return float(tile[peaks].max(initial=0)) / corner if corner > 0 else np.inf
