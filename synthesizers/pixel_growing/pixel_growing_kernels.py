"""The compiled loops of pixel-based synthesis: build and search a k-d tree, and synthesize an output pixel by pixel.

Coordinates and their differences are integers of 16 bits; squared distances fit into 32 bits. All sums are exact, so
that neither the order of summation nor the machine changes which point is nearest.
"""

from __future__ import annotations

import math

import numpy as np

from nrbench.jit import Int16x1, Int16x2, Int32x1, Int32x2, Int64x1, Int64x2, UInt8x1, UInt8x2, kernel, step_kernel

UNBOUNDED = np.int64(2**63 - 1)
"""A key larger than that of any point."""
DEEPEST = 160
"""Rows of a search's stack: two per level, for trees of at most 2^32 points that are split at their medians."""
TreeArrays = tuple[Int16x2, Int64x1, Int32x2, Int16x2, Int16x2, int]
"""A k-d tree: ``points (n, d)`` in the tree's order, their ``ranks (n,)``, ``nodes (m, 6)``, the ``lows`` and
``highs (g, d)`` of each root's box, and the number of ``leading`` coordinates, see :func:`key_of`. The columns of a
node are its first point, its last point + 1, its axis (-1: a leaf), the largest coordinate of its left child along this
axis, the smallest of its right child, and the number of the right child. The left child is the next node."""
CanvasArrays = tuple[UInt8x1, Int64x2, Int64x1]
"""The output: the flat ``values`` of its layers, with their border; ``sources (P, Q)``: each pixel's source in the
sample, -1 if it has none; ``frame``: the number of rows and of columns after which the output repeats, and the rows and
columns of the border at its top and left."""
StockArrays = tuple[UInt8x2, Int64x1, Int64x1, Int64x2, int]
"""The sample: its ``colors (h w, C)``; ``pixels (n,)``: the pixel at each place of the tree; ``places (h w,)``: the
place of each pixel, -1 if its neighborhood is incomplete; ``similar (n, k)``: the places most similar to each; the
sample's width."""
QueryArrays = tuple[Int64x1, Int16x2, Int32x1, int, Int64x2]
"""A neighborhood: ``steps (D,)`` from a pixel's first value to its neighborhood's; the projection's ``matrix``,
``shift`` and ``bits``; ``texture_offsets (m, 2)``: the offsets (x, y) whose sources are continued."""


@kernel
def split_at_middle(values: Int16x1, order: Int64x1, start: int, stop: int, middle: int) -> None:
    """Reorder the values from ``start`` to ``stop`` so that no value before ``middle`` exceeds a later one.

    ``order`` is reordered in the same way. This is Hoare's selection, O(stop - start) on average; values equal to the
    pivot go to both sides.
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


@kernel
def widest_axis(points: Int16x2, order: Int64x1, start: int, stop: int) -> int:
    """Return the axis with the largest variance of the points' coordinates; -1 if all points are equal."""
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


@kernel
def build_tree(points: Int16x2, order: Int64x1, bounds: Int64x1, roots: Int64x1, leaf: int) -> Int32x2:
    """Return the nodes of a tree for each group of points. A node is split at the median of its widest axis.

    Parameters
    ----------
    points
        ``(n, d)``.
    order
        ``(n,)``: the numbers of the points, group after group; reordered in place to the order of the trees.
    bounds
        ``(g + 1,)``: the start of each group, and n.
    roots
        ``(g,)``: output, the root node of each group.
    leaf
        The largest number of points of a leaf. Any number of equal points make one leaf.
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
                split_at_middle(values, order, start, stop, middle)
                node[2], node[3], node[4] = axis, values[start:middle].max(), values[middle:stop].min()
                todo[top, 0], todo[top, 1], todo[top, 2] = middle, stop, count
                todo[top + 1, 0], todo[top + 1, 1], todo[top + 1, 2] = start, middle, -1
                top += 2
            count += 1
    return nodes[:count].copy()


@step_kernel
def squared_distance(one: Int16x1, other: Int16x1) -> np.int32:
    """Return the squared distance of two points."""
    total = np.int32(0)
    for a in range(one.size):
        difference = np.int16(one[a] - other[a])
        total = np.int32(total + np.int32(difference) * np.int32(difference))
    return total


@step_kernel
def key_of(query: Int16x1, points: Int16x2, ranks: Int64x1, place: int, leading: int) -> np.int64:
    """Return the key of a point for a query: squared distance times 2^32 plus rank, so that ranks break ties.

    With fewer ``leading`` coordinates than all, the distance is the sum of two norms, theirs and that of the others. It
    is at least the norm of all coordinates, and its square at most twice the square of that norm.
    """
    point = points[place]
    distance = np.int64(squared_distance(query, point))
    if leading < query.size:
        first = np.int64(squared_distance(query[:leading], point[:leading]))
        distance += np.int64(2 * math.sqrt(float(first * (distance - first))))
    key: np.int64 = (distance << 32) + ranks[place]
    return key


@kernel
def search_tree(
    tree: TreeArrays,
    group: int,
    root: int,
    query: Int16x1,
    shrink: float,
    keys: Int64x1,
    places: Int64x1,
    stack: Int64x2,
    gaps: Int64x1,
) -> None:
    """Find the points of one group that are nearest to a query, and nearer than the known ones.

    A box is skipped if it is farther than the known points. Its distance is updated along one axis at each step down
    the tree (incremental distances, Arya and Mount). O(log n) if the points' intrinsic dimension is small, O(n) at
    worst.

    Parameters
    ----------
    tree
        See :data:`TreeArrays`.
    group, root
        The numbers of the group's box and of its root node.
    query
        ``(d,)``.
    shrink
        (1 + eps)^2: the squared distance of a box is multiplied by this before it is compared. 1: the search is exact.
    keys
        ``(k,)``, ascending: input, the keys of the known points; output, the least keys. See :func:`key_of`.
    places
        ``(k,)``: output, the places of the new points in the tree's order; entries of known points are shifted along.
    stack, gaps
        Buffers: ``(DEEPEST, 4)`` and ``(d,)``.
    """
    points, ranks, nodes, lows, highs, leading = tree
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
            key = key_of(query, points, ranks, p, leading)
            if key < keys[last]:
                i = last
                while i > 0 and keys[i - 1] > key:
                    keys[i], places[i] = keys[i - 1], places[i - 1]
                    i -= 1
                keys[i], places[i] = key, p


@kernel
def search_queries(
    tree: TreeArrays, roots: Int64x1, groups: Int64x1, queries: Int16x2, shrink: float, keys: Int64x2, places: Int64x2
) -> None:
    """Run :func:`search_tree` for each of ``queries (q, d)`` in its group; keys and places are ``(q, k)``."""
    stack, gaps = np.empty((DEEPEST, 4), np.int64), np.empty(queries.shape[1], np.int64)
    for q in range(queries.shape[0]):
        group = groups[q]
        search_tree(tree, group, roots[group], queries[q], shrink, keys[q], places[q], stack, gaps)


@kernel
def project_neighborhood(
    values: UInt8x1,
    at: int,
    steps: Int64x1,
    matrix: Int16x2,
    shift: Int32x1,
    bits: int,
    buffer: Int16x1,
    point: Int16x1,
) -> None:
    """Compute the point of a neighborhood into ``point``; ``at`` is the index of the pixel's first value."""
    for i in range(steps.size):
        buffer[i] = values[at + steps[i]]
    for a in range(matrix.shape[0]):
        row = matrix[a]
        total = np.int32(0)
        for i in range(buffer.size):
            total = np.int32(total + np.int32(row[i]) * np.int32(buffer[i]))
        point[a] = np.int16((np.int64(total) + shift[a]) >> bits)


@kernel
def write_pixel(canvas: CanvasArrays, row: int, column: int, source: int, color: UInt8x1) -> None:
    """Write a pixel and, if the output wraps, its copies in the border."""
    values, sources, frame = canvas
    height, width, channels = sources.shape[0], sources.shape[1], color.size
    for r in range(row % frame[0], height, frame[0]):
        for c in range(column % frame[1], width, frame[1]):
            sources[r, c] = source
            for k in range(channels):
                values[(r * width + c) * channels + k] = color[k]


@kernel
def grow_box(
    canvas: CanvasArrays,
    stock: StockArrays,
    query: QueryArrays,
    tree: TreeArrays,
    roots: Int64x1,
    groups: Int64x2,
    box: Int64x1,
    factor: float,
    everywhere: bool,
) -> None:
    """Synthesize the pixels of a box in scan-line order.

    Parameters
    ----------
    canvas, stock, query
        See :data:`CanvasArrays`, :data:`StockArrays`, :data:`QueryArrays`.
    tree, roots
        The tree of the sample's neighborhoods, and its root nodes by groups.
    groups
        ``(rows, columns)`` of the box: the group of each pixel's source.
    box
        (y0, y1, x0, x1) of the output.
    factor
        The continuation of a neighbor's source is preferred if its squared distance is at most this multiple of the
        least one; 0: it is not preferred.
    everywhere
        Whether the tree is searched for every pixel. If not, the candidates are the continuations of the neighbors'
        sources and the places similar to them; the tree is searched only if there are no candidates.
    """
    values, sources, frame = canvas
    colors, pixels, places, similar, stride = stock
    steps, matrix, shift, bits, texture_offsets = query
    points, ranks, nodes, leading = tree[0], tree[1], tree[2], tree[5]
    channels, width = colors.shape[1], sources.shape[1]
    buffer, point = np.zeros(matrix.shape[1], np.int16), np.zeros(matrix.shape[0], np.int16)
    stack, gaps = np.empty((DEEPEST, 4), np.int64), np.empty(matrix.shape[0], np.int64)
    keys, best = np.empty(1, np.int64), np.empty(1, np.int64)
    for y in range(box[0], box[1]):
        for x in range(box[2], box[3]):
            row, column = y + frame[2], x + frame[3]
            project_neighborhood(values, (row * width + column) * channels, steps, matrix, shift, bits, buffer, point)
            group = groups[y - box[0], x - box[2]]
            start, stop = nodes[roots[group], 0], nodes[roots[group], 1]
            nearest, near = UNBOUNDED, np.int64(-1)
            keys[0], best[0] = UNBOUNDED, -1
            for m in range(texture_offsets.shape[0]):
                source = sources[row + texture_offsets[m, 1], column + texture_offsets[m, 0]]
                if source < 0:
                    continue
                source -= texture_offsets[m, 1] * stride + texture_offsets[m, 0]
                if source < 0 or source >= places.size:
                    continue
                place = places[source]
                if place < 0:
                    continue
                if start <= place < stop:
                    key = key_of(point, points, ranks, place, leading)
                    if key < nearest:
                        nearest, near = key, place
                if not everywhere:
                    for j in range(similar.shape[1]):
                        other = similar[place, j]
                        if start <= other < stop:
                            key = key_of(point, points, ranks, other, leading)
                            if key < keys[0]:
                                keys[0], best[0] = key, other
            if everywhere or (near < 0 and best[0] < 0):
                if factor > 0 and near >= 0:
                    keys[0] = np.int64(math.ceil((nearest >> 32) / factor)) << 32
                search_tree(tree, group, roots[group], point, 1.0, keys, best, stack, gaps)
            elif near >= 0 and (nearest < keys[0] or (factor > 0 and (nearest >> 32) <= factor * (keys[0] >> 32))):
                best[0] = -1
            chosen = pixels[near if best[0] < 0 else best[0]]
            write_pixel(canvas, row, column, chosen, colors[chosen])
