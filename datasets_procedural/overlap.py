"""Squares over hexagons."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from .modelling.model import Model, Vectors
from .modelling.pattern import Field, Layer, Pattern, box, cells, coverage, hexagon, honeycomb

_SQUARE = (0.60, 0.49, 0.25)
_HEXAGON = (0.30, 0.39, 0.49)
_GROUND = (0.58, 0.58, 0.56)


@dataclass(frozen=True)
class Overlap(Model):
    """Square frames over hexagonal tiles: two lattices, whose smallest common cell holds 25 squares and 56 hexagons.

    Five squares are as wide as seven hexagons and as high as four double rows of hexagons, stretched by 1 %.
    ``Texture.lattices`` holds the common lattice, that of the squares and that of the hexagons. Elements: square,
    hexagon.

    Parameters
    ----------
    period
        Distance from square to square in px; the common cell is 5 periods wide and high.
    """

    period: float = 37.3

    ranges = {"period": 14}
    breadth = ("period", 5 / 7)

    @property
    def vectors(self) -> Vectors:
        """The generating vectors of the common lattice."""
        return (5 * self.period, 0.0), (0.0, 5 * self.period)

    def sublattices(self) -> tuple[Vectors, ...]:
        """Return the lattice of the squares, and that of the hexagons."""
        width, rise = 5 / 7 * self.period, 5 / 4 * self.period
        return ((self.period, 0.0), (0.0, self.period)), ((width, 0.0), (width / 2, rise / 2))

    def kind_vectors(self, name: str) -> Vectors:
        """Return the generating vectors of the lattice of one kind, before rotation."""
        return self.sublattices()[("square", "hexagon").index(name)]

    def pattern(self, x: Field, y: Field) -> Pattern:
        """Return frames over tiles; the origin is the middle of a square and of a hexagon."""
        square, (right, down) = cells(x, y, self.period, self.period)
        frame = np.abs(box(right, down, 0.7 * self.period, 0.7 * self.period)) - 0.055 * self.period
        over = coverage(frame)
        squeeze = 7 / 4 / math.sqrt(3)
        tile, (aside, below) = honeycomb(x, y / squeeze, self.element_size)
        under = coverage(hexagon(aside, below, self.element_size - 2)) * (1 - over)
        return Pattern(_GROUND, (Layer("square", square, over, _SQUARE), Layer("hexagon", tile, under, _HEXAGON)))
