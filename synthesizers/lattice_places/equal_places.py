"""Find the places in a sample that a lattice makes equal, and the cells that are one cell of an output that repeats."""

from __future__ import annotations

import math
import warnings
from collections.abc import Iterable
from dataclasses import dataclass
from functools import cached_property
from typing import Any, Final

import numpy as np
from numpy.typing import ArrayLike, NDArray

from nrbench.lattice.geometry import Lattice, Points, integers_within
from nrbench.plugins.forms import Refused, Shape

Pixels = NDArray[np.int64]
"""``int64 (n, 2)``: whole-pixel (x, y) of a patch's first pixel."""
SearchShape = tuple[int, int]
"""Number of rows and of columns of whole-pixel places at which a patch lies inside a sample."""


def search_shape(size: int, shape: tuple[int, int]) -> SearchShape:
    """Return the search shape of a square patch of ``size`` px in a sample of ``shape``, not positive if none fits."""
    return shape[0] - size + 1, shape[1] - size + 1


@dataclass(frozen=True)
class EqualPlaces:
    """Finds the places ``position + a t1 + b t2`` (a, b integers) at which a patch lies inside a sample.

    Places are real-valued. Rounding a place changes it by at most half a pixel anywhere in the output; with rounded
    lattice vectors, the error would increase with a and b.

    Parameters
    ----------
    lattice
        Its origin has no effect.
    search_shape
        See :func:`search_shape`. A place counts if it rounds to one of these whole-pixel places.
    margin
        Distance in px by which a place may lie outside.

    Examples
    --------
    >>> EqualPlaces(Lattice((30, 0), (0, 24)), (25, 60)).find_places((95, 200)).tolist()
    [[5.0, 8.0], [35.0, 8.0]]
    """

    lattice: Lattice
    search_shape: SearchShape
    margin: float = 0.0

    def find_places(self, position: ArrayLike) -> Points:
        """Return the places equal to a patch's (x, y) px in the output, ``(n, 2)``, row by row, possibly none."""
        # The lattice vectors that can lead into the sample are listed once. A call only shifts and filters them.
        at = np.asarray(position, np.float64)
        places = at - np.floor(at @ self._inverse) @ self._basis + self._steps
        low, high = -0.5 - self.margin, np.array(self.search_shape[::-1]) - 0.5 + self.margin
        places = places[((places >= low) & (places < high)).all(1)]
        return np.asarray(places[np.lexsort(places.round(6).T)])

    @cached_property
    def _basis(self) -> Points:
        return self.lattice.reduced().matrix

    @cached_property
    def _inverse(self) -> Points:
        return np.asarray(np.linalg.inv(self._basis))

    @cached_property
    def _steps(self) -> Points:
        """All lattice vectors from a point of the cell with corner 0 to a place inside the sample."""
        corners = np.array([(0, 0), (1, 0), (0, 1), (1, 1)]) @ self._basis
        last = np.array(self.search_shape[::-1]) - 0.5
        low, high = -0.5 - self.margin - corners.max(0), last + self.margin - corners.min(0)
        return np.asarray(integers_within(self._basis, low, high) @ self._basis)


def pixel_grid(width: int, height: int, left: int = 0, top: int = 0) -> NDArray[np.int64]:
    """Return the (x, y) of each pixel of a rectangle whose first one is (``left``, ``top``): ``int64 (h, w, 2)``."""
    y, x = np.indices((height, width))
    return np.stack([x + left, y + top], -1)


def nearest_pixels(positions: Points, search_shape: SearchShape) -> Pixels:
    """Return places rounded to whole pixels (halves up), row by row, without repetitions."""
    return _unique(_round(positions), search_shape)


def nearby_pixels(positions: Points, tolerance: float, search_shape: SearchShape) -> Pixels:
    """Return the whole-pixel places within ``tolerance`` px of any of ``positions``, along x and along y.

    Places are in the order of rows, without repetitions. The nearest pixel always counts, however small the tolerance
    is (RSGF, section 4.2, uses 3 px).
    """
    reach = max(tolerance, 0.5) + 1e-9
    steps = np.arange(-math.floor(reach + 0.5), math.floor(reach + 0.5) + 1)
    offsets = np.stack(np.meshgrid(steps, steps, indexing="ij"), -1).reshape(-1, 2)
    near = _round(positions)[:, np.newaxis] + offsets
    close = (np.abs(near - positions[:, np.newaxis]) <= reach).all(-1)
    inside = ((near >= 0) & (near < search_shape[::-1])).all(-1)
    return _unique(near[close & inside], search_shape)


def _round(positions: Points) -> Pixels:
    return np.floor(positions + 0.5).astype(np.int64)


def _unique(positions: Pixels, search_shape: SearchShape) -> Pixels:
    index = np.unique(positions[:, 1] * search_shape[1] + positions[:, 0])
    return np.stack([index % search_shape[1], index // search_shape[1]], -1)


PERIOD_SLACK: Final = 0.05
"""px by which a sample may be smaller than two periods. Periods are not measured more accurately than this."""


def require_two_periods(lattice: Lattice, shape: tuple[int, ...]) -> None:
    """Check that a sample of ``shape`` (height, width, ...) shows two periods along x and along y.

    Raises
    ------
    Refused
        If the sample is narrower or lower than twice the extent of the lattice's two shortest vectors.
    """
    if not shows_two_periods(lattice, shape):
        extent = _extent(lattice)
        raise Refused(
            f"the lattice reaches {extent[0]:.1f}x{extent[1]:.1f} px, the sample is {shape[1]}x{shape[0]} px: it shows "
            "less than two periods; choose a larger sample"
        )


def shows_two_periods(lattice: Lattice, shape: tuple[int, ...]) -> bool:
    """Return whether a sample of ``shape`` (height, width, ...) shows two periods along x and along y."""
    return bool((2 * _extent(lattice) <= np.array(shape[1::-1]) + 2 * PERIOD_SLACK).all())


def _extent(lattice: Lattice) -> NDArray[np.float64]:
    """Return the extent of the two shortest vectors along x and along y: the larger component of both, px."""
    return np.asarray(np.abs(lattice.canonical().matrix).max(0))


@dataclass(frozen=True)
class CellTorus:
    """Cells of a lattice of which those that lie whole periods apart are one cell.

    The periods are (columns, 0) and (shift, rows), in cells. They are the Hermite normal form of any other periods.

    Parameters
    ----------
    columns, rows
        NDArray[np.int64] of different cells along the two vectors of the lattice.
    shift
        Columns by which the cells are moved ``rows`` rows on.
    """

    columns: int
    rows: int
    shift: int = 0

    @classmethod
    def of(cls, periods: Iterable[Iterable[int]]) -> CellTorus:
        """Return the torus of two or more periods in cells.

        Examples
        --------
        >>> CellTorus.of([(4, 1), (2, -3)])
        CellTorus(columns=14, rows=1, shift=4)
        """
        first, second = np.zeros(2, np.int64), np.zeros(2, np.int64)
        for period in periods:
            last = np.array(period, np.int64)
            while last[1]:
                second, last = last, second - (second[1] // last[1]) * last
            first[0] = np.gcd(first[0], last[0])
        shift, rows = (second * np.sign(second[1])).tolist()
        return cls(int(first[0]), rows, shift % int(first[0]))

    @classmethod
    def closing(cls, lattice: Lattice, shape: Shape) -> CellTorus:
        """Return the torus of an output whose sides are vectors of a lattice."""
        return cls.of(np.rint(np.diag(shape[::-1]) @ np.linalg.inv(lattice.matrix)).astype(np.int64))

    def joined(self, period: tuple[int, int]) -> CellTorus:
        """Return the torus that has one more period."""
        return CellTorus.of([(self.columns, 0), (self.shift, self.rows), period])

    def wrap(self, cells: NDArray[np.integer[Any]]) -> NDArray[np.int64]:
        """Return the same cells, ``(..., 2)``, from (0, 0) to (columns, rows), without the latter."""
        turns = cells[..., 1] // self.rows
        return np.stack([(cells[..., 0] - turns * self.shift) % self.columns, cells[..., 1] - turns * self.rows], -1)

    def find_equal(self, cells: NDArray[np.int64]) -> tuple[NDArray[np.intp], ...]:
        """Return where in a box of cells, ``(I, J, 2)``, one cell stands for all that are equal, off the box's border.

        The box without its border must show all cells.
        """
        number = np.ravel_multi_index(tuple(np.moveaxis(self.wrap(cells), -1, 0)), (self.columns, self.rows))
        inner = number[1:-1, 1:-1]
        _, first = np.unique(inner, return_index=True)
        return tuple(at + 1 for at in np.unravel_index(first[number], inner.shape))

    def transform(self, values: NDArray[Any]) -> NDArray[np.complex128]:
        """Return the Fourier transform of values of the cells, ``(columns, rows, ...)``."""
        if not self.shift:
            return np.fft.fft2(values, axes=(0, 1))
        return np.fft.fft(np.fft.fft(values, axis=0) * self._twist(values.ndim), axis=1)

    def invert(self, spectrum: NDArray[np.complex128]) -> NDArray[np.complex128]:
        """Return the values of which a spectrum is the Fourier transform."""
        if not self.shift:
            return np.fft.ifft2(spectrum, axes=(0, 1))
        return np.fft.ifft(np.fft.ifft(spectrum, axis=1) * self._twist(spectrum.ndim).conj(), axis=0)

    def _twist(self, dimensions: int) -> NDArray[np.complex128]:
        """Return the phases that make waves continue across the border that is shifted."""
        turns = np.outer(np.arange(self.columns), np.arange(self.rows)) * self.shift / (self.columns * self.rows)
        return np.asarray(np.exp(2j * np.pi * turns).reshape(self.columns, self.rows, *(1,) * (dimensions - 2)))


def warn_of_no_lattice(method: str, reason: str) -> None:
    """Warn that a method does without a lattice because none was found."""
    warnings.warn(
        f"{method}: no lattice found ({reason}), so the output keeps no regularity; if the sample is regular, give its "
        "lattice",
        stacklevel=2,
    )
