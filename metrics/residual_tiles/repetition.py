"""Count near-exact twins: windows that the output shows twice, and windows that it copies from the sample."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from nrbench.imaging.convert import Image
from nrbench.imaging.mean_tile import Values
from nrbench.lattice.geometry import Lattice

from ..ncc.periodic import tile_box
from .pair_kernels import add_distances, index_lags, pair_blocks
from .tiles import ComparedTiles, TileSet, quarters

Distances = NDArray[np.float32]
SIZES = (0.5, 1.0, 2.0)
"""Widths of the compared windows, in tiles."""
_MOST_TILES = 500
"""Largest number of tiles that are compared with each other; if there are more, the central ones. They have 125,000
pairs."""
_MOST_COPIES = 300
"""Largest number of tiles that are searched for in the sample; if there are more, evenly spaced ones."""
_OF_COPIER = 0.1
"""Pairs are twins below the distance at which pairs of fresh draws are a tenth as frequent as twins of a copier."""
_LEAST_PAIRS = 6
"""Pairs at one lag below which the lag is ignored: half of them can be twins by chance."""
_BY_CHANCE = 0.02
"""Windows are copies if they are nearer to the sample than all but this share of the windows of fresh draws."""
_LEAST_SCALE = 0.25
"""Distances are relative to the output's energy, but at least to this share of that of fresh draws."""


@dataclass(frozen=True)
class Pairs:
    """Pairs of windows of one width.

    Parameters
    ----------
    distances
        ``(k p,)``: weighted mean squared difference of each pair, for the windows in k parts of the cell in turn.
    lags
        ``(p,)``: index of each pair's lag, in cells. Windows in different parts of the cell have different lags.
    """

    distances: Distances
    lags: NDArray[np.int64]

    def count(self, limit: float) -> NDArray[np.float64]:
        """Return the number of pairs, of pairs nearer than ``limit``, and of pairs at lags at which windows return.

        At a lag where k of n pairs are near, max(2 k - n, 0) return: none if half of the pairs are near, all if all
        are. Lags with fewer than :data:`_LEAST_PAIRS` pairs are ignored.
        """
        pairs, parts = np.bincount(self.lags), len(self.distances) // max(len(self.lags), 1)
        part, pair = np.divmod(np.flatnonzero(self.distances <= limit), max(len(self.lags), 1))
        near = np.bincount(part * len(pairs) + self.lags[pair], minlength=parts * len(pairs))
        returning = np.maximum(2 * near.reshape(parts, len(pairs)) - pairs, 0)[:, pairs >= _LEAST_PAIRS]
        return np.array([len(self.distances), near.sum(), returning.sum()], np.float64)


@dataclass(frozen=True)
class Share:
    """Share of pairs of windows that are twins.

    Parameters
    ----------
    all
        Share of all pairs.
    by_lag
        Square root of the share of pairs that return, see :meth:`Pairs.count`: 0 if twins are spread over all lags, 1
        if all pairs are twins.
    """

    all: float
    by_lag: float

    @classmethod
    def of(cls, pairs: list[Pairs], limit: float) -> Share:
        """Return the shares of pairs, of one or several images, that are nearer than ``limit``."""
        count, near, returning = np.sum([one.count(limit) for one in pairs], 0)
        return cls(float(near / count), float(np.sqrt(returning / count)))


@dataclass(frozen=True)
class Twins:
    """Twins among windows of one width.

    Parameters
    ----------
    size
        Width of the windows in tiles.
    own, natural
        Share of twins in the output, and in fresh draws.
    sources
        Number of places of the sample from which a copier can choose.
    """

    size: float
    own: Share
    natural: Share
    sources: float

    @property
    def score(self) -> float:
        """Excess of twins: 0 as in fresh draws, 1 if each window is a random choice among the sources.

        This is the larger of the excess among all pairs and the excess by lag. A crop of the sample that is repeated in
        rows and columns has fewer twins than a random choice, because it uses every source equally often. But its twins
        are at few lags, at which all windows return; for M sources its excess by lag is about the square root of M.
        """
        strewn = self._excess(self.own.all, self.natural.all)
        returning = self._excess(self.own.by_lag, self.natural.by_lag)
        return max(strewn, returning) if returning > 0 else strewn

    def _excess(self, own: float, natural: float) -> float:
        natural = min(natural, 0.5)
        return (own - natural) * self.sources / (1 - natural)


def find_twins(
    output: TileSet, fresh: tuple[TileSet, ...], weights: NDArray[np.float32], sources: list[float], scale: float
) -> list[Twins]:
    """Return the twins among windows of each of :data:`SIZES` of which there are pairs.

    For n tiles, at most 500, this computes O(n^2) products of tiles.

    Parameters
    ----------
    output, fresh
        Tiles of the output, and of its references.
    weights
        ``(V, U)``: weight of each sample of a tile.
    sources
        For each size, the number of places from which a copier can choose.
    scale
        Energy of the output's departures over the references'. If the output varies less, pairs are nearer without
        being copies. Distances are therefore relative to the scale, down to 0.25. Below that all tiles look alike and
        are twins.
    """
    relative = float(np.clip(scale, _LEAST_SCALE, 1))
    own, others = find_pairs(output, weights), [find_pairs(tiles, weights) for tiles in fresh]
    twins = []
    for i, size in enumerate(SIZES):
        usual = np.concatenate([other[i].distances for other in others])
        if len(own[i].distances) and len(usual):
            limit = float(np.quantile(usual, _OF_COPIER / sources[i], overwrite_input=True))
            near, chance = Share.of([own[i]], limit * relative), Share.of([other[i] for other in others], limit)
            twins.append(Twins(size, near, chance, sources[i]))
    return twins


def find_pairs(tiles: TileSet, weights: NDArray[np.float32]) -> tuple[Pairs, Pairs, Pairs]:
    """Return the pairs of windows half a tile, one tile and two tiles wide; of the widest, those without common tiles.

    Tiles must have different numbers.
    """
    tiles = tiles.take_central(_MOST_TILES)
    shares = quarters((weights / weights.sum())[np.newaxis, ..., np.newaxis])
    pairs = len(tiles) * (len(tiles) - 1) // 2
    halves, whole = np.empty((len(shares), pairs), np.float32), np.zeros(pairs, np.float32)
    for part, share, half in zip(quarters(tiles.tiles), shares, halves, strict=True):
        rows = _weighted_rows(part - part.mean(0), share[0, ..., 0])
        add_distances(rows @ rows.T, (rows**2).sum(1), share.sum(), half, whole)
    lags, blocks = index_lags(tiles.numbers), tiles.neighbors()
    wide = pair_blocks(whole, blocks, tiles.numbers[blocks[:, 0]], len(tiles))
    return Pairs(halves.ravel(), lags), Pairs(whole, lags), Pairs(*wide)


def _squares(one: Values, other: Values, share: NDArray[np.float32]) -> Distances:
    """Return the weighted squared differences, mean over channels, between two sets of windows, ``(n, m)``."""
    middle = other.mean(0)
    a, b = (_weighted_rows(windows - middle, share) for windows in (one, other))
    powers = (a**2).sum(1)[:, np.newaxis] + (b**2).sum(1)
    return np.asarray(np.maximum(powers - 2 * (a @ b.T), 0), np.float32)


def _weighted_rows(windows: Values, share: NDArray[np.float32]) -> Values:
    """Return windows as rows, so that squared differences of rows are weighted, and means over channels."""
    root = np.repeat(np.sqrt(share / windows.shape[-1]).ravel(), windows.shape[-1])
    return np.asarray(windows.reshape(len(windows), -1) * root)


def copied_share(tiles: ComparedTiles) -> float | None:
    """Return the share of the output's windows of half a tile that are copies, in excess of that of fresh draws.

    It is None if the sample holds no windows to compare with.
    """
    own = _nearest_in_sample(tiles.output, tiles)
    usual = np.concatenate([_nearest_in_sample(some, tiles, inside=not tiles.model) for some in tiles.reference])
    if not len(own) or not len(usual):
        return None
    limit = float(np.quantile(usual, _BY_CHANCE))
    share, natural = float((own <= limit).mean()), float((usual <= limit).mean())
    return (share - natural) / (1 - natural)


def _nearest_in_sample(some: TileSet, tiles: ComparedTiles, inside: bool = False) -> NDArray[np.float64]:
    """Return the distance of each quarter of each tile to the nearest window of the sample, ``(k,)``.

    The squared difference is divided by the departures of both from the mean tile, so it is 0 for a copy and about 1
    for an independent window, and weak departures do not count as copies. If ``inside`` is True, the tiles are
    those of the sample, and each window is not compared with itself.
    """
    parts = zip(
        quarters(some.tiles[:: -(-len(some) // _MOST_COPIES) or 1]),
        tiles.windows,
        quarters(tiles.mean[np.newaxis]),
        quarters(tiles.weights[np.newaxis, ..., np.newaxis])[:, 0, ..., 0],
        strict=True,
    )
    nearest = []
    for part, windows, mean, weight in parts:
        if len(windows) > inside:
            squares = _squares(part, windows, weight).astype(np.float64)
            own, other = _squares(part, mean, weight), _squares(windows, mean, weight)
            ratios = squares / np.maximum(own + other.T, 1e-9)
            nearest.append((np.where(squares < 1e-6 * weight.sum(), np.inf, ratios) if inside else ratios).min(1))
    return np.concatenate(nearest) if nearest else np.zeros(0)


def count_sources(sample: Image, lattice: Lattice, size: float = 0.5) -> float:
    """Return the number of places, equal modulo the lattice, where the sample holds a window of ``size`` tiles.

    It is at least 1.
    """
    room = np.maximum(np.array(sample.shape[1::-1]) - tile_box(lattice) * size, 1)
    return max(float(room.prod()) / lattice.area, 1.0)
