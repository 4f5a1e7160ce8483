"""Generating vectors to a fraction of a pixel: fitted to the autocorrelation's peaks at all their multiples."""

from __future__ import annotations

import numpy as np

from nrbench.detectors.autocorrelation.peaks import climb
from nrbench.imaging.correlation import Correlation
from nrbench.lattice.geometry import Points

NEAR = 1.5
"""A peak further than this, px along x or y, from where a multiple was expected does not belong to it."""
LOST = 0.25
"""A fit that moves a vector by more than this share of its length has followed peaks that are not its own."""


def fit_multiples(gamma: Correlation, vectors: Points, reach: tuple[int, int]) -> Points:
    """Return each vector fitted to the peaks near its own multiples.

    A peak at the k-th multiple tells the vector k times more precisely than the first, but is found only from a vector
    that is precise already: so the fit goes outward, one multiple at a time, until no peak is near or ``reach`` ends.
    A vector that the fit moves too far (:data:`LOST`) is returned as it was.

    Parameters
    ----------
    gamma
        The right half of an autocorrelation, ``(2H-1, W)``.
    vectors
        ``(n, 2)``, (x, y) px, at peaks.
    reach
        Largest lag along x and y, px, that is looked at.
    """
    lengths, fitted, live = np.hypot(*vectors.T), vectors.copy(), np.arange(len(vectors))
    products, squares = vectors.copy(), np.ones(len(vectors))
    for k in range(2, int(np.hypot(*reach) / lengths.min(initial=np.inf)) + 1):
        live = live[(np.abs(k * fitted[live]) <= reach).all(1)]
        peaks, _ = climb(gamma, k * fitted[live])
        near = (np.abs(peaks - k * fitted[live]) <= NEAR).all(1)
        live, peaks = live[near], peaks[near]
        products[live] += k * peaks
        squares[live] += k * k
        fitted[live] = products[live] / squares[live, np.newaxis]
    lost = np.hypot(*(fitted - vectors).T) > lengths * LOST
    return np.where(lost[:, np.newaxis], vectors, fitted)


def fit_pair(gamma: Correlation, pair: Points, reach: tuple[int, int]) -> Points:
    """Return two generating vectors fitted to the peaks near all their multiples within ``reach``.

    Least squares, each peak weighted by its correlation, over a disk whose radius doubles: see :func:`fit_multiples`.
    Where the fit moves a vector too far (:data:`LOST`), ``pair`` is returned.

    Parameters
    ----------
    gamma
        The right half of an autocorrelation, ``(2H-1, W)``.
    pair
        ``(2, 2)``, rows (x, y) px.
    reach
        Largest lag along x and y, px, that is looked at.
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
        fitted = _least_squares(gamma, chosen, fitted)
    return fitted if np.hypot(*(fitted - pair).T).max() <= lengths.min() * LOST else pair


def _least_squares(gamma: Correlation, numbers: Points, pair: Points) -> Points:
    """Return the pair whose multiples ``numbers`` lie nearest to the peaks there; ``pair`` where they do not tell."""
    peaks, values = climb(gamma, numbers @ pair)
    use = (np.abs(peaks - numbers @ pair) <= NEAR).all(1) & (values > 0)
    weights = np.sqrt(values[use])[:, np.newaxis]
    if np.linalg.matrix_rank(numbers[use] * weights) < 2:
        return pair
    return np.asarray(np.linalg.lstsq(numbers[use] * weights, peaks[use] * weights)[0])
