"""Upright rectangles that are periods of several lattices and stripes at once, to whole pixels."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from nrbench.errors import BadInput
from nrbench.lattice.geometry import Lattice, Points


@dataclass(frozen=True)
class CommonPeriod:
    """A rectangle that tiles.

    Parameters
    ----------
    size
        (width, height), whole px.
    error
        px: how far its sides are from periods at most, of the group that fits worst.
    free
        Of (width, height), which may be any length, as nothing varies along it (stripes).
    """

    size: tuple[int, int]
    error: float
    free: tuple[bool, bool] = (False, False)

    @property
    def sides(self) -> Points:
        """``(2, 2)``: the two sides (x, y), px."""
        return np.diag(np.array(self.size, np.float64))


def common_period(
    groups: Sequence[NDArray[np.float64]], tolerance: float = 0.5, limit: int = 1024
) -> CommonPeriod | None:
    """Return the smallest upright rectangle of whole px that is a period of all groups of frequencies.

    Either side is the shortest that is near a period of every group: a lattice vector, or, of stripes, what leads from
    a stripe to a stripe. The paper (Nicoll et al. 2005, equation 7) divides by the components of the lowest frequency,
    which may be 0; here a side along which nothing varies is free, and as long as the other.

    Parameters
    ----------
    groups
        Of each its fundamentals, ``(1 or 2, 2)`` cycles/px.
    tolerance
        px: how far a side may be from a period of any group; at least 0, and less than half of the shortest one.
    limit
        The longest side that is looked at, px.

    Returns
    -------
    CommonPeriod or None
        None where there is no group, or no side within ``limit``.

    Raises
    ------
    BadInput
        Where the tolerance would take any rectangle, or the limit is no length.
    """
    if not limit >= 1:
        raise BadInput(f"common period: limit is {limit} px; give the longest side allowed, at least 1")
    shortest = min((1 / float(np.linalg.svd(g)[1][0]) for g in groups), default=np.inf)
    if not 0 <= tolerance < shortest / 2:
        raise BadInput(f"common period: tolerance is {tolerance} px; give 0 or more, less than {shortest / 2:.4g} px")
    if not groups:
        return None
    errors = np.stack([np.max([misses(g, axis, int(limit)) for g in groups], 0) for axis in (0, 1)])
    reach = max(tolerance, 1e-6)
    found = [_side(along, reach) for along in errors]
    if found[0] is None or found[1] is None:
        return None
    return _rectangle((found[0], found[1]), errors)


def misses(fundamentals: NDArray[np.float64], axis: int, limit: int) -> NDArray[np.float64]:
    """Return how far each length from 1 to ``limit`` along an axis is from a period, px, ``(limit,)``.

    Parameters
    ----------
    fundamentals
        Of one group, ``(1 or 2, 2)`` cycles/px.
    axis
        0: along x, 1: along y.
    limit
        px.
    """
    if len(fundamentals) == 2:
        basis = Lattice.from_basis(np.linalg.inv(fundamentals).T).reduced().matrix
        turns = np.outer(np.arange(1, limit + 1), np.linalg.inv(basis)[axis])
        return np.asarray(np.hypot(*((turns - np.rint(turns)) @ basis).T))
    turns = np.arange(1, limit + 1) * fundamentals[0, axis]
    return np.asarray(np.abs(turns - np.rint(turns)) / np.hypot(*fundamentals[0]))


def _side(errors: NDArray[np.float64], reach: float) -> tuple[int, bool] | None:
    """Return the shortest length within reach, past those that are too short to leave it; or the longest, free."""
    beyond = np.flatnonzero(errors > reach)
    first = int(beyond[0]) if len(beyond) else len(errors)
    if first > 2 * reach + 1:
        return first, True
    within = np.flatnonzero(errors[first:] <= reach)
    return (first + int(within[0]) + 1, False) if len(within) else None


def _rectangle(found: tuple[tuple[int, bool], tuple[int, bool]], errors: NDArray[np.float64]) -> CommonPeriod:
    (width, free_x), (height, free_y) = found
    if free_x:
        width = min(width, height)
    if free_y:
        height = min(height, width)
    error = float(max(errors[0, width - 1], errors[1, height - 1]))
    return CommonPeriod((width, height), error, (free_x, free_y))
