"""Weighted NCC of windows with a template at chosen offsets alone: one matrix product instead of FFTs."""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from nrbench.imaging.fold import Values
from nrbench.imaging.registration import Map, Template, box_sum

_TRANSFORM = 10.0
"""Cost of a pixel and level of an FFT with what is done to it after, in multiplications of a matrix product: some 13 as
measured on one core, less what it takes to lay out the matrices."""
_MOST_NUMBERS = 1 << 24
"""The matrices hold no more numbers than this (64 MiB)."""
_FLAT = 1e-6
"""Variance (per weight) below which a window or a template shows nothing: that of rounding in float32."""


@dataclass(frozen=True)
class Bank:
    """The windows of a template at chosen offsets.

    The result is that of :meth:`~nrbench.imaging.registration.Template.surfaces_and_slopes` at these offsets. With
    windows of m px, C channels and q offsets a window costs (2 C + 1) m q multiplications; the FFTs of a template of
    P px cost (2 C + 3) P log2 P steps. The cheaper of the two is taken.

    Parameters
    ----------
    template
        Where windows are looked for.
    where
        ``bool (TH - h + 1, TW - w + 1)``: at which of its offsets.
    """

    template: Template
    where: NDArray[np.bool_]

    def compare(self, windows: Values) -> tuple[Map, Map]:
        """Return NCC and slope of each window ``(n, h, w, C)`` at each offset, row by row, both ``(n, q)``."""
        if not self.small:
            ncc, slope = self.template.surfaces_and_slopes(windows)
            return ncc[:, self.where], slope[:, self.where]
        shapes, weights, energy = self._rows
        planes = np.moveaxis(windows - self.template.mean, -1, 1).reshape(len(windows), windows.shape[-1], -1)
        cross = planes.reshape(len(planes), -1) @ shapes.T
        power = (planes**2).sum(1) @ weights.T
        for channel in range(planes.shape[1]):
            mean = planes[:, channel] @ weights.T
            mean *= mean
            power -= mean
        cross *= power > _FLAT
        scale = np.where(energy > _FLAT, 1 / np.maximum(energy, _FLAT), 0).astype(np.float32)
        ncc = cross * np.sqrt(scale) / np.sqrt(np.maximum(power, _FLAT))
        return ncc.astype(np.float32, copy=False), np.asarray(cross * scale, np.float32)

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
    def _rows(self) -> tuple[Map, Map, Map]:
        """Return, a row an offset, the weighted template less its mean, the weights (of sum 1), and the energy."""
        template, (height, width) = self.template, self.template.window
        centered = np.moveaxis(template.image - template.mean, -1, 0)
        planes = np.concatenate([template.weights[np.newaxis], template.weights * centered])
        total, *sums = (box_sum(plane, template.window)[self.where] for plane in planes)
        squares = box_sum((planes[1:] * centered).sum(0), template.window)[self.where]
        means = np.stack(sums, -1) / total[:, np.newaxis]
        side = template.weights.shape[1]
        inside = (side * np.arange(height)[:, np.newaxis] + np.arange(width)).ravel()
        index = np.ravel_multi_index(np.nonzero(self.where), template.weights.shape)[:, np.newaxis] + inside
        weights = planes[0].ravel()[index] / total[:, np.newaxis]
        shapes = np.empty((len(index), len(sums), len(inside)), np.float32)
        for channel, (plane, mean) in enumerate(zip(planes[1:], means.T, strict=True)):
            np.take(plane.ravel(), index, out=shapes[:, channel])
            shapes[:, channel] /= total[:, np.newaxis]
            shapes[:, channel] -= weights * mean[:, np.newaxis]
        return shapes.reshape(len(index), -1), weights, squares / total - (means**2).sum(1)
