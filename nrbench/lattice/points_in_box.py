"""The integer combinations of two vectors that lie in an upright box, found row by row."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

Integers = NDArray[np.int64]


def integers_within(basis: ArrayLike, low: ArrayLike, high: ArrayLike) -> Integers:
    """Return the integers (i, j) whose points ``i a + j b`` lie in a box, and a few that lie just outside.

    Parameters
    ----------
    basis
        ``(2, 2)``, rows a and b (x, y); reduced, or the rows are many and nearly empty.
    low, high
        Corners (x, y) of the box.

    Returns
    -------
    Integers
        ``int64 (n, 2)``, each once. Points within 1e-6 of a step of the border may be in it: test the points, not the
        integers. Time and memory grow with the rows that the box meets and the points in it, not with the square of
        its longer side.
    """
    (a, b), (lower, upper) = np.asarray(basis, np.float64), np.array([low, high], np.float64)
    corners = np.array([(x, y) for x in (lower[0], upper[0]) for y in (lower[1], upper[1])])
    rows = (corners @ np.linalg.inv([a, b]))[:, 1]
    j = np.arange(np.ceil(rows.min() - 1e-6), np.floor(rows.max() + 1e-6) + 1)
    first, last = _clipped(a, j[:, np.newaxis] * b, lower, upper)
    first, last = np.ceil(first - 1e-6), np.floor(last + 1e-6)
    return _spelled(first.astype(np.int64), np.maximum(last - first + 1, 0).astype(np.int64), j.astype(np.int64))


def _clipped(
    a: NDArray[np.float64], starts: NDArray[np.float64], low: NDArray[np.float64], high: NDArray[np.float64]
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return the range of i at which each line ``start + i a`` is in the box; below its start where it never is."""
    first, last = np.full(len(starts), -np.inf), np.full(len(starts), np.inf)
    length = float(np.hypot(*a))
    for axis in (0, 1):
        if abs(a[axis]) > 1e-12 * length:
            ends = (np.array([low[axis], high[axis]])[:, np.newaxis] - starts[:, axis]) / a[axis]
            first, last = np.maximum(first, ends.min(0)), np.minimum(last, ends.max(0))
        else:
            slack = 1e-6 * length
            outside = (starts[:, axis] < low[axis] - slack) | (starts[:, axis] > high[axis] + slack)
            last[outside] = -np.inf
    missed = last < first - 1e-5
    return np.where(missed, 0.0, first), np.where(missed, -1.0, last)


def _spelled(first: Integers, counts: Integers, j: Integers) -> Integers:
    """Return ``(i, j)`` for ``counts`` values of i from ``first`` on, row by row."""
    before = np.repeat(np.cumsum(counts) - counts, counts)
    return np.stack([np.repeat(first, counts) + np.arange(len(before)) - before, np.repeat(j, counts)], 1)
