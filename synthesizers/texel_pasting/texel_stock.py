"""The texels of a sample, and how well each fits beside each other one."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from nrbench.imaging.convert import Image
from nrbench.lattice.geometry import Points

from .texel_shape import NEIGHBORS, Step, TexelShape

_CHUNK = 1 << 20
"""Number of points of the sample that are read at a time."""


@dataclass(frozen=True, eq=False)
class TexelStock:
    """The texels that a sample holds with their zones.

    Parameters
    ----------
    shape
        Their shape, and the lattice of their middles.
    middles
        ``(n, 2)``: the middle (x, y) px of each texel.
    read
        Returns the values of the sample at points ``(..., 2)``, as ``(..., C)``.
    """

    shape: TexelShape
    middles: Points
    read: Callable[[Points], Image]

    @classmethod
    def of(
        cls,
        shape: TexelShape,
        box: tuple[Points, Points],
        holds: Callable[[Points], NDArray[np.bool_]],
        read: Callable[[Points], Image],
    ) -> TexelStock:
        """Return all texels that the sample holds.

        Parameters
        ----------
        shape, read
            As in the class.
        box
            Least and greatest (x, y) px of the middles that are tried.
        holds
            Whether the sample shows points, ``(..., 2)`` to ``(...)``.
        """
        middles = shape.lattice.from_cell(shape.lattice.cell_numbers(*box))
        middles = middles[holds(middles[:, np.newaxis] + shape.rim).all(1)]
        return cls(shape, middles, read)

    @cached_property
    def zones(self) -> dict[Step, tuple[int, NDArray[np.float64]]]:
        """For each neighbor the points of the shared zone, and the sum of squared differences, ``(n, n)``.

        Row i, column j: texel i in place, texel j beside it. Differences are summed over points and averaged over
        channels. All texels lie on the lattice, so that these numbers hold wherever two texels meet. O(n^2 zone).
        """
        found: dict[Step, tuple[int, NDArray[np.float64]]] = {}
        for step in NEIGHBORS:
            back = (-step[0], -step[1])
            if back in found:
                found[step] = found[back][0], found[back][1].T
                continue
            points = self.shape.shared_zone(step)
            if not len(points):
                found[step] = 0, np.zeros((len(self.middles), len(self.middles)))
                continue
            own = self._values(points)
            other = self._values(points - np.array(step) @ self.shape.lattice.matrix)
            cross = (own**2).sum(1)[:, np.newaxis] + (other**2).sum(1) - 2 * own @ other.T
            channels = own.shape[1] // len(points)
            found[step] = len(points), np.maximum(cross, 0) / channels
        return found

    def _values(self, offsets: Points) -> NDArray[np.float64]:
        """Return the values of each texel at offsets ``(m, 2)`` from its middle, as ``(n, m C)``."""
        step = max(1, _CHUNK // len(offsets))
        parts = [
            self.read(self.middles[first : first + step, np.newaxis] + offsets)
            for first in range(0, len(self.middles), step)
        ]
        values = np.concatenate(parts).astype(np.float64)
        return values.reshape(len(values), -1)

    @cached_property
    def power(self) -> float:
        """Mean square of the values on the rims."""
        values = self._values(self.shape.rim)
        return float((values**2).mean())
