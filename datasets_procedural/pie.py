"""A pie with a lattice top."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from .modelling.model import Model, Vectors
from .modelling.pattern import Field, Pattern, interlace, mix

_CRUST = (0.62, 0.49, 0.31)
_BROWN = (0.50, 0.34, 0.22)
_FILLING = (0.41, 0.17, 0.18)
_DRAFT = np.array([[True, False], [False, True]])


@dataclass(frozen=True)
class Pie(Model):
    """The top of a pie: strips of crust, woven, over a dark filling. Elements: upright strip, level strip.

    Parameters
    ----------
    period
        Distance from strip to strip in px; the lattice is (period, period), (period, -period).
    strip
        Breadth of a strip in px.
    """

    period: float = 20.3
    strip: float = 12.1

    ranges = {"strip": 4, "period": lambda own: own.strip + 1}

    @property
    def vectors(self) -> Vectors:
        """The vectors to the next equal crossings."""
        return (self.period, self.period), (self.period, -self.period)

    def pattern(self, x: Field, y: Field) -> Pattern:
        """Return strips over the filling; the origin is a crossing where the upright one lies above."""
        strips = interlace(x, y, (self.period, self.period), self.period - self.strip, _DRAFT, depth=0.3)
        layers = []
        for name, strip in zip(("upright", "level"), strips, strict=True):
            baked = mix(np.exp(np.minimum(strip.distance, 0) / (0.14 * self.strip)), _CRUST, _BROWN)
            layers.append(strip.layer(name, baked))
        return Pattern(_FILLING, tuple(layers))
