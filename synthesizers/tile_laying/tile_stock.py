"""The tiles that a sample holds, and the choice among them."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final, Literal, NamedTuple

import numpy as np
from numpy.typing import NDArray

from nrbench.imaging.convert import Image, to_bytes
from nrbench.lattice.geometry import Lattice, Points

from ..sampling.patches import Patches
from .choice_kernels import absolute_differences, best_move, nearest_places
from .tile_shape import TileShape

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
