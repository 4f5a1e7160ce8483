"""The compiled steps that choose a tile, and join it to what is known under it.

Small tiles are laid by the thousand, so that each step is one call. Pixels are 8-bit whole numbers and all sums are
exact: equal tiles tie, and results do not depend on the machine.
"""

from __future__ import annotations

import math

import numpy as np

from nrbench.jit import (
    BoolView2,
    Boolx1,
    Boolx2,
    Float32View3,
    Float32x2,
    Float32x3,
    Float64x1,
    Float64x2,
    Float64x3,
    Int64x1,
    Int64x2,
    Int64x3,
    UInt8View3,
    UInt8x1,
    UInt8x2,
    allocating_step_kernel,
    inlined_kernel,
    kernel,
)

from ..canvas.seam_kernels import cut_overlap, link_costs, record_seams

KEPT, EMPTY, FREE = 0, 1, 2
"""States of a pixel of a tile's box: it stays, because it is outside the tile or known under its outermost pixels;
nothing is known there, so the tile must be shown; the cut decides."""
FEATHER = 3.0
"""px; width of the ramp where the two seams of dynamic programming conflict (the paper gives no width)."""
Overlap = tuple[UInt8x1, Int64x2]
"""The known pixels under a tile: their values, flat, and ``(r, 3)``: the contiguous runs of them, each with its first
value, its length, and the offset of its first value from that of the tile's middle in a flat image."""
Images = tuple[UInt8x2, int, int, int, int]
"""The shifted images of a sample, ``(n, height * width * channels)``, their height, width and channels, and the parts
of a pixel by which they are shifted."""
Under = tuple[UInt8View3, Float32View3, BoolView2, Float32View3]
"""What lies under the box of a tile: the pixels ``(h, w, C)``, their source map ``(h, w, 3)``, which of them are known
``(h, w)``, and the costs of the seams to the right and downward ``(2, h, w)``."""


@inlined_kernel
def gather(image: UInt8View3, known: BoolView2, mask: Boolx2, offsets: Int64x2) -> Overlap:
    """Return the known pixels under a tile as an :data:`Overlap`; parameters as in :func:`compare_tiles`."""
    height, width, channels = image.shape
    values, runs = np.empty(height * width * channels, np.uint8), np.empty((height * width, 3), np.int64)
    count, number, following = 0, 0, np.int64(0)
    for y in range(height):
        for x in range(width):
            if not (known[y, x] and mask[y, x]):
                continue
            if number == 0 or offsets[y, x] != following:  # the last run ended before this pixel
                runs[number, 0], runs[number, 1], runs[number, 2] = count, 0, offsets[y, x]
                number += 1
            runs[number - 1, 1] += channels
            following = offsets[y, x] + channels
            for c in range(channels):
                values[count] = image[y, x, c]
                count += 1
    return values[:count], runs[:number]


@kernel
def compare_tiles(
    image: UInt8View3, known: BoolView2, mask: Boolx2, offsets: Int64x2, images: Images, places: Int64x2
) -> tuple[Overlap, Int64x1]:
    """Return what is known under a tile, and how the tiles at some places differ from it.

    Parameters
    ----------
    image, known
        ``(h, w, C)`` and ``(h, w)``: the picture under the tile's box, and where it is known.
    mask
        ``(h, w)``: which pixels of the box belong to the tile.
    offsets
        ``(h, w)``: the offset of each pixel's first value from that of the tile's middle in a flat image.
    images
        See :data:`Images`.
    places
        ``(p, 3)``: shifted image and pixel (x, y) of the middle of each tile.

    Returns
    -------
    overlap
        See :data:`Overlap`.
    sums
        ``(p,)``: the sum of absolute differences between the values of each tile and those of the overlap.
    """
    overlap = gather(image, known, mask, offsets)
    (values, runs), (sources, _, width, channels, _) = overlap, images
    sums = np.zeros(places.shape[0], np.int64)
    for p in range(places.shape[0]):
        source, first = sources[places[p, 0]], (places[p, 2] * width + places[p, 1]) * channels
        total = np.int64(0)
        for r in range(runs.shape[0]):
            here = values[runs[r, 0] : runs[r, 0] + runs[r, 1]]
            there = source[first + runs[r, 2] : first + runs[r, 2] + runs[r, 1]]
            part = np.int32(0)
            for i in range(here.size):
                part += np.int32(abs(np.int32(here[i]) - np.int32(there[i])))
            total += part
        sums[p] = total
    return overlap, sums


@allocating_step_kernel
def product_sums(overlap: Overlap, images: UInt8x2, places: Int64x2, channels: int) -> Int64x3:
    """Compute, for each place of an image, the sums of its values, their squares, and their products with an overlap.

    Parameters
    ----------
    overlap
        See :data:`Overlap`; its runs are whole pixels.
    images
        ``(n, m)``: the images, flat.
    places
        ``(p, 2)``: image, and position in it.
    channels
        Number of channels.

    Returns
    -------
    NDArray
        ``(p, channels, 3)``.
    """
    values, runs = overlap
    sums = np.zeros((places.shape[0], channels, 3), np.int64)
    for p in range(places.shape[0]):
        source, first = images[places[p, 0]], places[p, 1]
        for r in range(runs.shape[0]):
            for i in range(runs[r, 1]):
                value = np.int64(source[first + runs[r, 2] + i])
                channel = i % channels
                sums[p, channel, 0] += value
                sums[p, channel, 1] += value * value
                sums[p, channel, 2] += value * np.int64(values[runs[r, 0] + i])
    return sums


@kernel
def nearest_places(places: Float64x2, images: Images, box: Int64x2) -> tuple[Int64x2, Boolx1]:
    """Return the nearest places that shifted images have, and whether a tile around them lies inside the sample.

    Parameters
    ----------
    places
        ``(p, 2)``: (x, y).
    images
        See :data:`Images`.
    box
        ``(2, 2)``: the least and the greatest (x, y) of a tile's pixels, from its middle.

    Returns
    -------
    nearest
        ``(p, 3)``: the shifted image, and pixel (x, y).
    inside
        ``(p,)``: whether the tile and the pixels that it is interpolated from lie inside.
    """
    _, height, width, _, parts = images
    nearest, inside = np.empty((places.shape[0], 3), np.int64), np.empty(places.shape[0], np.bool_)
    for p in range(places.shape[0]):
        # The place in parts of a pixel; what is left beyond whole pixels is the number of the image.
        u = np.int64(math.floor(places[p, 0] * parts + 0.5))
        v = np.int64(math.floor(places[p, 1] * parts + 0.5))
        x, y = u // parts, v // parts
        right, below = u - x * parts, v - y * parts
        within = x + box[0, 0] >= 0 and x + box[1, 0] + (1 if right > 0 else 0) <= width - 1
        within = within and y + box[0, 1] >= 0 and y + box[1, 1] + (1 if below > 0 else 0) <= height - 1
        nearest[p, 0], nearest[p, 1], nearest[p, 2] = below * parts + right, x, y
        inside[p] = within
    return nearest, inside


@allocating_step_kernel
def list_moves(start: Float64x1, radius: float, parts: int) -> Float64x2:
    """Return the places to which a tile may move, ``(n, 2)``: its own, and those of a square around it.

    Parameters
    ----------
    start
        (x, y) px: the place of the tile.
    radius
        Half the side of the square, px.
    parts
        Places are 1 / ``parts`` px apart.
    """
    reach = np.int64(radius * parts + 0.5)
    side = 2 * reach + 1
    moves = np.empty((side * side + 1, 2))
    moves[0, 0], moves[0, 1] = start[0], start[1]
    for m in range(side * side):
        moves[m + 1, 0] = start[0] + (m % side - reach) / parts
        moves[m + 1, 1] = start[1] + (m // side - reach) / parts
    return moves


@kernel
def best_move(
    overlap: Overlap, images: Images, box: Int64x2, drawn: Int64x1, middle: Float64x1, radius: float
) -> Int64x1:
    """Return the place at which a tile correlates best with what is known there.

    Parameters
    ----------
    overlap, images, box
        See :data:`Overlap`, :data:`Images` and :func:`nearest_places`.
    drawn
        ``(3,)``: the shifted image and the pixel (x, y) of the tile.
    middle
        ``(2,)``: its real middle (x, y).
    radius
        Largest distance from the middle, px.

    Returns
    -------
    NDArray
        ``(3,)``: as ``drawn``. Ties go to no move, then to the place nearest to the real middle.

    Notes
    -----
    Liu, Tsin and Lin 2005, section 3.1, stage 2, register tiles "by correlation". For the n values v of a tile and o of
    the overlap in each channel, the place with the largest ::

        sum over channels of (n sum(v o) - sum(v) sum(o)) / sqrt(sum over channels of (n sum(v v) - sum(v)^2))

    is taken: the normalized correlation without the overlap's own norm, which is the same everywhere. All sums are
    whole numbers.
    """
    sources, _, width, channels, parts = images
    copy, part = drawn[0] // (parts * parts), drawn[0] % (parts * parts)
    start = np.array([drawn[1] + part % parts / parts, drawn[2] + part // parts / parts])
    moves = list_moves(start, radius, parts)
    nearest, inside = nearest_places(moves, images, box)
    places, away = np.empty((moves.shape[0], 2), np.int64), np.empty(moves.shape[0])
    # Keep the places within the radius at which the tile lies inside the sample; no move is always one of them.
    count = 0
    for m in range(moves.shape[0]):
        distance = math.hypot(moves[m, 0] - middle[0], moves[m, 1] - middle[1])
        if m == 0 or (distance <= radius and inside[m]):
            away[count] = distance if m else -1.0
            for k in range(3):
                nearest[count, k] = nearest[m, k] + (copy * parts * parts if k == 0 else 0)
            places[count, 0] = nearest[count, 0]
            places[count, 1] = (nearest[m, 2] * width + nearest[m, 1]) * channels
            count += 1
    # The sums of the tile at each place, and of the overlap.
    sums = product_sums(overlap, sources, places[:count], channels)
    values = overlap[0]
    total = np.zeros(channels, np.int64)
    for i in range(values.size):
        total[i % channels] += np.int64(values[i])
    size = values.size // channels
    # The correlations, and the largest of them.
    best, highest = 0, -math.inf
    for m in range(count):
        covariance, variance = np.int64(0), np.int64(0)
        for c in range(channels):
            covariance += sums[m, c, 2] * size - sums[m, c, 0] * total[c]
            variance += sums[m, c, 1] * size - sums[m, c, 0] * sums[m, c, 0]
        correlation = covariance / math.sqrt(variance if variance > 1 else 1)
        if correlation > highest or (correlation == highest and away[m] < away[best]):
            best, highest = m, correlation
    return nearest[best, :].copy()


@kernel
def error_surface(
    image: UInt8View3, known: BoolView2, patch: UInt8View3, cells: Int64x3
) -> tuple[Float64x2, tuple[int, int]]:
    """Return the squared color difference of picture and tile at each cell of the tile's grid, and what is known there.

    Parameters
    ----------
    image, known
        ``(h, w, C)`` and ``(h, w)``: the picture under the tile's box, and where it is known.
    patch
        ``(h, w, C)``: the tile.
    cells
        ``(rows, columns, 2)``: each cell's (x, y) in the box.

    Returns
    -------
    surface
        ``(rows, columns)``; 0 where nothing is known. In the last column of the upper band, the sum from there
        downward: a seam that ends above the band's last row leaves the tile's own border as the cut below.
    bands
        How far what is known reaches from the left in rows that are not completely known, and from the top in columns
        that are not; the largest numbers of cells.
    """
    rows, columns = cells.shape[:2]
    surface, first = np.zeros((rows, columns)), np.full(columns, -1, np.int64)
    beside = above = 0
    for i in range(rows):
        is_first = True
        for j in range(columns):
            x, y = cells[i, j, 0], cells[i, j, 1]
            if not known[y, x]:
                if is_first:
                    beside, is_first = max(beside, j), False
                if first[j] < 0:
                    first[j], above = i, max(above, i)
                continue
            total = np.int64(0)
            for c in range(image.shape[2]):
                difference = np.int64(image[y, x, c]) - np.int64(patch[y, x, c])
                total += difference * difference
            surface[i, j] = total
    for i in range(above - 2, -1, -1):
        surface[i, columns - 1] += surface[i + 1, columns - 1]
    return surface, (beside, above)


@kernel
def blend_weights(
    known: BoolView2, cells: Int64x3, across: Int64x1, down: Int64x1, meeting: tuple[int, int], bands: tuple[int, int]
) -> Float64x2:
    """Return the weight of each of a tile's pixels over what is known, given its two seams.

    Parameters
    ----------
    known
        ``(h, w)``: where the picture under the tile's box is known.
    cells
        See :attr:`~nrbench.synthesizers.tile_laying.tiles.TileShape.pixel_cells`.
    across, down, meeting
        The seams in the tile's grid, and the (row, column) at which they meet: see
        :class:`~nrbench.synthesizers.canvas.canvas.SeamPaths`.
    bands
        See :func:`error_surface`.

    Returns
    -------
    NDArray
        ``(h, w)``; 0 outside the tile.

    Notes
    -----
    In the order of the branches: where nothing is known the weight is 1; before the corner at which the seams meet it
    is 0. Where only one seam applies, it cuts. Where both apply, the tile fades in with the depth beyond the nearer
    seam, from half of :data:`FEATHER` before it to half of it behind. Where the picture is known and no seam applies,
    the tile fades in from its border.
    """
    weights = np.zeros(known.shape)
    for y in range(known.shape[0]):
        for x in range(known.shape[1]):
            row, column, border = cells[y, x, 0], cells[y, x, 1], cells[y, x, 2]
            if border < 0:
                continue
            if not known[y, x]:
                weights[y, x] = 1.0
                continue
            if row < meeting[0] and column < meeting[1]:
                continue
            beside, above = column < bands[0] and row >= meeting[0], row < bands[1] and column >= meeting[1]
            if beside or above:
                depth = 1e9
                if beside:
                    depth = min(depth, column - across[row] + 0.5)
                if above:
                    depth = min(depth, row - down[column] + 0.5)
                soft = beside and above
            else:
                depth, soft = border + 0.5 - FEATHER / 2, True
            weights[y, x] = min(max(depth / FEATHER + 0.5, 0.0), 1.0) if soft else (1.0 if depth > 0 else 0.0)
    return weights


@kernel
def join_tile(
    under: Under,
    patch: UInt8View3,
    origin: Float32x3,
    border: Int64x2,
    weights: tuple[Float32x2, Float64x2],
    corner: tuple[int, int],
) -> Boolx2:
    """Show a tile where nothing is known, and beyond the best seam; return where it is shown.

    Parameters
    ----------
    under
        See :data:`Under`; changed. The seams count for pixels that stay, so that it pays to cover them.
    patch, origin
        ``(h, w, C)`` and ``(h, w, 3)``: the tile, and its source map.
    border
        ``(h, w)``: the number of cells between each pixel and the tile's border, negative outside the tile. The tile's
        outermost pixels are not shown where the picture is known.
    weights
        Table and numbers of :class:`~nrbench.synthesizers.tile_laying.tiles.ElementWeights`.
    corner
        (x, y) of the first pixel, in the coordinates of these numbers.

    Notes
    -----
    Kwatra et al. 2003, sections 3 and 5::

        state = EMPTY, FREE or KEPT for each pixel
        costs = |old(s) - new(s)| + |old(t) - new(t)| over the gradients, times how much elements vary at s and t
        minimum cut: EMPTY pixels become new, KEPT pixels stay, old seams count where both their pixels stay
        record the seams along the cut

    A seam along the border of what is known has nothing to be compared with. Its cost is the double of what the known
    side contributes, for this tile and for those that follow. If it were free, cuts would follow it straight through
    elements.
    """
    image, source, known, seams = under
    height, width, channels = image.shape
    state = np.full((height, width), KEPT, np.uint8)
    old = np.empty((height, width, channels), np.float32)
    new = np.empty((height, width, channels), np.float32)
    # Both pictures over the box. Each shows the other one where it has no pixel of its own.
    differs = False
    for y in range(height):
        for x in range(width):
            if border[y, x] >= 0:
                state[y, x] = EMPTY if not known[y, x] else FREE if border[y, x] > 0 else KEPT
            for c in range(channels):
                old[y, x, c] = new[y, x, c] = image[y, x, c] / np.float32(255)
                if border[y, x] >= 0:
                    new[y, x, c] = patch[y, x, c] / np.float32(255)
                    if not known[y, x]:
                        old[y, x, c] = new[y, x, c]
                    elif old[y, x, c] != new[y, x, c]:
                        differs = True
    shown: Boolx2 = state == EMPTY
    if differs:  # else no seam is needed
        costs = link_costs(old, new, False)
        weigh_links(state, weights, corner, costs)
        shown = cut_overlap(costs, seams, state == KEPT, shown)
        record_seams(seams, known, shown, costs)
    for y in range(height):
        for x in range(width):
            if shown[y, x]:
                known[y, x] = True
                for c in range(channels):
                    image[y, x, c] = patch[y, x, c]
                for c in range(3):
                    source[y, x, c] = origin[y, x, c]
    return shown


@allocating_step_kernel
def weigh_links(state: UInt8x2, table: tuple[Float32x2, Float64x2], corner: tuple[int, int], costs: Float64x3) -> None:
    """Multiply the costs of links by the mean weight of their two pixels, read from a table over the cell.

    Costs of links to where nothing is known are doubled: the unknown half counts as much as the known one.

    Parameters
    ----------
    state
        ``(h, w)``: the state of each pixel of the box.
    table, corner
        As ``weights`` and ``corner`` in :func:`join_tile`.
    costs
        ``(2, h, w)``: costs of the links to the right and downward; changed.
    """
    (values, to_cell), (x0, y0) = table, corner
    height, width = state.shape
    rows, columns = values.shape
    weights = np.empty((height, width))
    for y in range(height):
        for x in range(width):
            u = to_cell[0, 0] * (x0 + x) + to_cell[0, 1] * (y0 + y) + to_cell[0, 2]
            v = to_cell[1, 0] * (x0 + x) + to_cell[1, 1] * (y0 + y) + to_cell[1, 2]
            column, row = int((u - np.floor(u)) * columns + 0.5), int((v - np.floor(v)) * rows + 0.5)
            weights[y, x] = values[row % rows, column % columns]
    for axis in range(2):
        for y in range(height - axis):
            for x in range(width - 1 + axis):
                costs[axis, y, x] *= (weights[y, x] + weights[y + axis, x + 1 - axis]) / 2
                if (state[y, x] == EMPTY) != (state[y + axis, x + 1 - axis] == EMPTY):
                    costs[axis, y, x] *= 2
