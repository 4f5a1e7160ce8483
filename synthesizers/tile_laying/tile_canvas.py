"""The output that tiles are laid on, one over another."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from nrbench.imaging.convert import Image

from ..seams.seam_kernels import cheapest_path
from .choice_kernels import gather
from .stitch_kernels import blend_weights, cut_tile, error_surface, paste
from .tile_shape import ElementWeights
from .tile_stock import CoveredPixels, TilePlaces, TileStock


class TileCanvas:
    """An output with a margin around it, wide enough for every tile that touches the output.

    Parameters
    ----------
    shape
        Height and width of the output.
    stock
        The tiles.
    weights
        Tiles are joined along exact minimum cuts of the overlap: how much a seam counts at each place of the cell.
        None: along two seams by dynamic programming, blended where they conflict.

    Attributes
    ----------
    values, filled, origins
        ``uint8 (H, W, C)``, the canvas with its margin; ``uint8 (H, W)``, 1 where it is filled; and its source map.
    seams
        ``(2, H, W)``: costs of the seams between each pixel and the next to its right, and below, for minimum cuts.
    margin
        Width of the margin along x and y, px.
    """

    def __init__(self, shape: tuple[int, int], stock: TileStock, weights: ElementWeights | None) -> None:
        tile, images = stock.tile, stock.images
        self.shape, self.tile, self.images, self.weights = shape, tile, images, weights
        self.margin = np.ceil(3 * tile.reach).astype(int) + 2
        size = shape[0] + 2 * self.margin[1], shape[1] + 2 * self.margin[0]
        _, width, channels = images.shape
        self.values = np.zeros((*size, channels), np.uint8)
        self.filled = np.zeros(size, np.uint8)
        self.origins = np.zeros((*size, 3), np.float32)
        self.seams = np.zeros((2, *((0, 0) if weights is None else size)), np.float32)
        x, y, row, column, border = tile.pixels.T
        self.pixels = np.ascontiguousarray(np.column_stack([x, y, (y * width + x) * channels, row, column, border]))
        x, y = np.moveaxis(tile.cells, -1, 0)
        self.cells = np.ascontiguousarray(np.stack([x, y, (y * width + x) * channels], -1))
        self._nearest = _nearest_pixels(images.parts)

    def overlap(self, left: int, top: int) -> CoveredPixels:
        """Return what is filled under a tile around pixel (left, top) of the canvas."""
        values, runs = np.empty((len(self.pixels), self.values.shape[2]), np.uint8), np.empty_like(self.pixels[:, :3])
        count, number = gather(self.values, self.filled, self.pixels, left, top, values, runs)
        return CoveredPixels(values[:count], runs[:number])

    def lay(self, left: int, top: int, drawn: TilePlaces) -> None:
        """Lay one tile around pixel (left, top) of the canvas, and stitch it to what is filled (steps 5 and 6)."""
        _, width, channels = self.images.shape
        (x, y), row = drawn.pixel[0], int(drawn.row[0])
        source, first = self.images.values[row], int(y * width + x) * channels
        if self.weights is not None:
            weights = cut_tile(
                self.values,
                self.filled,
                self.seams,
                (self.weights.table, self.weights.numbers_from(-self.margin)),
                source,
                first,
                self.pixels,
                self.tile.box,
                left,
                top,
            )
        else:
            surface = np.empty(self.tile.grid, np.float64)
            error_surface(self.values, self.filled, source, first, self.cells, left, top, surface)
            (left_band, across), (top_band, down) = find_seam(surface), find_seam(np.ascontiguousarray(surface.T))
            bands = np.array([left_band, top_band])
            weights = blend_weights(self.filled, self.pixels, left, top, across, down, bands)
        place = self._nearest[row] + (x, y, 0)
        paste(self.values, self.filled, self.origins, source, first, self.pixels, left, top, weights, place)

    def output(self) -> tuple[Image, NDArray[np.float32]]:
        """Return the output and its source map."""
        (height, width), (x, y) = self.shape, self.margin
        window = np.s_[y : y + height, x : x + width]
        return np.asarray(self.values[window] / np.float32(255), np.float32), self.origins[window]


def _nearest_pixels(parts: int) -> NDArray[np.float64]:
    """Return the sample's pixel (x, y) nearest to pixel (0, 0) of each shifted image, and its weight."""
    fractions = np.array([(fx, fy) for fy, fx in np.ndindex(parts, parts)]) / parts
    return np.column_stack([np.floor(fractions + 0.5), np.maximum(fractions, 1 - fractions).prod(1)])


def find_seam(surface: NDArray[np.float64]) -> tuple[int, NDArray[np.int64]]:
    """Find the seam of a tile by dynamic programming, from top to bottom (step 5).

    Parameters
    ----------
    surface
        ``(rows, columns)``: squared differences, negative where nothing is filled.

    Returns
    -------
    band
        How far the filled region reaches from the left in rows that are not completely covered, 0 if there are none.
    seam
        ``(rows,)``: the first new column, in the band.
    """
    empty = surface < 0
    band = int(np.where(empty.any(1), empty.argmax(1), 0).max())
    if not band:
        return 0, np.zeros(len(surface), np.int64)
    return band, cheapest_path(np.maximum(surface[:, :band], 0))
