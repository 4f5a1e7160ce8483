"""The compiled loops of minimum cuts: augmenting paths between two trees that are kept, and what seams cost."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from nrbench.jit import kernel

SOURCE, SINK = 1, 2
"""The trees; 0 is neither."""
GRAY_LEVEL = 1 / 255
"""Added to gradients, so that flat places have a cost."""
_ROOT, _ORPHAN, _NONE = 4, 5, 6
"""What a node's parent may be, other than a direction (0 right, 1 left, 2 down, 3 up; ``d ^ 1`` is the opposite)."""


@kernel("uint8[::1](float64[:, ::1], float64[::1], int64)")
def grow_trees(residual: NDArray[np.float64], terminal: NDArray[np.float64], width: int) -> NDArray[np.uint8]:
    """Saturate a grid of links, and return the tree that each node is in at the end.

    Parameters
    ----------
    residual
        ``(4, n)``: capacity of the links from each node to the right, left, below and above; changed in place. The
        grid has a ring of nodes around that nothing links.
    terminal
        ``(n,)``: what can flow from the source to a node, or, where negative, from the node to the sink; changed in
        place. Infinite terminals are never used up.
    width
        Nodes in a row, the ring included.

    Returns
    -------
    NDArray
        ``uint8 (n,)``: :data:`SOURCE` where the source reaches the node still: that side of a minimum cut, the
        smallest of all; :data:`SINK` where the node reaches the sink, else 0.

    Notes
    -----
    Boykov and Kolmogorov 2004 (An experimental comparison of min-cut/max-flow algorithms), section 3, with marked
    distances: two trees grow until they touch, the path is saturated, and the nodes that it cuts off look for new
    parents. Every step keeps the flow valid, so the cut is exact whatever the order. Most of the time goes into walking
    up the trees: parents are kept as unsigned node numbers, which are read and followed without a look at their sign.
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
        out, link = tree[current] == SOURCE, -1
        for d in range(4):
            j = current + offset[d]
            if (residual[d, current] if out else residual[d ^ 1, j]) <= 0:
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
        time += 1
        first = current if out else current + offset[link]
        across = link if out else link ^ 1
        last = first + offset[across]
        flow = residual[across, first]
        k = np.uint64(first)
        while parent[k] != _ROOT:
            room = residual[parent[k] ^ np.uint8(1), up[k]]
            k = up[k]
            if room < flow:
                flow = room
        flow = min(flow, terminal[k])
        k = np.uint64(last)
        while parent[k] != _ROOT:
            room = residual[parent[k], k]
            k = up[k]
            if room < flow:
                flow = room
        flow = min(flow, -terminal[k])
        residual[across, first] -= flow
        residual[across ^ 1, last] += flow
        begin, end = 0, 0
        k = np.uint64(first)
        while parent[k] != _ROOT:
            e, above = parent[k], up[k]
            left = residual[e ^ np.uint8(1), above] - flow
            residual[e ^ np.uint8(1), above] = left
            residual[e, k] += flow
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
            e, above = parent[k], up[k]
            left = residual[e, k] - flow
            residual[e, k] = left
            residual[e ^ np.uint8(1), above] += flow
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
        while begin != end:
            i = orphans[begin]
            begin = (begin + 1) % (n + 1)
            own, best, found = tree[i], n + 2, _NONE
            for d in range(4):
                j = i + offset[d]
                if tree[j] != own or (residual[d ^ 1, j] if own == SOURCE else residual[d, i]) <= 0:
                    continue
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
                    best, found = steps, d
                m = np.uint64(j)
                while mark[m] != time:
                    mark[m], distance[m] = time, steps
                    steps -= 1
                    m = up[m]
            if found != _NONE:
                parent[i], up[i], mark[i], distance[i] = found, i + offset[found], time, best + 1
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


@kernel("Tuple((float64[:, ::1], float64[:, ::1]))(float32[:, :, ::1], float32[:, :, ::1], boolean, float64)")
def link_costs(
    old: NDArray[np.float32], new: NDArray[np.float32], normalized: bool, power: float
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return what a seam between two pictures costs on each link to the right, and on each to below.

    See :func:`nrbench.synthesizers.seams.minimum_cut.seam_links`. Gradients are central differences, one-sided at the edges. O(h w).
    """
    height, width, channels = old.shape
    difference = np.zeros((height, width))
    busy = np.zeros((2, height, width))
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
            busy[0, y, x] = (np.sqrt(old_x) + np.sqrt(new_x)) / max(right - left, 1)
            busy[1, y, x] = (np.sqrt(old_y) + np.sqrt(new_y)) / max(below - above, 1)
    across, down = np.empty((height, width - 1)), np.empty((height - 1, width))
    for axis in range(2):
        costs = across if axis == 0 else down
        for y in range(costs.shape[0]):
            for x in range(costs.shape[1]):
                v, u = (y, x + 1) if axis == 0 else (y + 1, x)
                apart = difference[y, x] + difference[v, u]
                cost = apart * apart if power == 2.0 else apart**power
                costs[y, x] = cost / (busy[axis, y, x] + busy[axis, v, u] + GRAY_LEVEL) if normalized else cost
    return across, down
