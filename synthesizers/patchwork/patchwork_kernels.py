"""The compiled loops of a patchwork: the costs of a window's links."""

from __future__ import annotations

import numpy as np

from nrbench.jit import Boolx2, Int32x3, Int64x3, Int64x4, kernel

UNIT = 16.0
"""Costs are integers, in units of 1 / UNIT gray levels, so that flows are exact."""
STAY, SECOND, FIRST = 0, 1, 2
"""Cases of a link: both pixels stay; only the second becomes new; only the first becomes new. If both become new, the
link costs nothing."""


SeamRule = tuple[Int32x3, Int32x3, bool, int]
"""How a seam is rated: the sample's ``features``, their gradients ``(2, H, W)``, and the parameters ``normalized`` and
``power`` of :class:`~nrbench.synthesizers.patchwork.patchwork.Patchwork`."""


@kernel
def feature_distance(features: Int32x3, y: int, x: int, v: int, u: int) -> float:
    """Return the Euclidean distance of the features of two pixels, (y, x) and (v, u)."""
    squares = 0
    for c in range(features.shape[2]):
        difference = int(features[y, x, c]) - int(features[v, u, c])
        squares += difference * difference
    return float(np.sqrt(np.float64(squares)))


@kernel
def step_cost(rule: SeamRule, axis: int, y: int, x: int, v: int, u: int) -> int:
    """Return the cost of a seam between two patches on a link to the right (axis 0) or downward (axis 1).

    (y, x) and (v, u) are the places of the link's first pixel in the sample, for either patch. Beyond the sample's
    edges its outermost pixels are repeated.
    """
    if y == v and x == u:
        return 0
    features, slopes = rule[0], rule[1]
    last_row, last_column = features.shape[0] - 1, features.shape[1] - 1
    apart, busy = 0.0, 0
    for k in range(2):
        down, right = k * axis, k * (1 - axis)
        j, i = min(max(y + down, 0), last_row), min(max(x + right, 0), last_column)
        n, m = min(max(v + down, 0), last_row), min(max(u + right, 0), last_column)
        apart += feature_distance(features, j, i, n, m)
        busy += slopes[axis, j, i] + slopes[axis, n, m]
    if not rule[2]:
        return int(np.rint(UNIT * apart))
    return int(np.rint(UNIT * UNIT * apart * (apart if rule[3] == 2 else UNIT) / (busy + UNIT)))


@kernel
def link_choices(rule: SeamRule, source: Int64x3, known: Boolx2, x: int, y: int) -> Int64x4:
    """Return the cost of each link of a window for each case of replaced pixels.

    Parameters
    ----------
    rule
        See :data:`SeamRule`.
    source
        ``(h, w, 2)``: (x, y) in the sample of the window's pixels.
    known
        ``(h, w)``: whether they are known.
    x, y
        The place in the sample of the new patch's first pixel.

    Returns
    -------
    NDArray
        ``(2, 3, h, w)``: for the link to the right of each pixel and the link below it, the costs in the cases
        :data:`STAY`, :data:`SECOND` and :data:`FIRST`. 0 if there is no link, or if a pixel that stays is unknown.
        The time is O(h w F).
    """
    height, width = known.shape
    costs = np.zeros((2, 3, height, width), np.int64)
    for axis in range(2):
        down, right = axis, 1 - axis
        for j in range(height - down):
            for i in range(width - right):
                n, m = j + down, i + right
                first, second = known[j, i], known[n, m]
                ay, ax = source[j, i, 1], source[j, i, 0]
                by, bx = source[n, m, 1] - down, source[n, m, 0] - right
                if first and second:
                    costs[axis, STAY, j, i] = step_cost(rule, axis, ay, ax, by, bx)
                if first:
                    costs[axis, SECOND, j, i] = step_cost(rule, axis, ay, ax, y + j, x + i)
                if first and second and ay == by and ax == bx:
                    costs[axis, FIRST, j, i] = costs[axis, SECOND, j, i]
                elif second:
                    costs[axis, FIRST, j, i] = step_cost(rule, axis, y + j, x + i, by, bx)
    return costs
