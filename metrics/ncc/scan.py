"""Where windows fit best in a patch of the periodic image: every offset, at a fraction of the cost of exact NCC."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view
from numpy.typing import NDArray

from .colors import Colors, Planes, cut_planes, smoothed
from .registration import Map, Template
from .scan_kernels import correlated, correlations

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
