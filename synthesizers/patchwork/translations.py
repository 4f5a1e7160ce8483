"""Compare an output with the sample at every translation, by Fourier transforms.

Kwatra, Schödl, Essa, Turk, Bobick 2003 (Graphcut textures: image and video synthesis using graph cuts), section 4.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cached_property, lru_cache
from typing import Any, NamedTuple

import numpy as np
import scipy
from numpy.typing import NDArray

from nrbench.imaging.box_sums import box_sums, box_sums_from, integral_image
from nrbench.imaging.convert import Image

from ..seams.minimum_cut import Mask

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


class Layer(NamedTuple):
    """A group of channels of a window, and the pixels at which they are compared.

    Parameters
    ----------
    values
        ``int32 (h, w, C)``.
    known
        ``bool (h, w)``: the pixels that are compared. None: all.
    """

    values: Features
    known: Mask | None = None


@dataclass(frozen=True, eq=False)
class Translations:
    """The translations of a sample that cover a window (sub-patch matching), with the sample's precomputed spectra.

    Parameters
    ----------
    layers
        Groups of the sample's channels, ``int32 (H, W, C)`` each, for example its colors and the values of a mask. Each
        group has its own set of compared pixels. Sums of squares over the sample must be below 2^47.
    """

    layers: tuple[Features, ...]

    def compute_costs(self, window: Sequence[Layer]) -> Costs:
        """Return the sum of squared differences between a window and the part of the sample at each place.

        Parameters
        ----------
        window
            One layer for each of the sample's, all ``(h, w)``, not larger than the sample.

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
        height, width = window[0].values.shape[:2]
        rows, columns = self.layers[0].shape[0] - height + 1, self.layers[0].shape[1] - width + 1
        planes, total = [], np.zeros((rows, columns))
        for number, layer in enumerate(window):
            values = np.moveaxis(layer.values, -1, 0).astype(np.float64)
            if layer.known is None:
                total += self._box_sums(number, (height, width))
            else:
                values *= layer.known
                planes.append(layer.known[np.newaxis].astype(np.float64))
            total += float((values**2).sum())
            planes.append(-2 * values)
        spectra = self._stacked(tuple(layer.known is not None for layer in window))
        product = np.einsum("chw,chw->hw", spectra, _transform_planes(np.concatenate(planes), self._fast_shape))
        products = scipy.fft.irfft(scipy.fft.ifft(product.conj(), axis=0)[:rows], self._fast_shape[1], axis=1)
        return np.asarray(total + np.rint(products[:, :columns]))

    @cached_property
    def _stacked(self) -> Callable[[tuple[bool, ...]], _Spectra]:
        """The conjugate spectra of all layers; of each whose flag is set, first that of its summed squares."""
        return lru_cache(1 << len(self.layers))(self._stack)

    def _stack(self, masked: tuple[bool, ...]) -> _Spectra:
        planes = []
        for layer, with_squares in zip(self.layers, masked, strict=True):
            planes += [(layer.astype(np.int64) ** 2).sum(-1)[np.newaxis]] if with_squares else []
            planes.append(np.moveaxis(layer, -1, 0))
        return _transform_planes(np.concatenate(planes), self._fast_shape).conj()

    @cached_property
    def _box_sums(self) -> Callable[[int, tuple[int, int]], Costs]:
        """The sums of a layer's squares over all boxes of a size; those of the latest sizes are kept."""
        return lru_cache(2 * len(self.layers))(self._sum_boxes)

    def _sum_boxes(self, number: int, size: tuple[int, int]) -> Costs:
        return box_sums_from(self._tables[number], size)

    @cached_property
    def _tables(self) -> list[Costs]:
        """The integral image of each layer's squares."""
        return [integral_image((layer.astype(np.int64) ** 2).sum(-1)) for layer in self.layers]

    @cached_property
    def _fast_shape(self) -> tuple[int, int]:
        return _fast_shape(*self.layers[0].shape[:2])


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

    def compute_costs(self, window: Layer) -> tuple[Costs, Costs]:
        """Compare the patch with the known pixels that it overlaps, at each translation.

        Parameters
        ----------
        window
            ``(H + rows - 1, W + columns - 1)``: the part of the output that the patch can reach. Pixels beyond the
            output's edges are unknown.

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
        known = np.ones(window.values.shape[:2], np.bool_) if window.known is None else window.known
        values = window.values * known[..., np.newaxis]
        size = self.patch.shape[0], self.patch.shape[1]
        spectra, squares = self._prepared
        product = np.einsum("chw,chw->hw", spectra, _transform(-2 * values, self._fast_shape))
        product += squares * _transform(known[..., np.newaxis], self._fast_shape)[0]
        rows, columns = self.counts
        products = scipy.fft.irfft(scipy.fft.ifft(product, axis=0)[:rows], self._fast_shape[1], axis=1)[:, :columns]
        energy = box_sums((values.astype(np.int64) ** 2).sum(-1), size)
        return np.asarray(energy + np.rint(products)), box_sums(known, size)

    @cached_property
    def _prepared(self) -> tuple[_Spectra, _Spectra]:
        """The conjugate spectra of the patch's channels and of its squares, summed over channels."""
        squares = (self.patch.astype(np.int64) ** 2).sum(-1, keepdims=True)
        shape = self._fast_shape
        return _transform(self.patch, shape).conj(), _transform(squares, shape)[0].conj()

    @cached_property
    def _fast_shape(self) -> tuple[int, int]:
        return _fast_shape(*(side + n - 1 for side, n in zip(self.patch.shape, self.counts, strict=False)))


def _transform(pixels: NDArray[Any], shape: tuple[int, int]) -> _Spectra:
    """Return the spectra ``(C, rows, columns)`` of ``(h, w, C)``, padded with zeros to a shape."""
    return _transform_planes(np.moveaxis(pixels, -1, 0), shape)


def _transform_planes(planes: NDArray[Any], shape: tuple[int, int]) -> _Spectra:
    """Return the spectra ``(C, rows, columns)`` of planes ``(C, h, w)``, padded with zeros to a shape."""
    lines = scipy.fft.rfft(planes.astype(np.float64, copy=False), shape[1], axis=2)
    return np.asarray(scipy.fft.fft(lines, shape[0], axis=1))


def _fast_shape(height: int, width: int) -> tuple[int, int]:
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
