"""The compiled loop of frame matching."""

from __future__ import annotations

import numpy as np

from nrbench.jit import Float32x3, Float64x1, Int64x2, kernel

LONGEST_RUN = 256
"""Number of products of 8-bit values whose sum is exact in float32: 256 * 255^2 < 2^24."""


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
    flat_image, flat_template = image.reshape(len(image), -1), template.reshape(height, -1)
    end = width * channels
    sums = np.zeros(positions.shape[0], np.float64)
    for n in range(positions.shape[0]):
        left, top = positions[n, 0] * channels, positions[n, 1]
        total = np.float64(0)
        for y in range(height):
            before, after = (x0 * channels, x1 * channels) if y0 <= y < y1 else (end, end)
            for start, stop in ((0, before), (after, end)):
                for first in range(start, stop, LONGEST_RUN):
                    last = min(first + LONGEST_RUN, stop)
                    under = flat_image[top + y, left + first : left + last]
                    over = flat_template[y, first:last]
                    part = np.float32(0)
                    for i in range(over.size):
                        part += under[i] * over[i]
                    total += part
        sums[n] = total
    return sums
