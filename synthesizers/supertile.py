"""A baseline: the largest part of the sample that the lattice can repeat, repeated."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from nrbench.lattice.geometry import Lattice, Points
from nrbench.plugins.forms import Refused, Task

from .baselines.lattice_baseline import LatticeBaseline, half_extent, half_extents
from .gap_filling.holes import leaves_out

_CANDIDATES = 300
"""Number of lattice vectors tried for each side of the crop: those nearest to the sample's sides."""


@leaves_out
@dataclass(frozen=True)
class Supertile(LatticeBaseline):
    """The largest crop of the sample that the lattice can repeat: keeps lattice and variation, but repeats the crop.

    The crop is a Voronoi cell of the largest supercell (two vectors of the lattice) that fits the sample around its
    middle, including the pixels' areas. Vectors are real-valued: each output pixel shows the equivalent point of the
    crop, interpolated by a spline of order 5, so nothing drifts, and where the vectors are whole pixels every pixel is
    a copy. Inside the crop the sample is unchanged, phase included; its border continues the lattice, but cuts through
    whatever varies.

    On perfectly regular textures it is a valid method rather than a baseline. Without a given lattice it finds one by
    ``gncc``. The note gives the number of tiles in the crop.
    """

    version: ClassVar[str] = "1"

    def find_tiles(self, task: Task, lattice: Lattice) -> tuple[Callable[[Points], Points], str]:
        """Return the point of the sample that each output pixel shows, and the number of tiles in the crop."""
        periods = np.diag(task.shape[::-1]) if task.tileable else None
        cell = largest_supercell(lattice, task.sample.shape, periods)
        middle = (np.array(task.sample.shape[1::-1]) - 1) / 2
        return lambda pixels: middle + cell.wrap(pixels - middle), f"repeats {round(cell.area / lattice.area)} tiles"


def largest_supercell(lattice: Lattice, shape: tuple[int, ...], periods: Points | None = None) -> Lattice:
    """Return the largest sublattice whose Voronoi cell fits an image of ``shape``; of equally large ones the squarest.

    ``periods`` are vectors, ``(n, 2)``, that it must have.

    Raises
    ------
    Refused
        When even the lattice's own cell does not fit.
    """
    height, width = shape[:2]
    room = np.array([width, height], np.float64)
    at_zero = Lattice(lattice.t1, lattice.t2).reduced()
    vectors = at_zero.from_cell(at_zero.cell_numbers((-room[0], -room[1]), (room[0], room[1])))
    vectors = vectors[np.abs(vectors).max(1) > 1e-6]
    across, down = (_nearest(vectors, side) for side in np.diag(room))
    pairs = _reduced_pairs(across, down)
    fits = np.asarray((2 * half_extents(pairs) <= room + 1e-6).all(1))
    if periods is not None:
        steps = periods @ np.asarray(np.linalg.inv(np.where(fits[:, np.newaxis, np.newaxis], pairs, np.eye(2))))
        fits &= (np.abs(steps - np.rint(steps)) < 1e-6).all((1, 2))
    if not fits.any():
        x, y = half_extent(lattice)
        raise Refused(
            f"a tile takes {2 * x:.0f}x{2 * y:.0f} px, the sample is {width}x{height} px: it holds none whole"
        )
    pairs = pairs[fits]
    area, length = np.abs(np.linalg.det(pairs)), (pairs**2).sum((1, 2))
    return Lattice.from_basis(pairs[np.lexsort((length.round(6), -area.round(6)))[0]])


def _nearest(vectors: Points, side: Points) -> Points:
    return np.asarray(vectors[np.argsort(np.hypot(*(vectors - side).T), kind="stable")[:_CANDIDATES]])


def _reduced_pairs(first: Points, second: Points) -> Points:
    """Return all pairs ``(n, 2, 2)`` that are a reduced basis, at an angle of 60 to 120 degrees."""
    a, b = (grid.reshape(-1, 2) for grid in np.broadcast_arrays(first[:, np.newaxis], second[np.newaxis]))
    along, short = np.abs((a * b).sum(1)), np.minimum((a**2).sum(1), (b**2).sum(1))
    return np.asarray(np.stack([a, b], 1)[2 * along <= short * (1 + 1e-9)])
