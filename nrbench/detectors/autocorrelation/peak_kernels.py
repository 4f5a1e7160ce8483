"""Compiled loops on the peaks and ridges of a surface: prominence, region of dominance, and ridges between peaks."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from nrbench.jit import (
    Boolx1,
    Float32x2,
    Float64x1,
    Float64x2,
    Int32x1,
    Int32x2,
    Int64x1,
    Int64x2,
    allocating_step_kernel,
    kernel,
    step_kernel,
)


@step_kernel
def root(parent: Int64x1, node: int) -> int:
    """Return the root of a node's tree in a union-find forest, and halve the path to it.

    ``parent`` holds the parent of each node; a root is its own parent. Amortized O(log n).
    """
    while parent[node] != node:
        parent[node] = parent[parent[node]]
        node = parent[node]
    return node


@step_kernel
def neighbor_above(height: Int32x1, rows: int, columns: int, pixel: int, step: int) -> int:
    """Return one of the nine pixels around a pixel; -1 if it is outside, or does not come before the pixel.

    Pixels come in descending height, and of equal heights in ascending index. ``height`` ``(rows * columns,)`` is the
    right half of a surface that is symmetric about the middle of its first column. The first column holds its pixels
    twice, above and below the origin; those above stand for those below.
    """
    y, x = pixel // columns + step // 3 - 1, pixel % columns + step % 3 - 1
    if x < 0 or (x == 0 and y < rows // 2):
        y, x = rows - 1 - y, -x
    if x >= columns or y < 0 or y >= rows:
        return -1
    near = y * columns + x
    return near if height[near] > height[pixel] or (height[near] == height[pixel] and near < pixel) else -1


@allocating_step_kernel
def list_saddles() -> Boolx1:
    """Return for each set of the eight neighbors of a pixel whether it has several parts, ``(256,)``.

    Bit k of an index stands for the k-th of the neighbors in the order of rows. Neighbors are in one part if they touch
    each other, if only by a corner.
    """
    out = np.zeros(256, np.bool_)
    ring = np.array((1, 2, 4, 7, 6, 5, 3, 0, 1))
    for members in range(256):
        missing = 1 - (members >> ring & 1)
        # Going around, a part ends at a missing side unless the next corner and the next side are missing, too.
        ends = 0
        for side in range(0, 8, 2):
            ends += missing[side] * (1 - missing[side + 1] * missing[side + 2])
        out[members] = ends > 1
    return out


@step_kernel
def ascend(height: Int32x1, rows: int, columns: int, pixel: int) -> tuple[int, int]:
    """Return the highest neighbor of a pixel, itself if none is higher, and the set of its higher neighbors as bits.

    ``height`` is as for :func:`neighbor_above`, the bits as for :func:`list_saddles`.
    """
    y, x = pixel // columns, pixel % columns
    best, higher = pixel, 0
    if 1 < x < columns - 1 and 0 < y < rows - 1:
        # Inside, neighbors need no mirror. Of equal heights the pixel of the lower index comes first.
        own = highest = height[pixel]
        for bit in range(8):
            step = bit + bit // 4
            near = pixel + (step // 3 - 1) * columns + step % 3 - 1
            if height[near] > own or (bit < 4 and height[near] == own):
                higher |= 1 << bit
                if height[near] > highest or (height[near] == highest and near < best):
                    best, highest = near, height[near]
    else:
        for bit in range(8):
            near = neighbor_above(height, rows, columns, pixel, bit + bit // 4)
            if near >= 0:
                higher |= 1 << bit
                if height[near] > height[best] or (height[near] == height[best] and near < best):
                    best = near
    return best, higher


@step_kernel
def follow_to_tops(following: Int64x1) -> None:
    """Replace the next pixel of each path by its last one, which follows itself. Pixels of -1 are on no path."""
    for pixel in range(following.size):
        if following[pixel] >= 0:
            top = pixel
            while following[top] != top:
                top = following[top]
            below = pixel
            while following[below] != top:
                above = following[below]
                following[below] = top
                below = above


@kernel
def find_basins(surface: Int32x2) -> tuple[Int64x1, Int64x1]:
    """Return the peak to which the steepest ascent from each pixel leads, and the saddles between peaks.

    Parameters
    ----------
    surface
        ``(2h+1, w)``: the right half of a surface that is symmetric about its origin at ``[h, 0]``.

    Returns
    -------
    peaks
        ``((2h+1) * w,)``: the flat index of the peak; -1 in the first column above the origin, which repeats the pixels
        below the origin. Adjacent pixels of equal height form one peak.
    saddles
        The negative height times 2^32, plus the flat index, of each pixel whose higher neighbors have several parts. In
        ascending order they are the pixels from the highest to the lowest.

    Notes
    -----
    Each pixel points to its highest neighbor. Along these steps each ascent ends at a peak, which points to itself.
    O(pixels): the pixels of an ascent are led to its peak at once. S. Beucher and C. Lantuejoul, "Use of watersheds in
    contour detection", 1979, define basins and passes in this way.
    """
    rows, columns = surface.shape
    height = surface.copy().ravel()
    peaks, saddles = np.full(height.size, -1, np.int64), np.empty(height.size, np.int64)
    is_saddle = list_saddles()
    count = 0
    for pixel in range(height.size):
        if pixel % columns == 0 and pixel // columns < rows // 2:
            continue
        peaks[pixel], higher = ascend(height, rows, columns, pixel)
        if is_saddle[higher]:
            saddles[count] = -np.int64(height[pixel]) * 4294967296 + pixel
            count += 1
    follow_to_tops(peaks)
    return peaks, saddles[:count].copy()


@kernel
def prominences(surface: Int32x2, peaks: Int64x1, saddles: Int64x1) -> Int32x2:
    """Return the prominence of each peak: its height above the highest pass to a higher peak.

    Parameters
    ----------
    surface
        ``(2h+1, w)``: the right half of a surface that is symmetric about its origin at ``[h, 0]``.
    peaks, saddles
        As :func:`find_basins` returns them, the saddles in ascending order.

    Returns
    -------
    NDArray
        ``(2h+1, w)``: 0 where there is no peak. The prominence of the highest peak is its height above the lowest
        pixel. Of equal peaks the first one counts as the higher.

    Notes
    -----
    Basins are joined in a union-find forest whose roots are the highest peaks of the joined basins::

        for each saddle, from the highest to the lowest, and for each basin that meets another one there:
            prominence of the lower peak = its height - height of the saddle
            join the lower peak's basin to the higher peak's

    scikit-image and scipy have no prominence of two-dimensional peaks. This one also respects the symmetry. Few pixels
    are saddles, which are sorted much faster than all pixels.
    """
    rows, columns = surface.shape
    height = surface.copy().ravel()
    parent = np.full(height.size, -1, np.int64)
    found = np.zeros(height.size, np.int32)
    # The peaks, each the root of its basin; `left` is the number of joins until one basin is left.
    highest, lowest, left = -1, 0, -1
    for pixel in range(height.size):
        if peaks[pixel] == pixel:
            parent[pixel] = pixel
            left += 1
            if highest < 0 or height[pixel] > height[highest]:
                highest = pixel
        if peaks[pixel] >= 0 and height[pixel] < height[lowest]:
            lowest = pixel
    # Join basins at the saddles, from the highest to the lowest. The low 32 bits of a key are the saddle's pixel.
    for key in saddles:
        if left == 0:
            break
        pixel = key & 4294967295
        one = root(parent, peaks[pixel])
        for step in range(9):
            near = neighbor_above(height, rows, columns, pixel, step)
            if near < 0:
                continue
            other = root(parent, peaks[near])
            if one == other:
                continue
            # `one` is the higher peak; the other one's prominence ends at this saddle.
            if height[one] < height[other] or (height[one] == height[other] and other < one):
                one, other = other, one
            found[other] = height[other] - height[pixel]
            parent[other] = one
            left -= 1
    # No saddle leads to a higher peak than the highest.
    found[highest] = height[highest] - height[lowest]
    return found.reshape(surface.shape)


@step_kernel
def value_at(gamma: Float32x2, x: int, y: int) -> float:
    """Return the correlation at a whole lag (x, y) on either half-plane, given the right half, ``(2H-1, W)``."""
    middle = gamma.shape[0] // 2
    return float(gamma[middle - y, -x]) if x < 0 else float(gamma[middle + y, x])


@step_kernel
def vertex(before: float, middle: float, after: float) -> float:
    """Return the position of the vertex of the parabola through samples at -1, 0 and 1; 0 if 0 is no maximum."""
    bend = 2 * middle - before - after
    if middle < before or middle < after or bend <= 0:
        return 0.0
    return min(max((after - before) / 2 / max(bend, 1e-12), -0.5), 0.5)


@step_kernel
def find_peak_near(gamma: Float32x2, x: float, y: float) -> tuple[float, float]:
    """Return the sub-pixel position of the highest of the nine lags around a position."""
    column, row = int(np.rint(x)), int(np.rint(y))
    best, best_x, best_y = -np.inf, column - 1, row - 1
    for step in range(9):
        value = value_at(gamma, column + step % 3 - 1, row + step // 3 - 1)
        if value > best:
            best, best_x, best_y = value, column + step % 3 - 1, row + step // 3 - 1
    left, right = value_at(gamma, best_x - 1, best_y), value_at(gamma, best_x + 1, best_y)
    above, below = value_at(gamma, best_x, best_y - 1), value_at(gamma, best_x, best_y + 1)
    return best_x + vertex(left, best, right), best_y + vertex(above, best, below)


@kernel
def follow_multiples(gamma: Float32x2, vectors: Float64x2, reach: Float64x1, most: int, near: float) -> Float64x2:
    """Fit each vector to the peaks at its multiples, from the nearest one to the first that is missing.

    Parameters
    ----------
    gamma
        The right half of an autocorrelation, ``(2H-1, W)``.
    vectors
        ``(n, 2)``, (x, y) px.
    reach
        Largest lag along x and y, px; at least 2 px less than the sides.
    most
        Number of the last multiple.
    near
        px; the peak of a multiple is the sub-pixel position of the highest of the nine lags around it. It is missing if
        it lies further away than this along x or y.

    Returns
    -------
    NDArray
        ``(n, 2)``: the vectors that fit best to these peaks, by least squares.
    """
    fitted = vectors.copy()
    for i in range(vectors.shape[0]):
        product_x, product_y, squares = vectors[i, 0], vectors[i, 1], 1.0
        for k in range(2, most + 1):
            x, y = k * fitted[i, 0], k * fitted[i, 1]
            if not (abs(x) <= reach[0] and abs(y) <= reach[1]):
                break
            peak_x, peak_y = find_peak_near(gamma, x, y)
            if not (abs(peak_x - x) <= near and abs(peak_y - y) <= near):
                break
            product_x, product_y, squares = product_x + k * peak_x, product_y + k * peak_y, squares + k * k
            fitted[i, 0], fitted[i, 1] = product_x / squares, product_y / squares
    return fitted


@step_kernel
def find_shifted_root(parent: Int64x1, across: Int64x1, down: Int64x1, node: int) -> tuple[int, int, int]:
    """Return the root of a node's tree, and the sums of the shifts along the way to it, in tiles along x and y."""
    shift_x, shift_y = 0, 0
    while parent[node] != node:
        shift_x, shift_y = shift_x + across[node], shift_y + down[node]
        node = parent[node]
    return node, shift_x, shift_y


@kernel
def highest_ridge(tile: Float32x2, order: Int64x1) -> Float64x1:
    """Return the ridge that joins the peaks of a periodic surface: of all paths, the one whose lowest point is highest.

    Parameters
    ----------
    tile
        One cell of the surface, ``(V, U)``, with periodic borders; its peak is at ``[0, 0]``.
    order
        Flat indices of the pixels, from the highest to the lowest.

    Returns
    -------
    NDArray
        ``(3,)``: the lowest height of the ridge, and the numbers of tiles along x and y between the peaks that it
        joins.

    Notes
    -----
    Pixels are added from the highest to the lowest; the regions that they form are joined in a union-find forest. Each
    region lies in the plane of all tiles, and the shift from a pixel to its parent says in which tile::

        for each pixel, from the highest to the lowest, and each neighbor that was added before:
            if they are in different regions: join these, with the shift that makes the two pixels neighbors
            else the region meets itself; if the two ways to its root differ by whole tiles, it meets a copy of itself
        until the region of the peak meets a copy of itself: the pixel is the lowest of the ridge
    """
    rows, columns = tile.shape
    height = tile.ravel()
    parent = np.full(tile.size, -1, np.int64)
    # The shift from each pixel to its parent, and from each region to the copy of itself that it touches, in tiles.
    across, down = np.zeros(tile.size, np.int64), np.zeros(tile.size, np.int64)
    met_x, met_y = np.zeros(tile.size, np.int64), np.zeros(tile.size, np.int64)
    for pixel in order:
        parent[pixel] = pixel
        y, x = pixel // columns, pixel % columns
        for step in range(9):
            near_y, near_x = y + step // 3 - 1, x + step % 3 - 1
            near = near_y % rows * columns + near_x % columns
            if parent[near] < 0 or step == 4:
                continue
            one, one_x, one_y = find_shifted_root(parent, across, down, pixel)
            other, other_x, other_y = find_shifted_root(parent, across, down, near)
            shift_x, shift_y = near_x // columns + other_x - one_x, near_y // rows + other_y - one_y
            if one != other:
                parent[other], across[other], down[other] = one, -shift_x, -shift_y
                shift_x, shift_y = met_x[other], met_y[other]
            if met_x[one] == 0 and met_y[one] == 0:
                met_x[one], met_y[one] = shift_x, shift_y
        if parent[0] >= 0:
            first, _, _ = find_shifted_root(parent, across, down, 0)
            if met_x[first] != 0 or met_y[first] != 0:
                return np.array((float(height[pixel]), float(met_x[first]), float(met_y[first])))
    return np.array((float(height[order[-1]]), 1.0, 0.0))


class PeakGrid(NamedTuple):
    """Peaks and their mirror images in the boxes of a grid, of which each holds a linked list.

    Parameters
    ----------
    first
        ``(rows, columns)``: the first peak in each box; -1 if there is none.
    following
        ``(2 n,)``: the next peak in the box of each; -1 if there is none. Peak i has the number 2 i, its mirror image
        2 i + 1.
    box
        Side of a box, px.
    x_end, y_end
        Half sides of the grid, px.
    """

    first: Int64x2
    following: Int64x1
    box: float
    x_end: float
    y_end: float


@allocating_step_kernel
def make_peak_grid(peaks: Float64x2) -> PeakGrid:
    """Return an empty grid that has about as many boxes as there are peaks ``(n, 2)``, n at least 1."""
    n = peaks.shape[0]
    x_end, y_end = 0.0, 0.0
    for i in range(n):
        x_end, y_end = max(x_end, abs(peaks[i, 0])), max(y_end, abs(peaks[i, 1]))
    box = max(np.sqrt(2 * x_end * y_end / n), max(x_end, y_end) / n, 1e-6)
    columns, rows = int(2 * x_end / box) + 1, int(2 * y_end / box) + 1
    return PeakGrid(np.full((rows, columns), -1, np.int64), np.full(2 * n, -1, np.int64), box, x_end, y_end)


@step_kernel
def nearest_in_box(grid: PeakGrid, peaks: Float64x2, row: int, column: int, x: float, y: float) -> float:
    """Return the squared distance of a position from the nearest peak in a box; infinite if there is none."""
    nearest = np.inf
    k = grid.first[row, column]
    while k >= 0:
        sign = 1 - 2 * (k % 2)
        dx, dy = x - sign * peaks[k // 2, 0], y - sign * peaks[k // 2, 1]
        nearest = min(nearest, dx * dx + dy * dy)
        k = grid.following[k]
    return nearest


@step_kernel
def nearest_distance(grid: PeakGrid, peaks: Float64x2, i: int) -> float:
    """Return the distance of a peak from the nearest peak of a grid, or from lag 0 if that is nearer.

    The rings of boxes around its own box are searched until no farther box can hold a nearer peak.
    """
    x, y = peaks[i, 0], peaks[i, 1]
    rows, columns = grid.first.shape
    column, row = int((x + grid.x_end) / grid.box), int((y + grid.y_end) / grid.box)
    nearest = x * x + y * y
    ring = 0
    while ring <= 1 or (ring - 1) * grid.box * (ring - 1) * grid.box <= nearest:
        for r in range(max(row - ring, 0), min(row + ring, rows - 1) + 1):
            # The top and the bottom row of a ring are whole; of the others only the ends belong to it.
            step = 1 if abs(r - row) == ring else max(2 * ring, 1)
            for c in range(column - ring, column + ring + 1, step):
                if 0 <= c < columns:
                    nearest = min(nearest, nearest_in_box(grid, peaks, r, c, x, y))
        ring += 1
    return float(np.sqrt(nearest))


@kernel
def region_radii(ranked: Float64x2) -> Float64x1:
    """Return the distance of each peak from the nearest higher peak, px, ``(n,)``.

    Parameters
    ----------
    ranked
        ``(n, 2)``: lags (x, y), the highest peak first. Each peak has a mirror image; lag 0 is the highest peak of all.

    Notes
    -----
    Peaks enter a grid that has as many boxes as there are peaks, the highest first. For each peak the rings of boxes
    around its own box are searched until the nearest peak is known: O(n log n) for evenly spread peaks.
    """
    n = ranked.shape[0]
    radii = np.empty(n)
    if n == 0:
        return radii
    grid = make_peak_grid(ranked)
    for i in range(n):
        radii[i] = nearest_distance(grid, ranked, i)
        for half in range(2):
            sign = 1 - 2 * half
            c = int((sign * ranked[i, 0] + grid.x_end) / grid.box)
            r = int((sign * ranked[i, 1] + grid.y_end) / grid.box)
            grid.following[2 * i + half] = grid.first[r, c]
            grid.first[r, c] = 2 * i + half
    return radii
