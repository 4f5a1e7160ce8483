"""Glazed wall tiles."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from .modelling.model import SquareModel
from .modelling.pattern import Field, Layer, Pattern, bevel, box, cells, coverage, mix

_GLAZE = (0.55, 0.55, 0.52)
_BLUE = (0.25, 0.33, 0.52)
_OCHRE = (0.60, 0.46, 0.23)
_GROUT = (0.44, 0.43, 0.42)


@dataclass(frozen=True)
class Ceramic(SquareModel):
    """Glazed ceramic tiles with a painted flower. Element: tile.

    Parameters
    ----------
    period
        Distance from tile to tile in px.
    joint
        Width of the grout in px, at least 1.
    """

    period: float = 29.3
    joint: float = 2.0

    ranges = {"joint": 1, "period": lambda own: 6 * own.joint}

    def pattern(self, x: Field, y: Field) -> Pattern:
        """Return tiles on grout; the origin is the middle of a tile."""
        index, (right, down) = cells(x, y, self.period, self.period)
        side = self.period - self.joint
        distance = box(right, down, side, side, radius=1.0)
        radius, angle = np.hypot(right, down), np.arctan2(down, right)
        petals = radius - side * (0.24 + 0.12 * np.cos(4 * angle))
        corner = side * 0.24 - np.hypot(np.abs(right) - side / 2, np.abs(down) - side / 2)
        ring = np.abs(corner + 0.05 * side) - 0.035 * side
        painted = mix(coverage(np.minimum(petals, -corner)), mix(coverage(ring), _GLAZE, _BLUE), _BLUE)
        color = mix(coverage(radius - 0.1 * side), painted, _OCHRE)
        shade = bevel(distance, right, down, 0.2, 1.5)
        return Pattern(_GROUT, (Layer("tile", index, coverage(distance), color, shade),))
