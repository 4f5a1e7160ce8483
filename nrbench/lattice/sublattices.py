"""Coarser and finer lattices, each once: integer matrices in Hermite normal form."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from nrbench.errors import BadInput
from nrbench.lattice.geometry import Integers, Lattice, Points, shortest_pair

LARGEST = 10**9
"""Entries beyond this would not leave their products and determinants exact in 64 bits."""


def hermite_form(matrix: ArrayLike) -> tuple[Integers, Integers]:
    """Return H and U with ``U @ matrix = H``, U of determinant +-1, H in Hermite normal form.

    Two integer matrices give the same coarser lattice of one basis exactly where their H agree.

    Parameters
    ----------
    matrix
        ``(2, 2)`` whole numbers, at most 1e9 in magnitude, determinant not 0; its rows are vectors.

    Returns
    -------
    H, U
        ``int64 (2, 2)``: H is ``[[a, b], [0, d]]`` with a, d > 0 and 0 <= b < d. Exact.

    Raises
    ------
    BadInput
        Where the matrix is not such a one.
    """
    (p, q), (r, s) = _checked(matrix)
    divisor, x, y = _bezout(p, r)
    change = [[x, y], [-r // divisor, p // divisor]]
    corner, d = x * q + y * s, change[1][0] * q + change[1][1] * s
    if d < 0:
        change[1], d = [-entry for entry in change[1]], -d
    times = corner // d
    change[0] = [upper - times * lower for upper, lower in zip(*change, strict=True)]
    return np.array([[divisor, corner - times * d], [0, d]], np.int64), np.array(change, np.int64)


def hermite_matrices(index: int) -> Integers:
    """Return all Hermite normal forms of a determinant: ``int64 (n, 2, 2)``, n the sum of its divisors.

    ``H @ basis`` are the coarser lattices of that index, ``H @ basis / index`` the finer ones, each once: a finer
    lattice, enlarged ``index`` times, is a coarser one. See :func:`coarser` and :func:`finer`.

    Parameters
    ----------
    index
        How many cells go into one, 1 or more.
    """
    if isinstance(index, bool) or not isinstance(index, (int, np.integer)) or index < 1:
        raise BadInput(f"lattice: index is {index!r}; give a whole number of cells, 1 or more")
    divisors = [d for d in range(1, int(index) + 1) if index % d == 0]
    return np.array([((index // d, b), (0, d)) for d in divisors for b in range(d)], np.int64)


def coarser(lattice: Lattice, index: int) -> tuple[Lattice, ...]:
    """Return all lattices of ``index`` times the cell area whose points are all points of ``lattice``, each once.

    They are reduced and keep the origin; each stands for ``index`` cosets, those of the other points. There are as many
    as the divisors of ``index`` add up to: 3 of 2, 4 of 3, 6 of 5, 8 of 7.
    """
    return _lattices(lattice, hermite_matrices(index) @ lattice.reduced().matrix)


def finer(lattice: Lattice, index: int) -> tuple[Lattice, ...]:
    """Return all lattices of 1 / ``index`` the cell area that hold all points of ``lattice``, each once.

    They are reduced and keep the origin. As many as :func:`coarser`; their duals are the coarser ones of the dual.
    """
    return _lattices(lattice, hermite_matrices(index) @ lattice.reduced().matrix / index)


def _lattices(lattice: Lattice, bases: Points) -> tuple[Lattice, ...]:
    return tuple(Lattice.from_basis(shortest_pair(basis), lattice.origin).reduced() for basis in bases)


def _checked(matrix: ArrayLike) -> list[list[int]]:
    """Return a 2 x 2 matrix of whole numbers as Python's own, which do not overflow."""
    hint = f"give 2 x 2 whole numbers up to {LARGEST} of a determinant other than 0"
    values = np.asarray(matrix)
    if values.shape != (2, 2) or values.dtype.kind not in "iuf":
        raise BadInput(f"hermite_form: the matrix is {matrix!r}; {hint}")
    if not (np.isfinite(values).all() and (values == np.rint(values)).all() and (np.abs(values) <= LARGEST).all()):
        raise BadInput(f"hermite_form: the matrix is {values.tolist()}; {hint}")
    (p, q), (r, s) = rows = [[int(entry) for entry in row] for row in values]
    if p * s == q * r:
        raise BadInput(f"hermite_form: the rows {rows} are parallel; {hint}")
    return rows


def _bezout(p: int, r: int) -> tuple[int, int, int]:
    """Return the greatest common divisor of p and r, and x, y with ``x p + y r`` equal to it."""
    x, next_x, rest, divisor = 1, 0, p, r
    while divisor:
        times = rest // divisor
        rest, divisor = divisor, rest - times * divisor
        x, next_x = next_x, x - times * next_x
    x, rest = (-x, -rest) if rest < 0 else (x, rest)
    return rest, x, (rest - x * p) // r if r else 0
