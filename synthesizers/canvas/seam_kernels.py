"""The compiled loops of seams: minimum-error paths, minimum cuts, costs of seams between two pictures, and blending.

Kwatra, Schödl, Essa, Turk, Bobick 2003 (Graphcut textures: image and video synthesis using graph cuts), section 3.

The solver of minimum cuts is our own because PyMaxflow and igraph are under the GPL, and
``scipy.sparse.csgraph.maximum_flow`` takes 9 (48 x 48 pixels) to 19 times (80 x 80) as long and accepts only
whole-number capacities.
"""

from __future__ import annotations

import numpy as np

from nrbench.jit import (
    BoolView2,
    Boolx1,
    Boolx2,
    Float32View3,
    Float32View4,
    Float32x3,
    Float64View2,
    Float64x1,
    Float64x2,
    Float64x3,
    Float64x4,
    Int64x1,
    UInt8View3,
    UInt8x1,
    UInt64x1,
    allocating_step_kernel,
    inlined_kernel,
    kernel,
    step_kernel,
)

SOURCE, SINK = 1, 2
"""The two trees of a minimum cut; 0 marks a node in neither."""
STAY, SECOND, FIRST = 0, 1, 2
"""Cases of a link: both pixels stay; only the second becomes new; only the first becomes new. If both become new, the
link costs nothing."""
GRAY_LEVEL = 1 / 255
"""Added to gradients, so that flat regions have a finite cost."""
_ROOT, _ORPHAN, _NONE = 4, 5, 6
"""Values of a node's parent besides the directions 0 right, 1 left, 2 down, 3 up (``d ^ 1`` is the opposite of d)."""
_HEAD, _TAIL, _CURRENT = 0, 1, 2
"""The entries of ``state``: the ends of the queue of active nodes, and the node whose tree grows, or -1."""
Nodes = tuple[UInt8x1, UInt8x1, UInt64x1, Int64x1, Int64x1, Boolx1]
"""For each node: its tree; the direction of its parent and the parent's number; its distance from the root, and the
time at which this was measured; whether it waits in the queue. The number is unsigned, so that the compiled code does
not test for negative indices."""


@allocating_step_kernel
def path_costs(error: Float64View2) -> Float64x2:
    """Return, for each pixel, the least sum of errors over 8-connected paths from the lowest row up to it. O(h w)."""
    rows, columns = error.shape
    total = np.empty((rows, columns))
    for j in range(columns):
        total[rows - 1, j] = error[rows - 1, j]
    for i in range(rows - 2, -1, -1):
        for j in range(columns):
            least = total[i + 1, j]
            if j > 0:
                least = min(least, total[i + 1, j - 1])
            if j < columns - 1:
                least = min(least, total[i + 1, j + 1])
            total[i, j] = error[i, j] + least
    return total


@allocating_step_kernel
def follow_path(total: Float64x2, row: int, column: int) -> Int64x1:
    """Return the columns of the path of least cost from a pixel down to the lowest row, one for each row from ``row``.

    Parameters
    ----------
    total
        Costs from :func:`path_costs`. Of steps of equal cost the straight one is preferred, then the left one.
    row, column
        The pixel.
    """
    rows, columns = total.shape
    path = np.empty(rows - row, np.int64)
    path[0] = column
    for i in range(row + 1, rows):
        before = path[i - row - 1]
        best = before
        if before > 0 and total[i, before - 1] < total[i, best]:
            best = before - 1
        if before < columns - 1 and total[i, before + 1] < total[i, best]:
            best = before + 1
        path[i - row] = best
    return path


@kernel
def cheapest_path(error: Float64x2) -> Int64x1:
    """Return the columns, row by row, of the 8-connected path from top to bottom with the least sum of errors.

    Dynamic programming (Efros and Freeman 2001, section 2.1): E[i, j] = e[i, j] + min of E[i-1, j-1], E[i-1, j] and
    E[i-1, j+1]. Of steps of equal cost the straight one is preferred, then the left one; of ends of equal cost, the
    leftmost one. O(h w).

    Parameters
    ----------
    error
        ``(h, w)``, at least one row and one column: difference of two patches at each pixel of their overlap. Infinity
        forbids a pixel.

    Returns
    -------
    NDArray
        ``(h,)``: for each row the first column, 0 to w - 1, that belongs to the patch on the right. Columns of adjacent
        rows differ by at most 1.
    """
    total = path_costs(error[::-1])
    return follow_path(total, 0, int(np.argmin(total[0])))[::-1].copy()


@allocating_step_kernel
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
    distances::

        every node with a terminal is the root of a tree, and active
        until the trees do not touch any more:
            grow the trees from the active nodes until they touch   (touch_trees)
            saturate the path between the two roots                 (send_flow)
            find new parents for the nodes that lost theirs by this (reattach_orphans)

    The flow is valid after every step, so the cut is exact for any order of steps.
    """
    n = terminal.size
    offset = np.array([1, -1, width, -width])
    tree, parent, up = np.zeros(n, np.uint8), np.full(n, _NONE, np.uint8), np.zeros(n, np.uint64)
    distance, mark, waiting = np.zeros(n, np.int64), np.zeros(n, np.int64), np.zeros(n, np.bool_)
    nodes = (tree, parent, up, distance, mark, waiting)
    queue, orphans = np.empty(n + 1, np.int64), np.empty(n + 1, np.int64)
    # The roots.
    tail = 0
    for i in range(n):
        if terminal[i] != 0:
            tree[i] = SOURCE if terminal[i] > 0 else SINK
            parent[i], distance[i] = _ROOT, 1
            # Nothing grows from a fixed node among others that are fixed alike.
            alike = abs(terminal[i]) == np.inf
            for d in range(4):
                alike = alike and terminal[i + offset[d]] == terminal[i]
            if not alike:
                queue[tail], waiting[i] = i, True
                tail += 1
    state = np.array([0, tail, -1])
    time = 0
    while True:
        link = touch_trees(residual, offset, nodes, queue, state)
        if link < 0:
            return tree
        time += 1
        # The two nodes at which the trees touch, that of the source first.
        first = last = state[_CURRENT]
        if tree[first] == SOURCE:
            last += offset[link]
        else:
            first += offset[link]
            link ^= 1
        count = send_flow(residual, terminal, parent, up, orphans, link, (first, last))
        reattach_orphans(residual, offset, nodes, queue, orphans, state, count, time)


@step_kernel
def touch_trees(residual: Float64x2, offset: Int64x1, nodes: Nodes, queue: Int64x1, state: Int64x1) -> int:
    """Grow the trees from the active nodes until they touch.

    Return the direction from the current node, ``state[_CURRENT]``, to a node of the other tree, or -1 if the trees do
    not touch any more.

    Notes
    -----
    Boykov and Kolmogorov 2004, section 3.2.1, the growth stage::

        for each active node, first come first served:
            for each neighbor with a residual link from (source tree) or to (sink tree) the node:
                free:       it joins the tree, and becomes active
                other tree: the trees touch; the node stays the current one
                own tree:   the node becomes its parent, if that shortens its way to the root
    """
    tree, parent, up, distance, mark, waiting = nodes
    head, tail, current = state[_HEAD], state[_TAIL], state[_CURRENT]
    while True:
        # Take the next active node, unless the last one is still at work. Nodes that lost their tree are passed over.
        if current < 0 or tree[current] == 0:
            if head == tail:
                return -1
            current = queue[head]
            head = (head + 1) % queue.size
            waiting[current] = False
            if tree[current] == 0:
                continue
        own, steps, time = tree[current], distance[current] + 1, mark[current]
        from_source = own == SOURCE
        for d in range(4):
            j = current + offset[d]
            # Flow runs away from the source's tree and toward the sink's.
            if (residual[d, current] if from_source else residual[d ^ 1, j]) <= 0:
                continue
            # A free neighbor joins the tree, and becomes active.
            if tree[j] == 0:
                tree[j], parent[j], up[j], distance[j], mark[j] = own, d ^ 1, current, steps, time
                if not waiting[j]:
                    queue[tail], waiting[j] = j, True
                    tail = (tail + 1) % queue.size
            # The trees touch.
            elif tree[j] != own:
                state[_HEAD], state[_TAIL], state[_CURRENT] = head, tail, current
                return d
            # A neighbor of the same tree gets a shorter way to the root.
            elif mark[j] <= time and distance[j] >= steps:
                parent[j], up[j], distance[j], mark[j] = d ^ 1, current, steps, time
        current = -1


@inlined_kernel
def send_flow(
    residual: Float64x2,
    terminal: Float64x1,
    parent: UInt8x1,
    up: UInt64x1,
    orphans: Int64x1,
    across: int,
    ends: tuple[int, int],
) -> int:
    """Saturate the path between two roots, and return the number of orphans.

    A node is an orphan if its link to its parent, or to its terminal, is used up.

    Parameters
    ----------
    residual, terminal
        As in :func:`grow_trees`; changed.
    parent, up
        See :data:`Nodes`; the parents of orphans are changed.
    orphans
        Written: the orphans.
    across
        The direction from the tree of the source to that of the sink, where they touch.
    ends
        The node of either tree at which they touch, that of the source first.

    Notes
    -----
    Boykov and Kolmogorov 2004, section 3.2.2, the augmentation stage: the flow is the least capacity on the way from
    the source's root over the link where the trees touch to the sink's root, terminals included. It is subtracted along
    the way and added against it.
    """
    first, last = ends
    # The least capacity on both halves of the path.
    flow = residual[across, first]
    for to_sink in range(2):
        k = np.uint64(ends[to_sink])
        while parent[k] != _ROOT:
            capacity = residual[parent[k], k] if to_sink else residual[parent[k] ^ np.uint8(1), up[k]]
            k = up[k]
            if capacity < flow:
                flow = capacity
        flow = min(flow, abs(terminal[k]))
    # Send it over the link in the middle, then along both halves.
    residual[across, first] -= flow
    residual[across ^ 1, last] += flow
    count = 0
    for to_sink in range(2):
        k = np.uint64(ends[to_sink])
        while parent[k] != _ROOT:
            d, above = parent[k], up[k]
            if to_sink:
                left = residual[d, k] - flow
                residual[d, k] = left
                residual[d ^ np.uint8(1), above] += flow
            else:
                left = residual[d ^ np.uint8(1), above] - flow
                residual[d ^ np.uint8(1), above] = left
                residual[d, k] += flow
            if left <= 0:
                parent[k], orphans[count] = _ORPHAN, k
                count += 1
            k = above
        terminal[k] += flow if to_sink else -flow
        if terminal[k] == 0:
            parent[k], orphans[count] = _ORPHAN, k
            count += 1
    return count


@inlined_kernel
def reattach_orphans(
    residual: Float64x2,
    offset: Int64x1,
    nodes: Nodes,
    queue: Int64x1,
    orphans: Int64x1,
    state: Int64x1,
    count: int,
    time: int,
) -> None:
    """Give each orphan the parent nearest to the root of its tree, or free it.

    Parameters
    ----------
    residual, offset, nodes, queue, state
        As in :func:`grow_trees`; changed.
    orphans
        A ring, of which the first ``count`` entries are the orphans.
    count
        Number of orphans.
    time
        The number of this step: distances marked with it are valid.

    Notes
    -----
    Boykov and Kolmogorov 2004, section 3.2.3, the adoption stage::

        for each orphan i:
            of the neighbors j of its tree with a residual link to i whose way up ends at a root,
                the one nearest to the root becomes its parent
            if there is none:
                i becomes free
                neighbors of its tree that could reach i become active
                its children become orphans

    Most of the time of a cut is spent in the walks up the trees. They are written out here: as a function of their own
    they take a third longer.
    """
    tree, parent, up, distance, mark, waiting = nodes
    begin, end, tail = 0, count, state[_TAIL]
    while begin != end:
        i = orphans[begin]
        begin = (begin + 1) % orphans.size
        own, best, toward = tree[i], orphans.size + 1, _NONE
        # Look for a parent in all four directions.
        for d in range(4):
            j = i + offset[d]
            if tree[j] != own or (residual[d ^ 1, j] if own == SOURCE else residual[d, i]) <= 0:
                continue
            # Walk up to the root, or to a node whose distance has been measured in this step; an orphan ends the walk.
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
            # Walk up again and note the distances, so that no way is walked twice in this step.
            m = np.uint64(j)
            while mark[m] != time:
                mark[m], distance[m] = time, steps
                steps -= 1
                m = up[m]
        if toward != _NONE:
            parent[i], up[i], mark[i], distance[i] = toward, i + offset[toward], time, best + 1
            continue
        # Free it: neighbors that could reach it become active, its children become orphans.
        tree[i], parent[i] = 0, _NONE
        for d in range(4):
            j = i + offset[d]
            if tree[j] != own:
                continue
            if (residual[d ^ 1, j] if own == SOURCE else residual[d, i]) > 0 and not waiting[j]:
                queue[tail], waiting[j] = j, True
                tail = (tail + 1) % queue.size
            if parent[j] == d ^ 1:
                parent[j], orphans[end] = _ORPHAN, j
                end = (end + 1) % orphans.size
    state[_TAIL] = tail


@kernel
def cut_links(choices: Float64x4, fixed_old: Boolx2, fixed_new: Boolx2) -> Boolx2:
    """Return the pixels of a window that become new, so that the total cost of its links is least.

    Parameters
    ----------
    choices
        ``(2, 3, h, w)``: the cost of each link to the right (0) and downward (1) for each case: :data:`STAY`,
        :data:`SECOND` and :data:`FIRST`. Links that lead out do not count.
    fixed_old, fixed_new
        ``bool (h, w)``: pixels that must stay, and pixels that must become new; none is both.

    Notes
    -----
    Let a link cost c if both its pixels s and t stay, b if only s becomes new, a if only t becomes new, and 0 if both
    do. Up to a constant, this is a link of cost (a + b - c) / 2 between s and t, plus (b - a - c) / 2 if s becomes new,
    plus (a - b - c) / 2 if t becomes new. If c exceeds a + b, which no metric allows, c is replaced by a + b. All costs
    are doubled, so that whole numbers stay whole.
    """
    height, width = fixed_old.shape
    stride = width + 2
    residual, terminal = np.zeros((4, (height + 2) * stride)), np.zeros((height + 2) * stride)
    # Capacities between pixels and to the terminals, by the formulas above. The grid has a ring of nodes without links.
    for j in range(height):
        for i in range(width):
            node = (j + 1) * stride + i + 1
            for axis in range(2):
                if (i if axis == 0 else j) == (width if axis == 0 else height) - 1:
                    continue
                ahead = node + (1 if axis == 0 else stride)
                first, second = choices[axis, FIRST, j, i], choices[axis, SECOND, j, i]
                stay = min(choices[axis, STAY, j, i], first + second)
                residual[2 * axis, node] = residual[2 * axis + 1, ahead] = first + second - stay
                terminal[node] -= first - second - stay
                terminal[ahead] -= second - first - stay
            if fixed_new[j, i]:
                terminal[node] = np.inf
            elif fixed_old[j, i]:
                terminal[node] = -np.inf
    tree = grow_trees(residual, terminal, stride)
    # New are the pixels on the source's side.
    new = np.empty((height, width), np.bool_)
    for j in range(height):
        for i in range(width):
            new[j, i] = tree[(j + 1) * stride + i + 1] == SOURCE
    return new


@kernel
def cut_overlap(costs: Float64x3, seams: Float32View3, fixed_old: Boolx2, fixed_new: Boolx2) -> Boolx2:
    """Return where to show the new picture, so that the seam between old and new is the least visible.

    Where both pictures agree the old one stays.

    Parameters
    ----------
    costs
        Costs of a seam between old and new, see :func:`link_costs`.
    seams
        ``(2, h, w)``: costs of the seams that the old picture already has, 0 elsewhere, in the same unit. A seam counts
        if both its pixels stay old, so that it pays to cover it (Kwatra et al. 2003, section 3.1, "accounting for old
        seams"). A seam that costs more than twice its link counts as twice the link.
    fixed_old, fixed_new
        ``bool (h, w)``: pixels that must stay old, and pixels that must be new. The others are the overlap.

    Notes
    -----
    The paper's seam node gives the same costs, except that it compares the new picture with what the covered patches
    would show beyond the seam; here it is compared with the old picture as it is.
    """
    _, height, width = costs.shape
    choices = np.empty((2, 3, height, width))
    for axis in range(2):  # numba takes seconds to compile the assignment of a slice
        for y in range(height):
            for x in range(width):
                choices[axis, STAY, y, x] = seams[axis, y, x]
                choices[axis, SECOND, y, x] = choices[axis, FIRST, y, x] = costs[axis, y, x]
    return cut_links(choices, fixed_old, fixed_new)


@kernel
def record_seams(seams: Float32View3, filled: BoolView2, mask: Boolx2, costs: Float64x3) -> None:
    """Change the seams of a box to those with the new picture: new ones along its cut, none inside it.

    Parameters
    ----------
    seams, costs
        As in :func:`cut_overlap`; ``seams`` is changed.
    filled
        ``bool (h, w)``: False where the old picture is empty. No seam runs along its border.
    mask
        ``(h, w)``: where the new picture is shown.
    """
    height, width = mask.shape
    for axis in range(2):
        for y in range(height - axis):
            for x in range(width - 1 + axis):
                v, u = y + axis, x + 1 - axis
                if mask[y, x] or mask[v, u]:
                    both_filled = (mask[y, x] or filled[y, x]) and (mask[v, u] or filled[v, u])
                    seams[axis, y, x] = costs[axis, y, x] if both_filled and mask[y, x] != mask[v, u] else 0.0


@kernel
def link_costs(old: Float32x3, new: Float32x3, squared: bool) -> Float64x3:
    """Return the cost of a seam between two pictures on each link to the right (0) and downward (1), ``(2, h, w)``.

    For the pixels s and t of a link the cost is ``|old(s) - new(s)| + |old(t) - new(t)|``, Euclidean over the channels
    (Kwatra et al. 2003, equation 1), over the sum of the gradients of both pictures at s and t along the link (section
    5) plus one gray level. Divided by gradients, a seam follows the outlines in the texture instead of crossing flat
    regions. Gradients are central differences, one-sided at the edges. Links that lead out cost 0.

    Parameters
    ----------
    old, new
        ``(h, w, C)``.
    squared
        Square the differences: one large step costs more than several small ones. The paper does not.

    Notes
    -----
    With d(s) = |old(s) - new(s)| and g(s), the sum of both gradients along the link, the cost is ::

        (d(s) + d(t))^p / (g(s) + g(t) + 1/255),  p = 2 if squared, else 1

    O(h w).
    """
    height, width, channels = old.shape
    difference = np.zeros((height, width))
    gradient = np.zeros((2, height, width))
    # d and g of each pixel.
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
    # The costs of the links.
    costs = np.zeros((2, height, width))
    for axis in range(2):
        for y in range(height - axis):
            for x in range(width - 1 + axis):
                v, u = y + axis, x + 1 - axis
                apart = difference[y, x] + difference[v, u]
                cost = apart * apart if squared else apart
                costs[axis, y, x] = cost / (gradient[axis, y, x] + gradient[axis, v, u] + GRAY_LEVEL)
    return costs


@kernel
def corner_paths(error: Float64x2, beside: int, above: int) -> tuple[int, int, Int64x1, Int64x1, float]:
    """Return the two paths of an L-shaped cut, as ``find_paths`` describes them. O(h beside + w above).

    Parameters
    ----------
    error
        ``(h, w)``: the error of each pixel.
    beside, above
        Width of the overlap at the left and at the top, px, at least 1.

    Returns
    -------
    row, column
        The pixel at which the paths meet. Of meeting pixels of equal cost it is the first one, row by row.
    first, below
        The columns of the path downward, from that row on, and the rows of the path to the right, from that column on.
    cost
        Sum of the errors of both paths. The pixel at which they meet counts once.
    """
    upright, level = path_costs(error[:, :beside]), path_costs(error[:above].T)
    cost, row, column = np.inf, 0, 0
    for i in range(above):
        for j in range(beside):
            both = upright[i, j] + level[j, i] - error[i, j]
            if both < cost:
                cost, row, column = both, i, j
    return row, column, follow_path(upright, row, column), follow_path(level, column, row), cost


@kernel
def blend_pixels(
    image: UInt8View3,
    source: Float32View3,
    further: Float32View4,
    known: BoolView2,
    patch: UInt8View3,
    origin: Float32x3,
    weights: Float64x2,
    full: float,
) -> None:
    """Blend a patch into a picture.

    Parameters
    ----------
    image, source, further, known
        ``(h, w, C)``, ``(h, w, 3)``, ``(h, w, K, 3)`` and ``(h, w)``: the picture, its source map, the further sources
        of blended pixels, and where it is known; changed.
    patch, origin
        ``(h, w, C)`` and ``(h, w, 3)``: the patch and its source map.
    weights, full
        ``(h, w)``: the weights of the patch, from 0 to ``full``.

    Notes
    -----
    With w = weight / full a pixel becomes w patch + (1 - w) image, rounded to whole numbers, halves up. The weight of
    its source becomes the larger one of w times that of the patch and 1 - w times the old one. The smaller one joins
    the further sources, which are in the order of their weights; the last one is dropped.
    """
    for y in range(weights.shape[0]):
        for x in range(weights.shape[1]):
            weight = weights[y, x]
            if weight <= 0:
                continue
            for c in range(image.shape[2]):
                mixed = (weight * patch[y, x, c] + (full - weight) * image[y, x, c]) / full
                image[y, x, c] = np.uint8(mixed + 0.5)
            share, rest = weight / full, (full - weight) / full
            mine, others = share * origin[y, x, 2], rest * source[y, x, 2]
            if full != 1:  # shares of whole numbers are rounded as the source map is, so that equal ones tie
                part = np.float32(share)
                mine = np.float64(part * origin[y, x, 2])
                others = np.float64((np.float32(1) - part) * source[y, x, 2])
            next_x, next_y, next_weight = origin[y, x, 0], origin[y, x, 1], np.float32(mine)
            if not known[y, x] or mine >= others:
                next_x, next_y, next_weight = source[y, x, 0], source[y, x, 1], np.float32(others)
                source[y, x, 0], source[y, x, 1], source[y, x, 2] = origin[y, x, 0], origin[y, x, 1], mine
            else:
                source[y, x, 2] = others
            for k in range(further.shape[2]):
                further[y, x, k, 2] *= np.float32(rest)
                if next_weight > further[y, x, k, 2]:
                    old_x, old_y, old_weight = further[y, x, k, 0], further[y, x, k, 1], further[y, x, k, 2]
                    further[y, x, k, 0], further[y, x, k, 1], further[y, x, k, 2] = next_x, next_y, next_weight
                    next_x, next_y, next_weight = old_x, old_y, old_weight
            known[y, x] = True
