"""Where windows of an image lie in a patch of the periodic image, to about a pixel."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from .colors import Colors, Planes
from .registration import Template, peaks
from .scan import Scan


@dataclass(frozen=True)
class Places:
    """A patch of the periodic image, looked at within one cell of displacements.

    Parameters
    ----------
    template
        The patch, its colors along the axes.
    inside
        ``bool``: at which of its offsets a window may lie.
    colors
        The axes.
    size
        Pixels each way of a window that are taken together: 1, or 2 where tiles are large. The offsets stay single
        pixels; a window so costs a quarter.
    """

    template: Template
    inside: NDArray[np.bool_]
    colors: Colors
    size: int

    def find(self, planes: Planes, corners: NDArray[np.intp]) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Return where each window at ``corners`` fits best, ``(n, 2)`` as (x, y) in the patch, and its NCC there."""
        ncc = np.concatenate(list(self._scan.maps(planes, corners)))
        surfaces = np.full((len(ncc), *self.inside.shape), -1, np.float32)
        surfaces[:, self._scan.where] = ncc
        return peaks(surfaces, self.inside)

    @cached_property
    def _scan(self) -> Scan:
        """All offsets, and those around them that a parabola through a peak needs."""
        return Scan(self.template, ndimage.binary_dilation(self.inside), self.colors, (self.size, 2 * self.size))
