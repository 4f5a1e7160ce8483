"""Refine displacements of windows to a fraction of a pixel, without a bias towards whole pixels."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from nrbench.imaging.convert import Image
from nrbench.imaging.mean_tile import Tile, Values, sample_tile
from nrbench.lattice.geometry import Lattice, Points

from .ncc_kernels import sum_products

_STEPS = (2, 2, 1, 1)
"""Distance, px, between the pixels that each step uses: coarse steps come near, fine steps converge."""
_SETTLED = 0.005
"""Length of a step, px, below which a window has converged. The remaining error is a small part of it."""
_REACH = 1.5
"""Largest total change of a displacement, px. A window that moves further has left its peak of NCC."""
_FLAT = 1e-6


@dataclass(frozen=True)
class Cell:
    """One cell of a periodic image, with its derivatives, for interpolation between its samples.

    Parameters
    ----------
    table
        ``float32 (V, U, 1 + 3 A)``: weights, the periodic image along A axes of color, and its derivatives per px along
        x, and along y.
    colors
        ``(C, C)``: the axes of color as columns, in order of decreasing variance of the periodic image.
    lattice
        The lattice of the periodic image.
    """

    table: Values
    colors: Values
    lattice: Lattice

    @classmethod
    def of(cls, tile: Tile, variance: Tile, floor: float) -> Cell:
        """Return the cell of a mean tile.

        Parameters
        ----------
        tile
            The mean tile.
        variance
            Variance across tiles, one channel. The weight of a pixel is one over its variance plus ``floor``.
        floor
            See ``variance``.
        """
        rows, columns, channels = tile.values.shape
        flat = tile.values.reshape(-1, channels) - tile.values.mean((0, 1))
        energies, colors = np.linalg.eigh(flat.T @ flat)
        axes = max(int((energies > _FLAT * energies[-1]).sum()), 1)
        colors = np.ascontiguousarray(colors[:, ::-1], np.float32)
        shape = (flat @ colors[:, :axes]).reshape(rows, columns, axes)
        u = (np.roll(shape, -1, 1) - np.roll(shape, 1, 1)) * np.float32(columns / 2)
        v = (np.roll(shape, -1, 0) - np.roll(shape, 1, 0)) * np.float32(rows / 2)
        inverse = np.linalg.inv(tile.lattice.matrix).astype(np.float32)
        slopes = [u * along[0] + v * along[1] for along in inverse]
        at = np.stack(np.meshgrid(np.arange(columns) / columns, np.arange(rows) / rows), -1)
        weights = 1 / (sample_tile(variance.values, at)[..., :1] + np.float32(floor))
        return cls(np.ascontiguousarray(np.concatenate([weights, shape, *slopes], -1)), colors, tile.lattice)


def refine_displacements(
    image: Image, cell: Cell, corners: NDArray[np.intp], window: tuple[int, int], displacement: Points
) -> tuple[Points, NDArray[np.float64]]:
    """Return each window's displacement (x, y) px, and its weighted NCC with the periodic image there.

    Gauss-Newton steps maximize the NCC over real-valued displacements (Lucas and Kanade, IJCAI 1981, here with free
    brightness and contrast). The periodic image is interpolated between the samples of one cell, which is the mean over
    many periods. A parabola through the NCC at whole pixels has an error of up to a tenth of a pixel that depends on
    the fraction of the displacement; this method does not. Time is linear in the pixels of the windows.

    Parameters
    ----------
    image
        ``(H, W, C)``.
    cell
        The cell of the periodic image.
    corners
        ``(n, 2)``: (x, y) of each window's first pixel.
    window
        Height and width.
    displacement
        ``(n, 2)``: (x, y) px, with an error of about a pixel. It is kept if the refined displacement differs by more
        than :data:`_REACH`.
    """
    rotated = np.ascontiguousarray(image @ cell.colors)
    corners, inverse = corners.astype(np.int64), np.linalg.inv(cell.lattice.matrix).astype(np.float64)
    rows = np.array(window)

    def compute_step(which: NDArray[np.bool_], at: Points, every: int) -> tuple[Points, NDArray[np.float64]]:
        start = cell.lattice.to_cell(corners[which] - at)
        return _solve_steps(sum_products(rotated, cell.table, corners[which], start, rows, inverse, every))

    at = np.array(displacement, np.float64)
    ncc, active = np.zeros(len(corners)), np.ones(len(corners), np.bool_)
    for every in _STEPS:
        move, ncc[active] = compute_step(active, at[active], every)
        at[active] += np.clip(move, -1, 1)
        active[active] = (every > 1) | (np.abs(move).max(1) > _SETTLED)
    lost = np.hypot(*(at - displacement).T) > _REACH
    at[lost], ncc[lost] = displacement[lost], compute_step(lost, displacement[lost], 1)[1]
    return at, ncc


def _solve_steps(sums: NDArray[np.float64]) -> tuple[Points, NDArray[np.float64]]:
    """Return the step (x, y) px of each window, and its NCC after that step.

    The model is image = a (t - step . (p, q)) + constant, see :func:`~.ncc_kernels.sum_products`.
    """
    tt, tp, tq, pp, pq, qq, it, ip, iq, ii = sums.T
    matrix = np.stack([tt, tp, tq, tp, pp, pq, tq, pq, qq], -1).reshape(-1, 3, 3)
    matrix += _FLAT * (np.trace(matrix, axis1=1, axis2=2) + 1)[:, np.newaxis, np.newaxis] * np.eye(3)
    wanted = np.stack([it, ip, iq], -1)
    a, x, y = np.linalg.solve(matrix, wanted[..., np.newaxis])[..., 0].T
    explained = np.maximum(a * it + x * ip + y * iq, 0)
    ncc = np.sign(a) * np.sqrt(np.minimum(explained / np.maximum(ii, _FLAT), 1))
    steep = np.abs(a) > _FLAT
    return np.where(steep, -np.stack([x, y]) / np.where(steep, a, 1), 0).T, ncc
