"""A knotted carpet."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from nrbench.errors import require

from .modelling.model import Model, Vectors
from .modelling.pattern import Field, Layer, Pattern, box, cells, coverage, rim

_COLORS = np.array([(0.50, 0.20, 0.22), (0.20, 0.23, 0.36), (0.60, 0.50, 0.34), (0.34, 0.39, 0.28)])
_WARP = (0.25, 0.20, 0.19)


@dataclass(frozen=True)
class Carpet(Model):
    """A carpet: small knots whose colors make medallions between stars. Element: knot.

    Parameters
    ----------
    knot
        Distance from knot to knot in px.
    knots
        Number of knots of a medallion along x and y, even, from 6 to 40. Every row of medallions is shifted by half a
        medallion.
    """

    knot: float = 3.7
    knots: int = 12

    breadth = ("knot", 1)

    ranges = {"knot": 3}

    def _check_parameters(self) -> None:
        super()._check_parameters()
        require(self.knots in range(6, 41, 2), f"knots is {self.knots}; give an even number from 6 to 40")

    @property
    def vectors(self) -> Vectors:
        """The vectors to the next medallion along the row, and in the next row."""
        side = self.knots * self.knot
        return (side, 0.0), (side / 2, side)

    def pattern(self, x: Field, y: Field) -> Pattern:
        """Return knots; the origin is the middle of a medallion."""
        (i, j), (right, down) = cells(x, y, self.knot, self.knot)
        row = np.floor(j / self.knots + 0.5)
        du = np.abs((i / self.knots - row / 2 + 0.5) % 1 - 0.5)
        dv = np.abs(j / self.knots - row)
        medal, star = du + dv, np.maximum(du, dv) + 0.4 * np.minimum(du, dv)
        color = np.select([medal < 0.13, medal < 0.27, medal < 0.36, star > 0.52], [2, 0, 2, 3], 1)
        distance = box(right, down, self.knot - 0.6, self.knot - 0.6, radius=1.0)
        shade = rim(distance, 0.35, 0.8)
        return Pattern(_WARP, (Layer("knot", (i, j), coverage(distance), _COLORS[color], shade),))
