"""A knotted mat."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from .modelling.model import Model, Vectors
from .modelling.pattern import Field, Layer, Pattern, capsule, coverage, round_profile, split_period, stripe

_ROPE = (0.60, 0.52, 0.38)
_KNOT = (0.56, 0.44, 0.30)
_FLOOR = (0.23, 0.20, 0.18)


@dataclass(frozen=True)
class Mat(Model):
    """A mat of ropes that wind from side to side, knotted where they meet. Elements: rope, knot.

    Parameters
    ----------
    width
        Distance from rope to rope in px.
    height
        Distance from knot to knot along a rope in px; the lattice is (width, height), (width, -height).
    rope
        Breadth of a rope in px.
    """

    width: float = 21.7
    height: float = 17.3
    rope: float = 8.3

    breadth = ("rope", 1)
    ranges = {"rope": 3, "width": lambda own: 2 * own.rope, "height": lambda own: own.rope}

    @property
    def vectors(self) -> Vectors:
        """The vectors from a knot to the next ones, on the next rope."""
        return (self.width, self.height), (self.width, -self.height)

    def pattern(self, x: Field, y: Field) -> Pattern:
        """Return ropes and knots on a floor; the origin lies on a rope."""
        number = np.pi / self.height
        i = np.rint(x / self.width).astype(np.int64)
        swing = np.where(i % 2 == 0, 0.5, -0.5) * (self.width - 0.7 * self.rope)
        slope = swing * number * np.cos(number * y)
        aside = (x - i * self.width - swing * np.sin(number * y)) / np.hypot(1, slope)
        across, right = split_period(x - self.width / 2, self.width)
        along, down = split_period(y - np.where(across % 2 == 0, 0.5, 1.5) * self.height, 2 * self.height)
        distance = capsule(right, down, 1.75 * self.rope, 1.05 * self.rope)
        knot = coverage(distance)
        twist = 0.82 + 0.18 * np.cos(8 * number * y + 5 * aside / self.rope)
        turns = 0.8 + 0.2 * np.cos(2 * np.pi * (right / self.rope * 1.7 + down / self.rope * 0.6))
        rope = coverage(stripe(aside, self.rope)) * (1 - knot)
        strands = Layer("rope", (i,), rope, _ROPE, twist * round_profile(aside, self.rope, 0.4))
        knots = Layer("knot", (across, along), knot, _KNOT, turns * round_profile(down, 1.05 * self.rope, 0.4))
        return Pattern(_FLOOR, (strands, knots))
