"""The compiled loops of seams: minimum-error paths, minimum cuts, and the costs of seams between two pictures."""

from __future__ import annotations

import numpy as np

from nrbench.jit import Float32x3, Float64x1, Float64x2, Int64x1, UInt8x1, kernel

SOURCE, SINK = 1, 2
"""The two trees of a minimum cut; 0 marks a node in neither."""
GRAY_LEVEL = 1 / 255
"""Added to gradients, so that flat regions have a finite cost."""
_ROOT, _ORPHAN, _NONE = 4, 5, 6
"""Values of a node's parent besides the directions 0 right, 1 left, 2 down, 3 up (``d ^ 1`` is the opposite of d)."""


@kernel
def cheapest_path(error: Float64x2) -> Int64x1:
    """Return the columns, row by row, of the 8-connected path from top to bottom with the least sum of errors.

    Dynamic programming (Efros and Freeman 2001, section 2.1): E[i, j] = e[i, j] + min of E[i-1, j-1], E[i-1, j] and
    E[i-1, j+1]. Of steps of equal cost the straight one is preferred, then the left one; of ends of equal cost, the
    leftmost one. O(h w).

    Parameters
    ----------
    error
        ``(h, w)``, at least one row and one column; infinity forbids a pixel.

    Returns
    -------
    NDArray
        ``(h,)``: columns from 0 to w - 1, neighboring rows at most 1 apart.
    """
    rows, columns = error.shape
    total = error[0].copy()
    below = np.empty(columns, np.float64)
    step_from_above = np.zeros((rows, columns), np.int8)
    for i in range(1, rows):
        for j in range(columns):
            least, step = total[j], np.int8(0)
            if j > 0 and total[j - 1] < least:
                least, step = total[j - 1], np.int8(-1)
            if j < columns - 1 and total[j + 1] < least:
                least, step = total[j + 1], np.int8(1)
            below[j] = error[i, j] + least
            step_from_above[i, j] = step
        total, below = below, total
    path = np.empty(rows, np.int64)
    path[rows - 1] = np.argmin(total)
    for i in range(rows - 1, 0, -1):
        path[i - 1] = path[i] + step_from_above[i, path[i]]
    return path


@kernel
def grow_trees(residual: Float64x2, terminal: Float64x1, width: int) -> UInt8x1:
    """Compute the maximum flow of a grid, and return the tree of each node at the end.

    Parameters
    ----------
    residual
        ``(4, n)``: capacities of the links from each node to the right, left, down and up; changed in place. The
        outermost nodes of the grid are a ring without links.
    terminal
        ``(n,)``: capacity from the source to a node or, if negative, from the node to the sink; changed in place.
        Infinite capacities stay infinite.
    width
        Nodes in a row, including the ring.

    Returns
    -------
    NDArray
        ``uint8 (n,)``: :data:`SOURCE` if residual links lead from the source to the node, :data:`SINK` if they lead
        from the node to the sink, else 0. The nodes of :data:`SOURCE` are the smallest source side of all minimum cuts.

    Notes
    -----
    Boykov and Kolmogorov 2004 (An experimental comparison of min-cut/max-flow algorithms), section 3, with marked
    distances. Two trees grow until they touch. The path between their roots is then saturated, and the nodes that lose
    their parents by this find new ones. The flow is valid after every step, so the cut is exact for any order of steps.

    Most of the time is spent in walks up the trees. Parents are unsigned node numbers, so that the compiled code does
    not test for negative indices. All three steps are in one function because calls between kernels pass a dozen arrays
    each: with one function for each step it takes 2.2 times as long (grids of 48 x 48 and 80 x 80 pixels).
    """
    n = terminal.size
    offset = np.array([1, -1, width, -width])
    tree = np.zeros(n, np.uint8)
    parent, up = np.full(n, _NONE, np.uint8), np.zeros(n, np.uint64)
    distance, mark = np.zeros(n, np.int64), np.zeros(n, np.int64)
    active, waiting = np.empty(n + 1, np.int64), np.zeros(n, np.bool_)
    orphans = np.empty(n + 1, np.int64)
    head, tail = 0, 0
    for i in range(n):
        if terminal[i] != 0:
            tree[i] = SOURCE if terminal[i] > 0 else SINK
            parent[i], distance[i] = _ROOT, 1
            active[tail], waiting[i] = i, True
            tail += 1
    time, current = 0, -1
    while True:
        if current < 0 or tree[current] == 0:
            if head == tail:
                break
            current = active[head]
            head = (head + 1) % (n + 1)
            waiting[current] = False
            if tree[current] == 0:
                continue
        # Grow the tree of the current node until it touches the other one.
        from_source, link = tree[current] == SOURCE, -1
        for d in range(4):
            j = current + offset[d]
            if (residual[d, current] if from_source else residual[d ^ 1, j]) <= 0:
                continue
            if tree[j] == 0:
                tree[j], parent[j], up[j] = tree[current], d ^ 1, current
                distance[j], mark[j] = distance[current] + 1, mark[current]
                if not waiting[j]:
                    active[tail], waiting[j] = j, True
                    tail = (tail + 1) % (n + 1)
            elif tree[j] != tree[current]:
                link = d
                break
            elif mark[j] <= mark[current] and distance[j] > distance[current]:
                parent[j], up[j], distance[j], mark[j] = d ^ 1, current, distance[current] + 1, mark[current]
        if link < 0:
            current = -1
            continue
        # Find how much can flow along the path, from the source side (first) to the sink side (last).
        time += 1
        first = current if from_source else current + offset[link]
        across = link if from_source else link ^ 1
        last = first + offset[across]
        flow = residual[across, first]
        k = np.uint64(first)
        while parent[k] != _ROOT:
            capacity = residual[parent[k] ^ np.uint8(1), up[k]]
            k = up[k]
            if capacity < flow:
                flow = capacity
        flow = min(flow, terminal[k])
        k = np.uint64(last)
        while parent[k] != _ROOT:
            capacity = residual[parent[k], k]
            k = up[k]
            if capacity < flow:
                flow = capacity
        flow = min(flow, -terminal[k])
        # Send the flow; a node whose link to its parent, or to its terminal, is used up becomes an orphan.
        residual[across, first] -= flow
        residual[across ^ 1, last] += flow
        begin, end = 0, 0
        k = np.uint64(first)
        while parent[k] != _ROOT:
            d, above = parent[k], up[k]
            left = residual[d ^ np.uint8(1), above] - flow
            residual[d ^ np.uint8(1), above] = left
            residual[d, k] += flow
            if left <= 0:
                parent[k] = _ORPHAN
                orphans[end] = k
                end += 1
            k = above
        terminal[k] -= flow
        if terminal[k] == 0:
            parent[k] = _ORPHAN
            orphans[end] = k
            end += 1
        k = np.uint64(last)
        while parent[k] != _ROOT:
            d, above = parent[k], up[k]
            left = residual[d, k] - flow
            residual[d, k] = left
            residual[d ^ np.uint8(1), above] += flow
            if left <= 0:
                parent[k] = _ORPHAN
                orphans[end] = k
                end += 1
            k = above
        terminal[k] += flow
        if terminal[k] == 0:
            parent[k] = _ORPHAN
            orphans[end] = k
            end += 1
        # Give each orphan the parent nearest to the root of its tree. If there is none, free the orphan; its children
        # then become orphans.
        while begin != end:
            i = orphans[begin]
            begin = (begin + 1) % (n + 1)
            own, best, toward = tree[i], n + 2, _NONE
            for d in range(4):
                j = i + offset[d]
                if tree[j] != own or (residual[d ^ 1, j] if own == SOURCE else residual[d, i]) <= 0:
                    continue
                # Walk up to the root, or to a node of known distance; then note the distances on the way.
                steps, m = 0, np.uint64(j)
                while mark[m] != time and parent[m] < _ROOT:
                    steps += 1
                    m = up[m]
                if mark[m] != time and parent[m] != _ROOT:
                    continue
                if mark[m] != time:
                    mark[m], distance[m] = time, 1
                steps += distance[m]
                if steps < best:
                    best, toward = steps, d
                m = np.uint64(j)
                while mark[m] != time:
                    mark[m], distance[m] = time, steps
                    steps -= 1
                    m = up[m]
            if toward != _NONE:
                parent[i], up[i], mark[i], distance[i] = toward, i + offset[toward], time, best + 1
                continue
            tree[i], parent[i] = 0, _NONE
            for d in range(4):
                j = i + offset[d]
                if tree[j] != own:
                    continue
                if (residual[d ^ 1, j] if own == SOURCE else residual[d, i]) > 0 and not waiting[j]:
                    active[tail], waiting[j] = j, True
                    tail = (tail + 1) % (n + 1)
                if parent[j] == d ^ 1:
                    parent[j] = _ORPHAN
                    orphans[end] = j
                    end = (end + 1) % (n + 1)
    return tree


@kernel
def link_costs(old: Float32x3, new: Float32x3, normalized: bool, power: float) -> tuple[Float64x2, Float64x2]:
    """Return the cost of a seam between two pictures on each link to the right, and on each link downward.

    See :func:`~nrbench.synthesizers.seams.minimum_cut.seam_links`. Gradients are central differences, one-sided at the
    edges. O(h w).
    """
    height, width, channels = old.shape
    difference = np.zeros((height, width))
    gradient = np.zeros((2, height, width))
    for y in range(height):
        above, below = max(y - 1, 0), min(y + 1, height - 1)
        for x in range(width):
            left, right = max(x - 1, 0), min(x + 1, width - 1)
            apart, old_x, old_y, new_x, new_y = 0.0, 0.0, 0.0, 0.0, 0.0
            for c in range(channels):
                apart += (old[y, x, c] - new[y, x, c]) ** 2
                old_x += (old[y, right, c] - old[y, left, c]) ** 2
                new_x += (new[y, right, c] - new[y, left, c]) ** 2
                old_y += (old[below, x, c] - old[above, x, c]) ** 2
                new_y += (new[below, x, c] - new[above, x, c]) ** 2
            difference[y, x] = np.sqrt(apart)
            gradient[0, y, x] = (np.sqrt(old_x) + np.sqrt(new_x)) / max(right - left, 1)
            gradient[1, y, x] = (np.sqrt(old_y) + np.sqrt(new_y)) / max(below - above, 1)
    across, down = np.empty((height, width - 1)), np.empty((height - 1, width))
    for axis in range(2):
        costs = across if axis == 0 else down
        for y in range(costs.shape[0]):
            for x in range(costs.shape[1]):
                v, u = (y, x + 1) if axis == 0 else (y + 1, x)
                apart = difference[y, x] + difference[v, u]
                cost = apart * apart if power == 2.0 else apart**power
                costs[y, x] = cost / (gradient[axis, y, x] + gradient[axis, v, u] + GRAY_LEVEL) if normalized else cost
    return across, down
