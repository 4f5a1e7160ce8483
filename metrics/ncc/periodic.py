"""The periodic image that a texture follows, and the templates that are cut from it."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from nrbench.imaging.fold import Tile, Values, fold, tile_grid
from nrbench.lattice.geometry import Lattice, Points
from nrbench.plugins.forms import Shape

from .refinement import Cell
from .strip_template import StripTemplate, strip_templates
from .window_search import Bank, Colors, Places, Scan, Template

WINDOW_TILES = 2.0
"""Width of the windows whose place is registered, in tiles: two show every joint of a tile whole, wherever they lie."""
TOLERANCE = 0.1
"""Displacement, in units of s, up to which content counts as in place: less than the smallest defect to be detected
(0.15 s), more than is measured on windows of fresh draws (0.06 s)."""
HALVES = ((0.0, 0.0), (0.5, 0.0), (0.0, 0.5), (0.5, 0.5))
"""Cell coordinates of the middles of the one-tile windows."""
_VARIANCE_FLOOR = 0.1
"""Share of the mean variance that is added to every pixel's: no pixel weighs more than ten times the mean's weight."""

_FINENESS, _LEAST_COUNT = (3, 2, 1), 0.5
"""Samples per pixel along each axis of a cell folded from many, tried in this order until every sample has more than
``_LEAST_COUNT`` pixels."""
_LARGE_CELL = 300
"""Area of a cell, px, above which its windows are compared in blocks of 2 x 2 pixels, at every place."""
_SIZES, _LARGE_SIZES, _LARGE_TILE = (1, 2), (2, 2), 600
"""One-tile windows are compared pixel by pixel, or in blocks of 2 x 2 pixels if the cell has more than 600 px. Their
means and power are always taken over blocks of 2 x 2."""
_SHARPENED = 2
"""How often the residual of the image is folded and added to the cell, which is blurred by sharing pixels."""
LARGE = 7
"""Cells each way over which a cell is averaged: some 50 pixels fall on each of its samples."""


@dataclass(frozen=True)
class Search:
    """One-tile windows at one place of the cell, all searched in one patch.

    Parameters
    ----------
    half
        Cell coordinates of the windows' middles.
    bank, scan
        The patch, to be looked at exactly near that place, and in the rest of the cell.
    place
        (x, y) px in the patch where the window's corner belongs.
    near
        Offsets within the tolerance of that place.
    """

    half: tuple[float, float]
    bank: Bank
    scan: Scan
    place: Points
    near: NDArray[np.bool_]


@dataclass(frozen=True)
class Periodic:
    """The periodic image that a texture follows, and how much each of its pixels varies from tile to tile.

    Parameters
    ----------
    lattice
        Reduced.
    ideal
        The periodic image: from a shape to the image of that shape whose first pixel is at (0, 0); or one tile of it.
    variance
        Mean tile of the squared departures, one channel.
    """

    lattice: Lattice
    ideal: Callable[[Shape], Values] | Tile
    variance: Tile

    def image(self, shape: Shape) -> Values:
        """Return the periodic image of ``shape``, its first pixel at (0, 0)."""
        return self.ideal.unfold(shape) if isinstance(self.ideal, Tile) else self.ideal(shape)

    def weights(self, shape: Shape) -> NDArray[np.float32]:
        """Return what each pixel counts for: the inverse of its variance across tiles, of mean 1.

        A tenth of the mean variance (and that of rounding to 8 bits) is added to every pixel's, so that no few pixels
        carry all the weight.
        """
        variance = self._variance(shape)
        weights = 1 / (variance + _VARIANCE_FLOOR * self.variance.values.mean() + 1 / 255**2)
        return np.asarray(weights / weights.mean(), np.float32)

    def stretched(self, matrix: Points) -> Periodic:
        """Return the same tile on the lattice that the affine displacement ``matrix @ (x, y)`` moves this one to."""
        moved = np.vstack([self.lattice.matrix, self.lattice.origin]) @ (np.eye(2) + matrix).T
        return self.on(Lattice.from_basis(moved[:2], moved[2]))

    def on(self, lattice: Lattice) -> Periodic:
        """Return the same tile on another lattice."""
        if not isinstance(self.ideal, Tile):
            raise TypeError("only a periodic image that is held as a tile can be put on another lattice")
        ideal, variance = (Tile(tile.values, tile.counts, lattice) for tile in (self.ideal, self.variance))
        return Periodic(lattice, ideal, variance)

    @cached_property
    def windows(self) -> Template:
        """A patch that holds every displacement of a cell at least once, for windows of 2 tiles."""
        window = window_shape(self.lattice, WINDOW_TILES)
        cell = np.ceil(np.abs(self.lattice.matrix).sum(0)).astype(int) + 2
        shape = (window[0] + int(cell[1]), window[1] + int(cell[0]))
        return Template(self.colors.along(self._patch(shape)), self.weights(shape), window)

    @cached_property
    def colors(self) -> Colors:
        """The axes of color of all templates and windows."""
        height, width = window_shape(self.lattice, WINDOW_TILES)
        return Colors.of(self._patch((height, width)))

    def _patch(self, shape: Shape) -> Values:
        """Return :meth:`image`, cut from :attr:`large` if that is large enough."""
        enough = shape[0] <= self.large.shape[0] and shape[1] <= self.large.shape[1]
        return self.large[: shape[0], : shape[1]] if enough else self.image(shape)

    @cached_property
    def large(self) -> Values:
        """The periodic image over :data:`LARGE` cells or more each way: every place of a cell."""
        side = np.ceil(LARGE * tile_box(self.lattice)).astype(int)
        return self.image((int(side[1]), int(side[0])))

    def _variance(self, shape: Shape) -> Values:
        """Return the variance ``(H, W)``, cut from that of :attr:`large` if that is large enough."""
        there = self._large_variance
        enough = shape[0] <= there.shape[0] and shape[1] <= there.shape[1]
        return there[: shape[0], : shape[1]] if enough else self.variance.unfold(shape)[..., 0]

    @cached_property
    def _large_variance(self) -> Values:
        return self.variance.unfold(self.large.shape[:2])[..., 0]

    @cached_property
    def courses(self) -> tuple[StripTemplate, ...]:
        """One cell of its courses in each direction."""
        return strip_templates(self.lattice, self.large, self._large_variance)

    @cached_property
    def cell(self) -> Cell:
        """One cell, for interpolation between its samples: as fine as the many cells of a rendered image allow."""
        floor = float(_VARIANCE_FLOOR * self.variance.values.mean() + 1 / 255**2)
        return Cell.of(self.ideal if isinstance(self.ideal, Tile) else self._finely_folded(), self.variance, floor)

    def _finely_folded(self) -> Tile:
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
    def places(self) -> Places:
        """The same patch, to be looked at within one cell of displacements about its middle."""
        template = self.windows
        rows, columns = (
            side - length + 1 for side, length in zip(template.weights.shape, template.window, strict=True)
        )
        y, x = np.indices((rows, columns))
        inside = _within_cell(np.stack([x - columns // 2, y - rows // 2], -1).astype(np.float64), self.lattice)
        return Places(template, inside, self.colors, 2 if self.lattice.area > _LARGE_CELL else 1)

    @cached_property
    def searches(self) -> tuple[Search, ...]:
        """Patches for one-tile windows, half a cell apart along both vectors."""
        return tuple(self._search(half) for half in HALVES)

    @cached_property
    def _offsets(self) -> tuple[NDArray[np.bool_], NDArray[np.bool_], int]:
        return _offsets(self.lattice)

    def _search(self, half: tuple[float, float]) -> Search:
        window = window_shape(self.lattice, 1.0)
        size = np.array(window[::-1])
        near, far, reach = self._offsets
        wanted = self.lattice.from_cell(half) - (size - 1) / 2
        wanted = reach + 1 + self.lattice.wrap(wanted - 2 * reach - 1)
        x, y = (int(value) for value in np.floor(wanted + 0.5 + 1e-6))
        width, height = (int(value) for value in size + 2 * reach)
        image, weights = (plane((y + height, x + width))[y:, x:] for plane in (self._patch, self.weights))
        template = Template(self.colors.along(image), weights, window)
        bank = Bank(template, _ringed(near), self.colors.varies)
        sizes = _LARGE_SIZES if self.lattice.area > _LARGE_TILE else _SIZES
        return Search(half, bank, Scan(template, far, self.colors, sizes), reach + wanted - (x, y), near)


def tile_box(lattice: Lattice) -> NDArray[np.float64]:
    """Return width and height in px of the upright box that stands for one cell.

    It has the spread of the cell along x and y: sqrt(t1^2 + t2^2) in each coordinate, with the canonical basis.
    """
    return np.asarray(np.sqrt((lattice.canonical().matrix ** 2).sum(0)))


def window_shape(lattice: Lattice, tiles: float) -> tuple[int, int]:
    """Return height and width in px of a window that is ``tiles`` tiles wide."""
    width, height = np.maximum(np.rint(tiles * tile_box(lattice)), 3).astype(int)
    return int(height), int(width)


def _offsets(lattice: Lattice) -> tuple[NDArray[np.bool_], NDArray[np.bool_], int]:
    """Return masks of the offsets within the tolerance and in the rest of the Voronoi cell, and their reach in px."""
    reach = int(lattice.covering_radius) + 2
    y, x = np.indices((2 * reach + 1, 2 * reach + 1)) - reach
    cell = _within_cell(np.stack([x, y], -1).astype(np.float64), lattice)
    near = np.hypot(x, y) <= max(TOLERANCE * lattice.s, 1.0)
    return near, cell & ~near, reach


def _within_cell(offsets: Points, lattice: Lattice) -> NDArray[np.bool_]:
    """Return which offsets are nearer to zero than to any other lattice point."""
    return np.asarray(np.abs(lattice.wrap(offsets) - offsets).max(-1) < 1e-6)


def _ringed(mask: NDArray[np.bool_]) -> NDArray[np.bool_]:
    """Return a mask with the pixels next to it along both axes: what a parabola through a peak needs."""
    return np.asarray(ndimage.binary_dilation(mask))
