"""The texels of a sample, and how well each fits beside each other one."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property, lru_cache

import numpy as np
import scipy
from numpy.typing import NDArray

from nrbench.imaging.convert import Image
from nrbench.lattice.geometry import Points

from .texel_shape import NEIGHBORS, Step, TexelShape

_CHUNK = 1 << 16
"""Number of points of the sample that are read at a time."""
_KEPT = 1 << 22
"""Number of differences that are kept, 32 MiB."""


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

    def zone_size(self, step: Step) -> int:
        """Return the number of points of the zone that a texel shares with the one at a step."""
        return len(self._zones[min(step, _opposite(step))][0])

    def differences(self, step: Step, there: int) -> NDArray[np.float64]:
        """Return how each texel differs from one beside it, in the zone that they share, ``(n,)``.

        Squared differences are summed over the points of the zone and averaged over channels. All texels lie on the
        lattice, so that these numbers hold wherever the two meet.

        Parameters
        ----------
        step
            From each texel to the one beside it.
        there
            The number of the texel beside it.

        Notes
        -----
        The first call for a step and a texel takes O(n zone). At most :data:`_KEPT` numbers are kept for later calls;
        n x n tables would take hundreds of MiB where the sample holds thousands of texels.
        """
        return self._differences(step, there)

    @cached_property
    def _differences(self) -> Callable[[Step, int], NDArray[np.float64]]:
        return lru_cache(max(1, _KEPT // max(len(self.middles), 1)))(self._compute_differences)

    def _compute_differences(self, step: Step, there: int) -> NDArray[np.float64]:
        """Compute :meth:`differences`; a step and its opposite share a zone, so that they agree on every pair."""
        forward = min(step, _opposite(step))
        points, own, other = self._zones[forward]
        if not len(points):
            return np.zeros(len(self.middles))
        here, beside = (own, other) if step == forward else (other, own)
        squares = scipy.spatial.distance.cdist(beside[there : there + 1], here, "sqeuclidean")[0]
        return np.asarray(squares / (here.shape[1] // len(points)))

    @cached_property
    def _zones(self) -> dict[Step, tuple[Points, NDArray[np.float64], NDArray[np.float64]]]:
        """For each forward step: points of the shared zone, their values in each texel, and in each as the other."""
        zones = {}
        for step in NEIGHBORS:
            if step < _opposite(step):
                points = self.shape.shared_zone(step)
                beside = points - np.array(step) @ self.shape.lattice.matrix
                zones[step] = points, self._values(points), self._values(beside)
        return zones

    def _values(self, offsets: Points) -> NDArray[np.float64]:
        """Return the values of each texel at offsets ``(m, 2)`` from its middle, as ``(n, m C)``."""
        if not len(offsets):
            return np.zeros((len(self.middles), 0))
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


def _opposite(step: Step) -> Step:
    return -step[0], -step[1]
