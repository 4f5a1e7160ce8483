"""Cans seen from above."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Literal

import numpy as np

from .modelling.model import Model, Vectors
from .modelling.pattern import Field, Layer, Pattern, capsule, cells, coverage, disc, honeycomb, mix

_LID = (0.46, 0.46, 0.45)
_TAB = (0.44, 0.44, 0.46)
_MOUTH = (0.30, 0.30, 0.32)
_CRATE = (0.23, 0.21, 0.20)


@dataclass(frozen=True)
class Cans(Model):
    """Drink cans seen from above, packed in a crate. Element: can.

    Parameters
    ----------
    period
        Distance from can to can in px.
    packing
        ``"hexagonal"`` or ``"square"``.
    """

    period: float = 28.3
    packing: Literal["hexagonal", "square"] = "hexagonal"

    ranges = {"period": 12}

    @property
    def vectors(self) -> Vectors:
        """The vectors to the next cans."""
        p = self.period
        return (p, 0.0), ((p / 2, p * math.sqrt(3) / 2) if self.packing == "hexagonal" else (0.0, p))

    def pattern(self, x: Field, y: Field) -> Pattern:
        """Return cans in the crate; the origin is the middle of a can."""
        p = self.period
        index, (right, down) = honeycomb(x, y, p) if self.packing == "hexagonal" else cells(x, y, p, p)
        outline, radius = disc(right, down, 0.97 * p), np.hypot(right, down) / p
        mouth = capsule(right, down - 0.17 * p, 0.27 * p, 0.18 * p)
        tab = capsule(down + 0.06 * p, right, 0.3 * p, 0.17 * p)
        color = mix(coverage(tab), mix(coverage(mouth), _LID, _MOUTH), _TAB)
        rims = 0.24 * np.exp(-(((radius - 0.45) / 0.025) ** 2)) - 0.42 * np.exp(-(((radius - 0.385) / 0.03) ** 2))
        gleam = 0.14 * np.cos(2 * np.arctan2(down, right) + 1.2) * np.minimum(radius / 0.3, 1)
        return Pattern(_CRATE, (Layer("can", index, coverage(outline), color, 0.98 + rims + gleam),))
