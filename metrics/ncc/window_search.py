"""Find windows of an image in a patch of the periodic image by weighted normalized cross-correlation (NCC)."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass, field
from functools import cached_property

import numpy as np
import scipy.fft
from numpy.lib.stride_tricks import sliding_window_view
from numpy.typing import NDArray
from scipy import ndimage

from nrbench.imaging.box_sums import box_sums
from nrbench.imaging.convert import subtract_color
from nrbench.imaging.mean_tile import Values
from nrbench.imaging.subpixel import find_vertex

from .ncc_kernels import compute_ncc, normalize_sums

_FAINT, _MINOR = 1e-5, 0.01
"""Shares of the largest variance along an axis of color. An axis with less than the first share counts as constant. An
axis with less than the second share is ignored in the search for the best offset."""


@dataclass(frozen=True)
class Colors:
    """Orthonormal axes of color, in order of decreasing variance of a periodic image.

    Parameters
    ----------
    mean
        ``(C,)``: the color whose coordinates are zero.
    axes
        ``(C, C)``: the axes as columns.
    varies
        Number of axes along which the periodic image varies: one if tiles and joints have one color each.
    main
        Number of axes along which it varies much; the search uses only these.
    """

    mean: NDArray[np.float32]
    axes: NDArray[np.float32]
    varies: int
    main: int

    @classmethod
    def of(cls, image: Values) -> Colors:
        """Return the axes of a periodic image ``(H, W, C)`` that shows every place of a cell."""
        pixels = image.reshape(-1, image.shape[-1]).astype(np.float64)
        mean = pixels.mean(0)
        variance, axes = np.linalg.eigh((pixels - mean).T @ (pixels - mean))
        varies, main = (max(int((variance > share * variance[-1]).sum()), 1) for share in (_FAINT, _MINOR))
        return cls(mean.astype(np.float32), np.ascontiguousarray(axes[:, ::-1], np.float32), varies, main)

    def project(self, image: Values) -> Values:
        """Return the coordinates of an image's colors along the axes, ``(H, W, C)``."""
        pixels = subtract_color(np.ascontiguousarray(image), self.mean).reshape(-1, image.shape[-1])
        return np.asarray((pixels @ self.axes).reshape(image.shape), np.float32)

    def planes(self, image: Values) -> Planes:
        """Return the coordinates of an image's colors along the axes, as planes."""
        return Planes(np.ascontiguousarray(np.moveaxis(self.project(image), -1, 0)))


@dataclass(frozen=True)
class Planes:
    """The planes of an image along axes of color.

    Parameters
    ----------
    values
        ``(C, H, W)``.
    """

    values: Map
    _kept: dict[tuple[int, int], Map] = field(default_factory=dict, init=False, repr=False, compare=False)

    def smooth(self, size: int, first: int) -> Map:
        """Return running means of the planes and of the sum of their squares, ``(C + 1, ...)``.

        Parameters
        ----------
        size
            Each value is the mean over ``size`` x ``size`` pixels, of which its own pixel is the first.
        first
            Width of the running mean that is taken before the squares, at most ``size``.
        """
        if (size, first) not in self._kept:
            values = smooth_planes(self.values, first)
            squares = np.einsum("chw,chw->hw", values, values)[np.newaxis]
            self._kept[size, first] = smooth_planes(np.concatenate([values, squares]), size - first + 1)
        return self._kept[size, first]


def smooth_planes(planes: Map, size: int) -> Map:
    """Return for each pixel the mean over the ``size`` x ``size`` pixels of which it is the first, ``(..., H, W)``."""
    for _ in range(2 if size > 1 else 0):
        length = planes.shape[-1] - size + 1
        parts = [planes[..., k : k + length] for k in range(size)]
        planes = np.swapaxes(np.sum(parts, 0) / np.float32(size), -1, -2)
    return np.ascontiguousarray(planes, np.float32)


def cut_planes(planes: Map, corners: NDArray[np.intp], window: tuple[int, int], step: int = 1) -> Map:
    """Cut windows out of planes.

    Parameters
    ----------
    planes
        ``(C, H, W)``.
    corners
        ``(n, 2)``: (x, y) of the first pixel of each window.
    window
        Height and width of the windows.
    step
        Distance between the pixels that are taken, along both axes. Use it with running means of the same size.

    Returns
    -------
    Map
        ``(n, C, h, w)`` with ``h = height // step`` and ``w = width // step``.
    """
    spans = [(side // step - 1) * step + 1 for side in window]
    views = sliding_window_view(planes, spans, axis=(1, 2))[..., ::step, ::step]
    return np.ascontiguousarray(np.moveaxis(views, 0, 2)[corners[:, 1], corners[:, 0]])


Map = NDArray[np.float32]
_BATCH_PIXELS = 1 << 21


@dataclass(frozen=True)
class Template:
    """A patch of the periodic image with which windows of one shape are correlated.

    Parameters
    ----------
    image
        ``(TH, TW, C)``, larger than the window by the range of displacements that is searched.
    weights
        ``(TH, TW)``: weight of each pixel of the template, not negative.
    window
        Height and width of the windows.
    """

    image: Values
    weights: Map
    window: tuple[int, int]

    @cached_property
    def _size(self) -> tuple[int, int]:
        height, width = self.weights.shape
        return scipy.fft.next_fast_len(height, True), scipy.fft.next_fast_len(width, True)

    @cached_property
    def mean(self) -> NDArray[np.float32]:
        """Weighted mean of each channel."""
        return np.asarray(np.tensordot(self.weights, self.image, 2) / self.weights.sum(), np.float32)

    @cached_property
    def _spectra(self) -> NDArray[np.complex64]:
        """Spectra of the weights, and of the weights times each channel, ``(1 + C, ...)``."""
        planes = np.concatenate([self.weights[np.newaxis], np.moveaxis(self._weighted, -1, 0)])
        return np.asarray(scipy.fft.rfft2(planes, self._size))

    @cached_property
    def _weighted(self) -> Values:
        return self.weights[..., np.newaxis] * (self.image - self.mean)

    @cached_property
    def _sums(self) -> tuple[Map, Values, Map]:
        """Return the sum of weights, the weighted sums of channels and the energy in a window at each offset."""
        weights = box_sums(self.weights, self.window).astype(np.float32)
        sums = np.moveaxis(box_sums(self._weighted, self.window), -1, 0).astype(np.float32)
        squares = box_sums((self._weighted * (self.image - self.mean)).sum(-1), self.window).astype(np.float32)
        energy = squares - (sums**2).sum(0) / weights
        return weights, sums, energy

    def surfaces(self, windows: Values) -> Map:
        """Return the NCC of each window at every offset of the template, as ``(n, TH - h + 1, TW - w + 1)``.

        All channels together give one correlation. The mean of each channel over the window is subtracted first, so
        brightness does not count. The NCC is 0 if the window or the template is flat.
        """
        return self.surfaces_and_slopes(windows)[0]

    def surfaces_and_slopes(self, windows: Values) -> tuple[Map, Map]:
        """Return the NCC and the slope of each window at every offset.

        The slope is that of the weighted regression of the window on the template. It measures the contrast of the
        template that the window contains: 1 for a window that equals the template, 0 for an unrelated one.
        """
        height, width = self._sums[0].shape
        empty = np.zeros((0, height, width), np.float32)
        parts = [self._batch(batch) for batch in self._batches(windows)] or [(empty, empty)]
        ncc, slope = (np.concatenate(column) for column in zip(*parts, strict=True))
        return ncc, slope

    def _batches(self, windows: Values) -> Iterator[Values]:
        count = max(1, _BATCH_PIXELS // (self._size[0] * self._size[1] * (1 + windows.shape[-1])))
        for start in range(0, len(windows), count):
            yield windows[start : start + count]

    def _batch(self, windows: Values) -> tuple[Map, Map]:
        weights, sums, energy = self._sums
        planes = np.moveaxis(windows - self.mean, -1, 1)
        spectra = np.conj(scipy.fft.rfft2(planes, self._size))
        squares = np.conj(scipy.fft.rfft2((planes**2).sum(1), self._size))
        cross = self._valid((self._spectra[1:] * spectra).sum(1))
        means = self._valid(self._spectra[0] * spectra)
        power = self._valid(self._spectra[0] * squares) - (means**2).sum(1) / weights
        cross -= (means * sums).sum(1) / weights
        floor = 1e-6 * weights
        good = (power > floor) & (energy > floor)
        cross *= good
        energy = np.maximum(energy, floor)
        return cross / np.sqrt(np.maximum(power, floor) * energy), cross / energy

    def _valid(self, spectrum: NDArray[np.complex64]) -> Map:
        rows, columns = self._sums[0].shape
        return np.asarray(scipy.fft.irfft2(spectrum, self._size)[..., :rows, :columns])


def find_peaks(
    surfaces: Map, where: NDArray[np.bool_] | None = None
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return the highest point of each surface, ``(n, 2)`` as (x, y), and its height, ``(n,)``.

    The point is found to a fraction of a pixel by a parabola through three points along each axis.

    Parameters
    ----------
    surfaces
        ``(n, height, width)``.
    where
        ``bool (height, width)``: points that may be the highest; None: all. Points on the border are always left out.
    """
    height, width = surfaces.shape[1:]
    inner = np.zeros((height, width), np.bool_)
    inner[1:-1, 1:-1] = True
    rows, columns = np.nonzero(inner if where is None else inner & where)
    best = surfaces[:, rows, columns].argmax(1)
    rows, columns, each = rows[best], columns[best], np.arange(len(surfaces))
    at = surfaces[each, rows, columns]
    x, gain_x = find_vertex(surfaces[each, rows, columns - 1], at, surfaces[each, rows, columns + 1], climb=True)
    y, gain_y = find_vertex(surfaces[each, rows - 1, columns], at, surfaces[each, rows + 1, columns], climb=True)
    return np.stack([columns + x, rows + y], -1), np.minimum(at + gain_x + gain_y, 1.0)


_TRANSFORM = 20.0
"""Cost of an FFT per pixel and level, with the operations that follow, in multiplications of a matrix product. About 30
were measured on one core; the cost of building the matrices is subtracted."""
_MOST_NUMBERS = 1 << 24
"""Largest number of values in the matrices (64 MiB)."""
_FLAT = 1e-6
"""Variance (per weight) below which a window or a template counts as flat: that of rounding in float32."""


@dataclass(frozen=True)
class Correlator:
    """Exact correlation of windows with a template, at chosen offsets only.

    The result is that of :meth:`~nrbench.metrics.ncc.window_search.Template.surfaces_and_slopes` at these offsets. A
    matrix product costs (C + 1 + A) m q multiplications a window, for windows of m px, C channels, q offsets, and a
    template whose colors vary along A axes. The FFTs of a template of P px cost (2 C + 3) P log2 P steps. The cheaper
    method is used.

    Parameters
    ----------
    template
        The template, its colors along axes.
    where
        ``bool (TH - h + 1, TW - w + 1)``: the chosen offsets.
    varies
        A: number of axes along which the template varies; they are the first ones.
    """

    template: Template
    where: NDArray[np.bool_]
    varies: int

    def correlate(self, windows: Map) -> tuple[Map, Map]:
        """Return NCC and slope of each window ``(n, C, h, w)`` at each chosen offset, row by row, both ``(n, q)``."""
        if not self.small:
            ncc, slope = self.template.surfaces_and_slopes(np.moveaxis(windows, 1, -1))
            return ncc[:, self.where], slope[:, self.where]
        weighted, weights, energy, means = self._rows
        planes = windows.reshape(*windows.shape[:2], -1)
        cross = np.asarray(planes[:, : self.varies].reshape(len(planes), -1) @ weighted.T, np.float32)
        squares = np.einsum("ncp,ncp->np", planes, planes)[:, np.newaxis]
        every = np.concatenate([planes, squares], 1).reshape(-1, weights.shape[1])
        *channels, power = np.moveaxis((every @ weights.T).reshape(len(windows), -1, len(weights)), 1, 0)
        for channel, mean in zip(channels, means, strict=False):
            cross -= channel * mean
        power = power - sum(channel * channel for channel in channels)
        cross *= power > _FLAT
        scale = np.where(energy > _FLAT, 1 / np.maximum(energy, _FLAT), 0).astype(np.float32)
        ncc = cross * np.sqrt(scale)
        ncc /= np.sqrt(np.maximum(power, _FLAT, out=power), out=power)
        cross *= scale
        return ncc, cross

    def surfaces(self, ncc: Map) -> Map:
        """Return the NCC as maps ``(n, TH - h + 1, TW - w + 1)``, -1 outside the chosen offsets."""
        maps = np.full((len(ncc), *self.where.shape), -1, np.float32)
        maps[:, self.where] = ncc
        return maps

    @property
    def small(self) -> bool:
        """Whether the matrix product is cheaper than the FFTs, and its matrices fit into memory."""
        numbers = math.prod(self.template.window) * int(self.where.sum())
        channels, patch = self.template.image.shape[-1], self.template.weights.size
        transforms = (2 * channels + 3) * patch * math.log2(patch) * _TRANSFORM
        return bool((channels + 1) * numbers <= _MOST_NUMBERS and (2 * channels + 1) * numbers < transforms)

    @cached_property
    def _rows(self) -> tuple[Map, Map, Map, Map]:
        """Return the weighted template, the weights (of sum 1), the energy and the weighted means at each offset.

        The first two have one row for each offset. The means are ``(A, q)``; they are subtracted later, once for each
        window.
        """
        template, offsets = self.template, np.argwhere(self.where)[:, ::-1]
        image = np.moveaxis(template.image[..., : self.varies], -1, 0)
        planes = np.concatenate([template.weights[np.newaxis], template.weights * image])
        squares = box_sums((planes[1:] * image).sum(0), template.window).astype(np.float32)[self.where]
        rows = cut_planes(planes, offsets, template.window)
        total = rows[:, 0].sum((1, 2))
        rows /= total[:, np.newaxis, np.newaxis, np.newaxis]
        means = np.ascontiguousarray(rows[:, 1:].sum((2, 3)).T)
        energy = squares / total - (means**2).sum(0)
        return rows[:, 1:].reshape(len(rows), -1), rows[:, 0].reshape(len(rows), -1), energy, means


_AT_ONCE = 64
"""Number of windows correlated at a time. Their maps then stay in the cache of the processor."""
_MOST_NUMBERS = 1 << 24
"""Largest number of values in the matrix (64 MiB). Larger searches use FFTs."""
_FLAT = 1e-6


@dataclass(frozen=True)
class OffsetSearch:
    """Search for the offset of a template at which a window has the highest NCC.

    The search is approximate, and the NCC of its result is exact. NCC needs the product of window and template, and the
    weighted means and power of the window, at every offset. These cost (2 A + 1) m q multiplications for windows of
    m px, q offsets and A axes of color along which the template varies much. Means and power change slowly from offset
    to offset, so they are computed from blocks of 2 x 2 pixels, which reduces the cost to (A + (A + 1) / 4) m q. The
    result is the highest NCC or, rarely, one that is slightly lower.

    Parameters
    ----------
    template
        The patch of the periodic image, its colors along the axes.
    where
        ``bool (TH - h + 1, TW - w + 1)``: the offsets that are searched.
    colors
        The axes.
    sizes
        Width in px of the blocks whose means replace the pixels of a window, and of those that replace the pixels for
        its means and power; the second is not smaller. Offsets are whole pixels in any case.
    """

    template: Template
    where: NDArray[np.bool_]
    colors: Colors
    sizes: tuple[int, int]

    def find(self, planes: Planes, corners: NDArray[np.intp]) -> tuple[NDArray[np.intp], NDArray[np.float64]]:
        """Return the best offset (x, y) of each window at ``corners``, and the exact NCC there.

        The exact NCC is computed at the highest approximate NCC, or at the two highest ones if windows are compared in
        blocks. Blocks are precise enough to find these two, but not to decide between them.
        """
        highest = np.concatenate([_find_highest(ncc, self.sizes[0]) for ncc in self.maps(planes, corners)], 1)
        window, first = np.array(self.template.window), np.ascontiguousarray(corners, np.int64)
        offsets = np.ascontiguousarray(self._offsets[highest], np.int64)
        ncc = np.stack([compute_ncc(planes.smooth(1, 1), first, self._exact, at, window) for at in offsets])
        best = ncc.argmax(0)
        return offsets[best, np.arange(len(best))], ncc.max(0)

    def maps(self, planes: Planes, corners: NDArray[np.intp]) -> Iterator[Map]:
        """Yield the approximate NCC at every offset, ``(n, q)``, for some windows at a time."""
        for start in range(0, len(corners), _AT_ONCE):
            few = corners[start : start + _AT_ONCE]
            yield self._product(planes, few) if self.small else self._transforms(planes, few)

    @property
    def small(self) -> bool:
        """Whether the matrix fits into memory."""
        numbers = math.prod(self.template.window) // self.sizes[0] ** 2 * int(self.where.sum())
        return self.colors.main * numbers <= _MOST_NUMBERS

    def _transforms(self, planes: Planes, corners: NDArray[np.intp]) -> Map:
        windows = cut_planes(planes.values, corners, self.template.window)
        return self.template.surfaces(np.moveaxis(windows, 1, -1))[:, self.where]

    def _product(self, planes: Planes, corners: NDArray[np.intp]) -> Map:
        """Return the NCC by matrix products. Along minor axes of color, the plain mean replaces the weighted one."""
        (weighted, weights, template_sums, scale), main = self._rows, self.colors.main
        fine, coarse = self.sizes
        shapes = self._cut(planes.smooth(fine, fine)[:main], corners, fine)
        rest = self._cut(planes.smooth(coarse, fine), corners, coarse)
        middle = rest[:, :-1].mean(2, keepdims=True)
        power = rest[:, -1] - (2 * middle * rest[:, :-1] - middle**2).sum(1)
        rest = np.concatenate([rest[:, :main] - middle[:, :main], power[:, np.newaxis]], 1)
        cross = np.asarray((shapes - middle[:, :main]).reshape(len(corners), -1) @ weighted.T, np.float32)
        window_means = (rest.reshape(-1, rest.shape[-1]) @ weights.T).reshape(len(corners), main + 1, -1)
        normalize_sums(cross, window_means, template_sums, scale)
        return cross

    def _cut(self, planes: Map, corners: NDArray[np.intp], size: int) -> Map:
        """Return windows of planes with their pixels along one axis, ``(n, C, m)``."""
        cut = cut_planes(planes, corners, self.template.window, size)
        return cut.reshape(*cut.shape[:2], -1)

    @cached_property
    def _offsets(self) -> NDArray[np.intp]:
        """``(q, 2)``: (x, y)."""
        return np.argwhere(self.where)[:, ::-1]

    @cached_property
    def _rows(self) -> tuple[Map, Map, Map, Map]:
        """Return the weighted template, the weights (of sum 1), the weighted sums ``(A, q)`` and the scale.

        The first two have one row for each offset. See :func:`~.ncc_kernels.normalize_sums`.
        """
        fine, coarse = (smooth_planes(self.template.weights[np.newaxis], size) for size in self.sizes)
        image = smooth_planes(np.moveaxis(self.template.image[..., : self.colors.main], -1, 0), self.sizes[0])
        shapes = fine * image
        total, squares, *sums = self._sums(np.concatenate([fine, (shapes * image).sum(0, keepdims=True), shapes]))
        energy = squares / total - sum((one / total) ** 2 for one in sums)
        scale = np.where(energy > _FLAT, 1 / np.sqrt(np.maximum(energy, _FLAT)), 0) / total
        weights = self._cut(coarse, self._offsets, self.sizes[1])[:, 0]
        weights /= (weights @ np.ones(weights.shape[-1], np.float32))[:, np.newaxis]
        rows = self._cut(shapes, self._offsets, self.sizes[0]).reshape(len(weights), -1)
        return rows, weights, np.stack(sums), scale.astype(np.float32)

    def _sums(self, planes: Map) -> Map:
        """Return the sums over the window at each offset, ``(C, q)``, first along one axis, then along the other."""
        size = self.sizes[0]
        for axis, side in zip((1, 2), self.template.window, strict=True):
            span = (side // size - 1) * size + 1
            planes = sliding_window_view(planes, span, axis=axis)[..., ::size].sum(-1)
        rows, columns = self.where.shape
        return planes[:, :rows, :columns][:, self.where]

    @cached_property
    def _exact(self) -> Map:
        """Return the template in the form of :func:`~.ncc_kernels.compute_ncc`."""
        image, weights = np.moveaxis(self.template.image, -1, 0), self.template.weights[np.newaxis]
        weighted = weights * image
        squares = (weighted * image).sum(0, keepdims=True)
        return np.ascontiguousarray(np.concatenate([weights, squares, weighted[: self.colors.varies]]))


def _find_highest(ncc: Map, count: int) -> NDArray[np.intp]:
    """Return the indices of the ``count`` highest values of each row, ``(count, n)``; they are overwritten."""
    highest, rows = [], np.arange(len(ncc))
    for _ in range(count):
        highest.append(ncc.argmax(1))
        ncc[rows, highest[-1]] = -np.inf
    return np.stack(highest)


@dataclass(frozen=True)
class CellSearch:
    """Search for the displacement of a window within one cell, to a fraction of a pixel.

    Parameters
    ----------
    template
        The patch of the periodic image, its colors along the axes.
    inside
        ``bool``: the offsets that are searched.
    colors
        The axes.
    size
        Width in px of the blocks whose means replace the pixels of a window: 1, or 2 for large tiles, which reduces the
        cost to a quarter. Offsets are whole pixels in any case.
    """

    template: Template
    inside: NDArray[np.bool_]
    colors: Colors
    size: int

    def find(self, planes: Planes, corners: NDArray[np.intp]) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Return the best offset of each window at ``corners``, ``(n, 2)`` as (x, y), and its NCC there."""
        ncc = np.concatenate(list(self._search.maps(planes, corners)))
        surfaces = np.full((len(ncc), *self.inside.shape), -1, np.float32)
        surfaces[:, self._search.where] = ncc
        return find_peaks(surfaces, self.inside)

    @cached_property
    def _search(self) -> OffsetSearch:
        """Search of these offsets and of their neighbors, which the parabola through a peak needs."""
        return OffsetSearch(
            self.template, ndimage.binary_dilation(self.inside), self.colors, (self.size, 2 * self.size)
        )
