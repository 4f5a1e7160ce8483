"""Faults of appearance: content that lies in its place and looks wrong there."""

from __future__ import annotations

import math

import numpy as np
from scipy.ndimage import gaussian_filter

from .planting import Planting, Plot

_BLUR = 8.0
_SEAM_REACH = 16.0


def missing_tile(plot: Plot) -> Planting:
    """Cover one cell with its mean color."""
    covered, fresh = plot.cell(), plot.fresh()
    image = np.array(fresh)
    image[covered] += np.float32(plot.size) * (image[covered].mean(0) - image[covered])
    return Planting(image, plot.still(), covered & (image != fresh).any(), f"opacity {plot.size:g}")


def blurred_band(plot: Plot) -> Planting:
    """Blur a band, a quarter of the output wide."""
    axis = int(plot.rng.integers(2))
    width = max(plot.shape[axis] // 4, 1)
    start = int(plot.rng.integers(plot.shape[axis] - width + 1))
    covered = np.zeros(plot.shape, np.bool_)
    np.moveaxis(covered, axis, 0)[start : start + width] = True
    fresh, deviation = plot.fresh(), _BLUR * plot.size
    image = np.array(fresh)
    if deviation:
        image[covered] = gaussian_filter(image, (deviation, deviation, 0), mode="mirror")[covered]
    return Planting(image, plot.still(), covered & (image != fresh).any(), f"standard deviation {deviation:g} px")


def seam(plot: Plot) -> Planting:
    """Brighten one side of a line, darken the other, less and less away from it."""
    angle = plot.rng.uniform(0, 2 * math.pi)
    beyond = (plot.pixels() - plot.middling()) @ np.array([math.cos(angle), math.sin(angle)])
    weight = np.maximum(1 - np.abs(beyond) / _SEAM_REACH, 0)
    change = plot.size / 2 * np.where(beyond >= 0, weight, -weight)
    image = np.clip(plot.fresh() + change[..., np.newaxis].astype(np.float32), 0, 1)
    return Planting(image, plot.still(), (weight > 0) & (plot.size > 0), f"contrast {plot.size:g}")


def color_mean(plot: Plot) -> Planting:
    """Add one color everywhere, of random proportions, to each channel the way where it has more room."""
    proportions = plot.rng.uniform(0.2, 1, 3)
    fresh = plot.fresh()
    mean = fresh.mean((0, 1), np.float64)
    direction = np.where(mean < 0.5, 1, -1) * proportions[: len(mean)]
    change = plot.size * direction / np.hypot.reduce(direction)
    image = np.clip(fresh + change.astype(np.float32), 0, 1)
    reached = float(np.hypot.reduce(image.mean((0, 1), np.float64) - mean))
    covered = np.full(plot.shape, plot.size > 0)
    return Planting(image, plot.still(), covered, f"{plot.size:g} ({reached:.3f} after clipping)")
