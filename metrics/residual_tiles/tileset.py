"""Sets of tiles that are compared: those of the output, of the sample and of fresh draws, all cut on one grid."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from nrbench.imaging.convert import Image
from nrbench.imaging.fold import Values, cut_tiles, tile_grid
from nrbench.lattice.geometry import Lattice, Points
from nrbench.plugins.forms import Shape

Grid = tuple[int, int]
QUARTERS = ((-0.25, -0.25), (0.25, -0.25), (-0.25, 0.25), (0.25, 0.25))
"""Cell coordinates of the middles of a tile's quarters, in the order of :func:`quarters`."""


@dataclass(frozen=True)
class TileSet:
    """Whole tiles of one image.

    Parameters
    ----------
    numbers
        ``(n, 2)``: which lattice point each tile lies around, in whole cells.
    centers
        ``(n, 2)``: their middles (x, y) px.
    tiles
        ``(n, V, U, C)``, V and U even.
    lattice
        Reduced.
    """

    numbers: NDArray[np.int64]
    centers: Points
    tiles: Values
    lattice: Lattice

    @classmethod
    def cut(cls, image: Image, lattice: Lattice, numbers: Points, centers: Points, grid: Grid) -> TileSet:
        """Cut the tiles around ``centers`` that lie within the image."""
        tiles, inside = cut_tiles(image, lattice, centers, grid)
        return cls(np.rint(numbers[inside]).astype(np.int64), centers[inside], tiles, lattice)

    @classmethod
    def on(cls, image: Image, lattice: Lattice, grid: Grid) -> TileSet:
        """Cut the tiles around the lattice's points."""
        centers = lattice.points(image.shape[:2])
        return cls.cut(image, lattice, lattice.to_cell(centers), centers, grid)

    def __len__(self) -> int:
        return len(self.tiles)

    @cached_property
    def departures(self) -> Values:
        """``(n, V, U, C)``: each tile less the mean of all, times sqrt(n / (n - 1)): the mean took 1/n of energy."""
        if len(self) < 2:
            return self.tiles - self.tiles
        return np.asarray((self.tiles - self.tiles.mean(0)) * np.float32(np.sqrt(len(self) / (len(self) - 1))))

    def middle(self, most: int) -> TileSet:
        """Return the ``most`` tiles nearest to the middle of them all: neighbors stay together."""
        if len(self) <= most:
            return self
        away = np.hypot(*(self.centers - self.centers.mean(0)).T)
        return self.some(np.sort(np.argsort(away, kind="stable")[:most]))

    def blocks(self, shape: Shape, extent: Shape) -> Iterator[TileSet]:
        """Yield the tiles in upright boxes of ``extent`` that cover an image of ``shape`` and overlap least."""
        starts = [
            np.linspace(0, max(side - length, 0), -(-side // length))
            for side, length in zip(shape, extent, strict=True)
        ]
        for y in starts[0]:
            for x in starts[1]:
                inside = (self.centers >= (x, y)) & (self.centers <= (x + extent[1] - 1, y + extent[0] - 1))
                yield self.some(np.flatnonzero(inside.all(1)))

    def neighbors(self) -> NDArray[np.intp]:
        """Return the tiles at (0, 0), (1, 0), (0, 1) and (1, 1) from each that has all of them, ``(m, 4)``."""
        low = self.numbers.min(0) if len(self) else np.zeros(2, np.int64)
        size = (self.numbers.max(0) - low + 2) if len(self) else np.ones(2, np.int64)
        table = np.full(size, -1, np.intp)
        at = self.numbers - low
        table[at[:, 0], at[:, 1]] = np.arange(len(self))
        found = np.stack([table[at[:, 0] + du, at[:, 1] + dv] for dv in (0, 1) for du in (0, 1)], -1)
        return np.asarray(found[(found >= 0).all(1)])

    def some(self, index: NDArray[np.intp]) -> TileSet:
        """Return the tiles at ``index``."""
        return TileSet(self.numbers[index], self.centers[index], self.tiles[index], self.lattice)


def even_grid(lattice: Lattice) -> Grid:
    """Return the samples (V, U) of a tile, both even, so that its quarters are alike."""
    rows, columns = tile_grid(lattice)
    return rows + rows % 2, columns + columns % 2


def quarters(tiles: Values) -> Values:
    """Return the quarters of tiles ``(n, V, U, C)`` as ``(4, n, V / 2, U / 2, C)``."""
    rows, columns = tiles.shape[1] // 2, tiles.shape[2] // 2
    parts = [tiles[:, y : y + rows, x : x + columns] for y in (0, rows) for x in (0, columns)]
    return np.stack(parts)
