"""Compiled loops of a net: values between pixels, means of blocks, and misfits of cells."""

from __future__ import annotations

import numpy as np

from nrbench.jit import Boolx1, Boolx2, Float32x2, Float32x3, Float32x4, Float64x2, Float64x3, Int64x2, Int64x3, kernel


@kernel
def interpolate_pixels(planes: Float32x3, points: Float64x2, known: Boolx1) -> Float32x2:
    """Return the values of planes ``(H, W, C)`` at known points (x, y), ``(n, 2)``, interpolated linearly, ``(n, C)``.

    Unknown points have the values 0, and those beyond the border the ones of the nearest pixel. The values are those of
    :func:`scipy.ndimage.map_coordinates`, which takes one plane at a time and calculates each weight anew.
    """
    height, width, channels = planes.shape
    found, pixels = np.zeros((len(points), channels), np.float32), planes.reshape(height * width, channels)
    for n in range(len(points)):
        if not known[n]:
            continue
        x, y = min(max(points[n, 0], 0.0), width - 1.0), min(max(points[n, 1], 0.0), height - 1.0)
        left, top = min(int(x), width - 2), min(int(y), height - 2)
        u, v = x - left, y - top
        first, second, third, fourth = (1.0 - v) * (1.0 - u), (1.0 - v) * u, v * (1.0 - u), v * u
        p, one = np.uint64(top * width + left), np.uint64(1)  # no index is negative, so the loop is one of vectors
        q = p + np.uint64(width)
        for c in range(channels):
            above = pixels[p, c] * first + pixels[p + one, c] * second
            found[n, c] = above + (pixels[q, c] * third + pixels[q + one, c] * fourth)
    return found


@kernel
def average_blocks(planes: Float32x3, known: Boolx2, rows: int, columns: int) -> tuple[Float64x3, Float64x2]:
    """Return the means of planes ``(H, W, C)`` over blocks of ``rows`` x ``columns``, and the known share of each.

    Where a point is unknown, it counts as 0.
    """
    height, width, channels = planes.shape[0] // rows, planes.shape[1] // columns, planes.shape[2]
    means, share = np.zeros((height, width, channels)), np.zeros((height, width))
    for i in range(height):
        for y in range(i * rows, (i + 1) * rows):
            for j in range(width):
                for x in range(j * columns, (j + 1) * columns):
                    if known[y, x]:
                        share[i, j] += 1.0
                        for c in range(channels):
                            means[i, j, c] += planes[y, x, c]
    return means / (rows * columns), share / (rows * columns)


@kernel
def measure_misfits(
    plane: Float32x3, means: Float32x4, weights: Float32x4, number: Int64x2, moves: Int64x3, first: int
) -> Float32x2:
    """Return the weighted mean squared differences of the single cells at nodes, moved, from mean cells, ``(R, C)``.

    Parameters
    ----------
    plane
        ``(N1 n1, N2 n2, 3)``, in the order of a net.
    means, weights
        ``(k, n1, n2, 3)``: mean cells, and the weights of their points.
    number
        ``(R, C)``: which mean cell counts at each node.
    moves
        ``(R, C, 2)``: displacements in samples.
    first
        Number of the half cell in which the cell of the first node begins, along both vectors.
    """
    rows, columns = number.shape
    n1, n2 = means.shape[1:3]
    misfits = np.empty((rows, columns), np.float32)
    for r in range(rows):
        top = (first + r) * (n1 // 2)
        for c in range(columns):
            left, k, total = (first + c) * (n2 // 2), number[r, c], 0.0
            for i in range(n1):
                y = top + (i + moves[r, c, 0] - top) % n1
                for j in range(n2):
                    x = left + (j + moves[r, c, 1] - left) % n2
                    for channel in range(3):
                        away = plane[y, x, channel] - means[k, i, j, channel]
                        total += weights[k, i, j, channel] * away * away
            misfits[r, c] = total
    return misfits
