"""Neighborhoods of pixels: which offsets are compared in the texture, and which in its mask."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from nrbench.imaging.convert import Image, to_bytes

Layers = NDArray[np.uint8]
"""``uint8 (L, H, W, C)``: the texture, and (L = 2) its mask."""
Integers = NDArray[np.int64]


@dataclass(frozen=True, eq=False)
class Neighborhood:
    """The offsets around a pixel that are compared.

    Parameters
    ----------
    taps
        ``int64 (t, 3)``: (x, y, layer): 0 is the texture, 1 the mask.
    """

    taps: Integers

    @classmethod
    def growing(cls, size: int, masked: bool) -> Neighborhood:
        """Return the window of ``size`` x ``size`` px from -size//2 on: N_upper in the texture, N_lower in the mask.

        N_upper are the pixels before its own in scan-line order, N_lower its own and those behind (Nicoll et al. 2005,
        figure 4); without a mask N_upper is all.
        """
        x, y = _window(size)
        lower = (y > 0) | ((y == 0) & (x >= 0))
        return cls(np.stack([x, y, lower], -1)[masked | ~lower])

    @classmethod
    def closing(cls, size: int, masked: bool) -> Neighborhood:
        """Return the window of size//2 px on all sides, all synthesized before: the mask counts at the pixel alone."""
        x, y = _window(size // 2 * 2 + 1)
        own = (y == 0) & (x == 0)
        return cls(np.stack([x, y, own], -1)[masked | ~own])

    @classmethod
    def of_mask(cls, size: int) -> Neighborhood:
        """Return the whole window, in the mask."""
        x, y = _window(size)
        return cls(np.stack([x, y, np.ones_like(x)], -1))

    @property
    def causes(self) -> Integers:
        """``(m, 2)``: the offsets (x, y) that are compared in the texture."""
        return np.ascontiguousarray(self.taps[self.taps[:, 2] == 0, :2])

    @property
    def box(self) -> tuple[int, int, int, int]:
        """(left, top, right, bottom): how far the offsets reach from the pixel."""
        (x0, y0), (x1, y1) = self.taps[:, :2].min(0), self.taps[:, :2].max(0)
        return max(-int(x0), 0), max(-int(y0), 0), max(int(x1), 0), max(int(y1), 0)

    def weights(self, weight: float, channels: int) -> NDArray[np.float64]:
        """Return what each value's squared difference counts: 1 in the texture, ``weight`` in the mask."""
        return np.repeat(np.where(self.taps[:, 2] == 1, weight, 1.0), channels)

    def steps(self, layers: Layers) -> Integers:
        """Return how far the values lie from a pixel's first one in the flat array, ``(t C,)``."""
        _, height, width, channels = layers.shape
        x, y, layer = self.taps.T
        pixels = (layer * height + y) * width + x
        return np.asarray((pixels[:, np.newaxis] * channels + np.arange(channels)).ravel())

    def complete(self, shape: tuple[int, int]) -> Integers:
        """Return the pixels of a (height, width) whose whole neighborhood lies inside, as row * width + column."""
        (height, width), (left, top, right, bottom) = shape, self.box
        numbers = np.arange(height * width).reshape(height, width)
        return numbers[top : max(height - bottom, 0), left : max(width - right, 0)].ravel()

    def vectors(self, layers: Layers, pixels: Integers) -> NDArray[np.uint8]:
        """Return the neighborhoods of some pixels, ``uint8 (n, t C)``."""
        values, starts, steps = layers.reshape(-1), pixels * layers.shape[3], self.steps(layers)
        found = np.empty((len(pixels), len(steps)), np.uint8)
        for column, step in enumerate(steps.tolist()):
            found[:, column] = values[starts + step]
        return found


def layers_of(*pictures: Image) -> Layers:
    """Return the texture, and its mask, as layers."""
    return np.stack([to_bytes(picture) for picture in pictures])


def _window(size: int) -> tuple[Integers, Integers]:
    y, x = np.indices((size, size)).reshape(2, -1) - size // 2
    return x, y
