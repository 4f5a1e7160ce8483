"""The compiled loops of regions of dominance: each peak's nearest higher one, and every pair of vectors' hits."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from nrbench.detectors.agreement.rows import row_ends
from nrbench.jit import kernel


@kernel("float64[::1](float64[:, ::1])")
def region_radii(ranked: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the distance of each peak from the nearest higher one, px, ``(n,)``.

    Parameters
    ----------
    ranked
        ``(n, 2)``: lags (x, y), the highest first; lag 0 is higher still, and each peak has its mirror image.

    Notes
    -----
    Peaks enter a grid of as many boxes as peaks, the highest first, and each looks at boxes around its own until the
    nearest is found: O(n log n) where they are spread evenly.
    """
    n = ranked.shape[0]
    radii = np.empty(n)
    if n == 0:
        return radii
    x_end, y_end = np.abs(ranked[:, 0]).max(), np.abs(ranked[:, 1]).max()
    box = max(np.sqrt(2 * x_end * y_end / n), max(x_end, y_end) / n, 1e-6)
    columns, rows = int(2 * x_end / box) + 1, int(2 * y_end / box) + 1
    first = np.full((rows, columns), -1, np.int64)
    following = np.full(2 * n, -1, np.int64)
    for i in range(n):
        x, y = ranked[i, 0], ranked[i, 1]
        column, row = int((x + x_end) / box), int((y + y_end) / box)
        nearest = x * x + y * y
        ring = 0
        while ring <= 1 or (ring - 1) * box * (ring - 1) * box <= nearest:
            for r in range(max(row - ring, 0), min(row + ring, rows - 1) + 1):
                step = 1 if abs(r - row) == ring else max(2 * ring, 1)
                for c in range(column - ring, column + ring + 1, step):
                    if c < 0 or c >= columns:
                        continue
                    k = first[r, c]
                    while k >= 0:
                        sign = 1 - 2 * (k % 2)
                        dx, dy = x - sign * ranked[k // 2, 0], y - sign * ranked[k // 2, 1]
                        nearest = min(nearest, dx * dx + dy * dy)
                        k = following[k]
            ring += 1
        radii[i] = np.sqrt(nearest)
        for half in range(2):
            sign = 1 - 2 * half
            c, r = int((sign * x + x_end) / box), int((sign * y + y_end) / box)
            following[2 * i + half] = first[r, c]
            first[r, c] = 2 * i + half
    return radii


@kernel("float64[:, ::1](float64[:, ::1], int64[::1], float64[:, ::1], float64[::1], float64, int64)")
def rate_pairs(
    peaks: NDArray[np.float64],
    heights: NDArray[np.int64],
    candidates: NDArray[np.float64],
    reach: NDArray[np.float64],
    tolerance: float,
    most: int,
) -> NDArray[np.float64]:
    """Return how many dominant peaks lie on the lattice of each pair of candidates, each lattice once.

    Parameters
    ----------
    peaks
        ``(n, 2)``: lags (x, y) px on the right half-plane, the most dominant first.
    heights
        ``(n,)``: the correlation there, in whole numbers: their sums do not depend on their order.
    candidates
        ``(k, 2)``: vectors (x, y) px.
    reach
        ``(2,)``: largest lag along x and y, px.
    tolerance
        Largest distance of a hit, as a share of the shortest vector, below 0.5; at least 1 px.
    most
        A lattice of more points than this within ``reach`` is looked at within fewer lags, of the same proportions.

    Returns
    -------
    NDArray
        ``(m, 7)``: x1, y1, x2, y2 of the reduced pair, number of lattice points (lag 0 left out, one of each mirrored
        two), of hits among as many peaks, the most dominant, and the sum of the hits' heights. Pairs whose cell is thin
        or under 4 px^2 are left out, lattices the same to half a pixel count once.

    Notes
    -----
    Time is the number of lattices times the number of peaks.
    """
    n = candidates.shape[0]
    out = np.zeros((n * (n - 1) // 2, 7))
    m = 0
    for i in range(n):
        for j in range(i + 1, n):
            x1, y1, x2, y2 = candidates[i, 0], candidates[i, 1], candidates[j, 0], candidates[j, 1]
            area = abs(x1 * y2 - x2 * y1)
            if area < 4 or area * area < 0.01 * (x1 * x1 + y1 * y1) * (x2 * x2 + y2 * y2):
                continue
            while True:
                if x1 * x1 + y1 * y1 > x2 * x2 + y2 * y2:
                    x1, y1, x2, y2 = x2, y2, x1, y1
                times = np.rint((x1 * x2 + y1 * y2) / (x1 * x1 + y1 * y1))
                if times == 0:
                    break
                x2, y2 = x2 - times * x1, y2 - times * y1
            if x1 * x2 + y1 * y2 < 0:
                x2, y2 = -x2, -y2
            known = False
            for k in range(m):
                straight = max(abs(out[k, 0] - x1), abs(out[k, 1] - y1), abs(out[k, 2] - x2), abs(out[k, 3] - y2))
                turned = max(abs(out[k, 0] + x1), abs(out[k, 1] + y1), abs(out[k, 2] + x2), abs(out[k, 3] + y2))
                if min(straight, turned) < 0.25:
                    known = True
                    break
            if known:
                continue
            shrink = min(1.0, np.sqrt(most * area / (2 * reach[0] * reach[1])))
            end_x, end_y = shrink * reach[0], shrink * reach[1]
            points = 0
            for b in range(int((end_y * abs(x1) + end_x * abs(y1)) / area) + 1):
                first, last = row_ends(x1, y1, x2, y2, b, end_x, end_y)
                points += max(last - (max(first, 1) if b == 0 else first) + 1, 0)
            radius = max(tolerance * np.sqrt(x1 * x1 + y1 * y1), 1.0)
            determinant = x1 * y2 - x2 * y1
            seen, hits, total = 0, 0, 0
            for k in range(peaks.shape[0]):
                if seen == points:
                    break
                x, y = peaks[k]
                if abs(x) > end_x or abs(y) > end_y:
                    continue
                seen += 1
                u, v = np.floor((x * y2 - y * x2) / determinant), np.floor((y * x1 - x * y1) / determinant)
                for corner in range(4):
                    a, b = u + corner % 2, v + corner // 2
                    dx, dy = x - a * x1 - b * x2, y - a * y1 - b * y2
                    if dx * dx + dy * dy <= radius * radius:
                        hits += 1
                        total += heights[k]
                        break
            out[m, 0], out[m, 1], out[m, 2], out[m, 3] = x1, y1, x2, y2
            out[m, 4], out[m, 5], out[m, 6] = points, hits, total
            m += 1
    return out[:m].copy()
