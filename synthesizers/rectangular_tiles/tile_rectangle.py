"""The frame of a rectangular tile: which rectangle of the lattice, how many pixels, where they lie in the sample."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from nrbench.imaging.convert import Image
from nrbench.lattice.geometry import Lattice, Points
from nrbench.plugins.forms import Refused, Shape

from ..sampling.patches import Patches
from ..sampling.two_periods import WHOLE, require_two_periods
from .rectangular_supercell import Rectangle, free_rectangle, upright_rectangle

_LEVELS = (0.0, 0.5, 1.0)
"""Shares of the tolerance: a rectangle is taken from the first at which one fits, an exact one where there is one."""
_TURNED = 4
"""A turned rectangle is taken where the upright one holds more than so many times its cells, or there is none."""
_LEAST_SIDE = 2


@dataclass(frozen=True)
class TileFrame:
    """Where the pixels of a tile, and of the image that all tiles are cut from, lie in the sample.

    Parameters
    ----------
    periods
        ``(2, 2)``: the lattice vectors (x, y), px of the sample, along the tile's columns' and rows' directions.
    size
        (rows, columns) of the tile in whole px: the floor of the periods' lengths (representative tile, section 3).
    steps
        ``(2, 2)``: how far, px of the sample, a step by one tile pixel goes along columns and rows.
    first
        (x, y): the number, in steps from the sample's first pixel, of the scaled image's first pixel.
    shape
        Of the scaled image (height, width): it covers the sample.
    cells
        How many cells of the lattice a tile holds.
    """

    periods: Points
    size: tuple[int, int]
    steps: Points
    first: tuple[int, int]
    shape: Shape
    cells: int

    @property
    def scale(self) -> tuple[float, float]:
        """Px of the sample a tile pixel, along columns' and rows' directions: r of equation 4."""
        x, y = np.hypot(*self.steps.T)
        return float(x), float(y)

    @property
    def plain(self) -> bool:
        """Whether tile pixels are the sample's own."""
        return bool(np.abs(self.steps - np.eye(2)).max() < 1e-9)

    def to_sample(self, pixels: Points) -> Points:
        """Return the points (x, y) of the sample under points of the scaled image, ``(..., 2)``."""
        return np.asarray((pixels + np.array(self.first)) @ self.steps)

    def scaled(self, sample: Image, patches: Patches) -> tuple[Image, NDArray[np.bool_] | None]:
        """Return the sample scaled down (and turned upright), and which of its pixels lie inside; None: all."""
        if self.plain:
            return sample, None
        pixels = pixel_grid(self.shape)
        inside = self.holds(pixels, sample.shape)
        return patches.read(self.to_sample(pixels)), None if inside.all() else inside

    def holds(self, pixels: Points, shape: tuple[int, ...]) -> NDArray[np.bool_]:
        """Tell which points of the scaled image lie inside a sample of ``shape``."""
        at = self.to_sample(pixels)
        return np.asarray(((at >= -1e-6) & (at <= np.array(shape[1::-1]) - 1 + 1e-6)).all(-1))


def rectangle_frame(lattice: Lattice, shape: tuple[int, ...], tolerance: float, scale_down: bool) -> TileFrame:
    """Return the frame of the smallest rectangular tile of a lattice for a sample of ``shape``.

    Of rectangles that are exact periods the smallest upright one counts, as in the paper, unless a turned one holds a
    quarter of its cells or less; where none fits the sample, those within half of the tolerance, then within all of it.
    What the rectangle's sides lack of lattice vectors is put into the frame's steps: the tile is deformed by no more
    than the tolerance, and the periods stay the lattice's.

    Parameters
    ----------
    tolerance
        How far, in shares of s, a side may be from a lattice vector.
    scale_down
        Whether the periods shrink to whole pixels (equation 4), or only what is over is cut off.

    Raises
    ------
    Refused
        Where the sample shows less than two periods, or holds no rectangle that repeats.
    """
    require_two_periods(lattice, shape)
    lattice = lattice.canonical()
    found = _smallest(lattice, shape, tolerance)
    if found is None:
        raise Refused(
            f"no rectangle inside the {shape[1]}x{shape[0]} px sample repeats within {tolerance:g} s of this "
            f"{lattice.kind} lattice: the tile would be larger than the sample"
        )
    periods = _nearest_upright(found.numbers @ lattice.matrix)
    lengths = np.hypot(*periods.T)
    columns, rows = (int(length + WHOLE) for length in lengths)
    if min(rows, columns) < _LEAST_SIDE:
        raise Refused(f"the lattice repeats every {lengths.min():.2f} px: a tile of less than 2 px shows nothing")
    steps = periods / (np.array([[columns], [rows]]) if scale_down else lengths[:, np.newaxis])
    first, covered = _cover(steps, shape)
    return TileFrame(periods, (rows, columns), steps, first, covered, found.cells)


def _smallest(lattice: Lattice, shape: tuple[int, ...], tolerance: float) -> Rectangle | None:
    """Return the upright rectangle, or a turned one that is much smaller, at the first level at which one fits."""
    limit = math.hypot(*shape[:2])
    for level in _LEVELS:
        reach = level * tolerance * lattice.s
        found = {
            weight: find(lattice, reach, limit) for find, weight in ((upright_rectangle, 1), (free_rectangle, _TURNED))
        }
        fitting = [(one.cells * weight, one) for weight, one in found.items() if one and _fits(one, lattice, shape)]
        if fitting:
            return min(fitting, key=lambda rated: rated[0])[1]
    return None


def _fits(found: Rectangle, lattice: Lattice, shape: tuple[int, ...]) -> bool:
    """Tell whether the box around the rectangle is no larger than the sample."""
    return bool((np.abs(found.numbers @ lattice.matrix).sum(0) <= np.array(shape[1::-1]) + WHOLE).all())


def _nearest_upright(vectors: Points) -> Points:
    """Return the rectangle's two sides as (across, down), turned least; at 45 degrees across points down, not up."""
    a, b = vectors
    slope = a[1] / a[0] if abs(a[0]) > 1e-9 * abs(a[1]) else np.inf
    if abs(slope) > 1 + 1e-9 or slope < 1e-9 - 1:
        a, b = b, a
    return np.stack([a if a[0] > 0 else -a, b if b[1] > 0 else -b])


def _cover(steps: Points, shape: tuple[int, ...]) -> tuple[tuple[int, int], Shape]:
    """Return the first pixel and the shape of the grid of ``steps`` that covers a sample of ``shape``."""
    ends = np.array([[x, y] for x in (0, shape[1] - 1) for y in (0, shape[0] - 1)], np.float64)
    corners = ends @ np.linalg.inv(steps)
    low, high = np.ceil(corners.min(0) - 1e-6).astype(int), np.floor(corners.max(0) + 1e-6).astype(int)
    return (int(low[0]), int(low[1])), (int(high[1] - low[1]) + 1, int(high[0] - low[0]) + 1)


def pixel_grid(shape: Shape) -> Points:
    """Return the (x, y) of each pixel, ``(H, W, 2)``."""
    y, x = np.indices(shape)
    return np.stack([x, y], -1).astype(np.float64)
