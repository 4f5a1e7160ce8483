"""Striped toothpaste."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from .modelling.model import RectangularModel
from .modelling.pattern import Field, Layer, Pattern, coverage, round_profile, split_period, stripe

_COLORS = np.array([(0.62, 0.62, 0.61), (0.58, 0.23, 0.25), (0.62, 0.62, 0.61), (0.23, 0.47, 0.50)])
_GAP = (0.28, 0.30, 0.33)


@dataclass(frozen=True)
class Toothpaste(RectangularModel):
    """Toothpaste in strands side by side: white, red, white and green stripes wind around each strand. Element: stripe.

    Parameters
    ----------
    width
        Distance from strand to strand in px.
    turn
        Length in px of one turn of the four stripes.
    """

    width: float = 19.3
    turn: float = 37.9

    sides = ("width", "turn")
    ranges = {"width": 6, "turn": 12}
    breadth = ("turn", 1 / 4)

    def pattern(self, x: Field, y: Field) -> Pattern:
        """Return stripes on a dark gap; the origin is the middle of a white stripe."""
        i, right = split_period(x, self.width)
        around = np.arcsin(np.clip(2 * right / self.width, -1, 1)) / np.pi
        k, along = split_period(y - 0.5 * self.turn * around, self.turn / 4)
        strand = coverage(stripe(right, self.width - 1.5)) * coverage(stripe(along, self.turn / 4 - 0.3))
        shade = round_profile(right, self.width, 0.4)
        return Pattern(_GAP, (Layer("stripe", (i, k), strand, _COLORS[k % 4], shade),))
