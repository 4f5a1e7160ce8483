"""Corduroy."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from .modelling.model import RectangularModel
from .modelling.pattern import Field, Layer, Pattern, coverage, round_profile, split_period, stripe

_PILE = (0.52, 0.41, 0.28)
_GROUND = (0.28, 0.22, 0.18)


@dataclass(frozen=True)
class Corduroy(RectangularModel):
    """Corduroy: upright cords of pile, tufted along their length. Element: tuft.

    Parameters
    ----------
    width
        Distance from cord to cord in px.
    tuft
        Distance from tuft to tuft along a cord in px.
    """

    width: float = 14.3
    tuft: float = 5.9

    sides = ("width", "tuft")
    ranges = {"width": 5, "tuft": 3}
    breadth = ("tuft", 1)

    def pattern(self, x: Field, y: Field) -> Pattern:
        """Return tufts in cords; the origin is the middle of one."""
        i, right = split_period(x, self.width)
        k, along = split_period(y + 0.35 * np.abs(right), self.tuft)
        cord = coverage(stripe(right, 0.78 * self.width))
        shade = round_profile(right, 0.8 * self.width, 0.4) * (0.86 + 0.14 * np.cos(2 * np.pi * along / self.tuft))
        return Pattern(_GROUND, (Layer("tuft", (i, k), cord, _PILE, shade),))
