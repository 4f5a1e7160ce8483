"""What the baselines that keep the lattice share, and the Voronoi cell of a lattice, the tile that they repeat."""

from __future__ import annotations

from collections.abc import Callable
from typing import ClassVar, Final

import numpy as np

from nrbench.lattice.geometry import Lattice, Points
from nrbench.plugins.forms import Kind, Refused, Synthesis, Task, require_lattice
from nrbench.plugins.registry import NamedDetector

from ..lattice_places.equal_places import pixel_grid
from ..sample_reading.patches import resample

OFFSET: Final = (0.0011, 0.0007)
"""Offset of a cell's center in px. It keeps pixels off the cell's border, where rounding would decide their side."""


class LatticeBaseline:
    """A baseline that knows the lattice, and whose output pixels each show one point of the sample."""

    reference: ClassVar[bool] = True
    wraps: ClassVar[bool] = True
    maps: ClassVar[str] = "source"
    finder: ClassVar[str] = "gncc"
    right_on: ClassVar[frozenset[Kind]] = frozenset({"0"})

    def synthesize(self, task: Task) -> Synthesis:
        """Return the synthesis.

        The source map's weight is 1 where a pixel was copied, else the bilinear weight of the nearest pixel.

        Raises
        ------
        Refused
            When no lattice is found, or the sample does not hold a whole tile.
        """
        lattice, seconds = require_lattice(task, NamedDetector(self.finder), "there is no tile to repeat")
        locate, note = self.find_tiles(task, lattice)
        image, source = resample(task, locate)
        return Synthesis(image, lattice, source, detection_seconds=seconds, note=note)

    def find_tiles(self, task: Task, lattice: Lattice) -> tuple[Callable[[Points], Points], str]:
        """Return a function from pixels (x, y) of the output to points of the sample, and a note."""
        raise NotImplementedError


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
