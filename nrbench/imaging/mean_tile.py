"""Fold an image by a lattice into its mean tile, and unfold a tile into a periodic image."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any, Literal

import numpy as np
import scipy
from numpy.typing import NDArray

from nrbench.imaging.mean_tile_kernels import accumulate_pixels, interpolate_image, interpolate_tile
from nrbench.lattice.geometry import Lattice

Values = NDArray[np.float32]
"""``float32 (H, W, C)``: like an image, but with any range (a square, a difference)."""


@dataclass(frozen=True)
class Tile:
    """One cell of a periodic image, sampled on a grid in cell coordinates.

    Parameters
    ----------
    values
        ``float32 (V, U, C)``: value at (u, v) = (column / U, row / V) of the cell; borders are periodic.
    counts
        ``float64 (V, U)``: sum of bilinear weights of the pixels behind each value; 0 if the value was filled in.
    lattice
        The lattice of the cell.
    """

    values: Values
    counts: NDArray[np.float64]
    lattice: Lattice

    def unfold(self, shape: tuple[int, int], offset: tuple[float, float] = (0.0, 0.0)) -> Values:
        """Return the periodic image of ``shape`` (height, width), its content moved by ``offset`` (x, y) px.

        Values between the samples are interpolated bilinearly.
        """
        return sample_tile(self.values, cell_coordinates(self.lattice.shifted(offset), shape))


def cell_coordinates(lattice: Lattice, shape: tuple[int, int]) -> NDArray[np.float64]:
    """Return the cell coordinates (u, v) of every pixel center, as ``(H, W, 2)``."""
    height, width = shape
    across = lattice.to_cell(np.stack([np.arange(width), np.zeros(width)], -1))
    down = np.arange(height)[:, np.newaxis] * (lattice.to_cell((0.0, 1.0)) - lattice.to_cell((0.0, 0.0)))
    uv = np.empty((height, width, 2))
    for axis in (0, 1):
        np.add(across[:, axis], down[:, axis, np.newaxis], out=uv[..., axis])
    return uv


def tile_grid(lattice: Lattice) -> tuple[int, int]:
    """Return the numbers of samples along v and u for about one sample per pixel."""
    return max(math.ceil(math.hypot(*lattice.t2)), 1), max(math.ceil(math.hypot(*lattice.t1)), 1)


def fold(
    image: Values, lattice: Lattice, mask: NDArray[np.bool_] | None = None, grid: tuple[int, int] | None = None
) -> Tile:
    """Return the mean tile: the mean over all cells of the image; each pixel contributes to the four nearest samples.

    Parameters
    ----------
    image
        ``(H, W, C)``, any range.
    lattice
        Its basis spans the cells; a reduced basis samples the cell most evenly.
    mask
        ``bool (H, W)``: the pixels to use; all by default.
    grid
        Samples along v and u; about one per pixel by default.

    Returns
    -------
    Tile
        Samples without any pixel get the mean of the others.
    """
    uv = cell_coordinates(lattice, image.shape[:2]).reshape(-1, 2)
    pixels = np.asarray(image, np.float32).reshape(-1, image.shape[2])
    if mask is not None:
        uv, pixels = uv[mask.ravel()], pixels[mask.ravel()]
    rows, columns = grid or tile_grid(lattice)
    sums = accumulate_pixels(np.require(pixels, requirements=("C", "W")), uv, rows, columns)
    counts = sums[:, 0]
    values = sums[:, 1:] / np.maximum(counts, 1e-12)[:, np.newaxis]
    values[counts <= 1e-9] = values[counts > 1e-9].mean(0)
    return Tile(values.reshape(rows, columns, -1).astype(np.float32), counts.reshape(rows, columns), lattice)


def explained_share(image: Values, lattice: Lattice, mask: NDArray[np.bool_] | None = None) -> float:
    """Return the share of the variance of an image, or of the pixels of a mask, that its mean tile explains."""
    used = np.ones(image.shape[:2], np.bool_) if mask is None else mask
    pixels, rest = image[used], (image - fold(image, lattice, mask).unfold(image.shape[:2]))[used]
    around = np.square(pixels - pixels.mean(0, dtype=np.float64)).sum(dtype=np.float64)
    return 1 - float(np.square(rest).sum(dtype=np.float64) / max(float(around), 1e-12))


def sample_tile(values: Values, uv: NDArray[np.float64]) -> Values:
    """Return the bilinear values of a tile at cell coordinates ``uv`` of shape ``(..., 2)``, as ``(..., C)``."""
    sampled = interpolate_tile(
        np.require(values, np.float32, ("C", "W")), np.require(uv.reshape(-1, 2), requirements=("C", "W"))
    )
    return sampled.reshape(*uv.shape[:-1], values.shape[-1])


def interpolate(image: Values, xy: NDArray[np.float64]) -> Values:
    """Return the bilinear values of an image at places (x, y) px, ``(..., C)``; beyond the image those of its border.

    Parameters
    ----------
    image
        ``(H, W, C)``, at least 2 px a side.
    xy
        ``(..., 2)``.
    """
    inside = np.clip(xy.reshape(-1, 2), 0, np.array(image.shape[1::-1]) - 1)
    values = interpolate_image(np.require(image, np.float32, ("C", "W")), np.ascontiguousarray(inside, np.float64))
    return values.reshape(*xy.shape[:-1], image.shape[2])


def interpolate_planes(
    values: NDArray[Any],
    at: NDArray[np.float64],
    order: Literal[3, 5],
    mode: Literal["mirror", "nearest"],
    prefilter: bool = True,
) -> NDArray[Any]:
    """Return the values ``(..., C)`` of an array ``(H, W, C)`` at places ``(2, ...)``, row first, by splines.

    ``order``, ``mode`` and ``prefilter`` are those of :func:`scipy.ndimage.map_coordinates`.
    """
    planes = np.moveaxis(values, -1, 0)
    read = [scipy.ndimage.map_coordinates(each, at, None, order, mode, prefilter=prefilter) for each in planes]
    return np.stack(read, -1)
