"""Templates of courses: one cell of a course of the periodic image, and its variance from cell to cell."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view
from numpy.typing import NDArray

from nrbench.imaging.mean_tile import Values
from nrbench.lattice.geometry import Lattice

from .ncc_kernels import sum_courses

Samples = NDArray[np.float64]
AXES = (((0, 1), (1, 0)), ((1, 0), (0, 1)), ((1, 1), (0, 1)), ((1, -1), (0, 1)))
"""For courses along t1, t2, t2 - t1 and t1 + t2: coefficients (u, v) of the cell coordinate across the course, and of
the cell coordinate along it."""
_VARIANCE_FLOOR = 0.05
"""Share of the mean variance that is added to the variance of every sample, so that no few samples dominate."""
_RARE = 0.25
"""Number of pixels on a sample, over the mean, below which the pixels of its two neighbors are added. If a course is
oblique to the rows of pixels, these may fall on every second sample only (never less often, for a reduced lattice)."""
_AT_ONCE = 1 << 22
"""Largest number of values of the slid template that are in memory at a time (32 MiB)."""


@dataclass(frozen=True)
class CourseGrid:
    """Samples across and along one cell of the courses of one direction, about one a pixel.

    Parameters
    ----------
    lattice
        Reduced.
    direction
        Index of the direction in :data:`AXES`.
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
    def of(cls, lattice: Lattice, direction: int) -> CourseGrid:
        """Return the grid of about one sample a pixel."""
        t1, t2 = lattice.matrix
        length = float(np.hypot(*(t1, t2, t2 - t1, t1 + t2)[direction]))
        return cls(lattice, direction, 2 * max(round(lattice.area / length / 2), 2), max(round(length), 4))

    def with_lattice(self, lattice: Lattice) -> CourseGrid:
        """Return the grid with the same numbers of samples, on another lattice."""
        return replace(self, lattice=lattice)

    @property
    def slides(self) -> Samples:
        """``(columns,)``: displacement in px if the template slides by k samples, modulo the cell."""
        t1, t2 = self.lattice.matrix
        length = float(np.hypot(*(t1, t2, t2 - t1, t1 + t2)[self.direction]))
        steps = np.arange(self.columns)
        return np.minimum(steps, self.columns - steps) * length / self.columns

    def sum_pixels(self, image: Values, departures: Values) -> tuple[Samples, int]:
        """Sum the pixels of an image over the cells of each course.

        Parameters
        ----------
        image
            ``(H, W, C)``.
        departures
            ``(H, W)``: value that is added to the sum of squares of each pixel.

        Returns
        -------
        Samples
            ``(n * rows / 2, columns, C + 2)``: the sums of :func:`~.ncc_kernels.sum_courses` for n half courses.
        int
            Number of the first half course.
        """
        half = self.rows // 2
        places = self._places()
        corners = np.array([(x, y) for x in (0, image.shape[1] - 1) for y in (0, image.shape[0] - 1)])
        rows_reached = np.floor(places[0, 0] + corners @ places[0, 1:]).astype(int)
        first = int(rows_reached.min()) // half
        rows = max(-(-(int(rows_reached.max()) + 1 - first * half) // half), 2) * half
        pixels, extra = (np.array(values, np.float32, order="C") for values in (image, departures))
        return sum_courses(pixels, extra, places, first * half, rows, self.columns), first

    def _places(self) -> Samples:
        """Return row and column of the pixel (0, 0), and their growth per px along x and along y, ``(2, 3)``."""
        axes = np.array(AXES[self.direction], np.float64) * np.array([[self.rows], [self.columns]])
        origin, x, y = self.lattice.to_cell(np.array([(0.0, 0.0), (1.0, 0.0), (0.0, 1.0)])) @ axes.T
        return np.ascontiguousarray(np.stack([origin, x - origin, y - origin], 1))


@dataclass(frozen=True)
class CourseTemplate:
    """One cell of a course of the periodic image.

    Parameters
    ----------
    grid
        The samples.
    mean
        ``(rows, columns, C)``: mean of the pixels on each sample.
    variance
        ``(rows, columns)``: mean squared departure of these pixels from their mean, per channel; above 0.
    """

    grid: CourseGrid
    mean: Samples
    variance: Samples

    @classmethod
    def of(cls, lattice: Lattice, image: Values, variance: Values, direction: int) -> CourseTemplate:
        """Return the template of one direction.

        Parameters
        ----------
        lattice
            Reduced.
        image
            ``(H, W, C)``: the periodic image, large enough to show every place of a cell.
        variance
            ``(H, W)``: its variance across tiles.
        direction
            Index of the direction in :data:`AXES`.
        """
        grid, channels = CourseGrid.of(lattice, direction), image.shape[2]
        sums, first = grid.sum_pixels(image, channels * variance)
        halves = sums.reshape(-1, grid.rows // 2, *sums.shape[1:])
        whole = np.concatenate([halves[(half + first) % 2 :: 2].sum(0) for half in (0, 1)])
        rare = whole[..., :1] < _RARE * whole[..., 0].mean()
        whole = np.where(rare, whole + np.roll(whole, 1, 1) + np.roll(whole, -1, 1), whole)
        count = np.maximum(whole[..., 0], 1)
        mean = whole[..., 1:-1] / count[..., np.newaxis]
        departure = np.maximum(whole[..., -1] / count - (mean**2).sum(-1), 0) / channels
        return cls(grid, mean, departure + _VARIANCE_FLOOR * departure.mean() + 1 / 255**2)

    def compare_halves(self, halves: Samples, half: int) -> tuple[Samples, Samples, Samples]:
        """Compare half courses with one half of the template, slid along it by k = 0 .. columns - 1 samples.

        The comparison uses matrix products. They take rows x columns x columns x (3 C + 3) multiplications a course.
        For tiles of up to about 10 000 px this costs less than FFTs along these short rows.

        Parameters
        ----------
        halves
            ``(n, rows / 2, columns, C + 2)``: sums of :meth:`CourseGrid.sum_pixels`.
        half
            Half of the rows of the template: 0 or 1.

        Returns
        -------
        fit
            ``(n, columns)``: sum over pixels and channels of the squared difference from the template over the
            variance, plus the logarithm of the variance.
        weight
            ``(n, columns)``: sum of the inverse variance over pixels.
        differences
            ``(C, n, columns)``: sums over pixels of the difference from the template over the variance.
        """
        first, middle = half * self.grid.rows // 2, (half + 1) * self.grid.rows // 2
        step = max(_AT_ONCE // (self.grid.columns**2 * (self.mean.shape[-1] + 2)), 1)
        parts = []
        for start in range(first, middle, step):
            rows = slice(start, min(start + step, middle))
            sums = halves[:, rows.start - first : rows.stop - first]
            planes = np.moveaxis(sums, -1, 0).reshape(sums.shape[-1], len(sums), -1)
            parts.append(_multiply_sums(planes, self._slide_rows(rows)))
        fit, weight, differences = (sum(some[1:], some[0]) for some in zip(*parts, strict=True))
        return fit, weight, differences

    def _slide_rows(self, rows: slice) -> Samples:
        """Return some rows of the template, slid by every k, ``(C + 2, rows * columns, columns)``.

        The C + 2 planes are the coefficients of the normal log-likelihood: its constant, the inverse variance, and the
        inverse variance times the mean of each channel.
        """
        mean, variance, columns = self.mean[rows], self.variance[rows], self.grid.columns
        precision, channels = 1 / variance, mean.shape[-1]
        constant = precision * (mean**2).sum(-1) + channels * np.log(variance)
        planes = np.stack([constant, precision, *np.moveaxis(precision[..., np.newaxis] * mean, -1, 0)])
        backwards = np.concatenate([planes, planes], -1)[..., :0:-1]
        windows = sliding_window_view(backwards, columns, -1)[..., ::-1, :]
        return windows.reshape(len(planes), -1, columns)


def _multiply_sums(sums: Samples, slid: Samples) -> tuple[Samples, Samples, Samples]:
    """Return the result of :meth:`CourseTemplate.compare_halves` for some rows.

    Parameters
    ----------
    sums
        ``(C + 2, n, m)``: sums over the pixels of half courses.
    slid
        ``(C + 2, m, columns)``: rows of the template, from :meth:`CourseTemplate._slide_rows`.
    """
    count, values, squares = sums[0], sums[1:-1], sums[-1]
    weighted_count = count @ slid
    fit = weighted_count[0] + squares @ slid[1] - 2 * (values @ slid[2:]).sum(0)
    return fit, weighted_count[1], values @ slid[1] - weighted_count[2:]


def make_course_templates(lattice: Lattice, image: Values, variance: Values) -> tuple[CourseTemplate, ...]:
    """Return the templates of all four directions; see :meth:`CourseTemplate.of` for the parameters."""
    return tuple(CourseTemplate.of(lattice, image, variance, direction) for direction in range(len(AXES)))
