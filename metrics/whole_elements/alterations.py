"""What whole tiles show when they are blurred, lit unevenly or bent: faults of others, that break no tile."""

from __future__ import annotations

from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from nrbench.imaging.fold import Values
from nrbench.lattice.geometry import Lattice, Points

from .composite_tiles import Rows, cuts
from .elements import SAMPLES, Cutter

_WIDE = 2 * SAMPLES + 1
"""Samples of the windows that are blurred: half a cell more on every side."""
_MOST = 48
"""Windows of an image that are altered: second moments need no more."""
_BLURS = (1.5, 3.0, 6.0)
"""Standard deviations of the Gaussians, px."""
_BENDS, _BEND, _SHIFT = 64, 0.05, 0.05
"""How many bends; standard deviations of the entries of their matrix, and of their shift in units of s."""
_DIRECTIONS, _ASIDE = 16, (-0.6, -0.4, -0.2, 0.0, 0.2, 0.4, 0.6)
_REACH, _STEP = 16.0, 0.3
"""How far from a line the light fades, px, and its step there, in values."""


def alterations(cutter: Cutter, middles: Points) -> Rows:
    """Return the second moments of what altering whole windows adds to them, ``(p, p)``, summed over the alterations.

    Each window is blurred by three Gaussians, all of it and on one side of a cut (the border of a blurred region runs
    through tiles); bent by a random affine map about as strong as a displacement of 0.15 s that is smooth over 2 s; and
    lit from one side of a line, all channels alike. What lies along these directions tells nothing of parts that were
    joined: without them a blurred band, a seam of brightness and a warp would break tiles.

    Parameters
    ----------
    cutter
        Of an image whose tiles are whole.
    middles
        ``(n, 2)``: of windows that lie inside, at least one.
    """
    middles = middles[:: -(-len(middles) // _MOST)]
    wide = cutter.around(middles, _WIDE, _WIDE / SAMPLES)
    side = (_WIDE - SAMPLES) // 2
    own, channels = _rows(wide[:, side:-side, side:-side]), wide.shape[-1]
    flat = wide.reshape(len(wide), -1, channels)
    total = _moments(_rows(cutter.around(middles, bends=_bends(cutter.lattice))) - own)
    total += _moments(np.repeat(_lights(cutter.lattice), channels, 1))
    cut = np.resize(cuts(own.shape[1]), own.shape)
    for deviation in _BLURS:
        change = _rows(np.einsum("qp,npc->nqc", _blur(cutter.lattice, deviation), flat, optimize=True)) - own
        total += _moments(change) + _moments(np.where(cut, change, 0))
    return total


def _rows(values: Values) -> Rows:
    return values.reshape(len(values), -1).astype(np.float64)


def _moments(rows: Rows) -> Rows:
    return np.asarray(rows.T @ rows / len(rows))


def _grid(samples: int, lattice: Lattice) -> Points:
    """Return where samples lie (x, y) px from a window's middle, ``(samples^2, 2)``."""
    steps = (np.arange(samples) + 0.5 - samples / 2) / SAMPLES
    u, v = np.meshgrid(steps, steps)
    return np.asarray(np.stack([u, v], -1).reshape(-1, 2) @ lattice.matrix)


@lru_cache(maxsize=len(_BLURS))
def _blur(lattice: Lattice, deviation: float) -> NDArray[np.float32]:
    """Return the weights with which a Gaussian reads each sample of a window from a wide one, ``(49, 225)``."""
    away = _grid(SAMPLES, lattice)[:, np.newaxis] - _grid(_WIDE, lattice)
    weights = np.exp(-(away**2).sum(-1) / (2 * deviation**2))
    return np.asarray(weights / weights.sum(1, keepdims=True), np.float32)


@lru_cache(maxsize=1)
def _bends(lattice: Lattice) -> tuple[NDArray[np.float64], Points]:
    """Return matrices ``(64, 2, 2)`` and shifts ``(64, 2)`` px, always the same ones."""
    drawn = np.random.default_rng(0).standard_normal((_BENDS, 3, 2))
    return np.eye(2) + _BEND * drawn[:, :2], _SHIFT * lattice.s * drawn[:, 2]


@lru_cache(maxsize=1)
def _lights(lattice: Lattice) -> Rows:
    """Return light of one side of lines through a window, shade of the other, ``(112, 49)``."""
    angles = 2 * np.pi * np.arange(_DIRECTIONS) / _DIRECTIONS
    across = _grid(SAMPLES, lattice) @ np.stack([np.cos(angles), np.sin(angles)])
    beyond = across.T[:, np.newaxis] - np.array(_ASIDE)[:, np.newaxis] * np.sqrt(lattice.area)
    weight = np.maximum(1 - np.abs(beyond) / _REACH, 0)
    return np.asarray((_STEP / 2 * np.where(beyond >= 0, weight, -weight)).reshape(-1, SAMPLES**2))
