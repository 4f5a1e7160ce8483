"""Compiled loops of folding: mean tiles, values between their samples, and cubic splines for cutting tiles.

The cubic splines agree with those of :mod:`scipy.ndimage` to 1e-6. scipy computes one channel at a time and takes three
times as long for the coefficients and seven times as long for the values (256 x 256 x 3). The quintic splines of the
synthesizers are more precise, but need 36 products per value instead of 16.
"""

from __future__ import annotations

import numpy as np

from nrbench.jit import Float32View3, Float32x2, Float32x3, Float64x2, kernel

PAD = 2
"""Rows and columns of coefficients that are mirrored beyond the image's border."""


@kernel
def accumulate_pixels(pixels: Float32x2, uv: Float64x2, rows: int, columns: int) -> Float64x2:
    """Return the sum of the pixels' bilinear weights and the sums of their weighted values, for each sample of a tile.

    Parameters
    ----------
    pixels
        ``(n, C)``.
    uv
        ``(n, 2)``: their cell coordinates.
    rows, columns
        Samples of the tile along v and u.

    Returns
    -------
    NDArray
        ``(rows * columns, 1 + C)``: weights first. Time is linear in the number of pixels.
    """
    sums = np.zeros((rows * columns, 1 + pixels.shape[1]))
    for n in range(len(pixels)):
        u, v = uv[n, 0] % 1.0 * columns, uv[n, 1] % 1.0 * rows
        left, top = int(u), int(v)
        u -= left
        v -= top
        for dx in range(2):
            for dy in range(2):
                share = (u if dx else 1.0 - u) * (v if dy else 1.0 - v)
                at = (top + dy) % rows * columns + (left + dx) % columns
                sums[at, 0] += share
                for c in range(pixels.shape[1]):
                    sums[at, 1 + c] += share * pixels[n, c]
    return sums


@kernel
def interpolate_tile(values: Float32x3, uv: Float64x2) -> Float32x2:
    """Return the bilinear values of a tile ``(V, U, C)`` at cell coordinates ``(n, 2)``, as ``(n, C)``."""
    rows, columns, channels = values.shape
    found = np.zeros((len(uv), channels), np.float32)
    for n in range(len(uv)):
        u, v = uv[n, 0] % 1.0 * columns, uv[n, 1] % 1.0 * rows
        left, top = int(u), int(v)
        u -= left
        v -= top
        for dx in range(2):
            for dy in range(2):
                share = np.float32((u if dx else 1.0 - u) * (v if dy else 1.0 - v))
                y, x = (top + dy) % rows, (left + dx) % columns
                for c in range(channels):
                    found[n, c] += share * values[y, x, c]
    return found


@kernel
def filter_columns(values: Float32View3) -> None:
    """Replace values ``(H, W, C)`` by the coefficients of cubic splines along the first axis."""
    height, width, channels = values.shape
    pole = np.float32(np.sqrt(3.0) - 2.0)
    last, gain, horizon = np.float32(pole / (pole * pole - 1)), np.float32(6.0), 16
    for x in range(width):
        for c in range(channels):
            start, power = values[0, x, c], pole
            for k in range(1, min(height, horizon)):
                start += power * values[k, x, c]
                power *= pole
            values[0, x, c] = gain * start
    for y in range(1, height):
        for x in range(width):
            for c in range(channels):
                values[y, x, c] = gain * values[y, x, c] + pole * values[y - 1, x, c]
    for x in range(width):
        for c in range(channels):
            values[height - 1, x, c] = last * (values[height - 1, x, c] + pole * values[height - 2, x, c])
    for y in range(height - 2, -1, -1):
        for x in range(width):
            for c in range(channels):
                values[y, x, c] = pole * (values[y + 1, x, c] - values[y, x, c])


def spline_coefficients(image: Float32x3) -> Float32x3:
    """Return the coefficients of the cubic spline through an image that is mirrored about its outermost pixels.

    Parameters
    ----------
    image
        ``float32 (H, W, C)``, H and W at least 4.

    Returns
    -------
    NDArray[np.float32]
        ``(H + 4, W + 4, C)``: :data:`PAD` mirrored rows and columns on each side.

    Notes
    -----
    One recursion forwards and one backwards along each axis; O(pixels). It is no kernel: numba takes 6 s to compile the
    copies and the exchange of axes, which numpy does as fast. M. Unser, "Splines: a perfect fit for signal
    and image processing", IEEE Signal Processing Magazine 16, 1999.
    """
    height, width, channels = image.shape
    found = np.empty((height + 4, width + 4, channels), np.float32)
    inner = found[2 : height + 2, 2 : width + 2]
    inner[:] = image
    filter_columns(inner.transpose(1, 0, 2))
    filter_columns(inner)
    for k in range(1, 3):
        found[2 : height + 2, 2 - k] = found[2 : height + 2, 2 + k]
        found[2 : height + 2, width + 1 + k] = found[2 : height + 2, width + 1 - k]
    for k in range(1, 3):
        found[2 - k] = found[2 + k]
        found[height + 1 + k] = found[height + 1 - k]
    return found


@kernel
def interpolate_image(image: Float32x3, xy: Float64x2) -> Float32x2:
    """Return the bilinear values of an image ``(H, W, C)`` at places ``(n, 2)`` px inside it, as ``(n, C)``."""
    height, width, channels = image.shape
    found = np.empty((len(xy), channels), np.float32)
    for n in range(len(xy)):
        left, top = min(int(xy[n, 0]), width - 2), min(int(xy[n, 1]), height - 2)
        x, y = np.float32(xy[n, 0] - left), np.float32(xy[n, 1] - top)
        for c in range(channels):
            above = image[top, left, c] * (np.float32(1) - x) + image[top, left + 1, c] * x
            below = image[top + 1, left, c] * (np.float32(1) - x) + image[top + 1, left + 1, c] * x
            found[n, c] = above * (np.float32(1) - y) + below * y
    return found


@kernel
def spline_windows(coefficients: Float32x3, middles: Float64x2, around: Float64x2) -> Float32x3:
    """Return the values of a spline at the same offsets from each of several centers.

    Parameters
    ----------
    coefficients
        From :func:`spline_coefficients`.
    middles
        ``(n, 2)`` (x, y) px: the centers.
    around
        ``(m, 2)`` (x, y) px: the offsets. Every position must lie within the image.

    Returns
    -------
    NDArray[np.float32]
        ``(n, m, C)``.

    Notes
    -----
    O(n m C), 16 products per value.
    """
    height, width, channels = coefficients.shape
    found = np.empty((len(middles), len(around), channels), np.float32)
    across, down = np.empty(4, np.float32), np.empty(4, np.float32)
    for i in range(len(middles)):
        for j in range(len(around)):
            x, y = middles[i, 0] + around[j, 0], middles[i, 1] + around[j, 1]
            left = min(max(int(np.floor(x)), 0), width - 5)
            top = min(max(int(np.floor(y)), 0), height - 5)
            for axis in range(2):
                t = np.float32(x - left) if axis == 0 else np.float32(y - top)
                u = np.float32(1) - t
                share = across if axis == 0 else down
                share[0] = u * u * u / np.float32(6)
                share[1] = np.float32(2 / 3) - t * t * (np.float32(1) - t * np.float32(0.5))
                share[2] = np.float32(2 / 3) - u * u * (np.float32(1) - u * np.float32(0.5))
                share[3] = t * t * t / np.float32(6)
            for c in range(channels):
                total = np.float32(0)
                for row in range(4):
                    line = coefficients[top + 1 + row]
                    part = across[0] * line[left + 1, c] + across[1] * line[left + 2, c]
                    part += across[2] * line[left + 3, c] + across[3] * line[left + 4, c]
                    total += down[row] * part
                found[i, j, c] = total
    return found
