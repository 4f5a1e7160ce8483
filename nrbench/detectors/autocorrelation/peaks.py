"""Peaks of an autocorrelation: which there are, and where they lie to a fraction of a pixel."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import scipy.ndimage
from numpy.typing import NDArray

from nrbench.detectors.autocorrelation.topography_kernels import prominences
from nrbench.imaging.correlation import Correlation
from nrbench.imaging.parabola import find_vertex
from nrbench.lattice.geometry import Points

Lags = NDArray[np.int64]
"""``int64 (n, 2)``: displacements (dx, dy) in whole px."""

UNIT = 1 << 24
"""Correlations enter compiled loops as whole multiples of 1 / UNIT, so that no order of summing changes a bit."""


@dataclass(frozen=True)
class Peaks:
    """Local maxima of an autocorrelation on the right half-plane.

    Parameters
    ----------
    lags
        ``(n, 2)``: dx > 0, or dx = 0 and dy > 0.
    values
        ``(n,)``: the correlation there.
    prominences
        ``(n,)``: how far each stands above the highest pass to a higher one.
    """

    lags: Lags
    values: NDArray[np.float64]
    prominences: NDArray[np.float64]


def find_peaks(gamma: Correlation, reach: tuple[int, int]) -> Peaks:
    """Return the positive local maxima (eight neighbors) at lags with dx <= reach[0], abs(dy) <= reach[1].

    Parameters
    ----------
    gamma
        The right half of an autocorrelation, ``(2H-1, W)``.
    reach
        px, at most W - 2 and H - 2; higher ground beyond it by more than a pixel is not looked at.
    """
    middle, (x_end, y_end) = gamma.shape[0] // 2, reach
    surface = quantized(gamma[middle - y_end - 1 : middle + y_end + 2, : x_end + 2])
    order = np.argsort(-surface.ravel(), kind="stable")
    heights = prominences(surface, order)
    y, x = np.nonzero((heights > 0) & (surface > 0))
    lags = np.stack([x, y - y_end - 1], 1)
    inside = ((x > 0) | (lags[:, 1] > 0)) & (x <= x_end) & (np.abs(lags[:, 1]) <= y_end)
    y, x = y[inside], x[inside]
    return Peaks(lags[inside], surface[y, x] / UNIT, heights[y, x] / UNIT)


def quantized(gamma: Correlation) -> NDArray[np.int32]:
    """Return the correlation in whole multiples of 1 / :data:`UNIT`."""
    return np.ascontiguousarray(np.rint(gamma * UNIT), np.int32)


def dilated(gamma: Correlation, radius: int) -> Correlation:
    """Return the highest correlation within ``radius`` px (a square) of each lag, right half, ``(2H-1, W)``."""
    if radius == 0:
        return gamma
    left = gamma[::-1, radius:0:-1]
    highest = scipy.ndimage.maximum_filter(np.concatenate([left, gamma], 1), 2 * radius + 1, mode="nearest")
    return np.asarray(highest[:, left.shape[1] :])


def values_at(gamma: Correlation, lags: Lags) -> NDArray[np.float64]:
    """Return the correlation at whole lags ``(..., 2)`` on either half-plane."""
    sign = np.where(lags[..., 0] < 0, -1, 1)
    return np.asarray(gamma[gamma.shape[0] // 2 + sign * lags[..., 1], sign * lags[..., 0]], np.float64)


def climb(gamma: Correlation, points: Points) -> tuple[Points, NDArray[np.float64]]:
    """Return the highest place within a pixel of each point ``(n, 2)``, to a fraction of a pixel, and its correlation.

    The nine lags around the nearest whole one are compared; the fraction is :func:`subpixel`'s.
    """
    steps = np.array([(x, y) for y in (-1, 0, 1) for x in (-1, 0, 1)])
    around = np.rint(points).astype(np.int64)[:, np.newaxis] + steps
    values = values_at(gamma, around)
    best = values.argmax(1)
    rows = np.arange(len(points))
    return subpixel(gamma, around[rows, best]), values[rows, best]


def subpixel(gamma: Correlation, lags: Lags) -> Points:
    """Return the vertices of the parabolas, one along x and one along y, through lags ``(n, 2)`` and their neighbors.

    Lags that are no maximum along x (or y) stay where they are along x (or y).
    """
    offsets = []
    for step in np.eye(2, dtype=np.int64):
        offsets.append(find_vertex(*(values_at(gamma, lags + k * step) for k in (-1, 0, 1)))[0])
    return np.asarray(lags + np.stack(offsets, 1))
