"""The cells of a lattice that an image holds, whole or in part."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from nrbench.lattice.geometry import Integers, Lattice, Points

TOUCH = 1e-6
"""px by which a cell must reach into the image to meet it, or may reach out of it and still be whole."""


@dataclass(frozen=True)
class Cells:
    """The cells that meet an image.

    Parameters
    ----------
    lattice
        Whose cells they are: parallelograms of its t1 and t2, corner (u, v) at ``origin + u t1 + v t2``.
    numbers
        ``int64 (n, 2)``: (u, v) of each cell's first corner, sorted. Cell (u, v) holds the points of cell coordinates
        [u, u + 1) x [v, v + 1), so ``floor(lattice.to_cell(xy))`` is the number of a point's cell.
    whole
        ``bool (n,)``: which lie within the image wholly.
    """

    lattice: Lattice
    numbers: Integers
    whole: NDArray[np.bool_]

    @property
    def count(self) -> int:
        """How many cells lie within the image wholly."""
        return int(self.whole.sum())

    @property
    def area(self) -> float:
        """Area of the whole cells together, px^2."""
        return self.count * self.lattice.area

    def corners(self) -> Points:
        """Return each cell's corners (x, y) in px, going round it, ``(n, 4, 2)``."""
        return self.lattice.from_cell(self.numbers[:, np.newaxis] + np.array([(0, 0), (1, 0), (1, 1), (0, 1)]))


def cells(lattice: Lattice, shape: tuple[int, int]) -> Cells:
    """Return the cells of which some part, or all, lies in an image.

    Cells depend on the basis and on the origin: reduce the lattice first for the most compact ones. Time grows with the
    number of cells.

    Parameters
    ----------
    lattice
        In the image's coordinates.
    shape
        (height, width) in px of the image, which covers [-0.5, width - 0.5) x [-0.5, height - 0.5).

    Returns
    -------
    Cells
        At least one.
    """
    height, width = shape
    low, high = np.array([-0.5, -0.5]), np.array([width - 0.5, height - 0.5])
    first, last = np.minimum(lattice.matrix, 0).sum(0), np.maximum(lattice.matrix, 0).sum(0)
    numbers = lattice.cell_numbers(low - last, high - first)
    starts = lattice.from_cell(numbers) + first
    ends = starts + last - first
    meets = ((starts < high - TOUCH) & (ends > low + TOUCH)).all(1) & _beside(lattice, numbers, low, high)
    whole = ((starts >= low - TOUCH) & (ends <= high + TOUCH)).all(1)
    return Cells(lattice, numbers[meets], whole[meets])


def _beside(lattice: Lattice, numbers: Integers, low: Points, high: Points) -> NDArray[np.bool_]:
    """Return which cells no line along t1 or t2 parts from the image."""
    corners = lattice.to_cell([(x, y) for x in (low[0], high[0]) for y in (low[1], high[1])])
    slack = TOUCH * np.hypot(*lattice.matrix[::-1].T) / lattice.area
    return np.asarray(((numbers + 1 > corners.min(0) + slack) & (numbers < corners.max(0) - slack)).all(1))
