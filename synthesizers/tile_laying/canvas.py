"""The picture that tiles are laid on, one over another."""

from __future__ import annotations

from typing import Literal, NamedTuple

import numpy as np
from numpy.typing import NDArray

from nrbench.imaging.convert import Image

from .choice_kernels import band_width, gather, wide_seam
from .cut_kernels import cut_tile
from .stock import Cuts, Overlap, Stock
from .symmetry import Picture
from .tile_kernels import error_surface, paste

Stitch = Literal["dynamic", "graphcut"]


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
    stitch
        Two seams by dynamic programming, or the exact minimum cut of the overlap, which never conflicts with itself.
    """

    def __init__(
        self,
        shape: tuple[int, int],
        stock: Stock,
        pictures: list[Picture],
        slope: int,
        feather: float,
        stitch: Stitch = "dynamic",
    ) -> None:
        self.shape, self.source = shape, stock.source
        self.places = _places(pictures, stock.source.parts)
        self.slope, self.feather = slope, float(feather)
        _, width, channels = self.source.shape
        self.margin = np.ceil(3 * stock.frame.reach).astype(int) + 2
        size = shape[0] + 2 * self.margin[1], shape[1] + 2 * self.margin[0]
        self.values = np.zeros((*size, channels), np.uint8)
        self.filled = np.zeros(size, np.uint8)
        self.origins = np.zeros((*size, 3), np.float32)
        x, y, row, column, border = stock.frame.pixels.T
        self.pixels = np.ascontiguousarray(np.column_stack([x, y, (y * width + x) * channels, row, column, border]))
        x, y = np.moveaxis(stock.frame.cells, -1, 0)
        self.cells = np.ascontiguousarray(np.stack([x, y, (y * width + x) * channels], -1))
        self.surface = np.empty(stock.frame.grid, np.float64)
        self.stitch, self.box = stitch, stock.frame.box
        self.seams = np.zeros((*(size if stitch == "graphcut" else (0, 0)), 2), np.float32)
        rows, columns = stock.frame.grid
        self.uncut = Seams(np.zeros(rows, np.int64), np.zeros(columns, np.int64), np.zeros(2, np.int64))

    def overlap(self, left: int, top: int) -> Overlap:
        """Return what stands under a tile around pixel (left, top) of the canvas."""
        values, runs = np.empty((len(self.pixels), self.values.shape[2]), np.uint8), np.empty_like(self.pixels[:, :3])
        count, number = gather(self.values, self.filled, self.pixels, left, top, values, runs)
        return Overlap(values[:count], runs[:number])

    def lay(self, left: int, top: int, cut: Cuts) -> None:
        """Lay one tile around pixel (left, top) of the canvas, stitched to what stands there (steps 5 and 6)."""
        _, width, channels = self.source.shape
        (x, y), copy = cut.pixel[0], int(cut.copy[0])
        source, first = self.source.values[copy], int(y * width + x) * channels
        if self.stitch == "graphcut":
            around = self.pixels, self.box, left, top
            shown = cut_tile(self.values, self.filled, self.seams, source, first, *around)
            pixels, found, feather = self.pixels[shown > 0], self.uncut, 0.0
        else:
            error_surface(self.values, self.filled, source, first, self.cells, left, top, self.surface)
            pixels, found, feather = self.pixels, seams(self.surface, self.slope), self.feather
        place = self._place(cut)
        paste(self.values, self.filled, self.origins, source, first, pixels, left, top, *found, feather, place)

    def _place(self, cut: Cuts) -> NDArray[np.float64]:
        """Return where the tile's middle is in the sample, the weight of that pixel, and the turn of the tile."""
        place: NDArray[np.float64] = self.places[cut.copy[0]].copy()
        place[:2] += place[3:].reshape(2, 2) @ cut.pixel[0]
        return place

    def picture(self) -> tuple[Image, NDArray[np.float32]]:
        """Return the output and its source map."""
        (height, width), (x, y) = self.shape, self.margin
        window = np.s_[y : y + height, x : x + width]
        return np.asarray(self.values[window] / np.float32(255), np.float32), self.origins[window].copy()


def _places(pictures: list[Picture], parts: int) -> NDArray[np.float64]:
    """Return where the sample shows pixel (0, 0) of each copy, that pixel's weight, and the picture's turn."""
    found = []
    for picture in pictures:
        for fy, fx in np.ndindex(parts, parts):
            fraction = np.array([fx, fy]) / parts
            near = picture.matrix @ np.floor(fraction + 0.5) + picture.offset
            found.append([*near, np.maximum(fraction, 1 - fraction).prod(), *picture.matrix.ravel()])
    return np.array(found)


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
    bands = np.array([band_width(surface), band_width(np.ascontiguousarray(surface.T))])
    across = wide_seam(surface, bands[0], slope)
    down = wide_seam(np.ascontiguousarray(surface.T), bands[1], slope)
    return Seams(across, down, bands)
