"""Square blocks that fill an output in a chess-like fashion, and the wedge-shaped borders between them.

Every other block (a *placed* one) lends the gaps beside it a border: the part of its patch that reaches beyond its
square, into the gap. Where two borders meet in a corner of the gap, the diagonal divides them: they are wedges.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from .matching import Hole

Sides = tuple[bool, bool, bool, bool]
"""Which neighbours a block has: left, top, right, bottom."""
STEPS = ((-1, 0), (0, -1), (1, 0), (0, 1))
"""(x, y) from a block to each neighbour, in blocks."""
OWN = 4
"""The layer of the gap's own patch; 0 to 3 are the neighbours'."""


@dataclass(frozen=True)
class BlockGrid:
    """The division of an output into blocks; those at the right and bottom may reach beyond it.

    Parameters
    ----------
    shape
        Height and width of the output in px.
    block
        Side of a block in px.
    border
        Width in px of what a placed block's patch shows beyond its square; at most half a block.
    """

    shape: tuple[int, int]
    block: int
    border: int

    @property
    def counts(self) -> tuple[int, int]:
        """Rows and columns of blocks."""
        height, width = self.shape
        return -(-height // self.block), -(-width // self.block)

    def placed(self) -> Iterator[tuple[int, int]]:
        """Yield (row, column) of the blocks that are sampled."""
        return self._chess(0)

    def gaps(self) -> Iterator[tuple[int, int]]:
        """Yield (row, column) of the blocks that are filled in afterwards."""
        return self._chess(1)

    def _chess(self, parity: int) -> Iterator[tuple[int, int]]:
        rows, columns = self.counts
        return ((i, j) for i in range(rows) for j in range(columns) if (i + j) % 2 == parity)

    def sides(self, row: int, column: int) -> Sides:
        """Return which neighbours the block has."""
        rows, columns = self.counts
        return column > 0, row > 0, column < columns - 1, row < rows - 1


@dataclass(frozen=True, eq=False)
class Wedges:
    """The border inside a gap, pixel by pixel; n pixels, those less than ``border`` px from a neighbour.

    Parameters
    ----------
    pixels
        ``(n, 2)``: their (x, y) in the gap.
    owner
        ``(n,)``: the side whose wedge the pixel lies in: the nearest one.
    layers
        ``(3, n)``: what is blended there: the gap's own patch, and the neighbour beside and the one above or below.
    weights
        ``float32 (3, n)``: how much of each; they sum to 1.
    hole
        The rest of the gap.
    owners
        ``(block, block)``: the owner of every pixel of the gap, :data:`OWN` in the hole.
    """

    pixels: NDArray[np.int64]
    owner: NDArray[np.int64]
    layers: NDArray[np.int64]
    weights: NDArray[np.float32]
    hole: Hole
    owners: NDArray[np.int64]


@lru_cache(maxsize=256)
def wedges(block: int, border: int, sides: Sides) -> Wedges:
    """Return the border of a gap that has neighbours at ``sides``.

    A gap's own patch fades in linearly, from its edge to the border's inner edge. The rest is the neighbour's whose
    wedge it is; across the diagonal between two wedges one passes smoothly into the other, and at the gap's edge each
    neighbour is whole, so that no block's own square is touched.
    """
    depths = _depths(block, border, sides)
    rows, columns = np.nonzero(depths.min(0) < 1)
    depth = depths[:, rows, columns]
    beside, above = np.where(depth[0] < depth[2], 0, 2), np.where(depth[1] < depth[3], 1, 3)
    p, q = depth[[0, 2]].min(0), depth[[1, 3]].min(0)
    layers, weights = np.stack([np.full_like(beside, OWN), beside, above]), _weights(p, q)
    owners = np.full((block, block), OWN)
    owners[rows, columns] = np.where(p <= q, beside, above)
    return Wedges(
        pixels=np.stack([columns, rows], -1),
        owner=owners[rows, columns],
        layers=np.where(weights > 0, layers, OWN),
        weights=weights,
        hole=_hole(block, border, sides),
        owners=owners,
    )


def _depths(block: int, border: int, sides: Sides) -> NDArray[np.float64]:
    """Distance of each pixel from each side, as a share of the border, at most 1: ``(4, block, block)``."""
    depth = np.minimum((np.arange(block) + 0.5) / border, 1)
    across, down = np.broadcast_to(depth, (block, block)), np.broadcast_to(depth[:, np.newaxis], (block, block))
    depths = np.stack([across, down, across[:, ::-1], down[::-1]])
    return np.where(np.array(sides)[:, np.newaxis, np.newaxis], depths, 1)


def _weights(p: NDArray[np.float64], q: NDArray[np.float64]) -> NDArray[np.float32]:
    own = np.minimum(p, q)
    beside, above = 1 / p - 1, 1 / q - 1
    share = beside / (beside + above)
    return np.stack([own, (1 - own) * share, (1 - own) * (1 - share)]).astype(np.float32)


def _hole(block: int, border: int, sides: Sides) -> Hole:
    left, top, right, bottom = (border if side else 0 for side in sides)
    return top, block - bottom, left, block - right
