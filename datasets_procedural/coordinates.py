"""Coordinates: a model's own axes in the picture, and which cell of a lattice a point lies in."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from nrbench.lattice.geometry import Vector
from nrbench.texture import Shape

Field = NDArray[np.float64]
"""One number for each point, any shape; usually ``(H, W)``."""
Index = NDArray[np.int64]
"""One whole number for each point: a part of an element's index."""
Local = tuple[Field, Field]
"""(x, y) in px from the centre of the cell that a point lies in."""


@dataclass(frozen=True)
class Frame:
    """Where a model's axes lie in the picture.

    Parameters
    ----------
    origin
        The picture's point (x, y) px of the model's origin.
    rotation
        Degrees from the picture's x axis to the model's, positive towards y (clockwise on the screen).
    """

    origin: Vector = (0.0, 0.0)
    rotation: float = 0.0

    def grid(self, shape: Shape) -> tuple[Field, Field]:
        """Return the model's coordinates (x, y) px of each pixel centre, two arrays of ``shape``."""
        x = np.arange(shape[1]) - self.origin[0]
        y = np.arange(shape[0])[:, np.newaxis] - self.origin[1]
        cos, sin = _turn(self.rotation)
        return x * cos + y * sin, y * cos - x * sin

    def vector(self, model: Vector) -> Vector:
        """Return a vector (x, y) of the model in the picture's axes."""
        cos, sin = _turn(self.rotation)
        return model[0] * cos - model[1] * sin, model[0] * sin + model[1] * cos


def _turn(degrees: float) -> tuple[float, float]:
    """Return cosine and sine, exact at right angles."""
    quarter, rest = divmod(degrees, 90.0)
    cos, sin = math.cos(math.radians(rest)), math.sin(math.radians(rest))
    return [(cos, sin), (-sin, cos), (-cos, -sin), (sin, -cos)][int(quarter) % 4]


def nearest(x: Field, period: float) -> tuple[Index, Field]:
    """Return which of the points ``period * i`` is nearest, and the signed distance from it in px."""
    steps = np.rint(x / period)
    return steps.astype(np.int64), x - steps * period


def rows(x: Field, y: Field, width: float, height: float, shift: float) -> tuple[tuple[Index, Index], Local]:
    """Return the cell (i, j) of rows of boxes, each row moved by ``shift`` widths against the one above it.

    The boxes' centres are the lattice of ``(width, 0)`` and ``(shift * width, height)``, and (i, j) its coordinates.
    """
    j, across = nearest(y, height)
    i, along = nearest(x - j * (shift * width), width)
    return (i, j), (along, across)


def honeycomb(x: Field, y: Field, period: float) -> tuple[tuple[Index, Index], Local]:
    """Return the hexagon (i, j) nearest to each point: centres at the lattice of (p, 0) and (p/2, p sqrt(3)/2).

    The centres are two rectangular lattices, one in the middles of the other; the nearer of their two answers wins.
    """
    rise = period * math.sqrt(3)
    even, odd = _rectangle(x, y, period, rise), _rectangle(x - period / 2, y - rise / 2, period, rise)
    first = even[2] ** 2 + even[3] ** 2 <= odd[2] ** 2 + odd[3] ** 2
    column, row, dx, dy = (np.where(first, a, b) for a, b in zip(even, odd, strict=True))
    return (column - row, 2 * row + ~first), (dx, dy)


def _rectangle(x: Field, y: Field, width: float, height: float) -> tuple[Index, Index, Field, Field]:
    (i, dx), (j, dy) = nearest(x, width), nearest(y, height)
    return i, j, dx, dy
