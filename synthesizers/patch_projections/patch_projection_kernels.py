"""The compiled loops of the sliced Wasserstein distance of patches: projections, ranks and the gradient."""

from __future__ import annotations

import numpy as np

from nrbench.jit import Float32x1, Float32x2, Float32x3, Float32x4, kernel, step_kernel

BINS = 1 << 14
"""Values are ranked by this many bins between the least and the largest one, and by position within a bin."""


_TOGETHER = 7
"""Taps of a filter that are added in one pass, so that a row is loaded and stored once for all of them."""


@step_kernel
def add_products(row: Float32x1, values: Float32x1, taps: Float32x1) -> None:
    """Add the product of each part of some values with the taps of a filter, tap by tap.

    Parameters
    ----------
    row
        ``(n,)``. The products are added to it.
    values
        ``(n + size - 1,)``: the part of element k begins at k.
    taps
        ``(size,)``.
    """
    width, size = len(row), len(taps)
    whole = size - size % _TOGETHER
    for j in range(0, whole, _TOGETHER):
        a, b, c, d, e, f, g = taps[j], taps[j + 1], taps[j + 2], taps[j + 3], taps[j + 4], taps[j + 5], taps[j + 6]
        part = values[j : j + width + 6]
        for x in range(width):
            first = row[x] + a * part[x] + b * part[x + 1] + c * part[x + 2] + d * part[x + 3]
            row[x] = first + e * part[x + 4] + f * part[x + 5] + g * part[x + 6]
    for j in range(whole, size):
        weight, part = taps[j], values[j : j + width]
        for x in range(width):
            row[x] += weight * part[x]


@kernel
def project_patches(planes: Float32x3, filters: Float32x4, projections: Float32x3) -> None:
    """Compute the product of every patch of an image with each filter.

    Parameters
    ----------
    planes
        ``(C, H, W)``.
    filters
        ``(P, C, size, size)``.
    projections
        ``(P, H - size + 1, W - size + 1)``. It is overwritten.
    """
    count, channels, size, _ = filters.shape
    height = projections.shape[1]
    for p in range(count):
        for y in range(height):
            row = projections[p, y]
            row[:] = 0
            for c in range(channels):
                for i in range(size):
                    add_products(row, planes[c, y + i], filters[p, c, i])


@kernel
def collect_gradient(slopes: Float32x3, filters: Float32x4, gradient: Float32x3) -> None:
    """Compute the gradient by the pixels from that by the projections.

    Parameters
    ----------
    slopes
        ``(P, H - size + 1, W - size + 1)``: derivatives by the projections.
    filters
        As in :func:`project_patches`.
    gradient
        ``(C, H, W)``. It is overwritten.
    """
    count, channels, size, _ = filters.shape
    _, height, width = slopes.shape
    # From right to left, so that each pixel adds its products in the order of the taps.
    mirrored = np.zeros_like(gradient)
    around = np.zeros((count, width + 2 * (size - 1)), np.float32)
    for y in range(height):
        around[:, size - 1 : size - 1 + width] = slopes[:, y, ::-1]
        for c in range(channels):
            for i in range(size):
                for p in range(count):
                    add_products(mirrored[c, y + i], around[p], filters[p, c, i])
    gradient[:] = mirrored[:, :, ::-1]


@kernel
def match_ranks(projections: Float32x2, targets: Float32x2, slopes: Float32x2) -> float:
    """Compute the mean absolute difference of values and the targets of the same rank, and its sign for each value.

    Parameters
    ----------
    projections
        ``(P, n)``.
    targets
        ``(P, m)``: ascending. Each stands for n / m values.
    slopes
        ``(P, n)``: -1, 0 or 1. It is overwritten.
    """
    count, n = projections.shape
    m = targets.shape[1]
    first = np.empty(BINS + 1, np.int64)
    total = 0.0
    for p in range(count):
        values, wanted, signs = projections[p], targets[p], slopes[p]
        low, high = values[0], values[0]
        for k in range(n):
            low, high = min(low, values[k]), max(high, values[k])
        scale = np.float32((BINS - 1) / (high - low)) if high > low else np.float32(0)
        first[:] = 0
        for k in range(n):
            first[int((values[k] - low) * scale) + 1] += 1
        for b in range(BINS):
            first[b + 1] += first[b]
        for k in range(n):
            b = int((values[k] - low) * scale)
            difference = values[k] - wanted[first[b] * m // n]
            first[b] += 1
            total += float(abs(difference))
            signs[k] = np.sign(difference)
    return float(total / (count * n))
