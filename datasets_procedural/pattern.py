"""The pattern: what a model looks like without departures, element by element."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from nrbench.imaging.door import Image

from .coordinates import Field, Index


@dataclass(frozen=True)
class Layer:
    """One kind of element, as seen at each point.

    Parameters
    ----------
    name
        The kind: ``"brick"``.
    index
        Which element it is: one whole number a point for each part of the index.
    coverage
        The share in [0, 1] of each pixel that the element covers, visibly: those of all layers add up to at most 1.
    color
        Expected color in [0, 1], broadcastable to ``(H, W, 3)``.
    shade
        A factor of the color at each point.
    """

    name: str
    index: tuple[Index, ...]
    coverage: Field
    color: ArrayLike
    shade: Field | float = 1.0

    def paint(self) -> Image:
        """Return what the layer adds to the ideal image."""
        weight = np.asarray(self.coverage * self.shade, np.float32)[..., np.newaxis]
        return weight * np.asarray(self.color, np.float32)


@dataclass(frozen=True)
class Pattern:
    """What a model looks like without departures: layers of elements on a ground.

    Parameters
    ----------
    ground
        The color between the elements, broadcastable to ``(H, W, 3)``.
    layers
        Kinds of element; no two at the same pixel are the same element.
    """

    ground: ArrayLike
    layers: tuple[Layer, ...]

    def bare(self) -> Image:
        """Return the ground where no element covers it."""
        covered = np.sum([layer.coverage for layer in self.layers], 0)
        return np.asarray((1 - covered)[..., np.newaxis] * np.asarray(self.ground), np.float32)
