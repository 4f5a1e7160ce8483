"""Follow a lattice outward from one place of an image, however much its vectors change on the way."""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cached_property
from typing import Any, Final

import numpy as np
import scipy
from numpy.typing import NDArray

from nrbench.imaging.mean_tile import Tile, Values, sample_tile
from nrbench.lattice.geometry import Lattice, Points
from nrbench.tracking import growth_kernels
from nrbench.tracking.tracker import cell_covariance

__all__ = ["TRUNCATED", "Knots", "Start", "Window", "fit_basis", "grow_from", "grow_on", "spread_window"]

PARTS: Final = 2
"""Parts into which each step of about s is divided by knots, if they are fine."""
MOST_KNOTS: Final = 12000
"""Most knots that an image may hold; where there are more, only every second one, every fourth one ... is used."""
_WIDTH = 1.2
"""Width in tiles of the window of a knot."""
TRUNCATED = 1.9
"""Radius of a window in standard deviations."""
_MOST_SAMPLES = 450
"""Most points of a window that are read."""
_MARGIN = 0.0
"""Correlation above the level below which a knot is searched for in other places nearby."""
_ROOM = 2.2
"""Diameter of the plane that knots may cover, over the image's diagonal."""
_FARTHEST = 0.3
"""Largest distance, in s, of a knot from its prediction."""
_SPREAD = 0.15
"""Standard deviation of a knot's departure from its prediction: of the place, in s, and of the slopes."""
_NOISE = 0.05
"""Mean squared difference of an image and its template, both normalized, that the prediction is weighed against."""
_STEPS = 8
"""Steps of the registration of a start."""
_LEAST_SEEN = 0.6
"""Share of a window that must lie in the image."""
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
        """Return the vectors and the origin of :meth:`mean_lattice`, ``(3, 2)`` px."""
        return fit_basis(self.cells[self.known], self.places[self.known])

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
        at = self.positions(cells)
        planes = np.moveaxis(self._continued, -1, 0)
        return np.stack([scipy.ndimage.map_coordinates(plane, at, order=3, mode="nearest") for plane in planes], -1)

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


def fit_basis(cells: Points, places: Points) -> Points:
    """Return the vectors and the origin, ``(3, 2)`` px, of the lattice whose points lie nearest to places.

    Parameters
    ----------
    cells, places
        ``(n, 2)`` each: cell coordinates, and (x, y) px where they were found.
    """
    design = np.column_stack([cells, np.ones(len(cells))])
    return np.asarray(np.linalg.lstsq(design, places, rcond=None)[0])


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


@dataclass(frozen=True)
class Window:
    """The window of a knot, and the mean tile under it at each phase of a knot.

    Parameters
    ----------
    points, templates
        See :data:`~.growth_kernels.Window` and :data:`~.growth_kernels.Templates`.
    s
        Length of the shortest lattice vector, px.
    spread
        Standard deviation of a knot's departure from its prediction: of the place, in s, and of the affine map.
    """

    points: growth_kernels.Window
    templates: growth_kernels.Templates
    s: float
    spread: float = _SPREAD

    @classmethod
    def of(
        cls,
        offsets: Points,
        weights: NDArray[np.float64],
        tiles: tuple[Values, Values, Values],
        s: float,
        spread: float = _SPREAD,
    ) -> Window:
        """Return the window for the tile and its slopes along x and y, ``(p, n, C)`` each."""
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
        return cls(
            (_contiguous(offsets), _contiguous(weights), np.abs(offsets).max(0)),
            (_contiguous(template, np.float32), _contiguous(rows, np.float32), _contiguous(normals), _contiguous(sums)),
            s,
            spread,
        )

    @property
    def _prior(self) -> NDArray[np.float64]:
        """Costs of a squared departure from the prediction: of the place, per px^2, and of the map."""
        return np.array([_NOISE / (self.spread * self.s) ** 2, _NOISE / self.spread**2])

    def register(self, image: Values, phase: int, state: Points) -> float:
        """Fit a place and an affine map in place, and return the correlation, see :func:`~.growth_kernels.register`."""
        values, rows, normals, sums = (part[phase] for part in self.templates)
        template, start = (values, rows, normals, sums), state.copy()
        pixels = _contiguous(image, np.float32)
        return growth_kernels.register(pixels, template, self.points, state, start, self._prior, _LEAST_SEEN, _STEPS)

    def grow(
        self,
        image: Values,
        phases: NDArray[np.int64],
        points: Points,
        states: Points,
        correlation: NDArray[np.float64],
        seed: NDArray[np.int64],
        levels: tuple[float, ...],
        margin: float,
    ) -> None:
        """Find the places of knots, see :func:`~.growth_kernels.grow_knots`."""
        growth_kernels.grow_knots(
            _contiguous(image, np.float32),
            self.templates,
            _contiguous(phases, np.int64),
            self.points,
            _contiguous(points),
            states,
            correlation,
            _contiguous(seed, np.int64),
            self._prior,
            np.array(levels, np.float64),
            _FARTHEST * self.s,
            margin,
            _LEAST_SEEN,
        )


def _contiguous(values: NDArray[Any], dtype: Any = np.float64) -> NDArray[Any]:
    """Return values as the kernels need them."""
    return np.ascontiguousarray(values, dtype)


def grow_from(image: Values, start: Start, levels: tuple[float, ...], fine: bool = True) -> Knots:
    """Follow a lattice from one place outward, and return the knots that were found.

    At each knot the image is registered with the mean tile under a Gaussian window as broad as 1.2 tiles, for place and
    affine distortion, starting from what its known neighbors predict. The knot that is best surrounded by well
    correlated ones comes next. This is reliability-guided digital image correlation (B. Pan, Applied Optics 48, 2009),
    with a periodic template. Unlike the displacements of :func:`~nrbench.tracking.tracker.track_lattice`, those found
    here may have any slope: the window is strained like the image, and the next knot is predicted with that strain.

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
    return _grow(image, start.tile, parts, seed - half, states, correlation, half[::-1], levels)


def grow_on(image: Values, tile: Tile, knots: Knots, levels: tuple[float, ...]) -> Knots:
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
    """
    parts = np.array(knots.parts)
    margin = _half_size(tile.lattice, parts, image.shape[:2]) // 2
    frame = ((margin[1], margin[1]), (margin[0], margin[0]))
    distortion = knots.slopes @ np.linalg.inv(tile.lattice.matrix.T)
    states = np.concatenate([knots.places, distortion.reshape(*knots.known.shape, 4)], -1)
    states = np.pad(np.where(knots.known[..., np.newaxis], states, 0.0), (*frame, (0, 0)))
    nowhere = np.array([-1, -1])
    return _grow(
        image, tile, parts, np.array(knots.first) - margin, states, np.pad(knots.correlation, frame), nowhere, levels
    )


def _grow(
    image: Values,
    tile: Tile,
    parts: NDArray[np.float64],
    first: NDArray[np.int64],
    states: Points,
    correlation: NDArray[np.float64],
    seed: NDArray[np.int64],
    levels: tuple[float, ...],
) -> Knots:
    """Find the places of knots on a grid whose first one has the numbers ``first``, see :meth:`Window.grow`."""
    matrix = tile.lattice.matrix
    rows, columns = correlation.shape
    offsets, weights = spread_window(_WIDTH**2 * cell_covariance(tile.lattice), 1.0, _MOST_SAMPLES)
    periods = np.maximum(parts, 1).astype(np.int64)
    u, v = np.meshgrid(*(np.arange(n) / n for n in periods))
    middles = np.stack([u, v], -1).reshape(-1, 1, 2)
    inverse = np.linalg.inv(matrix)

    def read(x: float, y: float) -> Values:
        return sample_tile(tile.values, middles + (offsets + np.array([x, y])) @ inverse)

    half_pixel = np.float32(0.5)
    slopes = half_pixel * (read(1, 0) - read(-1, 0)), half_pixel * (read(0, 1) - read(0, -1))
    window = Window.of(offsets, weights, (read(0, 0), *slopes), tile.lattice.s)
    a, b = ((np.arange(n) + number) % period for n, number, period in zip((columns, rows), first, periods, strict=True))
    # Only differences of the points count. Small ones are exact.
    middle = np.array([columns // 2, rows // 2])
    numbers = np.stack(np.meshgrid(np.arange(columns), np.arange(rows)), -1) - middle
    origins, known = states.copy(), correlation.copy()
    # Where the seed is not correlated enough for the first level, it is tried at the next one.
    for number in range(len(levels)):
        states[:], correlation[:] = origins, known
        window.grow(
            image,
            b[:, np.newaxis] * periods[0] + a,
            (numbers / parts) @ matrix,
            states,
            correlation,
            seed,
            levels[number:],
            _MARGIN,
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
        states[..., 2:].reshape(rows, columns, 2, 2)[box] @ matrix.T,
        correlation[box],
    )


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


def spread_window(covariance: Points, spacing: float, most: int | None = None) -> tuple[Points, NDArray[np.float64]]:
    """Return the points of a Gaussian window, (x, y) px from its middle, and their weights, of sum 1.

    Parameters
    ----------
    covariance
        2 x 2, px^2. The window ends at :data:`TRUNCATED` standard deviations.
    spacing
        px; distance of the points along x and y.
    most
        Every second, third ... point is left out if there are more than this number.
    """
    reach = np.ceil(TRUNCATED * np.sqrt(np.diag(covariance)) / spacing)
    x, y = np.meshgrid(*(np.arange(-end, end + 1) * spacing for end in reach))
    offsets = np.stack([x, y], -1).reshape(-1, 2)
    distance = np.einsum("ni,ij,nj->n", offsets, np.linalg.inv(covariance), offsets)
    inside = np.flatnonzero(distance <= TRUNCATED**2)
    chosen = inside[:: math.ceil(len(inside) / most) if most else 1]
    weights = np.exp(-distance[chosen] / 2)
    return offsets[chosen], weights / weights.sum()
