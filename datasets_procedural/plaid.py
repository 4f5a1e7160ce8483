"""Plaid cloth."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from .modelling.model import SquareModel
from .modelling.pattern import Field, Layer, Pattern, boxes, coverage, stripe

_COLORS = np.array([(0.54, 0.20, 0.22), (0.18, 0.23, 0.31), (0.20, 0.34, 0.26), (0.62, 0.57, 0.31)])
_SETT = (0.42, 0.08, 0.26, 0.08, 0.16)
_DYES = np.array([0, 3, 1, 2, 1])
_GROUND = (0.23, 0.22, 0.22)


@dataclass(frozen=True)
class Plaid(SquareModel):
    """Plaid cloth: upright and level bands of color that show through each other. Elements: upright, level band.

    Parameters
    ----------
    period
        Distance from sett to sett in px, both ways.
    """

    period: float = 36.1

    ranges = {"period": 12}
    breadth = ("period", 1 / 4)

    def pattern(self, x: Field, y: Field) -> Pattern:
        """Return bands that each cover half of a pixel; the origin is the middle of a broad upright and level band."""
        layers = []
        for name, at in (("upright", x), ("level", y)):
            k, along, width = boxes(at, tuple(share * self.period for share in _SETT))
            seen = 0.5 * coverage(stripe(along, width))
            layers.append(Layer(name, (np.broadcast_to(k, seen.shape),), seen, _COLORS[_DYES[k % len(_SETT)]]))
        return Pattern(_GROUND, tuple(layers))
