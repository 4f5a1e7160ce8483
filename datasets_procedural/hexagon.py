"""Hexagonal tiles."""

from __future__ import annotations

import math
from dataclasses import dataclass

from nrbench.lattice.geometry import Vector

from .coordinates import Field, honeycomb
from .model import Model, check
from .pattern import Layer, Pattern
from .shapes import coverage, hexagon, rim

_GLAZE = (0.32, 0.46, 0.52)
_GROUT = (0.78, 0.77, 0.73)


@dataclass(frozen=True)
class Hexagon(Model):
    """Regular hexagonal tiles, a net of grout between them. Element: tile.

    Parameters
    ----------
    period
        From a tile's centre to the next in px: the lattice is (period, 0), (period / 2, period sqrt(3) / 2).
    joint
        Width of the grout in px, at least 1.
    """

    period: float = 26.2
    joint: float = 2.4

    def __post_init__(self) -> None:
        super().__post_init__()
        check(self.joint >= 1, f"joint is {self.joint} px; give at least 1")
        least = self.joint + 2
        check(least <= self.period < 1e4, f"period is {self.period} px; give at least joint + 2 = {least:g}")

    @property
    def vectors(self) -> tuple[Vector, Vector]:
        """To the next tile on the right, and to the one below it."""
        return (self.period, 0.0), (self.period / 2, self.period * math.sqrt(3) / 2)

    def pattern(self, x: Field, y: Field) -> Pattern:
        """Return tiles on grout; the origin is the middle of a tile."""
        index, (right, down) = honeycomb(x, y, self.period)
        distance = hexagon(right, down, self.period - self.joint, radius=0.5)
        return Pattern(_GROUT, (Layer("tile", index, coverage(distance), _GLAZE, rim(distance, 0.2, 1.5)),))
