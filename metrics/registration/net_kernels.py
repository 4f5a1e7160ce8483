"""Compiled loops of a net: values between pixels, and lengths of displacements modulo the lattice."""

from __future__ import annotations

import numpy as np

from nrbench.jit import Float32View3, Float32x2, Float64x1, Float64x2, kernel


@kernel
def interpolate_pixels(planes: Float32View3, points: Float64x2) -> Float32x2:
    """Return the values of planes ``(H, W, C)`` at points (x, y), ``(n, 2)``, interpolated linearly, as ``(n, C)``.

    Points beyond the border have the values of the nearest pixel. The values are those of
    :func:`scipy.ndimage.map_coordinates`, which takes one plane at a time and calculates each weight anew.
    """
    height, width, channels = planes.shape
    found = np.empty((len(points), channels), np.float32)
    for n in range(len(points)):
        x, y = min(max(points[n, 0], 0.0), width - 1.0), min(max(points[n, 1], 0.0), height - 1.0)
        left, top = min(int(x), width - 2), min(int(y), height - 2)
        u, v = x - left, y - top
        for c in range(channels):
            above = planes[top, left, c] * (1.0 - v) * (1.0 - u) + planes[top, left + 1, c] * (1.0 - v) * u
            below = planes[top + 1, left, c] * v * (1.0 - u) + planes[top + 1, left + 1, c] * v * u
            found[n, c] = above + below
    return found


@kernel
def measure_lengths(displacements: Float64x2, vectors: Float64x2) -> Float64x1:
    """Return the length px of displacements in cell coordinates, ``(n, 2)``, modulo the lattice of reduced vectors."""
    lengths = np.empty(len(displacements))
    for n in range(len(displacements)):
        u, v = displacements[n]
        u, v = u - np.rint(u), v - np.rint(v)
        least = np.inf
        for i in range(-1, 2):
            for j in range(-1, 2):
                x = (u + i) * vectors[0, 0] + (v + j) * vectors[1, 0]
                y = (u + i) * vectors[0, 1] + (v + j) * vectors[1, 1]
                least = min(least, x * x + y * y)
        lengths[n] = np.sqrt(least)
    return lengths
