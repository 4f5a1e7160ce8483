"""Texels: their shape, those that a sample holds, and the mosaic of them that an output shows."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from functools import cached_property, lru_cache
from typing import Final

import numpy as np
import scipy
from numpy.typing import NDArray

from nrbench.imaging.convert import Image
from nrbench.lattice.geometry import Lattice, Points

from ..sampling.cell_torus import CellTorus

Step = tuple[int, int]
"""A lattice vector, in steps along the first and the second vector, from a texel to another one."""
NEIGHBORS: Final[tuple[Step, ...]] = tuple((u, v) for u in (-1, 0, 1) for v in (-1, 0, 1) if u or v)
_CHUNK = 1 << 16
"""Number of points of the sample that are read at a time."""
_KEPT = 1 << 22
"""Number of differences that are kept, 32 MiB."""
Grid = NDArray[np.int64]
"""``(columns, rows)``: number of the texel at each place of the output."""


@dataclass(frozen=True, eq=False)
class TexelShape:
    """A convex texel, symmetric about its middle, that tiles the plane when a lattice repeats it.

    Parameters
    ----------
    lattice
        Its points are the middles of the texels. All texels that meet are one step along either or both vectors apart.
    normals
        ``(k, 2)``: unit vectors across the pairs of parallel sides, two or three.
    halves
        ``(k,)`` px: distance of each side from the middle.
    zone
        Breadth, px, of the zone that two neighbors share: each reaches half of it beyond its sides.
    """

    lattice: Lattice
    normals: Points
    halves: NDArray[np.float64]
    zone: float

    @classmethod
    def of(cls, lattice: Lattice, corners: Points, zone: float) -> TexelShape:
        """Return the texel with some corners.

        Parameters
        ----------
        lattice
            Its points are the middles.
        corners
            ``(2 k, 2)`` px: the corners from the middle, in order around it; two may coincide.
        zone
            As in the class. It is made no broader than the texel.
        """
        sides = np.roll(corners, -1, 0)[: len(corners) // 2] - corners[: len(corners) // 2]
        lengths = np.hypot(*sides.T)
        kept = lengths > 1e-6
        normals = np.column_stack([-sides[:, 1], sides[:, 0]])[kept] / lengths[kept, np.newaxis]
        halves = np.abs((normals * corners[: len(corners) // 2][kept]).sum(1))
        return cls(lattice, normals, halves, min(zone, 2 * float(halves.min())))

    def ramp(self, points: Points) -> NDArray[np.float64]:
        """Return how far points ``(..., 2)`` px from the middle are inside: 0 to 1 across the zone, 1/2 on a side."""
        inside = (self.halves - np.abs(points @ self.normals.T)).min(-1)
        return np.asarray(np.clip(0.5 + inside / max(self.zone, 1e-9), 0, 1))

    def weights(self, points: Points) -> Iterator[tuple[NDArray[np.int64], NDArray[np.float64]]]:
        """Yield cell coordinates of texels near points ``(n, 2)`` px, ``(n, 2)``, and their weights there, ``(n,)``.

        The weights of all texels at a point add up to 1. They fall linearly across the zone of two neighbors. If each
        new texel were feathered onto those pasted before, the weights would be the same, but for the corners where
        three meet.
        """
        near = np.rint(self.lattice.to_cell(points)).astype(np.int64)
        numbers = [near + step for step in ((0, 0), *NEIGHBORS)]
        ramps = [self.ramp(points - self.lattice.from_cell(number)) for number in numbers]
        total = np.sum(ramps, 0)
        for number, ramp in zip(numbers, ramps, strict=True):
            yield number, ramp / total

    @cached_property
    def pixels(self) -> Points:
        """``(n, 2)``: the whole-pixel points from the middle that the texel and its zone hold."""
        reach = int(np.ceil(2 * np.hypot(*self.lattice.matrix.T).max() + self.zone))
        side = np.arange(-reach, reach + 1.0)
        points = np.stack(np.meshgrid(side, side), -1).reshape(-1, 2)
        return points[self.ramp(points) > 0]

    @cached_property
    def rim(self) -> Points:
        """``(n, 2)`` px: the outermost of :attr:`pixels`."""
        steps = np.array([(1, 0), (-1, 0), (0, 1), (0, -1)])
        return np.asarray(self.pixels[(self.ramp(self.pixels[:, np.newaxis] + steps) == 0).any(1)])

    def shared_zone(self, step: Step) -> Points:
        """Return the :attr:`pixels` of the zone that a texel shares with the one at a step, ``(n, 2)``."""
        return np.asarray(self.pixels[self.ramp(self.pixels - np.array(step) @ self.lattice.matrix) > 0])


@dataclass(frozen=True, eq=False)
class TexelStock:
    """The texels that a sample holds with their zones.

    Parameters
    ----------
    shape
        Their shape, and the lattice of their middles.
    middles
        ``(n, 2)``: the middle (x, y) px of each texel.
    read
        Returns the values of the sample at points ``(..., 2)``, as ``(..., C)``.
    """

    shape: TexelShape
    middles: Points
    read: Callable[[Points], Image]

    @classmethod
    def of(
        cls,
        shape: TexelShape,
        box: tuple[Points, Points],
        holds: Callable[[Points], NDArray[np.bool_]],
        read: Callable[[Points], Image],
    ) -> TexelStock:
        """Return all texels that the sample holds.

        Parameters
        ----------
        shape, read
            As in the class.
        box
            Least and greatest (x, y) px of the middles that are tried.
        holds
            Whether the sample shows points, ``(..., 2)`` to ``(...)``.
        """
        middles = shape.lattice.from_cell(shape.lattice.cell_numbers(*box))
        middles = middles[holds(middles[:, np.newaxis] + shape.rim).all(1)]
        return cls(shape, middles, read)

    def zone_size(self, step: Step) -> int:
        """Return the number of points of the zone that a texel shares with the one at a step."""
        return len(self._zones[min(step, _opposite(step))][0])

    def differences(self, step: Step, there: int) -> NDArray[np.float64]:
        """Return how each texel differs from one beside it, in the zone that they share, ``(n,)``.

        Squared differences are summed over the points of the zone and averaged over channels. All texels lie on the
        lattice, so that these numbers hold wherever the two meet.

        Parameters
        ----------
        step
            From each texel to the one beside it.
        there
            The number of the texel beside it.

        Notes
        -----
        The first call for a step and a texel takes O(n zone). At most :data:`_KEPT` numbers are kept for later calls;
        n x n tables would take hundreds of MiB where the sample holds thousands of texels.
        """
        return self._differences(step, there)

    @cached_property
    def _differences(self) -> Callable[[Step, int], NDArray[np.float64]]:
        return lru_cache(max(1, _KEPT // max(len(self.middles), 1)))(self._compute_differences)

    def _compute_differences(self, step: Step, there: int) -> NDArray[np.float64]:
        """Compute :meth:`differences`; a step and its opposite share a zone, so that they agree on every pair."""
        forward = min(step, _opposite(step))
        points, own, other = self._zones[forward]
        if not len(points):
            return np.zeros(len(self.middles))
        here, beside = (own, other) if step == forward else (other, own)
        squares = scipy.spatial.distance.cdist(beside[there : there + 1], here, "sqeuclidean")[0]
        return np.asarray(squares / (here.shape[1] // len(points)))

    @cached_property
    def _zones(self) -> dict[Step, tuple[Points, NDArray[np.float64], NDArray[np.float64]]]:
        """For each forward step: points of the shared zone, their values in each texel, and in each as the other."""
        zones = {}
        for step in NEIGHBORS:
            if step < _opposite(step):
                points = self.shape.shared_zone(step)
                beside = points - np.array(step) @ self.shape.lattice.matrix
                zones[step] = points, self._values(points), self._values(beside)
        return zones

    def _values(self, offsets: Points) -> NDArray[np.float64]:
        """Return the values of each texel at offsets ``(m, 2)`` from its middle, as ``(n, m C)``."""
        if not len(offsets):
            return np.zeros((len(self.middles), 0))
        step = max(1, _CHUNK // len(offsets))
        parts = [
            self.read(self.middles[first : first + step, np.newaxis] + offsets)
            for first in range(0, len(self.middles), step)
        ]
        values = np.concatenate(parts).astype(np.float64)
        return values.reshape(len(values), -1)

    @cached_property
    def power(self) -> float:
        """Mean square of the values on the rims."""
        values = self._values(self.shape.rim)
        return float((values**2).mean())


def _opposite(step: Step) -> Step:
    return -step[0], -step[1]


@dataclass(frozen=True, eq=False)
class TexelMosaic:
    """Texels side by side.

    Parameters
    ----------
    stock
        The texels.
    first
        (u, v): cell coordinates of the first texel of ``chosen``.
    chosen
        The texel at each place.
    torus
        The places of a mosaic that repeats, all of which ``chosen`` holds. None: it does not repeat.
    """

    stock: TexelStock
    first: NDArray[np.int64]
    chosen: Grid
    torus: CellTorus | None = None

    @classmethod
    def grow(
        cls,
        stock: TexelStock,
        box: tuple[Points, Points],
        largest: float,
        rng: np.random.Generator,
        progress: Callable[[float], None],
        torus: CellTorus | None = None,
    ) -> TexelMosaic:
        """Choose a texel for each place in a box, in the order in which the lattice is constructed.

        The lattice grows from the texel in the middle: each vertex leads to the four beside it. The earlier the
        vertices of a texel are found, the earlier it is pasted (report, appendix A). Of the texels that differ from
        those around it by at most ``largest``, one is drawn; if there is none, the one that differs least is taken.

        Parameters
        ----------
        stock
            The texels.
        box
            Least and greatest (x, y) px that must be covered.
        largest
            d_max: largest root mean square difference in the zones shared with texels that stand already.
        rng
            The randomness.
        progress
            Is called with the fraction that is done.
        torus
            The places of a mosaic that repeats. None: it does not.
        """
        first, size = _cover(stock.shape.lattice, box)
        if torus is not None:
            first, size = np.zeros(2, np.int64), np.array([torus.columns, torus.rows])
        mosaic = cls(stock, first, np.full((size[0], size[1]), -1), torus)
        order = list(growth_order((int(size[0]), int(size[1]))))
        draws = rng.random(len(order))
        count = len(stock.middles)
        for done, ((column, row), draw) in enumerate(zip(order, draws, strict=True)):
            squares, points = np.zeros(count), 0
            for step in NEIGHBORS:
                there = mosaic.texel_at(column + step[0], row + step[1])
                if there >= 0:
                    squares += stock.differences(step, there)
                    points += stock.zone_size(step)
            limit = max(largest**2 * points, float(squares.min())) * (1 + 1e-9)
            able = np.flatnonzero(squares <= limit)
            mosaic.chosen[column, row] = able[int(draw * len(able))]
            if done % 256 == 0:
                progress(done / len(order))
        return mosaic

    def texel_at(self, column: int, row: int) -> int:
        """Return the texel at a place of the grid, -1 if it is empty or outside."""
        if self.torus is not None:
            column, row = self.torus.wrap(np.array([column, row])).tolist()
        elif not (0 <= column < self.chosen.shape[0] and 0 <= row < self.chosen.shape[1]):
            return -1
        return int(self.chosen[column, row])

    def contributions(self, points: Points) -> Iterator[tuple[NDArray[np.intp], Points, NDArray[np.float64]]]:
        """Yield which points, ``(n, 2)`` px, show a texel, where in the sample it shows them, and its weight.

        The weights at a point add up to 1, see :meth:`~.TexelShape.weights`.
        """
        shape = self.stock.shape
        for numbers, weights in shape.weights(points):
            seen = np.flatnonzero(weights > 1e-6)
            number = numbers[seen]
            column, row = (number - self.first if self.torus is None else self.torus.wrap(number)).T
            middles = self.stock.middles[self.chosen[column, row]]
            yield seen, points[seen] + (middles - shape.lattice.from_cell(number)), weights[seen]


def _cover(lattice: Lattice, box: tuple[Points, Points]) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Return the first place (u, v) of the texels that cover a box with their zones, and their numbers along u, v."""
    (left, top), (right, bottom) = box
    uv = lattice.to_cell([(left, top), (right, top), (left, bottom), (right, bottom)])
    first = np.floor(uv.min(0)).astype(np.int64) - 2
    return first, np.ceil(uv.max(0)).astype(np.int64) + 3 - first


def growth_order(size: tuple[int, int]) -> Iterator[tuple[int, int]]:
    """Yield the (column, row) of every texel in the order in which the lattice's vertices are found.

    Vertices are found in rings: those of the texel in the middle, then those one step along a vector from them, and so
    on; in a ring, in the order of rows. A texel follows its last vertex.
    """
    columns, rows = size
    u, v = np.meshgrid(np.arange(columns + 1), np.arange(rows + 1), indexing="ij")
    middle = (columns - 1) // 2, (rows - 1) // 2
    # Steps from the nearest of the four vertices of the texel in the middle.
    found = np.maximum(np.maximum(middle[0] - u, u - middle[0] - 1), 0)
    found = found + np.maximum(np.maximum(middle[1] - v, v - middle[1] - 1), 0)
    last = np.maximum(np.maximum(found[:-1, :-1], found[1:, :-1]), np.maximum(found[:-1, 1:], found[1:, 1:]))
    column, row = (part.ravel() for part in np.indices(size))
    for n in np.lexsort((column, row, last.ravel())):
        yield int(column[n]), int(row[n])
