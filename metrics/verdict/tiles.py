"""Compare single tiles with the periodic image at their places: displaced, missing and broken tiles."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from nrbench.imaging.convert import Image
from nrbench.lattice.geometry import Lattice, Points

from ..ncc.periodic import Periodic, Search
from ..ncc.window_search import Planes, cut_planes, peaks
from . import limits
from .exponential_tail import ExponentialTail
from .windows import moved

Ratios = NDArray[np.float64]
_SHARED = 2
"""How many of the one-tile windows, half a cell apart, share what one independent window would see."""
_LEAST_CONTRAST = 0.2
"""Contrast of a tile's surroundings, over the usual, below which it is not made up for: nothing is left to see."""


def displacement_excess(tiles: Tiles, references: list[Tiles], regular_share: float) -> Ratios:
    """Return, for each tile, how far it exceeds the limits of fitting better elsewhere: above 1 it is displaced."""
    tail = ExponentialTail.fit(np.concatenate([other.gain for other in references]), overlap=_SHARED)
    sure = regular_share >= limits.SINGLE_TILE_SHARE
    limit = limits.TILE_SURPRISAL if sure else limits.FAINT_TILE_SURPRISAL
    return np.minimum(tail.surprisal(tiles.gain) / limit, tiles.gain / limits.GAIN_FLOOR)


def elsewhere_excess(tiles: Tiles, references: list[Tiles]) -> float:
    """Return how far the share of tiles that fit better elsewhere exceeds its limit: above 1 the pattern is another.

    It needs no tail of what single tiles of few references come to: a pattern of twice the period fits the windows of
    two tiles, in which half of the joints are missing, and no tile by itself is beyond a wide tail.
    """
    most = max((float((other.gain > 0).mean()) for other in references if len(other.gain)), default=1.0)
    found = float((tiles.gain > 0).mean()) if len(tiles.gain) else 0.0
    return found / (limits.MISPLACED_SHARE + 2 * most)


def breakage_excess(tiles: Tiles, references: list[Tiles]) -> Ratios:
    """Return, for each tile, how far it exceeds the limits of fitting badly in its place: above 1 it is broken.

    Its correlation with the periodic image, or the contrast that it shows of it, is too low. Contrast that the tiles
    around it lack as well is held against blur, not against the tile.
    """
    slopes = np.concatenate([other.slope for other in references])
    slope, which = tiles.slope.copy(), np.flatnonzero(_lack(tiles.slope, slopes) > 1)
    around = tiles.around(tiles.slope, which) / max(float(np.median(slopes)), 1e-6)
    slope[which] /= np.clip(around, _LEAST_CONTRAST, 1)
    return np.maximum(_lack(tiles.here, np.concatenate([other.here for other in references])), _lack(slope, slopes))


def _lack(values: Ratios, own: Ratios) -> Ratios:
    """Return how far values fall short of the references' own, in units of both limits of a broken tile."""
    surprise = ExponentialTail.fit(-own, overlap=_SHARED).surprisal(-values) / limits.TILE_SURPRISAL
    short = (1 - values / max(float(np.median(own)), 1e-6)) / (1 - limits.FIT_FLOOR)
    return np.minimum(surprise, short)


_AT_ONCE = 256
"""Windows compared at a time, which bounds memory."""
_AROUND = 2
"""How many cells away a tile's surroundings reach."""
_TIE = 1e-6
"""Places half-way between two pixels go to the second, whatever rounding made of them: px."""


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
    moved
        ``(n, 2)``: (x, y) px from there to the best match in the whole cell; beyond the tolerance to whole pixels.
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
    moved: Points
    here: NDArray[np.float64]
    elsewhere: NDArray[np.float64]
    slope: NDArray[np.float64]
    whole: NDArray[np.bool_]

    @property
    def gain(self) -> NDArray[np.float64]:
        """``(n,)``: how much better a tile fits elsewhere than here: high where it is displaced."""
        return self.elsewhere - self.here

    def around(self, values: NDArray[np.float64], which: NDArray[np.intp]) -> NDArray[np.float64]:
        """Return, for each tile of ``which``, the median value of the tiles around it that it shares no pixel with.

        Those are the windows from one to :data:`_AROUND` cells away along the lattice vectors; where there are none,
        the median of all.
        """
        at = np.rint(2 * self.lattice.to_cell(self.centers)).astype(np.intp)
        found = []
        for one in at[which]:
            away = np.abs(at - one).max(1)
            near = values[(away > 1) & (away <= 2 * _AROUND)]
            found.append(np.median(near if len(near) else values))
        return np.array(found, np.float64)


def inspect(image: Image, periodic: Periodic, phase: Points, drift: Points | None = None) -> Tiles:
    """Compare every tile with the periodic image at the consensus phase.

    Parameters
    ----------
    image
        The image.
    periodic
        What it should follow.
    phase
        (x, y) px by which the image's content has moved as a whole.
    drift
        2 x 2 matrix of an affine displacement that the tiles' places are to follow; None: none. Within a tile it is
        left out: a drift of 2 % is 0.01 of a tile at its border.
    """
    lattice = moved(periodic.lattice, np.zeros((2, 2)) if drift is None else drift, phase)
    planes = periodic.colors.planes(image)
    parts = [_inspect(planes, lattice, search) for search in periodic.searches]
    centers, offsets, moved_by, here, elsewhere, slope = (np.concatenate(column) for column in zip(*parts, strict=True))
    whole = np.repeat([search.half == (0.0, 0.0) for search in periodic.searches], [len(part[0]) for part in parts])
    return Tiles(lattice, centers, offsets, moved_by, here, elsewhere, slope, whole)


def _inspect(planes: Planes, lattice: Lattice, search: Search) -> tuple[NDArray[np.float64], ...]:
    """Return the middles of the tiles at one place of the cell, and what :class:`Tiles` tells of each."""
    shape, window = planes.values.shape[1:], search.bank.template.window
    size = np.array(window[::-1])
    first = lattice.from_cell(search.half)
    centers = Lattice(lattice.t1, lattice.t2, (float(first[0]), float(first[1]))).points((shape[0], shape[1]))
    corners = np.floor(centers - (size - 1) / 2 + 0.5 + _TIE).astype(np.intp)
    fits = (corners >= 0).all(1) & (corners + size <= shape[::-1]).all(1)
    centers, corners = centers[fits], corners[fits]
    if not len(corners):
        return centers, centers, centers, np.zeros(0), np.zeros(0), np.zeros(0)
    at, here, slope = _near(planes, corners, search)
    best, elsewhere = _far(planes, corners, search)
    best = np.where((elsewhere > here)[:, np.newaxis], best, at)
    start = corners - (centers - (size - 1) / 2) + search.place
    return centers, start - at, start - best, here, elsewhere, slope


def _near(planes: Planes, corners: NDArray[np.intp], search: Search) -> tuple[NDArray[np.float64], ...]:
    """Return where each window fits best within the tolerance, its NCC there, and its slope."""
    few = np.array_split(corners, len(corners) // _AT_ONCE + 1)
    windows = (cut_planes(planes.values, some, search.bank.template.window) for some in few)
    ncc, slopes = (np.concatenate(column) for column in zip(*map(search.bank.compare, windows), strict=True))
    at, here = peaks(search.bank.surfaces(ncc), search.near)
    order = np.cumsum(search.bank.where).reshape(search.near.shape) - 1
    slope = slopes[np.arange(len(at)), order[*np.rint(at).astype(int).T[::-1]]]
    return at, here, slope.astype(np.float64)


def _far(planes: Planes, corners: NDArray[np.intp], search: Search) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return where each window fits best in the rest of the cell, and its NCC there: -1 where there is no rest."""
    if not search.scan.where.any():
        return np.zeros((len(corners), 2)), np.full(len(corners), -1.0)
    at, ncc = search.scan.find(planes, corners)
    return at.astype(np.float64), ncc
