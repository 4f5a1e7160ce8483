"""Weighted NCC of windows with a template at chosen offsets alone: one matrix product instead of FFTs."""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view
from numpy.typing import NDArray

from nrbench.imaging.fold import Values
from nrbench.imaging.registration import Map, Template, box_sum

_TRANSFORM = 20.0
"""Cost of a pixel and level of an FFT with what is done to it after, in multiplications of a matrix product: some 30 as
measured on one core, less what it takes to lay out the matrices."""
_FAINT = 1e-9
"""Share of a template's largest variance along an axis of color below which it does not vary along another."""
_MOST_NUMBERS = 1 << 24
"""The matrices hold no more numbers than this (64 MiB), whatever the colors."""
_FLAT = 1e-6
"""Variance (per weight) below which a window or a template shows nothing: that of rounding in float32."""


@dataclass(frozen=True)
class Bank:
    """The windows of a template at chosen offsets.

    The result is that of :meth:`~nrbench.imaging.registration.Template.surfaces_and_slopes` at these offsets. With
    windows of m px, C channels and q offsets a window costs (2 C + 1) m q multiplications, or (C + 1 + A) m q where the
    template's colors vary along A axes alone (one for tiles and joints of one color each); the FFTs of a template of
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
        weighted, weights, energy, means = self._rows
        rotated = np.moveaxis((windows - self.template.mean) @ self._axes[0], -1, 1).reshape(len(windows), -1)
        cross = np.asarray(rotated[:, : weighted.shape[1]] @ weighted.T, np.float32)
        planes = rotated.reshape(len(windows), windows.shape[-1], -1)
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
    def _axes(self) -> tuple[Map, int]:
        """Return orthonormal axes of color, the template's largest variance first, and along how many it varies."""
        colors = (self.template.image - self.template.mean).reshape(-1, len(self.template.mean))
        variance, axes = np.linalg.eigh(colors.T @ colors)
        varies = int((variance > _FAINT * variance[-1]).sum())
        return np.ascontiguousarray(axes[:, ::-1], np.float32), max(varies, 1)

    @cached_property
    def _rows(self) -> tuple[Map, Map, Map, Map]:
        """Return, a row an offset, the weighted template and the weights (of sum 1), its energy, and its means.

        The template is there along those axes of color alone along which it varies. The means are ``(axes, q)``: what
        is still to be taken out of it, once for each window.
        """
        template, (height, width), (axes, varies) = self.template, self.template.window, self._axes
        centered = np.moveaxis((template.image - template.mean) @ axes[:, :varies], -1, 0)
        planes = np.concatenate([template.weights[np.newaxis], template.weights * centered])
        total, *sums = (box_sum(plane, template.window)[self.where] for plane in planes)
        squares = box_sum((planes[1:] * centered).sum(0), template.window)[self.where]
        means = np.stack(sums) / total
        weights = np.empty((len(total), height, width), np.float32)
        weighted = np.empty((len(total), varies, height, width), np.float32)
        views = sliding_window_view(planes, template.window, axis=(1, 2))
        for k, (y, x) in enumerate(np.argwhere(self.where)):
            np.multiply(views[0, y, x], 1 / total[k], out=weights[k])
            np.multiply(views[1:, y, x], 1 / total[k], out=weighted[k])
        energy = squares / total - (means**2).sum(0)
        return weighted.reshape(len(total), -1), weights.reshape(len(total), -1), energy, means
