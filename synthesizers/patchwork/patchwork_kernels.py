"""The compiled loops of a patchwork: the costs of a window's links with the old and the new patch."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from nrbench.jit import kernel

UNIT = 16.0
"""Costs are integers, in units of 1 / UNIT gray levels, so that flows are exact."""
STAY, SECOND, FIRST = 0, 1, 2
"""Cases of a link: both pixels stay; only the second becomes new; only the first becomes new. If both become new, the
link costs nothing."""


@kernel("int64(int32[:, :, ::1], int32[:, :, ::1], int64, boolean, int64, int64, int64, int64, int64)")
def step_cost(
    features: NDArray[np.int32],
    slopes: NDArray[np.int32],
    axis: int,
    normalized: bool,
    power: int,
    y: int,
    x: int,
    v: int,
    u: int,
) -> int:
    """Return the cost of a seam between two patches on a link to the right (axis 0) or downward (axis 1).

    See :class:`~nrbench.synthesizers.patchwork.patchwork.Patchwork`. (y, x) and (v, u) are the places of the link's
    first pixel in the sample, for either patch. Beyond the sample's edges its outermost pixels are repeated.
    """
    if y == v and x == u:
        return 0
    height, width, channels = features.shape
    apart, busy = 0.0, 0.0
    for k in range(2):
        j, i = y + k * axis, x + k * (1 - axis)
        m, n = v + k * axis, u + k * (1 - axis)
        j, i = min(max(j, 0), height - 1), min(max(i, 0), width - 1)
        m, n = min(max(m, 0), height - 1), min(max(n, 0), width - 1)
        squares = 0
        for c in range(channels):
            difference = int(features[j, i, c]) - int(features[m, n, c])
            squares += difference * difference
        apart += np.sqrt(np.float64(squares))
        busy += slopes[axis, j, i] + slopes[axis, m, n]
    if normalized:
        if power == 2:
            return int(np.rint(UNIT * UNIT * apart * apart / (busy + UNIT)))
        return int(np.rint(UNIT * UNIT * UNIT * apart / (busy + UNIT)))
    return int(np.rint(UNIT * apart * apart if power == 2 else UNIT * apart))


@kernel(
    "int64[:, :, :, ::1]"
    "(int32[:, :, ::1], int32[:, :, ::1], boolean, int64, int64[:, :, ::1], boolean[:, ::1], int64, int64)"
)
def link_choices(
    features: NDArray[np.int32],
    slopes: NDArray[np.int32],
    normalized: bool,
    power: int,
    source: NDArray[np.int64],
    known: NDArray[np.bool_],
    x: int,
    y: int,
) -> NDArray[np.int64]:
    """Return the cost of each link of a window for each case of replaced pixels.

    Parameters
    ----------
    features, slopes, normalized, power
        The sample's features, their gradients ``(2, H, W)``, and the type of cost: see
        :class:`~nrbench.synthesizers.patchwork.patchwork.Patchwork`.
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
                    costs[axis, STAY, j, i] = step_cost(features, slopes, axis, normalized, power, ay, ax, by, bx)
                if first:
                    costs[axis, SECOND, j, i] = step_cost(
                        features, slopes, axis, normalized, power, ay, ax, y + j, x + i
                    )
                if second:
                    costs[axis, FIRST, j, i] = step_cost(
                        features, slopes, axis, normalized, power, y + j, x + i, by, bx
                    )
    return costs
