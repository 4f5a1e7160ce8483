"""What one cell of a course looks like, and how much each of its pixels varies from cell to cell."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from nrbench.imaging.fold import Values
from nrbench.lattice.geometry import Lattice

from .strip_kernels import course_sums

Samples = NDArray[np.float64]
AXES = (((0, 1), (1, 0)), ((1, 0), (0, 1)), ((1, 1), (0, 1)), ((1, -1), (0, 1)))
"""For the courses along t1, t2, t2 - t1 and t1 + t2: what of the cell coordinates counts across, and what along."""
_VARIANCE_FLOOR = 0.05
"""Share of the mean variance that is added to every sample's: no few samples decide alone."""
_RARE = 0.25
"""Samples that fewer pixels fall on, over the mean, take those of their neighbors too: where a course runs obliquely
to the rows of pixels, these may fall on every second sample along it, but no more rarely while the lattice is reduced.
"""


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
        whole = np.zeros((grid.rows, *sums.shape[1:]))
        np.add.at(whole, (np.arange(len(sums)) + first * (grid.rows // 2)) % grid.rows, sums)
        rare = whole[..., :1] < _RARE * whole[..., 0].mean()
        whole = np.where(rare, whole + np.roll(whole, 1, 1) + np.roll(whole, -1, 1), whole)
        count = np.maximum(whole[..., 0], 1)
        mean = whole[..., 1:-1] / count[..., np.newaxis]
        spread = np.maximum(whole[..., -1] / count - (mean**2).sum(-1), 0) / channels
        return cls(grid, mean, spread + _VARIANCE_FLOOR * spread.mean() + 1 / 255**2)

    @cached_property
    def spectra(self) -> tuple[NDArray[np.complex128], ...]:
        """What counts, squares and values of a row are to be correlated with: conjugate spectra along the course."""
        precision, channels = 1 / self.variance, self.mean.shape[-1]
        constant = precision * (self.mean**2).sum(-1) + channels * np.log(self.variance)
        slopes = precision[..., np.newaxis] * self.mean
        return tuple(np.conj(np.fft.rfft(one, axis=1)) for one in (constant, precision, slopes))


def strip_templates(lattice: Lattice, image: Values, variance: Values) -> tuple[StripTemplate, ...]:
    """Return one cell of the courses of each direction."""
    return tuple(StripTemplate.of(lattice, image, variance, direction) for direction in range(len(AXES)))
