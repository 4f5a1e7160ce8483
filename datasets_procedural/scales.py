"""Fish-scale tiles."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from .modelling.model import Model, Vectors
from .modelling.pattern import Field, Index, Layer, Pattern, coverage, disc, rim

_SCALE = (0.39, 0.52, 0.54)
_GAP = (0.22, 0.25, 0.28)


@dataclass(frozen=True)
class Scales(Model):
    """Fish-scale tiles: each row hangs over the one below it, shifted by half a scale. Element: scale.

    Parameters
    ----------
    width
        Distance from scale to scale along a row in px; rows are half as far apart.
    gap
        Width of the dark gap between scales in px, at least 1.
    """

    width: float = 26.9
    gap: float = 1.8

    ranges = {"gap": 1, "width": lambda own: 6 * own.gap}

    @property
    def vectors(self) -> Vectors:
        """The vectors along a row, and to the next one."""
        return (self.width, 0.0), (self.width / 2, self.width / 2)

    def pattern(self, x: Field, y: Field) -> Pattern:
        """Return scales, each a disc under the two above it; the origin is the middle of a disc."""
        row = np.floor(y / (self.width / 2)).astype(np.int64)
        above, below = self._scale(x, y, row), self._scale(x, y, row + 1)
        over = above[1] <= 0
        i, distance = (np.where(over, *pair) for pair in zip(above, below, strict=True))
        seam = self.gap / 2 - np.abs(above[1])
        shade = 1 - 0.45 * np.exp(-np.maximum(above[1], 0) / (0.12 * self.width)) * ~over
        ribs = 1 + 0.12 * np.cos(2 * np.pi * distance / (0.17 * self.width))
        index = i, np.where(over, row, row + 1)
        shade = 0.85 * shade * ribs * rim(seam, 0.2, 1.0)
        return Pattern(_GAP, (Layer("scale", index, coverage(seam), _SCALE, shade),))

    def _scale(self, x: Field, y: Field, row: Index) -> tuple[Index, Field]:
        """Return the nearest scale of a row, and the distance to its disc."""
        i = np.rint(x / self.width - row / 2).astype(np.int64)
        return i, disc(x - (i + row / 2) * self.width, y - row * self.width / 2, self.width)
