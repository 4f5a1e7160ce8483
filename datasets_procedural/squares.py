"""Nested squares."""

from __future__ import annotations

from dataclasses import dataclass

from .modelling.model import SquareModel
from .modelling.pattern import Field, Layer, Pattern, box, cells, coverage

_OUTER = (0.56, 0.30, 0.26)
_MIDDLE = (0.60, 0.55, 0.44)
_INNER = (0.26, 0.33, 0.44)
_GROUND = (0.36, 0.36, 0.34)


@dataclass(frozen=True)
class Squares(SquareModel):
    """Nested squares: three in each other, in straight rows. Elements: outer, middle, inner square.

    Parameters
    ----------
    period
        Distance from square to square in px.
    """

    period: float = 27.7

    ranges = {"period": 12}

    def pattern(self, x: Field, y: Field) -> Pattern:
        """Return squares on a ground; the origin is the middle of three nested ones."""
        index, (right, down) = cells(x, y, self.period, self.period)
        sides = (share * self.period for share in (0.84, 0.56, 0.28))
        outer, middle, inner = (coverage(box(right, down, side, side)) for side in sides)
        frames = Layer("outer", index, outer - middle, _OUTER), Layer("middle", index, middle - inner, _MIDDLE)
        return Pattern(_GROUND, (*frames, Layer("inner", index, inner, _INNER)))
