"""Find the smallest rectangular tile of a lattice, and where its pixels lie in the sample.

A lattice repeats with a rectangle if both sides of the rectangle are lattice vectors. :func:`find_upright_rectangle`
and :func:`find_free_rectangle` search for such rectangles, exact or nearly so; :func:`find_tile_frame` chooses one for
a sample and lays a grid of tile pixels over it. A rectangle is given by two lattice vectors, its sides or nearly:
``int64 (2, 2)``, whose rows are multiples of the vectors of the lattice.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from nrbench.imaging.convert import Image
from nrbench.lattice.geometry import Integers, Lattice, Points, integers_within
from nrbench.plugins.forms import Refused, Shape

from ..sampling.equal_places import pixel_grid
from ..sampling.patches import Patches
from ..sampling.two_periods import PERIOD_SLACK, require_two_periods

EXACT = 1e-6
"""Share of s that a rectangle may miss a period by, whatever the tolerance: the effect of rounding."""
_LEVELS = (0.0, 0.5, 1.0)
"""Shares of the tolerance, tried in order: the first at which a rectangle fits the sample is used."""
_TURNED = 4
"""A turned rectangle is used if the upright one holds more than this many times its cells, or if there is none."""
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
        ``(2, 2)``: the vectors (x, y), px of the sample, of one tile pixel along columns and rows.
    first
        (x, y): position of the scaled image's first pixel, in steps from the sample's first pixel.
    shape
        Shape (height, width) of the scaled image, which covers the sample.
    cells
        Number of cells of the lattice in a tile.
    """

    periods: Points
    size: tuple[int, int]
    steps: Points
    first: tuple[int, int]
    shape: Shape
    cells: int

    def to_sample(self, pixels: Points) -> Points:
        """Return the points (x, y) of the sample under points of the scaled image, ``(..., 2)``."""
        return np.asarray((pixels + np.array(self.first)) @ self.steps)

    def scale_sample(self, sample: Image, patches: Patches) -> tuple[Image, NDArray[np.bool_] | None]:
        """Return the sample scaled down (and turned upright), and which of its pixels lie inside; None: all."""
        if np.abs(self.steps - np.eye(2)).max() < 1e-9:
            return sample, None
        pixels = pixel_grid(*self.shape[::-1]).astype(np.float64)
        inside = self.holds(pixels, sample.shape)
        return patches.read_points(self.to_sample(pixels)), None if inside.all() else inside

    def holds(self, pixels: Points, shape: tuple[int, ...]) -> NDArray[np.bool_]:
        """Return which points of the scaled image lie inside a sample of ``shape``."""
        at = self.to_sample(pixels)
        return np.asarray(((at >= -1e-6) & (at <= np.array(shape[1::-1]) - 1 + 1e-6)).all(-1))


def find_tile_frame(lattice: Lattice, shape: tuple[int, ...], tolerance: float) -> TileFrame:
    """Return the frame of the smallest rectangular tile of a lattice for a sample of ``shape``.

    Among rectangles that are exact periods the smallest upright one is used, as in the paper, unless a turned one holds
    a quarter of its cells or less. If none fits the sample, rectangles within half of the tolerance are searched, then
    those within all of it. The steps of the frame absorb what the sides of the rectangle lack of lattice vectors: the
    tile is deformed by no more than the tolerance, and the periods stay those of the lattice.

    Parameters
    ----------
    lattice, shape
        The lattice of the sample, and the sample's shape.
    tolerance
        How far, in shares of s, a side may be from a lattice vector.

    Raises
    ------
    Refused
        Where the sample shows less than two periods, or holds no rectangle that repeats.
    """
    require_two_periods(lattice, shape)
    lattice = lattice.canonical()
    rectangle = _find_rectangle(lattice, shape, tolerance)
    if rectangle is None:
        raise Refused(
            f"no rectangle inside the {shape[1]}x{shape[0]} px sample repeats within {tolerance:g} s of this "
            f"{lattice.kind} lattice: the tile would be larger than the sample"
        )
    periods = _orient(rectangle @ lattice.matrix)
    lengths = np.hypot(*periods.T)
    columns, rows = (int(length + PERIOD_SLACK) for length in lengths)
    if min(rows, columns) < _LEAST_SIDE:
        raise Refused(f"the lattice repeats every {lengths.min():.2f} px: a tile of less than 2 px shows nothing")
    steps = periods / np.array([[columns], [rows]])  # equation 4: the periods shrink to whole pixels
    first, covered = _cover(steps, shape)
    return TileFrame(periods, (rows, columns), steps, first, covered, count_rectangle_cells(rectangle))


def count_rectangle_cells(rectangle: Integers) -> int:
    """Return the number of cells of the lattice in a rectangle."""
    (p, q), (r, s) = rectangle
    return abs(int(p) * int(s) - int(q) * int(r))


def _find_rectangle(lattice: Lattice, shape: tuple[int, ...], tolerance: float) -> Integers | None:
    """Return the upright rectangle, or a turned one that is much smaller, at the first level at which one fits."""
    limit = math.hypot(*shape[:2])
    room = np.array(shape[1::-1]) + PERIOD_SLACK
    for level in _LEVELS:
        reach = level * tolerance * lattice.s
        candidates = (
            (find_upright_rectangle(lattice, reach, limit), 1),
            (find_free_rectangle(lattice, reach, limit), _TURNED),
        )
        fitting = [
            (count_rectangle_cells(rectangle) * weight, rectangle)
            for rectangle, weight in candidates
            if rectangle is not None and bool((np.abs(rectangle @ lattice.matrix).sum(0) <= room).all())
        ]
        if fitting:
            return min(fitting, key=lambda rated: rated[0])[1]
    return None


def _orient(vectors: Points) -> Points:
    """Return the sides of a rectangle as (across, down) with the least rotation; at 45 degrees across points down."""
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


def find_upright_rectangle(lattice: Lattice, tolerance: float, limit: float) -> Integers | None:
    """Return the smallest upright rectangle that is a period of the lattice.

    The sides (w, 0) and (0, h) are each the shortest within ``tolerance`` of a lattice vector.

    Parameters
    ----------
    lattice
        Its origin has no effect, and its basis none on the rectangle.
    tolerance
        Largest distance, px, of a side from a lattice vector; less than half of s. 0: exact up to rounding.
    limit
        Longest side, px.

    Returns
    -------
    Integers or None
        None if there is none, as for most lattices at a tolerance of 0.
    """
    reach, basis = max(tolerance, EXACT * lattice.s), lattice.reduced().matrix
    across, down = (_side_along_x(turned, reach, limit) for turned in (basis, basis[:, ::-1]))
    if across is None or down is None:
        return None
    return _count_vectors(lattice, np.array([across[1] @ basis, down[1] @ basis]))


def find_free_rectangle(lattice: Lattice, tolerance: float, limit: float) -> Integers | None:
    """Return the rectangle of least area, in any direction, that is a period of the lattice.

    One side is a lattice vector; the other, at a right angle, is within ``tolerance`` of one. Sides are tried from the
    shortest on, until they are too long to be the shorter side of a smaller rectangle. Parameters and results are those
    of :func:`find_upright_rectangle`. Time grows with the number of lattice vectors tried: those shorter than the
    square root of the area of the result, or than ``limit`` if there is none (about 2 ``limit``^2 over the cell's
    area).
    """
    reach, basis = max(tolerance, EXACT * lattice.s), lattice.reduced().matrix
    least, rectangle = math.inf, None
    for side in _half_plane(integers_within(basis, (-limit, -limit), (limit, limit)), basis, limit):
        vector = side @ basis
        length = float(np.hypot(*vector))
        if length * length >= least * (1 - 1e-9):
            break
        x, y = vector / length
        other = _side_along_x(basis @ np.array([[-y, x], [x, y]]), reach, limit)
        if other is not None and length * other[0] < least * (1 - 1e-9):
            least = length * other[0]
            rectangle = _count_vectors(lattice, np.array([vector, other[1] @ basis]))
    return rectangle


def _side_along_x(basis: Points, reach: float, limit: float) -> tuple[float, Integers] | None:
    """Return the least x with (x, 0) within ``reach`` of a vector of the basis, and that vector's integers."""
    numbers = integers_within(basis, (reach, -reach), (limit + reach, reach))
    vectors = numbers @ basis
    lengths = vectors[:, 0]
    chosen = (np.abs(vectors[:, 1]) <= reach * (1 + 1e-9)) & (lengths > reach) & (lengths <= limit * (1 + 1e-9))
    if not chosen.any():
        return None
    best = np.argmin(np.where(chosen, lengths, np.inf))
    return float(lengths[best]), numbers[best]


def _half_plane(numbers: Integers, basis: Points, limit: float) -> Integers:
    """Return one of each pair +-(i, j), shortest first, none longer than ``limit``."""
    numbers = numbers[(numbers[:, 0] > 0) | ((numbers[:, 0] == 0) & (numbers[:, 1] > 0))]
    lengths = np.hypot(*(numbers @ basis).T)
    return numbers[np.argsort(lengths, kind="stable")][: int((lengths <= limit).sum())]


def _count_vectors(lattice: Lattice, vectors: Points) -> Integers:
    """Return the multiples of the lattice's vectors that add up to some lattice vectors."""
    return np.rint(vectors @ np.linalg.inv(lattice.matrix)).astype(np.int64)
