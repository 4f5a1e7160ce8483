"""The compiled steps that choose a tile: what is filled under it, which tiles fit there, and its registration.

Small tiles are laid by the thousand, so that each step is one call. Pixels are 8-bit whole numbers and all sums are
exact: equal tiles tie, and results do not depend on the machine.
"""

from __future__ import annotations

import math

import numpy as np

from nrbench.jit import Float64x1, Float64x2, Int64x1, Int64x2, Int64x3, UInt8x1, UInt8x2, UInt8x3, kernel


@kernel
def gather(
    canvas: UInt8x3, filled: UInt8x2, pixels: Int64x2, left: int, top: int, values: UInt8x2, runs: Int64x2
) -> tuple[int, int]:
    """Write the filled pixels under a tile, and return the number of pixels and of runs.

    Parameters
    ----------
    canvas, filled, pixels, left, top
        As in :func:`~nrbench.synthesizers.tile_laying.stitch_kernels.paste`.
    values
        ``(n, C)``, written: the filled pixels.
    runs
        ``(n, 3)``, written: see :class:`~nrbench.synthesizers.tile_laying.tile_stock.CoveredPixels`.
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


@kernel
def absolute_differences(values: UInt8x1, runs: Int64x2, sources: UInt8x2, places: Int64x2) -> Int64x1:
    """Compute, for each place of a source, the sum of absolute differences between its values and those of an overlap.

    Parameters
    ----------
    values
        ``(m,)``: the values of the overlap.
    runs
        ``(r, 3)``: contiguous parts of the overlap: first value, length, and offset of the source's first value from
        a place.
    sources
        ``(k, n)``: the sources' values, flat.
    places
        ``(p, 2)``: source and position.

    Returns
    -------
    NDArray
        ``(p,)``.
    """
    sums = np.zeros(places.shape[0], np.int64)
    for p in range(places.shape[0]):
        source, first = sources[places[p, 0]], places[p, 1]
        total = np.int64(0)
        for r in range(runs.shape[0]):
            here = values[runs[r, 0] : runs[r, 0] + runs[r, 1]]
            there = source[first + runs[r, 2] : first + runs[r, 2] + runs[r, 1]]
            part = np.int32(0)
            for i in range(here.size):
                part += np.int32(abs(np.int32(here[i]) - np.int32(there[i])))
            total += part
        sums[p] = total
    return sums


@kernel
def product_sums(values: UInt8x1, runs: Int64x2, sources: UInt8x2, places: Int64x2, channels: int) -> Int64x3:
    """Compute, for each place of a source, the sums of its values, their squares, and their products with an overlap.

    Parameters as in :func:`absolute_differences`, each run of whole pixels; the result is ``(p, channels, 3)``.
    """
    sums = np.zeros((places.shape[0], channels, 3), np.int64)
    for p in range(places.shape[0]):
        source, first = sources[places[p, 0]], places[p, 1]
        for r in range(runs.shape[0]):
            for i in range(runs[r, 1]):
                value = np.int64(source[first + runs[r, 2] + i])
                channel = i % channels
                sums[p, channel, 0] += value
                sums[p, channel, 1] += value * value
                sums[p, channel, 2] += value * np.int64(values[runs[r, 0] + i])
    return sums


@kernel
def nearest_places(places: Float64x2, parts: int, box: Int64x2, height: int, width: int) -> Int64x2:
    """Return the nearest places that shifted images have, and whether a tile around them lies inside the sample.

    Parameters
    ----------
    places
        ``(p, 2)``: (x, y).
    parts
        Parts of a pixel at which tiles are placed.
    box
        ``(2, 2)``: the least and the greatest (x, y) of a tile's pixels.
    height, width
        Shape of the sample.

    Returns
    -------
    NDArray
        ``(p, 4)``: the shifted image, pixel (x, y), and 1 if the tile and the pixels that it is
        interpolated from lie inside, else 0.
    """
    nearest = np.empty((places.shape[0], 4), np.int64)
    for p in range(places.shape[0]):
        u = np.int64(math.floor(places[p, 0] * parts + 0.5))
        v = np.int64(math.floor(places[p, 1] * parts + 0.5))
        x, y = u // parts, v // parts
        right, below = u - x * parts, v - y * parts
        within = x + box[0, 0] >= 0 and x + box[1, 0] + (1 if right > 0 else 0) <= width - 1
        within = within and y + box[0, 1] >= 0 and y + box[1, 1] + (1 if below > 0 else 0) <= height - 1
        nearest[p, 0], nearest[p, 1], nearest[p, 2] = below * parts + right, x, y
        nearest[p, 3] = 1 if within else 0
    return nearest


@kernel
def best_move(
    values: UInt8x1,
    runs: Int64x2,
    sources: UInt8x2,
    height: int,
    width: int,
    channels: int,
    parts: int,
    here: Float64x1,
    middle: Float64x1,
    radius: float,
    box: Int64x2,
) -> Int64x1:
    """Return the place at which a tile correlates best with what is filled there.

    Parameters
    ----------
    values, runs, sources
        As in :func:`absolute_differences`.
    height, width, channels, parts, box
        The sample's shape, and ``parts`` and ``box`` as in :func:`nearest_places`.
    here, middle
        ``(2,)``: the place of the tile, and its real middle, (x, y).
    radius
        Largest distance from the middle, px.

    Returns
    -------
    NDArray
        ``(3,)``: shifted image and pixel (x, y). Ties go to no move, then to the place nearest to the real middle.
    """
    reach = np.int64(radius * parts + 0.5)
    side = 2 * reach + 1
    moves = np.empty((side * side + 1, 2))
    for m in range(side * side):
        moves[m + 1, 0], moves[m + 1, 1] = (here[0] + (m % side - reach) / parts, here[1] + (m // side - reach) / parts)
    moves[0] = here
    nearest = nearest_places(moves, parts, box, height, width)
    places = np.empty((moves.shape[0], 2), np.int64)
    away = np.empty(moves.shape[0])
    count = 0
    for m in range(moves.shape[0]):
        distance = math.hypot(moves[m, 0] - middle[0], moves[m, 1] - middle[1])
        if m == 0 or (distance <= radius and nearest[m, 3] == 1):
            away[count] = distance if m else -1.0
            nearest[count] = nearest[m]
            places[count, 0] = nearest[m, 0]
            places[count, 1] = (nearest[m, 2] * width + nearest[m, 1]) * channels
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
    return np.array([nearest[best, 0], nearest[best, 1], nearest[best, 2]])
