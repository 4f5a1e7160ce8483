"""Where windows of an image lie in a patch of the periodic image, to about a pixel."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from nrbench.imaging.fold import Values
from nrbench.imaging.registration import Map, Template, peaks

from .bank import Bank


@dataclass(frozen=True)
class Places:
    """A patch of the periodic image, looked at within one cell of displacements.

    Parameters
    ----------
    template
        The patch.
    inside
        ``bool``: at which of its offsets a window may lie.
    size
        Pixels each way of a window that are taken together: 1, or 2 where tiles are large. The offsets stay single
        pixels, of which all that are even, or odd, along each axis are looked at together; a window so costs a quarter.
    """

    template: Template
    inside: NDArray[np.bool_]
    size: int

    def find(self, windows: Values) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Return where each window ``(n, h, w, C)`` fits best, ``(n, 2)`` as (x, y) in the patch, and its NCC there."""
        surfaces = np.full((len(windows), *self.inside.shape), -1, np.float32)
        few = binned(windows, self.size)
        for row, column, bank in self._banks:
            surfaces[:, row :: self.size, column :: self.size] = bank.surfaces(bank.compare(few)[0])
        return peaks(surfaces, self.inside)

    @cached_property
    def _banks(self) -> tuple[tuple[int, int, Bank], ...]:
        """Return the first offset along y and x of each set of offsets, and the bank that looks at it."""
        return tuple(self._split())

    def _split(self) -> Iterator[tuple[int, int, Bank]]:
        image, weights = smoothed(self.template.image, self.size), smoothed(self.template.weights, self.size)
        where = ndimage.binary_dilation(self.inside)
        height, width = (side // self.size for side in self.template.window)
        for row, column in np.ndindex(self.size, self.size):
            wanted = where[row :: self.size, column :: self.size]
            rows, columns = wanted.shape[0] + height - 1, wanted.shape[1] + width - 1
            few = np.s_[row :: self.size, column :: self.size]
            template = Template(image[few][:rows, :columns], weights[few][:rows, :columns], (height, width))
            yield row, column, Bank(template, wanted)


def smoothed(plane: Map, size: int) -> Map:
    """Return at each pixel the mean over the ``size`` x ``size`` pixels of which it is the first, ``(H, W, ...)``."""
    for axis in (0, 1):
        parts = [np.take(plane, np.arange(k, plane.shape[axis] - size + 1 + k), axis) for k in range(size)]
        plane = np.asarray(np.mean(parts, 0), np.float32)
    return plane


def binned(images: Values, size: int) -> Values:
    """Return images ``(n, H, W, C)`` whose pixels are means over ``size`` x ``size``; what is left over is cut off."""
    n, height, width, channels = images.shape
    whole = images[:, : height // size * size, : width // size * size]
    blocks = whole.reshape(n, height // size, size, width // size, size, channels)
    return np.asarray(blocks.mean((2, 4)), np.float32) if size > 1 else images
