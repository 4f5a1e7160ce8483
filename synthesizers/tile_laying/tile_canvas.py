"""The tiles that a sample holds, the choice among them, and the output they are laid on, one over another."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final, Literal, NamedTuple

import numpy as np
from numpy.typing import NDArray

from nrbench.imaging.convert import Image, to_bytes
from nrbench.lattice.geometry import Lattice, Points

from ..sampling.patches import Patches
from ..sampling.torus import Torus
from ..seams.seam_kernels import cheapest_path, corner_paths
from .tile_kernels import (
    absolute_differences,
    best_move,
    blend_weights,
    cut_tile,
    error_surface,
    gather,
    nearest_places,
    paste,
)
from .tile_shape import ElementWeights, TileShape

OverlapMeasure = Literal["mean", "sum"]
MAX_COMPARED: Final = 48
"""Number of tiles of a set, evenly spread, that are compared with one another for the threshold."""


@dataclass(frozen=True, eq=False)
class ShiftedImages:
    """A sample shifted by the fractions 0, 1/n, ... of a pixel along x and y.

    Parameters
    ----------
    values
        ``uint8 (n * n, H * W * C)``: row ``fy * n + fx`` shows at pixel (x, y) what the sample shows at (x + fx / n,
        y + fy / n).
    shape
        (H, W, C) of the sample.
    parts
        n; 1 if tiles are placed at whole pixels.
    """

    values: NDArray[np.uint8]
    shape: tuple[int, int, int]
    parts: int

    @classmethod
    def of(cls, sample: Image, parts: int) -> ShiftedImages:
        """Shift a sample by splines of order 5, mirrored at the edges. With 1 part the only row is an exact copy."""
        height, width, channels = sample.shape
        patches = Patches(sample)
        fractions = [np.array([fx, fy]) / parts for fy, fx in np.ndindex(parts, parts)]
        rows = [to_bytes(patches.cut_patch(fraction, (height, width))[0]) for fraction in fractions]
        return cls(np.stack(rows).reshape(len(rows), -1), (height, width, channels), parts)


class CoveredPixels(NamedTuple):
    """The pixels of the canvas under a tile that are filled.

    Parameters
    ----------
    values
        ``uint8 (n, C)``, one row per pixel.
    runs
        ``(r, 3)``: contiguous parts of the flattened values: their first value, their length, and the offset of the
        tile's own first value from the tile's middle.
    """

    values: NDArray[np.uint8]
    runs: NDArray[np.int64]

    @classmethod
    def from_offsets(cls, values: NDArray[np.uint8], offsets: NDArray[np.int64]) -> CoveredPixels:
        """Return the overlap of pixels ``(n, C)`` at ``offsets`` ``(n,)`` from the tile's middle."""
        channels = values.shape[1]
        first = np.flatnonzero(np.diff(offsets, prepend=offsets[:1] - 2 * channels) != channels)
        lengths = np.diff(first, append=len(offsets))
        return cls(values, np.stack([first * channels, lengths * channels, offsets[first]], -1))


class TilePlaces(NamedTuple):
    """Tiles around whole pixels: row of the shifted images ``(n,)``, pixel (x, y) and real middle (x, y) ``(n, 2)``."""

    row: NDArray[np.int64]
    pixel: NDArray[np.int64]
    middle: Points

    def take(self, indices: NDArray[np.bool_] | NDArray[np.int64]) -> TilePlaces:
        """Return some of the tiles."""
        return TilePlaces(self.row[indices], self.pixel[indices], self.middle[indices])


@dataclass(frozen=True, eq=False)
class TileStock:
    """The complete maximum tiles of a sample.

    Parameters
    ----------
    tile
        The shape of the tiles.
    images
        The shifted copies of the sample that tiles are cut from.
    lattice
        The lattice of the sample, anchored at a tile's middle.
    """

    tile: TileShape
    images: ShiftedImages
    lattice: Lattice

    def middles(self, i: int, j: int) -> Points:
        """Return the middle (x, y) of every complete tile of the set at step i in the row and row j.

        With i and j even this is the set T. For the others see :meth:`TileShape.set_offsets`.
        """
        offset = np.array([i % 2, j % 2]) @ self.tile.steps
        return self.tile.complete_middles(self.lattice.shifted(offset), self.images.shape)

    def cut(self, middles: Points) -> TilePlaces:
        """Return the tiles around the nearest places that the shifted images have, if they lie inside.

        If rounding leaves none inside, return all of them, moved inward by less than a pixel.
        """
        height, width, _ = self.images.shape
        places = nearest_places(np.ascontiguousarray(middles), self.images.parts, self.tile.box, height, width)
        row, pixel, inside = places[:, 0], places[:, 1:3], places[:, 3] == 1
        if not inside.any():
            (left, top), (right, bottom) = self.tile.box
            pixel = np.clip(pixel, (-left, -top), (width - 1 - right, height - 1 - bottom))
            row, inside = np.zeros_like(row), ~inside
        return TilePlaces(row, pixel, middles).take(inside)

    def differences(self, overlap: CoveredPixels, tiles: TilePlaces) -> NDArray[np.int64]:
        """Compute each tile's sum of absolute differences over the overlap, channels added (step 3)."""
        return absolute_differences(overlap.values.ravel(), overlap.runs, self.images.values, self._positions(tiles))

    def register(self, overlap: CoveredPixels, drawn: TilePlaces, radius: float) -> TilePlaces:
        """Return one tile moved to where it correlates best, by at most ``radius`` px from its real middle (step 4).

        The correlation is normalized over the overlap, without the mean of each channel.
        """
        images, (x, y) = self.images, drawn.pixel[0]
        part = int(drawn.row[0])
        here = np.array([x + part % images.parts / images.parts, y + part // images.parts / images.parts])
        best = best_move(
            overlap.values.ravel(),
            overlap.runs,
            images.values,
            *images.shape,
            images.parts,
            here,
            drawn.middle[0],
            radius,
            self.tile.box,
        )
        return TilePlaces(best[:1], best[np.newaxis, 1:], drawn.middle)

    def _positions(self, tiles: TilePlaces) -> NDArray[np.int64]:
        """Return row and position of each tile's middle in the shifted images."""
        _, width, channels = self.images.shape
        positions = np.empty((len(tiles.row), 2), np.int64)
        positions[:, 0], positions[:, 1] = tiles.row, (tiles.pixel[:, 1] * width + tiles.pixel[:, 0]) * channels
        return positions

    def estimate_threshold(self, quantile: float, measure: OverlapMeasure) -> float:
        """Return the least threshold at which each tile of the sample accepts a share of the others.

        Two tiles of a set (unmoved) are compared over the usual overlap: the left and the upper half
        of a tile. For each tile the quantile of its differences from the others is taken, and the largest of these is
        the threshold. A single quantile over all pairs would leave the oddest tile no successor but its own, so that
        the sample would be copied on and on. Infinite if no set holds two tiles.
        """
        offsets = self._usual_overlap()
        quantiles: list[float] = []
        for number in self.tile.set_offsets(self.lattice):
            tiles = self.cut(self.middles(*number))
            tiles = tiles.take(np.unique(np.linspace(0, len(tiles.row) - 1, MAX_COMPARED).astype(np.int64)))
            for n, (row, first) in enumerate(self._positions(tiles)):
                values = self.images.values[row][first + offsets[:, np.newaxis] + np.arange(self.images.shape[2])]
                others = np.delete(self.differences(CoveredPixels.from_offsets(values, offsets), tiles), n)
                quantiles += [float(np.quantile(others, quantile))] if len(others) else []
        return max(quantiles, default=np.inf) / (len(offsets) if measure == "mean" else 1)

    def _usual_overlap(self) -> NDArray[np.int64]:
        """Return the offsets, from a tile's middle, of the pixels in its left and its upper half."""
        _, width, channels = self.images.shape
        rows, columns = self.tile.grid
        x, y, row, column, _ = self.tile.pixels.T
        covered = (row < rows / 2) | (column < columns / 2)
        return np.asarray((y * width + x)[covered] * channels)


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
    wrap
        Whether opposite edges of the output are adjacent.

    Attributes
    ----------
    values, filled, origins
        ``uint8 (H, W, C)``, the canvas with its margin; ``uint8 (H, W)``, 1 where it is filled; and its source map.
    seams
        ``(2, H, W)``: costs of the seams between each pixel and the next to its right, and below, for minimum cuts.
    margin
        Width of the margin along x and y, px.
    """

    def __init__(
        self, shape: tuple[int, int], stock: TileStock, weights: ElementWeights | None, wrap: bool = False
    ) -> None:
        tile, images = stock.tile, stock.images
        self.shape, self.tile, self.images, self.weights = shape, tile, images, weights
        self.margin = np.ceil(3 * tile.reach).astype(int) + 2
        self.torus = Torus(shape, (int(self.margin[1]), int(self.margin[0])))
        self.wrap, size = wrap, self.torus.canvas
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
            weights = blend_weights(self.filled, self.pixels, left, top, *find_seams(surface))
        place = self._nearest[row] + (x, y, 0)
        paste(self.values, self.filled, self.origins, source, first, self.pixels, left, top, weights, place)
        if self.wrap:
            (x0, y0), (x1, y1) = self.tile.box.tolist()
            window = slice(top + y0, top + y1 + 1), slice(left + x0, left + x1 + 1)
            self.torus.repeat(window, self.values, self.filled, self.origins, *self.seams[:, : len(self.filled)])

    def output(self) -> tuple[Image, NDArray[np.float32]]:
        """Return the output and its source map."""
        window = self.torus.output
        return np.asarray(self.values[window] / np.float32(255), np.float32), self.origins[window]


def _nearest_pixels(parts: int) -> NDArray[np.float64]:
    """Return the sample's pixel (x, y) nearest to pixel (0, 0) of each shifted image, and its weight."""
    fractions = np.array([(fx, fy) for fy, fx in np.ndindex(parts, parts)]) / parts
    return np.column_stack([np.floor(fractions + 0.5), np.maximum(fractions, 1 - fractions).prod(1)])


def find_seams(surface: NDArray[np.float64]) -> tuple[NDArray[np.int64], NDArray[np.int64], NDArray[np.int64]]:
    """Find the seams of a tile by dynamic programming, one downward and one to the right (step 5).

    Where the tile overlaps others at its left and at its top, the paths meet in the corner, where the sum of errors
    over both is least (Efros and Freeman 2001, section 2.1, which the paper cites).

    Parameters
    ----------
    surface
        ``(rows, columns)``: squared differences, negative where nothing is filled.

    Returns
    -------
    across
        ``(rows,)``: the first new column of each row.
    down
        ``(columns,)``: the first new row of each column.
    bands
        ``(columns, rows, row, column)``: how far the filled region reaches from the left in rows that are not
        completely covered, and from the top in columns; and the first row and column that the seams divide.
    """
    empty = surface < 0
    beside, above = (int(np.where(side.any(1), side.argmax(1), 0).max()) for side in (empty, empty.T))
    error = np.maximum(surface, 0)
    across, down = np.zeros(len(error), np.int64), np.zeros(error.shape[1], np.int64)
    row = column = 0
    if beside and above:
        row, column, across[row:], down[column:], _ = corner_paths(error, beside, above)
    elif beside:
        across = cheapest_path(np.ascontiguousarray(error[:, :beside]))
    elif above:
        down = cheapest_path(np.ascontiguousarray(error[:above].T))
    return across, down, np.array([beside, above, row, column])
