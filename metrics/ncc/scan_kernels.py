"""Compiled loops of the search for windows: their NCC from sums at many offsets, and exactly at one."""

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
