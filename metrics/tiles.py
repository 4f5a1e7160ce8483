"""Single tiles, looked at where they should be: the finer channel of the judge."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from nrbench.imaging.door import Image
from nrbench.imaging.fold import Values
from nrbench.imaging.registration import cut_windows, peaks
from nrbench.lattice.geometry import Lattice, Points

from .periodic import Periodic, Search

_AT_ONCE = 256


@dataclass(frozen=True)
class Tiles:
    """Windows of one tile, half a cell apart along both vectors, each compared with the periodic image.

    Parameters
    ----------
    lattice
        Reduced, moved to the consensus phase.
    centers
        ``(n, 2)``: middles (x, y) in px where the tiles belong.
    offsets
        ``(n, 2)``: (x, y) px from there to the best match within the tolerance.
    here
        ``(n,)``: best weighted NCC within the tolerance of the tile's place.
    elsewhere
        ``(n,)``: best weighted NCC in the rest of the cell.
    slope
        ``(n,)``: how much of the periodic image's contrast the tile shows here.
    whole
        ``(n,)``: whether the window's middle is a lattice point (one window a cell).
    """

    lattice: Lattice
    centers: Points
    offsets: Points
    here: NDArray[np.float64]
    elsewhere: NDArray[np.float64]
    slope: NDArray[np.float64]
    whole: NDArray[np.bool_]

    @property
    def gain(self) -> NDArray[np.float64]:
        """``(n,)``: how much better a tile fits elsewhere than here: high where it is displaced."""
        return self.elsewhere - self.here


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
    parts = [_inspect(image, lattice, search) for search in periodic.searches]
    centers, offsets, here, elsewhere, slope = (np.concatenate(column) for column in zip(*parts, strict=True))
    whole = np.repeat([search.half == (0.0, 0.0) for search in periodic.searches], [len(part[0]) for part in parts])
    return Tiles(lattice, centers, offsets, here, elsewhere, slope, whole)


def _inspect(image: Image, lattice: Lattice, search: Search) -> tuple[NDArray[np.float64], ...]:
    """Return middles, offsets, NCC here and elsewhere, and slope of the tiles at one place of the cell."""
    size = np.array(search.template.window[::-1])
    first = lattice.from_cell(search.half)
    centers = Lattice(lattice.t1, lattice.t2, (float(first[0]), float(first[1]))).points(image.shape[:2])
    corners = np.rint(centers - (size - 1) / 2).astype(np.intp)
    fits = (corners >= 0).all(1) & (corners + size <= image.shape[1::-1]).all(1)
    centers, corners = centers[fits], corners[fits]
    if not len(corners):
        return centers, centers, np.zeros(0), np.zeros(0), np.zeros(0)
    few = np.array_split(corners, len(corners) // _AT_ONCE + 1)
    parts = [_compare(cut_windows(image, some, search.template.window), search) for some in few]
    at, *fits = (np.concatenate(column) for column in zip(*parts, strict=True))
    return centers, corners - (centers - (size - 1) / 2) + search.place - at, *fits


def _compare(windows: Values, search: Search) -> tuple[NDArray[np.float64], ...]:
    """Return where each window fits best within the tolerance, NCC here and elsewhere, and slope."""
    surfaces, slopes = search.template.surfaces_and_slopes(windows)
    at, here = peaks(surfaces, search.near)
    slope = slopes[np.arange(len(at)), *np.rint(at).astype(int).T[::-1]].astype(np.float64)
    return at, here, surfaces[:, search.far].max(1).astype(np.float64), slope
