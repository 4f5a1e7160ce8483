"""Places in a sample that the lattice calls equal to a place in the output."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from nrbench.lattice.geometry import Lattice, Points, Vector

Positions = NDArray[np.int64]
"""``int64 (n, 2)``: (x, y) of a patch's first pixel."""
Room = tuple[int, int]
"""Rows and columns of whole-pixel places that a patch may take in a sample."""


def room_for(size: int, shape: tuple[int, int]) -> Room:
    """Return the room of a square patch of ``size`` px in a sample of ``shape`` (not positive: it does not fit)."""
    return shape[0] - size + 1, shape[1] - size + 1


def equivalent_positions(lattice: Lattice, position: Vector, room: Room, margin: float = 0.0) -> Points:
    """Return all places ``position + a t1 + b t2`` (a, b whole) that round into the room.

    The places are real-valued: rounding them once, at the end, misplaces by half a pixel at most, wherever the output
    lies; rounding the vectors would let the error grow with a and b.

    Parameters
    ----------
    lattice
        Its origin does not matter.
    position
        (x, y) px of the patch in the output.
    room
        Of the patch, see :func:`room_for`.
    margin
        Also take places as far as this, px, outside the room.

    Returns
    -------
    Points
        ``(n, 2)`` (x, y), possibly none.
    """
    return Lattice(lattice.t1, lattice.t2, position).points(room, margin)


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
