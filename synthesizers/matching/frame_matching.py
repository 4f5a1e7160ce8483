"""Find where a patch agrees best with what surrounds it: at whole pixels, between pixels, and deformed.

:class:`FrameMatcher` compares 8-bit whole numbers, so that its sums are exact: direct summation and the Fourier domain
give the same bits, and equally good places tie. It is our own for that reason, and for speed: the masked
cross-correlation of scikit-image takes 16 times as long for a frame of 40 x 40 px in 128 x 128 px of three channels,
OpenCV's masked ``matchTemplate`` sums in float32, and both compute every place, where the few near a lattice suffice.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import cached_property
from typing import Any, Final, Literal

import numpy as np
import scipy
from numpy.typing import NDArray

from nrbench.imaging.convert import Image, box_sums_from, integral_image, to_bytes
from nrbench.lattice.geometry import Points

from ..canvas.canvas import Box
from ..lattice_places.equal_places import search_shape
from .matching_kernels import correlate_at

Match = Literal["ncc", "color"]
Array = NDArray[np.float64]
Spectra = NDArray[np.complex128]
"""``(C, rows, columns)``: the spectra of some planes, padded with zeros."""
DAMPING: Final = 1e-4
"""Added to the mean squared gradient, in squared values (0 to 1) per px: noise of a gray level moves nothing."""
WAVES: Final = 4
"""Cosines along each side of a deformed patch: the shortest has half a period on a third of the side."""
DEFORMATION_STEPS: Final = 5
"""Gauss-Newton steps."""


class FourierProducts:
    """Correlates images with templates; the sums of products are exact for whole numbers.

    Parameters
    ----------
    shape
        Shape (height, width, ...) of the largest image.
    """

    def __init__(self, shape: tuple[int, ...]) -> None:
        self._shape = tuple(scipy.fft.next_fast_len(side, real=True) for side in shape[:2])

    def transform(self, planes: NDArray[Any]) -> Spectra:
        """Return the spectra of planes ``(C, h, w)``."""
        lines = scipy.fft.rfft(np.ascontiguousarray(planes, np.float64), self._shape[1], axis=2)
        return np.asarray(scipy.fft.fft(lines, self._shape[0], axis=1))

    def correlate(self, image: Spectra, template: Spectra, counts: tuple[int, int]) -> NDArray[np.float64]:
        """Return the sum of products of a template and the image under it at the first ``counts`` rows and columns.

        Rows are transformed before they are padded below, and after the columns are cut, which saves time. The result
        is rounded to whole numbers.
        """
        product = np.einsum("chw,chw->hw", image, template.conj())
        lines = scipy.fft.ifft(product, axis=0)[: counts[0]]
        return np.rint(scipy.fft.irfft(lines, self._shape[1], axis=1)[:, : counts[1]])


class FrameMatcher:
    """Rates every place of an image against a square frame, which is a template without a rectangular hole.

    Parameters
    ----------
    image
        ``(H, W, C)``. Its pixels count as the 8-bit values that they round to.
    size
        Side of the template in px.
    match
        ``"ncc"``: generalized normalized cross-correlation with channels weighted by their standard deviations (RSGF,
        eqs. 4 and 6 to 8), 0 if a standard deviation is 0. ``"color"``: negated sum of squared color differences
        (RSGF, eq. 10).

    Attributes
    ----------
    search_shape
        Rows and columns of places at which the template lies inside the image.
    """

    def __init__(self, image: Image, size: int, match: Match = "color") -> None:
        self.values = to_bytes(image).astype(np.float32)
        self.size, self.match = size, match
        self.search_shape = search_shape(size, (image.shape[0], image.shape[1]))
        self._frame_statistics: dict[Box, tuple[Array, Array]] = {}

    def rate(self, template: NDArray[np.float32], hole: Box, positions: NDArray[np.int64]) -> Array:
        """Rate some places, by direct summation.

        Parameters
        ----------
        template
            ``(size, size, C)``: whole numbers from 0 to 255.
        hole
            The part of the template that does not count.
        positions
            ``(n, 2)``: (x, y) of the template's first pixel, within :attr:`search_shape`.

        Returns
        -------
        Array
            ``(n,)``: higher is better.
        """
        products = correlate_at(self.values, np.ascontiguousarray(template), hole, np.ascontiguousarray(positions))
        totals = [self._frame_sums(table, hole, positions) for table in self._integrals]
        return self._ratings(products, *self._summary(totals[0], totals[-1], self._count(hole)), template, hole)

    def rate_everywhere(self, template: NDArray[np.float32], hole: Box) -> Array:
        """Rate every place, in the Fourier domain: an array of :attr:`search_shape`. Parameters as in :meth:`rate`."""
        frame = np.where(frame_mask(hole, self.size)[..., np.newaxis], template, 0)
        return self._ratings(self.correlate_everywhere(frame), *self._statistics(hole), template, hole)

    def correlate_everywhere(self, template: NDArray[Any]) -> Array:
        """Return the sum of products of a template and the image under it at every place, in the Fourier domain.

        Parameters
        ----------
        template
            ``(h, w, C)``, at most ``size`` px a side: whole numbers, so small that sums stay below 2^47.

        Returns
        -------
        Array
            Of :attr:`search_shape`, exact.
        """
        spectra = self._products.transform(np.moveaxis(template, -1, 0))
        return self._products.correlate(self._spectra, spectra, self.search_shape)

    def _ratings(self, products: Array, sums: Array, spread: Array, template: NDArray[np.float32], hole: Box) -> Array:
        """Compute ratings from sums of products ``(...)``: equation 10 expanded, or equation 4."""
        values = template[frame_mask(hole, self.size)].astype(np.float64)
        own_sums, own_spread = self._summary(values.sum(0), (values**2).sum(0), len(values))
        if self.match == "color":
            return np.asarray(2 * products - spread - own_spread)
        covariance, both = len(values) * products - sums @ own_sums, spread @ own_spread
        return np.asarray(np.divide(covariance, both, out=np.zeros_like(covariance), where=both > 0))

    def _summary(self, sums: Array, squares: Array, n: int) -> tuple[Array, Array]:
        """Return the sums, and what the match needs of the squares: their total, or n standard deviations."""
        if self.match == "color":
            return sums, np.asarray(squares.sum(-1))
        return sums, np.sqrt(np.maximum(n * squares - sums**2, 0))

    @cached_property
    def _products(self) -> FourierProducts:
        return FourierProducts(self.values.shape)

    @cached_property
    def _spectra(self) -> Spectra:
        return self._products.transform(np.moveaxis(self.values, -1, 0))

    @cached_property
    def _integrals(self) -> tuple[Array, ...]:
        """Integral images of what the match needs: the squares of all channels together, or values and squares."""
        if self.match == "color":
            return (integral_image(np.einsum("hwc,hwc->hw", self.values, self.values)[..., np.newaxis]),)
        values = self.values.astype(np.float64)
        return integral_image(values), integral_image(values**2)

    def _statistics(self, hole: Box) -> tuple[Array, Array]:
        """Return the summary of what lies under the frame at every place: sums over the square less over the hole."""
        if hole not in self._frame_statistics:
            totals = [self._frame_sums(table, hole) for table in self._integrals]
            self._frame_statistics[hole] = self._summary(totals[0], totals[-1], self._count(hole))
        return self._frame_statistics[hole]

    def _count(self, hole: Box) -> int:
        return int(frame_mask(hole, self.size).sum())

    def _frame_sums(self, table: Array, hole: Box, positions: NDArray[np.int64] | None = None) -> Array:
        """Return the sums over the frame at some places, or at every place."""
        square, cut = (0, self.size, 0, self.size), hole
        if positions is None:
            return self._box_sums(table, square) - self._box_sums(table, cut)
        x, y = positions.T
        parts = [
            table[y + y1, x + x1] - table[y + y0, x + x1] - table[y + y1, x + x0] + table[y + y0, x + x0]
            for y0, y1, x0, x1 in (square, cut)
        ]
        return np.asarray(parts[0] - parts[1])

    def _box_sums(self, table: Array, box: Box) -> Array:
        rows, columns = self.search_shape
        y0, y1, x0, x1 = box
        return box_sums_from(table[y0 : y1 + rows, x0 : x1 + columns], (y1 - y0, x1 - x0))


def frame_mask(hole: Box, size: int) -> NDArray[np.bool_]:
    """Return the pixels of a square of ``size`` px that are not in a hole, ``bool (size, size)``."""
    frame = np.ones((size, size), bool)
    frame[hole[0] : hole[1], hole[2] : hole[3]] = False
    return frame


def align_patch(cut: Callable[[Points], Image], place: Points, old: Image, weight: Array) -> Points:
    """Move a place by at most half a pixel along x and along y, so that its patch agrees better with its surroundings.

    This is one step of Lucas and Kanade (1981), the least-squares solution of ``gradient . move = old - new``, so that
    nothing moves where both pictures agree.

    Parameters
    ----------
    cut
        Returns the patch at a place (x, y): ``(h, w, C)``.
    place
        The start, at most about a pixel away.
    old
        ``(h, w, C)``: the surroundings.
    weight
        ``(h, w)``, not negative: 0 where the surroundings are not known.

    Returns
    -------
    Points
        (x, y).
    """
    new = cut(place)
    y, x = (np.asarray(part, np.float64) for part in np.gradient(new, axis=(0, 1)))
    difference = (old - new).astype(np.float64)
    total = max(float(weight.sum()), 1e-12)
    xx, xy, yy, ex, ey = (
        float((weight * np.einsum("ijk,ijk->ij", *pair)).sum()) / total
        for pair in ((x, x), (x, y), (y, y), (x, difference), (y, difference))
    )
    matrix = np.array([[xx + DAMPING, xy], [xy, yy + DAMPING]])
    return np.asarray(place + np.clip(np.linalg.solve(matrix, [ex, ey]), -0.5, 0.5))


def fit_deformation(read: Callable[[Array], Image], old: Image, weight: Array, limit: float) -> Array:
    """Compute the smooth displacements with which a patch agrees best with its surroundings.

    The displacements along x and along y are sums of the :data:`WAVES` x :data:`WAVES` lowest cosines over the patch,
    so that what fits the surroundings continues smoothly into the rest. Gauss-Newton steps minimize the weighted mean
    of the squared differences, plus a penalty on steep displacements. The displacement of a pixel is then shortened to
    the limit.

    Parameters
    ----------
    read
        Returns the patch under a displacement (x, y) px of each pixel, ``(h, w, 2)``: ``(h, w, C)``.
    old, weight
        ``(h, w, C)`` and ``(h, w)``, as in :func:`align_patch`.
    limit
        Largest displacement, px.

    Returns
    -------
    Array
        ``(h, w, 2)``: (x, y) px.
    """
    down, across = (scipy.fft.idct(np.eye(WAVES, side), axis=1, norm="ortho") * side**0.5 for side in weight.shape)
    basis = np.einsum("ih,jw->ijhw", down, across).reshape(WAVES**2, -1)
    order = np.arange(WAVES) ** 2
    penalty = DAMPING * np.tile((1 + np.add.outer(order, order)).ravel(), 2)
    share = (weight / max(weight.sum(), 1e-12)).ravel()
    amounts, field = np.zeros(2 * WAVES**2), np.zeros((*weight.shape, 2))
    for _ in range(DEFORMATION_STEPS):
        new = read(field)
        slopes = np.array(np.gradient(new.astype(np.float64), axis=(1, 0)))
        tensor = np.einsum("ahwc,bhwc->abhw", slopes, slopes).reshape(2, 2, -1) * share
        pull = np.einsum("ahwc,hwc->ahw", slopes, old - new).reshape(2, -1) * share
        matrix = np.block([[(basis * tensor[a, b]) @ basis.T for b in (0, 1)] for a in (0, 1)])
        amounts += np.linalg.solve(matrix + np.diag(penalty), (pull @ basis.T).ravel() - penalty * amounts)
        field = np.moveaxis((amounts.reshape(2, -1) @ basis).reshape(2, *weight.shape), 0, -1)
        field *= np.minimum(1, limit / np.maximum(np.hypot(*np.moveaxis(field, -1, 0)), 1e-12))[..., np.newaxis]
    return field
