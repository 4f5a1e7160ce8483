"""Rectangles that are periods of a lattice, exactly or nearly: what tiles without a seam."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from nrbench.errors import BadInput
from nrbench.lattice.geometry import Integers, Lattice, Points, integers_within

EXACT = 1e-6
"""Share of s within which a rectangle is a period whatever the tolerance: what rounding leaves."""


@dataclass(frozen=True)
class Rectangle:
    """A rectangle whose two sides are lattice vectors, exactly or nearly.

    Parameters
    ----------
    sides
        ``(2, 2)``: the two sides (x, y), px, at a right angle to each other. Of an upright one (w, 0) and (0, h).
    numbers
        ``int64 (2, 2)``: ``numbers @ lattice.matrix`` are the lattice vectors that the sides stand for.
    lattice
        Whose period it is.
    """

    sides: Points
    numbers: Integers
    lattice: Lattice

    @property
    def size(self) -> tuple[float, float]:
        """(w, h): the lengths of the two sides, px."""
        w, h = np.hypot(*self.sides.T)
        return float(w), float(h)

    @property
    def cells(self) -> int:
        """How many cells of the lattice the rectangle stands for."""
        (p, q), (r, s) = self.numbers
        return abs(int(p) * int(s) - int(q) * int(r))

    @property
    def residuals(self) -> Points:
        """``(2, 2)``: each side less its lattice vector (x, y), px; the seam where the rectangle meets itself."""
        return np.asarray(self.sides - self.numbers @ self.lattice.matrix)

    @property
    def error(self) -> float:
        """Length of the longer residual, px."""
        return float(np.hypot(*self.residuals.T).max())

    def fitted(self) -> Lattice:
        """Return the lattice nearby of which the rectangle is an exact period; same basis, same origin."""
        return Lattice.from_basis(np.linalg.solve(self.numbers, self.sides), self.lattice.origin)


def upright_rectangle(
    lattice: Lattice, tolerance: float = 0.0, limit: float = 1024.0, whole: bool = False
) -> Rectangle | None:
    """Return the smallest upright rectangle that is a period of the lattice.

    The sides (w, 0) and (0, h) are each the shortest within ``tolerance`` of a lattice vector. A share of a side costs
    the same share of its residual: twice as wide a rectangle is twice as far off.

    Parameters
    ----------
    lattice
        Neither basis nor origin matters.
    tolerance
        How far, px, a side may be from a lattice vector; less than half of s. 0: exactly, up to rounding.
    limit
        The longest side, px, that is looked at.
    whole
        Whether the sides must be whole numbers of px; then the rounding counts as part of the residual.

    Returns
    -------
    Rectangle or None
        None where either side finds no vector: for most lattices there is none at a tolerance of 0.

    Raises
    ------
    BadInput
        Where the tolerance would take any rectangle, or the limit is no length.
    """
    reach = _reach(lattice, tolerance, limit)
    basis = lattice.reduced().matrix
    found = [_along(turned, reach, limit, whole) for turned in (basis, basis[:, ::-1])]
    if found[0] is None or found[1] is None:
        return None
    (w, across), (h, down) = found[0], found[1]
    return _rectangle(lattice, np.diag([w, h]), np.array([across @ basis, down @ basis]))


def free_rectangle(lattice: Lattice, tolerance: float = 0.0, limit: float = 1024.0) -> Rectangle | None:
    """Return the rectangle of least area with one side a lattice vector, in any direction, that is a period.

    One side is a lattice vector; the other, at a right angle, is within ``tolerance`` of one. Sides are tried from the
    shortest on, until they are too long to be the shorter side of a smaller rectangle. The same parameters, results and
    errors as :func:`upright_rectangle`. Time grows with the number of lattice vectors tried: those shorter than the
    square root of the area found, or than ``limit`` where there is none (about 2 ``limit``^2 over the cell's area).
    """
    reach = _reach(lattice, tolerance, limit)
    basis = lattice.reduced().matrix
    best, found = math.inf, None
    for side in _half(integers_within(basis, (-limit, -limit), (limit, limit)), basis, limit):
        vector = side @ basis
        length = float(np.hypot(*vector))
        if length * length >= best * (1 - 1e-9):
            break
        x, y = vector / length
        other = _along(basis @ np.array([[-y, x], [x, y]]), reach, limit, False)
        if other is not None and length * other[0] < best * (1 - 1e-9):
            best = length * other[0]
            sides = np.array([vector, (-y * other[0], x * other[0])])
            found = _rectangle(lattice, sides, np.array([vector, other[1] @ basis]))
    return found


def _reach(lattice: Lattice, tolerance: float, limit: float) -> float:
    """Return the tolerance that also forgives rounding; refuse what makes no sense."""
    s = lattice.s
    if not 0 <= tolerance < s / 2:
        raise BadInput(f"rectangle: tolerance is {tolerance} px; give 0 or more, less than half of s = {s:.4g} px")
    if not 0 < limit < math.inf:
        raise BadInput(f"rectangle: limit is {limit} px; give the longest side allowed, above 0")
    return max(tolerance, EXACT * s)


def _along(basis: Points, reach: float, limit: float, whole: bool) -> tuple[float, Integers] | None:
    """Return the least x with (x, 0) within ``reach`` of a vector of the basis, and that vector's integers."""
    numbers = integers_within(basis, (reach, -reach), (limit + reach, reach))
    vectors = numbers @ basis
    lengths = np.ceil(vectors[:, 0] - 0.5 - 1e-9) if whole else vectors[:, 0]
    error = np.hypot(lengths - vectors[:, 0], vectors[:, 1])
    chosen = (error <= reach * (1 + 1e-9)) & (lengths > reach) & (lengths <= limit * (1 + 1e-9))
    if not chosen.any():
        return None
    best = np.argmin(np.where(chosen, lengths, np.inf))
    return float(lengths[best]), numbers[best]


def _half(numbers: Integers, basis: Points, limit: float) -> Integers:
    """Return one of each pair +-(i, j), shortest first, none longer than ``limit``."""
    numbers = numbers[(numbers[:, 0] > 0) | ((numbers[:, 0] == 0) & (numbers[:, 1] > 0))]
    lengths = np.hypot(*(numbers @ basis).T)
    return numbers[np.argsort(lengths, kind="stable")][: int((lengths <= limit).sum())]


def _rectangle(lattice: Lattice, sides: Points, vectors: Points) -> Rectangle:
    numbers = np.rint(vectors @ np.linalg.inv(lattice.matrix)).astype(np.int64)
    return Rectangle(sides, numbers, lattice)
