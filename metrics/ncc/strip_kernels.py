"""Compiled sums over the cells of courses."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from nrbench.jit import kernel


@kernel("float64[:, :, ::1](float32[:, :, ::1], float32[:, ::1], float64[:, ::1], int64, int64, int64)")
def course_sums(
    image: NDArray[np.float32],
    departures: NDArray[np.float32],
    places: NDArray[np.float64],
    first: int,
    rows: int,
    columns: int,
) -> NDArray[np.float64]:
    """Return, for each row across the courses and each column of one cell along them, sums over the pixels there.

    Parameters
    ----------
    image
        ``(H, W, C)``.
    departures
        ``(H, W)``: what is added to each pixel's sum of squares.
    places
        ``(2, 3)``: row and column of the pixel (0, 0), and by how much they grow along x and along y.
    first
        Row of the result's first.
    rows, columns
        Columns beyond the last begin again at the first.

    Returns
    -------
    NDArray[np.float64]
        ``(rows, columns, C + 2)``: how many pixels, their sum, and the sum of their squares over all channels.
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
