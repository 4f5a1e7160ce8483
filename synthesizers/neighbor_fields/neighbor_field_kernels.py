"""The compiled loops of the search for nearest patches, and of the votes of the patches found."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np

from nrbench.jit import (
    Float32x1,
    Float32x2,
    Int32x3,
    Int64x1,
    inlined_kernel,
    kernel,
    nonallocating_kernel,
    step_kernel,
)


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


class FieldArrays(NamedTuple):
    """The patches of an image that search, and their matches in another image.

    Parameters
    ----------
    queries, keys
        ``(H, W C)``: the images whose patches search and are found.
    rows, columns
        The rows and the columns of the patches that search, ascending.
    channels
        Values of a pixel.
    size
        Side of a patch in px.
    factors
        For each place of a patch in ``keys``: the cost of a match is this multiple of the sum of squared differences.
    matches
        ``(rows, columns, 2)``: row and column of each patch's match in ``keys``.
    costs
        ``(rows, columns)``: the cost of each match.
    """

    queries: Float32x2
    keys: Float32x2
    rows: Int64x1
    columns: Int64x1
    channels: int
    size: int
    factors: Float32x2
    matches: Int32x3
    costs: Float32x2


@inlined_kernel
def keep_better(field: FieldArrays, i: int, j: int, v: int, u: int, best: tuple[float, int, int]) -> Any:
    """Return the better of two matches of a patch (i, j): the one at row ``v`` and column ``u``, and the best so far.

    ``best`` is a cost, a row and a column. The sum ends where it exceeds that cost. A place outside is no match.
    """
    height, width = field.factors.shape
    if (v != best[1] or u != best[2]) and 0 <= v < height and 0 <= u < width:
        factor, top, left = field.factors[v, u], field.rows[i], field.columns[j] * field.channels
        length, bound = field.size * field.channels, best[0] / factor
        distance = patch_distance(
            field.queries, top, left, field.keys, v, u * field.channels, field.size, length, bound
        )
        if distance * factor < best[0]:
            best = (distance * factor, v, u)
    return best


@inlined_kernel
def draw_near(middle: int, reach: int, count: int, share: np.float32) -> int:
    """Return one of the places 0 to ``count`` - 1 within ``reach`` of the middle, by a random number in [0, 1)."""
    low, high = max(middle - reach, 0), min(middle + reach, count - 1)
    return low + int(share * (high - low + 1))


@step_kernel
def measure_costs(field: FieldArrays) -> None:
    """Compute the cost of every match."""
    length = field.size * field.channels
    for i in range(field.rows.size):
        for j in range(field.columns.size):
            top, left = field.rows[i], field.columns[j] * field.channels
            v, u = field.matches[i, j, 0], field.matches[i, j, 1]
            found = patch_distance(
                field.queries, top, left, field.keys, v, u * field.channels, field.size, length, np.inf
            )
            field.costs[i, j] = found * field.factors[v, u]


@nonallocating_kernel
def improve_matches(field: FieldArrays, draws: Float32x1, sweeps: int) -> None:
    """Improve the matches of patches by propagation and random search, and compute their costs.

    Parameters
    ----------
    field
        Its matches and costs are overwritten.
    draws
        Random numbers in [0, 1), which are used again and again.
    sweeps
        Number of passes over all patches, in alternating directions.

    Notes
    -----
    PatchMatch (C. Barnes and others 2009, sections 3.2 and 3.3). With f(p) the match of the patch at p, and p - s the
    patch before it in the direction of the sweep, for each patch::

        propagation:    f(p) = the best of f(p), f(p - s) + s for the patch above, and for the patch to the left
        random search:  for r = R, R / 2, R / 4, ... 1, with R the longer side of the image that is searched:
                            f(p) = the better of f(p), and a random place within r of f(p)

    The distance of a candidate is summed up to that of the present match only.
    """
    rows, columns, matches, costs = field.rows, field.columns, field.matches, field.costs
    height, width = field.factors.shape
    measure_costs(field)
    number = 0
    for sweep in range(sweeps):
        step = 1 - 2 * (sweep % 2)
        for a in range(rows.size):
            i = a if step > 0 else rows.size - 1 - a
            for b in range(columns.size):
                j = b if step > 0 else columns.size - 1 - b
                best = float(costs[i, j]), matches[i, j, 0] + 0, matches[i, j, 1] + 0
                # Propagation from the patch above or below, and from the patch to the left or right.
                if a > 0:
                    v = matches[i - step, j, 0] + rows[i] - rows[i - step]
                    best = keep_better(field, i, j, v, matches[i - step, j, 1], best)
                if b > 0:
                    u = matches[i, j - step, 1] + columns[j] - columns[j - step]
                    best = keep_better(field, i, j, matches[i, j - step, 0], u, best)
                # Random search around the best match, nearer and nearer.
                reach = max(height, width)
                while reach >= 1:
                    if number + 2 > draws.size:
                        number = 0
                    v = draw_near(best[1], reach, height, draws[number])
                    u = draw_near(best[2], reach, width, draws[number + 1])
                    number += 2
                    reach //= 2
                    best = keep_better(field, i, j, v, u, best)
                costs[i, j], matches[i, j, 0], matches[i, j, 1] = best


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
    grid
        The rows and the columns of the patches that search, ascending.
    channels
        Values of a pixel.
    matches
        ``(rows, columns, 2)``: row and column of each patch's match in ``values``.
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
