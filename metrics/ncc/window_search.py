"""Search windows of an image in a patch of the periodic image by weighted normalized cross-correlation (NCC)."""

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
from nrbench.imaging.fold import Values
from nrbench.imaging.parabola import find_vertex

from .ncc_kernels import correlated, correlations

_FAINT, _MINOR = 1e-5, 0.01
"""Share of the largest variance along an axis of color below which the periodic image does not vary along another, and
below which it need not be looked at to find where a window fits best."""


@dataclass(frozen=True)
class Colors:
    """Orthonormal axes of color, those along which a periodic image varies most first.

    Parameters
    ----------
    mean
        ``(C,)``: the color that is zero along every axis.
    axes
        ``(C, C)``, a column an axis.
    varies
        Along how many of them the periodic image varies: one for tiles and joints of one color each.
    main
        Along how many it varies by much.
    """

    mean: NDArray[np.float32]
    axes: NDArray[np.float32]
    varies: int
    main: int

    @classmethod
    def of(cls, image: Values) -> Colors:
        """Return the axes of a periodic image ``(H, W, C)`` that shows all of a cell."""
        pixels = image.reshape(-1, image.shape[-1]).astype(np.float64)
        mean = pixels.mean(0)
        variance, axes = np.linalg.eigh((pixels - mean).T @ (pixels - mean))
        varies, main = (max(int((variance > share * variance[-1]).sum()), 1) for share in (_FAINT, _MINOR))
        return cls(mean.astype(np.float32), np.ascontiguousarray(axes[:, ::-1], np.float32), varies, main)

    def along(self, image: Values) -> Values:
        """Return an image ``(H, W, C)`` with its colors along the axes."""
        pixels = np.ascontiguousarray(image).reshape(-1, image.shape[-1])
        return np.asarray(((pixels - self.mean) @ self.axes).reshape(image.shape), np.float32)

    def planes(self, image: Values) -> Planes:
        """Return the same, plane by plane."""
        return Planes(np.ascontiguousarray(np.moveaxis(self.along(image), -1, 0)))


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

    def smoothed(self, size: int, first: int) -> Map:
        """Return the planes, and the sum of their squares, at lower resolution but at every pixel, ``(C + 1, ...)``.

        Parameters
        ----------
        size
            A pixel stands for the mean over ``size`` x ``size`` pixels of which it is the first.
        first
            So many each way are averaged, at most ``size``, before the squares are taken.
        """
        if (size, first) not in self._kept:
            values = smoothed(self.values, first)
            squares = np.einsum("chw,chw->hw", values, values)[np.newaxis]
            self._kept[size, first] = smoothed(np.concatenate([values, squares]), size - first + 1)
        return self._kept[size, first]


def smoothed(planes: Map, size: int) -> Map:
    """Return at each pixel the mean over the ``size`` x ``size`` pixels of which it is the first, ``(..., H, W)``."""
    for _ in range(2 if size > 1 else 0):
        length = planes.shape[-1] - size + 1
        parts = [planes[..., k : k + length] for k in range(size)]
        planes = np.swapaxes(np.sum(parts, 0) / np.float32(size), -1, -2)
    return np.ascontiguousarray(planes, np.float32)


def cut_planes(planes: Map, corners: NDArray[np.intp], window: tuple[int, int], step: int = 1) -> Map:
    """Return windows of planes ``(C, H, W)``, ``(n, C, h, w)``.

    Parameters
    ----------
    planes
        What they are cut from.
    corners
        ``(n, 2)``: (x, y) of their first pixels.
    window
        Height and width of what they cover.
    step
        Every so many pixels of them, along both axes, one is taken: ``h = height // step``, for means over as many.
    """
    spans = [(side // step - 1) * step + 1 for side in window]
    views = sliding_window_view(planes, spans, axis=(1, 2))[..., ::step, ::step]
    return np.ascontiguousarray(np.moveaxis(views, 0, 2)[corners[:, 1], corners[:, 0]])


Map = NDArray[np.float32]
_BATCH_PIXELS = 1 << 21


@dataclass(frozen=True)
class Template:
    """A patch of the periodic image in which windows of one shape are looked for.

    Parameters
    ----------
    image
        ``(TH, TW, C)``, larger than the window by the range of displacements that is searched.
    weights
        ``(TH, TW)``, not negative: what each pixel of the template counts for.
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
        """Return, over a window at every offset: sum of weights, weighted sums of channels, template's energy."""
        weights = box_sums(self.weights, self.window).astype(np.float32)
        sums = np.moveaxis(box_sums(self._weighted, self.window), -1, 0).astype(np.float32)
        squares = box_sums((self._weighted * (self.image - self.mean)).sum(-1), self.window).astype(np.float32)
        energy = squares - (sums**2).sum(0) / weights
        return weights, sums, energy

    def surfaces(self, windows: Values) -> Map:
        """Return the NCC of each window at every offset of the template, as ``(n, TH - h + 1, TW - w + 1)``.

        All channels share one correlation; each channel's mean over the window is taken out first, so that lighting
        does not count. A window or template without variance gives 0.
        """
        return self.surfaces_and_slopes(windows)[0]

    def surfaces_and_slopes(self, windows: Values) -> tuple[Map, Map]:
        """Return the NCC, and the slope: how much of the template's contrast the window shows at every offset.

        The slope is that of the weighted regression of the window on the template: 1 for a window that equals it, 0
        for one that has nothing of it, whatever else it shows.
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


def peaks(surfaces: Map, where: NDArray[np.bool_] | None = None) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return each surface's highest point, ``(n, 2)`` as (x, y), sub-pixel, and its height ``(n,)``.

    A parabola through three points along each axis.

    Parameters
    ----------
    surfaces
        ``(n, height, width)``.
    where
        ``bool (height, width)``: where to look; the outermost ring is always left out. None: everywhere else.
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
"""Cost of a pixel and level of an FFT with what is done to it after, in multiplications of a matrix product: some 30 as
measured on one core, less what it takes to lay out the matrices."""
_MOST_NUMBERS = 1 << 24
"""The matrices hold no more numbers than this (64 MiB), whatever the colors."""
_FLAT = 1e-6
"""Variance (per weight) below which a window or a template shows nothing: that of rounding in float32."""


@dataclass(frozen=True)
class Bank:
    """The windows of a template at chosen offsets.

    The result is that of :meth:`~nrbench.metrics.ncc.window_search.Template.surfaces_and_slopes` at these offsets. With
    windows of m px, C channels and q offsets a window costs (C + 1 + A) m q multiplications where the template's colors
    vary along A axes alone; the FFTs of a template of P px cost (2 C + 3) P log2 P steps. The cheaper of the two is
    taken.

    Parameters
    ----------
    template
        Where windows are looked for, its colors along axes.
    where
        ``bool (TH - h + 1, TW - w + 1)``: at which of its offsets.
    varies
        A: along how many axes, the first, it varies.
    """

    template: Template
    where: NDArray[np.bool_]
    varies: int

    def compare(self, windows: Map) -> tuple[Map, Map]:
        """Return NCC and slope of each window ``(n, C, h, w)`` at each offset, row by row, both ``(n, q)``."""
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
        """Return the NCC as maps ``(n, TH - h + 1, TW - w + 1)``, -1 where it was not asked for."""
        maps = np.full((len(ncc), *self.where.shape), -1, np.float32)
        maps[:, self.where] = ncc
        return maps

    @property
    def small(self) -> bool:
        """Whether the product is cheaper than the FFTs, and its matrices are not too large."""
        numbers = math.prod(self.template.window) * int(self.where.sum())
        channels, patch = self.template.image.shape[-1], self.template.weights.size
        transforms = (2 * channels + 3) * patch * math.log2(patch) * _TRANSFORM
        return bool((channels + 1) * numbers <= _MOST_NUMBERS and (2 * channels + 1) * numbers < transforms)

    @cached_property
    def _rows(self) -> tuple[Map, Map, Map, Map]:
        """Return, a row an offset, the weighted template and the weights (of sum 1), its energy, and its means.

        The means are ``(A, q)``: what is still to be taken out of it, once for each window.
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
"""Windows looked at at a time: their maps stay in the processor's cache."""
_MOST_NUMBERS = 1 << 24
"""The matrix holds no more numbers than this (64 MiB); beyond, FFTs take its place."""
_FLAT = 1e-6


@dataclass(frozen=True)
class Scan:
    """A patch of the periodic image, to be looked at at many offsets.

    NCC needs, at every offset, the product of window and template, and the window's own weighted means and power. With
    windows of m px, q offsets and A axes of color along which the template varies by much these are (2 A + 1) m q
    multiplications; but means and power change slowly, so that their pixels may be taken two by two: (A + (A + 1) / 4)
    m q. What is found this way is the highest NCC or, seldom, one that is little lower.

    Parameters
    ----------
    template
        The patch, its colors along the axes.
    where
        ``bool (TH - h + 1, TW - w + 1)``: at which of its offsets.
    colors
        The axes.
    sizes
        Pixels each way that are taken together in windows, and, no fewer, in their means and power. The offsets stay
        single pixels.
    """

    template: Template
    where: NDArray[np.bool_]
    colors: Colors
    sizes: tuple[int, int]

    def find(self, planes: Planes, corners: NDArray[np.intp]) -> tuple[NDArray[np.intp], NDArray[np.float64]]:
        """Return where in the patch, (x, y), each window at ``corners`` fits best, and the exact NCC there.

        It is the best of the highest where every pixel is looked at, of the two highest where they are taken two by
        two: their NCC comes near enough to tell these from the rest, not from each other.
        """
        highest = np.concatenate([_highest(ncc, self.sizes[0]) for ncc in self.maps(planes, corners)], 1)
        window, first = np.array(self.template.window), np.ascontiguousarray(corners, np.int64)
        offsets = np.ascontiguousarray(self._offsets[highest], np.int64)
        ncc = np.stack([correlations(planes.smoothed(1, 1), first, self._exact, at, window) for at in offsets])
        best = ncc.argmax(0)
        return offsets[best, np.arange(len(best))], ncc.max(0)

    def maps(self, planes: Planes, corners: NDArray[np.intp]) -> Iterator[Map]:
        """Yield the NCC of some windows after the other at every offset, ``(n, q)``."""
        for start in range(0, len(corners), _AT_ONCE):
            few = corners[start : start + _AT_ONCE]
            yield self._product(planes, few) if self.small else self._transforms(planes, few)

    @property
    def small(self) -> bool:
        """Whether the matrix is not too large."""
        numbers = math.prod(self.template.window) // self.sizes[0] ** 2 * int(self.where.sum())
        return self.colors.main * numbers <= _MOST_NUMBERS

    def _transforms(self, planes: Planes, corners: NDArray[np.intp]) -> Map:
        windows = cut_planes(planes.values, corners, self.template.window)
        return self.template.surfaces(np.moveaxis(windows, 1, -1))[:, self.where]

    def _product(self, planes: Planes, corners: NDArray[np.intp]) -> Map:
        """Return the NCC, but that colors along minor axes are taken at their plain mean over the window."""
        (weighted, weights, means, scale), main = self._rows, self.colors.main
        fine, coarse = self.sizes
        shapes = self._cut(planes.smoothed(fine, fine)[:main], corners, fine)
        rest = self._cut(planes.smoothed(coarse, fine), corners, coarse)
        middle = rest[:, :-1].mean(2, keepdims=True)
        power = rest[:, -1] - (2 * middle * rest[:, :-1] - middle**2).sum(1)
        rest = np.concatenate([rest[:, :main] - middle[:, :main], power[:, np.newaxis]], 1)
        cross = np.asarray((shapes - middle[:, :main]).reshape(len(corners), -1) @ weighted.T, np.float32)
        seen = (rest.reshape(-1, rest.shape[-1]) @ weights.T).reshape(len(corners), main + 1, -1)
        correlated(cross, seen, means, scale)
        return cross

    def _cut(self, planes: Map, corners: NDArray[np.intp], size: int) -> Map:
        """Return windows of planes, their pixels in a row, ``(n, C, m)``."""
        cut = cut_planes(planes, corners, self.template.window, size)
        return cut.reshape(*cut.shape[:2], -1)

    @cached_property
    def _offsets(self) -> NDArray[np.intp]:
        """``(q, 2)``: (x, y)."""
        return np.argwhere(self.where)[:, ::-1]

    @cached_property
    def _rows(self) -> tuple[Map, Map, Map, Map]:
        """Return, a row an offset, the weighted template and the weights (of sum 1), its sums ``(A, q)``, and scale."""
        fine, coarse = (smoothed(self.template.weights[np.newaxis], size) for size in self.sizes)
        image = smoothed(np.moveaxis(self.template.image[..., : self.colors.main], -1, 0), self.sizes[0])
        shapes = fine * image
        total, squares, *sums = self._sums(np.concatenate([fine, (shapes * image).sum(0, keepdims=True), shapes]))
        energy = squares / total - sum((one / total) ** 2 for one in sums)
        scale = np.where(energy > _FLAT, 1 / np.sqrt(np.maximum(energy, _FLAT)), 0) / total
        weights = self._cut(coarse, self._offsets, self.sizes[1])[:, 0]
        weights /= (weights @ np.ones(weights.shape[-1], np.float32))[:, np.newaxis]
        rows = self._cut(shapes, self._offsets, self.sizes[0]).reshape(len(weights), -1)
        return rows, weights, np.stack(sums), scale.astype(np.float32)

    def _sums(self, planes: Map) -> Map:
        """Return the sums over windows of planes at each offset, ``(C, q)``: along one axis, then the other."""
        size = self.sizes[0]
        for axis, side in zip((1, 2), self.template.window, strict=True):
            span = (side // size - 1) * size + 1
            planes = sliding_window_view(planes, span, axis=axis)[..., ::size].sum(-1)
        rows, columns = self.where.shape
        return planes[:, :rows, :columns][:, self.where]

    @cached_property
    def _exact(self) -> Map:
        """Return the template as :func:`~.scan_kernels.correlations` wants it."""
        image, weights = np.moveaxis(self.template.image, -1, 0), self.template.weights[np.newaxis]
        weighted = weights * image
        squares = (weighted * image).sum(0, keepdims=True)
        return np.ascontiguousarray(np.concatenate([weights, squares, weighted[: self.colors.varies]]))


def _highest(ncc: Map, count: int) -> NDArray[np.intp]:
    """Return the indices of the ``count`` highest values of each row, ``(count, n)``; these are overwritten."""
    found, rows = [], np.arange(len(ncc))
    for _ in range(count):
        found.append(ncc.argmax(1))
        ncc[rows, found[-1]] = -np.inf
    return np.stack(found)


@dataclass(frozen=True)
class Places:
    """A patch of the periodic image, looked at within one cell of displacements.

    Parameters
    ----------
    template
        The patch, its colors along the axes.
    inside
        ``bool``: at which of its offsets a window may lie.
    colors
        The axes.
    size
        Pixels each way of a window that are taken together: 1, or 2 where tiles are large. The offsets stay single
        pixels; a window so costs a quarter.
    """

    template: Template
    inside: NDArray[np.bool_]
    colors: Colors
    size: int

    def find(self, planes: Planes, corners: NDArray[np.intp]) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Return where each window at ``corners`` fits best, ``(n, 2)`` as (x, y) in the patch, and its NCC there."""
        ncc = np.concatenate(list(self._scan.maps(planes, corners)))
        surfaces = np.full((len(ncc), *self.inside.shape), -1, np.float32)
        surfaces[:, self._scan.where] = ncc
        return peaks(surfaces, self.inside)

    @cached_property
    def _scan(self) -> Scan:
        """All offsets, and those around them that a parabola through a peak needs."""
        return Scan(self.template, ndimage.binary_dilation(self.inside), self.colors, (self.size, 2 * self.size))
