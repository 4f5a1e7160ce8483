"""Compare an output with the sample at every translation, by Fourier transforms.

Kwatra, Schödl, Essa, Turk, Bobick 2003 (Graphcut textures: image and video synthesis using graph cuts), section 4.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
import scipy
from numpy.typing import NDArray

from nrbench.imaging.box_sums import Table, box_sums, box_sums_from, integral_image
from nrbench.imaging.convert import Image

Mask = NDArray[np.bool_]
Features = NDArray[np.int32]
"""``int32 (H, W, F)``: the values of the pixels that are compared. They are integers, so that sums are exact."""
Costs = NDArray[np.float64]
"""``float64 (rows, columns)``: the cost of each place (y, x) of the window's first pixel in the sample."""
_Spectra = NDArray[np.complex128]
_FARTHEST = 746.0
"""exp of less than minus this is 0."""


def to_gray_levels(image: Image, weight: float = 1.0) -> Features:
    """Return an image, times a weight, rounded to integer gray levels, ``int32 (H, W, C)``."""
    return np.ascontiguousarray(np.rint(image.astype(np.float64) * (255 * weight)), np.int32)


@dataclass(frozen=True, eq=False)
class Translations:
    """The translations of a sample that cover a window (sub-patch matching), with the sample's precomputed spectra.

    Parameters
    ----------
    values
        ``int32 (H, W, F)``: the sample, for example its colors and the values of a mask. Sums of squares over it must
        be below 2^47.
    colors
        The number of leading channels that are compared at known pixels only. The others are compared at all pixels.
    """

    values: Features
    colors: int

    def compute_costs(self, window: Features, known: Mask) -> Costs:
        """Return the sum of squared differences between a window and the part of the sample at each place.

        Parameters
        ----------
        window
            ``int32 (h, w, F)``, not larger than the sample.
        known
            ``bool (h, w)``: the pixels at which the leading channels are compared.

        Returns
        -------
        Costs
            ``(H - h + 1, W - w + 1)``, exact.

        Notes
        -----
        The square of the difference is expanded (section 5 of the paper). Fourier transforms compute the products.
        Integral images compute the sums of squares, or transforms if not all pixels are compared. The time is
        O(F H W log(H W)) for windows of any size.
        """
        size, sides = (known.shape[0], known.shape[1]), self.values.shape
        counts = sides[0] - size[0] + 1, sides[1] - size[1] + 1
        seen = window.astype(np.float64)
        seen[~known, : self.colors] = 0
        total = float((seen**2).sum()) + box_sums_from(self._tables[1], size)
        planes, spectra = -2 * seen, self._spectra
        if known.all():
            total, spectra = total + box_sums_from(self._tables[0], size), spectra[:-1]
        else:
            planes = np.concatenate([planes, known[..., np.newaxis]], -1)
        product = np.einsum("chw,chw->hw", spectra, _transform(planes, self._fast_shape))
        return np.asarray(total + _invert(product.conj(), self._fast_shape, counts))

    @cached_property
    def _squares(self) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
        """The squares, summed over the leading channels and over the others."""
        squares = self.values.astype(np.int64) ** 2
        return squares[..., : self.colors].sum(-1), squares[..., self.colors :].sum(-1)

    @cached_property
    def _tables(self) -> tuple[Table, Table]:
        return integral_image(self._squares[0]), integral_image(self._squares[1])

    @cached_property
    def _spectra(self) -> _Spectra:
        """The conjugate spectra of all channels, and last that of the squares of the leading ones."""
        planes = np.concatenate([self.values, self._squares[0][..., np.newaxis]], -1)
        return _transform(planes, self._fast_shape).conj()

    @cached_property
    def _fast_shape(self) -> tuple[int, int]:
        return _find_fast_shape(*self.values.shape[:2])


@dataclass(frozen=True, eq=False)
class EntirePatch:
    """The translations of a whole patch over an output that is only partly known (entire-patch matching).

    Parameters
    ----------
    patch
        ``int32 (H, W, C)``: the whole sample. Sums of squares over it must be below 2^47.
    counts
        (rows, columns): the number of translations that are compared along each axis.
    """

    patch: Features
    counts: tuple[int, int]

    def compute_costs(self, window: Features, known: Mask) -> tuple[Costs, Costs]:
        """Compare the patch with the known pixels that it overlaps, at each translation.

        Parameters
        ----------
        window
            ``int32 (H + rows - 1, W + columns - 1, C)``: the part of the output that the patch can reach.
        known
            ``bool (H + rows - 1, W + columns - 1)``: the known pixels. Those beyond the output's edges are unknown.

        Returns
        -------
        costs
            ``(rows, columns)``, exact: the sums of squared differences, at each position of the patch's first pixel in
            the window. The paper's C(t) is this sum over the area.
        areas
            ``(rows, columns)``: the number of known pixels that the patch overlaps.

        Notes
        -----
        With M = 1 at known pixels, the sum over M (O - I)^2 is that of M O^2, a box sum, minus twice the correlation of
        M O with I, plus the correlation of M with I^2. The time is O(C n log n) for windows of n pixels.
        """
        seen = window * known[..., np.newaxis]
        planes = np.concatenate([-2 * seen, known[..., np.newaxis]], -1)
        product = np.einsum("chw,chw->hw", self._spectra, _transform(planes, self._fast_shape))
        size = self.patch.shape[0], self.patch.shape[1]
        energy = box_sums((seen.astype(np.int64) ** 2).sum(-1), size)
        return np.asarray(energy + _invert(product, self._fast_shape, self.counts)), box_sums(known, size)

    @cached_property
    def _spectra(self) -> _Spectra:
        """The conjugate spectra of the patch's channels, and last that of its squares, summed over channels."""
        squares = (self.patch.astype(np.int64) ** 2).sum(-1, keepdims=True)
        return _transform(np.concatenate([self.patch, squares], -1), self._fast_shape).conj()

    @cached_property
    def _fast_shape(self) -> tuple[int, int]:
        return _find_fast_shape(*(side + n - 1 for side, n in zip(self.patch.shape, self.counts, strict=False)))


def _transform(pixels: NDArray[Any], shape: tuple[int, int]) -> _Spectra:
    """Return the spectra ``(C, rows, columns)`` of ``(h, w, C)``, padded with zeros to a shape."""
    planes = np.ascontiguousarray(np.moveaxis(pixels, -1, 0), np.float64)
    return np.asarray(scipy.fft.fft(scipy.fft.rfft(planes, shape[1], axis=2), shape[0], axis=1))


def _invert(product: _Spectra, shape: tuple[int, int], counts: tuple[int, int]) -> Costs:
    """Return the first ``counts`` rows and columns of a real picture, whole numbers, from its spectrum."""
    lines = scipy.fft.ifft(product, axis=0)[: counts[0]]
    return np.rint(scipy.fft.irfft(lines, shape[1], axis=1)[:, : counts[1]])


def _find_fast_shape(height: int, width: int) -> tuple[int, int]:
    return scipy.fft.next_fast_len(height, real=True), scipy.fft.next_fast_len(width, real=True)


def draw_translation(costs: Costs, scale: float, rng: np.random.Generator) -> tuple[int, int]:
    """Draw a place, (x, y) px, with a probability proportional to exp(-cost / scale).

    Parameters
    ----------
    costs
        Costs of the places, for example from :meth:`Translations.compute_costs`. Places of infinite cost are never
        drawn; at least one cost is finite.
    scale
        The paper's k sigma^2 (section 4) in the unit of the costs: times the number of the window's pixels if the costs
        are sums. 0: one of the places of least cost is drawn.
    rng
        The generator; one number is drawn from it.
    """
    above = costs - costs.min()
    near = np.flatnonzero(above <= _FARTHEST * scale)  # the weights of all others are 0
    weights = np.exp(-above.ravel()[near] / scale) if scale > 0 else np.ones(len(near))
    cumulative = np.cumsum(weights)
    index = int(np.searchsorted(cumulative, rng.random() * cumulative[-1], "right"))
    y, x = divmod(int(near[min(index, len(near) - 1)]), costs.shape[1])
    return x, y
