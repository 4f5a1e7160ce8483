"""Whether a rectangular period is the lattice's own, or holds several of its cells."""

from __future__ import annotations

import numpy as np

from nrbench.detectors.autocorrelation.peaks import quantized
from nrbench.detectors.rectangular_periods.rectangle_kernels import inner_relief
from nrbench.imaging.correlation import Correlation
from nrbench.imaging.fold import fold
from nrbench.lattice.geometry import Lattice

CELLS = 4
"""Rectangles along each axis that are looked at: enough to average, and no more than a large image allows."""
CORNER = 0.125
"""Within this share of its sides from a corner, a rectangle's repetition is that of the corner."""
SEVERAL = 0.63
"""An inner repetition from which on a rectangle holds several cells: halfway between the most of rectangles of one cell
(0.49) and the least of those of two (0.78) on procedural textures with departures (seeds 0 to 5, 160 x 160 px)."""


def inner_repetition(gamma: Correlation, width: float, height: float, reach: tuple[int, int]) -> float:
    """Return how nearly an image repeats at some place inside a rectangle as it does at the corners.

    The autocorrelation is averaged over rectangles, the one around lag 0 left out. Peaks are measured from the highest
    pass between them and the corners: a bump on a ridge (along the rows of a wall) is no repetition.

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
        How far the most prominent peak inside stands above its pass, over how far the corners do: about 1 where the
        rectangle holds several cells (a running bond's holds two), 0 where there is no peak inside, infinite where
        there is none at the corners.
    """
    middle = gamma.shape[0] // 2
    x_end, y_end = (min(end, round((CELLS + 0.5) * side)) for end, side in zip(reach, (width, height), strict=True))
    right = gamma[middle - y_end : middle + y_end + 1, : x_end + 1]
    y, x = np.indices(right.shape)
    others = (x >= width / 2) | (np.abs(y - y_end) >= height / 2)
    tile = fold(right[..., np.newaxis], Lattice((width, 0), (0, height), (0, y_end)), others).values[..., 0]
    heights = quantized(tile.astype(np.float32))
    rows, columns = (np.abs(np.fft.fftfreq(n)) > CORNER for n in tile.shape)
    order = np.argsort(-heights.ravel(), kind="stable")
    return inner_relief(heights, rows[:, np.newaxis] | columns, order)
