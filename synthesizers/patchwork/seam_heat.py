"""Where the seams of an output are worst."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from nrbench.imaging.box_sums import box_sums

from .patchwork import Patchwork, Window

FINE = 6
"""Windows are looked at in steps of this part of their shorter side."""


@dataclass(frozen=True, eq=False)
class SeamHeat:
    """What the seams of an output cost, summed over blocks; blocks cool down with each try to improve them.

    Blocks keep the search for the worst window cheap: a step costs O(H W / q^2) for blocks of q px, and what a new
    patch changes is summed anew, alone.

    Parameters
    ----------
    work
        The output.
    size
        (height, width) px of the windows that are compared, not larger than the output.
    """

    work: Patchwork
    size: tuple[int, int]

    @cached_property
    def block(self) -> int:
        """Side of a block, px."""
        return max(1, min(self.size) // FINE)

    @cached_property
    def tries(self) -> NDArray[np.int64]:
        """How often each block has been tried."""
        return np.zeros(self._costs.shape, np.int64)

    @cached_property
    def _costs(self) -> NDArray[np.float64]:
        height, width = self.work.shape
        return self._summed(self._blocks(0, height, 0), self._blocks(0, width, 1))

    def _summed(self, rows: NDArray[np.int64], columns: NDArray[np.int64]) -> NDArray[np.float64]:
        """Return what the seams cost in each block of some rows and columns of blocks, in rising order."""
        y, x = ((numbers[:, np.newaxis] * self.block + np.arange(self.block)).ravel() for numbers in (rows, columns))
        y, x = y[y < self.work.shape[0]], x[x < self.work.shape[1]]
        seams = self.work.seams[:, y[:, np.newaxis], x].sum(0)
        by_rows = np.add.reduceat(seams, np.searchsorted(y, rows * self.block), 0)
        return np.add.reduceat(by_rows, np.searchsorted(x, columns * self.block), 1).astype(np.float64)

    def worst(self) -> Window:
        """Return the window whose seams cost most, each block's cost halved with each try."""
        heat = self._costs * 0.5 ** np.minimum(self.tries, 50)
        height, width = (min(-(-side // self.block), most) for side, most in zip(self.size, heat.shape, strict=True))
        if self.work.wrap:
            heat = np.pad(heat, ((0, height - 1), (0, width - 1)), "wrap")
        sums = box_sums(heat, (height, width))
        y, x = (self.block * k for k in divmod(int(sums.argmax()), sums.shape[1]))
        if not self.work.wrap:
            y, x = min(y, self.work.shape[0] - self.size[0]), min(x, self.work.shape[1] - self.size[1])
        return y, y + self.size[0], x, x + self.size[1]

    def tried(self, window: Window, reach: int = 0) -> None:
        """Note that a window was covered anew: blocks with pixels up to ``reach`` px from it are summed again."""
        y0, y1, x0, x1 = window
        rows, columns = self._blocks(y0 - 1 - reach, y1 + reach, 0), self._blocks(x0 - 1 - reach, x1 + reach, 1)
        self._costs[np.ix_(rows, columns)] = self._summed(rows, columns)
        self.tries[np.ix_(self._blocks(*window[:2], 0), self._blocks(*window[2:], 1))] += 1

    def _blocks(self, start: int, stop: int, axis: int) -> NDArray[np.int64]:
        """Return the blocks that pixels from ``start`` up to ``stop`` lie in, along an axis."""
        side = self.work.shape[axis]
        pixels = np.arange(start, stop) % side if self.work.wrap else np.arange(max(start, 0), min(stop, side))
        return np.unique(pixels // self.block)
