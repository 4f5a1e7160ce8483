"""What one cell of a course looks like, and how much each of its pixels varies from cell to cell."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view
from numpy.typing import NDArray

from nrbench.imaging.fold import Values
from nrbench.lattice.geometry import Lattice

from .ncc_kernels import course_sums

Samples = NDArray[np.float64]
AXES = (((0, 1), (1, 0)), ((1, 0), (0, 1)), ((1, 1), (0, 1)), ((1, -1), (0, 1)))
"""For the courses along t1, t2, t2 - t1 and t1 + t2: what of the cell coordinates counts across, and what along."""
_VARIANCE_FLOOR = 0.05
"""Share of the mean variance that is added to every sample's: no few samples decide alone."""
_RARE = 0.25
"""Samples that fewer pixels fall on, over the mean, take those of their neighbors too: where a course runs obliquely
to the rows of pixels, these may fall on every second sample along it, but no more rarely while the lattice is reduced.
"""
_AT_ONCE = 1 << 22
"""Numbers of slid rows of a template that are held at a time: 32 MiB."""


@dataclass(frozen=True)
class Grid:
    """Samples across and along one cell of the courses of one direction, about one a pixel.

    Parameters
    ----------
    lattice
        Reduced.
    direction
        Number of the direction, as in :data:`AXES`.
    rows
        Samples across a course, an even number.
    columns
        Samples along one cell of it.
    """

    lattice: Lattice
    direction: int
    rows: int
    columns: int

    @classmethod
    def of(cls, lattice: Lattice, direction: int) -> Grid:
        """Return the grid of about one sample a pixel."""
        t1, t2 = lattice.matrix
        length = float(np.hypot(*(t1, t2, t2 - t1, t1 + t2)[direction]))
        return cls(lattice, direction, 2 * max(round(lattice.area / length / 2), 2), max(round(length), 4))

    def on(self, lattice: Lattice) -> Grid:
        """Return the grid with as many samples on another lattice."""
        return replace(self, lattice=lattice)

    @property
    def slides(self) -> Samples:
        """``(columns,)``: px by which the template slid by so many samples has moved, the shorter way round."""
        t1, t2 = self.lattice.matrix
        length = float(np.hypot(*(t1, t2, t2 - t1, t1 + t2)[self.direction]))
        steps = np.arange(self.columns)
        return np.minimum(steps, self.columns - steps) * length / self.columns

    def sums(self, image: Values, departures: Values) -> tuple[Samples, int]:
        """Return the sums of :func:`~.strip_kernels.course_sums`, and the half course at which they begin."""
        half = self.rows // 2
        places = self._places()
        corners = np.array([(x, y) for x in (0, image.shape[1] - 1) for y in (0, image.shape[0] - 1)])
        reached = np.floor(places[0, 0] + corners @ places[0, 1:]).astype(int)
        first = int(reached.min()) // half
        rows = max(-(-(int(reached.max()) + 1 - first * half) // half), 2) * half
        pixels, extra = (np.array(values, np.float32, order="C") for values in (image, departures))
        return course_sums(pixels, extra, places, first * half, rows, self.columns), first

    def _places(self) -> Samples:
        """Return row and column of the pixel (0, 0), and their growth along x and y, ``(2, 3)``."""
        axes = np.array(AXES[self.direction], np.float64) * np.array([[self.rows], [self.columns]])
        origin, x, y = self.lattice.to_cell(np.array([(0.0, 0.0), (1.0, 0.0), (0.0, 1.0)])) @ axes.T
        return np.ascontiguousarray(np.stack([origin, x - origin, y - origin], 1))


@dataclass(frozen=True)
class StripTemplate:
    """One cell of a course of the periodic image.

    Parameters
    ----------
    grid
        Its samples.
    mean
        ``(rows, columns, C)``.
    variance
        ``(rows, columns)``: mean square of what a pixel there departs from it, one channel; above 0.
    """

    grid: Grid
    mean: Samples
    variance: Samples

    @classmethod
    def of(cls, lattice: Lattice, image: Values, variance: Values, direction: int) -> StripTemplate:
        """Sample the periodic image and its ``variance`` across tiles, both of one shape that shows all of a cell."""
        grid, channels = Grid.of(lattice, direction), image.shape[2]
        sums, first = grid.sums(image, channels * variance)
        halves = sums.reshape(-1, grid.rows // 2, *sums.shape[1:])
        whole = np.concatenate([halves[(half + first) % 2 :: 2].sum(0) for half in (0, 1)])
        rare = whole[..., :1] < _RARE * whole[..., 0].mean()
        whole = np.where(rare, whole + np.roll(whole, 1, 1) + np.roll(whole, -1, 1), whole)
        count = np.maximum(whole[..., 0], 1)
        mean = whole[..., 1:-1] / count[..., np.newaxis]
        spread = np.maximum(whole[..., -1] / count - (mean**2).sum(-1), 0) / channels
        return cls(grid, mean, spread + _VARIANCE_FLOOR * spread.mean() + 1 / 255**2)

    def correlated(self, halves: Samples, half: int) -> tuple[Samples, Samples, Samples]:
        """Hold half courses against one half of the template slid by k samples along it, k = 0 .. columns - 1.

        The slid rows are laid out for matrix products: rows x columns x columns x (3 C + 3) multiplications a course,
        which for tiles of up to some 10 000 px is less than FFTs along rows this short cost.

        Parameters
        ----------
        halves
            ``(n, rows / 2, columns, C + 2)``: sums of :meth:`Grid.sums`.
        half
            Which half of the template's rows: 0 or 1.

        Returns
        -------
        fit
            ``(n, columns)``: sum over pixels of their squared departures over the variance, plus its logarithm.
        weight
            ``(n, columns)``: sum over pixels of the inverse variance.
        lacks
            ``(C, n, columns)``: sums over pixels of their departures over the variance.
        """
        first, middle = half * self.grid.rows // 2, (half + 1) * self.grid.rows // 2
        step = max(_AT_ONCE // (self.grid.columns**2 * (self.mean.shape[-1] + 2)), 1)
        parts = []
        for start in range(first, middle, step):
            rows = slice(start, min(start + step, middle))
            seen = halves[:, rows.start - first : rows.stop - first]
            parts.append(_products(np.moveaxis(seen, -1, 0).reshape(seen.shape[-1], len(seen), -1), self._slid(rows)))
        fit, weight, lacks = (sum(some[1:], some[0]) for some in zip(*parts, strict=True))
        return fit, weight, lacks

    def _slid(self, rows: slice) -> Samples:
        """Return constant, precision and slopes of some rows, ``(C + 2, rows * columns, columns)``, slid by k."""
        mean, variance, columns = self.mean[rows], self.variance[rows], self.grid.columns
        precision, channels = 1 / variance, mean.shape[-1]
        constant = precision * (mean**2).sum(-1) + channels * np.log(variance)
        planes = np.stack([constant, precision, *np.moveaxis(precision[..., np.newaxis] * mean, -1, 0)])
        backwards = np.concatenate([planes, planes], -1)[..., :0:-1]
        windows = sliding_window_view(backwards, columns, -1)[..., ::-1, :]
        return windows.reshape(len(planes), -1, columns)


def _products(seen: Samples, slid: Samples) -> tuple[Samples, Samples, Samples]:
    """Return what :meth:`StripTemplate.correlated` does, of sums ``(C + 2, n, m)`` and rows ``(C + 2, m, columns)``."""
    count, values, squares = seen[0], seen[1:-1], seen[-1]
    alone = count @ slid
    fit = alone[0] + squares @ slid[1] - 2 * (values @ slid[2:]).sum(0)
    return fit, alone[1], values @ slid[1] - alone[2:]


def strip_templates(lattice: Lattice, image: Values, variance: Values) -> tuple[StripTemplate, ...]:
    """Return one cell of the courses of each direction."""
    return tuple(StripTemplate.of(lattice, image, variance, direction) for direction in range(len(AXES)))
