"""The shape of texels: a quadrilateral or hexagon that the lattice repeats, and the zone that neighbors share."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from functools import cached_property
from typing import Final

import numpy as np
from numpy.typing import NDArray

from nrbench.lattice.geometry import Lattice, Points

Step = tuple[int, int]
"""A lattice vector, in steps along the first and the second vector, from a texel to another one."""
NEIGHBORS: Final[tuple[Step, ...]] = tuple((u, v) for u in (-1, 0, 1) for v in (-1, 0, 1) if u or v)


@dataclass(frozen=True, eq=False)
class TexelShape:
    """A convex texel, symmetric about its middle, that tiles the plane when a lattice repeats it.

    Parameters
    ----------
    lattice
        Its points are the middles of the texels. All texels that meet are one step along either or both vectors apart.
    normals
        ``(k, 2)``: unit vectors across the pairs of parallel sides, two or three.
    halves
        ``(k,)`` px: distance of each side from the middle.
    zone
        Breadth, px, of the zone that two neighbors share: each reaches half of it beyond its sides.
    """

    lattice: Lattice
    normals: Points
    halves: NDArray[np.float64]
    zone: float

    @classmethod
    def of(cls, lattice: Lattice, corners: Points, zone: float) -> TexelShape:
        """Return the texel with some corners.

        Parameters
        ----------
        lattice
            Its points are the middles.
        corners
            ``(2 k, 2)`` px: the corners from the middle, in order around it; two may coincide.
        zone
            As in the class. It is made no broader than the texel.
        """
        sides = np.roll(corners, -1, 0)[: len(corners) // 2] - corners[: len(corners) // 2]
        lengths = np.hypot(*sides.T)
        kept = lengths > 1e-6
        normals = np.column_stack([-sides[:, 1], sides[:, 0]])[kept] / lengths[kept, np.newaxis]
        halves = np.abs((normals * corners[: len(corners) // 2][kept]).sum(1))
        return cls(lattice, normals, halves, min(zone, 2 * float(halves.min())))

    def ramp(self, points: Points) -> NDArray[np.float64]:
        """Return how far points ``(..., 2)`` px from the middle are inside: 0 to 1 across the zone, 1/2 on a side."""
        inside = (self.halves - np.abs(points @ self.normals.T)).min(-1)
        return np.asarray(np.clip(0.5 + inside / max(self.zone, 1e-9), 0, 1))

    def weights(self, points: Points) -> Iterator[tuple[NDArray[np.int64], NDArray[np.float64]]]:
        """Yield cell coordinates of texels near points ``(n, 2)`` px, ``(n, 2)``, and their weights there, ``(n,)``.

        The weights of all texels at a point add up to 1. They fall linearly across the zone of two neighbors. If each
        new texel were feathered onto those pasted before, the weights would be the same, but for the corners where
        three meet.
        """
        near = np.rint(self.lattice.to_cell(points)).astype(np.int64)
        numbers = [near + step for step in ((0, 0), *NEIGHBORS)]
        ramps = [self.ramp(points - self.lattice.from_cell(number)) for number in numbers]
        total = np.sum(ramps, 0)
        for number, ramp in zip(numbers, ramps, strict=True):
            yield number, ramp / total

    @cached_property
    def pixels(self) -> Points:
        """``(n, 2)``: the whole-pixel points from the middle that the texel and its zone hold."""
        reach = int(np.ceil(2 * np.hypot(*self.lattice.matrix.T).max() + self.zone))
        side = np.arange(-reach, reach + 1.0)
        points = np.stack(np.meshgrid(side, side), -1).reshape(-1, 2)
        return points[self.ramp(points) > 0]

    @cached_property
    def rim(self) -> Points:
        """``(n, 2)`` px: the outermost of :attr:`pixels`."""
        steps = np.array([(1, 0), (-1, 0), (0, 1), (0, -1)])
        return np.asarray(self.pixels[(self.ramp(self.pixels[:, np.newaxis] + steps) == 0).any(1)])

    def shared_zone(self, step: Step) -> Points:
        """Return the :attr:`pixels` of the zone that a texel shares with the one at a step, ``(n, 2)``."""
        return np.asarray(self.pixels[self.ramp(self.pixels - np.array(step) @ self.lattice.matrix) > 0])
