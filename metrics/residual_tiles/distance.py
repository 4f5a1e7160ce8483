"""How far the distribution of an output's residual tiles is from that of fresh draws: an energy distance."""

from __future__ import annotations

from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from .tileset import TileSet

MOST_TILES = 160
"""Tiles of each image that are compared; of more, evenly spaced ones."""
_PARTS = 4


def distance(output: TileSet, fresh: tuple[TileSet, ...], weights: NDArray[np.float32]) -> tuple[float, float]:
    """Return the energy distance of the output's departures to fresh draws', and that of fresh draws to each other.

    ``2 E|X - Y| - E|X - X'| - E|Y - Y'|`` (Szekely and Rizzo, Energy statistics, 2013), over ``E|Y - Y'|``: 0 where
    both have one distribution, whatever that is, since X and X' are different tiles (the estimate can be under 0).
    Departures are each image's own, less its mean tile. It is the mean of that of all samples and that of the means of
    4 x 4 parts of a tile: in so many dimensions as a tile has samples the first sees little but how strong departures
    are, and noise would buy it. The level of fresh draws, each against all others, is what an
    output as large as they are reads when it is right. O(n^2) products for at most 160 tiles an image.

    Parameters
    ----------
    output, fresh
        Tiles on one grid; at least two of each, two fresh sets.
    weights
        ``(V, U)``.
    """
    both = [_compared([flat(tiles, weights) for tiles in (output, *fresh)]) for flat in (_flat, _pooled)]
    own, level = np.mean(both, 0)
    return float(own), float(level)


def _compared(sets: list[NDArray[np.float32]]) -> tuple[float, float]:
    """Return the energy distance of the first set to all others, and the mean one of each of these to the rest."""
    start = np.cumsum([0, *(len(part) for part in sets)])
    lengths = _lengths(np.concatenate(sets))
    spans = [slice(a, b) for a, b in pairwise(start)]
    means = np.array([[lengths[a, b].sum(dtype=np.float64) for b in spans] for a in spans])
    counts = np.array([len(part) for part in sets], np.float64)
    levels = [_energy(means, counts, k, [j for j in range(1, len(sets)) if j != k]) for k in range(1, len(sets))]
    return _energy(means, counts, 0, list(range(1, len(sets)))), float(np.mean(levels))


def _flat(tiles: TileSet, weights: NDArray[np.float32]) -> NDArray[np.float32]:
    few = tiles.departures if len(tiles) <= MOST_TILES else _thinned(tiles.departures)
    share = np.sqrt(weights / weights.sum() / few.shape[-1])[..., np.newaxis]
    return np.asarray((few * share).reshape(len(few), -1), np.float32)


def _pooled(tiles: TileSet, weights: NDArray[np.float32]) -> NDArray[np.float32]:
    """Return the weighted mean departures of 4 x 4 parts of each tile."""
    few = tiles.departures if len(tiles) <= MOST_TILES else _thinned(tiles.departures)
    rows, columns = (np.unique(np.linspace(0, side, _PARTS + 1).astype(int)[:-1]) for side in weights.shape)
    sums = np.add.reduceat(np.add.reduceat(few * weights[..., np.newaxis], rows, 1), columns, 2)
    masses = np.add.reduceat(np.add.reduceat(weights, rows, 0), columns, 1)
    return np.asarray((sums / masses[..., np.newaxis]).reshape(len(few), -1), np.float32)


def _thinned(departures: NDArray[np.float32]) -> NDArray[np.float32]:
    return departures[np.linspace(0, len(departures) - 1, MOST_TILES).round().astype(np.intp)]


def _lengths(flat: NDArray[np.float32]) -> NDArray[np.float32]:
    powers = (flat**2).sum(1)
    squares = flat @ flat.T
    squares *= -2
    squares += powers
    squares += powers[:, np.newaxis]
    np.fill_diagonal(squares, 0)
    return np.asarray(np.sqrt(np.maximum(squares, 0, out=squares), out=squares))


def _energy(sums: NDArray[np.float64], counts: NDArray[np.float64], one: int, others: list[int]) -> float:
    """Return the energy distance of one set to others that are each a draw: pairs within a draw for E|Y - Y'|."""
    between = (sums[one, others] / counts[others]).mean() / counts[one]
    own = sums[one, one] / (counts[one] * (counts[one] - 1))
    theirs = (sums[others, others] / (counts[others] * (counts[others] - 1))).mean()
    return float((2 * between - own - theirs) / max(theirs, 1e-12))
