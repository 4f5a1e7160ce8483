"""Laying rectangular tiles over an output: which point of the sample every output pixel shows."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from nrbench.imaging.convert import Image
from nrbench.lattice.geometry import Points
from nrbench.plugins.forms import SourceMap, Task

from ..sampling.patches import Patches
from ..sampling.splines import resampled
from .tile_rectangle import TileFrame
from .wang import WangSet


@dataclass(frozen=True, eq=False)
class Laying:
    """Tiles side by side, from where the first was cut.

    Parameters
    ----------
    frame
        The tiles' size, and where their pixels lie in the sample.
    tiles
        One tile, or a set that is laid by its edges' colors. Where its corner lies in the sample the output shows a
        tile's first pixel, so that the output continues the sample's phase.
    rescale
        Whether the periods are the sample's, or the tiles' whole pixels.
    """

    frame: TileFrame
    tiles: WangSet
    rescale: bool

    @property
    def _corner(self) -> Points:
        """Where (x, y) in the output a tile's first pixel lies."""
        corner = np.array(self.tiles.corner, np.float64)
        return self.frame.to_sample(corner) if self.rescale else corner

    @property
    def _steps(self) -> Points:
        """How far (x, y) px of the output a step by one tile pixel goes along columns and rows."""
        rows, columns = self.frame.size
        return self.frame.periods / np.array([[columns], [rows]]) if self.rescale else np.eye(2)

    def numbers(self, shape: tuple[int, int]) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
        """Return the least and the greatest number (x, y) of the tiles that an output of ``shape`` shows."""
        ends = np.array([[x, y] for x in (0, shape[1] - 1) for y in (0, shape[0] - 1)], np.float64)
        cells, _, _ = self._split(ends)
        return cells.min(0), cells.max(0)

    def _split(self, pixels: Points) -> tuple[NDArray[np.int64], NDArray[np.int64], Points]:
        """Return the number (x, y) of each output pixel's tile, the nearest pixel in it, and what is left."""
        at = (pixels - self._corner) @ np.linalg.inv(self._steps)
        nearest = np.floor(at + 0.5).astype(np.int64)
        cells, inside = np.divmod(nearest, np.array(self.frame.size[::-1]))
        return cells, inside, at - nearest

    def source(self, laid_out: NDArray[np.int64], low: NDArray[np.int64], pixels: Points) -> Points:
        """Return the points of the sample that output pixels show, given which tile lies where (rows, columns)."""
        cells, inside, rest = self._split(pixels)
        column, row = np.moveaxis(cells - low, -1, 0)
        x, y = np.moveaxis(inside, -1, 0)
        return self.frame.to_sample(self.tiles.sources[laid_out[row, column], y, x] + rest)


def laid(task: Task, laying: Laying, patches: Patches) -> tuple[Image, SourceMap]:
    """Return the output and its source map."""
    low, high = laying.numbers(task.shape)
    columns, rows = high - low + 1
    laid_out = laying.tiles.lay_out((int(rows), int(columns)), task.rng)
    return resampled(task, lambda pixels: laying.source(laid_out, low, pixels), patches)
