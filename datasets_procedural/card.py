"""Punched cards."""

from __future__ import annotations

from dataclasses import dataclass

from .modelling.model import RectangularModel
from .modelling.pattern import Field, Layer, Pattern, box, cells, coverage, hats

_HOLE = (0.25, 0.24, 0.26)
_PAPER = (0.62, 0.58, 0.47)


@dataclass(frozen=True)
class Card(RectangularModel):
    """A punched card: columns of tall holes. Elements: hole, and the paper around each hole.

    Parameters
    ----------
    width, height
        Distance from hole to hole along and across a row in px.
    hole
        Breadth of a hole as a share of ``width``, from 0.2 to 0.8.
    """

    width: float = 12.7
    height: float = 27.4
    hole: float = 0.42

    ranges = {"width": 6, "height": 6, "hole": (0.2, 0.8)}

    def pattern(self, x: Field, y: Field) -> Pattern:
        """Return holes in paper; the origin is the middle of a hole."""
        index, (right, down) = cells(x, y, self.width, self.height)
        hole = coverage(box(right, down, self.hole * self.width, 0.66 * self.height, radius=0.8))
        around = hats(x / self.width, y / self.height)
        paper = (Layer("paper", index, weight * (1 - hole), _PAPER) for index, weight in around)
        return Pattern(_PAPER, (Layer("hole", index, hole, _HOLE), *paper))
