"""The compiled step that cuts a tile against what it is laid over: one exact minimum cut a tile."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from nrbench.jit import kernel

from ..seams.seam_kernels import SOURCE, grow_trees, link_costs

_OUTSIDE, _FRESH, _KEPT, _FREE = 0, 1, 2, 3
"""What a pixel of the tile's box is: not the tile's; where nothing stands; the tile's outermost; free to choose."""


@kernel(
    "uint8[::1](uint8[:, :, ::1], uint8[:, ::1], float32[:, :, ::1], uint8[::1], int64, int64[:, ::1], int64[:, ::1],"
    " int64, int64)"
)
def cut_tile(
    canvas: NDArray[np.uint8],
    filled: NDArray[np.uint8],
    seams: NDArray[np.float32],
    source: NDArray[np.uint8],
    first: int,
    pixels: NDArray[np.int64],
    box: NDArray[np.int64],
    left: int,
    top: int,
) -> NDArray[np.uint8]:
    """Return which of a tile's pixels are shown: 1 where nothing stands, and beyond the least visible seam.

    Parameters
    ----------
    canvas, filled, source, first, pixels, left, top
        As in :func:`~nrbench.synthesizers.tile_laying.tile_kernels.paste`; the tile's outermost pixels are not shown where
        something stands.
    seams
        ``(H, W, 2)``: what the canvas's seams cost between each pixel and the next to its right, and below; changed to
        what they cost with the tile. They count for a pixel that stays, so that it is worth something to cover them.
    box
        ``(2, 2)``: the least and the greatest (x, y) of the tile's pixels.

    Notes
    -----
    A seam along the border of what stands would be compared with nothing there: it costs as much as the dearest seam
    that is known, now and for the tiles that follow. Were it free, cuts would keep to it, straight through elements.
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
        stands = filled[y0 + y, x0 + x] != 0
        state[y, x] = (_FREE if pixels[k, 5] > 0 else _KEPT) if stands else _FRESH
        for c in range(channels):
            new[y, x, c] = source[at + c] / np.float32(255)
            if not stands:
                old[y, x, c] = new[y, x, c]
            elif old[y, x, c] != new[y, x, c]:
                differs = True
    shown = np.zeros(pixels.shape[0], np.uint8)
    if not differs:
        for k in range(pixels.shape[0]):
            shown[k] = state[pixels[k, 1] - box[0, 1], pixels[k, 0] - box[0, 0]] == _FRESH
        return shown
    across, down = link_costs(old, new, True, 1.0)
    double_border(state, across, down)
    residual, terminal = graph(state, across, down, seams[y0 : y0 + height, x0 : x0 + width])
    tree = grow_trees(residual, terminal, width + 2)
    mask = np.zeros((height, width), np.uint8)
    for k in range(pixels.shape[0]):
        x, y = pixels[k, 0] - box[0, 0], pixels[k, 1] - box[0, 1]
        mask[y, x] = shown[k] = tree[(y + 1) * (width + 2) + x + 1] == SOURCE
    remember(seams[y0 : y0 + height, x0 : x0 + width], filled[y0 : y0 + height, x0 : x0 + width], mask, across, down)
    return shown


@kernel("void(uint8[:, ::1], float64[:, ::1], float64[:, ::1])")
def double_border(state: NDArray[np.uint8], across: NDArray[np.float64], down: NDArray[np.float64]) -> None:
    """Make links to where nothing stands twice as dear: the unknown half counts as much as the known one."""
    for y in range(state.shape[0]):
        for x in range(state.shape[1]):
            if x < state.shape[1] - 1 and (state[y, x] == _FRESH) != (state[y, x + 1] == _FRESH):
                across[y, x] *= 2
            if y < state.shape[0] - 1 and (state[y, x] == _FRESH) != (state[y + 1, x] == _FRESH):
                down[y, x] *= 2


@kernel("Tuple((float64[:, ::1], float64[::1]))(uint8[:, ::1], float64[:, ::1], float64[:, ::1], float32[:, :, :])")
def graph(
    state: NDArray[np.uint8],
    across: NDArray[np.float64],
    down: NDArray[np.float64],
    seams: NDArray[np.float32],
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return the capacities and terminals of a box's graph, see :func:`~nrbench.synthesizers.seams.seam_kernels.grow_trees`.

    Old seams count as in :func:`~nrbench.synthesizers.seams.minimum_cut.cut_overlap`.
    """
    height, width = state.shape
    stride = width + 2
    residual, terminal = np.zeros((4, (height + 2) * stride)), np.zeros((height + 2) * stride)
    for y in range(height):
        for x in range(width):
            node = (y + 1) * stride + x + 1
            if state[y, x] == _FRESH:
                terminal[node] = np.inf
            elif state[y, x] != _FREE:
                terminal[node] = -np.inf
            if x < width - 1:
                half = min(seams[y, x, 0] / 2, across[y, x])
                residual[0, node] = residual[1, node + 1] = across[y, x] - half
                terminal[node] += half
                terminal[node + 1] += half
            if y < height - 1:
                half = min(seams[y, x, 1] / 2, down[y, x])
                residual[2, node] = residual[3, node + stride] = down[y, x] - half
                terminal[node] += half
                terminal[node + stride] += half
    return residual, terminal


@kernel("void(float32[:, :, :], uint8[:, :], uint8[:, ::1], float64[:, ::1], float64[:, ::1])")
def remember(
    seams: NDArray[np.float32],
    filled: NDArray[np.uint8],
    mask: NDArray[np.uint8],
    across: NDArray[np.float64],
    down: NDArray[np.float64],
) -> None:
    """Change the seams of a box to those with the tile: new ones where it begins, none where it is shown."""
    height, width = mask.shape
    for y in range(height):
        for x in range(width):
            here = mask[y, x]
            for axis in range(2):
                v, u = (y, x + 1) if axis == 0 else (y + 1, x)
                if v == height or u == width or not (here or mask[v, u]):
                    continue
                stands = (here or filled[y, x] != 0) and (mask[v, u] or filled[v, u] != 0)
                cost = across[y, x] if axis == 0 else down[y, x]
                seams[y, x, axis] = cost if stands and here != mask[v, u] else 0.0
