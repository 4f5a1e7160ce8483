"""Compiled loops of the blur of planes."""

from __future__ import annotations

import numpy as np

from nrbench.jit import Float32x2, Float64x1, inlined_kernel, kernel


@inlined_kernel
def _find_place(place: int, size: int, mirrored: bool) -> int:
    """Return the place inside that has the value of one beyond the border."""
    if mirrored:
        place %= 2 * size
        return min(place, 2 * size - 1 - place)
    return min(max(place, 0), size - 1)


@kernel
def blur_plane(plane: Float32x2, weights: Float64x1, mirrored: bool) -> Float32x2:
    """Return a plane ``(H, W)`` filtered along both axes by symmetric weights, from the middle one to the last.

    Beyond the border the plane is mirrored, or has the values of the nearest pixel. The values are those of
    :func:`scipy.ndimage.correlate1d`, which filters one line at a time, for the modes ``reflect`` and ``nearest``.
    """
    (height, width), reach = plane.shape, len(weights) - 1
    total, line = np.empty(width), np.empty(width + 2 * reach)
    blurred = np.empty((height, width), np.float32)
    for y in range(height):
        for x in range(width):
            total[x] = plane[y, x] * weights[0]
        for k in range(reach, 0, -1):
            above, below = plane[_find_place(y - k, height, mirrored)], plane[_find_place(y + k, height, mirrored)]
            weight = weights[k]
            for x in range(width):
                total[x] += (np.float64(above[x]) + np.float64(below[x])) * weight
        for x in range(width):
            line[reach + x] = np.float32(total[x])
        for x in range(reach):
            line[x] = line[reach + _find_place(x - reach, width, mirrored)]
            line[reach + width + x] = line[reach + _find_place(width + x, width, mirrored)]
        for x in range(width):
            total[x] = line[reach + x] * weights[0]
        for k in range(reach, 0, -1):
            # By slices: of an index that may be negative, numba makes no loop of vectors.
            before, after, weight = line[reach - k :], line[reach + k :], weights[k]
            for x in range(width):
                total[x] += (before[x] + after[x]) * weight
        for x in range(width):
            blurred[y, x] = total[x]
    return blurred
