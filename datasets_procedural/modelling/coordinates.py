"""Coordinates: a model's own axes in the picture, and which cell of a lattice a point lies in."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from nrbench.lattice.geometry import Vector
from nrbench.plugins.forms import Shape

Field = NDArray[np.float64]
"""One number for each point, any shape; usually ``(H, W)``."""
Index = NDArray[np.int64]
"""One whole number for each point: a part of an element's index."""
Displacement = NDArray[np.float64]
"""(x, y) px for each pixel, in the picture's axes, ``(H, W, 2)``."""
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

    def grid(self, shape: Shape, margin: int = 0, moved: Displacement | None = None) -> tuple[Field, Field]:
        """Return the model's coordinates (x, y) px of each pixel centre, two arrays of ``shape``.

        Parameters
        ----------
        shape
            (height, width) of the picture.
        margin
            Also of as many pixels beyond each side.
        moved
            How far the content at each pixel has moved from the place whose coordinates it gets.
        """
        x = np.arange(-margin, shape[1] + margin) - self.origin[0]
        y = np.arange(-margin, shape[0] + margin)[:, np.newaxis] - self.origin[1]
        if moved is not None:
            x, y = x - moved[..., 0], y - moved[..., 1]
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


def boxes(x: Field, widths: tuple[float, ...]) -> tuple[Index, Field, Field]:
    """Return in which box of a row each point lies, the signed distance from its middle, and its width.

    The row repeats ``widths``; the middle of its first box lies at x = 0.
    """
    sizes = np.asarray(widths)
    if len(sizes) == 1:
        return (*nearest(x, widths[0]), np.broadcast_to(sizes, x.shape))
    turn = np.floor((x + sizes[0] / 2) / sizes.sum())
    rest = x + sizes[0] / 2 - turn * sizes.sum()
    ends = np.cumsum(sizes)
    which = np.searchsorted(ends[:-1], rest, side="right")
    return turn.astype(np.int64) * len(sizes) + which, rest - (ends - sizes / 2)[which], sizes[which]


def cells(x: Field, y: Field, width: float, height: float) -> tuple[tuple[Index, Index], Local]:
    """Return the box (i, j) of a rectangular grid, its middles at multiples of width and height."""
    (i, right), (j, down) = nearest(x, width), nearest(y, height)
    return (i, j), (right, down)


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


def hats(u: Field, v: Field) -> list[tuple[tuple[Index, Index], Field]]:
    """Return the four whole points (i, j) around each point (u, v), each with its bilinear weight.

    In each of the four, i and j have a parity of their own, so that no two ever name the same point.
    """
    columns, rows = ([_hat(part, parity) for parity in range(2)] for part in (u, v))
    return [((i, j), right * down) for j, down in rows for i, right in columns]


def _hat(u: Field, parity: int) -> tuple[Index, Field]:
    """Return the nearest even or odd number, and its linear weight."""
    i = 2 * np.rint((u - parity) / 2).astype(np.int64) + parity
    return i, np.maximum(1 - np.abs(u - i), 0)
