"""Where in an image a frame (a border around a hole) fits best.

Everything is computed on whole numbers (8-bit pixels), so that the sums are exact: the direct and the Fourier way agree
to the last bit, and equally good positions tie exactly.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import Literal

import numpy as np
from numpy.typing import NDArray
from scipy import fft

from nrbench.imaging.box_sums import boxes_of, integral
from nrbench.imaging.convert import Image, to_bytes

from .matching_kernels import LONGEST_RUN, correlate_at

Match = Literal["ncc", "color"]
Hole = tuple[int, int, int, int]
"""(y0, y1, x0, x1), half-open: the rows and columns of a template that do not count."""
Array = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class FrameMatcher:
    """Rates every place of an image against a square frame.

    Parameters
    ----------
    image
        Where to look; its pixels count as the 8-bit values that they round to.
    size
        Side of the square template in px.
    match
        ``"ncc"``: generalized normalized cross-correlation, the channels weighted by their standard deviations (RSGF,
        eqs. 4 and 6 to 8), 0 where a standard deviation is 0; ``"color"``: negated sum of squared color differences
        (RSGF, eq. 10).
    """

    image: Image
    size: int
    match: Match = "color"

    @cached_property
    def values(self) -> NDArray[np.float32]:
        """The image as whole numbers from 0 to 255."""
        return to_bytes(self.image).astype(np.float32)

    @property
    def room(self) -> tuple[int, int]:
        """Rows and columns of places where the template lies wholly inside."""
        return self.values.shape[0] - self.size + 1, self.values.shape[1] - self.size + 1

    def at(self, template: NDArray[np.float32], hole: Hole, positions: NDArray[np.int64]) -> Array:
        """Rate some places, by direct summation.

        Parameters
        ----------
        template
            ``(size, size, C)`` of whole numbers from 0 to 255.
        hole
            The part of it that does not count.
        positions
            ``(n, 2)``: (x, y) of the template's first pixel, within :attr:`room`.

        Returns
        -------
        Array
            ``(n,)``: the higher, the better.
        """
        channels = template.shape[2]
        products = correlate_at(
            self.values.reshape(len(self.values), -1),
            np.ascontiguousarray(template).reshape(self.size, -1),
            self._runs(hole, channels),
            np.ascontiguousarray(positions * (channels, 1)),
        )
        sums, spread = (table[positions[:, 1], positions[:, 0]] for table in self._statistics(hole))
        return self._rate(products, sums, spread, template, hole)

    def everywhere(self, template: NDArray[np.float32], hole: Hole) -> Array:
        """Rate every place, in the Fourier domain: an array of shape :attr:`room`; parameters as in :meth:`at`."""
        framed = np.where(_outside(hole, self.size)[..., np.newaxis], template, 0).astype(np.float64)
        spectrum = fft.rfft2(framed, self._fast_shape, axes=(0, 1)).conj()
        products = fft.irfft2((self._spectrum * spectrum).sum(-1), self._fast_shape)
        rows, columns = self.room
        return self._rate(np.rint(products[:rows, :columns]), *self._statistics(hole), template, hole)

    def _rate(self, products: Array, sums: Array, spread: Array, template: NDArray[np.float32], hole: Hole) -> Array:
        """Make ratings of sums of products ``(...)``: equation 10 multiplied out, or equation 4."""
        inside = template[_outside(hole, self.size)].astype(np.float64)
        own, own_spread = self._summary(inside.sum(0), (inside**2).sum(0), len(inside))
        if self.match == "color":
            return np.asarray(2 * products - spread - own_spread)
        covariance, both = len(inside) * products - sums @ own, spread @ own_spread
        return np.asarray(np.divide(covariance, both, out=np.zeros_like(covariance), where=both > 0))

    def _summary(self, sums: Array, squares: Array, n: int) -> tuple[Array, Array]:
        """Return the sums, and what the match needs of the squares: their total, or n standard deviations."""
        if self.match == "color":
            return sums, np.asarray(squares.sum(-1))
        return sums, np.sqrt(np.maximum(n * squares - sums**2, 0))

    @cached_property
    def _fast_shape(self) -> tuple[int, int]:
        height, width, _ = self.values.shape
        return fft.next_fast_len(height, real=True), fft.next_fast_len(width, real=True)

    @cached_property
    def _spectrum(self) -> NDArray[np.complex128]:
        return np.asarray(fft.rfft2(self.values.astype(np.float64), self._fast_shape, axes=(0, 1)))

    @cached_property
    def _integrals(self) -> tuple[Array, Array]:
        values = self.values.astype(np.float64)
        return integral(values), integral(values**2)

    @cached_property
    def _known(self) -> dict[Hole, tuple[Array, Array]]:
        return {}

    def _statistics(self, hole: Hole) -> tuple[Array, Array]:
        """Return the summary of what lies under the frame at every place: sums over the square less over the hole."""
        if hole not in self._known:
            square = (0, self.size, 0, self.size)
            sums, squares = (self._box(table, square) - self._box(table, hole) for table in self._integrals)
            self._known[hole] = self._summary(sums, squares, int(_outside(hole, self.size).sum()))
        return self._known[hole]

    def _box(self, table: Array, box: Hole) -> Array:
        rows, columns = self.room
        y0, y1, x0, x1 = box
        under = table[y0 : y1 + rows, x0 : x1 + columns]
        return boxes_of(under, (y1 - y0, x1 - x0))

    def _runs(self, hole: Hole, channels: int) -> NDArray[np.int64]:
        """Return the template's rows less the hole, cut to what the kernel sums exactly."""
        y0, y1, x0, x1 = hole
        whole, beside = [(0, self.size)], [(0, x0), (x1, self.size)]
        return np.array(
            [
                (row, start, min(start + LONGEST_RUN, stop * channels))
                for row in range(self.size)
                for first, stop in (beside if y0 <= row < y1 else whole)
                for start in range(first * channels, stop * channels, LONGEST_RUN)
            ],
            np.int64,
        ).reshape(-1, 3)


def _outside(hole: Hole, size: int) -> NDArray[np.bool_]:
    frame = np.ones((size, size), bool)
    frame[hole[0] : hole[1], hole[2] : hole[3]] = False
    return frame
