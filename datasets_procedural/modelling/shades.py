"""Shades: how light falls on an element, and how its colors mix."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import ArrayLike, NDArray

from .coordinates import Field


def rim(distance: Field, depth: float, width: float) -> Field:
    """Return a shade in [1 - depth, 1]: darkest at the edge, fading over ``width`` px towards the inside."""
    return np.asarray(1 - depth * np.exp(np.minimum(distance, 0) / width))


def round_profile(x: Field, width: float, depth: float) -> Field:
    """Return a shade in [1 - depth, 1]: that of a round thread of ``width`` px, lit from the front."""
    return np.asarray(1 - depth * (1 - np.sqrt(np.maximum(1 - (2 * x / width) ** 2, 0))))


def bevel(distance: Field, x: Field, y: Field, depth: float, width: float) -> Field:
    """Return a shade in [1 - depth, 1 + depth]: an edge ``width`` px broad, lit from the upper left.

    ``(x, y)`` points from the middle of the element; ``distance`` is that to its outline, negative inside.
    """
    away = np.maximum(np.hypot(x, y), 1e-9)
    near = np.exp(-((np.minimum(distance, 0) / width) ** 2))
    return np.asarray(1 - depth * near * (x + y) / away / math.sqrt(2))


def mix(share: Field, under: ArrayLike, over: ArrayLike) -> NDArray[np.float64]:
    """Return the color ``under`` where ``share`` is 0, and ``over`` where it is 1, ``(H, W, 3)``."""
    weight = np.asarray(share)[..., np.newaxis]
    return np.asarray((1 - weight) * np.asarray(under) + weight * np.asarray(over))


def hue_turn(degrees: float) -> NDArray[np.float64]:
    """Return the matrix that turns colors around the gray axis; the mean of their channels stays."""
    angle = math.radians(degrees)
    third, across = 1 / 3, math.sin(angle) / math.sqrt(3)
    cross = np.array([[0.0, -1, 1], [1, 0, -1], [-1, 1, 0]])
    return np.asarray(math.cos(angle) * (np.eye(3) - third) + third + across * cross)
