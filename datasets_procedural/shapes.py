"""Shapes as signed distances in px (negative inside), and the share of a pixel that they cover.

The formulas are the exact Euclidean distances collected by I. Quilez, "2D distance functions" (iquilezles.org).
"""

from __future__ import annotations

import math

import numpy as np

from .coordinates import Field


def stripe(x: Field, width: float) -> Field:
    """Return the distance to a stripe of ``width`` px around x = 0."""
    return np.abs(x) - width / 2


def box(x: Field, y: Field, width: float, height: float, radius: float = 0.0) -> Field:
    """Return the distance to a box around the origin, its corners rounded by ``radius`` px."""
    dx, dy = np.abs(x) - (width / 2 - radius), np.abs(y) - (height / 2 - radius)
    outside = np.hypot(np.maximum(dx, 0), np.maximum(dy, 0))
    return np.asarray(outside + np.minimum(np.maximum(dx, dy), 0) - radius)


def hexagon(x: Field, y: Field, width: float, radius: float = 0.0) -> Field:
    """Return the distance to a regular hexagon around the origin, ``width`` px from flat to flat along x."""
    inner = width / 2 - radius
    along, across = np.abs(y), np.abs(x)
    fold = np.minimum(across / 2 - along * (math.sqrt(3) / 2), 0)
    along, across = along + fold * math.sqrt(3), across - fold
    side = inner / math.sqrt(3)
    ahead = across - inner
    return np.asarray(np.copysign(np.hypot(along - np.clip(along, -side, side), ahead), ahead) - radius)


def coverage(distance: Field) -> Field:
    """Return the share in [0, 1] of a pixel on the inner side of a straight edge ``distance`` px from its centre.

    The pixel is a box one px wide across the edge. The share is a function of the point alone, so a periodic
    pattern stays exactly periodic at any phase and angle.
    """
    return np.clip(0.5 - distance, 0, 1)


def rim(distance: Field, depth: float, width: float) -> Field:
    """Return a shade in [1 - depth, 1]: darkest at the edge, fading over ``width`` px towards the inside."""
    return np.asarray(1 - depth * np.exp(np.minimum(distance, 0) / width))


def round_profile(x: Field, width: float, depth: float) -> Field:
    """Return a shade in [1 - depth, 1]: that of a round thread of ``width`` px, lit from the front."""
    return np.asarray(1 - depth * (1 - np.sqrt(np.maximum(1 - (2 * x / width) ** 2, 0))))
