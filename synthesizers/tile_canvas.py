"""The picture that tiles are laid on, one over another."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from nrbench.imaging.door import Image
from nrbench.imaging.seams import dynamic_seam

from .tile_kernels import error_surface, paste
from .tile_stock import Cuts, Overlap, Stock
from .tile_symmetry import Picture


class Seams(NamedTuple):
    """Where a tile begins over what stands there.

    Parameters
    ----------
    across
        ``(rows,)``: the first new column of the left band.
    down
        ``(columns,)``: the first new row of the top band.
    bands
        Columns of the left band and rows of the top band, 0 where there is none.
    """

    across: NDArray[np.int64]
    down: NDArray[np.int64]
    bands: NDArray[np.int64]


class Canvas:
    """An output with a margin around it, wide enough for every tile that touches the output.

    Parameters
    ----------
    shape
        Height and width of the output.
    stock
        Where the tiles come from.
    pictures
        How the pictures of the stock's source lie in the sample.
    slope
        How far, px, a seam may move aside from one row to the next.
    feather
        Width in px of the ramp where the two seams of a tile conflict; 0 cuts.
    """

    def __init__(
        self, shape: tuple[int, int], stock: Stock, pictures: list[Picture], slope: int, feather: float
    ) -> None:
        self.shape, self.source, self.pictures = shape, stock.source, pictures
        self.slope, self.feather = slope, float(feather)
        _, width, channels = self.source.shape
        self.margin = np.ceil(2 * stock.frame.reach).astype(int) + 2
        size = shape[0] + 2 * self.margin[1], shape[1] + 2 * self.margin[0]
        self.values = np.zeros((*size, channels), np.uint8)
        self.filled = np.zeros(size, np.uint8)
        self.origins = np.zeros((*size, 3), np.float32)
        x, y, row, column, border = stock.frame.pixels.T
        self.pixels = np.ascontiguousarray(np.column_stack([x, y, (y * width + x) * channels, row, column, border]))
        x, y = np.moveaxis(stock.frame.cells, -1, 0)
        self.cells = np.ascontiguousarray(np.stack([x, y, (y * width + x) * channels], -1))
        self.surface = np.empty(stock.frame.grid, np.float64)

    def overlap(self, left: int, top: int) -> Overlap:
        """Return what stands under a tile around pixel (left, top) of the canvas."""
        x, y = left + self.pixels[:, 0], top + self.pixels[:, 1]
        there = self.filled[y, x] != 0
        return Overlap.of(self.values[y[there], x[there]], self.pixels[there, 2])

    def lay(self, left: int, top: int, cut: Cuts) -> None:
        """Lay one tile around pixel (left, top) of the canvas, stitched to what stands there (steps 5 and 6)."""
        _, width, channels = self.source.shape
        (x, y), copy = cut.pixel[0], int(cut.copy[0])
        source, first = self.source.values[copy], int(y * width + x) * channels
        error_surface(self.values, self.filled, source, first, self.cells, left, top, self.surface)
        paste(
            self.values,
            self.filled,
            self.origins,
            source,
            first,
            self.pixels,
            left,
            top,
            *seams(self.surface, self.slope),
            self.feather,
            self._place(cut),
        )

    def _place(self, cut: Cuts) -> NDArray[np.float64]:
        """Return where the tile's middle is in the sample, the weight of that pixel, and the turn of the tile."""
        picture, part = divmod(int(cut.copy[0]), self.source.parts**2)
        fraction = np.array([part % self.source.parts, part // self.source.parts]) / self.source.parts
        matrix, offset = self.pictures[picture].matrix, self.pictures[picture].offset
        near = matrix @ (cut.pixel[0] + np.floor(fraction + 0.5)) + offset
        return np.array([*near, np.maximum(fraction, 1 - fraction).prod(), *matrix.ravel()])

    def picture(self) -> tuple[Image, NDArray[np.float32]]:
        """Return the output and its source map."""
        (height, width), (x, y) = self.shape, self.margin
        window = np.s_[y : y + height, x : x + width]
        return np.asarray(self.values[window] / np.float32(255), np.float32), self.origins[window].copy()


def seams(surface: NDArray[np.float64], slope: int) -> Seams:
    """Return the seams of a tile by dynamic programming, along the two directions separately (step 5).

    The left band is as wide as what stands reaches from the left in rows that are not wholly covered, the top band as
    high as it reaches from the top in columns that are not.

    Parameters
    ----------
    surface
        ``(rows, columns)``: squared differences, negative where nothing stands.
    slope
        How far, px, a seam may move aside from one row to the next.
    """
    missing = surface < 0
    bands = np.array([_band(missing), _band(missing.T)])
    error = np.where(missing, 0, surface)
    rows, columns = surface.shape
    across = _seam(error[:, : bands[0]], slope) if bands[0] else np.zeros(rows, np.int64)
    down = _seam(error[: bands[1]].T, slope) if bands[1] else np.zeros(columns, np.int64)
    return Seams(across, down, bands)


def _band(missing: NDArray[np.bool_]) -> int:
    """Return how far what stands reaches from the left, in rows where something is missing."""
    some = missing.any(1)
    return int(missing.argmax(1)[some].max()) if some.any() else 0


def _seam(error: NDArray[np.float64], slope: int) -> NDArray[np.int64]:
    """Return the seam through rows that are each taken ``slope`` times, so that one row lets it move so far."""
    path = dynamic_seam(np.repeat(error, slope, axis=0))
    return np.ascontiguousarray(path[slope // 2 :: slope])
