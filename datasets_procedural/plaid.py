"""Plaid cloth."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from nrbench.lattice.geometry import Vector

from .modelling.checks import check_sizes
from .modelling.coordinates import Field, boxes
from .modelling.model import Model
from .modelling.pattern import Layer, Pattern
from .modelling.shapes import coverage, stripe

_COLORS = np.array([(0.54, 0.20, 0.22), (0.18, 0.23, 0.31), (0.20, 0.34, 0.26), (0.62, 0.57, 0.31)])
_SETT = (0.42, 0.08, 0.26, 0.08, 0.16)
_DYES = np.array([0, 3, 1, 2, 1])
_GROUND = (0.23, 0.22, 0.22)


@dataclass(frozen=True)
class Plaid(Model):
    """Plaid: bands of color, upright and level, that show through each other. Elements: upright, level band.

    Parameters
    ----------
    period
        From sett to sett in px, both ways.
    """

    period: float = 36.1

    def __post_init__(self) -> None:
        super().__post_init__()
        check_sizes(self, period=12)

    @property
    def vectors(self) -> tuple[Vector, Vector]:
        """Along both kinds of bands."""
        return (self.period, 0.0), (0.0, self.period)

    @property
    def element_size(self) -> float:
        """The breadth of a middling band."""
        return self.period / 4

    def pattern(self, x: Field, y: Field) -> Pattern:
        """Return bands, each with half of every pixel; the origin is the middle of a broad upright and level one."""
        layers = []
        for name, at in (("upright", x), ("level", y)):
            k, along, width = boxes(at, tuple(share * self.period for share in _SETT))
            seen = 0.5 * coverage(stripe(along, width))
            layers.append(Layer(name, (np.broadcast_to(k, seen.shape),), seen, _COLORS[_DYES[k % len(_SETT)]]))
        return Pattern(_GROUND, tuple(layers))
