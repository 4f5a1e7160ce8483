"""Compare single tiles with the periodic image to detect displaced, missing and broken tiles."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from nrbench.imaging.convert import Image
from nrbench.lattice.geometry import Lattice, Points

from ..ncc.periodic import Periodic, TileSearch
from ..ncc.window_search import Planes, cut_planes, find_peaks
from . import limits
from .exponential_tail import ExponentialTail
from .windows import displace_lattice

Ratios = NDArray[np.float64]
_SHARED = 2
"""Number of one-tile windows, half a cell apart, that count as one independent window."""
_LEAST_CONTRAST = 0.2
"""Least contrast of a tile's surroundings, over the usual contrast, by which the tile's contrast is divided."""


def displacement_excess(tiles: Tiles, references: list[Tiles], regular_share: float) -> Ratios:
    """Return for each tile the ratio of its better fit elsewhere to the limits; above 1 the tile is displaced."""
    tail = ExponentialTail.fit(np.concatenate([other.gain for other in references]), overlap=_SHARED)
    sure = regular_share >= limits.SINGLE_TILE_SHARE
    limit = limits.TILE_SURPRISAL if sure else limits.FAINT_TILE_SURPRISAL
    return np.minimum(tail.surprisal(tiles.gain) / limit, tiles.gain / limits.GAIN_FLOOR)


def elsewhere_excess(tiles: Tiles, references: list[Tiles]) -> float:
    """Return the ratio of the share of tiles that fit better elsewhere to its limit; above 1 the pattern is different.

    This detects a pattern of twice the period. It fits the windows of two tiles, in which half of the joints are
    missing. If there are few references, the limit of a single tile is so wide that no single tile exceeds it.
    """
    most = max((float((other.gain > 0).mean()) for other in references if len(other.gain)), default=1.0)
    share = float((tiles.gain > 0).mean()) if len(tiles.gain) else 0.0
    return share / (limits.MISPLACED_SHARE + 2 * most)


def breakage_excess(tiles: Tiles, references: list[Tiles], limit: float = limits.TILE_SURPRISAL) -> Ratios:
    """Return for each tile the ratio of its bad fit in its place to the limits; above 1 the tile is broken.

    A broken tile has too low a correlation with the periodic image, or too little of its contrast. If the tiles around
    it have low contrast too, the cause is a blur, and the contrast is compared with theirs. ``limit`` is the surprisal
    above which a tile is broken.
    """
    slopes = np.concatenate([other.slope for other in references])
    slope, which = tiles.slope.copy(), np.flatnonzero(_shortfall(tiles.slope, slopes, limit) > 1)
    around = tiles.median_around(tiles.slope, which) / max(float(np.median(slopes)), 1e-6)
    slope[which] /= np.clip(around, _LEAST_CONTRAST, 1)
    return np.maximum(
        _shortfall(tiles.here, np.concatenate([other.here for other in references]), limit),
        _shortfall(slope, slopes, limit),
    )


def _shortfall(values: Ratios, usual: Ratios, limit: float) -> Ratios:
    """Return the ratio of the shortfall of values from the references' values to both limits of a broken tile."""
    surprisal = ExponentialTail.fit(-usual, overlap=_SHARED).surprisal(-values) / limit
    loss = (1 - values / max(float(np.median(usual)), 1e-6)) / (1 - limits.FIT_FLOOR)
    return np.minimum(surprisal, loss)


_AT_ONCE = 256
"""Number of windows that are compared at a time, which limits the memory."""
_AROUND = 2
"""Reach of a tile's surroundings, in cells."""
_TIE = 1e-6
"""Tolerance, px, by which places half-way between two pixels are rounded up, whatever their rounding errors."""


@dataclass(frozen=True)
class Tiles:
    """Windows of one tile, half a cell apart along both vectors, each compared with the periodic image.

    Parameters
    ----------
    lattice
        Reduced, displaced by the consensus phase.
    centers
        ``(n, 2)``: middles of the tiles' own places, (x, y) px.
    offsets
        ``(n, 2)``: (x, y) px from there to the best match within the tolerance.
    displacements
        ``(n, 2)``: (x, y) px from there to the best match in the whole cell; whole pixels beyond the tolerance.
    here
        ``(n,)``: best weighted NCC within the tolerance of the tile's place.
    elsewhere
        ``(n,)``: best weighted NCC in the rest of the cell.
    slope
        ``(n,)``: share of the contrast of the periodic image that the tile shows there.
    whole
        ``(n,)``: whether the window's middle is a lattice point (one window a cell).
    """

    lattice: Lattice
    centers: Points
    offsets: Points
    displacements: Points
    here: NDArray[np.float64]
    elsewhere: NDArray[np.float64]
    slope: NDArray[np.float64]
    whole: NDArray[np.bool_]

    @property
    def gain(self) -> NDArray[np.float64]:
        """``(n,)``: ``elsewhere`` less ``here``; large for displaced tiles."""
        return self.elsewhere - self.here

    def median_around(self, values: NDArray[np.float64], which: NDArray[np.intp]) -> NDArray[np.float64]:
        """Return for some tiles the median value of the surrounding tiles that share no pixel with them.

        These are the windows from one to :data:`_AROUND` cells away along the lattice vectors. If there are none, the
        median of all tiles is returned.

        Parameters
        ----------
        values
            ``(n,)``: one value a tile.
        which
            Indices of the tiles.
        """
        at = np.rint(2 * self.lattice.to_cell(self.centers)).astype(np.intp)
        medians = []
        for one in at[which]:
            away = np.abs(at - one).max(1)
            near = values[(away > 1) & (away <= 2 * _AROUND)]
            medians.append(np.median(near if len(near) else values))
        return np.array(medians, np.float64)


def measure_tiles(image: Image, periodic: Periodic, phase: Points, drift: Points | None = None) -> Tiles:
    """Compare every tile with the periodic image at the consensus phase.

    Parameters
    ----------
    image
        The image.
    periodic
        The periodic image that it should follow.
    phase
        (x, y) px: displacement of the image's content as a whole.
    drift
        2 x 2 matrix of an affine displacement of the tiles; None: no drift. It displaces whole tiles and does not
        deform them: a drift of 2 % is only 0.01 of a tile at its border.
    """
    lattice = displace_lattice(periodic.lattice, np.zeros((2, 2)) if drift is None else drift, phase)
    planes = periodic.colors.planes(image)
    parts = [_measure_windows(planes, lattice, search) for search in periodic.tile_searches]
    centers, offsets, displacements, here, elsewhere, slope = (
        np.concatenate(column) for column in zip(*parts, strict=True)
    )
    whole = np.repeat(
        [search.half == (0.0, 0.0) for search in periodic.tile_searches], [len(part[0]) for part in parts]
    )
    return Tiles(lattice, centers, offsets, displacements, here, elsewhere, slope, whole)


def _measure_windows(planes: Planes, lattice: Lattice, search: TileSearch) -> tuple[NDArray[np.float64], ...]:
    """Return the fields of :class:`Tiles` for the tiles at one place of the cell, without lattice and ``whole``."""
    shape, window = planes.values.shape[1:], search.correlator.template.window
    size = np.array(window[::-1])
    first = lattice.from_cell(search.half)
    centers = Lattice(lattice.t1, lattice.t2, (float(first[0]), float(first[1]))).points((shape[0], shape[1]))
    corners = np.floor(centers - (size - 1) / 2 + 0.5 + _TIE).astype(np.intp)
    fits = (corners >= 0).all(1) & (corners + size <= shape[::-1]).all(1)
    centers, corners = centers[fits], corners[fits]
    if not len(corners):
        return centers, centers, centers, np.zeros(0), np.zeros(0), np.zeros(0)
    at, here, slope = _match_near(planes, corners, search)
    best, elsewhere = _match_far(planes, corners, search)
    best = np.where((elsewhere > here)[:, np.newaxis], best, at)
    start = corners - (centers - (size - 1) / 2) + search.place
    return centers, start - at, start - best, here, elsewhere, slope


def _match_near(planes: Planes, corners: NDArray[np.intp], search: TileSearch) -> tuple[NDArray[np.float64], ...]:
    """Return the best offset of each window within the tolerance, and its NCC and slope there."""
    few = np.array_split(corners, len(corners) // _AT_ONCE + 1)
    windows = (cut_planes(planes.values, some, search.correlator.template.window) for some in few)
    ncc, slopes = (np.concatenate(column) for column in zip(*map(search.correlator.correlate, windows), strict=True))
    at, here = find_peaks(search.correlator.surfaces(ncc), search.near)
    order = np.cumsum(search.correlator.where).reshape(search.near.shape) - 1
    slope = slopes[np.arange(len(at)), order[*np.rint(at).astype(int).T[::-1]]]
    return at, here, slope.astype(np.float64)


def _match_far(
    planes: Planes, corners: NDArray[np.intp], search: TileSearch
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return the best offset of each window in the rest of the cell, and its NCC there; -1 if there is no rest."""
    if not search.offset_search.where.any():
        return np.zeros((len(corners), 2)), np.full(len(corners), -1.0)
    at, ncc = search.offset_search.find(planes, corners)
    return at.astype(np.float64), ncc
