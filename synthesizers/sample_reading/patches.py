"""Read a sample at real-valued places by spline interpolation, and record where each pixel comes from."""

from __future__ import annotations

import itertools
from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property, lru_cache
from typing import Final

import numpy as np
from numpy.typing import NDArray

from nrbench.imaging.convert import Image
from nrbench.lattice.geometry import Points
from nrbench.plugins.forms import Task

from ..lattice_places.equal_places import pixel_grid
from .quintic_kernels import PAD, quintic_at

ORDER: Final = 5
"""Order of the interpolating B-spline. Halfway between pixels it keeps 0.93 of the amplitude of a wave of 3 px."""
PLACE_STEP: Final = 1 / 64
"""px: places are rounded to multiples of this, so that a place within a rounding error of a whole pixel is copied."""
Source = NDArray[np.float32]
"""``float32 (h, w, 3)``: the place (x, y) in the sample that a pixel shows, a whole pixel where it is copied, and 1."""
_POLES = -0.43057534709997379, -0.043096288203264654
"""The poles of that spline."""
_SAME = 2**-25
"""px: a place that is so near to a pixel is copied."""
_BAND = 1 << 18
"""Number of pixels that are resampled at a time."""


def round_places(places: Points) -> Points:
    """Return places rounded to multiples of :data:`PLACE_STEP`."""
    return np.rint(np.asarray(places) / PLACE_STEP) * PLACE_STEP


@dataclass(frozen=True, eq=False)
class Patches:
    """Reads a sample between its pixels, with B-splines of order 5, mirrored at the edges.

    Parameters
    ----------
    sample
        ``(H, W, C)``.

    Examples
    --------
    >>> image, source = Patches(np.eye(8, dtype=np.float32)[..., np.newaxis]).cut_patch(np.array([2.0, 1.0]), (2, 2))
    >>> image[..., 0].tolist(), source[0, 0].tolist()
    ([[0.0, 0.0], [1.0, 0.0]], [2.0, 1.0, 1.0])
    """

    sample: Image

    @cached_property
    def _spline(self) -> NDArray[np.float64]:
        return np.pad(_filter_spline(self.sample), ((PAD, PAD), (PAD, PAD), (0, 0)), "reflect")

    @cached_property
    def _coefficients(self) -> NDArray[np.float32]:
        return self._spline.astype(np.float32)

    def cut_patch(self, place: Points, shape: tuple[int, int]) -> tuple[Image, Source]:
        """Return the patch at a place, and its :data:`Source`.

        At whole-pixel places the patch is a copy. Between pixels the fraction is the same in the whole patch, so rows
        and columns are interpolated separately: O(h w).

        Parameters
        ----------
        place
            (x, y) in the sample of the patch's first pixel. No pixel may lie more than half a pixel outside.
        shape
            Height and width in px.
        """
        (x, y), (height, width) = round_places(place), shape
        column, row = int(np.floor(x)), int(np.floor(y))
        fraction = float(x - column), float(y - row)
        if fraction == (0.0, 0.0):
            patch = self.sample[row : row + height, column : column + width]
        else:
            patch = np.clip(self._interpolate(row, column, shape, fraction), 0, 1)
        source, last = np.ones((height, width, 3), np.float32), np.array(self.sample.shape) - 0.5
        source[..., 0] = np.clip(x + np.arange(width), -0.5, last[1])
        source[..., 1] = np.clip(y + np.arange(height), -0.5, last[0])[:, np.newaxis]
        return patch, source

    def _interpolate(self, row: int, column: int, shape: tuple[int, int], fraction: tuple[float, float]) -> Image:
        height, width = shape
        first = row + PAD - 2, column + PAD - 2
        window = self._coefficients[first[0] : first[0] + height + 5, first[1] : first[1] + width + 5]
        down = _weighted_rows(window, _spline_weights(fraction[1]), height)
        return _weighted_rows(down.swapaxes(0, 1), _spline_weights(fraction[0]), width).swapaxes(0, 1)

    def read_points(self, points: Points) -> Image:
        """Return the values at points (x, y) of the sample, ``(..., 2)``, clipped to [0, 1]: ``(..., C)``."""
        values = quintic_at(self._spline, np.ascontiguousarray(points, np.float64).reshape(-1, 2))
        return np.asarray(np.clip(values, 0, 1)).reshape(*points.shape[:-1], self.sample.shape[2])

    def read_with_source(self, points: Points) -> tuple[Image, Source]:
        """Return the values at points (x, y) of the sample, ``(h, w, 2)``, and their :data:`Source`."""
        nearest = np.clip(np.rint(points), 0, np.array(self.sample.shape[1::-1]) - 1)
        x, y = np.moveaxis(nearest.astype(np.intp), -1, 0)
        copied = np.abs(points - nearest).sum(-1, keepdims=True) < _SAME
        return np.where(copied, self.sample[y, x], self.read_points(points)), point_source(points, self.sample.shape)


def _filter_spline(values: Image) -> NDArray[np.float64]:
    """Return the coefficients of the spline through values ``(H, W, C)``, mirrored at the edges.

    They are those of :func:`scipy.ndimage.spline_filter`, to the bit. Importing that function takes longer than a
    method that needs no other one of scipy. Each pole is a filter forward and one backward (Unser 1999, IEEE Signal
    Processing Magazine 16).
    """
    coefficients = np.array(values, np.float64)
    for along in (coefficients, coefficients.swapaxes(0, 1)):
        last = len(along) - 1
        along *= np.prod([(1 - pole) * (1 - 1 / pole) for pole in _POLES])
        for pole in _POLES:
            power, end = pole, pole**last
            along[0] += end * along[last]
            for i in range(1, last):
                along[0] += power * (along[i] + end * along[last - i])
                power *= pole
            along[0] /= 1 - end * end
            for i in range(1, last + 1):
                along[i] += pole * along[i - 1]
            along[last] = (pole * along[last - 1] + along[last]) * pole / (pole * pole - 1)
            for i in range(last - 1, -1, -1):
                along[i] = pole * (along[i + 1] - along[i])
    return coefficients


def point_source(points: Points, shape: tuple[int, ...]) -> Source:
    """Return the :data:`Source` of points (x, y) ``(h, w, 2)`` of a sample of a shape (height, width, ...)."""
    inside = np.clip(points, -0.5, np.array(shape[1::-1]) - 0.5)
    return np.concatenate([inside, np.ones_like(inside[..., :1])], -1).astype(np.float32)


def _weighted_rows(window: Image, weights: tuple[np.float32, ...], count: int) -> Image:
    """Return ``count`` rows, each the weighted sum of six consecutive rows of the window."""
    total = weights[0] * window[:count]
    for k, weight in enumerate(weights[1:], 1):
        total += weight * window[k : k + count]
    return np.asarray(total)


@lru_cache(maxsize=256)
def _spline_weights(fraction: float) -> tuple[np.float32, ...]:
    """Return the weights of six coefficients, from 2 px before a pixel to 3 px after it, ``fraction`` px after it.

    They are the values of the basis splines of degree 5, by the recursion of Cox and de Boor for knots at all whole
    numbers. ``scipy.interpolate`` gives the same values, but its import takes longer than a small synthesis.
    """
    values = [1.0]
    for degree in range(1, ORDER + 1):
        shares = [value / degree for value in values]
        values = [
            (fraction + degree - n) * before + (n + 1 - fraction) * after
            for n, (before, after) in enumerate(itertools.pairwise([0.0, *shares, 0.0]))
        ]
    return tuple(map(np.float32, values))


def resample(task: Task, points: Callable[[Points], Points], patches: Patches | None = None) -> tuple[Image, Source]:
    """Compute an output whose pixels show given points of the sample, and its source map.

    Parameters
    ----------
    task
        The sample, and the shape of the output.
    points
        Maps pixels (x, y) of the output, ``(h, W, 2)``, to points (x, y) of the sample.
    patches
        The sample's patches, if they exist already.

    Returns
    -------
    image, source
        ``(H, W, C)`` in [0, 1]; ``(H, W, 3)``: see :data:`Source`.
    """
    height, width = task.shape
    patches = Patches(task.sample) if patches is None else patches
    image = np.empty((height, width, task.sample.shape[2]), np.float32)
    source = np.empty((height, width, 3), np.float32)
    rows = max(1, _BAND // width)
    for top in range(0, height, rows):
        band = slice(top, top + rows)
        pixels = pixel_grid(width, min(rows, height - top), top=top).astype(np.float64)
        image[band], source[band] = patches.read_with_source(points(pixels))
        task.progress(min(1.0, (top + rows) / height))
    return image, source
