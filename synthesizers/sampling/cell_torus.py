"""The cells of an output that repeats."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from nrbench.lattice.geometry import Lattice
from nrbench.plugins.forms import Shape

Numbers = NDArray[np.int64]


@dataclass(frozen=True)
class CellTorus:
    """Cells of a lattice of which those that lie whole periods apart are one cell.

    The periods are (columns, 0) and (shift, rows), in cells. They are the Hermite normal form of any other periods.

    Parameters
    ----------
    columns, rows
        Numbers of different cells along the two vectors of the lattice.
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

    def wrap(self, cells: NDArray[np.integer[Any]]) -> Numbers:
        """Return the same cells, ``(..., 2)``, from (0, 0) to (columns, rows), without the latter."""
        turns = cells[..., 1] // self.rows
        return np.stack([(cells[..., 0] - turns * self.shift) % self.columns, cells[..., 1] - turns * self.rows], -1)

    def find_equal(self, cells: Numbers) -> tuple[NDArray[np.intp], ...]:
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
