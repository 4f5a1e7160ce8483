"""Distances between distributions of values and of colors, from histograms."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from nrbench.imaging.convert import Image

Histogram = NDArray[np.float64]
"""``(k, BINS + 1)``: k cumulative histograms that end in 1."""
BINS = 512
_DIRECTIONS = 12
_PIXELS = 1 << 14
"""About how many pixels, evenly over the image, a distribution of colors rests on."""
_GOLDEN = np.pi * (3 - np.sqrt(5))


def cumulative(values: NDArray[np.float32]) -> Histogram:
    """Return the cumulative histograms of values in [0, 1], ``(n, k)``, one a column.

    A value between two bins is shared among them, so that nothing is lost to rounding.
    """
    at = np.clip(values, 0, 1) * np.float32(BINS)
    low = np.minimum(at.astype(np.int32), BINS - 1)
    share = at - low
    upper = [np.bincount(column, weight, BINS) for column, weight in zip(low.T, share.T, strict=True)]
    whole = [np.bincount(column, minlength=BINS) for column in low.T]
    counts = np.zeros((values.shape[1], BINS + 1))
    counts[:, :-1] = np.array(whole) - upper
    counts[:, 1:] += upper
    return np.asarray(np.cumsum(counts, 1) / len(values))


def distance(one: Histogram, other: Histogram) -> float:
    """Return the Wasserstein distance of order 1 between distributions over [0, 1], mean over the histograms.

    It is the area between the cumulative distributions.
    """
    return float(np.abs(one - other).mean(0).sum() / BINS)


def color_histograms(image: Image) -> Histogram:
    """Return cumulative histograms of an image's colors along directions spread evenly over the half-sphere.

    For the sliced Wasserstein distance (Rabin, Peyré, Delon, Bernot, SSVM 2011), with fixed directions instead of
    random ones, so that the same pixels read the same. Colors are projected and moved into [0, 1] by the unit cube's
    own reach of 2 sqrt(3); multiply by :func:`color_scale`.
    """
    pixels = image.reshape(-1, image.shape[2])
    pixels = pixels[:: len(pixels) // _PIXELS | 1]
    if image.shape[2] == 1:
        return cumulative(pixels)
    return cumulative(pixels @ _directions().T / np.float32(color_scale(3)) + np.float32(0.5))


def color_scale(channels: int) -> float:
    """Return what a distance of :func:`color_histograms` is multiplied by to be in values."""
    return 1.0 if channels == 1 else 2 * np.sqrt(3.0)


def _directions() -> NDArray[np.float32]:
    """Return unit vectors on a Fibonacci spiral over the half-sphere, ``(12, 3)``."""
    z = (np.arange(_DIRECTIONS) + 0.5) / _DIRECTIONS
    angle = _GOLDEN * np.arange(_DIRECTIONS)
    radius = np.sqrt(1 - z**2)
    return np.stack([radius * np.cos(angle), radius * np.sin(angle), z], -1).astype(np.float32)
