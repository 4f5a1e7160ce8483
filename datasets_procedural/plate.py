"""Metal tread plate."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from .modelling.model import Model, Vectors
from .modelling.pattern import Field, Layer, Pattern, bevel, cells, coverage, hats, lozenge, rotate

_STEEL = (0.49, 0.50, 0.52)


@dataclass(frozen=True)
class Plate(Model):
    """Metal tread plate: raised lozenges at right angles to each other. Elements: lozenge, and the sheet around it.

    Parameters
    ----------
    period
        Distance from lozenge to lozenge along x and along y in px; the lattice is (period, period), (period, -period).
    """

    period: float = 19.7

    ranges = {"period": 8}

    @property
    def vectors(self) -> Vectors:
        """The vectors to the next lozenges of the same orientation."""
        return (self.period, self.period), (self.period, -self.period)

    def pattern(self, x: Field, y: Field) -> Pattern:
        """Return lozenges on the sheet; the origin is the middle of one."""
        (i, j), (right, down) = cells(x, y, self.period, self.period)
        lean = np.where((i + j) % 2 == 0, 1.0, -1.0)
        along, across = rotate(right, lean * down, 45.0)
        distance = lozenge(along, across, 1.12 * self.period, 0.46 * self.period)
        raised = coverage(distance)
        shade = bevel(distance, right, down, 0.32, 0.11 * self.period)
        around = hats(x / self.period, y / self.period)
        shadow = 1 - 0.55 * np.exp(-np.maximum(distance, 0) / (0.08 * self.period)) * (right + down > 0)
        sheet = (Layer("sheet", index, weight * (1 - raised), _STEEL, shadow * 0.85) for index, weight in around)
        return Pattern(_STEEL, (Layer("lozenge", (i, j), raised, _STEEL, shade), *sheet))
