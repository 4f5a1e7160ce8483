"""Images with their colors along the axes in which a periodic image varies."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view
from numpy.typing import NDArray

from nrbench.imaging.fold import Values

from .registration import Map

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
