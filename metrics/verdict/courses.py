"""Courses of tiles: a row of them that slid is seen by all of its tiles together, where none alone tells."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from . import limits
from .exponential_tail import ExponentialTail
from .tiles import Tiles

Ratios = NDArray[np.float64]
_DIRECTIONS = ((0, 1), (1, 0), (1, 1), (1, -1))
"""What stays the same, in cell coordinates, along t1, t2, t2 - t1 and t1 + t2: the shortest vectors; the courses of
running bond may run along the fourth."""
_LEAST_TILES = 4
"""Windows of a course, half a cell apart, below which it is left out: two tiles."""
_QUANTILE, _OVERLAP = 0.9, 8
"""Where the tail of the references' courses begins, and how many courses see the same tiles: half a cell apart, in
four directions."""


def course_gains(tiles: Tiles) -> Ratios:
    """Return, for each direction and tile, the mean over its course of how much better tiles fit elsewhere, ``(4, n)``.

    -inf where the course is too short. Longer courses scatter no more than shorter ones, whatever their tiles share.
    """
    at = np.rint(2 * tiles.lattice.to_cell(tiles.centers)).astype(np.intp)
    gains = np.full((len(_DIRECTIONS), len(at)), -np.inf)
    for row, direction in zip(gains, _DIRECTIONS, strict=True):
        _, course, count = np.unique(at @ direction, return_inverse=True, return_counts=True)
        mean = np.bincount(course, tiles.gain) / count
        row[:] = np.where(count >= _LEAST_TILES, mean, -np.inf)[course]
    return gains


def course_excess(tiles: Tiles, references: list[Tiles]) -> Ratios:
    """Return, for each tile, how far the worst of its courses exceeds its limits: above 1 the course has slid.

    Its tiles fit better elsewhere on the whole, by more than courses of the references ever do.
    """
    own = np.concatenate([_once(course_gains(other)) for other in references])
    gains = course_gains(tiles)
    if not len(own) or not np.isfinite(gains).any():
        return np.zeros(len(tiles.centers))
    tail = ExponentialTail.fit(own, _QUANTILE, _OVERLAP)
    chances = np.log(max(len(_once(gains)), 1)) - np.log(gains.size)
    surprise = tail.surprisal(np.maximum(gains, own.min()).ravel()).reshape(gains.shape) - chances
    ratio = np.minimum(surprise / limits.COURSE_SURPRISAL, 1 + gains / limits.COURSE_GAIN)
    return np.asarray(np.maximum(ratio, 0).max(0))


def _once(gains: Ratios) -> Ratios:
    """Return each course's gain once."""
    return np.concatenate([np.unique(row[np.isfinite(row)]) for row in gains])
