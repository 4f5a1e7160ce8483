"""Sums of squared differences, normalized by their number: of two images, and of an image with its shifted self."""

from __future__ import annotations

import math

import numpy as np
import scipy.fft
from numpy.typing import NDArray

Pixels = NDArray[np.float32]
"""``float32 (H, W, C)``, any range."""
Sequence = NDArray[np.float64]
"""``float64 (n,)``: one value for each lag 0, 1, ..., n - 1 in px along one axis."""

_BLOCK = 1 << 22
"""Values that are transformed at a time."""


def ssdn(one: Pixels, other: Pixels) -> float:
    """Return the sum of squared differences of two images over their number of pixels, summed over channels.

    Notes
    -----
    Representative tile, section 3, equations 1 and 2.
    """
    difference = np.subtract(one, other, dtype=np.float64)
    return float(np.vdot(difference, difference)) / math.prod(one.shape[:2])


def shift_ssdn(image: Pixels, axis: int) -> tuple[Sequence, Sequence]:
    """Compare an image with its own copy shifted by each lag along one axis, over their overlap.

    Parameters
    ----------
    image
        ``(H, W, C)``, any range.
    axis
        0: shifts along y; 1: along x.

    Returns
    -------
    tuple
        g, ``(n,)`` for the axis' n pixels: :func:`ssdn` of the two overlapping parts at lag k. And what it would be, on
        average, if the two parts kept their pixels' means and variances but had nothing in common.

    Notes
    -----
    Representative tile, section 3, figure 1. O(H W log n): the products by one transform of each line, the squares by
    cumulative sums.
    """
    lines = np.moveaxis(image, (2, axis), (0, 2))
    lines = lines - lines.mean((1, 2), np.float64, keepdims=True)
    length = lines.shape[2]
    counts = lines.shape[1] * np.arange(length, 0, -1)
    squares = np.einsum("crx,crx->x", lines, lines)
    both = (_ahead(squares) + _ahead(squares[::-1])) / counts
    sums = lines.sum(1)
    means = sum(_ahead(channel) * _ahead(channel[::-1]) for channel in sums) / np.square(counts, dtype=np.float64)
    return np.maximum(both - 2 * _products(lines.reshape(-1, length)) / counts, 0), both - 2 * means


def _ahead(values: Sequence) -> Sequence:
    """Return the sums of the first n - k values, for k = 0, ..., n - 1."""
    return np.asarray(np.cumsum(values)[::-1])


def _products(lines: NDArray[np.float64]) -> Sequence:
    """Return the products of lines ``(m, n)`` with themselves shifted by each lag, summed, ``(n,)``."""
    length = lines.shape[1]
    padded = scipy.fft.next_fast_len(2 * length - 1, real=True)
    rows = max(_BLOCK // padded, 1)
    power = np.zeros(padded // 2 + 1)
    for start in range(0, len(lines), rows):
        spectra = scipy.fft.rfft(lines[start : start + rows], padded, axis=1)
        power += (spectra.real**2 + spectra.imag**2).sum(0)
    return np.asarray(scipy.fft.irfft(power, padded)[:length])
