"""Single tiles, looked at where they should be: the finer channel of the judge."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from nrbench.imaging.door import Image
from nrbench.imaging.registration import Template, cut_windows
from nrbench.lattice.geometry import Lattice, Points

from .placement import window_shape
from .yardstick import Periodic

TOLERANCE = 0.1
"""How far from its place a tile may be, in units of s (and never less than 1 px)."""


@dataclass(frozen=True)
class Tiles:
    """Windows of one tile, half a cell apart along both vectors, each compared with the periodic image.

    Parameters
    ----------
    lattice
        Reduced, moved to the consensus phase.
    centers
        ``(n, 2)``: middles (x, y) in px.
    here
        ``(n,)``: best weighted NCC within the tolerance of the tile's place.
    elsewhere
        ``(n,)``: best weighted NCC in the rest of the cell.
    """

    lattice: Lattice
    centers: Points
    here: NDArray[np.float64]
    elsewhere: NDArray[np.float64]


def inspect(image: Image, periodic: Periodic, phase: Points) -> Tiles:
    """Compare every tile with the periodic image at the consensus phase.

    Parameters
    ----------
    image
        The image.
    periodic
        What it should follow.
    phase
        (x, y) px by which the image's content has moved as a whole.
    """
    lattice = periodic.lattice.shifted((float(phase[0]), float(phase[1])))
    window = window_shape(lattice, 1.0)
    near, far, reach = _search(lattice)
    parts = [_inspect_class(image, periodic, lattice, window, half, (near, far, reach)) for half in _HALVES]
    centers, here, elsewhere = (np.concatenate(column) for column in zip(*parts, strict=True))
    return Tiles(lattice, centers, here, elsewhere)


_HALVES = ((0.0, 0.0), (0.5, 0.0), (0.0, 0.5), (0.5, 0.5))


def _inspect_class(
    image: Image,
    periodic: Periodic,
    lattice: Lattice,
    window: tuple[int, int],
    half: tuple[float, float],
    search: tuple[NDArray[np.bool_], NDArray[np.bool_], int],
) -> tuple[Points, NDArray[np.float64], NDArray[np.float64]]:
    """Compare the tiles at one phase of the cell: all are looked for in the same patch."""
    near, far, reach = search
    size = np.array(window[::-1])
    places = Lattice(lattice.t1, lattice.t2, _pair(lattice.from_cell(half))).points(image.shape[:2])
    corners = np.rint(places - (size - 1) / 2).astype(np.intp)
    fits = (corners >= 0).all(1) & (corners + size <= image.shape[1::-1]).all(1)
    patch, weights = _patch(periodic, periodic.lattice.from_cell(half) - (size - 1) / 2 - reach, size + 2 * reach)
    surfaces = Template(patch, weights, window).surfaces(cut_windows(image, corners[fits], window))
    here, elsewhere = (surfaces[:, mask].max(1, initial=-1).astype(np.float64) for mask in (near, far))
    return places[fits], here, elsewhere


def _patch(periodic: Periodic, corner: Points, size: NDArray[np.intp]) -> tuple[NDArray[np.float32], ...]:
    """Return image and weights of a patch of the periodic image near ``corner`` modulo the lattice."""
    cell = np.ceil(np.abs(periodic.lattice.matrix).sum(0)).astype(int)
    middle = cell / 2 + 1
    at = np.rint(middle + periodic.lattice.wrap(corner - middle)).astype(int)
    at = np.maximum(at, 0)
    image, weights = periodic.patch((int(at[1] + size[1]), int(at[0] + size[0])))
    return image[at[1] :, at[0] :], weights[at[1] :, at[0] :]


def _search(lattice: Lattice) -> tuple[NDArray[np.bool_], NDArray[np.bool_], int]:
    """Return masks of the offsets within the tolerance and in the rest of the Voronoi cell, and their reach in px."""
    reach = int(np.ceil(np.hypot(*lattice.reduced().matrix.sum(0)) / 2))
    y, x = np.indices((2 * reach + 1, 2 * reach + 1)) - reach
    offsets = np.stack([x, y], -1).astype(np.float64)
    length = np.hypot(x, y)
    cell = np.abs(lattice.wrap(offsets) - offsets).max(-1) < 1e-6
    near = length <= max(TOLERANCE * lattice.s, 1.0)
    return near, cell & ~near, reach


def _pair(point: Points) -> tuple[float, float]:
    return float(point[0]), float(point[1])
