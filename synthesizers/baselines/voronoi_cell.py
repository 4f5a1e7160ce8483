"""The Voronoi cell of a lattice: its extent, its edge, and the whole cells that a sample holds."""

from __future__ import annotations

from typing import Final

import numpy as np

from nrbench.lattice.geometry import Lattice, Points
from nrbench.plugins.forms import Refused

from ..sampling.equal_places import pixel_grid

OFFSET: Final = (0.0011, 0.0007)
"""Offset of a cell's center in px. It keeps pixels off the cell's border, where rounding would decide their side."""


def half_extents(bases: Points) -> Points:
    """Return the distances along x and y, px, from the center of a Voronoi cell to its farthest points.

    Parameters
    ----------
    bases
        ``(n, 2, 2)``: reduced bases.

    Returns
    -------
    Points
        ``(n, 2)``; infinite for vectors that are parallel.
    """
    a, b = bases[:, 0], bases[:, 1]
    b = np.where((a * b).sum(1, keepdims=True) < 0, -b, b)
    corners = [_circumcenters(p, q) for p, q in ((a, b), (a, a - b), (b, b - a))]
    return np.asarray(np.abs(np.stack(corners)).max(0))


def half_extent(lattice: Lattice) -> tuple[float, float]:
    """Return the distances along x and y, px, from the center of the lattice's Voronoi cell to its farthest points."""
    x, y = half_extents(lattice.reduced().matrix[np.newaxis])[0]
    return float(x), float(y)


def edge_points(lattice: Lattice, count: int) -> Points:
    """Return points (x, y) on the edge of the Voronoi cell around 0: ``count`` on each side, evenly spaced.

    The basis of the lattice must be reduced.
    """
    a, b = lattice.matrix
    around = np.array(sorted([a, b, b - a, -a, -b, a - b], key=lambda vector: float(np.arctan2(vector[1], vector[0]))))
    corners = _circumcenters(around, np.roll(around, -1, 0))
    sides = np.roll(corners, -1, 0) - corners
    along = (np.arange(count) + 0.5)[:, np.newaxis, np.newaxis] / count
    points = corners + along * sides
    return np.asarray(points[:, np.hypot(*sides.T) > 1e-6].reshape(-1, 2))


def _circumcenters(p: Points, q: Points) -> Points:
    """Return the points equally far from 0, p and q, ``(n, 2)``; infinite where p and q are parallel."""
    matrices, squares = np.stack([p, q], 1), np.stack([(p**2).sum(1), (q**2).sum(1)], 1)
    good = np.abs(np.linalg.det(matrices)) > 1e-9
    centers = np.full(p.shape, np.inf)
    centers[good] = np.linalg.solve(2 * matrices[good], squares[good][..., np.newaxis])[..., 0]
    return centers


def whole_cell_centers(lattice: Lattice, shape: tuple[int, ...]) -> Points:
    """Return the whole-pixel centers (x, y) of all cells that lie entirely within the sample, ``(n, 2)``.

    Raises
    ------
    Refused
        When there is none.
    """
    height, width = shape[:2]
    x, y = half_extent(lattice)
    low = np.ceil([x, y]).astype(int)
    high = np.floor([width - 1 - x, height - 1 - y]).astype(int)
    if (high < low).any():
        raise Refused(
            f"a tile takes {2 * x:.0f}x{2 * y:.0f} px, the sample is {width}x{height} px: it holds no whole tile"
        )
    width, height = high - low + 1
    return pixel_grid(width, height, *low).reshape(-1, 2).astype(np.float64)
