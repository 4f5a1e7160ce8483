"""Compiled loops over pairs of candidate vectors: each detector rates the lattice that a pair generates."""

from __future__ import annotations

import numpy as np

from nrbench.jit import Float64x1, Float64x2, Int32x2, Int64x1, kernel
from nrbench.lattice.geometry import MOST_STEPS


@kernel
def row_ends(x1: float, y1: float, x2: float, y2: float, b: int, end_x: float, end_y: float) -> tuple[int, int]:
    """Return the first and the last integer a for which a (x1, y1) + b (x2, y2) lies within (+-end_x, +-end_y).

    If there is none, the last is less than the first.
    """
    low, high = -1e9, 1e9
    if abs(x1) > 1e-9:
        one, other = (-end_x - b * x2) / x1, (end_x - b * x2) / x1
        low, high = max(low, min(one, other)), min(high, max(one, other))
    elif abs(b * x2) > end_x:
        return 1, 0
    if abs(y1) > 1e-9:
        one, other = (-end_y - b * y2) / y1, (end_y - b * y2) / y1
        low, high = max(low, min(one, other)), min(high, max(one, other))
    elif abs(b * y2) > end_y:
        return 1, 0
    return int(np.ceil(low)), int(np.floor(high))


@kernel
def best_pair(surface: Int32x2, candidates: Float64x2, unit: float, alpha: float, overlap: float) -> Float64x1:
    """Return the pair of generating vectors of the highest goodness.

    Parameters
    ----------
    surface
        ``(2H-1, W)``: normalized autocorrelation of an image ``(H, W)`` in integer multiples of 1 / ``unit``, lag
        (dx, dy) at ``[H-1+dy, dx]``.
    candidates
        ``(n, 2)``: vectors (x, y) px on the right half-plane, in ascending length.
    unit
        The value of 1 in ``surface``. Sums of integers do not depend on their order.
    alpha
        Exponent of the sum.
    overlap
        The overlap of image and shifted image at a valid multiple covers this share of the tile's bounding box.

    Returns
    -------
    NDArray
        ``(6,)``: goodness, x1, y1, x2, y2, number of valid multiples; zeros if no pair has a valid multiple.

    Notes
    -----
    RSGF (2011), section 3.3, steps 4 to 7 and equation 9.
    """
    height, width = (surface.shape[0] + 1) // 2, surface.shape[1]
    best = np.zeros(6)
    for i in range(candidates.shape[0]):
        x1, y1 = candidates[i]
        square = x1 * x1 + y1 * y1
        for j in range(i + 1, candidates.shape[0]):
            x2, y2 = candidates[j]
            times = np.rint((x2 * x1 + y2 * y1) / square)
            x2, y2 = x2 - times * x1, y2 - times * y1
            if x2 < 0 or (x2 == 0 and y2 < 0):
                x2, y2 = -x2, -y2
            if x2 * x2 + y2 * y2 < square:
                continue
            # The tile's bounding box. An overlap narrower than `overlap` of it is invalid, whatever its height.
            across, down = abs(x1) + abs(x2), abs(y1) + abs(y2)
            box = overlap * across * down
            if min(width - abs(x1), across) * min(height - abs(y1), down) < box or abs(y1) >= height:
                continue
            if min(width - abs(x2), across) * min(height - abs(y2), down) < box or abs(y2) >= height:
                continue
            far_x, far_y = width - overlap * across, height - overlap * down
            reach = int((far_y * abs(x1) + far_x * abs(y1)) / abs(x1 * y2 - x2 * y1)) + 1
            total, count = 0, 0
            for b in range(reach + 1):
                first, last = row_ends(x1, y1, x2, y2, b, far_x, far_y)
                for a in range(max(first, 1) if b == 0 else first, last + 1):
                    x, y = a * x1 + b * x2, a * y1 + b * y2
                    if x < 0 or (x == 0 and y < 0):
                        x, y = -x, -y
                    if x > far_x or abs(y) > far_y:
                        continue
                    if min(width - x, across) * min(height - abs(y), down) < box:
                        continue
                    total += surface[int(np.rint(y)) + height - 1, int(np.rint(x))]
                    count += 1
            if total <= 0:
                continue
            goodness = (total / unit) ** alpha / count
            if goodness > best[0]:
                best = np.array((goodness, x1, y1, x2, y2, float(count)))
    return best


@kernel
def count_hits(
    peaks: Float64x2, heights: Int64x1, candidates: Float64x2, reach: Float64x1, tolerance: float, most: int
) -> Float64x2:
    """Return, for each pair of candidates, how many dominant peaks lie on the lattice that the pair generates.

    Parameters
    ----------
    peaks
        ``(n, 2)``: lags (x, y) px on the right half-plane, the most dominant first.
    heights
        ``(n,)``: the correlation at the peaks, as integers. Sums of integers do not depend on their order.
    candidates
        ``(k, 2)``: vectors (x, y) px.
    reach
        ``(2,)``: largest lag along x and y, px.
    tolerance
        Largest distance of a hit from a lattice point, as a share of the shortest vector, below 0.5; at least 1 px.
    most
        If a lattice has more points than this within ``reach``, a smaller box of the same proportions is used.

    Returns
    -------
    NDArray
        ``(m, 7)``: x1, y1, x2, y2 of the reduced pair; the number of lattice points, without lag 0 and counting each
        mirrored pair once; the number of hits among as many of the most dominant peaks; the sum of the heights of the
        hits. Pairs whose cell is thin or below 4 px^2 are left out. Lattices that agree to 0.25 px count once.

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
            for _ in range(MOST_STEPS):  # rounding errors may keep a tie between two bases from ending
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


@kernel
def mean_correlations(surface: Int32x2, candidates: Float64x2, unit: float, reach: float) -> Float64x2:
    """Return the mean correlation at the multiples of every pair of candidates.

    Parameters
    ----------
    surface
        ``(2H-1, W)``: autocorrelation of an image ``(H, W)`` in integer multiples of 1 / ``unit``, lag (dx, dy) at
        ``[H-1+dy, dx]``.
    candidates
        ``(n, 2)``: vectors (x, y) px in ascending length.
    unit
        The value of 1 in ``surface``.
    reach
        Lags up to this share of the image's sides count, each weighted by the area of its overlap.

    Returns
    -------
    NDArray
        ``(m, 5)``: x1, y1, x2, y2 of the pair, with the first vector subtracted from the second as often as rounding
        says, and the mean correlation. Pairs whose cell is thin, below 8 px^2, or above 2/7 of the image are left out.

    Notes
    -----
    Time is the number of pairs times the number of their cells in the image.
    """
    height, width = (surface.shape[0] + 1) // 2, surface.shape[1]
    end_x, end_y = reach * (width - 1), reach * (height - 1)
    n = candidates.shape[0]
    out = np.zeros((n * (n - 1) // 2, 5))
    m = 0
    for i in range(n):
        x1, y1 = candidates[i]
        square = x1 * x1 + y1 * y1
        for j in range(i + 1, n):
            x2, y2 = candidates[j]
            times = np.rint((x2 * x1 + y2 * y1) / square)
            x2, y2 = x2 - times * x1, y2 - times * y1
            area = abs(x1 * y2 - x2 * y1)
            long = max(square, x2 * x2 + y2 * y2)
            if area < 8 or area > height * width / 3.5 or area * area < 0.01 * long * square:
                continue
            if x2 * x2 + y2 * y2 < 0.81 * square:
                continue
            rows = int((end_y * abs(x1) + end_x * abs(y1)) / area)
            total, weights = 0.0, 0.0
            for b in range(rows + 1):
                first, last = row_ends(x1, y1, x2, y2, b, end_x, end_y)
                for a in range(max(first, 1) if b == 0 else first, last + 1):
                    x, y = a * x1 + b * x2, a * y1 + b * y2
                    if abs(x) > end_x or abs(y) > end_y:
                        continue
                    if x < 0:
                        x, y = -x, -y
                    weight = (height - abs(y)) * (width - x)
                    total += weight * surface[int(np.rint(y)) + height - 1, int(np.rint(x))]
                    weights += weight
            if weights > 0:
                out[m, 0], out[m, 1], out[m, 2], out[m, 3] = x1, y1, x2, y2
                out[m, 4] = total / (weights * unit)
                m += 1
    return out[:m].copy()
