"""Places in a sample that the lattice calls equal to a place in the output."""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import ArrayLike, NDArray

from nrbench.lattice.geometry import Lattice, Points, Vector, integers_within

Positions = NDArray[np.int64]
"""``int64 (n, 2)``: (x, y) of a patch's first pixel."""
Room = tuple[int, int]
"""Rows and columns of whole-pixel places that a patch may take in a sample."""


def room_for(size: int, shape: tuple[int, int]) -> Room:
    """Return the room of a square patch of ``size`` px in a sample of ``shape`` (not positive: it does not fit)."""
    return shape[0] - size + 1, shape[1] - size + 1


def equivalent_positions(lattice: Lattice, position: Vector, room: Room, margin: float = 0.0) -> Points:
    """Return all places ``position + a t1 + b t2`` (a, b whole) that round into the room: see :class:`EqualPlaces`."""
    return EqualPlaces(lattice, room, margin).of(position)


@dataclass(frozen=True)
class EqualPlaces:
    """Which places ``position + a t1 + b t2`` (a, b whole) round into the room of a patch.

    The places are real-valued: rounding them once, at the end, misplaces by half a pixel at most, wherever the output
    lies; rounding the vectors would let the error grow with a and b.

    Parameters
    ----------
    lattice
        Its origin does not matter.
    room
        Of the patch, see :func:`room_for`.
    margin
        Also take places as far as this, px, outside the room.
    """

    lattice: Lattice
    room: Room
    margin: float = 0.0

    def of(self, position: ArrayLike) -> Points:
        """Return the places equal to a patch's (x, y) px in the output, ``(n, 2)``, row by row, possibly none.

        They are those of the basis cell, moved by vectors listed once: the cost is that of looking at these.
        """
        at = np.asarray(position, np.float64)
        places = at - np.floor(at @ self._inverse) @ self._basis + self._steps
        low, high = -0.5 - self.margin, np.array(self.room[::-1]) - 0.5 + self.margin
        places = places[((places >= low) & (places < high)).all(1)]
        return np.asarray(places[np.lexsort(places.round(6).T)])

    @cached_property
    def _basis(self) -> Points:
        return self.lattice.reduced().matrix

    @cached_property
    def _inverse(self) -> Points:
        return np.asarray(np.linalg.inv(self._basis))

    @cached_property
    def _steps(self) -> Points:
        """All lattice vectors that take a point of the basis cell, whose corner is 0, to one of the room."""
        corners = np.array([(0, 0), (1, 0), (0, 1), (1, 1)]) @ self._basis
        low, high = -0.5 - self.margin - corners.max(0), np.array(self.room[::-1]) - 0.5 + self.margin - corners.min(0)
        return np.asarray(integers_within(self._basis, low, high) @ self._basis)


def pixel_grid(width: int, height: int, left: int = 0, top: int = 0) -> NDArray[np.int64]:
    """Return the (x, y) of each pixel of a rectangle whose first one is (``left``, ``top``): ``int64 (h, w, 2)``."""
    y, x = np.indices((height, width))
    return np.stack([x + left, y + top], -1)


def nearest_pixels(positions: Points, room: Room) -> Positions:
    """Return places rounded to whole pixels, halves up; each once, row by row, whatever the lattice's basis."""
    return _once(_round(positions), room)


def around(positions: Points, tolerance: float, room: Room) -> Positions:
    """Return the whole-pixel places within ``tolerance`` px of any of ``positions``, along x and y, inside the room.

    Each once, row by row. The nearest pixel always counts, however small the tolerance (RSGF, section 4.2: 3 px).
    """
    reach = max(tolerance, 0.5) + 1e-9
    steps = np.arange(-math.floor(reach + 0.5), math.floor(reach + 0.5) + 1)
    offsets = np.stack(np.meshgrid(steps, steps, indexing="ij"), -1).reshape(-1, 2)
    near = _round(positions)[:, np.newaxis] + offsets
    close = (np.abs(near - positions[:, np.newaxis]) <= reach).all(-1)
    inside = ((near >= 0) & (near < room[::-1])).all(-1)
    return _once(near[close & inside], room)


def _round(positions: Points) -> Positions:
    return np.floor(positions + 0.5).astype(np.int64)


def _once(positions: Positions, room: Room) -> Positions:
    index = np.unique(positions[:, 1] * room[1] + positions[:, 0])
    return np.stack([index % room[1], index // room[1]], -1)
