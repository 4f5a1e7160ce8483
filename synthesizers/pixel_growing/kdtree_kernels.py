"""The compiled loops of a kd-tree: build, search, distance.

Coordinates are whole numbers of 16 bits, and so are their differences; squared distances fit 32 bits. All sums are
exact: no order of summation, and no machine, changes which point is nearest.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from nrbench.jit import kernel

Arrays = tuple[NDArray[np.int16], NDArray[np.int64], NDArray[np.int32], NDArray[np.int16], NDArray[np.int16]]
"""A tree as kernels see it: ``points (n, d)`` in the tree's order, their ``ranks (n,)``, ``nodes (m, 6)``, and the
``lows`` and ``highs (g, d)`` of each root's box. A node is first point, last point + 1, axis (-1: a leaf), the greatest
coordinate of its left child along it, the least of its right, and where the right child is; the left one follows it."""
TREE = "Tuple((int16[:, ::1], int64[::1], int32[:, ::1], int16[:, ::1], int16[:, ::1]))"
"""The same, to numba."""
DEEPEST = 160
"""Rows of a search's stack: two a level, of trees of at most 2^32 points split at their medians."""


@kernel("void(int16[::1], int64[::1], int64, int64, int64)")
def split(values: NDArray[np.int16], order: NDArray[np.int64], start: int, stop: int, middle: int) -> None:
    """Move the values from ``start`` to ``stop`` so that none before ``middle`` exceeds one from there on.

    ``order`` moves along. Hoare's selection, O(stop - start) on average, with equal values shared between both sides.
    """
    low, high = start, stop - 1
    while low < high:
        pivot = values[(low + high) // 2]
        i, j = low, high
        while i <= j:
            while values[i] < pivot:
                i += 1
            while values[j] > pivot:
                j -= 1
            if i <= j:
                values[i], values[j] = values[j], values[i]
                order[i], order[j] = order[j], order[i]
                i += 1
                j -= 1
        if middle <= j:
            high = j
        elif middle >= i:
            low = i
        else:
            return


@kernel("int64(int16[:, ::1], int64[::1], int64, int64)")
def widest_axis(points: NDArray[np.int16], order: NDArray[np.int64], start: int, stop: int) -> int:
    """Return the axis along which some points vary most (by the sum of squares about the mean); -1: they are one."""
    count, best, axis = np.int64(stop - start), np.int64(0), -1
    for a in range(points.shape[1]):
        total, squares = np.int64(0), np.int64(0)
        for i in range(start, stop):
            value = np.int64(points[order[i], a])
            total += value
            squares += value * value
        spread = squares - total * total // count
        if spread > best:
            best, axis = spread, a
    return axis


@kernel("int32[:, ::1](int16[:, ::1], int64[::1], int64[::1], int64[::1], int64)")
def build(
    points: NDArray[np.int16],
    order: NDArray[np.int64],
    bounds: NDArray[np.int64],
    roots: NDArray[np.int64],
    leaf: int,
) -> NDArray[np.int32]:
    """Return the nodes of a tree over each group of points, halved at the median of their widest axis.

    Parameters
    ----------
    points
        ``(n, d)``.
    order
        ``(n,)``: which points, group after group; rearranged into the trees' order.
    bounds
        ``(g + 1,)``: where each group starts, and n.
    roots
        ``(g,)``, written: each group's root.
    leaf
        Most points of a leaf; points that are all alike are one, however many.
    """
    nodes = np.empty((2 * order.size + 1, 6), np.int32)
    values = np.empty(order.size, np.int16)
    todo = np.empty((DEEPEST, 3), np.int64)
    count = 0
    for g in range(roots.size):
        roots[g] = count
        todo[0, 0], todo[0, 1], todo[0, 2] = bounds[g], bounds[g + 1], -1
        top = 1
        while top > 0:
            top -= 1
            start, stop, parent = todo[top, 0], todo[top, 1], todo[top, 2]
            if parent >= 0:
                nodes[parent, 5] = count
            node = nodes[count]
            node[0], node[1], node[2], node[3], node[4], node[5] = start, stop, -1, 0, 0, -1
            axis = widest_axis(points, order, start, stop) if stop - start > leaf else -1
            if axis >= 0:
                middle = (start + stop) // 2
                for i in range(start, stop):
                    values[i] = points[order[i], axis]
                split(values, order, start, stop, middle)
                node[2], node[3], node[4] = axis, values[start:middle].max(), values[middle:stop].min()
                todo[top, 0], todo[top, 1], todo[top, 2] = middle, stop, count
                todo[top + 1, 0], todo[top + 1, 1], todo[top + 1, 2] = start, middle, -1
                top += 2
            count += 1
    return nodes[:count].copy()


@kernel("int32(int16[::1], int16[::1])")
def squared_distance(one: NDArray[np.int16], other: NDArray[np.int16]) -> np.int32:
    """Return the squared distance of two points."""
    total = np.int32(0)
    for a in range(one.size):
        difference = np.int16(one[a] - other[a])
        total = np.int32(total + np.int32(difference) * np.int32(difference))
    return total


@kernel(f"void({TREE}, int64, int64, int16[::1], float64, int64[::1], int64[::1], int64[:, ::1], int64[::1])")
def search(
    tree: Arrays,
    group: int,
    root: int,
    query: NDArray[np.int16],
    shrink: float,
    keys: NDArray[np.int64],
    found: NDArray[np.int64],
    stack: NDArray[np.int64],
    gaps: NDArray[np.int64],
) -> None:
    """Find the points of one group that are nearest to a query, nearer than what is known already.

    Boxes are left out whose distance shows that they hold nothing nearer (Arya and Mount's incremental distances: one
    axis changes at each step down). O(log n) where the points have few dimensions in truth, O(n) at worst.

    Parameters
    ----------
    tree
        See :data:`Arrays`.
    group, root
        Whose box and whose node to start from.
    query
        ``(d,)``.
    shrink
        (1 + eps)^2: boxes are left out that hold nothing nearer by this factor (squared); 1 is exact.
    keys
        ``(k,)``, rising, read and written: squared distance times 2^32 plus rank: of points at one distance the one
        with the lowest rank counts as the nearest.
    found
        ``(k,)``, written: places of the points in the tree's order; what is not nearer than the keys stays.
    stack, gaps
        Room to work in: ``(DEEPEST, 4)`` and ``(d,)``.
    """
    points, ranks, nodes, lows, highs = tree
    last = keys.size - 1
    distance = np.int64(0)
    for a in range(query.size):
        beyond = max(np.int64(lows[group, a]) - query[a], np.int64(query[a]) - highs[group, a], np.int64(0))
        gaps[a] = beyond * beyond
        distance += gaps[a]
    stack[0, 0], stack[0, 1], stack[0, 2] = root, distance, -1
    top = 1
    while top > 0:
        top -= 1
        at, distance, axis = stack[top, 0], stack[top, 1], stack[top, 2]
        if at < 0:
            gaps[axis] = distance
            continue
        if distance * shrink > keys[last] >> 32:
            continue
        if axis >= 0:
            gaps[axis] = stack[top, 3]
        while nodes[at, 2] >= 0:
            axis = np.int64(nodes[at, 2])
            value = np.int64(query[axis])
            left, right = nodes[at, 3] - value, nodes[at, 4] - value
            near, far, cut = (at + 1, np.int64(nodes[at, 5]), right) if left + right > 0 else (
                np.int64(nodes[at, 5]), at + 1, left
            )  # fmt: skip
            farther = distance - gaps[axis] + cut * cut
            if farther * shrink <= keys[last] >> 32:
                stack[top, 0], stack[top, 1], stack[top, 2] = -1, gaps[axis], axis
                stack[top + 1, 0], stack[top + 1, 1], stack[top + 1, 2], stack[top + 1, 3] = (
                    far,
                    farther,
                    axis,
                    cut * cut,
                )
                top += 2
            at = near
        for p in range(nodes[at, 0], nodes[at, 1]):
            key = (np.int64(squared_distance(query, points[p])) << 32) + ranks[p]
            if key < keys[last]:
                i = last
                while i > 0 and keys[i - 1] > key:
                    keys[i], found[i] = keys[i - 1], found[i - 1]
                    i -= 1
                keys[i], found[i] = key, p


@kernel(f"void({TREE}, int64[::1], int64[::1], int16[:, ::1], float64, int64[:, ::1], int64[:, ::1])")
def search_all(
    tree: Arrays,
    roots: NDArray[np.int64],
    groups: NDArray[np.int64],
    queries: NDArray[np.int16],
    shrink: float,
    keys: NDArray[np.int64],
    found: NDArray[np.int64],
) -> None:
    """Run :func:`search` for each of ``queries (q, d)`` in its group; keys and found are ``(q, k)``."""
    stack, gaps = np.empty((DEEPEST, 4), np.int64), np.empty(queries.shape[1], np.int64)
    for q in range(queries.shape[0]):
        group = groups[q]
        search(tree, group, roots[group], queries[q], shrink, keys[q], found[q], stack, gaps)
