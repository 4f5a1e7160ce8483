"""The output that tiles are laid on, one over another."""

from __future__ import annotations

from typing import Literal

import numpy as np
from numpy.typing import NDArray

from nrbench.imaging.convert import Image

from .choice_kernels import gather
from .stitch_kernels import band_width, blend_weights, cut_tile, error_surface, paste, wide_seam
from .tile_shape import ElementWeights
from .tile_stock import Overlap, SampleCopy, Tiles, TileStock

Stitch = Literal["dynamic", "graphcut"]


class TileCanvas:
    """An output with a margin around it, wide enough for every tile that touches the output.

    Parameters
    ----------
    shape
        Height and width of the output.
    stock
        The tiles.
    copies
        The copies of the sample that the tiles come from.
    slope
        Largest number of px by which a seam moves aside from one row to the next.
    feather
        Width in px of the ramp where the two seams of a tile conflict; 0 cuts.
    stitch
        Two seams by dynamic programming, or one exact minimum cut of the overlap.
    weights
        How much the seams of minimum cuts count at each place of the cell. None: 1 everywhere.

    Attributes
    ----------
    values, filled, origins
        ``uint8 (H, W, C)``, the canvas with its margin; ``uint8 (H, W)``, 1 where it is filled; and its source map.
    seams
        ``(H, W, 2)``: costs of the seams between each pixel and the next to its right, and below, for minimum cuts.
    margin
        Width of the margin along x and y, px.
    """

    def __init__(
        self,
        shape: tuple[int, int],
        stock: TileStock,
        copies: list[SampleCopy],
        slope: int,
        feather: float,
        stitch: Stitch = "dynamic",
        weights: ElementWeights | None = None,
    ) -> None:
        tile, images = stock.tile, stock.images
        self.shape, self.tile, self.images = shape, tile, images
        self.slope, self.feather, self.stitch = slope, float(feather), stitch
        self.margin = np.ceil(3 * tile.reach).astype(int) + 2
        size = shape[0] + 2 * self.margin[1], shape[1] + 2 * self.margin[0]
        _, width, channels = images.shape
        self.values = np.zeros((*size, channels), np.uint8)
        self.filled = np.zeros(size, np.uint8)
        self.origins = np.zeros((*size, 3), np.float32)
        self.seams = np.zeros((*(size if stitch == "graphcut" else (0, 0)), 2), np.float32)
        self.weights = np.ones((1, 1), np.float32) if weights is None else weights.table
        self.to_cell = np.zeros((2, 3)) if weights is None else weights.numbers_from(-self.margin)
        x, y, row, column, border = tile.pixels.T
        self.pixels = np.ascontiguousarray(np.column_stack([x, y, (y * width + x) * channels, row, column, border]))
        x, y = np.moveaxis(tile.cells, -1, 0)
        self.cells = np.ascontiguousarray(np.stack([x, y, (y * width + x) * channels], -1))
        self._source_rows = _source_rows(copies, images.parts)
        self._has_resampled = any(copy.is_resampled for copy in copies)

    def overlap(self, left: int, top: int) -> Overlap:
        """Return what is filled under a tile around pixel (left, top) of the canvas."""
        values, runs = np.empty((len(self.pixels), self.values.shape[2]), np.uint8), np.empty_like(self.pixels[:, :3])
        count, number = gather(self.values, self.filled, self.pixels, left, top, values, runs)
        return Overlap(values[:count], runs[:number])

    def lay(self, left: int, top: int, drawn: Tiles) -> None:
        """Lay one tile around pixel (left, top) of the canvas, and stitch it to what is filled (steps 5 and 6)."""
        _, width, channels = self.images.shape
        (x, y), row = drawn.pixel[0], int(drawn.row[0])
        source, first = self.images.values[row], int(y * width + x) * channels
        if self.stitch == "graphcut":
            weights = cut_tile(
                self.values,
                self.filled,
                self.seams,
                (self.weights, self.to_cell),
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
            across, down, bands = find_seams(surface, self.slope)
            weights = blend_weights(self.filled, self.pixels, left, top, across, down, bands, self.feather)
        place: NDArray[np.float64] = self._source_rows[row].copy()
        place[:2] += place[3:].reshape(2, 2) @ drawn.pixel[0]
        paste(self.values, self.filled, self.origins, source, first, self.pixels, left, top, weights, place)

    def output(self) -> tuple[Image, NDArray[np.float32]]:
        """Return the output and its source map."""
        (height, width), (x, y) = self.shape, self.margin
        window = np.s_[y : y + height, x : x + width]
        source = self.origins[window].copy()
        if self._has_resampled:
            last = np.array(self.images.shape[1::-1]) - 1
            nearest = np.clip(np.rint(source[..., :2]), 0, last)
            source[..., 2] *= (1 - np.abs(source[..., :2] - nearest)).prod(-1)
            source[..., :2] = nearest
        return np.asarray(self.values[window] / np.float32(255), np.float32), source


def _source_rows(copies: list[SampleCopy], parts: int) -> NDArray[np.float64]:
    """Return, for each shifted image, the sample's (x, y) at its pixel (0, 0), that pixel's weight, and its matrix."""
    rows = []
    for copy in copies:
        for fy, fx in np.ndindex(parts, parts):
            fraction = np.array([fx, fy]) / parts
            near, weight = np.floor(fraction + 0.5), np.maximum(fraction, 1 - fraction).prod()
            if copy.is_resampled:  # the nearest pixel differs from place to place: see TileCanvas.output
                near, weight = fraction, 1.0
            rows.append([*(copy.matrix @ near + copy.offset), weight, *copy.matrix.ravel()])
    return np.array(rows)


def find_seams(
    surface: NDArray[np.float64], slope: int
) -> tuple[NDArray[np.int64], NDArray[np.int64], NDArray[np.int64]]:
    """Find the seams of a tile by dynamic programming, along the two directions separately (step 5).

    Parameters
    ----------
    surface
        ``(rows, columns)``: squared differences, negative where nothing is filled.
    slope
        Largest number of px by which a seam moves aside from one row to the next.

    Returns
    -------
    across
        ``(rows,)``: the first new column of the left band. The band is as wide as the filled region reaches from the
        left in rows that are not completely covered.
    down
        ``(columns,)``: the first new row of the top band, defined likewise.
    bands
        Columns of the left band and rows of the top band, 0 if there is none.
    """
    turned = np.ascontiguousarray(surface.T)
    bands = np.array([band_width(surface), band_width(turned)])
    return wide_seam(surface, bands[0], slope), wide_seam(turned, bands[1], slope), bands
