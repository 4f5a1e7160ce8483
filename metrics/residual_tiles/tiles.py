"""Cut the tiles of output, sample and fresh draws on one grid, so that they can be compared sample by sample."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from nrbench.imaging.convert import Image, quantize
from nrbench.imaging.mean_tile import Values, cut_tiles, tile_grid
from nrbench.lattice.geometry import Lattice, Points
from nrbench.plugins.forms import Observation, Shape, Texture

from ..ncc.periodic import TOLERANCE
from ..verdict.examination import examine
from ..verdict.measurements import Measurements
from ..verdict.reference import FIRST_DRAW, NoFreshDraw
from ..verdict.verdict import Verdict

_DRAWS, _MOST_DRAWS = 4, 12
"""Number of fresh draws for outputs of 256 x 256 px, and its upper limit. Smaller outputs get more draws, so that the
number of tiles is about the same."""
_LARGE, _FEW_DRAWS = 400**2, 3
"""Area of an output, px, above which its own tiles are so many that fewer draws are enough, and their number."""
_FIRST_DRAW = FIRST_DRAW + 1000
"""Fresh draws from this number on have the output's size; those below belong to regularity."""
_ALIGNMENT = 0.4
"""Remaining misalignment of aligned tiles, px."""
_LEAST_NOISE = 0.03
_CHANCE = 1.5
"""Factor by which the covariance of offsets in an image without defects may exceed that of the references by chance."""

Grid = tuple[int, int]
"""Number of samples (V, U) of a tile."""
QUARTERS = ((-0.25, -0.25), (0.25, -0.25), (-0.25, 0.25), (0.25, 0.25))
"""Cell coordinates of the middles of a tile's quarters, in the order of :func:`quarters`."""


@dataclass(frozen=True)
class TileSet:
    """Whole tiles of one image.

    Parameters
    ----------
    numbers
        ``(n, 2)``: cell coordinates of the lattice point in the middle of each tile, integers.
    centers
        ``(n, 2)``: middles of the tiles (x, y) px.
    tiles
        ``(n, V, U, C)``, V and U even.
    lattice
        Reduced.
    """

    numbers: NDArray[np.int64]
    centers: Points
    tiles: Values
    lattice: Lattice

    @classmethod
    def cut(cls, image: Image, lattice: Lattice, numbers: Points, centers: Points, grid: Grid) -> TileSet:
        """Cut the tiles around ``centers`` that lie inside the image."""
        tiles, inside = cut_tiles(image, lattice, centers, grid)
        return cls(np.rint(numbers[inside]).astype(np.int64), centers[inside], tiles, lattice)

    @classmethod
    def on(cls, image: Image, lattice: Lattice, grid: Grid) -> TileSet:
        """Cut the tiles around the lattice's points."""
        centers = lattice.points(image.shape[:2])
        return cls.cut(image, lattice, lattice.to_cell(centers), centers, grid)

    def __len__(self) -> int:
        return len(self.tiles)

    @cached_property
    def departures(self) -> Values:
        """``(n, V, U, C)``: tiles less their mean, times sqrt(n / (n - 1)), since the mean takes 1/n of the energy."""
        if len(self) < 2:
            return self.tiles - self.tiles
        return np.asarray((self.tiles - self.tiles.mean(0)) * np.float32(np.sqrt(len(self) / (len(self) - 1))))

    def take(self, index: NDArray[np.intp]) -> TileSet:
        """Return the tiles at ``index``."""
        return TileSet(self.numbers[index], self.centers[index], self.tiles[index], self.lattice)

    def take_central(self, most: int) -> TileSet:
        """Return the ``most`` tiles nearest to the middle of all tiles, so that neighbors stay together."""
        if len(self) <= most:
            return self
        away = np.hypot(*(self.centers - self.centers.mean(0)).T)
        return self.take(np.sort(np.argsort(away, kind="stable")[:most]))

    def blocks(self, shape: Shape, extent: Shape) -> Iterator[TileSet]:
        """Yield the tiles in upright boxes of ``extent`` that cover an image of ``shape`` with least overlap."""
        if shape == extent:
            yield self
            return
        starts = [
            np.linspace(0, max(side - length, 0), -(-side // length))
            for side, length in zip(shape, extent, strict=True)
        ]
        for y in starts[0]:
            for x in starts[1]:
                inside = (self.centers >= (x, y)) & (self.centers <= (x + extent[1] - 1, y + extent[0] - 1))
                yield self.take(np.flatnonzero(inside.all(1)))

    def neighbors(self) -> NDArray[np.intp]:
        """Return the tiles at (0, 0), (1, 0), (0, 1) and (1, 1) from each tile that has all of them, ``(m, 4)``."""
        low = self.numbers.min(0) if len(self) else np.zeros(2, np.int64)
        size = (self.numbers.max(0) - low + 2) if len(self) else np.ones(2, np.int64)
        table = np.full(size, -1, np.intp)
        at = self.numbers - low
        table[at[:, 0], at[:, 1]] = np.arange(len(self))
        index = np.stack([table[at[:, 0] + du, at[:, 1] + dv] for dv in (0, 1) for du in (0, 1)], -1)
        return np.asarray(index[(index >= 0).all(1)])


def even_grid(lattice: Lattice) -> Grid:
    """Return the samples (V, U) of a tile, both even, so that its quarters are alike."""
    rows, columns = tile_grid(lattice)
    return rows + rows % 2, columns + columns % 2


def quarters(tiles: Values) -> Values:
    """Return the quarters of tiles ``(n, V, U, C)`` as ``(4, n, V / 2, U / 2, C)``."""
    rows, columns = tiles.shape[1] // 2, tiles.shape[2] // 2
    return np.stack([tiles[:, y : y + rows, x : x + columns] for y in (0, rows) for x in (0, columns)])


def part_starts(side: int, parts: int) -> NDArray[np.int64]:
    """Return the first samples of ``parts`` equal parts of a side of a tile; a side shorter than that has fewer."""
    return np.unique(np.linspace(0, side, parts + 1).astype(int)[:-1])


def align_middles(image: Measurements, references: tuple[Measurements, ...]) -> Points:
    """Return the middles (x, y) px of the whole tiles, displaced by what exceeds the references' noise, ``(n, 2)``.

    Unlike in :func:`find_middles`, this also applies to the offset of the window around a tile. Tiles of an image
    without defects are therefore cut exactly on the lattice, like those of fresh draws.
    """
    noise = [np.concatenate(parts) for parts in zip(*map(_offsets, references), strict=True)]
    middles = image.tiles.centers[image.tiles.whole]
    for own, usual in zip(_offsets(image), noise, strict=True):
        middles = middles + own @ _wiener_filter(_covariance(own), _covariance(usual), _CHANCE).T
    return middles


def find_middles(image: Measurements, noise: Points) -> Points:
    """Return the middles (x, y) px of the whole tiles, displaced like the content of the image, ``(n, 2)``.

    A tile is displaced like the window around it, plus as much of its own offset from there as exceeds the noise of
    such offsets. This is Wiener's filter, whose signal covariance is that of the offsets less that of the noise.
    """
    around, own = _offsets(image)
    keep = _wiener_filter(_covariance(own), noise)
    return np.asarray(image.tiles.centers[image.tiles.whole] + around + own @ keep.T)


def offset_noise(images: tuple[Measurements, ...]) -> Points:
    """Return the covariance in px^2 of the tiles' own offsets in images without displacements."""
    return _covariance(np.concatenate([_offsets(image)[1] for image in images]))


def _offsets(image: Measurements) -> tuple[Points, Points]:
    """Return for each whole tile the offset of the window around it, 0 if misplaced, and its own offset from there."""
    tiles, windows = image.tiles, image.windows
    nearest = windows.find_nearest(tiles.centers[tiles.whole])
    inside = windows.misplacement[nearest] <= TOLERANCE
    around = windows.offsets[nearest] * inside[:, np.newaxis]
    return around, tiles.offsets[tiles.whole] - around


def _covariance(offsets: Points) -> Points:
    return offsets.T @ offsets / max(len(offsets), 1) + _LEAST_NOISE**2 * np.eye(2)


def _wiener_filter(total: Points, noise: Points, chance: float = 1.0) -> Points:
    """Return the matrix that keeps what exceeds the noise, along axes where it does so by a factor ``chance``."""
    values, vectors = np.linalg.eigh(noise)
    root = vectors @ np.diag(np.sqrt(values)) @ vectors.T
    back = np.linalg.inv(root)
    ratio, axes = np.linalg.eigh(back @ total @ back)
    return np.asarray(root @ axes @ np.diag(np.where(ratio > chance, 1 - 1 / ratio, 0.0)) @ axes.T @ back)


def squared_gradient(tile: Values, lattice: Lattice) -> NDArray[np.float64]:
    """Return the squared gradient per px of a periodic tile, ``(V, U, C)``."""
    rows, columns = tile.shape[:2]
    along = (np.roll(tile, -1, 1) - np.roll(tile, 1, 1)) * columns / 2
    across = (np.roll(tile, -1, 0) - np.roll(tile, 1, 0)) * rows / 2
    gradient = np.stack([along, across], -1) @ np.linalg.inv(lattice.matrix).T
    return np.asarray((gradient**2).sum(-1))


def interior_weights(mean: Values, energy: float, lattice: Lattice) -> NDArray[np.float32]:
    """Return weights ``(V, U)`` that are 1 in flat parts of the mean tile and small on its edges.

    Misalignment changes an edge by its gradient. If this exceeds the departures themselves, the pixel gets less weight.

    Parameters
    ----------
    mean
        ``(V, U, C)``: the mean tile.
    energy
        Mean squared departure from it.
    lattice
        The lattice of the tile.
    """
    steep = ndimage.maximum_filter(squared_gradient(mean, lattice).mean(-1).astype(np.float32), 3, mode="wrap")
    return np.asarray(1 / (1 + steep * _ALIGNMENT**2 / max(energy, 1e-9)), np.float32)


@dataclass(frozen=True)
class ComparedTiles:
    """The tiles of an output and of its references, all cut on one grid.

    Parameters
    ----------
    output
        Cut at their displacements.
    sample
        All whole tiles of the sample.
    fresh
        Those of fresh draws of the output's size, or of two halves of the sample if there are none (photographs).
    windows
        The sample's windows of half a tile around the middles of the four quarters, ``(m, V / 2, U / 2, C)`` each. They
        include those whose tile is not whole.
    extent, shapes
        Height and width in px of the boxes in which energies are compared; shapes of output and reference.
    model
        Whether the references are fresh draws.
    """

    output: TileSet
    sample: TileSet
    fresh: tuple[TileSet, ...]
    windows: tuple[Values, ...]
    extent: Shape
    shapes: tuple[Shape, Shape]
    model: bool

    @classmethod
    def of(cls, observation: Observation, verdict: Verdict) -> ComparedTiles:
        """Cut all tiles of an observation."""
        sample, lattice = verdict.reference.straighten(observation.sample)
        grid, model = even_grid(lattice), verdict.reference.source == "model"
        tiles = TileSet.on(sample, lattice, grid)
        output = _cut_displaced(verdict.output, verdict.references, grid)
        fresh = _cut_fresh(observation, verdict, grid) if model else _cut_halves(sample, tiles)
        shape = observation.output.shape[:2]
        other = shape if model else sample.shape[:2]
        extent = min(shape[0], other[0]), min(shape[1], other[1])
        windows = tuple(_cut_half_windows(sample, lattice, quarter, grid) for quarter in QUARTERS)
        return cls(output, tiles, fresh, windows, extent, (shape, other), model)

    @property
    def reference(self) -> tuple[TileSet, ...]:
        """The tiles that the output is compared with: those of fresh draws, or of the whole sample."""
        return self.fresh if self.model else (self.sample,)

    @cached_property
    def weights(self) -> NDArray[np.float32]:
        """``(V, U)``: weight of each sample of a tile, see :func:`interior_weights`."""
        energy = sum(float((tiles.departures**2).mean()) for tiles in self.reference) / len(self.reference)
        return interior_weights(self.mean, energy, self.sample.lattice)

    @cached_property
    def mean(self) -> Values:
        """The mean tile of the reference."""
        return np.asarray(np.concatenate([tiles.tiles for tiles in self.reference]).mean(0))

    @cached_property
    def blocks(self) -> tuple[list[TileSet], list[TileSet]]:
        """The tiles of output and reference in boxes of the extent that both have."""
        output = list(self.output.blocks(self.shapes[0], self.extent))
        return output, [block for tiles in self.reference for block in tiles.blocks(self.shapes[1], self.extent)]

    @property
    def fewest(self) -> int:
        """Smallest number of tiles in the compared images and blocks."""
        return min(map(len, (*self.blocks[0], *self.blocks[1], *self.fresh)), default=0)


def _cut_displaced(image: Measurements, references: tuple[Measurements, ...], grid: Grid) -> TileSet:
    """Cut an image's whole tiles at their displacements, see :func:`align_middles`."""
    tiles = image.tiles
    numbers = tiles.lattice.to_cell(tiles.centers[tiles.whole])
    return TileSet.cut(image.image, tiles.lattice, numbers, align_middles(image, references), grid)


def draw_fresh(observation: Observation) -> tuple[Texture, ...]:
    """Return fresh draws of the output's size, or none without a model. Metrics share them.

    Raises
    ------
    NoFreshDraw
        When the dataset gives no draw of this size.
    """
    draws = observation.shared(try_fresh)
    if any(draw is None for draw in draws):
        height, width = observation.output.shape[:2]
        raise NoFreshDraw(f"not applicable: the texture's dataset gives no fresh draw of {width}x{height} px")
    return tuple(draw for draw in draws if draw is not None)


def try_fresh(observation: Observation) -> tuple[Texture | None, ...]:
    """Return what the texture gives as fresh draws of the output's size: None where it gives none."""
    again, shape = observation.again, observation.output.shape[:2]
    if again is None:
        return ()
    area = shape[0] * shape[1]
    count = _FEW_DRAWS if area > _LARGE else int(np.clip(_DRAWS * 256**2 / area, _DRAWS, _MOST_DRAWS))
    return tuple(again(shape, _FIRST_DRAW + k) for k in range(count))


def measure_fresh(observation: Observation) -> tuple[Measurements, ...]:
    """Return the measurements of :func:`draw_fresh` whose content is displaced. Metrics share them."""
    reference = examine(observation).reference
    assert not isinstance(reference, str)
    draws = observation.shared(draw_fresh)
    return tuple(Measurements.at(reference.straighten(quantize(one.image))[0], reference.periodic) for one in draws)


def _cut_fresh(observation: Observation, verdict: Verdict, grid: Grid) -> tuple[TileSet, ...]:
    """Cut fresh draws of the output's size: on the lattice, or displaced if the model displaces its content."""
    draws = observation.shared(draw_fresh)
    if any(draw.displacement is not None for draw in draws):
        measured = observation.shared(measure_fresh)
        return tuple(_cut_displaced(measurements, verdict.references, grid) for measurements in measured)
    return tuple(TileSet.on(quantize(draw.image), verdict.reference.lattice, grid) for draw in draws)


def _cut_halves(sample: Image, tiles: TileSet) -> tuple[TileSet, TileSet]:
    """Return the tiles of two halves of the sample, divided across its longer side."""
    height, width = sample.shape[:2]
    along = tiles.centers[:, int(height > width)]
    low = along < np.median(along) if len(along) else np.zeros(0, np.bool_)
    return tiles.take(np.flatnonzero(low)), tiles.take(np.flatnonzero(~low))


def _cut_half_windows(sample: Image, lattice: Lattice, quarter: tuple[float, float], grid: Grid) -> Values:
    """Cut all windows of half a tile of the sample whose middle is equal to that of a quarter modulo the lattice."""
    (ax, ay), (bx, by) = lattice.matrix / 2
    half = Lattice((float(ax), float(ay)), (float(bx), float(by)))
    move = quarter @ lattice.matrix
    places = lattice.shifted((float(move[0]), float(move[1]))).points(sample.shape[:2])
    return cut_tiles(sample, half, places, (grid[0] // 2, grid[1] // 2))[0]
