"""The compiled loop of frame matching."""

from __future__ import annotations

import numpy as np

from nrbench.jit import Float32x2, Float64x1, Int64x2, kernel

LONGEST_RUN = 256
"""Number of products of 8-bit values whose sum is exact in float32: 256 * 255^2 < 2^24."""


@kernel
def correlate_at(image: Float32x2, template: Float32x2, runs: Int64x2, positions: Int64x2) -> Float64x1:
    """Compute the sum of products of a template and the image under it, for each position.

    Parameters
    ----------
    image, template
        Rows of whole numbers from 0 to 255.
    runs
        ``(k, 3)``: row, first column and last column + 1 of each part of the template that counts, at most
        :data:`LONGEST_RUN` long.
    positions
        ``(n, 2)``: (column, row) of the template's first value in the image. The template must lie inside.

    Returns
    -------
    NDArray
        ``(n,)``, exact.
    """
    sums = np.zeros(positions.shape[0], np.float64)
    for n in range(positions.shape[0]):
        left, top = positions[n, 0], positions[n, 1]
        total = np.float64(0)
        for k in range(runs.shape[0]):
            row, start, stop = runs[k, 0], runs[k, 1], runs[k, 2]
            under = image[top + row, left + start : left + stop]
            over = template[row, start:stop]
            part = np.float32(0)
            for i in range(over.size):
                part += under[i] * over[i]
            total += part
        sums[n] = total
    return sums
