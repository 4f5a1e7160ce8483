"""The straightened residual of a picture on few places of each cell."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from ..perception import limits
from .lattice_net import Mask, Values, split_cells
from .net_kernels import average_blocks


@dataclass(frozen=True, eq=False)
class CoarsePlane:
    """The residual of a straightened picture: what differs from the mean cell.

    Parameters
    ----------
    fine, known
        ``(N1 n1, N2 n2, 3)`` residual in the order of a net, and its known points.
    samples
        (n1, n2): samples of a cell.
    """

    fine: Values
    known: Mask
    samples: NDArray[np.intp]

    @cached_property
    def _means(self) -> tuple[Values, Mask]:
        fine = np.ascontiguousarray(self.fine, np.float32)
        means, share = average_blocks(fine, self.known, *self.samples // limits.PLACES)
        complete = share > 0.99
        return np.where(complete[..., np.newaxis], means, 0).astype(np.float32), complete

    @property
    def values(self) -> Values:
        """``(8 N1, 8 N2, 3)``: means over the places of each cell; 0 where unknown."""
        return self._means[0]

    @property
    def complete(self) -> Mask:
        """``(8 N1, 8 N2)``: the places all of whose points are known."""
        return self._means[1]

    @property
    def cells(self) -> Values:
        """``(N1, N2, 8, 8, 3)``: the values cell by cell."""
        return split_cells(self.values, (limits.PLACES, limits.PLACES))

    @property
    def whole(self) -> Mask:
        """``(N1, N2)``: the cells all of whose places are known."""
        return np.asarray(split_cells(self.complete, (limits.PLACES, limits.PLACES)).all((2, 3)))


def shift_plane(values: Values, known: Mask, lag: tuple[int, int]) -> tuple[Values, Mask]:
    """Return a plane moved by a lag in its samples, and the points that are known before and after the move."""
    moved, both = np.zeros_like(values), np.zeros_like(known)
    to, source = [], []
    for side, step in zip(known.shape, lag, strict=True):
        to.append(slice(max(-step, 0), side + min(-step, 0)))
        source.append(slice(max(step, 0), side + min(step, 0)))
    moved[tuple(to)], both[tuple(to)] = values[tuple(source)], known[tuple(source)]
    return moved, both & known
