"""The compiled steps that choose a tile, and stitch it to what is filled under it.

Small tiles are laid by the thousand, so that each step is one call. Pixels are 8-bit whole numbers and all sums are
exact: equal tiles tie, and results do not depend on the machine.
"""

from __future__ import annotations

import math

import numpy as np

from nrbench.jit import (
    Float32x2,
    Float32x3,
    Float64x1,
    Float64x2,
    Float64x3,
    Int64x1,
    Int64x2,
    Int64x3,
    UInt8x1,
    UInt8x2,
    UInt8x3,
    kernel,
)

from ..seams.seam_kernels import cut_overlap, link_costs, record_seams

_KEPT, _EMPTY, _FREE = 0, 1, 2
"""States of a pixel of the tile's box: kept, because it is outside the tile or filled under its outermost pixels; not
filled; free to choose."""
FEATHER = 3.0
"""px; width of the ramp where the two seams of dynamic programming conflict (the paper gives no width)."""


@kernel
def gather(
    canvas: UInt8x3, filled: UInt8x2, pixels: Int64x2, left: int, top: int, values: UInt8x2, runs: Int64x2
) -> tuple[int, int]:
    """Write the filled pixels under a tile, and return the number of pixels and of runs.

    Parameters
    ----------
    canvas, filled, pixels, left, top
        As in :func:`paste`.
    values
        ``(n, C)``, written: the filled pixels.
    runs
        ``(n, 3)``, written: see :class:`~nrbench.synthesizers.tile_laying.tile_canvas.CoveredPixels`.
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


@kernel
def error_surface(
    canvas: UInt8x3,
    filled: UInt8x2,
    source: UInt8x1,
    first: int,
    cells: Int64x3,
    left: int,
    top: int,
    surface: Float64x2,
) -> None:
    """Write the squared color difference of canvas and tile at each cell of the tile's grid, or -1 if it is not filled.

    Parameters
    ----------
    canvas, filled
        ``(H, W, C)`` and ``(H, W)``, 1 where the canvas is filled.
    source, first
        The flattened source, and the position of the tile's middle in it.
    cells
        ``(rows, columns, 3)``: each cell's (x, y) from the tile's middle, and its offset in the source.
    left, top
        The tile's middle in the canvas.
    surface
        ``(rows, columns)``, written.
    """
    channels = canvas.shape[2]
    for i in range(cells.shape[0]):
        for j in range(cells.shape[1]):
            x, y, at = left + cells[i, j, 0], top + cells[i, j, 1], first + cells[i, j, 2]
            if filled[y, x] == 0:
                surface[i, j] = -1
                continue
            total = np.int64(0)
            for c in range(channels):
                difference = np.int64(canvas[y, x, c]) - np.int64(source[at + c])
                total += difference * difference
            surface[i, j] = total


@kernel
def blend_weights(
    filled: UInt8x2,
    pixels: Int64x2,
    left: int,
    top: int,
    across: Int64x1,
    down: Int64x1,
    bands: Int64x1,
) -> Float64x1:
    """Return the weight of each of a tile's pixels over what is filled, given its two seams.

    Where nothing is filled the weight is 1; before the corner at which the seams meet it is 0. Where only one seam
    applies, it cuts. Where both apply, the tile fades in with the depth beyond the nearer seam, from half of
    :data:`FEATHER` before it to half of it behind. Where the canvas is filled and no seam applies, the tile fades in
    from its border.

    Parameters
    ----------
    filled, pixels, left, top
        As in :func:`paste`.
    across, down, bands
        See :func:`~nrbench.synthesizers.tile_laying.tile_canvas.find_seams`.
    """
    weights = np.ones(pixels.shape[0])
    for k in range(pixels.shape[0]):
        if filled[top + pixels[k, 1], left + pixels[k, 0]] == 0:
            continue
        row, column = pixels[k, 3], pixels[k, 4]
        if row < bands[2] and column < bands[3]:
            weights[k] = 0.0
            continue
        beside, above = column < bands[0] and row >= bands[2], row < bands[1] and column >= bands[3]
        if beside or above:
            depth = 1e9
            if beside:
                depth = min(depth, column - across[row] + 0.5)
            if above:
                depth = min(depth, row - down[column] + 0.5)
            soft = beside and above
        else:
            depth, soft = pixels[k, 5] + 0.5 - FEATHER / 2, True
        weights[k] = min(max(depth / FEATHER + 0.5, 0.0), 1.0) if soft else (1.0 if depth > 0 else 0.0)
    return weights


@kernel
def paste(
    canvas: UInt8x3,
    filled: UInt8x2,
    origins: Float32x3,
    source: UInt8x1,
    first: int,
    pixels: Int64x2,
    left: int,
    top: int,
    weights: Float64x1,
    place: Float64x1,
) -> None:
    """Blend a tile into the canvas, and record where its pixels come from.

    Parameters
    ----------
    canvas, filled, origins
        ``(H, W, C)``, ``(H, W)``, and ``(H, W, 3)``: the canvas, 1 where it is filled, and its source map; all written.
    source, first
        The flattened source, and the position of the tile's middle in it.
    pixels
        ``(n, 6)``: for each pixel (x, y) from the tile's middle, its offset in the source, its row and column in the
        tile's grid, and its distance in px from the tile's border.
    left, top
        The tile's middle in the canvas.
    weights
        ``(n,)``: weight of each of the tile's pixels; 0 leaves the canvas as it is.
    place
        ``(x, y, weight)``: the pixel of the sample nearest to the tile's middle, and its weight.
    """
    for k in range(pixels.shape[0]):
        weight = weights[k]
        if weight <= 0:
            continue
        x, y, at = left + pixels[k, 0], top + pixels[k, 1], first + pixels[k, 2]
        for c in range(canvas.shape[2]):
            mixed = weight * source[at + c] + (1 - weight) * canvas[y, x, c]
            canvas[y, x, c] = np.uint8(mixed + 0.5)
        new, old = weight * place[2], (1 - weight) * origins[y, x, 2]
        if filled[y, x] == 0 or new >= old:
            origins[y, x, 0], origins[y, x, 1] = place[0] + pixels[k, 0], place[1] + pixels[k, 1]
            origins[y, x, 2] = new
        else:
            origins[y, x, 2] = old
        filled[y, x] = 1


@kernel
def cut_tile(
    canvas: UInt8x3,
    filled: UInt8x2,
    seams: Float32x3,
    weights: tuple[Float32x2, Float64x2],
    source: UInt8x1,
    first: int,
    pixels: Int64x2,
    box: Int64x2,
    left: int,
    top: int,
) -> Float64x1:
    """Return the weight of each of a tile's pixels: 1 where nothing is filled and beyond the best seam, else 0.

    Parameters
    ----------
    canvas, filled, source, first, pixels, left, top
        As in :func:`paste`. The tile's outermost pixels are not shown where the canvas is filled.
    seams
        ``(2, H, W)``: costs of the canvas's seams between each pixel and the next to its right, and below; changed to
        those with the tile. They count for pixels that stay, so that it pays to cover them.
    weights
        Table and numbers of :class:`~nrbench.synthesizers.tile_laying.tile_shape.ElementWeights`, for the canvas.
    box
        ``(2, 2)``: the least and the greatest (x, y) of the tile's pixels.

    Notes
    -----
    A seam along the border of the filled region has nothing to be compared with. Its cost is the double of what the
    known side contributes, for this tile and for those that follow. If it were free, cuts would follow it straight
    through elements.
    """
    height, width = box[1, 1] - box[0, 1] + 1, box[1, 0] - box[0, 0] + 1
    x0, y0, channels = left + box[0, 0], top + box[0, 1], canvas.shape[2]
    state = np.zeros((height, width), np.uint8)
    old = np.empty((height, width, channels), np.float32)
    for y in range(height):
        for x in range(width):
            for c in range(channels):
                old[y, x, c] = canvas[y0 + y, x0 + x, c] / np.float32(255)
    new = old.copy()
    differs = False
    for k in range(pixels.shape[0]):
        x, y, at = pixels[k, 0] - box[0, 0], pixels[k, 1] - box[0, 1], first + pixels[k, 2]
        is_filled = filled[y0 + y, x0 + x] != 0
        state[y, x] = (_FREE if pixels[k, 5] > 0 else _KEPT) if is_filled else _EMPTY
        for c in range(channels):
            new[y, x, c] = source[at + c] / np.float32(255)
            if not is_filled:
                old[y, x, c] = new[y, x, c]
            elif old[y, x, c] != new[y, x, c]:
                differs = True
    shown = np.zeros(pixels.shape[0])
    if not differs:
        for k in range(pixels.shape[0]):
            shown[k] = state[pixels[k, 1] - box[0, 1], pixels[k, 0] - box[0, 0]] == _EMPTY
        return shown
    costs = link_costs(old, new, False)
    weigh_links(state, weights[0], weights[1], x0, y0, costs)
    seams_inside, filled_inside = seams[:, y0 : y0 + height, x0 : x0 + width], filled[y0 : y0 + height, x0 : x0 + width]
    mask = cut_overlap(costs, seams_inside, state == _KEPT, state == _EMPTY)
    for k in range(pixels.shape[0]):
        shown[k] = mask[pixels[k, 1] - box[0, 1], pixels[k, 0] - box[0, 0]]
    record_seams(seams_inside, filled_inside, mask, costs)
    return shown


@kernel
def weigh_links(state: UInt8x2, table: Float32x2, to_cell: Float64x2, x0: int, y0: int, costs: Float64x3) -> None:
    """Multiply the costs of links by the mean weight of their two pixels, read from a table over the cell.

    Costs of links to where nothing is filled are doubled: the unknown half counts as much as the known one.

    Parameters
    ----------
    state
        ``(h, w)``: the state of each pixel of the box.
    table, to_cell
        As ``weights`` in :func:`cut_tile`.
    x0, y0
        The first pixel of the box in the canvas.
    costs
        ``(2, h, w)``: costs of the links to the right and downward; changed.
    """
    height, width = state.shape
    rows, columns = table.shape
    weights = np.empty((height, width))
    for y in range(height):
        for x in range(width):
            u = to_cell[0, 0] * (x0 + x) + to_cell[0, 1] * (y0 + y) + to_cell[0, 2]
            v = to_cell[1, 0] * (x0 + x) + to_cell[1, 1] * (y0 + y) + to_cell[1, 2]
            column, row = int((u - np.floor(u)) * columns + 0.5), int((v - np.floor(v)) * rows + 0.5)
            weights[y, x] = table[row % rows, column % columns]
    for axis in range(2):
        for y in range(height - axis):
            for x in range(width - 1 + axis):
                costs[axis, y, x] *= (weights[y, x] + weights[y + axis, x + 1 - axis]) / 2
                if (state[y, x] == _EMPTY) != (state[y + axis, x + 1 - axis] == _EMPTY):
                    costs[axis, y, x] *= 2
