"""Registration of windows against a periodic template, by weighted normalized cross-correlation (NCC)."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from functools import cached_property

import numpy as np
import scipy.fft
from numpy.typing import NDArray

from nrbench.imaging.box_sums import box_sums
from nrbench.imaging.fold import Values
from nrbench.imaging.parabola import find_vertex

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
