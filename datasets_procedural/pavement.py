"""A pavement."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Literal

import numpy as np

from .modelling.model import Model, Vectors
from .modelling.pattern import Field, Layer, Pattern, box, cells, coverage, lozenge, rim

_STONE = (0.54, 0.50, 0.46)
_SMALL = (0.41, 0.36, 0.36)
_SAND = (0.28, 0.26, 0.23)
_LATTICES: dict[str, Vectors] = {
    "herringbone": ((1, 1), (2, -2)),
    "basket": ((2, 2), (2, -2)),
    "octagon": ((2, 0), (0, 2)),
}


@dataclass(frozen=True)
class Pavement(Model):
    """A pavement of stones, twice as long as wide, or of octagons and squares. Elements: stone, small stone.

    Parameters
    ----------
    width
        Breadth of a stone with its joint in px; half the distance from octagon to octagon.
    joint
        Width of the sand joints in px, at least 1.
    style
        ``"herringbone"``, ``"basket"`` (pairs of stones, horizontal and vertical in turn) or ``"octagon"``.
    """

    width: float = 13.3
    joint: float = 1.8
    style: Literal["herringbone", "basket", "octagon"] = "octagon"

    breadth = ("width", 1)
    ranges = {"joint": 1, "width": lambda own: 2 * own.joint + 2}

    @property
    def vectors(self) -> Vectors:
        """The vectors to the next stones of the same orientation."""
        (a, b), (c, d) = _LATTICES[self.style]
        return (a * self.width, b * self.width), (c * self.width, d * self.width)

    def pattern(self, x: Field, y: Field) -> Pattern:
        """Return stones on sand."""
        if self.style == "octagon":
            return self._octagons(x, y)
        (i, j), (right, down) = cells(x, y, self.width, self.width)
        if self.style == "herringbone":
            part = (i - j) % 4
            lying, far_x, far_y = part < 2, part == 1, part == 2
        else:
            lying = (i // 2 + j // 2) % 2 == 0
            far_x, far_y = lying & (i % 2 == 1), ~lying & (j % 2 == 1)
        half = self.width / 2
        along = right + np.where(lying, np.where(far_x, half, -half), 0)
        across = down + np.where(lying, 0, np.where(far_y, half, -half))
        long, short = 2 * self.width - self.joint, self.width - self.joint
        distance = box(along, across, np.where(lying, long, short), np.where(lying, short, long), radius=1.0)
        index = i - far_x, j - far_y
        return Pattern(_SAND, (Layer("stone", index, coverage(distance), _STONE, rim(distance, 0.2, 1.5)),))

    def _octagons(self, x: Field, y: Field) -> Pattern:
        period = 2 * self.width
        index, (right, down) = cells(x, y, period, period)
        tips = 1.42 * period - math.sqrt(2) * self.joint
        stone = np.maximum(box(right, down, period - self.joint, period - self.joint), lozenge(right, down, tips, tips))
        corner, (aside, below) = cells(x - self.width, y - self.width, period, period)
        tip = 0.58 * period - math.sqrt(2) * self.joint
        small = lozenge(aside, below, tip, tip)
        stones = Layer("stone", index, coverage(stone), _STONE, rim(stone, 0.2, 1.5))
        return Pattern(_SAND, (stones, Layer("small stone", corner, coverage(small), _SMALL, rim(small, 0.2, 1.5))))
