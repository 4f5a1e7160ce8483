"""Folding an image by a lattice into its mean tile, and unfolding a tile into a periodic image."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from nrbench.lattice.geometry import Lattice, Points

Values = NDArray[np.float32]
"""``float32 (H, W, C)``: like an image, but of any range (a square, a difference)."""


@dataclass(frozen=True)
class Tile:
    """One cell of a periodic image, sampled on a grid in cell coordinates.

    Parameters
    ----------
    values
        ``float32 (V, U, C)``: value at (u, v) = (column / U, row / V) of the cell; it wraps round.
    counts
        ``float64 (V, U)``: how many pixels (bilinear shares) each value is the mean of; 0 where it was filled in.
    lattice
        Whose cell it is.
    """

    values: Values
    counts: NDArray[np.float64]
    lattice: Lattice

    def unfold(self, shape: tuple[int, int], offset: tuple[float, float] = (0.0, 0.0)) -> Values:
        """Return the periodic image of ``shape`` (height, width), its content moved by ``offset`` (x, y) px.

        Values between the samples are bilinear.
        """
        return sample_tile(self.values, cell_coordinates(self.lattice.shifted(offset), shape))


def cell_coordinates(lattice: Lattice, shape: tuple[int, int]) -> NDArray[np.float64]:
    """Return the cell coordinates (u, v) of every pixel centre, as ``(H, W, 2)``."""
    y, x = np.indices(shape)
    return lattice.to_cell(np.stack([x, y], -1))


def tile_grid(lattice: Lattice) -> tuple[int, int]:
    """Return the samples along v and u that a tile needs at about one a pixel."""
    return max(math.ceil(math.hypot(*lattice.t2)), 1), max(math.ceil(math.hypot(*lattice.t1)), 1)


def fold(image: Values, lattice: Lattice, mask: NDArray[np.bool_] | None = None) -> Tile:
    """Return the mean tile: the mean over all cells of the image, each pixel shared among its four neighbors.

    Parameters
    ----------
    image
        ``(H, W, C)``, any range.
    lattice
        The cells; a reduced basis samples the cell most evenly.
    mask
        ``bool (H, W)``: the pixels to use; None: all.

    Returns
    -------
    Tile
        Samples that no pixel reached hold the mean of those that some did.
    """
    uv = cell_coordinates(lattice, image.shape[:2]).reshape(-1, 2)
    pixels = image.reshape(-1, image.shape[2])
    if mask is not None:
        uv, pixels = uv[mask.ravel()], pixels[mask.ravel()]
    rows, columns = tile_grid(lattice)
    index, share = _neighbors(uv, rows, columns)
    counts = np.asarray(np.bincount(index.ravel(), share.ravel(), rows * columns), np.float64)
    sums = [np.bincount(index.ravel(), (share * channel).ravel(), rows * columns) for channel in pixels.T]
    values = np.stack(sums, -1) / np.maximum(counts, 1e-12)[:, np.newaxis]
    values[counts <= 1e-9] = values[counts > 1e-9].mean(0)
    return Tile(values.reshape(rows, columns, -1).astype(np.float32), counts.reshape(rows, columns), lattice)


def sample_tile(values: Values, uv: NDArray[np.float64]) -> Values:
    """Return the tile's values at cell coordinates ``uv`` of shape ``(..., 2)``, bilinear, as ``(..., C)``."""
    rows, columns, channels = values.shape
    index, share = _neighbors(uv.reshape(-1, 2), rows, columns)
    flat = values.reshape(-1, channels)
    mixed = sum(flat[i] * w[:, np.newaxis] for i, w in zip(index, share.astype(np.float32), strict=True))
    return np.asarray(mixed, np.float32).reshape(*uv.shape[:-1], channels)


def cut_tiles(
    image: Values, lattice: Lattice, middles: Points, grid: tuple[int, int] | None = None
) -> tuple[Values, NDArray[np.bool_]]:
    """Return the image's cells around ``middles`` (x, y), each resampled on the grid of a tile by cubic splines.

    Parameters
    ----------
    image
        ``(H, W, C)``.
    lattice
        Its vectors span the cells; its origin does not matter.
    middles
        ``(n, 2)`` px, real-valued.
    grid
        Samples (V, U); None: what the lattice needs. Tiles that are to be compared share one.

    Returns
    -------
    tiles
        ``(m, V, U, C)``, for those m cells that lie within the image.
    inside
        ``bool (n,)``: which they are.
    """
    rows, columns = grid or tile_grid(lattice)
    v, u = np.meshgrid((np.arange(rows) + 0.5) / rows - 0.5, (np.arange(columns) + 0.5) / columns - 0.5, indexing="ij")
    around = np.stack([u, v], -1) @ lattice.matrix
    reach = np.abs(around).reshape(-1, 2).max(0)
    inside = (middles >= reach).all(1) & (middles <= np.array(image.shape[1::-1]) - 1 - reach).all(1)
    at = np.moveaxis(middles[inside, np.newaxis, np.newaxis] + around, -1, 0)[::-1]
    planes = [ndimage.spline_filter(plane, 3, np.float32, "mirror") for plane in np.moveaxis(image, -1, 0)]
    cut = [ndimage.map_coordinates(plane, at, np.float32, 3, "mirror", prefilter=False) for plane in planes]
    return np.stack(cut, -1), inside


def _neighbors(uv: NDArray[np.float64], rows: int, columns: int) -> tuple[NDArray[np.intp], NDArray[np.float64]]:
    """Return index and bilinear share, each ``(4, n)``, of the four samples around each cell coordinate."""
    at = (uv % 1.0) * (columns, rows)
    low = np.floor(at).astype(np.intp)
    fraction = at - low
    index, share = [], []
    for dx in (0, 1):
        for dy in (0, 1):
            index.append((low[:, 1] + dy) % rows * columns + (low[:, 0] + dx) % columns)
            share.append(np.abs(1 - dx - fraction[:, 0]) * np.abs(1 - dy - fraction[:, 1]))
    return np.stack(index), np.stack(share)
