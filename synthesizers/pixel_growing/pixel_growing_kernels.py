"""The compiled loops of pixel-based synthesis: build and search a k-d tree, and synthesize an output pixel by pixel.

Coordinates and their differences are integers of 16 bits; squared distances fit into 32 bits. All sums are exact, so
that neither the order of summation nor the machine changes which point is nearest.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from nrbench.jit import Int16x1, Int16x2, Int32x1, Int32x2, Int64x1, Int64x2, UInt8x1, UInt8x2, kernel, step_kernel

UNBOUNDED = np.int64(2**63 - 1)
"""A key larger than that of any point."""
DEEPEST = 160
"""Rows of a search's stack: two per level, for trees of at most 2^32 points that are split at their medians."""
FIRST, STOP, AXIS, LEFT_END, RIGHT_START, RIGHT = range(6)
"""The columns of a node: its first point, its last point + 1, the axis along which it is split (-1: a leaf), the
largest coordinate of its left child along this axis, the smallest of its right child, and the number of the right
child. The left child is the next node."""
NODE, DISTANCE, CUT_AXIS, GAP = range(4)
"""The columns of a search's stack, see :func:`search_tree`."""


class TreeArrays(NamedTuple):
    """A k-d tree for each of several groups of points.

    Parameters
    ----------
    points
        ``(n, d)``, in the tree's order.
    ranks
        ``(n,)``: of points at the same distance, the one of least rank is the nearest.
    nodes
        ``(m, 6)``: see :data:`FIRST`.
    roots
        ``(g,)``: the root node of each group.
    lows, highs
        ``(g, d)``: the box of each group's points.
    leading
        Number of leading coordinates, see :func:`key_of`.
    """

    points: Int16x2
    ranks: Int64x1
    nodes: Int32x2
    roots: Int64x1
    lows: Int16x2
    highs: Int16x2
    leading: int


class NearestPoints(NamedTuple):
    """The nearest points that were found so far, the nearest first.

    Parameters
    ----------
    keys
        ``(k,)``: their keys, see :func:`key_of`; :data:`UNBOUNDED` where there is no point yet.
    places
        ``(k,)``: their places in the tree's order; -1 where there is no point yet.
    """

    keys: Int64x1
    places: Int64x1


class SearchBuffers(NamedTuple):
    """The memory of a search, which is used again by the next one.

    Parameters
    ----------
    stack
        ``(DEEPEST, 4)``: the nodes that remain to be searched.
    gaps
        ``(d,)``: the squared distance along each axis of the query from the box of the current node.
    """

    stack: Int64x2
    gaps: Int64x1


class GrowthBuffers(NamedTuple):
    """The memory of the search for a source, which is used again for the next pixel.

    Parameters
    ----------
    values
        The values of a neighborhood, padded.
    point
        ``(d,)``: its point.
    near, other
        The best continuation, and the best other source.
    search
        The memory of a search of the tree.
    """

    values: Int16x1
    point: Int16x1
    near: NearestPoints
    other: NearestPoints
    search: SearchBuffers


class CanvasArrays(NamedTuple):
    """An output and its border.

    Parameters
    ----------
    values
        The values of its layers, flat.
    sources
        ``(P, Q)``: each pixel's source in the sample; -1 if it has none.
    frame
        ``(4,)``: the number of rows and of columns after which the output repeats, and the rows and columns of the
        border at its top and left.
    """

    values: UInt8x1
    sources: Int64x2
    frame: Int64x1


class SampleArrays(NamedTuple):
    """A sample, whose pixels are the sources of an output.

    Parameters
    ----------
    tree
        The tree of its neighborhoods.
    colors
        ``(h w, C)``.
    pixels
        ``(n,)``: the pixel at each place of the tree.
    places
        ``(h w,)``: the place of each pixel; -1 if its neighborhood is incomplete.
    similar
        ``(n, k)``: the places most similar to each place; -1 if there are fewer.
    width
        Its width, px.
    """

    tree: TreeArrays
    colors: UInt8x2
    pixels: Int64x1
    places: Int64x1
    similar: Int64x2
    width: int


class NeighborhoodArrays(NamedTuple):
    """A neighborhood, and the projection of its values to a point of the tree.

    Parameters
    ----------
    steps
        ``(D,)``: the steps from a pixel's first value to those of its neighborhood.
    matrix, shift, bits
        The projection, see :class:`~.neighbor_search.Projection`.
    texture_offsets
        ``(m, 2)``: the offsets (x, y) of the neighbors whose sources are continued.
    """

    steps: Int64x1
    matrix: Int16x2
    shift: Int32x1
    bits: int
    texture_offsets: Int64x2


@step_kernel
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


@step_kernel
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

    Notes
    -----
    The nodes of a group are numbered in the order of a depth-first walk, left children first. The stack ``todo`` holds
    the parts that remain::

        while parts remain: take the last part
            tell its parent, if it is a right child, where it begins
            if it has more than `leaf` points, and they differ:
                split it at the median of its widest axis
                put the right part, then the left part on the stack

    O(n d log n).
    """
    nodes = np.empty((2 * order.size + 1, 6), np.int32)
    values = np.empty(order.size, np.int16)
    todo = np.empty((DEEPEST, 3), np.int64)
    count = 0
    for g in range(roots.size):
        # The whole group is the first part on the stack.
        roots[g] = count
        todo[0, 0], todo[0, 1], todo[0, 2] = bounds[g], bounds[g + 1], -1
        top = 1
        while top > 0:
            top -= 1
            start, stop, parent = todo[top, 0], todo[top, 1], todo[top, 2]
            # Only now is the number of a right child known.
            if parent >= 0:
                nodes[parent, RIGHT] = count
            # The node is a leaf, unless it is split below.
            node = nodes[count]
            node[FIRST], node[STOP], node[AXIS], node[RIGHT] = start, stop, -1, -1
            node[LEFT_END], node[RIGHT_START] = 0, 0
            axis = widest_axis(points, order, start, stop) if stop - start > leaf else -1
            # Split at the median of the widest axis.
            if axis >= 0:
                middle = (start + stop) // 2
                for i in range(start, stop):
                    values[i] = points[order[i], axis]
                split_at_middle(values, order, start, stop, middle)
                node[AXIS] = axis
                node[LEFT_END], node[RIGHT_START] = values[start], values[middle]
                for i in range(start, middle):
                    node[LEFT_END] = max(node[LEFT_END], values[i])
                for i in range(middle, stop):
                    node[RIGHT_START] = min(node[RIGHT_START], values[i])
                # The right part, then the left one, which is taken next and so follows its parent.
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


@step_kernel
def keep_if_near(found: NearestPoints, key: np.int64, place: int) -> None:
    """Insert a point into the list of the nearest ones if it is nearer than the last of them, which is dropped."""
    i = found.keys.size - 1
    if key >= found.keys[i]:
        return
    while i > 0 and found.keys[i - 1] > key:
        found.keys[i], found.places[i] = found.keys[i - 1], found.places[i - 1]
        i -= 1
    found.keys[i], found.places[i] = key, place


@step_kernel
def measure_gaps(tree: TreeArrays, group: int, query: Int16x1, gaps: Int64x1) -> int:
    """Return the squared distance of a query from a group's box, and write its part along each axis to ``gaps``."""
    distance = 0
    for a in range(query.size):
        beyond = max(tree.lows[group, a] - query[a], query[a] - tree.highs[group, a], 0)
        gaps[a] = beyond * beyond
        distance += gaps[a]
    return distance


@step_kernel
def push(stack: Int64x2, row: int, node: int, distance: int, axis: int, gap: int) -> None:
    """Write a row of a search's stack."""
    stack[row, NODE], stack[row, DISTANCE], stack[row, CUT_AXIS], stack[row, GAP] = node, distance, axis, gap


@step_kernel
def search_tree(
    tree: TreeArrays, group: int, query: Int16x1, shrink: float, found: NearestPoints, buffers: SearchBuffers
) -> None:
    """Find the points of one group that are nearest to a query, and nearer than the known ones.

    Parameters
    ----------
    tree, group
        The tree, and the number of the group.
    query
        ``(d,)``.
    shrink
        (1 + eps)^2: the squared distance of a box is multiplied by this before it is compared. 1: the search is exact.
    found
        Input: the keys of the known points. Output: the nearest points; places of known points are shifted along.
    buffers
        Overwritten.

    Notes
    -----
    A box is skipped if it is farther than the known points. The distance of a box is the sum over the axes of ``gaps``,
    of which a step down the tree changes one (incremental distances). Each row of the stack sets the gap along one axis
    and names a node that is searched with it, or -1 if there is none::

        while the stack has rows: take the last row
            gaps[axis] = gap
            if node >= 0 and its box is no farther than the known points:
                go down to the leaf on the query's side of each cut; at each cut,
                    if the box beyond the cut is near enough:
                        push (-1, axis, the present gap), which restores the gap after the box beyond is searched
                        push (child beyond the cut, axis, squared distance from the cut)
                compare the query with the points of the leaf

    O(log n) if the points' intrinsic dimension is small, O(n) at worst. S. Arya and D. M. Mount, "Algorithms for fast
    vector quantization", Data Compression Conference 1993.
    """
    points, ranks, nodes, leading = tree.points, tree.ranks, tree.nodes, tree.leading
    stack, gaps = buffers.stack, buffers.gaps
    last = found.keys.size - 1
    # The search starts at the root of the group, with the gaps of its box.
    distance = measure_gaps(tree, group, query, gaps)
    push(stack, 0, tree.roots[group], distance, 0, gaps[0])
    top = 1
    while top > 0:
        top -= 1
        at, distance = stack[top, NODE], stack[top, DISTANCE]
        gaps[stack[top, CUT_AXIS]] = stack[top, GAP]
        # The row only restored a gap, or the known points are nearer than the box by now.
        if at < 0 or distance * shrink > found.keys[last] >> 32:
            continue
        # Go down to the leaf on the query's side of each cut.
        while nodes[at, AXIS] >= 0:
            axis = nodes[at, AXIS]
            # The query lies on the side of the cut whose points are nearer to it along the axis.
            to_left, to_right = nodes[at, LEFT_END] - query[axis], nodes[at, RIGHT_START] - query[axis]
            near, far, gap = at + 1, nodes[at, RIGHT], to_right * to_right
            if to_left + to_right <= 0:
                near, far, gap = far, near, to_left * to_left
            # Beyond the cut, one gap replaces another. The row that restores it lies below, and is taken later.
            farther = distance - gaps[axis] + gap
            if farther * shrink <= found.keys[last] >> 32:
                push(stack, top, -1, 0, axis, gaps[axis])
                push(stack, top + 1, far, farther, axis, gap)
                top += 2
            at = near
        # Compare the query with the points of the leaf.
        for place in range(nodes[at, FIRST], nodes[at, STOP]):
            keep_if_near(found, key_of(query, points, ranks, place, leading), place)


@kernel
def search_queries(
    tree: TreeArrays, groups: Int64x1, queries: Int16x2, shrink: float, keys: Int64x2, places: Int64x2
) -> None:
    """Run :func:`search_tree` for each of ``queries (q, d)`` in its group; keys and places are ``(q, k)``."""
    buffers = SearchBuffers(np.empty((DEEPEST, 4), np.int64), np.empty(queries.shape[1], np.int64))
    for q in range(queries.shape[0]):
        search_tree(tree, groups[q], queries[q], shrink, NearestPoints(keys[q], places[q]), buffers)


@step_kernel
def project_neighborhood(
    values: UInt8x1, at: int, neighborhood: NeighborhoodArrays, buffer: Int16x1, point: Int16x1
) -> None:
    """Compute the point of a neighborhood into ``point``; ``at`` is the index of the pixel's first value."""
    steps, matrix, shift = neighborhood.steps, neighborhood.matrix, neighborhood.shift
    for i in range(steps.size):
        buffer[i] = values[at + steps[i]]
    for a in range(matrix.shape[0]):
        row = matrix[a]
        total = np.int32(0)
        for i in range(buffer.size):
            total = np.int32(total + np.int32(row[i]) * np.int32(buffer[i]))
        point[a] = np.int16((np.int64(total) + shift[a]) >> neighborhood.bits)


@step_kernel
def write_pixel(canvas: CanvasArrays, row: int, column: int, source: int, color: UInt8x1) -> None:
    """Write a pixel and, if the output wraps, its copies in the border."""
    height, width, channels = canvas.sources.shape[0], canvas.sources.shape[1], color.size
    for r in range(row % canvas.frame[0], height, canvas.frame[0]):
        for c in range(column % canvas.frame[1], width, canvas.frame[1]):
            canvas.sources[r, c] = source
            for k in range(channels):
                canvas.values[(r * width + c) * channels + k] = color[k]


@step_kernel
def find_continuation(sources: Int64x2, places: Int64x1, width: int, pixel: tuple[int, int], x: int, y: int) -> int:
    """Return the place of the pixel beside the source of a neighbor at (x, y) as the pixel lies beside the neighbor.

    Return -1 if the neighbor has no source, or if there is no such pixel with a complete neighborhood.
    """
    source = sources[pixel[0] + y, pixel[1] + x]
    if source < 0:
        return -1
    source -= y * width + x
    if source < 0 or source >= places.size:
        return -1
    place: int = places[source]
    return place


@step_kernel
def rate_continuations(
    canvas: CanvasArrays,
    sample: SampleArrays,
    offsets: Int64x2,
    pixel: tuple[int, int],
    group: int,
    point: Int16x1,
    continuation: NearestPoints,
    similar: NearestPoints,
) -> None:
    """Find the best continuation of the neighbors' sources, and the best of the places similar to them.

    Parameters
    ----------
    canvas, sample
        The output and the sample.
    offsets
        ``(m, 2)``: the offsets (x, y) of the neighbors.
    pixel
        Row and column of the pixel on the canvas.
    group
        The group of its source; others are left out.
    point
        The point of its neighborhood.
    continuation, similar
        The best ones; they are overwritten.
    """
    tree = sample.tree
    points, ranks, leading = tree.points, tree.ranks, tree.leading
    start, stop = tree.nodes[tree.roots[group], FIRST], tree.nodes[tree.roots[group], STOP]
    for m in range(offsets.shape[0]):
        place = find_continuation(canvas.sources, sample.places, sample.width, pixel, offsets[m, 0], offsets[m, 1])
        if place < 0:
            continue
        if start <= place < stop:
            keep_if_near(continuation, key_of(point, points, ranks, place, leading), place)
        for j in range(sample.similar.shape[1]):
            other = sample.similar[place, j]
            if start <= other < stop:
                keep_if_near(similar, key_of(point, points, ranks, other, leading), other)


@step_kernel
def choose_source(
    canvas: CanvasArrays,
    sample: SampleArrays,
    neighborhood: NeighborhoodArrays,
    pixel: tuple[int, int],
    group: int,
    preference: tuple[float, bool],
    buffers: GrowthBuffers,
) -> int:
    """Return the place of the source of a pixel, whose row and column on the canvas are ``pixel``.

    Parameters
    ----------
    canvas, sample, neighborhood, group, preference
        As in :func:`grow_box`; the group of this pixel's source.
    buffers
        Overwritten.

    Notes
    -----
    With d the squared distance of neighborhoods::

        c = argmin of d over the continuations of the sources of the pixel's neighbors
        o = argmin of d over all neighborhoods of the sample, or over the places similar to the continuations
        source = c  if d(c) <= factor d(o), else o

    The tree is searched for points nearer than d(c) / factor alone: if there is none, c is the source. M. Ashikhmin,
    "Synthesizing natural textures", I3D 2001 (continuations); A. Hertzmann and others, "Image analogies", SIGGRAPH 2001
    (their preference); X. Tong and others, "Synthesis of bidirectional texture functions on arbitrary surfaces",
    SIGGRAPH 2002 (similar places).
    """
    factor, everywhere = preference
    near, other, point = buffers.near, buffers.other, buffers.point
    start = (pixel[0] * canvas.sources.shape[1] + pixel[1]) * sample.colors.shape[1]
    project_neighborhood(canvas.values, start, neighborhood, buffers.values, point)
    near.keys[0], near.places[0], other.keys[0], other.places[0] = UNBOUNDED, -1, UNBOUNDED, -1
    rate_continuations(canvas, sample, neighborhood.texture_offsets, pixel, group, point, near, other)
    if everywhere or (near.places[0] < 0 and other.places[0] < 0):
        if factor > 0 and near.places[0] >= 0:
            other.keys[0] = np.int64(math.ceil((near.keys[0] >> 32) / factor)) << 32
        search_tree(sample.tree, group, point, 1.0, other, buffers.search)
    elif near.keys[0] < other.keys[0] or (factor > 0 and (near.keys[0] >> 32) <= factor * (other.keys[0] >> 32)):
        other.places[0] = -1
    place: int = other.places[0] if other.places[0] >= 0 else near.places[0]
    return place


@kernel
def grow_box(
    canvas: CanvasArrays,
    sample: SampleArrays,
    neighborhood: NeighborhoodArrays,
    groups: Int64x2,
    box: Int64x1,
    preference: tuple[float, bool],
) -> None:
    """Synthesize the pixels of a box in scan-line order, see :func:`choose_source`.

    Parameters
    ----------
    canvas, sample, neighborhood
        The output, which is overwritten, the sample, and the neighborhoods that are compared.
    groups
        ``(rows, columns)`` of the box: the group of each pixel's source.
    box
        (y0, y1, x0, x1) of the output.
    preference
        ``factor``: the continuation of a neighbor's source is preferred if its squared distance is at most this
        multiple of the least one; 0: it is not preferred. ``everywhere``: whether the tree is searched for every pixel.
        If not, the candidates are the continuations of the neighbors' sources and the places similar to them; the tree
        is searched only if there are no candidates.
    """
    count, padded = neighborhood.matrix.shape
    buffers = GrowthBuffers(
        np.zeros(padded, np.int16),
        np.zeros(count, np.int16),
        NearestPoints(np.empty(1, np.int64), np.empty(1, np.int64)),
        NearestPoints(np.empty(1, np.int64), np.empty(1, np.int64)),
        SearchBuffers(np.empty((DEEPEST, 4), np.int64), np.empty(count, np.int64)),
    )
    for y in range(box[0], box[1]):
        for x in range(box[2], box[3]):
            row, column, group = y + canvas.frame[2], x + canvas.frame[3], groups[y - box[0], x - box[2]]
            place = choose_source(canvas, sample, neighborhood, (row, column), group, preference, buffers)
            source = sample.pixels[place]
            write_pixel(canvas, row, column, source, sample.colors[source])
