"""Peaks of an autocorrelation, and what is read off them."""

from __future__ import annotations

import numpy as np
import scipy.ndimage
from numpy.typing import NDArray

from nrbench.imaging.correlation import Correlation
from nrbench.lattice.geometry import Points


def local_maxima(gamma: Correlation) -> NDArray[np.intp]:
    """Return the lags (dx, dy) on the right half-plane at which the correlation exceeds its eight neighbors.

    Parameters
    ----------
    gamma
        The right half of an autocorrelation, ``(2H-1, W)``.

    Returns
    -------
    NDArray
        ``(n, 2)``: dx > 0, or dx = 0 and dy > 0; lags on the outermost rows and columns are left out.
    """
    half = (gamma.shape[0] + 1) // 2
    around = _with_left(gamma, 1)
    ring = np.ones((3, 3), bool)
    ring[1, 1] = False
    higher = around > scipy.ndimage.maximum_filter(around, footprint=ring, mode="constant", cval=np.inf)
    y, x = np.nonzero(higher[:, 1:])
    lags = np.stack([x, y - (half - 1)], 1)
    return lags[(x > 0) | (lags[:, 1] > 0)]


def dilated(gamma: Correlation, radius: int) -> Correlation:
    """Return the highest correlation within ``radius`` px (a square) of each lag, right half, ``(2H-1, W)``."""
    if radius == 0:
        return gamma
    around = _with_left(gamma, radius)
    return np.asarray(scipy.ndimage.maximum_filter(around, 2 * radius + 1, mode="nearest")[:, radius:])


def values_at(gamma: Correlation, lags: NDArray[np.intp]) -> NDArray[np.float32]:
    """Return the correlation at lags (dx, dy) of either half-plane, ``(n, 2)``."""
    half = (gamma.shape[0] + 1) // 2
    sign = np.where(lags[:, 0] < 0, -1, 1)
    return np.asarray(gamma[half - 1 + sign * lags[:, 1], sign * lags[:, 0]])


def subpixel(gamma: Correlation, lags: NDArray[np.intp]) -> Points:
    """Return the vertices of the parabolas, one along x and one along y, through local maxima and their neighbors.

    Lags that are no local maximum of their row (or column) stay where they are along x (or y).
    """
    offsets = []
    for step in ((1, 0), (0, 1)):
        before, here, after = (values_at(gamma, lags + k * np.array(step)).astype(np.float64) for k in (-1, 0, 1))
        curvature = 2 * here - before - after
        peak = (here >= before) & (here >= after) & (curvature > 0)
        offsets.append(np.where(peak, (after - before) / (2 * np.where(peak, curvature, 1)), 0))
    return lags + np.stack(offsets, 1)


def _with_left(gamma: Correlation, columns: int) -> Correlation:
    """Return the right half with the first ``columns`` columns of the left half before it."""
    return np.concatenate([gamma[::-1, columns:0:-1], gamma], 1)
