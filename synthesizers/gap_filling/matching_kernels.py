"""The compiled loop of frame matching."""

from __future__ import annotations

import numpy as np

from nrbench.jit import Float32x3, Float64x1, Int64x2, kernel


@kernel
def correlate_at(
    image: Float32x3, template: Float32x3, hole: tuple[int, int, int, int], positions: Int64x2
) -> Float64x1:
    """Compute the sum of products of a template and the image under it, for each position.

    Parameters
    ----------
    image, template
        ``(H, W, C)`` and ``(h, w, C)``: whole numbers from 0 to 255.
    hole
        (y0, y1, x0, x1): the part of the template that does not count.
    positions
        ``(n, 2)``: (x, y) of the template's first pixel in the image. The template must lie inside.

    Returns
    -------
    NDArray
        ``(n,)``, exact.
    """
    height, width, channels = template.shape
    y0, y1, x0, x1 = hole
    sums = np.zeros(positions.shape[0], np.float64)
    for n in range(positions.shape[0]):
        left, top = positions[n, 0], positions[n, 1]
        for y in range(height):
            start, stop = (x0, x1) if y0 <= y < y1 else (width, width)
            for x in range(start):
                for c in range(channels):
                    sums[n] += np.float64(image[top + y, left + x, c]) * np.float64(template[y, x, c])
            for x in range(stop, width):
                for c in range(channels):
                    sums[n] += np.float64(image[top + y, left + x, c]) * np.float64(template[y, x, c])
    return sums
