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
    rings = _rings(power.shape[1], power.shape[2])
    return np.stack([np.maximum(_by_block(plane), _by_ring(plane, rings)) for plane in power]) / math.log(2)


def _by_block(power: NDArray[np.float64]) -> NDArray[np.float64]:
    rows, cols = (_blocks(n) for n in power.shape)
    inside = power[rows[:, np.newaxis, :, np.newaxis], cols[:, np.newaxis, :]]
    medians = np.median(inside.reshape(len(rows), len(cols), -1), 2)
    smooth = median_filter(np.pad(medians, ((1, 1), (0, 0)), "wrap"), 3, mode="nearest")[1:-1]
    row, col = (np.arange(n) * len(blocks) // n for n, blocks in zip(power.shape, (rows, cols), strict=True))
    return np.asarray(smooth[row[:, np.newaxis], col])


def _blocks(length: int) -> NDArray[np.intp]:
    """Return the bins of each block, all of one size: neighbors share a bin where the length does not divide."""
    parts = max(length // BLOCK, 1)
    return np.asarray((np.arange(parts) * length // parts)[:, np.newaxis] + np.arange(length // parts))


def _by_ring(power: NDArray[np.float64], rings: list[NDArray[np.intp]]) -> NDArray[np.float64]:
    flat, floor = power.ravel(), np.empty(power.size)
    for ring in rings:
        floor[ring] = np.median(flat[ring])
    return floor.reshape(power.shape)


def _rings(height: int, half: int) -> list[NDArray[np.intp]]:
    """Return the flat numbers of the bins of each ring."""
    y = np.minimum(np.arange(height), height - np.arange(height))[:, np.newaxis] / height
    radius = np.hypot(y, np.arange(half) / (2 * max(half - 1, 1)))
    ring = np.floor(np.log(np.maximum(radius * height, 1)) / math.log(RATIO)).astype(np.int16).ravel()
    order = np.argsort(ring, kind="stable")
    return [part for part in np.split(order, np.flatnonzero(np.diff(ring[order])) + 1) if len(part)]
