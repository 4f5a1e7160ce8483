"""The shape of a tile set's tiles, and the steps by which they are laid."""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cached_property
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from nrbench.lattice.geometry import Lattice, Points

Tile = Literal["upright", "lattice", "rectangle", "cell"]


@dataclass(frozen=True, eq=False)
class Frame:
    """A maximum tile and how it is laid.

    Parameters
    ----------
    steps
        ``(2, 2)``: the step to the next tile of a row and the one to the next row, rows (x, y) px. Twice a step is a
        lattice vector.
    sides
        ``(2, 2)``: the two sides of the maximum tile, a parallelogram around its middle.
    core
        ``(2, 2)``: the two sides of the minimum tile.
    """

    steps: Points
    sides: Points
    core: Points

    def distinct(self, lattice: Lattice) -> list[tuple[int, int]]:
        """Return the steps (in the row, to the next row) from a lattice point to the middles of each set of tiles.

        Tiles are of one set where a lattice vector leads from one's place to the other's. Sides that are diagonals of
        the cell have two sets, T and Th; those along the lattice's vectors up to four; twice as large ones one, T.
        """
        numbers = list(np.ndindex(2, 2))
        halves = np.rint(2 * np.array(numbers) @ self.steps @ np.linalg.inv(lattice.matrix)).astype(int) % 2
        _, first = np.unique(halves, axis=0, return_index=True)
        return [numbers[n] for n in sorted(first.tolist())]

    @cached_property
    def reach(self) -> Points:
        """How far, along x and y in px, the tile reaches from its middle."""
        return np.asarray(np.abs(self.sides).sum(0) / 2)

    @cached_property
    def grid(self) -> tuple[int, int]:
        """Rows and columns, of a pixel or less, that divide the tile along its sides."""
        columns, rows = np.ceil(np.hypot(*self.sides.T) - 1e-9).astype(int)
        return max(int(rows), 1), max(int(columns), 1)

    @cached_property
    def pixels(self) -> NDArray[np.int64]:
        """``(n, 5)``: (x, y) of each whole-pixel point of the tile from its middle, and its cell of the grid.

        The cell is given by row, column, and how many cells lie between it and the tile's border.
        """
        x, y = np.floor(self.reach + 1e-9).astype(int)
        offsets = np.stack(np.meshgrid(np.arange(-x, x + 1), np.arange(-y, y + 1)), -1).reshape(-1, 2)
        ab = offsets @ np.linalg.inv(self.sides)
        inside = (np.abs(ab) <= 0.5 + 1e-9).all(1)
        rows, columns = self.grid
        column = np.clip(np.floor((ab[inside, 0] + 0.5) * columns), 0, columns - 1)
        row = np.clip(np.floor((ab[inside, 1] + 0.5) * rows), 0, rows - 1)
        border = np.minimum.reduce([column, row, columns - 1 - column, rows - 1 - row])
        return np.column_stack([offsets[inside], row, column, border]).astype(np.int64)

    @cached_property
    def box(self) -> NDArray[np.int64]:
        """``(2, 2)``: the least and the greatest (x, y) of the tile's pixels."""
        return np.stack([self.pixels[:, :2].min(0), self.pixels[:, :2].max(0)])

    @cached_property
    def cells(self) -> NDArray[np.int64]:
        """``(rows, columns, 2)``: the whole-pixel (x, y), from the tile's middle, nearest to each cell of its grid."""
        rows, columns = self.grid
        a, b = (np.arange(columns) + 0.5) / columns - 0.5, (np.arange(rows) + 0.5) / rows - 0.5
        at = np.stack(np.meshgrid(a, b), -1) @ self.sides
        return np.clip(np.floor(at + 0.5).astype(np.int64), *self.box)


def frame_of(lattice: Lattice, tile: Tile, cells: int = 1, margin: float = 0.0) -> Frame:
    """Return the frame of tiles whose sides are ``cells`` times those of a tile (see :func:`_frame_of`).

    Any tile of the lattice tiles the texture, and so does one of k x k cells: its steps are still half lattice vectors.
    Tiles with a ``margin`` are so many px longer at both ends of each side; the steps stay.
    """
    frame = _frame_of(lattice, tile)
    sides = cells * frame.sides
    sides = sides * (1 + 2 * margin / np.hypot(*sides.T))[:, np.newaxis]
    if tile == "upright":
        sides = np.diag(_without_gaps(np.diag(sides)))
    return Frame(cells * frame.steps, sides, cells * frame.core)


def _frame_of(lattice: Lattice, tile: Tile) -> Frame:
    """Return the tiles' frame.

    Parameters
    ----------
    lattice
        Its two shortest vectors t1, t2 span the minimum tile.
    tile
        ``"upright"``: the smallest upright rectangle around the minimum tile, laid along t1 + t2 in half steps, rows
        (t2 - t1) / 2 apart: what the paper does. ``"lattice"``: the same steps, and sides along t1 + t2 and t2 - t1:
        what the paper suggests; where t1 and t2 are equally long a rectangle, on an upright rhombic lattice the same
        one. ``"rectangle"``: sides t2 and 2 t1, the shorter vector doubled, in half steps along them: of two cells,
        too; upright on an upright rectangular lattice. ``"cell"``: sides t1 and t2, the minimum tile itself, in half
        steps along them.
    """
    t1, t2 = _basis(lattice)
    if tile == "cell":
        sides = _across_and_down(t1, t2)
        return Frame(sides / 2, sides, sides)
    if tile == "rectangle":
        sides = _across_and_down(2 * t1, t2)
        return Frame(sides / 2, sides, _across_and_down(t1, t2))
    sides, core = _across_and_down(t1 + t2, t2 - t1), np.stack([t1, t2])
    if tile == "lattice":
        return Frame(sides / 2, sides, core)
    return Frame(sides / 2, np.diag(np.abs(core).sum(0)), core)


def _without_gaps(lengths: Points) -> Points:
    """Return the lengths of sides, some rounded up, whose pixels meet where tiles lie that far apart.

    A tile has an odd number of pixels around its middle, and whole-pixel places may lie the next whole number apart. On
    a rectangular lattice an upright tile is the minimum tile itself, and two such gaps would cross at its border.
    """
    whole = np.ceil(lengths - 1e-9)
    return np.where(2 * np.floor(lengths / 2 + 1e-9) + 1 < whole, whole, lengths)


def _across_and_down(first: Points, second: Points) -> Points:
    """Return the two vectors, the one nearer to the x axis first, pointing right, the other pointing down."""
    across, down = sorted((first, second), key=_slope)
    return np.stack([across * (1 if across[0] >= 0 else -1), down * (1 if down[1] >= 0 else -1)])


def _basis(lattice: Lattice) -> Points:
    """Return the two shortest vectors; of equally short pairs the one with a diagonal nearest to the x axis."""
    a, b = lattice.reduced().matrix
    pairs: list[tuple[Points, Points]] = [(a, b), (a, b - a), (b, b - a)]
    lengths = [max(float(p @ p), float(q @ q)) for p, q in pairs]
    shortest = [pair for pair, length in zip(pairs, lengths, strict=True) if length <= min(lengths) * (1 + 1e-6)]
    a, b = min(shortest, key=_diagonal_slope)
    return np.stack([a, b])


def _diagonal_slope(pair: tuple[Points, Points]) -> float:
    """Return the least angle between one of a pair's diagonals and the x axis."""
    return min(_slope(pair[0] + pair[1]), _slope(pair[1] - pair[0]))


def _slope(vector: Points) -> float:
    """Return the angle between a vector's line and the x axis."""
    return math.atan2(abs(vector[1]), abs(vector[0]))
