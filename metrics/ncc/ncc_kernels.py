"""Compiled kernels: NCC of windows at many offsets and between pixels, and sums over the cells of courses."""

from __future__ import annotations

import numpy as np

from nrbench.jit import Float32x1, Float32x2, Float32x3, Float64x1, Float64x2, Float64x3, Int64x1, Int64x2, kernel

_FLAT = np.float32(1e-6)


@kernel
def normalize_sums(cross: Float32x2, window_means: Float32x3, template_sums: Float32x2, scale: Float32x1) -> None:
    """Compute the NCC of n windows at q offsets from weighted sums, in place.

    Parameters
    ----------
    cross
        ``(n, q)``: sum of weights times window times template, which the NCC replaces.
    window_means
        ``(n, A + 1, q)``: weighted means of the window along A axes of color, and of the sum of its squares.
    template_sums
        ``(A, q)``: weighted sums of the template along these axes.
    scale
        ``(q,)``: one over the product of the template's standard deviation and the sum of weights; 0 where the template
        is flat.
    """
    axes = template_sums.shape[0]
    for n in range(cross.shape[0]):
        for k in range(cross.shape[1]):
            power, product = window_means[n, axes, k], cross[n, k]
            for a in range(axes):
                power -= window_means[n, a, k] * window_means[n, a, k]
                product -= window_means[n, a, k] * template_sums[a, k]
            cross[n, k] = product * scale[k] / np.sqrt(max(power, _FLAT)) if power > _FLAT else np.float32(0)


@kernel
def compute_ncc(
    planes: Float32x3, corners: Int64x2, template: Float32x3, offsets: Int64x2, window: Int64x1
) -> Float64x1:
    """Return the weighted NCC of each window with the template at one offset; 0 where one of the two is flat.

    Parameters
    ----------
    planes
        ``(C + 1, H, W)``: an image along C axes of color, and the sum of their squares.
    corners
        ``(n, 2)``: (x, y) of each window's first pixel.
    template
        ``(2 + A, TH, TW)``: weights, weights times the sum of squares, and weights times the template along the A axes
        of color along which it varies.
    offsets
        ``(n, 2)``: (x, y) of the template pixel that is compared with the window's first pixel.
    window
        Height and width.
    """
    height, width = window[0], window[1]
    size, channels, axes = height * width, planes.shape[0] - 1, template.shape[0] - 2
    pixels = np.empty((channels + 1, size), np.float32)
    patch = np.empty((2 + axes, size), np.float32)
    ncc = np.zeros(corners.shape[0])
    for n in range(corners.shape[0]):
        x, y, left, top = corners[n, 0], corners[n, 1], offsets[n, 0], offsets[n, 1]
        for row in range(height):
            for k in range(channels + 1):
                for column in range(width):
                    pixels[k, row * width + column] = planes[k, y + row, x + column]
            for k in range(2 + axes):
                for column in range(width):
                    patch[k, row * width + column] = template[k, top + row, left + column]
        total, energy, power = np.float32(0), np.float32(0), np.float32(0)
        for i in range(size):
            total += patch[0, i]
            energy += patch[1, i]
            power += patch[0, i] * pixels[channels, i]
        cross, strength, variance = 0.0, float(energy), float(power)
        for k in range(channels):
            mean = np.float32(0)
            for i in range(size):
                mean += patch[0, i] * pixels[k, i]
            variance -= float(mean) ** 2 / float(total)
            if k < axes:
                own, product = np.float32(0), np.float32(0)
                for i in range(size):
                    own += patch[2 + k, i]
                    product += patch[2 + k, i] * pixels[k, i]
                strength -= float(own) ** 2 / float(total)
                cross += float(product) - float(mean) * float(own) / float(total)
        if min(variance, strength) > 1e-6 * total:
            ncc[n] = cross / np.sqrt(variance * strength)
    return ncc


@kernel
def sum_courses(
    image: Float32x3, departures: Float32x2, places: Float64x2, first: int, rows: int, columns: int
) -> Float64x3:
    """Return the sums over the pixels on each sample of the courses of one direction.

    A sample has a row, which counts across the courses, and a column, which counts along one cell of a course. Columns
    repeat with the cells.

    Parameters
    ----------
    image
        ``(H, W, C)``.
    departures
        ``(H, W)``: value that is added to the sum of squares of each pixel.
    places
        ``(2, 3)``: row and column of the pixel (0, 0), and by how much they grow per px along x and along y.
    first
        Row that is the first row of the result.
    rows, columns
        Shape of the result.

    Returns
    -------
    NDArray[np.float64]
        ``(rows, columns, C + 2)``: number of pixels, sum of each channel, and sum of squares over all channels.
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


@kernel
def sum_products(
    image: Float32x3,
    cell: Float32x3,
    corners: Int64x2,
    start: Float64x2,
    window: Int64x1,
    inverse: Float64x2,
    step: int,
) -> Float64x2:
    """Return the weighted sums of products from which the displacement of each window is computed.

    Parameters
    ----------
    image
        ``(H, W, C)``.
    cell
        ``(V, U, 1 + 3 A)``: one cell of the weights, of A channels of the periodic image, and of the derivatives of
        each per px along x and along y. It is periodic, and interpolated bilinearly.
    corners
        ``(n, 2)``: (x, y) of each window's first pixel.
    start
        ``(n, 2)``: cell coordinates (u, v) of the point of the periodic image that this pixel is compared with.
    window
        Height and width.
    inverse
        2 x 2: change of the cell coordinates (u, v) per px along x, and along y.
    step
        Distance, px, between the pixels that are used, along both axes.

    Returns
    -------
    NDArray[np.float64]
        ``(n, 10)``: weighted sums over pixels and channels of tt, tp, tq, pp, pq, qq, it, ip, iq and ii. Here t is the
        periodic image, p and q are its derivatives along x and y, and i is the image, each less its weighted mean over
        the window. Time is linear in the pixels of the windows.
    """
    rows, columns, depth = cell.shape
    axes, channels = (depth - 1) // 3, image.shape[2]
    length = (window[1] + step - 1) // step
    result = np.zeros((corners.shape[0], 10))
    sampled = np.zeros((depth, length), np.float32)
    value = np.zeros((channels, length), np.float32)
    at, corner_weights = np.zeros((4, length), np.uint32), np.zeros((4, length), np.float32)
    flat = cell.reshape(-1)
    template_sums = np.zeros((axes, 3))
    image_sums = np.zeros(channels)
    for n in range(corners.shape[0]):
        total = 0.0
        template_sums[:] = 0.0
        image_sums[:] = 0.0
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
                corner_weights[0, x], corner_weights[1, x] = (1 - u) * (1 - v), u * (1 - v)
                corner_weights[2, x], corner_weights[3, x] = (1 - u) * v, u * v
            for k in range(depth):
                for x in range(length):
                    sampled[k, x] = (
                        corner_weights[0, x] * flat[at[0, x] + k]
                        + corner_weights[1, x] * flat[at[1, x] + k]
                        + corner_weights[2, x] * flat[at[2, x] + k]
                        + corner_weights[3, x] * flat[at[3, x] + k]
                    )
            for k in range(channels):
                for x in range(length):
                    value[k, x] = image[corners[n, 1] + y, corners[n, 0] + step * x, k]
            zero = np.float32(0)
            weight = zero
            for x in range(length):
                weight += sampled[0, x]
            total += float(weight)
            for k in range(channels):
                one = two = zero
                for x in range(length):
                    scaled = sampled[0, x] * value[k, x]
                    one += scaled
                    two += scaled * value[k, x]
                image_sums[k] += one
                ii += float(two)
            for k in range(axes):
                t0 = p0 = q0 = t1 = p1 = q1 = p2 = q2 = q3 = t4 = p4 = q4 = zero
                for x in range(length):
                    t, p, q = sampled[1 + k, x], sampled[1 + axes + k, x], sampled[1 + 2 * axes + k, x]
                    wt, wp, wq = sampled[0, x] * t, sampled[0, x] * p, sampled[0, x] * q
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
                template_sums[k, 0] += t0
                template_sums[k, 1] += p0
                template_sums[k, 2] += q0
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
            ii -= image_sums[k] * image_sums[k] / total
            if k < axes:
                t, p, q = template_sums[k, 0] / total, template_sums[k, 1] / total, template_sums[k, 2] / total
                tt -= t * template_sums[k, 0]
                tp -= t * template_sums[k, 1]
                tq -= t * template_sums[k, 2]
                pp -= p * template_sums[k, 1]
                pq -= p * template_sums[k, 2]
                qq -= q * template_sums[k, 2]
                it -= image_sums[k] * t
                ip -= image_sums[k] * p
                iq -= image_sums[k] * q
        result[n, :] = (tt, tp, tq, pp, pq, qq, it, ip, iq, ii)
    return result
