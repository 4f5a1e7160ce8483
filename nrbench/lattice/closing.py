"""Lattices that close on a torus: the sides of an output that repeats are vectors of its lattice."""

from __future__ import annotations

import math
from typing import Final

import numpy as np
from numpy.typing import NDArray

from nrbench.lattice.geometry import Lattice

MOST_STRAIN: Final = 0.025
"""Largest strain that closes a lattice. Stretched by 2.5 %, a brick of 60 px gains 1.5 px."""


def close_lattice(lattice: Lattice, shape: tuple[int, int]) -> Lattice | None:
    """Return the nearest lattice that has (width, 0) and (0, height) as vectors.

    A linear map moves the lattice's vectors nearest to the two sides onto the sides.

    Parameters
    ----------
    lattice
        The lattice. Its origin is moved with it.
    shape
        (height, width) px of the output.

    Returns
    -------
    Lattice or None
        None if the two sides are shorter than the lattice's own periods, so that no lattice closes.

    Examples
    --------
    >>> from nrbench.lattice.geometry import Lattice
    >>> close_lattice(Lattice((31, 0), (15.5, 15)), (60, 128)).t1
    (32.0, 0.0)
    """
    sides = np.diag(shape[::-1]).astype(np.float64)
    near = sides - lattice.wrap(sides)
    if abs(np.linalg.det(near)) < lattice.area / 2:
        return None
    change = np.linalg.solve(near, sides)
    return Lattice.from_basis(lattice.matrix @ change, np.array(lattice.origin) @ change)


def closing_strain(lattice: Lattice, shape: tuple[int, int]) -> float:
    """Return how far the sides of an output are from vectors of a lattice, over their length; the larger of both."""
    return max(float(_strains(lattice, axis, np.array([side]))[0]) for axis, side in enumerate(shape[::-1]))


def nearest_closing_shape(lattice: Lattice, shape: tuple[int, int], strain: float) -> tuple[int, int]:
    """Return the (height, width) px nearest to a shape at which a lattice closes with at most some strain.

    Examples
    --------
    >>> from nrbench.lattice.geometry import Lattice
    >>> nearest_closing_shape(Lattice((31, 0), (15.5, 15)), (50, 128), 0.002)
    (60, 124)
    """
    found: list[int] = []
    for axis, side in enumerate(shape[::-1]):
        # A vector lies no farther from a side than the covering radius, so that a long side always closes.
        lengths = np.arange(1, max(2 * side, math.ceil(lattice.covering_radius / strain)) + 1)
        good = lengths[_strains(lattice, axis, lengths) <= strain]
        found.append(int(good[np.abs(good - side).argmin()]))
    return found[1], found[0]


def _strains(lattice: Lattice, axis: int, lengths: NDArray[np.int64]) -> NDArray[np.float64]:
    """Return the distance of each length along an axis from a vector of the lattice, over the length."""
    sides = np.zeros((len(lengths), 2))
    sides[:, axis] = lengths
    return np.asarray(np.hypot(*lattice.wrap(sides).T) / lengths)
