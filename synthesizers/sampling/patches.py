"""Patches of a sample at real-valued places, interpolated without visible blur."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property, lru_cache
from typing import Final

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage
from scipy.interpolate import BSpline

from nrbench.imaging.convert import Image
from nrbench.lattice.geometry import Points

from .quintic_kernels import PAD, quintic_at

SPLINE: Final = 5
"""Order of the interpolating B-spline: at half a pixel it still shows 0.93 of a wave of 3 px."""
FINEST: Final = 1 / 64
"""px; places are rounded to this, so that whole pixels are told from rounding errors, and copied."""
Source = NDArray[np.float32]
"""``float32 (h, w, 3)``: nearest pixel (x, y) of the sample and its bilinear weight, 1 where a pixel is copied."""


def snapped(places: Points) -> Points:
    """Return places rounded to :data:`FINEST`."""
    return np.rint(np.asarray(places) / FINEST) * FINEST


@dataclass(frozen=True, eq=False)
class Patches:
    """Cuts patches out of a sample.

    Parameters
    ----------
    sample
        ``(H, W, C)``.
    """

    sample: Image

    @cached_property
    def _spline(self) -> NDArray[np.float64]:
        planes = [
            ndimage.spline_filter(plane, SPLINE, np.float64, "mirror") for plane in np.moveaxis(self.sample, -1, 0)
        ]
        return np.pad(np.stack(planes, -1), ((PAD, PAD), (PAD, PAD), (0, 0)), "reflect")

    @cached_property
    def _coefficients(self) -> NDArray[np.float32]:
        return self._spline.astype(np.float32)

    def cut(self, place: Points, shape: tuple[int, int]) -> tuple[Image, Source]:
        """Return a patch, and where its pixels come from.

        Whole-pixel places give copies; between pixels a B-spline of order 5 interpolates, mirrored at the edges. The
        fraction is the same all over a patch, so rows and columns are interpolated one after the other: O(h w).

        Parameters
        ----------
        place
            (x, y) in the sample of the patch's first pixel; all its pixels from -0.5 to half a pixel beyond the last.
        shape
            Height and width in px.
        """
        (x, y), (height, width) = snapped(place), shape
        column, row = int(np.floor(x)), int(np.floor(y))
        fraction = float(x - column), float(y - row)
        if fraction == (0.0, 0.0):
            patch = self.sample[row : row + height, column : column + width]
        else:
            patch = np.clip(self._between(row, column, shape, fraction), 0, 1)
        return patch, self._source(float(x), float(y), shape)

    def _between(self, row: int, column: int, shape: tuple[int, int], fraction: tuple[float, float]) -> Image:
        height, width = shape
        first = row + PAD - 2, column + PAD - 2
        window = self._coefficients[first[0] : first[0] + height + 5, first[1] : first[1] + width + 5]
        down = _mixed(window, _taps(fraction[1]), height)
        return _mixed(down.swapaxes(0, 1), _taps(fraction[0]), width).swapaxes(0, 1)

    def _source(self, x: float, y: float, shape: tuple[int, int]) -> Source:
        height, width = shape
        columns, rows = x + np.arange(width), y + np.arange(height)
        last = self.sample.shape[1] - 1, self.sample.shape[0] - 1
        near = np.clip(np.floor(columns + 0.5), 0, last[0]), np.clip(np.floor(rows + 0.5), 0, last[1])
        source = np.empty((height, width, 3), np.float32)
        source[..., 0], source[..., 1] = near[0], near[1][:, np.newaxis]
        source[..., 2] = np.outer(1 - np.abs(rows - near[1]), 1 - np.abs(columns - near[0]))
        return source

    def read(self, points: Points) -> Image:
        """Return the values, clipped to [0, 1], at points (x, y) of the sample: ``(..., 2)`` to ``(..., C)``."""
        found = quintic_at(self._spline, np.ascontiguousarray(points, np.float64).reshape(-1, 2))
        return np.asarray(np.clip(found, 0, 1)).reshape(*points.shape[:-1], self.sample.shape[2])

    def at(self, points: Points) -> tuple[Image, Source]:
        """Return the pixels that show points (x, y) of the sample, ``(h, w, 2)``, and where they come from.

        As :meth:`cut` does, but each point is interpolated by itself.
        """
        nearest = np.clip(np.rint(points), 0, np.array(self.sample.shape[1::-1]) - 1)
        weight = np.clip(1 - np.abs(points - nearest), 0, 1).prod(-1, keepdims=True)
        x, y = np.moveaxis(nearest.astype(np.intp), -1, 0)
        image = np.where(weight == 1, self.sample[y, x], self.read(points))
        return image, np.concatenate([nearest, weight], -1).astype(np.float32)


def _mixed(window: Image, taps: tuple[np.float32, ...], count: int) -> Image:
    """Return ``count`` rows, each the sum of six rows of the window, weighted."""
    total = taps[0] * window[:count]
    for k, tap in enumerate(taps[1:], 1):
        total += tap * window[k : k + count]
    return np.asarray(total)


@lru_cache(maxsize=256)
def _taps(fraction: float) -> tuple[np.float32, ...]:
    """Return the weights of the six coefficients from 2 before to 3 after a pixel, ``fraction`` px after it."""
    element = BSpline.basis_element(np.arange(SPLINE + 2) - (SPLINE + 1) / 2, extrapolate=False)
    return tuple(np.float32(tap) for tap in np.nan_to_num(element(fraction - np.arange(-2, 4))))
