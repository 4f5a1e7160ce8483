"""The periodic image of a texture, and the templates that are cut from it."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from nrbench.imaging.mean_tile import Tile, Values, fold, tile_grid
from nrbench.lattice.geometry import Lattice, Points
from nrbench.plugins.forms import Shape

from .course_template import CourseTemplate, make_course_templates
from .refinement import Cell
from .window_search import CellSearch, Colors, Correlator, OffsetSearch, Template

WINDOW_TILES = 2.0
"""Width, in tiles, of the windows that are registered. A window of two tiles contains every joint of a tile whole,
wherever it lies."""
TOLERANCE = 0.1
"""Displacement, in units of s, up to which content counts as in place: less than the smallest defect to be detected
(0.15 s), more than is measured on windows of fresh draws (0.06 s)."""
HALVES = ((0.0, 0.0), (0.5, 0.0), (0.0, 0.5), (0.5, 0.5))
"""Cell coordinates of the middles of the one-tile windows."""
_VARIANCE_FLOOR = 0.1
"""Share of the mean variance that is added to the variance of every pixel. It limits the weight of a pixel to ten times
that of a pixel of mean variance."""

_FINENESS, _LEAST_COUNT = (3, 2, 1), 0.5
"""Samples per pixel along each axis of a cell folded from many, tried in this order until every sample has more than
``_LEAST_COUNT`` pixels."""
_LARGE_CELL = 300
"""Area of a cell, px, above which two-tile windows are compared in blocks of 2 x 2 pixels."""
_SIZES, _LARGE_SIZES, _LARGE_TILE = (1, 2), (2, 2), 600
"""One-tile windows are compared pixel by pixel, or in blocks of 2 x 2 pixels if the cell has more than 600 px. Their
means and power are always taken over blocks of 2 x 2."""
_SHARPENED = 2
"""Number of times that the residual of the image is folded and added to the cell. Folding shares each pixel among
samples and so blurs the cell; this restores it."""
LARGE = 7
"""Number of cells, along each axis, over which a cell is averaged: about 50 pixels fall on each sample."""


@dataclass(frozen=True)
class TileSearch:
    """Search for the one-tile windows at one place of the cell, in one patch of the periodic image.

    Parameters
    ----------
    half
        Cell coordinates of the windows' middles.
    correlator
        Exact correlation at offsets near that place.
    offset_search
        Search in the rest of the cell.
    place
        (x, y) px: offset in the patch at which a window is in its place.
    near
        ``bool``: offsets within the tolerance of that place.
    """

    half: tuple[float, float]
    correlator: Correlator
    offset_search: OffsetSearch
    place: Points
    near: NDArray[np.bool_]


@dataclass(frozen=True)
class Periodic:
    """The periodic image of a texture, and the variance of each of its pixels from tile to tile.

    Parameters
    ----------
    lattice
        Reduced.
    ideal
        The periodic image: a function that returns the image of a given shape, with its first pixel at (0, 0), or one
        tile.
    variance
        Mean tile of the squared departures from the periodic image, one channel.
    window_tiles
        Width, in tiles, of the windows that are registered.
    """

    lattice: Lattice
    ideal: Callable[[Shape], Values] | Tile
    variance: Tile
    window_tiles: float = WINDOW_TILES

    def image(self, shape: Shape) -> Values:
        """Return the periodic image of ``shape``, with its first pixel at (0, 0)."""
        return self.ideal.unfold(shape) if isinstance(self.ideal, Tile) else self.ideal(shape)

    def weights(self, shape: Shape) -> NDArray[np.float32]:
        """Return the weight of each pixel, the inverse of its variance across tiles, ``(H, W)``, with mean 1.

        A tenth of the mean variance, and the variance of rounding to 8 bits, are added to that of every pixel, so that
        no few pixels dominate.
        """
        variance = self._variance(shape)
        weights = 1 / (variance + _VARIANCE_FLOOR * self.variance.values.mean() + 1 / 255**2)
        return np.asarray(weights / weights.mean(), np.float32)

    def with_lattice(self, lattice: Lattice) -> Periodic:
        """Return the periodic image with the same tile on another lattice; only for a periodic image of one tile."""
        if not isinstance(self.ideal, Tile):
            raise TypeError("a periodic image that is a function cannot change its lattice; give one tile instead")
        ideal, variance = (Tile(tile.values, tile.counts, lattice) for tile in (self.ideal, self.variance))
        return Periodic(lattice, ideal, variance, self.window_tiles)

    @cached_property
    def windows(self) -> Template:
        """Template that contains every displacement of a window within one cell."""
        window = window_shape(self.lattice, self.window_tiles)
        cell = np.ceil(np.abs(self.lattice.matrix).sum(0)).astype(int) + 2
        shape = (window[0] + int(cell[1]), window[1] + int(cell[0]))
        return Template(self.colors.project(self._patch(shape)), self.weights(shape), window)

    @cached_property
    def colors(self) -> Colors:
        """Axes of color of all templates and windows."""
        height, width = window_shape(self.lattice, WINDOW_TILES)
        return Colors.of(self._patch((height, width)))

    def _patch(self, shape: Shape) -> Values:
        """Return the periodic image of ``shape``, cut from :attr:`large` if that is large enough."""
        enough = shape[0] <= self.large.shape[0] and shape[1] <= self.large.shape[1]
        return self.large[: shape[0], : shape[1]] if enough else self.image(shape)

    @cached_property
    def large(self) -> Values:
        """Periodic image of at least :data:`LARGE` cells along each axis."""
        side = np.ceil(LARGE * tile_box(self.lattice)).astype(int)
        return self.image((int(side[1]), int(side[0])))

    def _variance(self, shape: Shape) -> Values:
        """Return the variance ``(H, W)``, cut from that of :attr:`large` if that is large enough."""
        large = self._large_variance
        enough = shape[0] <= large.shape[0] and shape[1] <= large.shape[1]
        return large[: shape[0], : shape[1]] if enough else self.variance.unfold(shape)[..., 0]

    @cached_property
    def _large_variance(self) -> Values:
        return self.variance.unfold(self.large.shape[:2])[..., 0]

    @cached_property
    def course_templates(self) -> tuple[CourseTemplate, ...]:
        """Templates of the courses in each direction."""
        return make_course_templates(self.lattice, self.large, self._large_variance)

    @cached_property
    def cell(self) -> Cell:
        """One cell with its derivatives; it has several samples per pixel if a model renders the image."""
        floor = float(_VARIANCE_FLOOR * self.variance.values.mean() + 1 / 255**2)
        return Cell.of(self.ideal if isinstance(self.ideal, Tile) else self._fold_finely(), self.variance, floor)

    def _fold_finely(self) -> Tile:
        """Return the cell folded from :attr:`large`, with several samples per pixel if enough pixels fall on each."""
        image, (rows, columns) = self.large, tile_grid(self.lattice)
        for fineness in _FINENESS:
            tile = fold(image, self.lattice, grid=(fineness * rows, fineness * columns))
            if tile.counts.min() > _LEAST_COUNT:
                break
        for _ in range(_SHARPENED):
            left = fold(image - tile.unfold(image.shape[:2]), self.lattice, grid=tile.counts.shape)
            tile = Tile(tile.values + left.values, tile.counts, self.lattice)
        return tile

    @cached_property
    def cell_search(self) -> CellSearch:
        """Search for the windows within one cell of displacements about the middle of their template."""
        template = self.windows
        rows, columns = (
            side - length + 1 for side, length in zip(template.weights.shape, template.window, strict=True)
        )
        y, x = np.indices((rows, columns))
        inside = _within_cell(np.stack([x - columns // 2, y - rows // 2], -1).astype(np.float64), self.lattice)
        return CellSearch(template, inside, self.colors, 2 if self.lattice.area > _LARGE_CELL else 1)

    @cached_property
    def tile_searches(self) -> tuple[TileSearch, ...]:
        """Searches for one-tile windows, half a cell apart along both vectors."""
        return tuple(self._make_tile_search(half) for half in HALVES)

    @cached_property
    def _offsets(self) -> tuple[NDArray[np.bool_], NDArray[np.bool_], int]:
        return _offsets(self.lattice)

    def _make_tile_search(self, half: tuple[float, float]) -> TileSearch:
        window = window_shape(self.lattice, 1.0)
        size = np.array(window[::-1])
        near, far, reach = self._offsets
        wanted = self.lattice.from_cell(half) - (size - 1) / 2
        wanted = reach + 1 + self.lattice.wrap(wanted - 2 * reach - 1)
        x, y = (int(value) for value in np.floor(wanted + 0.5 + 1e-6))
        width, height = (int(value) for value in size + 2 * reach)
        image, weights = (plane((y + height, x + width))[y:, x:] for plane in (self._patch, self.weights))
        template = Template(self.colors.project(image), weights, window)
        correlator = Correlator(template, _dilate(near), self.colors.varies)
        sizes = _LARGE_SIZES if self.lattice.area > _LARGE_TILE else _SIZES
        offset_search = OffsetSearch(template, far, self.colors, sizes)
        return TileSearch(half, correlator, offset_search, reach + wanted - (x, y), near)


def tile_box(lattice: Lattice) -> NDArray[np.float64]:
    """Return width and height in px of an upright box of about the extent of one cell.

    Each side is sqrt(t1^2 + t2^2) in that coordinate, with the vectors of the canonical basis.
    """
    return np.asarray(np.sqrt((lattice.canonical().matrix ** 2).sum(0)))


def window_shape(lattice: Lattice, tiles: float) -> tuple[int, int]:
    """Return height and width in px of a window that is ``tiles`` tiles wide."""
    width, height = np.maximum(np.rint(tiles * tile_box(lattice)), 3).astype(int)
    return int(height), int(width)


def _offsets(lattice: Lattice) -> tuple[NDArray[np.bool_], NDArray[np.bool_], int]:
    """Return masks of the offsets within the tolerance and in the rest of the Voronoi cell, and their range in px."""
    reach = int(lattice.covering_radius) + 2
    y, x = np.indices((2 * reach + 1, 2 * reach + 1)) - reach
    cell = _within_cell(np.stack([x, y], -1).astype(np.float64), lattice)
    near = np.hypot(x, y) <= max(TOLERANCE * lattice.s, 1.0)
    return near, cell & ~near, reach


def _within_cell(offsets: Points, lattice: Lattice) -> NDArray[np.bool_]:
    """Return which offsets are nearer to zero than to any other lattice point."""
    return np.asarray(np.abs(lattice.wrap(offsets) - offsets).max(-1) < 1e-6)


def _dilate(mask: NDArray[np.bool_]) -> NDArray[np.bool_]:
    """Return a mask with its neighbors along both axes, which the parabola through a peak needs."""
    return np.asarray(ndimage.binary_dilation(mask))
