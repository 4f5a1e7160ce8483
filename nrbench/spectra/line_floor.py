"""The floor of irregular structure at a frequency: what the spectrum holds along lines through it, waves left out."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from nrbench.spectra.dirichlet import Array

DIRECTIONS = 12
REACH = 8
"""Bins looked at along a line to either side."""
FEWEST = 4
"""Samples that a line needs to tell its median."""


def line_floor(power: Array, shape: tuple[int, int], frequencies: Array, waves: Array) -> Array:
    """Return the mean power of what is irregular at frequencies, ``(n, C)``.

    Departures from regularity act on elements, and elements are not alike in all directions: the colors of threads
    that keep them along their length lie on lines of the spectrum, through the very places where the waves are, and
    tower over what surrounds the line. So the floor is the highest of the medians along twelve lines through a
    frequency, each over ln 2 (the power of a coefficient is exponentially distributed about its mean). Bins beside a
    wave are left out; where too few remain, the floor is that of the whole spectrum.

    Parameters
    ----------
    power
        ``(C, H, W // 2 + 1)``: squared magnitudes of what the waves leave, in the order of ``rfft2``.
    shape
        (H, W) px.
    frequencies
        ``(n, 2)`` cycles/px.
    waves
        ``(m, 2)`` cycles/px: all that were subtracted.
    """
    usable = np.moveaxis(np.where(_beside(waves, shape), np.inf, power), 0, 2)
    rows, cols = _folded(frequencies[:, np.newaxis, np.newaxis] * shape[::-1] + _lines(), shape)
    samples = np.sort(usable[rows, cols], axis=2)
    counts = np.isfinite(samples).sum(2)
    middle = np.take_along_axis(samples, np.maximum(counts - 1, 0)[:, :, np.newaxis] // 2, 2)[:, :, 0]
    medians = np.where(counts >= FEWEST, middle, 0).max(1, initial=0)
    whole = np.median(power.reshape(len(power), -1), 1)
    return np.asarray(np.where(medians > 0, medians, whole) / math.log(2))


def _lines() -> Array:
    """Return the steps from a frequency, bins, ``(directions, steps, 2)``."""
    angles = np.pi * np.arange(DIRECTIONS) / DIRECTIONS
    steps = np.concatenate([np.arange(-REACH, -1), np.arange(2, REACH + 1)])
    return np.asarray(steps[:, np.newaxis] * np.stack([np.cos(angles), np.sin(angles)], 1)[:, np.newaxis])


def _beside(waves: Array, shape: tuple[int, int]) -> NDArray[np.bool_]:
    """Return which bins are a wave's nearest or next to it, and those of the mean, ``(H, W // 2 + 1)``."""
    around = np.stack(np.meshgrid([-1, 0, 1], [-1, 0, 1]), -1).reshape(-1, 2)
    places = np.concatenate([np.zeros((1, 2)), waves, -waves]) * np.array(shape[::-1])
    near = np.zeros((shape[0], shape[1] // 2 + 1), np.bool_)
    near[_folded(np.rint(places)[:, np.newaxis] + around, shape)] = True
    return near


def _folded(bins: Array, shape: tuple[int, int]) -> tuple[NDArray[np.intp], NDArray[np.intp]]:
    """Return rows and columns of the half spectrum of bins (x, y), by its symmetry."""
    x, y = (np.rint(bins[..., k]).astype(np.intp) for k in (0, 1))
    x = (x + shape[1] // 2) % shape[1] - shape[1] // 2
    return np.where(x < 0, -y, y) % shape[0], np.abs(x)
