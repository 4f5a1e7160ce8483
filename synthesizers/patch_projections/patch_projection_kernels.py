"""The compiled loops of the sliced Wasserstein distance of patches: projections, ranks and the gradient."""

from __future__ import annotations

import numpy as np

from nrbench.jit import Float32x2, Float32x3, Float32x4, kernel

BINS = 1 << 14
"""Values are ranked by this many bins between the least and the largest one, and by position within a bin."""


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
    _, height, width = projections.shape
    for p in range(count):
        for y in range(height):
            row = projections[p, y]
            row[:] = 0
            for c in range(channels):
                for i in range(size):
                    for j in range(size):
                        weight, values = filters[p, c, i, j], planes[c, y + i, j : j + width]
                        for x in range(width):
                            row[x] += weight * values[x]


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
    gradient[:] = 0
    for c in range(channels):
        for y in range(height):
            for i in range(size):
                row = gradient[c, y + i]
                for p in range(count):
                    values = slopes[p, y]
                    for j in range(size):
                        weight, part = filters[p, c, i, j], row[j : j + width]
                        for x in range(width):
                            part[x] += weight * values[x]


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
