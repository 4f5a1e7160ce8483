"""Compiled loops of the correlation of windows: at many offsets, over the cells of courses, and between pixels."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from nrbench.jit import kernel

_FLAT = np.float32(1e-6)


@kernel("void(float32[:, ::1], float32[:, :, ::1], float32[:, ::1], float32[::1])")
def correlated(
    cross: NDArray[np.float32], seen: NDArray[np.float32], means: NDArray[np.float32], scale: NDArray[np.float32]
) -> None:
    """Turn sums over n windows at q offsets into their NCC, in place.

    Parameters
    ----------
    cross
        ``(n, q)``: sum of weights times window times template; becomes the NCC.
    seen
        ``(n, A + 1, q)``: weighted means of the window along A axes of color, and of its square.
    means
        ``(A, q)``: weighted sums of the template along these axes.
    scale
        ``(q,)``: one over the template's standard deviation and sum of weights; 0 where it shows nothing.
    """
    axes = means.shape[0]
    for n in range(cross.shape[0]):
        for k in range(cross.shape[1]):
            power, product = seen[n, axes, k], cross[n, k]
            for a in range(axes):
                power -= seen[n, a, k] * seen[n, a, k]
                product -= seen[n, a, k] * means[a, k]
            cross[n, k] = product * scale[k] / np.sqrt(max(power, _FLAT)) if power > _FLAT else np.float32(0)


@kernel("float64[::1](float32[:, :, ::1], int64[:, ::1], float32[:, :, ::1], int64[:, ::1], int64[::1])")
def correlations(
    planes: NDArray[np.float32],
    corners: NDArray[np.int64],
    template: NDArray[np.float32],
    offsets: NDArray[np.int64],
    window: NDArray[np.int64],
) -> NDArray[np.float64]:
    """Return the weighted NCC of each window at one offset of a template; 0 where one of the two shows nothing.

    Parameters
    ----------
    planes
        ``(C + 1, H, W)``: an image along axes of color, and the sum of its squares.
    corners
        ``(n, 2)``: (x, y) of each window's first pixel.
    template
        ``(2 + A, TH, TW)``: weights, weights times the sum of squares, and weights times the template along the A axes
        along which it varies.
    offsets
        ``(n, 2)``: (x, y) of the template's first pixel that is under it.
    window
        Height and width.
    """
    height, width = window[0], window[1]
    size, channels, axes = height * width, planes.shape[0] - 1, template.shape[0] - 2
    seen = np.empty((channels + 1, size), np.float32)
    under = np.empty((2 + axes, size), np.float32)
    found = np.zeros(corners.shape[0])
    for n in range(corners.shape[0]):
        x, y, left, top = corners[n, 0], corners[n, 1], offsets[n, 0], offsets[n, 1]
        for row in range(height):
            for k in range(channels + 1):
                for column in range(width):
                    seen[k, row * width + column] = planes[k, y + row, x + column]
            for k in range(2 + axes):
                for column in range(width):
                    under[k, row * width + column] = template[k, top + row, left + column]
        total, energy, power = np.float32(0), np.float32(0), np.float32(0)
        for i in range(size):
            total += under[0, i]
            energy += under[1, i]
            power += under[0, i] * seen[channels, i]
        cross, strength, variance = 0.0, float(energy), float(power)
        for k in range(channels):
            mean = np.float32(0)
            for i in range(size):
                mean += under[0, i] * seen[k, i]
            variance -= float(mean) ** 2 / float(total)
            if k < axes:
                own, product = np.float32(0), np.float32(0)
                for i in range(size):
                    own += under[2 + k, i]
                    product += under[2 + k, i] * seen[k, i]
                strength -= float(own) ** 2 / float(total)
                cross += float(product) - float(mean) * float(own) / float(total)
        if min(variance, strength) > 1e-6 * total:
            found[n] = cross / np.sqrt(variance * strength)
    return found


@kernel("float64[:, :, ::1](float32[:, :, ::1], float32[:, ::1], float64[:, ::1], int64, int64, int64)")
def course_sums(
    image: NDArray[np.float32],
    departures: NDArray[np.float32],
    places: NDArray[np.float64],
    first: int,
    rows: int,
    columns: int,
) -> NDArray[np.float64]:
    """Return, for each row across the courses and each column of one cell along them, sums over the pixels there.

    Parameters
    ----------
    image
        ``(H, W, C)``.
    departures
        ``(H, W)``: what is added to each pixel's sum of squares.
    places
        ``(2, 3)``: row and column of the pixel (0, 0), and by how much they grow along x and along y.
    first
        Row of the result's first.
    rows, columns
        Columns beyond the last begin again at the first.

    Returns
    -------
    NDArray[np.float64]
        ``(rows, columns, C + 2)``: how many pixels, their sum, and the sum of their squares over all channels.
    """
    height, width, channels = image.shape
    sums = np.zeros((rows, columns, channels + 2))
    for y in range(height):
        for x in range(width):
            row = int(np.floor(places[0, 0] + places[0, 1] * x + places[0, 2] * y)) - first
            along = places[1, 0] + places[1, 1] * x + places[1, 2] * y
            column = min(int(along - np.floor(along / columns) * columns), columns - 1)
            square = float(departures[y, x])
            for channel in range(channels):
                value = float(image[y, x, channel])
                sums[row, column, 1 + channel] += value
                square += value * value
            sums[row, column, 0] += 1
            sums[row, column, channels + 1] += square
    return sums


@kernel(
    "float64[:, ::1](float32[:, :, ::1], float32[:, :, ::1], int64[:, ::1], float64[:, ::1], int64[::1],"
    " float64[:, ::1], int64)"
)
def sums(
    image: NDArray[np.float32],
    cell: NDArray[np.float32],
    corners: NDArray[np.int64],
    start: NDArray[np.float64],
    window: NDArray[np.int64],
    inverse: NDArray[np.float64],
    step: int,
) -> NDArray[np.float64]:
    """Return the weighted sums from which each window's displacement is solved, a row a window.

    Parameters
    ----------
    image
        ``(H, W, C)``.
    cell
        ``(V, U, 1 + 3 A)``: one cell of the weights, of A channels of the periodic image, and of what each changes by
        in a px along x and along y; it wraps round, and is bilinear in between.
    corners
        ``(n, 2)``: (x, y) of each window's first pixel.
    start
        ``(n, 2)``: cell coordinates (u, v) of the periodic image under that pixel.
    window
        Height and width.
    inverse
        2 x 2: cell coordinates (u, v) of one px along x, and along y.
    step
        Every so many pixels, along both axes, one is looked at.

    Returns
    -------
    NDArray
        With t, p, q the periodic image and its two changes, and every channel's weighted mean over the window taken
        out first: weighted sums over pixels and channels of tt, tp, tq, pp, pq, qq, of the image times t, p, q, and of
        the image's own square. Time is linear in the pixels of the windows.
    """
    rows, columns, depth = cell.shape
    axes, channels = (depth - 1) // 3, image.shape[2]
    length = (window[1] + step - 1) // step
    found = np.zeros((corners.shape[0], 10))
    seen = np.zeros((depth, length), np.float32)
    value = np.zeros((channels, length), np.float32)
    at, share = np.zeros((4, length), np.uint32), np.zeros((4, length), np.float32)
    flat = cell.reshape(-1)
    linear = np.zeros((axes, 3))
    own = np.zeros(channels)
    for n in range(corners.shape[0]):
        total = 0.0
        linear[:] = 0.0
        own[:] = 0.0
        tt = tp = tq = pp = pq = qq = it = ip = iq = ii = 0.0
        for y in range(0, window[0], step):
            for x in range(length):
                across = step * x
                u = start[n, 0] + across * inverse[0, 0] + y * inverse[1, 0]
                v = start[n, 1] + across * inverse[0, 1] + y * inverse[1, 1]
                u = (u - np.floor(u)) * columns
                v = (v - np.floor(v)) * rows
                left, top = int(u), int(v)
                u -= left
                v -= top
                if left >= columns:
                    left = 0
                if top >= rows:
                    top = 0
                right = left + 1 if left + 1 < columns else 0
                below = top + 1 if top + 1 < rows else 0
                at[0, x], at[1, x] = (top * columns + left) * depth, (top * columns + right) * depth
                at[2, x], at[3, x] = (below * columns + left) * depth, (below * columns + right) * depth
                share[0, x], share[1, x] = (1 - u) * (1 - v), u * (1 - v)
                share[2, x], share[3, x] = (1 - u) * v, u * v
            for k in range(depth):
                for x in range(length):
                    seen[k, x] = (
                        share[0, x] * flat[at[0, x] + k]
                        + share[1, x] * flat[at[1, x] + k]
                        + share[2, x] * flat[at[2, x] + k]
                        + share[3, x] * flat[at[3, x] + k]
                    )
            for k in range(channels):
                for x in range(length):
                    value[k, x] = image[corners[n, 1] + y, corners[n, 0] + step * x, k]
            zero = np.float32(0)
            weight = zero
            for x in range(length):
                weight += seen[0, x]
            total += float(weight)
            for k in range(channels):
                one = two = zero
                for x in range(length):
                    scaled = seen[0, x] * value[k, x]
                    one += scaled
                    two += scaled * value[k, x]
                own[k] += one
                ii += float(two)
            for k in range(axes):
                t0 = p0 = q0 = t1 = p1 = q1 = p2 = q2 = q3 = t4 = p4 = q4 = zero
                for x in range(length):
                    t, p, q = seen[1 + k, x], seen[1 + axes + k, x], seen[1 + 2 * axes + k, x]
                    wt, wp, wq = seen[0, x] * t, seen[0, x] * p, seen[0, x] * q
                    t0 += wt
                    p0 += wp
                    q0 += wq
                    t1 += wt * t
                    p1 += wt * p
                    q1 += wt * q
                    p2 += wp * p
                    q2 += wp * q
                    q3 += wq * q
                    t4 += wt * value[k, x]
                    p4 += wp * value[k, x]
                    q4 += wq * value[k, x]
                linear[k, 0] += t0
                linear[k, 1] += p0
                linear[k, 2] += q0
                tt += float(t1)
                tp += float(p1)
                tq += float(q1)
                pp += float(p2)
                pq += float(q2)
                qq += float(q3)
                it += float(t4)
                ip += float(p4)
                iq += float(q4)
        for k in range(channels):
            ii -= own[k] * own[k] / total
            if k < axes:
                t, p, q = linear[k, 0] / total, linear[k, 1] / total, linear[k, 2] / total
                tt -= t * linear[k, 0]
                tp -= t * linear[k, 1]
                tq -= t * linear[k, 2]
                pp -= p * linear[k, 1]
                pq -= p * linear[k, 2]
                qq -= q * linear[k, 2]
                it -= own[k] * t
                ip -= own[k] * p
                iq -= own[k] * q
        found[n, :] = (tt, tp, tq, pp, pq, qq, it, ip, iq, ii)
    return found
