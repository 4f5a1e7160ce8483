"""Weighted NCC of windows with a template at chosen offsets alone: one matrix product instead of FFTs."""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from nrbench.imaging.box_sums import box_sums

from .colors import cut_planes
from .registration import Map, Template

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

    The result is that of :meth:`~nrbench.metrics.ncc.registration.Template.surfaces_and_slopes` at these offsets. With
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
