"""Compiled loops over the colors of elements, and over pairs of them."""

from __future__ import annotations

import numpy as np

from nrbench.jit import Boolx2, Float32x2, Float32x3, Float32x4, Float64x2, Float64x4, Int64x1, kernel


@kernel
def compare_tones(
    values: Float32x3, known: Boolx2, down: int, right: int, whole: Float32x4, unrelated: Float32x4, freedom: float
) -> tuple[Float32x2, Boolx2]:
    """Return the ratio (1 + d' W d / freedom) / (1 + d' V d / freedom) at each place, and the places with both values.

    Parameters
    ----------
    values, known
        ``(H, W, 3)`` and ``(H, W)``: colors at the places of cells, and the known ones.
    down, right
        Lag of the second value, from which the first one differs by d.
    whole, unrelated
        ``(p, p, 3, 3)``: W and V at each place of the cell, symmetric.
    freedom
        Degrees of freedom.
    """
    (height, width), places = known.shape, len(whole)
    ratio, both = np.ones((height, width), np.float32), np.zeros((height, width), np.bool_)
    for y in range(max(-down, 0), height - max(down, 0)):
        for x in range(max(-right, 0), width - max(right, 0)):
            if known[y, x] and known[y + down, x + right]:
                p, q, both[y, x] = y % places, x % places, True
                above, below = freedom, freedom
                for i in range(3):
                    for j in range(3):
                        product = values[y, x, i] - values[y + down, x + right, i]
                        product *= values[y, x, j] - values[y + down, x + right, j]
                        above += product * whole[p, q, i, j]
                        below += product * unrelated[p, q, i, j]
                ratio[y, x] = above / below
    return ratio, both


@kernel
def average_known(values: Float32x2, known: Boolx2, reach: int) -> tuple[Float32x2, Float32x2]:
    """Return the means over ``reach`` x ``reach`` places of values, ``(H, W)``, and of the known share.

    Unknown values and those beyond the border are 0. ``reach`` is odd. The means are those of
    :func:`scipy.ndimage.uniform_filter`, which filters one line at a time.
    """
    (height, width), half, side = known.shape, reach // 2, float(reach)
    means, share = np.empty((height, width), np.float32), np.empty((height, width), np.float32)
    total, count = np.empty(width), np.empty(width)
    line, shown = np.zeros(width + 2 * half), np.zeros(width + 2 * half)
    for y in range(height):
        total[:], count[:] = 0.0, 0.0
        for row in range(max(y - half, 0), min(y + half + 1, height)):
            for x in range(width):
                weight = np.float64(known[row, x])
                total[x] += values[row, x] * weight
                count[x] += weight
        for x in range(width):
            line[half + x], shown[half + x] = (
                np.float32(np.divide(total[x], side)),
                np.float32(np.divide(count[x], side)),
            )
        total[:], count[:] = 0.0, 0.0
        for step in range(reach):
            own, theirs = line[step:], shown[step:]
            for x in range(width):
                total[x] += own[x]
                count[x] += theirs[x]
        for x in range(width):
            means[y, x], share[y, x] = np.divide(total[x], side), np.divide(count[x], side)
    return means, share


@kernel
def sum_products(values: Float32x3, known: Boolx2, down: int, right: int, places: int) -> tuple[Float64x4, Float64x2]:
    """Return sums of products of colors at each place of the cell, ``(3, p, p, 9)``, and the pairs, ``(p, p)``.

    The products are those of the differences of pairs with themselves, of their first and of their second colors.
    """
    height, width = known.shape
    sums, count = np.zeros((3, places, places, 9)), np.zeros((places, places))
    for y in range(max(-down, 0), height - max(down, 0)):
        for x in range(max(-right, 0), width - max(right, 0)):
            if known[y, x] and known[y + down, x + right]:
                p, q = y % places, x % places
                count[p, q] += 1.0
                for i in range(3):
                    a, b = values[y, x, i], values[y + down, x + right, i]
                    for j in range(3):
                        c, d = values[y, x, j], values[y + down, x + right, j]
                        sums[0, p, q, 3 * i + j] += (a - b) * (c - d)
                        sums[1, p, q, 3 * i + j] += a * c
                        sums[2, p, q, 3 * i + j] += b * d
    return sums, count


@kernel
def cluster_colors(colors: Float64x2, first: int, count: int, rounds: int) -> tuple[Float64x2, Int64x1, Int64x1]:
    """Return the means of clusters, ``(k, 3)``, the number of each color's cluster, and the sizes of clusters.

    Parameters
    ----------
    colors
        ``(n, 3)``.
    first
        Number of the color that is the first center.
    count, rounds
        Number of clusters, and the largest number of rounds.

    Notes
    -----
    Each further center is the color farthest from the centers before it (Gonzalez 1985). Each round assigns the colors
    to the nearest centers and moves these to the means of their colors (Lloyd 1982), until no color changes its cluster
    or a cluster is empty.
    """
    centers, labels, counts = np.empty((count, 3)), np.full(len(colors), -1), np.zeros(count, np.int64)
    squares, far = np.full(len(colors), np.inf), first
    for k in range(count):
        for c in range(3):
            centers[k, c] = colors[far, c]
        far = 0
        for n in range(len(colors)):
            square = 0.0
            for c in range(3):
                square += (colors[n, c] - centers[k, c]) ** 2
            squares[n] = min(squares[n], square)
            far = n if squares[n] > squares[far] else far
    for _ in range(rounds):
        sums, changed, empty = np.zeros((count, 3)), False, count
        counts[:] = 0
        for n in range(len(colors)):
            least, label = np.inf, 0
            for k in range(count):
                square = 0.0
                for c in range(3):
                    square += (colors[n, c] - centers[k, c]) ** 2
                if square < least:
                    least, label = square, k
            changed |= label != labels[n]
            labels[n] = label
            empty -= counts[label] == 0
            counts[label] += 1
            for c in range(3):
                sums[label, c] += colors[n, c]
        if empty > 0 or not changed:
            break
        for k in range(count):
            for c in range(3):
                centers[k, c] = sums[k, c] / counts[k]
    return centers, labels, counts
