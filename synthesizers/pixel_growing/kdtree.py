"""A kd-tree of whole-number points, searched from compiled loops."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from .kdtree_kernels import Arrays, build, search_all

Points = NDArray[np.int16]
"""``int16 (n, d)``. Points and queries lie so near to each other that differences fit 16 bits and squared distances 31:
what is within 32 767 of each other."""
Integers = NDArray[np.int64]

UNBOUNDED = np.int64(2**63 - 1)
"""A key beyond that of any point."""


@dataclass(frozen=True, eq=False)
class KdTree:
    """A kd-tree over each of several groups of points.

    Parameters
    ----------
    arrays
        What kernels see, see :data:`~nrbench.synthesizers.pixel_growing.kdtree_kernels.Arrays`.
    roots
        ``(g,)``: the node to start from in each group.
    order
        ``(n,)``: which point stands where in the tree's order.
    """

    arrays: Arrays
    roots: Integers
    order: Integers

    @classmethod
    def of(cls, points: Points, ranks: Integers | None = None, groups: Integers | None = None, leaf: int = 8) -> KdTree:
        """Build the tree, O(n d log n).

        Parameters
        ----------
        points
            At least one.
        ranks
            ``(n,)``, in [0, 2^32): of points at one distance the one of least rank is the nearest. None: the first.
        groups
            ``(n,)``: each point's group, from 0 on, none empty; searched apart. None: one for all.
        leaf
            Most points of a leaf; with n the search is exhaustive.
        """
        n = len(points)
        labels = np.zeros(n, np.int64) if groups is None else groups
        order = np.argsort(labels, kind="stable")
        bounds = np.concatenate([[0], np.cumsum(np.bincount(labels))])
        roots = np.zeros(len(bounds) - 1, np.int64)
        boxes = [reduce.reduceat(points[order], bounds[:-1]) for reduce in (np.minimum, np.maximum)]
        nodes = build(points, order, bounds, roots, leaf)
        placed = (np.arange(n) if ranks is None else ranks)[order]
        return cls((np.ascontiguousarray(points[order]), placed, nodes, boxes[0], boxes[1]), roots, order)

    def nearest(
        self, queries: Points, k: int = 1, eps: float = 0.0, groups: Integers | None = None
    ) -> tuple[Integers, Integers]:
        """Return the k points that are nearest to each query, nearest first.

        Parameters
        ----------
        queries
            ``(q, d)``.
        k
            How many.
        eps
            Each point returned is at most (1 + eps) times as far as the one that is due; 0: exact, ties by rank.
        groups
            ``(q,)``: the group to look in. None: the first.

        Returns
        -------
        numbers
            ``(q, k)``: of points; -1 where the group has fewer.
        distances
            ``(q, k)``: squared; -1 there.
        """
        keys, found = np.full((len(queries), k), UNBOUNDED), np.full((len(queries), k), -1, np.int64)
        labels = np.zeros(len(queries), np.int64) if groups is None else groups
        search_all(self.arrays, self.roots, labels, queries, (1.0 + eps) ** 2, keys, found)
        return np.where(found < 0, -1, self.order[found]), np.where(found < 0, -1, keys >> 32)
