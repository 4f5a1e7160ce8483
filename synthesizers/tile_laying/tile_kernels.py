"""The compiled loops of tile sets: overlap differences, sums for correlation, error surfaces, pasting.

All pixels are 8-bit whole numbers and all sums exact, so that equal tiles tie exactly and no machine differs.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from nrbench.jit import kernel


@kernel("int64[::1](uint8[::1], int64[:, ::1], uint8[:, ::1], int64[:, ::1])")
def absolute_differences(
    values: NDArray[np.uint8], runs: NDArray[np.int64], sources: NDArray[np.uint8], places: NDArray[np.int64]
) -> NDArray[np.int64]:
    """Return, for each place of a source, the sum of absolute differences from the values there.

    Parameters
    ----------
    values
        ``(m,)``: what stands in the overlap.
    runs
        ``(r, 3)``: unbroken pieces of it: first value, how many, and where, from a place on, the source's first is.
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


@kernel("int64[:, :, ::1](uint8[::1], int64[:, ::1], uint8[:, ::1], int64[:, ::1], int64)")
def product_sums(
    values: NDArray[np.uint8],
    runs: NDArray[np.int64],
    sources: NDArray[np.uint8],
    places: NDArray[np.int64],
    channels: int,
) -> NDArray[np.int64]:
    """Return, for each place of a source, the sums of its values, their squares, and their products with the values.

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


@kernel("void(uint8[:, :, ::1], uint8[:, ::1], uint8[::1], int64, int64[:, :, ::1], int64, int64, float64[:, ::1])")
def error_surface(
    canvas: NDArray[np.uint8],
    filled: NDArray[np.uint8],
    source: NDArray[np.uint8],
    first: int,
    cells: NDArray[np.int64],
    left: int,
    top: int,
    surface: NDArray[np.float64],
) -> None:
    """Write the squared color difference between canvas and tile at each cell of the tile's grid; -1 where not filled.

    Parameters
    ----------
    canvas, filled
        ``(H, W, C)`` and ``(H, W)``, 1 where a tile was pasted.
    source, first
        The flat source, and where the tile's middle is in it.
    cells
        ``(rows, columns, 3)``: each cell's (x, y) from the tile's middle, and its step in the source.
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


@kernel(
    "void(uint8[:, :, ::1], uint8[:, ::1], float32[:, :, ::1], uint8[::1], int64, int64[:, ::1], int64, int64,"
    " int64[::1], int64[::1], int64[::1], float64, float64[::1])"
)
def paste(
    canvas: NDArray[np.uint8],
    filled: NDArray[np.uint8],
    origins: NDArray[np.float32],
    source: NDArray[np.uint8],
    first: int,
    pixels: NDArray[np.int64],
    left: int,
    top: int,
    across: NDArray[np.int64],
    down: NDArray[np.int64],
    bands: NDArray[np.int64],
    feather: float,
    place: NDArray[np.float64],
) -> None:
    """Paste a tile beyond its seams.

    Where nothing stands the tile is written. Where a seam alone decides, it cuts. Where both decide, the new side is
    what lies beyond both, and the tile fades in by its depth beyond the nearer seam, from half a feather before it
    to half a feather behind. Where something stands and no seam decides, it fades in from the tile's border.

    Parameters
    ----------
    canvas, filled, origins
        ``(H, W, C)``, ``(H, W)``, and ``(H, W, 3)``: the source map; all written.
    source, first
        As in :func:`error_surface`.
    pixels
        ``(n, 6)``: each pixel's (x, y) from the tile's middle, step in the source, row and column of the tile's grid,
        and distance in px from the tile's border.
    left, top
        The tile's middle in the canvas.
    across, down
        The seam of the left band, a column for each row; the seam of the top band, a row for each column.
    bands
        Columns of the left band and rows of the top band; 0 where there is none.
    feather
        Width of the ramp, px; 0 cuts.
    place
        The tile's middle in the sample (x, y) for the source map, the weight of the nearest pixel, and the mapping of
        the tile's (x, y) to the sample's: ``(x, y, weight, xx, xy, yx, yy)``.
    """
    channels = canvas.shape[2]
    for k in range(pixels.shape[0]):
        x, y, row, column = left + pixels[k, 0], top + pixels[k, 1], pixels[k, 3], pixels[k, 4]
        share = 1.0
        if filled[y, x] != 0:
            beside, above = column < bands[0], row < bands[1]
            if beside or above:
                depth = 1e9
                if beside:
                    depth = min(depth, column - across[row] + 0.5)
                if above:
                    depth = min(depth, row - down[column] + 0.5)
                soft = beside and above and feather > 0
            else:
                depth, soft = pixels[k, 5] + 0.5 - feather / 2, feather > 0
            share = min(max(depth / feather + 0.5, 0.0), 1.0) if soft else (1.0 if depth > 0 else 0.0)
        if share <= 0:
            continue
        at = first + pixels[k, 2]
        for c in range(channels):
            mixed = share * source[at + c] + (1 - share) * canvas[y, x, c]
            canvas[y, x, c] = np.uint8(mixed + 0.5)
        mine, theirs = share * place[2], (1 - share) * origins[y, x, 2]
        if filled[y, x] == 0 or mine >= theirs:
            dx, dy = pixels[k, 0], pixels[k, 1]
            origins[y, x, 0] = place[0] + place[3] * dx + place[4] * dy
            origins[y, x, 1] = place[1] + place[5] * dx + place[6] * dy
            origins[y, x, 2] = mine
        else:
            origins[y, x, 2] = theirs
        filled[y, x] = 1
