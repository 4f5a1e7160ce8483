"""Compiled loops over pairs of candidate vectors: each detector rates the lattice that a pair generates."""

from __future__ import annotations

import numpy as np

from nrbench.jit import Float64x1, Float64x2, Int32x2, Int64x1, kernel, step_kernel
from nrbench.lattice.geometry import MOST_STEPS

Pair = tuple[float, float, float, float]
"""Two vectors, x1, y1, x2, y2, px."""


@step_kernel
def row_ends(pair: Pair, b: int, end_x: float, end_y: float) -> tuple[int, int]:
    """Return the first and the last integer a for which a (x1, y1) + b (x2, y2) lies within (+-end_x, +-end_y).

    If there is none, the last is less than the first.
    """
    x1, y1, x2, y2 = pair
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


@step_kernel
def half_row(pair: Pair, b: int, end_x: float, end_y: float) -> tuple[int, int]:
    """Return :func:`row_ends` for b >= 0, without lag 0 and without one of each two opposite points."""
    first, last = row_ends(pair, b, end_x, end_y)
    return max(first, 1) if b == 0 else first, last


@step_kernel
def count_rows(pair: Pair, end_x: float, end_y: float) -> int:
    """Return the largest b of a lattice point a (x1, y1) + b (x2, y2) within (+-end_x, +-end_y), or more."""
    x1, y1, x2, y2 = pair
    return int((end_y * abs(x1) + end_x * abs(y1)) / abs(x1 * y2 - x2 * y1))


@step_kernel
def count_multiples(pair: Pair, end_x: float, end_y: float) -> int:
    """Return the number of lattice points within (+-end_x, +-end_y), without lag 0, each two opposite ones once."""
    points = 0
    for b in range(count_rows(pair, end_x, end_y) + 1):
        first, last = half_row(pair, b, end_x, end_y)
        points += max(last - first + 1, 0)
    return points


@step_kernel
def shorten_second(pair: Pair) -> Pair:
    """Subtract the first vector from the second as often as rounding says."""
    x1, y1, x2, y2 = pair
    times = np.rint((x2 * x1 + y2 * y1) / (x1 * x1 + y1 * y1))
    return x1, y1, x2 - times * x1, y2 - times * y1


@step_kernel
def overlap_within(x: float, y: float, shape: tuple[int, int], across: float, down: float) -> float:
    """Return the area in which an image of ``shape`` and its copy at a lag overlap, within a box of the given sides."""
    return min(shape[1] - abs(x), across) * min(shape[0] - abs(y), down)


@step_kernel
def rate_pair(surface: Int32x2, pair: Pair, unit: float, alpha: float, overlap: float) -> tuple[float, int]:
    """Return the goodness of a pair and the number of its valid multiples; 0, 0 if it is discarded.

    Parameters
    ----------
    surface, unit, alpha, overlap
        As for :func:`best_pair`.
    pair
        The vectors.
    """
    height, width = shape = (surface.shape[0] + 1) // 2, surface.shape[1]
    x1, y1, x2, y2 = pair
    # The tile's bounding box. An overlap narrower than `overlap` of it is invalid, whatever its height.
    across, down = abs(x1) + abs(x2), abs(y1) + abs(y2)
    box = overlap * across * down
    if overlap_within(x1, y1, shape, across, down) < box or abs(y1) >= height:
        return 0.0, 0
    if overlap_within(x2, y2, shape, across, down) < box or abs(y2) >= height:
        return 0.0, 0
    far_x, far_y = width - overlap * across, height - overlap * down
    total, count = 0, 0
    for b in range(count_rows(pair, far_x, far_y) + 1):
        first, last = half_row(pair, b, far_x, far_y)
        for a in range(first, last + 1):
            x, y = a * x1 + b * x2, a * y1 + b * y2
            if x < 0 or (x == 0 and y < 0):
                x, y = -x, -y
            if x > far_x or abs(y) > far_y or overlap_within(x, y, shape, across, down) < box:
                continue
            total += surface[int(np.rint(y)) + height - 1, int(np.rint(x))]
            count += 1
    return ((total / unit) ** alpha / count, count) if total > 0 else (0.0, 0)


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
    For each pair, of which the first vector is no longer than the second is after the first is subtracted from it::

        goodness = (sum of gamma over the valid multiples) ^ alpha / number of valid multiples

    RSGF (2011), section 3.3, steps 4 to 7 and equation 9. Time is the number of pairs times that of their multiples.
    """
    best = np.zeros(6)
    for i in range(candidates.shape[0]):
        for j in range(i + 1, candidates.shape[0]):
            x1, y1, x2, y2 = shorten_second((candidates[i, 0], candidates[i, 1], candidates[j, 0], candidates[j, 1]))
            if x2 < 0 or (x2 == 0 and y2 < 0):
                x2, y2 = -x2, -y2
            if x2 * x2 + y2 * y2 < x1 * x1 + y1 * y1:
                continue
            goodness, count = rate_pair(surface, (x1, y1, x2, y2), unit, alpha, overlap)
            if goodness > best[0]:
                best = np.array((goodness, x1, y1, x2, y2, float(count)))
    return best


@step_kernel
def reduce_pair(pair: Pair) -> Pair:
    """Return the shortest pair that generates the same lattice (Gauss), with an angle of at most 90 degrees."""
    x1, y1, x2, y2 = pair
    for _ in range(MOST_STEPS):  # rounding errors may keep a tie between two bases from ending
        if x1 * x1 + y1 * y1 > x2 * x2 + y2 * y2:
            x1, y1, x2, y2 = x2, y2, x1, y1
        times = np.rint((x1 * x2 + y1 * y2) / (x1 * x1 + y1 * y1))
        if times == 0:
            break
        x2, y2 = x2 - times * x1, y2 - times * y1
    return (x1, y1, -x2, -y2) if x1 * x2 + y1 * y2 < 0 else (x1, y1, x2, y2)


@step_kernel
def is_listed(rows: Float64x2, pair: Pair) -> bool:
    """Return whether a pair, or its opposite, agrees to 0.25 px with the first four columns of a row."""
    x1, y1, x2, y2 = pair
    for k in range(rows.shape[0]):
        row = rows[k]
        straight = max(abs(row[0] - x1), abs(row[1] - y1), abs(row[2] - x2), abs(row[3] - y2))
        turned = max(abs(row[0] + x1), abs(row[1] + y1), abs(row[2] + x2), abs(row[3] + y2))
        if min(straight, turned) < 0.25:
            return True
    return False


@step_kernel
def is_near_point(pair: Pair, x: float, y: float, radius: float) -> bool:
    """Return whether a position lies within a distance of a lattice point: of one of the corners of its cell."""
    x1, y1, x2, y2 = pair
    determinant = x1 * y2 - x2 * y1
    u, v = np.floor((x * y2 - y * x2) / determinant), np.floor((y * x1 - x * y1) / determinant)
    for corner in range(4):
        a, b = u + corner % 2, v + corner // 2
        dx, dy = x - a * x1 - b * x2, y - a * y1 - b * y2
        if dx * dx + dy * dy <= radius * radius:
            return True
    return False


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
    For each pair::

        n = number of lattice points in the box
        hits = those of the n most dominant peaks in the box that lie within the tolerance of a lattice point

    This is how the dominant peaks vote for a pair in Liu, Collins and Tsin (2004); the number n is nrbench's own.
    Time is the number of lattices times the number of peaks.
    """
    n = candidates.shape[0]
    out = np.zeros((n * (n - 1) // 2, 7))
    m = 0
    for i in range(n):
        for j in range(i + 1, n):
            x1, y1, x2, y2 = candidates[i, 0], candidates[i, 1], candidates[j, 0], candidates[j, 1]
            # Thin or tiny cells, and lattices that an earlier pair generates too, are left out.
            area = abs(x1 * y2 - x2 * y1)
            if area < 4 or area * area < 0.01 * (x1 * x1 + y1 * y1) * (x2 * x2 + y2 * y2):
                continue
            pair = reduce_pair((x1, y1, x2, y2))
            if is_listed(out[:m], pair):
                continue
            # The box, shrunk so that it holds at most about `most` lattice points.
            shrink = min(1.0, np.sqrt(most * area / (2 * reach[0] * reach[1])))
            end_x, end_y = shrink * reach[0], shrink * reach[1]
            points = count_multiples(pair, end_x, end_y)
            radius = max(tolerance * np.sqrt(pair[0] * pair[0] + pair[1] * pair[1]), 1.0)
            # The vote: as many of the most dominant peaks of the box as it has lattice points.
            seen, hits, total = 0, 0, 0
            for k in range(peaks.shape[0]):
                if seen == points:
                    break
                if abs(peaks[k, 0]) > end_x or abs(peaks[k, 1]) > end_y:
                    continue
                seen += 1
                if is_near_point(pair, peaks[k, 0], peaks[k, 1], radius):
                    hits += 1
                    total += heights[k]
            out[m, 0], out[m, 1], out[m, 2], out[m, 3] = pair
            out[m, 4], out[m, 5], out[m, 6] = points, hits, total
            m += 1
    return out[:m].copy()


@step_kernel
def mean_correlation(surface: Int32x2, pair: Pair, unit: float, end_x: float, end_y: float) -> float:
    """Return the mean correlation at a pair's multiples, each weighted by its overlap; -inf if there is none."""
    height, width = (surface.shape[0] + 1) // 2, surface.shape[1]
    x1, y1, x2, y2 = pair
    total, weights = 0.0, 0.0
    for b in range(count_rows(pair, end_x, end_y) + 1):
        first, last = half_row(pair, b, end_x, end_y)
        for a in range(first, last + 1):
            x, y = a * x1 + b * x2, a * y1 + b * y2
            if abs(x) > end_x or abs(y) > end_y:
                continue
            if x < 0:
                x, y = -x, -y
            weight = (height - abs(y)) * (width - x)
            total += weight * surface[int(np.rint(y)) + height - 1, int(np.rint(x))]
            weights += weight
    return total / (weights * unit) if weights > 0 else -np.inf


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
        for j in range(i + 1, n):
            pair = shorten_second((candidates[i, 0], candidates[i, 1], candidates[j, 0], candidates[j, 1]))
            x1, y1, x2, y2 = pair
            one, other, area = x1 * x1 + y1 * y1, x2 * x2 + y2 * y2, abs(x1 * y2 - x2 * y1)
            if area < 8 or area > height * width / 3.5 or area * area < 0.01 * max(one, other) * one:
                continue
            if other < 0.81 * one:
                continue
            mean = mean_correlation(surface, pair, unit, end_x, end_y)
            if mean > -np.inf:
                out[m, 0], out[m, 1], out[m, 2], out[m, 3] = pair
                out[m, 4] = mean
                m += 1
    return out[:m].copy()
