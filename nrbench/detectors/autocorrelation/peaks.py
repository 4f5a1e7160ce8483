"""Peaks of an autocorrelation, and generating vectors fitted to the peaks at their multiples."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import scipy
from numpy.typing import NDArray

from nrbench.detectors.autocorrelation.peak_kernels import find_basins, follow_multiples, prominences
from nrbench.imaging.correlation import Correlation, find_vertex
from nrbench.lattice.geometry import Points

Lags = NDArray[np.int64]
"""``int64 (n, 2)``: displacements (dx, dy) in whole px."""

UNIT = 1 << 24
"""Compiled loops sum correlations as integer multiples of 1 / UNIT, because such sums do not depend on the order."""
NEAR = 1.5
"""px; a peak belongs to a multiple if it lies within this distance of its expected position, along x and along y."""
MAX_SHIFT = 0.25
"""A fit that moves a vector by more than this share of its length is rejected: it has followed other peaks."""


@dataclass(frozen=True)
class Peaks:
    """Local maxima of an autocorrelation on the right half-plane.

    Parameters
    ----------
    lags
        ``(n, 2)``: dx > 0, or dx = 0 and dy > 0.
    values
        ``(n,)``: the correlation at the lags.
    prominences
        ``(n,)``: the height of each peak above the highest pass to a higher peak.
    """

    lags: Lags
    values: NDArray[np.float64]
    prominences: NDArray[np.float64]


def find_prominent_peaks(gamma: Correlation, reach: tuple[int, int]) -> Peaks:
    """Return the positive local maxima (eight neighbors) at lags with dx <= reach[0] and abs(dy) <= reach[1].

    Parameters
    ----------
    gamma
        The right half of an autocorrelation, ``(2H-1, W)``.
    reach
        px, at most W - 2 and H - 2. Prominences depend on the lags up to one pixel beyond it.
    """
    middle, (x_end, y_end) = gamma.shape[0] // 2, reach
    surface = quantize_correlation(gamma[middle - y_end - 1 : middle + y_end + 2, : x_end + 2])
    summits, saddles = find_basins(surface)
    heights = prominences(surface, summits, np.sort(saddles))
    y, x = np.nonzero((heights > 0) & (surface > 0))
    lags = np.stack([x, y - y_end - 1], 1)
    inside = ((x > 0) | (lags[:, 1] > 0)) & (x <= x_end) & (np.abs(lags[:, 1]) <= y_end)
    y, x = y[inside], x[inside]
    return Peaks(lags[inside], surface[y, x] / UNIT, heights[y, x] / UNIT)


def quantize_correlation(gamma: Correlation) -> NDArray[np.int32]:
    """Return the correlation in integer multiples of 1 / :data:`UNIT`."""
    return np.ascontiguousarray(np.rint(gamma * UNIT), np.int32)


def dilate(gamma: Correlation, radius: int) -> Correlation:
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
    """Return the sub-pixel position and the correlation of the highest lag within a pixel of each point ``(n, 2)``.

    The nine lags around the nearest whole lag are compared; :func:`subpixel` adds the fraction.
    """
    steps = np.array([(x, y) for y in (-1, 0, 1) for x in (-1, 0, 1)])
    around = np.rint(points).astype(np.int64)[:, np.newaxis] + steps
    values = values_at(gamma, around)
    best = values.argmax(1)
    rows = np.arange(len(points))
    return subpixel(gamma, around[rows, best]), values[rows, best]


def subpixel(gamma: Correlation, lags: Lags) -> Points:
    """Return the vertices of the parabolas, one along x and one along y, through lags ``(n, 2)`` and their neighbors.

    A lag that is no maximum along an axis is not moved along that axis.
    """
    offsets = []
    for step in np.eye(2, dtype=np.int64):
        before, middle, after = (values_at(gamma, lags + k * step) for k in (-1, 0, 1))
        offsets.append(find_vertex(before, middle, after))
    return np.asarray(lags + np.stack(offsets, 1))


def fit_multiples(gamma: Correlation, vectors: Points, reach: tuple[int, int]) -> Points:
    """Fit each vector to the peaks near its own multiples.

    A peak at the k-th multiple determines the vector k times more precisely than the peak at the vector itself, but it
    can be identified only if the vector is already precise. So the fit proceeds outward, one multiple at a time, until
    there is no peak near the next multiple or ``reach`` ends. A vector that the fit moves too far (:data:`MAX_SHIFT`)
    is returned unchanged.

    Parameters
    ----------
    gamma
        The right half of an autocorrelation, ``(2H-1, W)``.
    vectors
        ``(n, 2)``, (x, y) px, at peaks.
    reach
        Largest lag along x and y, px.
    """
    lengths = np.hypot(*vectors.T)
    most = int(np.hypot(*reach) / lengths.min(initial=np.inf)) + 1
    fitted = follow_multiples(gamma, np.array(vectors, np.float64, order="C"), np.array(reach, np.float64), most, NEAR)
    too_far = np.hypot(*(fitted - vectors).T) > lengths * MAX_SHIFT
    return np.where(too_far[:, np.newaxis], vectors, fitted)


def fit_pair(gamma: Correlation, pair: Points, reach: tuple[int, int]) -> Points:
    """Fit two generating vectors to the peaks near all their multiples within ``reach``.

    Least squares, each peak weighted by its correlation, over a disk whose radius doubles; see :func:`fit_multiples`.
    If the fit moves a vector too far (:data:`MAX_SHIFT`), ``pair`` is returned.

    Parameters
    ----------
    gamma
        The right half of an autocorrelation, ``(2H-1, W)``.
    pair
        ``(2, 2)``, rows (x, y) px.
    reach
        Largest lag along x and y, px.
    """
    lengths = np.hypot(*pair.T)
    n = int(2 * np.hypot(*reach) / lengths.min()) + 1
    numbers = np.stack(np.meshgrid(np.arange(-n, n + 1), np.arange(n + 1)), -1).reshape(-1, 2)
    numbers = numbers[(numbers[:, 1] > 0) | (numbers[:, 0] > 0)]
    distance = np.hypot(*(numbers @ pair).T)
    fitted, radius = pair, 0.75 * lengths.max()
    while radius <= np.hypot(*reach):
        radius *= 2
        chosen = numbers[distance <= radius]
        chosen = chosen[(np.abs(chosen @ fitted) <= reach).all(1)]
        fitted = _fit_least_squares(gamma, chosen, fitted)
    return fitted if np.hypot(*(fitted - pair).T).max() <= lengths.min() * MAX_SHIFT else pair


def _fit_least_squares(gamma: Correlation, numbers: Points, pair: Points) -> Points:
    """Return the pair whose multiples ``numbers`` lie nearest to peaks; ``pair`` if too few peaks are near."""
    peaks, values = climb(gamma, numbers @ pair)
    use = (np.abs(peaks - numbers @ pair) <= NEAR).all(1) & (values > 0)
    weights = np.sqrt(values[use])[:, np.newaxis]
    if np.linalg.matrix_rank(numbers[use] * weights) < 2:
        return pair
    return np.asarray(np.linalg.lstsq(numbers[use] * weights, peaks[use] * weights)[0])
