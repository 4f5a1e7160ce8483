"""Displacements to a fraction of a pixel that does not depend on where between two pixels they lie."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from nrbench.imaging.convert import Image
from nrbench.imaging.fold import Tile, Values, sample_tile
from nrbench.lattice.geometry import Lattice, Points

from .ncc_kernels import sums

_STEPS = (2, 2, 1, 1)
"""Every so many pixels are looked at in each step: the first comes near, the last settles."""
_SETTLED = 0.005
"""Step, px, after which a window has arrived: what is left is a small part of it."""
_REACH = 1.5
"""How far, px, a window may move in all; one that moves further has lost its peak, and stays."""
_FLAT = 1e-6


@dataclass(frozen=True)
class Cell:
    """One cell of a periodic image, ready to be read anywhere between its samples.

    Parameters
    ----------
    table
        ``float32 (V, U, 1 + 3 A)``: weights, the periodic image along A axes of color, what it changes by in a px
        along x, and along y.
    colors
        ``(C, C)``: axes of color, a column each, those along which the periodic image varies first.
    lattice
        Whose cell it is.
    """

    table: Values
    colors: Values
    lattice: Lattice

    @classmethod
    def of(cls, tile: Tile, weights: Tile, floor: float) -> Cell:
        """Return the cell of a mean tile; pixels count by the inverse of a variance (another tile) plus ``floor``."""
        rows, columns, channels = tile.values.shape
        flat = tile.values.reshape(-1, channels) - tile.values.mean((0, 1))
        variance, colors = np.linalg.eigh(flat.T @ flat)
        axes = max(int((variance > _FLAT * variance[-1]).sum()), 1)
        colors = np.ascontiguousarray(colors[:, ::-1], np.float32)
        shape = (flat @ colors[:, :axes]).reshape(rows, columns, axes)
        u = (np.roll(shape, -1, 1) - np.roll(shape, 1, 1)) * np.float32(columns / 2)
        v = (np.roll(shape, -1, 0) - np.roll(shape, 1, 0)) * np.float32(rows / 2)
        inverse = np.linalg.inv(tile.lattice.matrix).astype(np.float32)
        slopes = [u * along[0] + v * along[1] for along in inverse]
        at = np.stack(np.meshgrid(np.arange(columns) / columns, np.arange(rows) / rows), -1)
        counts = 1 / (sample_tile(weights.values, at)[..., :1] + np.float32(floor))
        return cls(np.ascontiguousarray(np.concatenate([counts, shape, *slopes], -1)), colors, tile.lattice)


def refined(
    image: Image, cell: Cell, corners: NDArray[np.intp], window: tuple[int, int], displacement: Points
) -> tuple[Points, NDArray[np.float64]]:
    """Return each window's displacement (x, y) px, and its weighted NCC with the periodic image there.

    The highest NCC over real displacements, by Gauss-Newton steps (Lucas and Kanade, IJCAI 1981; with free brightness
    and contrast): the periodic image is read where the window's pixels would come from, between the samples of one
    cell that all of its periods together gave. A parabola through the NCC at whole pixels is off by up to a tenth of a
    pixel, depending on where between two of them the peak lies; this is not. Time is linear in the windows' pixels.

    Parameters
    ----------
    image
        ``(H, W, C)``.
    cell
        What is looked for.
    corners
        ``(n, 2)``: (x, y) of each window's first pixel.
    window
        Height and width.
    displacement
        ``(n, 2)``: (x, y) px, to about a pixel. A window that would move by more than :data:`_REACH` stays there.
    """
    rotated = np.ascontiguousarray(image @ cell.colors)
    corners, inverse = corners.astype(np.int64), np.linalg.inv(cell.lattice.matrix).astype(np.float64)
    rows = np.array(window)

    def step(which: NDArray[np.bool_], at: Points, every: int) -> tuple[Points, NDArray[np.float64]]:
        start = cell.lattice.to_cell(corners[which] - at)
        return _solved(sums(rotated, cell.table, corners[which], start, rows, inverse, every))

    at = np.array(displacement, np.float64)
    ncc, going = np.zeros(len(corners)), np.ones(len(corners), np.bool_)
    for every in _STEPS:
        move, ncc[going] = step(going, at[going], every)
        at[going] += np.clip(move, -1, 1)
        going[going] = (every > 1) | (np.abs(move).max(1) > _SETTLED)
    lost = np.hypot(*(at - displacement).T) > _REACH
    at[lost], ncc[lost] = displacement[lost], step(lost, displacement[lost], 1)[1]
    return at, ncc


def _solved(found: NDArray[np.float64]) -> tuple[Points, NDArray[np.float64]]:
    """Return the step (x, y) px of each window, and its NCC after it: image = a (t - step . (p, q)) + constant."""
    tt, tp, tq, pp, pq, qq, it, ip, iq, ii = found.T
    matrix = np.stack([tt, tp, tq, tp, pp, pq, tq, pq, qq], -1).reshape(-1, 3, 3)
    matrix += _FLAT * (np.trace(matrix, axis1=1, axis2=2) + 1)[:, np.newaxis, np.newaxis] * np.eye(3)
    wanted = np.stack([it, ip, iq], -1)
    a, x, y = np.linalg.solve(matrix, wanted[..., np.newaxis])[..., 0].T
    explained = np.maximum(a * it + x * ip + y * iq, 0)
    ncc = np.sign(a) * np.sqrt(np.minimum(explained / np.maximum(ii, _FLAT), 1))
    steep = np.abs(a) > _FLAT
    return np.where(steep, -np.stack([x, y]) / np.where(steep, a, 1), 0).T, ncc
