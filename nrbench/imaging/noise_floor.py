"""The noise floor of a spectrum: what a coefficient's power is where no wave is."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import median_filter

BLOCK = 8
"""Bins a side of the blocks whose medians are taken: 64 powers give the floor to 18 %, the nine around it to 6 %."""
RATIO = 1.3
"""Between the radii of neighboring rings."""


def noise_floor(power: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the local mean power of a spectrum's noise, ``(C, H, W // 2 + 1)``.

    The power of a coefficient of noise is exponentially distributed about its mean, whatever the pixels' law, so the
    mean is the median over ln 2; lines, which occupy few bins, hardly move a median. The floor is the higher of two:
    the median of the blocks around a bin (spectra with a direction) and that of its ring (spectra steep towards 0,
    where a block holds too wide a range of powers).

    Parameters
    ----------
    power
        ``(C, H, W // 2 + 1)``: squared magnitudes in the order of ``rfft2``.
    """
    return np.stack([np.maximum(_by_block(plane), _by_ring(plane)) for plane in power]) / math.log(2)


def _by_block(power: NDArray[np.float64]) -> NDArray[np.float64]:
    rows, cols = (max(n // BLOCK, 1) for n in power.shape)
    row, col = (np.arange(n) * parts // n for n, parts in zip(power.shape, (rows, cols), strict=True))
    medians = np.empty((rows, cols))
    for r in range(rows):
        strip = power[row == r]
        for c in range(cols):
            medians[r, c] = np.median(strip[:, col == c])
    smooth = median_filter(np.pad(medians, ((1, 1), (0, 0)), "wrap"), 3, mode="nearest")[1:-1]
    return np.asarray(smooth[row[:, np.newaxis], col])


def _by_ring(power: NDArray[np.float64]) -> NDArray[np.float64]:
    height, half = power.shape
    y = np.minimum(np.arange(height), height - np.arange(height))[:, np.newaxis] / height
    radius = np.hypot(y, np.arange(half) / (2 * max(half - 1, 1)))
    ring = np.floor(np.log(np.maximum(radius * height, 1)) / math.log(RATIO)).astype(np.intp)
    flat = ring.ravel()
    order = np.lexsort((power.ravel(), flat))
    edges = np.searchsorted(flat[order], np.arange(flat.max() + 2))
    middle = np.minimum((edges[:-1] + edges[1:]) // 2, len(flat) - 1)
    return np.asarray(power.ravel()[order[middle]][ring])
