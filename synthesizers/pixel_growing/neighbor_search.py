"""Search for nearest neighborhoods: projection of pixel values to few dimensions, and a k-d tree of the points."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from .pixel_growing_kernels import UNBOUNDED, TreeArrays, build_tree, search_queries

TreePoints = NDArray[np.int16]
"""``int16 (n, d)``. TreePoints and queries are within 32 767 of each other, so that differences fit into 16 bits and
squared distances into 31 bits."""
Integers = NDArray[np.int64]
Vectors = NDArray[np.uint8]
"""``uint8 (n, D)``: pixel values, channel by channel."""

FARTHEST = 30000.0
"""Largest distance of two points, so that differences fit into 16 bits and squared distances into 31 bits."""
FINEST = 16
"""Largest number of units per gray level. Values of 8 bits need no finer units."""
BLOCK = 1 << 15
"""Number of vectors that are converted to floats at a time, to limit the memory."""
LANES = 16
"""Dimensions are padded with zeros to a multiple of this, for vector instructions."""


@dataclass(frozen=True, eq=False)
class Projection:
    """A linear mapping of pixel values to points: ``(matrix @ values + shift) >> bits``.

    The matrix is computed once in floating point and rounded to integers. All later arithmetic is in integers, so that
    neither the order of summation nor the machine changes which neighborhood is nearest. (The last bits of an
    eigenvector differ between linear algebra libraries. The rounding removes this difference, except for a rare
    coefficient halfway between two integers.)

    Parameters
    ----------
    matrix
        ``int16 (d, D)``.
    shift
        ``int32 (d,)``: moves the mean of the vectors to 0.
    bits
        Number of binary digits of the matrix after the point.
    units
        Units of a point's coordinates per gray level.
    leading
        Number of leading coordinates of a point whose norm is one of its own; d if there is one norm.
    """

    matrix: NDArray[np.int16]
    shift: NDArray[np.int32]
    bits: int
    units: int
    leading: int

    @classmethod
    def fit(
        cls, vectors: Vectors, weights: NDArray[np.float64], dimensions: int, mask: NDArray[np.bool_] | None = None
    ) -> Projection:
        """Return the projection on the principal components of the vectors.

        Parameters
        ----------
        vectors
            At least one.
        weights
            ``(D,)``: weight of each value's squared difference, at least 0.
        dimensions
            Number of components. 0, or at least D: the weighted values themselves, without principal components.
        mask
            ``(D,)``: the values whose norm is one of its own. No component mixes them with the others; those of the
            others are the leading ones. None: there is one norm.
        """
        width, roots = vectors.shape[1], np.sqrt(weights)
        apart = np.zeros(width, np.bool_) if mask is None else mask
        rows = _components(vectors, roots, dimensions, apart) if 0 < dimensions < width else np.eye(width)
        masked = apart[np.abs(rows).argmax(1)]
        rows = rows[np.argsort(masked, kind="stable")]
        weighted = rows * roots
        norm, units = float(np.sqrt(weights.sum())) * 255, FINEST
        while units > 1 and norm * units > FARTHEST:
            units //= 2
        bits = min(int(np.floor(np.log2(32767 / max(float(np.abs(weighted).max()) * units, 1e-9)))), 15)
        matrix = np.zeros((_round_up(len(rows)), _round_up(width)), np.int16)
        matrix[: len(rows), :width] = np.rint(weighted * units * 2.0**bits)
        total = matrix[:, :width].astype(np.int64) @ vectors.sum(0, dtype=np.int64)
        leading = len(matrix) if mask is None else int((~masked).sum())
        return cls(matrix, (-(total // len(vectors))).astype(np.int32), bits, units, leading)

    def points(self, vectors: Vectors) -> TreePoints:
        """Return the points of some vectors, ``int16 (n, d)``, equal to those that compiled loops compute."""
        matrix = self.matrix[:, : vectors.shape[1]].astype(np.float64)
        points = np.empty((len(vectors), len(matrix)), np.int16)
        for start in range(0, len(vectors), BLOCK):
            products = (vectors[start : start + BLOCK].astype(np.float64) @ matrix.T).astype(np.int64)
            points[start : start + BLOCK] = (products + self.shift) >> self.bits
        return points


def _components(
    vectors: Vectors, scales: NDArray[np.float64], count: int, apart: NDArray[np.bool_]
) -> NDArray[np.float64]:
    """Return the strongest principal components of the scaled vectors, ``(count, D)``, orthonormal.

    No component mixes values that are ``apart (D,)`` with others. The second moments are sums of integers, exact in
    float64.
    """
    mean = vectors.sum(0, dtype=np.int64) / len(vectors)
    moments = np.zeros((vectors.shape[1], vectors.shape[1]))
    for start in range(0, len(vectors), BLOCK):
        values = vectors[start : start + BLOCK].astype(np.float64)
        moments += values.T @ values
    covariance = (moments / len(vectors) - np.outer(mean, mean)) * (apart[:, np.newaxis] == apart)
    _, rows = np.linalg.eigh(covariance * np.outer(scales, scales))
    strongest = rows.T[::-1][:count]
    peaks = np.take_along_axis(strongest, np.abs(strongest).argmax(1)[:, np.newaxis], 1)
    return np.asarray(strongest * np.where(peaks < 0, -1, 1))


def _round_up(count: int) -> int:
    return -(-count // LANES) * LANES


@dataclass(frozen=True, eq=False)
class KdTree:
    """A k-d tree for each of several groups of integer points.

    :class:`scipy.spatial.cKDTree` is no alternative: it computes in floating point, breaks ties arbitrarily, and cannot
    be searched inside a compiled loop, where each query depends on earlier pixels.

    Parameters
    ----------
    arrays
        The arrays of the tree for compiled loops.
    order
        ``(n,)``: the number of the point at each place of the tree.
    """

    arrays: TreeArrays
    order: Integers

    @classmethod
    def build(
        cls,
        points: TreePoints,
        ranks: Integers | None = None,
        groups: Integers | None = None,
        leaf: int = 8,
        leading: int | None = None,
    ) -> KdTree:
        """Build the tree, O(n d log n).

        Parameters
        ----------
        points
            At least one.
        ranks
            ``(n,)``, in [0, 2^32): of points at the same distance, the one of least rank counts as the nearest. None:
            the number of the point.
        groups
            ``(n,)``: each point's group, from 0 on, none empty. Groups are searched separately. None: one group.
        leaf
            The largest number of points of a leaf. With n the search is exhaustive.
        leading
            Number of leading coordinates: the distance is their norm plus that of the others. None: one norm of all.
        """
        n = len(points)
        labels = np.zeros(n, np.int64) if groups is None else groups
        order = np.argsort(labels, kind="stable")
        bounds = np.concatenate([[0], np.cumsum(np.bincount(labels))])
        roots = np.zeros(len(bounds) - 1, np.int64)
        lows, highs = (reduce.reduceat(points[order], bounds[:-1]) for reduce in (np.minimum, np.maximum))
        nodes = build_tree(points, order, bounds, roots, leaf)
        placed = (np.arange(n) if ranks is None else ranks)[order]
        leading = points.shape[1] if leading is None else leading
        return cls(TreeArrays(np.ascontiguousarray(points[order]), placed, nodes, roots, lows, highs, leading), order)

    def nearest(
        self, queries: TreePoints, k: int = 1, eps: float = 0.0, groups: Integers | None = None
    ) -> tuple[Integers, Integers]:
        """Find the k points nearest to each query, the nearest first.

        Parameters
        ----------
        queries
            ``(q, d)``.
        k
            Number of points.
        eps
            The distance of each returned point is at most (1 + eps) times the exact one. 0: the search is exact, and
            ranks break ties.
        groups
            ``(q,)``: the group to search. None: the first.

        Returns
        -------
        numbers
            ``(q, k)``: the numbers of the points; -1 if the group has fewer points.
        distances
            ``(q, k)``: their squared distances; -1 if the group has fewer points.
        """
        keys, places = np.full((len(queries), k), UNBOUNDED), np.full((len(queries), k), -1, np.int64)
        labels = np.zeros(len(queries), np.int64) if groups is None else groups
        search_queries(self.arrays, labels, queries, (1.0 + eps) ** 2, keys, places)
        return np.where(places < 0, -1, self.order[places]), np.where(places < 0, -1, keys >> 32)
