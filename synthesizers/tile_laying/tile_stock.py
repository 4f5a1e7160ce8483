"""The tiles that a sample holds, and the choice among them.

Tiles are cut from copies of the sample: moved by fractions of a pixel, and mirrored or turned by its symmetries.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Final, Literal, NamedTuple

import numpy as np
import scipy
from numpy.typing import NDArray

from nrbench.imaging.convert import Image, to_bytes
from nrbench.imaging.mean_tile import fold
from nrbench.imaging.subpixel import find_vertex
from nrbench.lattice.geometry import Lattice, Points

from ..sampling.patches import Patches
from .choice_kernels import absolute_differences, best_move, nearest_places
from .tile_shape import TileShape

Difference = Literal["mean", "sum"]
MAX_COMPARED: Final = 48
"""Number of tiles of a set, evenly spread, that are compared with one another for the threshold."""
MIN_CORRELATION: Final = 0.9
"""Least correlation of the mean tile with its transformed copy for a symmetry of the texture."""
LATTICE_SLACK: Final = 0.02
"""Share of s by which a transformed lattice may differ from the lattice."""
TRANSFORMS: Final = {
    "half-turn": ((-1, 0), (0, -1)),
    "mirror-x": ((-1, 0), (0, 1)),
    "mirror-y": ((1, 0), (0, -1)),
    "quarter-turn": ((0, 1), (-1, 0)),
    "three-quarter-turn": ((0, -1), (1, 0)),
    "diagonal": ((0, 1), (1, 0)),
    "other-diagonal": ((0, -1), (-1, 0)),
}
"""The transforms that map the pixel grid onto itself: from a copy's (x, y) to the sample's, both from the middle."""


class SampleCopy(NamedTuple):
    """A sample transformed by one of its symmetries.

    Parameters
    ----------
    image
        ``(H, W, C)``.
    matrix, offset
        Pixel (x, y) of the copy is the sample's pixel ``matrix @ (x, y) + offset``.
    lattice
        The sample's lattice, with its origin where the copy shows what the sample shows at the lattice's origin.
    """

    image: Image
    matrix: Points
    offset: Points
    lattice: Lattice

    @property
    def is_resampled(self) -> bool:
        """Whether its pixels lie between those of the sample."""
        return bool((self.matrix != np.rint(self.matrix)).any())


def untransformed(sample: Image, lattice: Lattice) -> list[SampleCopy]:
    """Return the sample as it is, the only copy if symmetries are not used."""
    return [SampleCopy(sample, np.eye(2), np.zeros(2), lattice)]


def symmetric_copies(sample: Image, lattice: Lattice) -> list[SampleCopy]:
    """Return the sample, and one copy for each of its symmetries (section 4.4).

    A symmetry maps the lattice onto itself, and the transformed mean tile, aligned, correlates by at least
    :data:`MIN_CORRELATION` with the sample's. Quarter turns and diagonals need a square sample. Turns by multiples of
    60 degrees, and their mirror images, have another pixel grid: these copies are interpolated by splines of order 5,
    and show the part of the sample that the turned frame contains.
    """
    copies = untransformed(sample, lattice)
    height, width = sample.shape[:2]
    middle = (np.array([width, height]) - 1) / 2
    for rows in TRANSFORMS.values():
        matrix = np.array(rows, np.float64)
        if matrix[0, 0] == 0 and height != width:
            continue
        offset = middle - matrix @ middle
        transformed = Lattice(tuple(matrix.T @ lattice.t1), tuple(matrix.T @ lattice.t2))
        if not lattice.is_equivalent(transformed, LATTICE_SLACK * lattice.s):
            continue
        x, y = np.meshgrid(np.arange(width), np.arange(height))
        at = np.rint(np.stack([x, y], -1) @ matrix.T + offset).astype(np.int64)
        image = np.ascontiguousarray(sample[at[..., 1], at[..., 0]])
        shift, correlation = _align_mean_tiles(sample, image, lattice)
        if correlation >= MIN_CORRELATION:
            copies.append(SampleCopy(image, matrix, offset, lattice.shifted((float(shift[0]), float(shift[1])))))
    return copies + _turned_copies(sample, lattice)


def _turned_copies(sample: Image, lattice: Lattice) -> list[SampleCopy]:
    """Return a copy for each symmetry that turns the sample by 60, 120, 240 or 300 degrees, mirrored or not."""
    height, width = sample.shape[:2]
    middle = (np.array([width, height]) - 1) / 2
    pixels = np.stack(np.meshgrid(np.arange(width), np.arange(height)), -1)
    patches, copies = Patches(sample), []
    for matrix in _turns():
        transformed = Lattice(tuple(matrix.T @ lattice.t1), tuple(matrix.T @ lattice.t2))
        if not lattice.is_equivalent(transformed, LATTICE_SLACK * lattice.s):
            continue
        offset = middle - matrix @ middle
        at = pixels @ matrix.T + offset
        inside = np.asarray(((at >= 0) & (at <= 2 * middle)).all(-1))
        image = patches.read_points(np.clip(at, 0, 2 * middle))
        shift, correlation = _align_mean_tiles(sample, image, lattice, inside)
        if correlation >= MIN_CORRELATION:
            copies.append(SampleCopy(image, matrix, offset, lattice.shifted((float(shift[0]), float(shift[1])))))
    return copies


def _turns() -> Iterator[Points]:
    """Yield the turns by 60, 120, 240 and 300 degrees, each also after a reflection of x."""
    for degrees in (60, 120, 240, 300):
        cosine, sine = math.cos(math.radians(degrees)), math.sin(math.radians(degrees))
        turn = np.array([[cosine, -sine], [sine, cosine]])
        yield turn
        yield turn @ np.diag([-1.0, 1.0])


def _align_mean_tiles(
    sample: Image, other: Image, lattice: Lattice, known: NDArray[np.bool_] | None = None
) -> tuple[Points, float]:
    """Return the shift (x, y) px of the other's mean tile against the sample's, and their correlation.

    ``known`` ``(H, W)`` marks the pixels of the other image that count; None: all.
    """
    lattice = lattice.reduced()
    tiles = fold(sample, lattice), fold(other, lattice, known)
    here, there = (_normalize(tile.values.astype(np.float64)) for tile in tiles)
    spectra = np.conj(scipy.fft.rfft2(here, axes=(0, 1))) * scipy.fft.rfft2(there, axes=(0, 1))
    surface = scipy.fft.irfft2(spectra.sum(-1), here.shape[:2])
    row, column = np.unravel_index(int(surface.argmax()), surface.shape)
    rows, columns = surface.shape
    v = row + find_vertex(*surface[[row - 1, row, (row + 1) % rows], column])[0]
    u = column + find_vertex(*surface[row, [column - 1, column, (column + 1) % columns]])[0]
    return np.array([u / columns, v / rows]) @ lattice.matrix, float(surface[row, column])


def _normalize(values: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the tile without the means of its channels, of unit norm."""
    centered = values - values.mean((0, 1))
    return np.asarray(centered / max(float(np.sqrt((centered**2).sum())), 1e-12))


@dataclass(frozen=True, eq=False)
class ShiftedImages:
    """Images shifted by the fractions 0, 1/n, ... of a pixel along x and y.

    Parameters
    ----------
    values
        ``uint8 (k * n * n, H * W * C)``: row ``(m * n + fy) * n + fx`` shows at pixel (x, y) what the m-th image shows
        at (x + fx / n, y + fy / n).
    shape
        (H, W, C) of the images.
    parts
        n; 1 if tiles are placed at whole pixels.
    """

    values: NDArray[np.uint8]
    shape: tuple[int, int, int]
    parts: int


def shift_images(images: Sequence[Image], parts: int) -> ShiftedImages:
    """Shift images by all fractions of a pixel, by splines of order 5, mirrored at the edges.

    Parameters
    ----------
    images
        ``(H, W, C)``, all of one shape.
    parts
        Number of fractions along each axis, at least 1. With 1 every row is an exact copy.
    """
    rows = [row for image in images for row in _shifted_bytes(image, parts)]
    height, width, channels = images[0].shape
    return ShiftedImages(np.stack(rows).reshape(len(rows), -1), (height, width, channels), parts)


def _shifted_bytes(image: Image, parts: int) -> Iterator[NDArray[np.uint8]]:
    if parts == 1:
        yield to_bytes(image)
        return
    patches, shape = Patches(image), image.shape[:2]
    for fy in range(parts):
        for fx in range(parts):
            yield to_bytes(patches.cut_patch(np.array([fx, fy]) / parts, shape)[0])


class Overlap(NamedTuple):
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
    def from_offsets(cls, values: NDArray[np.uint8], offsets: NDArray[np.int64]) -> Overlap:
        """Return the overlap of pixels ``(n, C)`` at ``offsets`` ``(n,)`` from the tile's middle."""
        channels = values.shape[1]
        first = np.flatnonzero(np.diff(offsets, prepend=offsets[:1] - 2 * channels) != channels)
        lengths = np.diff(first, append=len(offsets))
        return cls(values, np.stack([first * channels, lengths * channels, offsets[first]], -1))


class Tiles(NamedTuple):
    """Tiles around whole pixels: row of the shifted images ``(n,)``, pixel (x, y) and real middle (x, y) ``(n, 2)``."""

    row: NDArray[np.int64]
    pixel: NDArray[np.int64]
    middle: Points

    def take(self, indices: NDArray[np.bool_] | NDArray[np.int64]) -> Tiles:
        """Return some of the tiles."""
        return Tiles(self.row[indices], self.pixel[indices], self.middle[indices])


@dataclass(frozen=True, eq=False)
class TileStock:
    """The complete maximum tiles of a sample.

    Parameters
    ----------
    tile
        The shape of the tiles.
    images
        The shifted copies of the sample that tiles are cut from.
    copies
        The copies of the sample; the lattice of each is anchored at a tile's middle.
    reach
        px by which a tile may be moved from its middle.
    """

    tile: TileShape
    images: ShiftedImages
    copies: tuple[SampleCopy, ...]
    reach: float = 0.0

    def middles(self, i: int, j: int) -> tuple[NDArray[np.int64], Points]:
        """Return copy and middle (x, y) of every complete tile of the set at step i in the row and row j.

        With i and j even this is the set T. For the others see :meth:`TileShape.set_offsets`.
        """
        offset = np.array([i % 2, j % 2]) @ self.tile.steps
        points = [self._complete_middles(copy, offset) for copy in self.copies]
        return np.repeat(np.arange(len(points)), [len(part) for part in points]), np.concatenate(points)

    def _complete_middles(self, copy: SampleCopy, offset: Points) -> Points:
        """Return the middles of a copy's tiles that lie in the image, and in the part that the sample shows."""
        shifted = copy.lattice.shifted(offset)
        points = self.tile.complete_middles(shifted, self.images.shape)
        if not copy.is_resampled:
            return points
        corners = np.array([(a, b) for a in (-0.5, 0.5) for b in (-0.5, 0.5)]) @ self.tile.sides
        at = (points[:, np.newaxis] + corners) @ copy.matrix.T + copy.offset
        slack = 1.0 + self.reach
        last = np.array([self.images.shape[1], self.images.shape[0]]) - 1
        return np.asarray(points[((at >= slack) & (at <= last - slack)).all((1, 2))])

    def cut(self, copies: NDArray[np.int64], middles: Points) -> Tiles:
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
        return Tiles(row + copies * self.images.parts**2, pixel, middles).take(inside)

    def differences(self, overlap: Overlap, tiles: Tiles) -> NDArray[np.int64]:
        """Compute each tile's sum of absolute differences over the overlap, channels added (step 3)."""
        return absolute_differences(overlap.values.ravel(), overlap.runs, self.images.values, self._positions(tiles))

    def register(self, overlap: Overlap, drawn: Tiles, radius: float) -> Tiles:
        """Return one tile moved to where it correlates best, by at most ``radius`` px from its real middle (step 4).

        The correlation is normalized over the overlap, without the mean of each channel.
        """
        images, (x, y) = self.images, drawn.pixel[0]
        copy, part = divmod(int(drawn.row[0]), images.parts**2)
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
            copy * images.parts**2,
        )
        return Tiles(best[:1], best[np.newaxis, 1:], drawn.middle)

    def _positions(self, tiles: Tiles) -> NDArray[np.int64]:
        """Return row and position of each tile's middle in the shifted images."""
        _, width, channels = self.images.shape
        positions = np.empty((len(tiles.row), 2), np.int64)
        positions[:, 0], positions[:, 1] = tiles.row, (tiles.pixel[:, 1] * width + tiles.pixel[:, 0]) * channels
        return positions

    def estimate_threshold(self, quantile: float, difference: Difference) -> float:
        """Return the least threshold at which each tile of the sample accepts a share of the others.

        Two tiles of a set (untransformed and unmoved) are compared over the usual overlap: the left and the upper half
        of a tile. For each tile the quantile of its differences from the others is taken, and the largest of these is
        the threshold. A single quantile over all pairs would leave the oddest tile no successor but its own, so that
        the sample would be copied on and on. Infinite if no set holds two tiles.
        """
        offsets = self._usual_overlap()
        quantiles: list[float] = []
        for number in self.tile.set_offsets(self.copies[0].lattice):
            copies, middles = self.middles(*number)
            tiles = self.cut(copies[copies == 0], middles[copies == 0])
            tiles = tiles.take(np.unique(np.linspace(0, len(tiles.row) - 1, MAX_COMPARED).astype(np.int64)))
            for n, (row, first) in enumerate(self._positions(tiles)):
                values = self.images.values[row][first + offsets[:, np.newaxis] + np.arange(self.images.shape[2])]
                others = np.delete(self.differences(Overlap.from_offsets(values, offsets), tiles), n)
                quantiles += [float(np.quantile(others, quantile))] if len(others) else []
        return max(quantiles, default=np.inf) / (len(offsets) if difference == "mean" else 1)

    def _usual_overlap(self) -> NDArray[np.int64]:
        """Return the offsets, from a tile's middle, of the pixels in its left and its upper half."""
        _, width, channels = self.images.shape
        rows, columns = self.tile.grid
        x, y, row, column, _ = self.tile.pixels.T
        covered = (row < rows / 2) | (column < columns / 2)
        return np.asarray((y * width + x)[covered] * channels)
