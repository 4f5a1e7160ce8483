"""The compiled loops of the search for nearest patches, and of the votes of the patches found."""

from __future__ import annotations

import numpy as np

from nrbench.jit import Float32x1, Float32x2, Int32x3, Int64x1, kernel, step_kernel


@step_kernel
def patch_distance(
    first: Float32x2,
    top: int,
    left: int,
    second: Float32x2,
    row: int,
    column: int,
    size: int,
    length: int,
    bound: float,
) -> float:
    """Return the sum of squared differences of two patches, or the part of it with which it exceeds a bound.

    Parameters
    ----------
    first, second
        Images, ``(H, W C)``.
    top, left, row, column
        The first row and the first value of each patch.
    size, length
        Rows of a patch, and values in a row.
    bound
        Summation ends at the end of a row where the sum is larger.
    """
    total = 0.0
    for i in range(size):
        ours = first[top + i, left : left + length]
        theirs = second[row + i, column : column + length]
        part = np.float32(0)
        for k in range(length):
            part += (ours[k] - theirs[k]) * (ours[k] - theirs[k])
        total += float(part)
        if total > bound:
            break
    return total


@kernel
def improve_matches(
    queries: Float32x2,
    keys: Float32x2,
    grid: tuple[Int64x1, Int64x1],
    channels: int,
    size: int,
    factors: Float32x2,
    matches: Int32x3,
    costs: Float32x2,
    draws: Float32x1,
    sweeps: int,
) -> None:
    """Improve the matches of patches by propagation and random search (Barnes and others 2009, sections 3.2 and 3.3).

    Parameters
    ----------
    queries, keys
        ``(H, W C)``: the images whose patches search and are found.
    grid
        The rows and the columns of the patches that search, ascending.
    channels
        Values of a pixel.
    size
        Side of a patch in px.
    factors
        For each place of a patch in ``keys``: the cost of a match is this multiple of the sum of squared differences.
    matches
        ``(rows, columns, 2)``: row and column of each patch's match in ``keys``. It is overwritten.
    costs
        ``(rows, columns)``: the cost of each match. It is overwritten.
    draws
        Random numbers in [0, 1), which are used again and again.
    sweeps
        Number of passes over all patches, in alternating directions.
    """
    rows, columns = grid
    height, width = factors.shape
    length = size * channels
    for i in range(rows.size):
        for j in range(columns.size):
            v, u = matches[i, j, 0], matches[i, j, 1]
            found = patch_distance(queries, rows[i], columns[j] * channels, keys, v, u * channels, size, length, np.inf)
            costs[i, j] = found * factors[v, u]
    number = 0
    for sweep in range(sweeps):
        step = 1 - 2 * (sweep % 2)
        for a in range(rows.size):
            i = a if step > 0 else rows.size - 1 - a
            for b in range(columns.size):
                j = b if step > 0 else columns.size - 1 - b
                best, best_v, best_u = costs[i, j], matches[i, j, 0], matches[i, j, 1]
                reach, turn = max(height, width), 0
                while reach >= 1:
                    if turn == 0:
                        turn = 1
                        if a == 0:
                            continue
                        v = matches[i - step, j, 0] + rows[i] - rows[i - step]
                        u = matches[i - step, j, 1]
                    elif turn == 1:
                        turn = 2
                        if b == 0:
                            continue
                        v = matches[i, j - step, 0]
                        u = matches[i, j - step, 1] + columns[j] - columns[j - step]
                    else:
                        if number + 2 > draws.size:
                            number = 0
                        low, high = max(best_v - reach, 0), min(best_v + reach, height - 1)
                        v = low + int(draws[number] * (high - low + 1))
                        low, high = max(best_u - reach, 0), min(best_u + reach, width - 1)
                        u = low + int(draws[number + 1] * (high - low + 1))
                        number += 2
                        reach //= 2
                    if (v == best_v and u == best_u) or not (0 <= v < height and 0 <= u < width):
                        continue
                    factor = factors[v, u]
                    distance = patch_distance(
                        queries, rows[i], columns[j] * channels, keys, v, u * channels, size, length, best / factor
                    )
                    if distance * factor < best:
                        best, best_v, best_u = distance * factor, v, u
                costs[i, j], matches[i, j, 0], matches[i, j, 1] = best, best_v, best_u


@kernel
def add_votes(
    values: Float32x2,
    grid: tuple[Int64x1, Int64x1],
    channels: int,
    matches: Int32x3,
    weights: Float32x2,
    falloff: Float32x2,
    sums: Float32x2,
    totals: Float32x2,
) -> None:
    """Add the patches that were found, weighted, to the pixels that they cover.

    Parameters
    ----------
    values
        ``(H, W C)``: the image that the patches are copied from.
    grid, channels, matches
        As in :func:`improve_matches`.
    weights
        ``(rows, columns)``: the weight of each patch.
    falloff
        ``(size, size)``: the weight of each pixel of a patch.
    sums, totals
        ``(height, width C)`` and ``(height, width)``: the weighted sums and the weights. They are overwritten.
    """
    rows, columns = grid
    size = len(falloff)
    for i in range(rows.size):
        for j in range(columns.size):
            left, column = columns[j], matches[i, j, 1] * channels
            for y in range(size):
                source = values[matches[i, j, 0] + y]
                target, total = sums[rows[i] + y], totals[rows[i] + y]
                for x in range(size):
                    weight = weights[i, j] * falloff[y, x]
                    total[left + x] += weight
                    for c in range(channels):
                        target[(left + x) * channels + c] += weight * source[column + x * channels + c]
