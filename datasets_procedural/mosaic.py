"""A mosaic."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from .modelling.model import SquareModel
from .modelling.pattern import Field, Index, Layer, Pattern, coverage, rim
from .modelling.random_fields import role_seed, uniform

_COLORS = np.array([(0.58, 0.39, 0.25), (0.60, 0.56, 0.47), (0.26, 0.39, 0.47), (0.52, 0.25, 0.23)])
_NEAR = [(a, b) for b in (-1, 0, 1) for a in (-1, 0, 1)]
_GROUT = (0.31, 0.30, 0.30)


@dataclass(frozen=True)
class Mosaic(SquareModel):
    """A mosaic: rings of small uneven stones, the same in every cell. Element: stone.

    Parameters
    ----------
    period
        Distance from rosette to rosette in px.
    stones
        Number of stones along a side of the cell, from 3 to 12.
    joint
        Width of the grout in px, at least 1.
    """

    period: float = 47.3
    stones: int = 6
    joint: float = 1.4

    ranges = {"stones": (3, 12), "joint": 1, "period": lambda own: 3 * own.joint * own.stones}

    @property
    def element_size(self) -> float:
        """The breadth of a stone."""
        return self.period / self.stones

    def pattern(self, x: Field, y: Field) -> Pattern:
        """Return stones on grout, each the Voronoi cell of its middle; the origin is the middle of a rosette."""
        u, v = x / self.element_size, y / self.element_size
        i, j = np.rint(u).astype(np.int64), np.rint(v).astype(np.int64)
        offsets = self._offsets(i, j, u - i, v - j)
        squares = (offsets**2).sum(1)
        first, mine = squares.argmin(0), squares.min(0)
        own = np.take_along_axis(offsets, first[np.newaxis, np.newaxis], 0)
        apart = np.sqrt(((offsets - own) ** 2).sum(1))
        seam = np.where(apart > 1e-6, (squares - mine) / np.maximum(2 * apart, 1e-6), np.inf).min(0)
        index = i + np.array(_NEAR)[first, 0], j + np.array(_NEAR)[first, 1]
        distance = self.joint / 2 - seam * self.element_size
        color = _COLORS[self._ring(*index)]
        return Pattern(_GROUT, (Layer("stone", index, coverage(distance), color, rim(distance, 0.15, 1.0)),))

    def _offsets(self, i: Index, j: Index, du: Field, dv: Field) -> Field:
        """Return the vectors, in stones, from each point to the middles of the nine stones nearby, ``(9, 2, ...)``."""
        n = self.stones
        uneven = 0.16 * uniform(role_seed(n, "stones"), *np.indices((2, n, n)))
        place = (i % n) * n + j % n
        offsets = []
        for a, b in _NEAR:
            dx, dy = np.roll(uneven, (-a, -b), (1, 2)).reshape(2, -1)
            offsets.append(np.stack([(dx + a).take(place) - du, (dy + b).take(place) - dv]))
        return np.stack(offsets)

    def _ring(self, i: Index, j: Index) -> Index:
        n = self.stones
        du, dv = (part - n * np.rint(part / n) for part in (i, j))
        return np.asarray(np.rint(np.hypot(du, dv)).astype(np.int64) % len(_COLORS))
