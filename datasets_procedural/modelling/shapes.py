"""Shapes as signed distances in px (negative inside), and the share of a pixel that they cover.

The formulas are the exact Euclidean distances collected by I. Quilez, "2D distance functions" (iquilezles.org).
"""

from __future__ import annotations

import math

import numpy as np

from .coordinates import Field


def stripe(x: Field, width: Field | float) -> Field:
    """Return the distance to a stripe of ``width`` px around x = 0."""
    return np.abs(x) - width / 2


def box(x: Field, y: Field, width: Field | float, height: Field | float, radius: float = 0.0) -> Field:
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


def disc(x: Field, y: Field, width: Field | float) -> Field:
    """Return the distance to a disc around the origin, ``width`` px across."""
    return np.asarray(np.hypot(x, y) - width / 2)


def lozenge(x: Field, y: Field, width: float, height: float) -> Field:
    """Return the distance to the sides of a lozenge around the origin (exact but for its tips)."""
    along = np.hypot(width, height)
    return np.asarray((np.abs(x) * height + np.abs(y) * width - width * height / 2) / along)


def capsule(x: Field, y: Field, length: float, width: float) -> Field:
    """Return the distance to a box with round ends, ``length`` px over all along x."""
    return np.asarray(np.hypot(np.maximum(np.abs(x) - (length - width) / 2, 0), y) - width / 2)


def turned(x: Field, y: Field, degrees: float) -> tuple[Field, Field]:
    """Return the coordinates along axes turned by ``degrees`` from x towards y."""
    cos, sin = math.cos(math.radians(degrees)), math.sin(math.radians(degrees))
    return x * cos + y * sin, y * cos - x * sin


def coverage(distance: Field) -> Field:
    """Return the share in [0, 1] of a pixel on the inner side of a straight edge ``distance`` px from its centre.

    The pixel is a box one px wide across the edge. The share is a function of the point alone, so a periodic
    pattern stays exactly periodic at any phase and angle.
    """
    return np.clip(0.5 - distance, 0, 1)
