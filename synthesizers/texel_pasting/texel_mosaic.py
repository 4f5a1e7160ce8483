"""An output of texels: which one stands where, in the order in which the lattice grows, and what a point shows."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from nrbench.lattice.geometry import Lattice, Points

from .texel_shape import NEIGHBORS
from .texel_stock import TexelStock

Grid = NDArray[np.int64]
"""``(columns, rows)``: number of the texel at each place of the output."""


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
    """

    stock: TexelStock
    first: NDArray[np.int64]
    chosen: Grid

    @classmethod
    def grow(
        cls,
        stock: TexelStock,
        box: tuple[Points, Points],
        largest: float,
        rng: np.random.Generator,
        progress: Callable[[float], None],
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
        """
        first, size = _cover(stock.shape.lattice, box)
        chosen = np.full((size[0] + 2, size[1] + 2), -1)
        order = list(growth_order((int(size[0]), int(size[1]))))
        draws = rng.random(len(order))
        count = len(stock.middles)
        for done, ((column, row), draw) in enumerate(zip(order, draws, strict=True)):
            squares, points = np.zeros(count), 0
            for step in NEIGHBORS:
                there = chosen[column + 1 + step[0], row + 1 + step[1]]
                if there >= 0:
                    squares += stock.differences(step, int(there))
                    points += stock.zone_size(step)
            limit = max(largest**2 * points, float(squares.min())) * (1 + 1e-9)
            able = np.flatnonzero(squares <= limit)
            chosen[column + 1, row + 1] = able[int(draw * len(able))]
            if done % 256 == 0:
                progress(done / len(order))
        return cls(stock, first, chosen[1:-1, 1:-1])

    def contributions(self, points: Points) -> Iterator[tuple[NDArray[np.intp], Points, NDArray[np.float64]]]:
        """Yield which points, ``(n, 2)`` px, show a texel, where in the sample it shows them, and its weight.

        The weights at a point add up to 1, see :meth:`~.TexelShape.weights`.
        """
        shape = self.stock.shape
        for numbers, weights in shape.weights(points):
            seen = np.flatnonzero(weights > 1e-6)
            number = numbers[seen]
            column, row = (number - self.first).T
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
    column, row = (one.ravel() for one in np.indices(size))
    for n in np.lexsort((column, row, last.ravel())):
        yield int(column[n]), int(row[n])
