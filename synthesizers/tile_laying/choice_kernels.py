"""The compiled steps before a tile is pasted: what stands under it, which tiles fit there, its registration, its seams.

Small tiles are laid by the thousand: each step is one call, whatever it loops over.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from nrbench.jit import kernel

from ..seams.seam_kernels import cheapest_path
from .tile_kernels import product_sums


@kernel(
    "UniTuple(int64, 2)(uint8[:, :, ::1], uint8[:, ::1], int64[:, ::1], int64, int64, uint8[:, ::1], int64[:, ::1])"
)
def gather(
    canvas: NDArray[np.uint8],
    filled: NDArray[np.uint8],
    pixels: NDArray[np.int64],
    left: int,
    top: int,
    values: NDArray[np.uint8],
    runs: NDArray[np.int64],
) -> tuple[int, int]:
    """Write what stands under a tile, and return how many pixels and how many runs that are.

    Parameters
    ----------
    canvas, filled, pixels, left, top
        As in :func:`~nrbench.synthesizers.tile_laying.tile_kernels.paste`.
    values
        ``(n, C)``, written: the pixels that stand there.
    runs
        ``(n, 3)``, written: see :class:`~nrbench.synthesizers.tile_laying.stock.Overlap`.
    """
    channels = canvas.shape[2]
    count, number, following = 0, 0, np.int64(0)
    for k in range(pixels.shape[0]):
        x, y, step = left + pixels[k, 0], top + pixels[k, 1], pixels[k, 2]
        if filled[y, x] == 0:
            continue
        if number == 0 or step != following:
            runs[number, 0], runs[number, 1], runs[number, 2] = count * channels, 0, step
            number += 1
        runs[number - 1, 1] += channels
        following = step + channels
        for c in range(channels):
            values[count, c] = canvas[y, x, c]
        count += 1
    return count, number


@kernel("int64[:, ::1](float64[:, ::1], int64, int64[:, ::1], int64, int64)")
def nearest_places(
    places: NDArray[np.float64], parts: int, box: NDArray[np.int64], height: int, width: int
) -> NDArray[np.int64]:
    """Return the nearest places that copies have, and whether a tile around them lies inside the sample.

    Parameters
    ----------
    places
        ``(p, 2)``: (x, y).
    parts
        Of a pixel.
    box
        ``(2, 2)``: the least and the greatest (x, y) of a tile's pixels.
    height, width
        Of the sample.

    Returns
    -------
    NDArray
        ``(p, 4)``: copy of the first picture, pixel (x, y), and 1 where the tile and the pixels that it is interpolated
        from lie inside, else 0.
    """
    found = np.empty((places.shape[0], 4), np.int64)
    for p in range(places.shape[0]):
        u = np.int64(math.floor(places[p, 0] * parts + 0.5))
        v = np.int64(math.floor(places[p, 1] * parts + 0.5))
        x, y = u // parts, v // parts
        right, below = u - x * parts, v - y * parts
        within = x + box[0, 0] >= 0 and x + box[1, 0] + (1 if right > 0 else 0) <= width - 1
        within = within and y + box[0, 1] >= 0 and y + box[1, 1] + (1 if below > 0 else 0) <= height - 1
        found[p, 0], found[p, 1], found[p, 2] = below * parts + right, x, y
        found[p, 3] = 1 if within else 0
    return found


@kernel(
    "int64[::1](uint8[::1], int64[:, ::1], uint8[:, ::1], int64, int64, int64, int64, float64[::1], float64[::1],"
    " float64, int64[:, ::1], int64)"
)
def best_move(
    values: NDArray[np.uint8],
    runs: NDArray[np.int64],
    sources: NDArray[np.uint8],
    height: int,
    width: int,
    channels: int,
    parts: int,
    here: NDArray[np.float64],
    middle: NDArray[np.float64],
    radius: float,
    box: NDArray[np.int64],
    first: int,
) -> NDArray[np.int64]:
    """Return to where a tile is moved that correlates best with what stands there.

    Parameters
    ----------
    values, runs, sources
        As in :func:`~nrbench.synthesizers.tile_laying.tile_kernels.absolute_differences`.
    height, width, channels, parts, box
        Of the sample, of a pixel, of a tile, as in :func:`nearest_places`.
    here, middle
        ``(2,)``: where the tile is, and its true middle, (x, y).
    radius
        How far, px, from the middle it may be moved.
    first
        First copy of the tile's picture.

    Returns
    -------
    NDArray
        ``(3,)``: copy and pixel (x, y). Of moves that correlate alike none, then the one nearest to the true middle.
    """
    reach = np.int64(radius * parts + 0.5)
    side = 2 * reach + 1
    moves = np.empty((side * side + 1, 2))
    for m in range(side * side):
        moves[m + 1, 0], moves[m + 1, 1] = (
            here[0] + (m % side - reach) / parts,
            here[1] + (m // side - reach) / parts,
        )
    moves[0] = here
    found = nearest_places(moves, parts, box, height, width)
    places = np.empty((moves.shape[0], 2), np.int64)
    away = np.empty(moves.shape[0])
    count = 0
    for m in range(moves.shape[0]):
        distance = math.hypot(moves[m, 0] - middle[0], moves[m, 1] - middle[1])
        if m == 0 or (distance <= radius and found[m, 3] == 1):
            away[count] = distance if m else -1.0
            found[count] = found[m]
            places[count, 0] = first + found[m, 0]
            places[count, 1] = (found[m, 2] * width + found[m, 1]) * channels
            count += 1
    sums = product_sums(values, runs, sources, places[:count], channels)
    total = np.zeros(channels, np.int64)
    for i in range(values.size):
        total[i % channels] += np.int64(values[i])
    size = values.size // channels
    best, highest = 0, -math.inf
    for m in range(count):
        covariance, variance = np.int64(0), np.int64(0)
        for c in range(channels):
            covariance += sums[m, c, 2] * size - sums[m, c, 0] * total[c]
            variance += sums[m, c, 1] * size - sums[m, c, 0] * sums[m, c, 0]
        correlation = covariance / math.sqrt(variance if variance > 1 else 1)
        if correlation > highest or (correlation == highest and away[m] < away[best]):
            best, highest = m, correlation
    return np.array([first + found[best, 0], found[best, 1], found[best, 2]])


@kernel("int64[::1](float64[:, ::1], int64, int64)")
def wide_seam(error: NDArray[np.float64], band: int, slope: int) -> NDArray[np.int64]:
    """Return the seam through the first columns of a surface, its rows each taken ``slope`` times.

    So one row lets the seam move so far aside. Negative errors, where nothing stands, count as 0; with no band the
    seam is 0 all along.
    """
    rows = error.shape[0]
    path = np.zeros(rows, np.int64)
    if band == 0:
        return path
    steep = np.empty((rows * slope, band))
    for i in range(rows):
        for j in range(band):
            steep[i * slope : (i + 1) * slope, j] = max(error[i, j], 0.0)
    found = cheapest_path(steep)
    for i in range(rows):
        path[i] = found[i * slope + slope // 2]
    return path


@kernel("int64(float64[:, ::1])")
def band_width(surface: NDArray[np.float64]) -> int:
    """Return how far what stands reaches from the left, in rows where something is missing (negative)."""
    width = 0
    for i in range(surface.shape[0]):
        for j in range(surface.shape[1]):
            if surface[i, j] < 0:
                width = max(width, j)
                break
    return width
