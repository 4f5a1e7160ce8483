"""The compiled loop of pixel-based synthesis: each pixel's query depends on the pixels before it."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from nrbench.jit import kernel

from .kdtree_kernels import DEEPEST, TREE, Arrays, search, squared_distance

FAR = np.int64(2**63 - 1)
CANVAS = "Tuple((uint8[::1], int64[:, ::1], int64[::1]))"
STOCK = "Tuple((uint8[:, ::1], int64[::1], int64[::1], int64[:, ::1], int64))"
QUERY = "Tuple((int64[::1], int16[:, ::1], int32[::1], int64, int64[:, ::1]))"
CanvasArrays = tuple[NDArray[np.uint8], NDArray[np.int64], NDArray[np.int64]]
"""``values``: the canvas' layers, flat, with their border; ``sources (P, Q)``: each pixel's in the sample, -1: none;
``frame``: rows and columns after which the canvas repeats, and the border at its top and left."""
StockArrays = tuple[NDArray[np.uint8], NDArray[np.int64], NDArray[np.int64], NDArray[np.int64], int]
"""``colors (h w, C)`` of the sample; ``pixels (n,)``: the sample's pixel at each place of the tree; ``places (h w,)``:
its inverse, -1 where the neighborhood is incomplete; ``similar (n, k)``: places like each; the sample's width."""
QueryArrays = tuple[NDArray[np.int64], NDArray[np.int16], NDArray[np.int32], int, NDArray[np.int64]]
"""``steps (D,)`` from a pixel's first value to its neighborhood's; ``matrix``, ``shift``, ``bits`` of the projection;
``causes (m, 2)``: the offsets (x, y) whose sources are continued."""


@kernel("void(uint8[::1], int64, int64[::1], int16[:, ::1], int32[::1], int64, int16[::1], int16[::1])")
def project(
    values: NDArray[np.uint8],
    at: int,
    steps: NDArray[np.int64],
    matrix: NDArray[np.int16],
    shift: NDArray[np.int32],
    bits: int,
    room: NDArray[np.int16],
    point: NDArray[np.int16],
) -> None:
    """Write the point of the neighborhood around the pixel whose first value is ``at``; ``room`` takes its values."""
    for i in range(steps.size):
        room[i] = values[at + steps[i]]
    for a in range(matrix.shape[0]):
        row = matrix[a]
        total = np.int32(0)
        for i in range(room.size):
            total = np.int32(total + np.int32(row[i]) * np.int32(room[i]))
        point[a] = np.int16((np.int64(total) + shift[a]) >> bits)


@kernel(f"void({CANVAS}, int64, int64, int64, uint8[::1])")
def put(canvas: CanvasArrays, row: int, column: int, source: int, color: NDArray[np.uint8]) -> None:
    """Write a pixel wherever it stands: once, or, where the canvas wraps, in its border as well."""
    values, sources, frame = canvas
    height, width, channels = sources.shape[0], sources.shape[1], color.size
    for r in range(row % frame[0], height, frame[0]):
        for c in range(column % frame[1], width, frame[1]):
            sources[r, c] = source
            for k in range(channels):
                values[(r * width + c) * channels + k] = color[k]


@kernel(f"void({CANVAS}, {STOCK}, {QUERY}, {TREE}, int64[::1], int64[:, ::1], int64[::1], float64, float64, boolean)")
def grow(
    canvas: CanvasArrays,
    stock: StockArrays,
    query: QueryArrays,
    tree: Arrays,
    roots: NDArray[np.int64],
    groups: NDArray[np.int64],
    box: NDArray[np.int64],
    factor: float,
    shrink: float,
    everywhere: bool,
) -> None:
    """Synthesize the pixels of a box in scan-line order.

    Parameters
    ----------
    canvas, stock, query
        See :data:`CanvasArrays`, :data:`StockArrays`, :data:`QueryArrays`.
    tree, roots
        The sample's neighborhoods, by groups.
    groups
        ``(rows, columns)`` of the box: the group that each pixel's source is taken from.
    box
        (y0, y1, x0, x1) of the output.
    factor
        A neighbor's continued source is taken where its squared distance is at most so many times the best's; 0: never
        for being one.
    shrink
        See :func:`~nrbench.synthesizers.pixel_growing.kdtree_kernels.search`.
    everywhere
        Whether the tree is searched, or the neighbors' continued sources and what is similar to them are all (where
        there are any).
    """
    values, sources, frame = canvas
    colors, pixels, places, similar, stride = stock
    steps, matrix, shift, bits, causes = query
    points, ranks, nodes = tree[0], tree[1], tree[2]
    channels, width = colors.shape[1], sources.shape[1]
    room, point = np.zeros(matrix.shape[1], np.int16), np.zeros(matrix.shape[0], np.int16)
    stack, gaps = np.empty((DEEPEST, 4), np.int64), np.empty(matrix.shape[0], np.int64)
    keys, found = np.empty(1, np.int64), np.empty(1, np.int64)
    for y in range(box[0], box[1]):
        for x in range(box[2], box[3]):
            row, column = y + frame[2], x + frame[3]
            project(values, (row * width + column) * channels, steps, matrix, shift, bits, room, point)
            group = groups[y - box[0], x - box[2]]
            start, stop = nodes[roots[group], 0], nodes[roots[group], 1]
            nearest, near = FAR, np.int64(-1)
            keys[0], found[0] = FAR, -1
            for m in range(causes.shape[0]):
                source = sources[row + causes[m, 1], column + causes[m, 0]]
                if source < 0:
                    continue
                source -= causes[m, 1] * stride + causes[m, 0]
                if source < 0 or source >= places.size:
                    continue
                place = places[source]
                if place < 0:
                    continue
                if start <= place < stop:
                    key = (np.int64(squared_distance(point, points[place])) << 32) + ranks[place]
                    if key < nearest:
                        nearest, near = key, place
                if not everywhere:
                    for j in range(similar.shape[1]):
                        other = similar[place, j]
                        if start <= other < stop:
                            key = (np.int64(squared_distance(point, points[other])) << 32) + ranks[other]
                            if key < keys[0]:
                                keys[0], found[0] = key, other
            if everywhere or (near < 0 and found[0] < 0):
                if factor > 0 and near >= 0:
                    keys[0] = np.int64(math.ceil((nearest >> 32) / factor)) << 32
                search(tree, group, roots[group], point, shrink, keys, found, stack, gaps)
            elif near >= 0 and (nearest < keys[0] or (factor > 0 and (nearest >> 32) <= factor * (keys[0] >> 32))):
                found[0] = -1
            chosen = pixels[near if found[0] < 0 else found[0]]
            put(canvas, row, column, chosen, colors[chosen])
