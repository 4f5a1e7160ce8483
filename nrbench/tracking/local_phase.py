"""Local harmonics: a lattice's Fourier coefficients, taken under a window around every node of a coarse grid."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np
import scipy.fft
from numpy.typing import NDArray

from nrbench.imaging.fold import Values
from nrbench.lattice.geometry import Lattice, Points

Coefficients = NDArray[np.complex64]
"""``(K, C, rows, columns)``: of K harmonics and C channels at the nodes."""
_ORDERS = 7
_HIGHEST = 0.4
"""Cycles/px above which harmonics are left out: rounding and interpolation spoil them."""
_REACH = 3.0
_NODES_A_TILE = 2.0


@dataclass(frozen=True)
class Harmonics:
    """Some of the frequencies that a texture of a lattice can have: one of each pair +-f.

    Parameters
    ----------
    lattice
        Reduced.
    numbers
        ``(K, 2)``: whole numbers m of each, f . t_i = m_i.
    """

    lattice: Lattice
    numbers: NDArray[np.int64]

    @classmethod
    def of(cls, lattice: Lattice) -> Harmonics:
        """Return those of low order, up to 0.4 cycles/px."""
        side = np.arange(-_ORDERS, _ORDERS + 1)
        numbers = np.stack(np.meshgrid(side, side, indexing="ij"), -1).reshape(-1, 2)
        numbers = numbers[(numbers[:, 0] > 0) | ((numbers[:, 0] == 0) & (numbers[:, 1] > 0))]
        every = cls(lattice, numbers)
        return cls(lattice, numbers[np.hypot(*every.frequencies.T) <= _HIGHEST])

    @property
    def frequencies(self) -> Points:
        """``(K, 2)``: (f_x, f_y) in cycles/px."""
        return np.asarray(self.numbers @ np.linalg.inv(self.lattice.matrix).T)

    def take(self, index: NDArray[np.intp]) -> Harmonics:
        """Return some of them."""
        return Harmonics(self.lattice, self.numbers[index])


@dataclass(frozen=True)
class Nodes:
    """The grid on which local harmonics are taken, and the window around each node.

    Parameters
    ----------
    shape
        Of the image, px.
    covariance
        2 x 2, px^2: of the Gaussian window.
    counts
        Rows and columns of nodes on the padded image.
    padded
        Its height and width, px: no window wraps round onto the image.
    tiles
        Width of the window in tiles.
    """

    shape: tuple[int, int]
    covariance: Points
    counts: tuple[int, int]
    padded: tuple[int, int]
    tiles: float

    @classmethod
    def of(cls, lattice: Lattice, shape: tuple[int, int], tiles: float) -> Nodes:
        """Return nodes half a tile apart, the windows as broad as a flat window of so many ``tiles``."""
        cell = cell_covariance(lattice)
        covariance = tiles**2 * cell
        spread, box = np.sqrt(np.diag(covariance))[::-1], np.sqrt(12 * np.diag(cell))[::-1]
        padded = [scipy.fft.next_fast_len(math.ceil(n + _REACH * one)) for n, one in zip(shape, spread, strict=True)]
        step = np.minimum(box / _NODES_A_TILE, np.array(shape) / 3)
        rows, columns = (scipy.fft.next_fast_len(math.ceil(n / one)) for n, one in zip(padded, step, strict=True))
        return cls(shape, covariance, (rows, columns), (padded[0], padded[1]), tiles)

    def narrowed(self, tiles: float) -> Nodes:
        """Return the same nodes with windows of another width, no broader than before."""
        return replace(self, covariance=self.covariance * (tiles / self.tiles) ** 2, tiles=tiles)

    @property
    def y(self) -> NDArray[np.float64]:
        """Rows, px, of the nodes inside the image."""
        return self._along(0)

    @property
    def x(self) -> NDArray[np.float64]:
        """Columns, px, of the nodes inside the image."""
        return self._along(1)

    @property
    def places(self) -> Points:
        """``(rows, columns, 2)``: (x, y) px of the nodes inside the image."""
        x, y = np.meshgrid(self.x, self.y)
        return np.stack([x, y], -1)

    def _along(self, axis: int) -> NDArray[np.float64]:
        at = np.arange(self.counts[axis]) * (self.padded[axis] / self.counts[axis])
        return np.asarray(at[at <= self.shape[axis] - 1])

    def coefficients(self, planes: Values, frequencies: Points) -> Coefficients:
        """Return the mean of each plane times exp(-2 pi i f . (x, y)) under the window around each node.

        One transform of the planes; of it, for each frequency, only the band that the window passes is turned back, on
        the coarse grid: time grows with pixels and with frequencies, not with their product.

        Parameters
        ----------
        planes
            ``(H, W, C)``; outside they count as 0.
        frequencies
            ``(K, 2)``: (f_x, f_y) cycles/px.
        """
        spectrum = scipy.fft.fft2(np.moveaxis(planes, -1, 0), self.padded)
        bins = frequencies[:, ::-1] * self.padded
        nearest = np.rint(bins).astype(np.int64)
        offsets = [np.rint(scipy.fft.fftfreq(n, 1 / n)).astype(np.int64) for n in self.counts]
        rows, columns = (nearest[:, [axis]] + offsets[axis] for axis in (0, 1))
        dy = (rows - bins[:, :1]) / self.padded[0]
        dx = (columns - bins[:, 1:]) / self.padded[1]
        (xx, xy), (_, yy) = self.covariance
        power = xx * dx[:, np.newaxis] ** 2 + 2 * xy * dx[:, np.newaxis] * dy[..., np.newaxis]
        power = power + yy * dy[..., np.newaxis] ** 2
        gain = (math.prod(self.counts) / math.prod(self.padded) * np.exp(-2 * math.pi**2 * power)).astype(np.float32)
        at = rows[..., np.newaxis] % self.padded[0], columns[:, np.newaxis] % self.padded[1]
        bands = scipy.fft.ifft2(np.moveaxis(spectrum[:, *at], 0, 1) * gain[:, np.newaxis])
        bands = bands[..., : len(self.y), : len(self.x)]
        rest = 2j * math.pi * (nearest - bins) / self.padded
        turn = np.exp(rest[:, :1] * self.y)[..., np.newaxis] * np.exp(rest[:, 1:] * self.x)[:, np.newaxis]
        return np.asarray(bands * turn[:, np.newaxis].astype(np.complex64))


def cell_covariance(lattice: Lattice) -> Points:
    """Return the covariance, 2 x 2 px^2, of points spread evenly over the lattice's Voronoi cell.

    Unlike the parallelogram's it depends on the lattice alone, not on its basis.
    """
    side = (np.arange(24) + 0.5) / 24
    uv = np.stack(np.meshgrid(side, side), -1).reshape(-1, 2)
    points = lattice.wrap(uv @ lattice.matrix)
    return np.asarray(points.T @ points / len(points))
