"""A cheat: as much of the sample as the lattice allows, repeated."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from nrbench.detectors.gncc import Gncc
from nrbench.lattice.geometry import Lattice, Points
from nrbench.plugins.forms import Kind, Refused, Synthesis, Task, require_lattice

from .sampling.splines import resampled
from .tiling import reach

_CANDIDATES = 300
"""Lattice vectors that are tried for each side of the crop: those nearest to the sample's sides."""


@dataclass(frozen=True)
class Supertile:
    """The largest crop of the sample that the lattice allows to repeat: right on both perils, but the same again.

    The crop is a cell of the largest supercell (two vectors of the lattice) that fits the sample around its middle,
    pixels' areas included. Vectors are real-valued: each output pixel shows the point of the crop that the supercell
    calls equal, interpolated by a spline of order 5, so nothing drifts, and where the vectors are whole pixels every
    pixel is a copy. Inside the crop the sample is unchanged, phase included; its border continues the lattice, but cuts
    through what varies.

    On perfectly regular textures it is no cheat. With no lattice given it finds one by ``gncc``. Its period, in cells
    along both vectors, is in the note.
    """

    reference: ClassVar[bool] = True
    uses_lattice: ClassVar[bool] = True
    right_on: ClassVar[frozenset[Kind]] = frozenset({"0"})
    version: ClassVar[str] = "1"

    def synthesize(self, task: Task) -> Synthesis:
        """Return the synthesis.

        Raises
        ------
        Refused
            When no lattice is found, or the sample does not hold a whole tile.
        """
        lattice, seconds = require_lattice(task, Gncc(), "there is nothing to repeat")
        cell = supercell(lattice, task.sample.shape)
        middle = (np.array(task.sample.shape[1::-1]) - 1) / 2
        image, source = resampled(task, lambda pixels: middle + cell.wrap(pixels - middle))
        count = round(cell.area / lattice.area)
        return Synthesis(image, lattice, source, detection_seconds=seconds, note=f"repeats {count} tiles")


def supercell(lattice: Lattice, shape: tuple[int, ...]) -> Lattice:
    """Return the largest sublattice whose Voronoi cell lies whole within an image of ``shape``; of equals the squarest.

    Raises
    ------
    Refused
        When not even the lattice's own cell does.
    """
    height, width = shape[:2]
    room = np.array([width, height], np.float64)
    vectors = _vectors(lattice, room)
    pairs = _reduced_pairs(_nearest(vectors, np.array([width, 0.0])), _nearest(vectors, np.array([0.0, height])))
    fits = (2 * _reaches(pairs) <= room + 1e-6).all(1)
    if not fits.any():
        x, y = reach(lattice)
        raise Refused(
            f"a tile takes {2 * x:.0f}x{2 * y:.0f} px, the sample is {width}x{height} px: it holds none whole"
        )
    pairs = pairs[fits]
    area, length = np.abs(np.linalg.det(pairs)), (pairs**2).sum((1, 2))
    (ax, ay), (bx, by) = pairs[np.lexsort((length.round(6), -area.round(6)))[0]]
    return Lattice((float(ax), float(ay)), (float(bx), float(by)))


def _vectors(lattice: Lattice, room: Points) -> Points:
    """Return the vectors of the lattice, other than zero, that reach no farther than the sample's sides."""
    at_zero = Lattice(lattice.t1, lattice.t2).reduced()
    x, y = (float(side) for side in room)
    found = at_zero.from_cell(at_zero.cell_numbers((-x, -y), (x, y)))
    return np.asarray(found[np.abs(found).max(1) > 1e-6])


def _nearest(vectors: Points, side: Points) -> Points:
    return np.asarray(vectors[np.argsort(np.hypot(*(vectors - side).T), kind="stable")[:_CANDIDATES]])


def _reduced_pairs(first: Points, second: Points) -> Points:
    """Return all pairs ``(n, 2, 2)`` that are a reduced basis, at an angle of 60 to 120 degrees."""
    a, b = (grid.reshape(-1, 2) for grid in np.broadcast_arrays(first[:, np.newaxis], second[np.newaxis]))
    along, short = np.abs((a * b).sum(1)), np.minimum((a**2).sum(1), (b**2).sum(1))
    return np.asarray(np.stack([a, b], 1)[2 * along <= short * (1 + 1e-9)])


def _reaches(pairs: Points) -> Points:
    """Return how far, along x and y in px, the Voronoi cell of each reduced basis reaches, ``(n, 2)``."""
    a, b = pairs[:, 0], pairs[:, 1]
    b = np.where((a * b).sum(1, keepdims=True) < 0, -b, b)
    corners = [_circumcentres(p, q) for p, q in ((a, b), (a, a - b), (b, b - a))]
    return np.asarray(np.abs(np.stack(corners)).max(0))


def _circumcentres(p: Points, q: Points) -> Points:
    """Return the points equally far from 0, p and q."""
    matrices, squares = np.stack([p, q], 1), np.stack([(p**2).sum(1), (q**2).sum(1)], 1)
    good = np.abs(np.linalg.det(matrices)) > 1e-9
    found = np.full(p.shape, np.inf)
    found[good] = np.linalg.solve(2 * matrices[good], squares[good][..., np.newaxis])[..., 0]
    return found
