"""Square crackers."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from .modelling.model import SquareModel
from .modelling.pattern import Field, Layer, Pattern, box, cells, coverage, disc, mix, split_period

_BISCUIT = (0.62, 0.52, 0.36)
_BAKED = (0.52, 0.36, 0.22)
_TRAY = (0.26, 0.23, 0.22)


@dataclass(frozen=True)
class Cracker(SquareModel):
    """Square crackers with nine holes and wavy edges, side by side. Element: cracker.

    Parameters
    ----------
    period
        Distance from cracker to cracker in px.
    gap
        Width of the gap between crackers in px, at least 1.
    """

    period: float = 33.7
    gap: float = 2.4

    ranges = {"gap": 1, "period": lambda own: 16 + own.gap}

    def pattern(self, x: Field, y: Field) -> Pattern:
        """Return crackers on a tray; the origin is the middle of one."""
        index, (right, down) = cells(x, y, self.period, self.period)
        side, number = self.period - self.gap, 2 * np.pi * 6 / self.period
        wavy = 0.02 * self.period * (np.cos(number * right) + np.cos(number * down) - 2)
        distance = box(right, down, side, side, radius=0.12 * side) - wavy
        holes = [np.clip(part, -1.4 * side / 4, 1.4 * side / 4) for part in (right, down)]
        (_, aside), (_, below) = (split_period(part, side / 4) for part in holes)
        beyond = np.hypot(right - holes[0], down - holes[1])
        hole = coverage(disc(np.hypot(aside, beyond), below, 0.075 * side))
        blister = 0.5 + 0.5 * np.cos(2 * np.pi * 4 * right / side) * np.cos(2 * np.pi * 4 * down / side)
        toasted = np.clip(np.exp(distance / (0.07 * side)) + 0.25 * blister, 0, 1)
        color = mix(hole, mix(toasted, _BISCUIT, _BAKED), _TRAY)
        return Pattern(_TRAY, (Layer("cracker", index, coverage(distance), color),))
