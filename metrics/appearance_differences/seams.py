"""Seams: straight lines, anywhere and in any direction, that stand out from their parallels."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from nrbench.imaging.convert import Image, gray
from nrbench.imaging.fold import Values, cell_coordinates, tile_grid
from nrbench.lattice.geometry import Lattice
from nrbench.plugins.forms import Shape

from .line_kernels import steep_line_sums, worst_of_parallels

Plane = NDArray[np.float32]
_TURNS = 4
_FLOOR = 0.25 / 255
"""Mean step along a line, in values, that rounding may leave."""


@dataclass(frozen=True)
class Line:
    """The line that stands out most.

    Parameters
    ----------
    strength
        By how many times the usual departure of its parallels it departs from their mean.
    size
        Its step, in values, or its excess of squared gradient.
    ends
        Its two ends (x, y) in px, on the image's padded square: they may lie outside the image.
    """

    strength: float
    size: float
    ends: tuple[tuple[float, float], tuple[float, float]]


def worst_lines(image: Image, lattice: Lattice | None) -> tuple[Line, Line]:
    """Return the worst lines of an image: by the step across them, and by the gradient on them.

    What the lattice explains is taken out first, so that rows of bricks are no seams. Then brightness, and the squared
    gradient, are summed along all lines by a discrete Radon transform, N^2 log N: every direction is looked at, with
    lines that end at every pixel of the border, if they are at least half the image's side long. A line's step is the
    difference between the 3 px on its right and those on its left; its gradient is compared with that of 6 px on either
    side. Both are then held against those of its parallels alone, since some directions are rougher by nature.

    Parameters
    ----------
    image
        The image.
    lattice
        Its lattice; where it lies does not matter. None: only means are taken out.
    """
    planes = np.stack([gray(image), _energy(image)], -1)
    left = np.asarray(planes - _usual(planes, lattice), np.float32)
    side = min(image.shape[:2])
    floors = np.array([_FLOOR, _FLOOR**2]) * math.sqrt(side)
    found = np.stack([_fan(left, turn, side / 2, floors) for turn in range(_TURNS)])
    best = found[:, :, 0].argmax(0)
    step, edge = (_line(found[turn, kind], int(turn), image.shape[:2]) for kind, turn in enumerate(best))
    return step, edge


def _fan(left: Values, turn: int, least: float, floors: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the worst lines of one of the four fans of directions, 45 degrees each."""
    value, energy = (steep_line_sums(_square(left[..., kind], turn)) for kind in range(2))
    return worst_of_parallels(value, energy, _lengths(left.shape[:2], turn), least, floors)


@lru_cache(maxsize=_TURNS)
def _lengths(shape: Shape, turn: int) -> Plane:
    return steep_line_sums(_square(np.ones(shape, np.float32), turn))


def _energy(image: Image) -> Plane:
    """Return the squared difference to the next pixel along x and along y, summed over channels."""
    across, down = np.diff(image, axis=1), np.diff(image, axis=0)
    energy = np.zeros(image.shape[:2], np.float32)
    energy[:, 1:] += np.einsum("ijk,ijk->ij", across, across)
    energy[1:] += np.einsum("ijk,ijk->ij", down, down)
    return energy


def _usual(planes: Values, lattice: Lattice | None) -> Values:
    """Return what the lattice explains: means over the pixels at the same place of the cell, to half a pixel."""
    if lattice is None:
        return np.asarray(planes.mean((0, 1)))
    cells, number = _cells(planes.shape[:2], lattice)
    counts = np.maximum(np.bincount(cells, minlength=number), 1)
    means = [np.bincount(cells, plane.ravel(), number) / counts for plane in np.moveaxis(planes, -1, 0)]
    return np.asarray(np.stack(means, -1)[cells].reshape(planes.shape), np.float32)


@lru_cache(maxsize=1)
def _cells(shape: Shape, lattice: Lattice) -> tuple[NDArray[np.intp], int]:
    """Return for each pixel its place of the cell, on a grid of two samples a pixel, and how many there are.

    Kept, since output and fresh draws share it.
    """
    reduced = replace(lattice.canonical(), origin=(0.0, 0.0))
    rows, columns = (2 * side for side in tile_grid(reduced))
    u, v = np.moveaxis((cell_coordinates(reduced, shape) % 1.0).reshape(-1, 2), -1, 0)
    row, column = (v * rows).astype(np.intp) % rows, (u * columns).astype(np.intp) % columns
    return row * columns + column, rows * columns


def _square(plane: Plane, turn: int) -> Plane:
    """Return a plane turned so that a fan's lines are steep and lean right, on a square of a power of two px."""
    turned = plane.T if turn & 2 else plane
    turned = turned[:, ::-1] if turn & 1 else turned
    size = 1 << math.ceil(math.log2(max(plane.shape)))
    square = np.zeros((size, size), np.float32)
    square[: turned.shape[0], : turned.shape[1]] = turned
    return square


def _line(found: NDArray[np.float64], turn: int, shape: Shape) -> Line:
    """Return a line of the turned square in the image's pixels."""
    size = 1 << math.ceil(math.log2(max(shape)))
    strength, lean, at, departure = found
    first = at - 0.5 - size
    ends = [(first, 0.0), (first + lean, size - 1.0)]
    width = shape[0] if turn & 2 else shape[1]
    if turn & 1:
        ends = [(width - 1 - x, y) for x, y in ends]
    start, end = [(y, x) if turn & 2 else (x, y) for x, y in ends]
    return Line(float(strength), float(departure), (start, end))
