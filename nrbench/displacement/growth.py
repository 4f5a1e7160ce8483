"""Follow a lattice outward from one place of an image, however much its vectors change on the way."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any, Final

import numpy as np
import scipy
from numpy.typing import NDArray

from nrbench.imaging.masks import Mask
from nrbench.imaging.mean_tile import Tile, Values, interpolate_planes, sample_tile
from nrbench.imaging.source_maps import read_nearest
from nrbench.lattice.geometry import Lattice, Points

from . import growth_kernels

PARTS: Final = 2
"""Parts into which each step of about s is divided by knots, if they are fine."""
MOST_KNOTS: Final = 12000
"""Most knots that an image may hold; where there are more, only every second one, every fourth one ... is used."""
_WIDTH = 1.2
"""Width in tiles of the window of a knot."""
_TRUNCATED = 1.9
"""Radius of a window in standard deviations."""
_MOST_SAMPLES = 450
"""Most points of a window that are read."""
_ROOM = 2.2
"""Diameter of the plane that knots may cover, over the image's diagonal."""
_FARTHEST = 0.3
"""Largest distance, in s, of a knot from its prediction."""
_SPREAD = 0.15
"""Standard deviation of a knot's departure from its prediction: of the place, in s, and of the slopes."""
_NOISE = 0.05
"""Mean squared difference of an image and its template, both normalized, that the prediction is weighed against."""
_FIRST = 1e-3
"""Correlation that the knot of a start has before it is registered."""
_LEAST_SEEN, _LAST_SEEN = 0.6, 0.45
"""Share of a window that must lie in the image, and in the last round, in which knots at the border are found, too."""
_LEAST_KNOWN = 0.9
"""Share of the pixels around a knot, in a square as broad as its window, that must count."""
_THINNEST = 1e-4
"""Area of a cell, over the sum of its squared sides, below which knots count as lying on one line."""


@dataclass(frozen=True, eq=False)
class Knots:
    """Where a grid of points of a lattice, and points between them, lie in an image.

    Parameters
    ----------
    parts
        Knots for each lattice vector t1 and t2; below 1 if there are fewer knots than lattice points.
    first
        Numbers (a, b) of the first knot. The knot in row i and column j has cell coordinates
        ((a + j) / parts[0], (b + i) / parts[1]).
    places
        ``(rows, columns, 2)``: (x, y) px.
    slopes
        ``(rows, columns, 2, 2)``: derivative of the place by the cell coordinates, px.
    correlation
        ``(rows, columns)``: correlation of the image with the mean tile at each knot, 0 where it was not found.
    """

    parts: tuple[float, float]
    first: tuple[int, int]
    places: Points
    slopes: Points
    correlation: NDArray[np.float64]

    @classmethod
    def regular(cls, lattice: Lattice, shape: tuple[int, int]) -> Knots:
        """Return the points of a lattice in an image of ``shape``, none of which was found."""
        low, high = (np.array(end) for end in ((0.0, 0.0), (shape[1] - 1.0, shape[0] - 1.0)))
        numbers = lattice.cell_numbers(low, high)
        first = numbers.min(0)
        columns, rows = numbers.max(0) - first + 1
        u, v = np.meshgrid(np.arange(columns) + first[0], np.arange(rows) + first[1])
        places = lattice.from_cell(np.stack([u, v], -1))
        slopes = np.tile(lattice.matrix.T, (rows, columns, 1, 1))
        return cls((1.0, 1.0), (int(first[0]), int(first[1])), places, slopes, np.zeros((rows, columns)))

    @property
    def known(self) -> NDArray[np.bool_]:
        """``bool (rows, columns)``: which knots were found."""
        return np.asarray(self.correlation > 0)

    @property
    def cells(self) -> Points:
        """``(rows, columns, 2)``: cell coordinates (u, v) of the knots."""
        rows, columns = self.correlation.shape
        u, v = np.meshgrid(np.arange(columns) + self.first[0], np.arange(rows) + self.first[1])
        return np.stack([u / self.parts[0], v / self.parts[1]], -1)

    def among(self, known: Mask) -> Knots:
        """Return the knots without those around which pixels do not count, so that nothing was there to be followed.

        Those stay around which nine tenths of the pixels count, in a square as broad as the window of a knot.
        """
        side = max(round(_WIDTH * math.sqrt(abs(float(np.linalg.det(self._fit()[:2]))))), 1)
        share = scipy.ndimage.uniform_filter(known.astype(np.float32), side)
        return replace(
            self, correlation=np.where(read_nearest(share, self.places) > _LEAST_KNOWN, self.correlation, 0.0)
        )

    @property
    def quality(self) -> float:
        """Mean correlation of the known knots, 0 if there are none."""
        return float(self.correlation[self.known].mean()) if self.known.any() else 0.0

    @property
    def area(self) -> float:
        """Area of the image, px^2, that belongs to known knots."""
        return float(np.abs(np.linalg.det(self.slopes[self.known])).sum() / math.prod(self.parts))

    @property
    def spans_plane(self) -> bool:
        """Whether the known knots have a mean lattice. They have none if they lie on one line, as in a narrow strip."""
        cells = self.cells[self.known]
        if not len(cells) or np.linalg.matrix_rank(cells - cells.mean(0)) < 2:
            return False
        basis = self._fit()[:2]
        return bool(abs(np.linalg.det(basis)) > _THINNEST * np.square(basis).sum())

    def mean_lattice(self) -> Lattice:
        """Return the lattice, origin included, whose points lie nearest to the known places (least squares).

        There is one if the known knots span the plane (:attr:`spans_plane`).
        """
        fit = self._fit()
        return Lattice.from_basis(fit[:2], fit[2])

    def _fit(self) -> Points:
        """Return the vectors and the origin of :meth:`mean_lattice`, ``(3, 2)`` px; of all knots if none is known."""
        use = self.known if self.known.any() else np.ones_like(self.known)
        design = np.column_stack([self.cells[use], np.ones(use.sum())])
        return np.asarray(np.linalg.lstsq(design, self.places[use], rcond=None)[0])

    def resized(self, factor: int) -> Knots:
        """Return the knots in an image of which each pixel here was the mean of ``factor`` x ``factor`` px."""
        places = factor * self.places + (factor - 1) / 2
        return Knots(self.parts, self.first, places, factor * self.slopes, self.correlation)

    def positions(self, cells: Points) -> Points:
        """Return the row and column, real-valued, of cell coordinates ``(..., 2)``, as ``(2, ...)``."""
        return np.moveaxis((cells * self.parts - self.first)[..., ::-1], -1, 0)

    def is_near(self, cells: Points) -> NDArray[np.bool_]:
        """Return whether most of the four knots around cell coordinates ``(..., 2)`` are known."""
        weight = scipy.ndimage.map_coordinates(
            self.known.astype(np.float64), self.positions(cells), order=1, mode="constant"
        )
        return np.asarray(weight > 0.49)

    def locate(self, cells: Points) -> Points:
        """Return the places (x, y) px of cell coordinates ``(..., 2)``, by cubic splines through the knots."""
        return interpolate_planes(self._continued, self.positions(cells), 3, "nearest")

    @cached_property
    def _continued(self) -> Points:
        """The places; a knot that was not found continues the slopes of those around it, from the known ones outward.

        The array is framed by known values or their continuation, so that splines do not swing.
        """
        have = self.known.copy()
        values = np.concatenate([self.places, self.slopes.reshape(*have.shape, 4)], -1)
        values[~have] = 0
        step = 1 / np.array(self.parts)
        rows, columns = have.shape
        while not have.all():
            framed, marks = np.pad(values, ((1, 1), (1, 1), (0, 0))), np.pad(have, 1)
            total, count = np.zeros_like(values), np.zeros(have.shape)
            for i in (-1, 0, 1):
                for j in (-1, 0, 1):
                    box = np.s_[1 + i : 1 + i + rows, 1 + j : 1 + j + columns]
                    other, mark = framed[box].copy(), marks[box]
                    slopes = other[..., 2:].reshape(rows, columns, 2, 2)
                    other[..., :2] -= slopes @ (np.array([j, i]) * step)
                    total += mark[..., np.newaxis] * other
                    count += mark
            new = ~have & (count > 0)
            values[new] = total[new] / count[new][:, np.newaxis]
            have = have | new
        return values[..., :2]


@dataclass(frozen=True)
class Start:
    """A place from which a lattice is followed.

    Parameters
    ----------
    tile
        The mean tile; the origin of its lattice does not matter.
    cell
        (u, v): cell coordinates of the place.
    place
        (x, y) px.
    slopes
        2 x 2 px: derivative of the place by the cell coordinates.
    """

    tile: Tile
    cell: Points
    place: Points
    slopes: Points


def _templates(
    offsets: Points, weights: NDArray[np.float64], tiles: tuple[Values, Values, Values]
) -> growth_kernels.Templates:
    """Return what windows are registered with, for the tile and its slopes along x and y, ``(p, n, C)`` each."""
    planes = [np.moveaxis(plane, -1, 1) for plane in tiles]
    mean = planes[0] @ weights
    centered = planes[0] - mean[..., np.newaxis]
    deviation = np.sqrt(np.maximum(((centered**2) @ weights).sum(1), 1e-12))
    template, across, down = (plane / deviation[:, np.newaxis, np.newaxis] for plane in (centered, *planes[1:]))
    dx, dy = offsets.T
    rows = np.stack([across, down, across * dx, across * dy, down * dx, down * dy], 1)
    weighted = rows * weights
    flat = rows.reshape(*rows.shape[:2], -1)
    normals = weighted.reshape(flat.shape) @ np.swapaxes(flat, 1, 2)
    products = (weighted * template[:, np.newaxis]).sum((2, 3))
    sums = np.concatenate([np.swapaxes(weighted.sum(-1), 1, 2), products[:, np.newaxis]], 1)
    return _contiguous(template, np.float32), _contiguous(rows, np.float32), _contiguous(normals), _contiguous(sums)


def _contiguous(values: NDArray[Any], dtype: Any = np.float64) -> NDArray[Any]:
    """Return values as the kernels need them."""
    return np.ascontiguousarray(values, dtype)


def grow_from(image: Values, start: Start, levels: tuple[float, ...], fine: bool = True) -> Knots:
    """Follow a lattice from one place outward, and return the knots that were found.

    At each knot the image is registered with the mean tile under a Gaussian window as broad as 1.2 tiles, for place and
    affine distortion, starting from what its known neighbors predict. The knot that is best surrounded by well
    correlated ones comes next. This is reliability-guided digital image correlation (B. Pan, Applied Optics 48, 2009),
    with a periodic template. The displacements may have any slope: the window is strained like the image, and the next
    knot is predicted with that strain.

    Parameters
    ----------
    image
        ``(H, W, C)``.
    start
        Where to start.
    levels
        Correlation from which a knot counts as known, in each round; in all rounds after the first the known knots are
        registered again with all their neighbors known.
    fine
        Whether knots lie about s / 2 apart, else s.
    """
    matrix = start.tile.lattice.matrix
    parts = _parts(start.tile.lattice, image.shape[:2], fine)
    half = _half_size(start.tile.lattice, parts, image.shape[:2])
    seed = np.rint(start.cell * parts).astype(np.int64)
    columns, rows = 2 * half + 1
    states, correlation = np.zeros((rows, columns, 6)), np.zeros((rows, columns))
    distortion = np.linalg.solve(matrix, start.slopes.T).T
    # The seed is a knot near the start.
    place = start.place + start.slopes @ (seed / parts - start.cell)
    states[half[1], half[0]] = *place, *distortion.ravel()
    correlation[half[1], half[0]] = _FIRST
    return _grow(image, start.tile, parts, seed - half, (states, correlation), levels, _LEAST_SEEN)


def grow_on(image: Values, tile: Tile, knots: Knots, levels: tuple[float, ...], last: bool = False) -> Knots:
    """Follow a lattice outward from known knots, and into the gaps between them, and return the knots that were found.

    Parameters
    ----------
    image
        ``(H, W, C)``.
    tile
        The mean tile; the origin of its lattice does not matter.
    knots
        The known knots. They are registered again in each round.
    levels
        As for :func:`grow_from`.
    last
        Whether windows may lie farther beyond the image, but at most one step beyond the known knots.
    """
    parts = np.array(knots.parts)
    margin = np.array([1, 1]) if last else _half_size(tile.lattice, parts, image.shape[:2]) // 2
    frame = ((margin[1], margin[1]), (margin[0], margin[0]))
    distortion = knots.slopes @ np.linalg.inv(tile.lattice.matrix.T)
    states = np.concatenate([knots.places, distortion.reshape(*knots.known.shape, 4)], -1)
    states = np.pad(np.where(knots.known[..., np.newaxis], states, 0.0), (*frame, (0, 0)))
    start = states, np.pad(knots.correlation, frame)
    least_seen = _LAST_SEEN if last else _LEAST_SEEN
    return _grow(image, tile, parts, np.array(knots.first) - margin, start, levels, least_seen)


def _grow(
    image: Values,
    tile: Tile,
    parts: NDArray[np.float64],
    first: NDArray[np.int64],
    start: growth_kernels.Found,
    levels: tuple[float, ...],
    least_seen: float,
) -> Knots:
    """Find the places of knots on a grid whose first one has the numbers ``first``, from those that are known."""
    lattice, (rows, columns) = tile.lattice, start[1].shape
    offsets, weights = spread_window(_WIDTH**2 * cell_covariance(lattice), _MOST_SAMPLES)
    periods = np.maximum(parts, 1).astype(np.int64)
    u, v = np.meshgrid(*(np.arange(n) / n for n in periods))
    middles = np.stack([u, v], -1).reshape(-1, 1, 2)
    inverse = np.linalg.inv(lattice.matrix)

    def read(x: float, y: float) -> Values:
        return sample_tile(tile.values, middles + (offsets + np.array([x, y])) @ inverse)

    half_pixel = np.float32(0.5)
    slopes = half_pixel * (read(1, 0) - read(-1, 0)), half_pixel * (read(0, 1) - read(0, -1))
    a, b = ((np.arange(n) + number) % period for n, number, period in zip((columns, rows), first, periods, strict=True))
    # Only differences of the points count. Small ones are exact.
    middle = np.array([columns // 2, rows // 2])
    numbers = np.stack(np.meshgrid(np.arange(columns), np.arange(rows)), -1) - middle
    prior = np.array([_NOISE / (_SPREAD * lattice.s) ** 2, _NOISE / _SPREAD**2])
    # Where the start is not correlated enough for the first level, it is tried at the next one.
    for number in range(len(levels)):
        states, correlation = (_contiguous(each.copy()) for each in start)
        growth_kernels.grow_knots(
            _contiguous(image, np.float32),
            _templates(offsets, weights, (read(0, 0), *slopes)),
            (_contiguous(offsets), _contiguous(weights), np.abs(offsets).max(0)),
            (_contiguous((numbers / parts) @ lattice.matrix), _contiguous(b[:, np.newaxis] * periods[0] + a, np.int64)),
            (states, correlation),
            np.array(levels[number:], np.float64),
            (prior, _FARTHEST * lattice.s, least_seen),
        )
        if correlation.any():
            break
    found = np.argwhere(correlation > 0)
    (top, left), (bottom, right) = (found.min(0), found.max(0) + 1) if len(found) else (middle[::-1], middle[::-1] + 1)
    box = np.s_[top:bottom, left:right]
    return Knots(
        (float(parts[0]), float(parts[1])),
        (int(first[0] + left), int(first[1] + top)),
        states[..., :2][box],
        states[..., 2:].reshape(rows, columns, 2, 2)[box] @ lattice.matrix.T,
        correlation[box],
    )


def cell_covariance(lattice: Lattice) -> Points:
    """Return the covariance, 2 x 2 px^2, of points spread evenly over the lattice's Voronoi cell.

    Unlike that of the parallelogram it does not depend on the basis.
    """
    side = (np.arange(24) + 0.5) / 24
    uv = np.stack(np.meshgrid(side, side), -1).reshape(-1, 2)
    points = lattice.wrap(uv @ lattice.matrix)
    return np.asarray(points.T @ points / len(points))


def _half_size(lattice: Lattice, parts: NDArray[np.float64], shape: tuple[int, int]) -> NDArray[np.int64]:
    """Return the largest numbers, counted from the middle, of knots that an image may need along each vector."""
    reach = _ROOM / 2 * math.hypot(*shape)
    heights = lattice.area / np.hypot(*lattice.matrix.T)[::-1]
    return np.asarray(np.ceil(reach * parts / heights), np.int64)


def _parts(lattice: Lattice, shape: tuple[int, int], fine: bool) -> NDArray[np.float64]:
    """Return the numbers of knots for each lattice vector: powers of 2 times those of steps of about s."""
    parts = (PARTS if fine else 1) * np.maximum(np.rint(np.hypot(*lattice.matrix.T) / lattice.s), 1)
    while math.prod(shape) / lattice.area * math.prod(parts) > MOST_KNOTS:
        # A vector is divided into a whole number of parts, or a part is a whole number of vectors.
        parts = np.where(parts >= 2, parts // 2, np.where(parts > 1, 1.0, parts / 2))
    return np.asarray(parts, np.float64)


def spread_window(covariance: Points, most: int) -> tuple[Points, NDArray[np.float64]]:
    """Return the points of a Gaussian window, (x, y) px from its middle, and their weights, of sum 1.

    Parameters
    ----------
    covariance
        2 x 2, px^2. The window ends at 1.9 standard deviations.
    most
        Every second, third ... point is left out if there are more than this number.
    """
    reach = np.ceil(_TRUNCATED * np.sqrt(np.diag(covariance)))
    x, y = np.meshgrid(*(np.arange(-end, end + 1) for end in reach))
    offsets = np.stack([x, y], -1).reshape(-1, 2)
    distance = np.einsum("ni,ij,nj->n", offsets, np.linalg.inv(covariance), offsets)
    inside = np.flatnonzero(distance <= _TRUNCATED**2)
    chosen = inside[:: math.ceil(len(inside) / most)]
    weights = np.exp(-distance[chosen] / 2)
    return offsets[chosen], weights / weights.sum()
