"""Find straight seams: lines in any direction that stand out from their parallels, and draw them."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from nrbench.imaging.convert import Image, gray
from nrbench.imaging.mean_tile import Values, cell_coordinates, tile_grid
from nrbench.lattice.geometry import Lattice
from nrbench.plugins.forms import Shape

from .line_kernels import steep_line_sums, worst_of_parallels

Plane = NDArray[np.float32]
_FANS = 4
"""Fans of directions, 45 degrees each."""
_FLOOR = 0.25 / 255
"""Mean step along a line, in values, that rounding may leave."""
_MARK = np.array((0.9, 0.1, 0.1), np.float32)
_DASH, _GAP = 8, 24
"""Dashes of a drawn line and the gaps between them, px."""


@dataclass(frozen=True)
class Line:
    """A line that stands out from its parallels.

    Parameters
    ----------
    strength
        Departure of the line from the mean of its parallels, over their usual departure.
    size
        Step across the line, in values, or excess of squared gradient on it.
    ends
        Its two ends (x, y) in px, on the image's padded square, so they may lie outside the image.
    """

    strength: float
    size: float
    ends: tuple[tuple[float, float], tuple[float, float]]


def find_worst_lines(image: Image, lattice: Lattice | None) -> tuple[Line, Line]:
    """Return the worst lines of an image: the one with the strongest step, and the one with the strongest gradient.

    The periodic part is subtracted first, so that rows of bricks are no seams. Then brightness and squared gradient are
    summed along all lines by a discrete Radon transform, in O(N^2 log N): lines in every direction, at most 1024, that
    start at any pixel of the border and are at least half the image's side long. The step of a line is the difference
    between the 3 px on its right and the 3 px on its left. Its gradient is compared with that of 6 px on either side.
    Both are then compared with those of parallel lines only, because some directions are rougher than others.

    Parameters
    ----------
    image
        The image.
    lattice
        The lattice whose periodic part is subtracted; its origin does not matter. None: only the mean is subtracted.
    """
    planes = np.stack([gray(image), _energy(image)], -1)
    rest = np.asarray(planes - _periodic_part(planes, lattice), np.float32)
    side = min(image.shape[:2])
    floors = np.array([_FLOOR, _FLOOR**2]) * math.sqrt(side)
    worst = np.stack([_worst_of_fan(rest, fan, side / 2, floors) for fan in range(_FANS)])
    best = worst[:, :, 0].argmax(0)
    step, edge = (_line(worst[fan, kind], int(fan), image.shape[:2]) for kind, fan in enumerate(best))
    return step, edge


def draw_line(output: Image, line: Line) -> Image:
    """Return the output with the line drawn in short dashes, far enough apart to show what is below."""
    picture = np.array(np.broadcast_to(output, (*output.shape[:2], 3)))
    (x0, y0), (x1, y1) = line.ends
    number = int(max(abs(x1 - x0), abs(y1 - y0))) + 1
    along = np.linspace(0, 1, number)
    along = along[np.arange(number) % (_DASH + _GAP) < _DASH]
    x, y = np.rint(x0 + along * (x1 - x0)).astype(int), np.rint(y0 + along * (y1 - y0)).astype(int)
    inside = (x >= 0) & (y >= 0) & (x < picture.shape[1]) & (y < picture.shape[0])
    picture[y[inside], x[inside]] = _MARK
    return picture


def _worst_of_fan(rest: Values, fan: int, least: float, floors: NDArray[np.float64]) -> NDArray[np.float64]:
    value, energy = (steep_line_sums(_turn(rest[..., kind], fan)) for kind in range(2))
    return worst_of_parallels(value, energy, _lengths(rest.shape[:2], fan), least, floors)


@lru_cache(maxsize=_FANS)
def _lengths(shape: Shape, fan: int) -> Plane:
    return steep_line_sums(_turn(np.ones(shape, np.float32), fan))


def _energy(image: Image) -> Plane:
    """Return the squared difference to the next pixel along x and along y, summed over channels."""
    energy = np.zeros(image.shape[:2], np.float32)
    for axis, inside in ((1, np.s_[:, 1:]), (0, np.s_[1:])):
        energy[inside] += sum(np.diff(plane, axis=axis) ** 2 for plane in np.moveaxis(image, -1, 0))
    return energy


def _periodic_part(planes: Values, lattice: Lattice | None) -> Values:
    """Return the means over all pixels at the same place of the cell, to half a pixel."""
    if lattice is None:
        return np.asarray(planes.mean((0, 1)))
    cells, number = _cells(planes.shape[:2], lattice)
    counts = np.maximum(np.bincount(cells, minlength=number), 1)
    means = [np.bincount(cells, plane.ravel(), number) / counts for plane in np.moveaxis(planes, -1, 0)]
    return np.stack([mean.astype(np.float32).take(cells).reshape(planes.shape[:2]) for mean in means], -1)


@lru_cache(maxsize=1)
def _cells(shape: Shape, lattice: Lattice) -> tuple[NDArray[np.intp], int]:
    """Return each pixel's place in the cell, on a grid of two samples a pixel, and the number of places.

    The result is cached because output and fresh draws share it.
    """
    reduced = replace(lattice.canonical(), origin=(0.0, 0.0))
    rows, columns = (2 * side for side in tile_grid(reduced))
    u, v = np.moveaxis((cell_coordinates(reduced, shape) % 1.0).reshape(-1, 2), -1, 0)
    row, column = (v * rows).astype(np.intp) % rows, (u * columns).astype(np.intp) % columns
    return row * columns + column, rows * columns


def _turn(plane: Plane, fan: int) -> Plane:
    """Return a plane turned such that the fan's lines are steep and lean right."""
    turned = plane.T if fan & 2 else plane
    return turned[:, ::-1] if fan & 1 else turned


def _line(row: NDArray[np.float64], fan: int, shape: Shape) -> Line:
    """Return a line of the turned square in the image's pixels."""
    size = 1 << math.ceil(math.log2(max(shape)))
    strength, lean, at, departure = row
    first = at - 0.5 - size
    ends = [(first, 0.0), (first + lean * max(size // 256, 1), size - 1.0)]
    width = shape[0] if fan & 2 else shape[1]
    if fan & 1:
        ends = [(width - 1 - x, y) for x, y in ends]
    start, end = [(y, x) if fan & 2 else (x, y) for x, y in ends]
    return Line(float(strength), float(departure), (start, end))
