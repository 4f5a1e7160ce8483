"""Divide an output into square blocks like a chess-board, and describe the border inside each gap.

Every other block is *placed* first; the others are *gaps*. The patch of a placed block reaches beyond its square and
shows a border in the gaps beside it. Where two borders meet in a corner of a gap, the diagonal divides them, so that
each has the shape of a wedge.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from functools import lru_cache
from typing import Final

import numpy as np
from numpy.typing import NDArray

from nrbench.errors import BadInput
from nrbench.lattice.geometry import Points
from nrbench.plugins.forms import Refused

from ..sampling.equal_places import SearchShape, search_shape

Box = tuple[int, int, int, int]
"""(y0, y1, x0, x1), half-open, px."""
Sides = tuple[bool, bool, bool, bool]
"""Which neighbors a block has: left, top, right, bottom."""
_STEPS: Final = ((-1, 0), (0, -1), (1, 0), (0, 1))
"""(x, y) from a block to each neighbor, in blocks."""
OWN: Final = 4
"""The layer of a gap's own patch; 0 to 3 are the neighbors'."""


def check_border(block: int, border: int) -> None:
    """Raise :class:`BadInput` unless ``border`` is from 1 px to half a block."""
    if not 1 <= border <= block // 2:
        raise BadInput(f"border {border} with block {block}; choose a border from 1 to half a block")


def box_slices(box: Box, top: int = 0, left: int = 0) -> tuple[slice, slice]:
    """Return the rows and columns of a box whose (0, 0) lies at row ``top`` and column ``left``."""
    y0, y1, x0, x1 = box
    return slice(top + y0, top + y1), slice(left + x0, left + x1)


@dataclass(frozen=True)
class BlockGrid:
    """The blocks of an output. Those at the right and at the bottom may reach beyond it.

    Parameters
    ----------
    shape
        Height and width of the output in px.
    size
        Side of a block in px.
    border
        Width in px of what the patch of a placed block shows beyond its square, at most half a block.
    """

    shape: tuple[int, int]
    size: int
    border: int

    @property
    def counts(self) -> tuple[int, int]:
        """Rows and columns of blocks."""
        height, width = self.shape
        return -(-height // self.size), -(-width // self.size)

    def placed(self) -> Iterator[Block]:
        """Yield the placed blocks, row by row."""
        return self._alternate(0)

    def gaps(self) -> Iterator[Block]:
        """Yield the gaps, row by row."""
        return self._alternate(1)

    def _alternate(self, parity: int) -> Iterator[Block]:
        rows, columns = self.counts
        return (Block(self, i, j) for i in range(rows) for j in range(columns) if (i + j) % 2 == parity)

    def search_shape(self, sample_shape: tuple[int, ...]) -> SearchShape:
        """Return the rows and columns of places at which a block and its borders lie inside a sample.

        Raises
        ------
        Refused
            If there are none.
        """
        height, width = sample_shape[:2]
        side = self.size + 2 * self.border
        if side > min(height, width):
            raise Refused(
                f"the sample is {width}x{height} px, a block with its borders {side}x{side} px; "
                f"choose block + 2 border <= {min(height, width)}"
            )
        return search_shape(side, (height, width))


@dataclass(frozen=True)
class Block:
    """A block of a grid: where it lies in the output, and what surrounds it.

    Parameters
    ----------
    grid
        The grid.
    row, column
        The place of the block in the grid.
    """

    grid: BlockGrid
    row: int
    column: int

    @property
    def corner(self) -> Points:
        """(x, y) px of the first pixel."""
        return np.array([self.column, self.row], np.float64) * self.grid.size

    @property
    def box(self) -> Box:
        """The block itself, px from its first pixel."""
        return 0, self.grid.size, 0, self.grid.size

    def window(self, box: Box | None = None) -> tuple[slice, slice]:
        """Return the rows and columns of the output under the block, or under a box, px from its first pixel."""
        size = self.grid.size
        return box_slices(box or self.box, self.row * size, self.column * size)

    @property
    def sides(self) -> Sides:
        """Which neighbors the block has."""
        rows, columns = self.grid.counts
        return self.column > 0, self.row > 0, self.column < columns - 1, self.row < rows - 1

    def neighbors(self) -> Iterator[tuple[int, Block, Box]]:
        """Yield each side that has a neighbor, the neighbor, and the strip of this gap that its patch shows."""
        size, border = self.grid.size, self.grid.border
        far = size - border
        strips = ((0, size, 0, border), (0, border, 0, size), (0, size, far, size), (far, size, 0, size))
        for side, (there, (dx, dy), strip) in enumerate(zip(self.sides, _STEPS, strips, strict=True)):
            if there:
                yield side, Block(self.grid, self.row + dy, self.column + dx), strip

    @property
    def border(self) -> GapBorder:
        """The border inside the block, which is a gap."""
        return gap_border(self.grid.size, self.grid.border, self.sides)


@dataclass(frozen=True, eq=False)
class GapBorder:
    """The border inside a gap: its n pixels are less than ``border`` px from a neighbor.

    Parameters
    ----------
    pixels
        ``(n, 2)``: (x, y) in the gap.
    owner
        ``(n,)``: the side in whose wedge the pixel lies, which is the nearest one.
    layers
        ``(3, n)``: the layers blended at the pixel: the gap's own patch, the neighbor to the left or right, and the one
        above or below.
    weights
        ``float32 (3, n)``: weights of these layers; they sum to 1.
    hole
        The rest of the gap.
    owners
        ``(block, block)``: the owner of every pixel of the gap, :data:`OWN` in the hole.
    """

    pixels: NDArray[np.int64]
    owner: NDArray[np.int64]
    layers: NDArray[np.int64]
    weights: NDArray[np.float32]
    hole: Box
    owners: NDArray[np.int64]


@lru_cache(maxsize=256)
def gap_border(block: int, border: int, sides: Sides) -> GapBorder:
    """Return the border of a gap that has neighbors at ``sides``.

    The gap's own patch fades in linearly from the gap's edge to the border's inner edge. The rest of the weight goes to
    the neighbor in whose wedge the pixel lies, with a smooth passage across the diagonal between two wedges. At the
    gap's edge the neighbor has all the weight, so that the squares of placed blocks stay as they are.
    """
    depths = _depths(block, border, sides)
    rows, columns = np.nonzero(depths.min(0) < 1)
    depth = depths[:, rows, columns]
    beside, above = np.where(depth[0] < depth[2], 0, 2), np.where(depth[1] < depth[3], 1, 3)
    p, q = depth[[0, 2]].min(0), depth[[1, 3]].min(0)
    layers, weights = np.stack([np.full_like(beside, OWN), beside, above]), _weights(p, q)
    owners = np.full((block, block), OWN)
    owners[rows, columns] = np.where(p <= q, beside, above)
    left, top, right, bottom = (border if side else 0 for side in sides)
    return GapBorder(
        pixels=np.stack([columns, rows], -1),
        owner=owners[rows, columns],
        layers=np.where(weights > 0, layers, OWN),
        weights=weights,
        hole=(top, block - bottom, left, block - right),
        owners=owners,
    )


def _depths(block: int, border: int, sides: Sides) -> NDArray[np.float64]:
    """Return the distance of each pixel from each side over the border's width, at most 1: ``(4, block, block)``."""
    depth = np.minimum((np.arange(block) + 0.5) / border, 1)
    across, down = np.broadcast_to(depth, (block, block)), np.broadcast_to(depth[:, np.newaxis], (block, block))
    depths = np.stack([across, down, across[:, ::-1], down[::-1]])
    return np.where(np.array(sides)[:, np.newaxis, np.newaxis], depths, 1)


def _weights(p: NDArray[np.float64], q: NDArray[np.float64]) -> NDArray[np.float32]:
    own = np.minimum(p, q)
    beside, above = 1 / p - 1, 1 / q - 1
    share = beside / (beside + above)
    return np.stack([own, (1 - own) * share, (1 - own) * (1 - share)]).astype(np.float32)
