"""Single tiles that are bad by themselves: displaced, or broken in their place."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from . import limits
from .exponential_tail import ExponentialTail
from .tiles import Tiles

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
