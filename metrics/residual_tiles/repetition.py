"""Near-exact twins: windows of the output that are there twice, and those that are in the sample."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from nrbench.imaging.convert import Image
from nrbench.imaging.fold import Values
from nrbench.lattice.geometry import Lattice

from ..ncc.periodic import tile_box
from .tileset import TileSet, quarters

Distances = NDArray[np.float32]
MOST_TILES = 1200
"""Pairs of more tiles than this are not compared: the tiles in the middle stand for all."""
SIZES = (0.5, 1.0, 2.0)
"""Widths of the windows that are compared, in tiles."""
_OF_COPIER = 0.1
"""Near-exact: so near that pairs of fresh draws are a tenth as often as the copier's twins would be."""
_LEAST_PAIRS = 6
"""Of fewer pairs at one lag half are twins by chance."""
_BY_CHANCE = 0.02
"""Near-exact in the sample: nearer than all but this share of a fresh draw's windows."""
_LEAST_SCALE = 0.25
"""Departures are measured against the output's own energy, down to this share of the fresh draws'."""


@dataclass(frozen=True)
class Pairs:
    """Pairs of windows of one width.

    Parameters
    ----------
    distances
        ``(p,)``: weighted mean squared difference of each pair.
    lags
        ``(p,)``: numbers that tell by how many cells, and in which direction, the two lie apart; windows in
        different quarters of the cell have numbers of their own.
    """

    distances: Distances
    lags: NDArray[np.intp]

    def counts(self, limit: float) -> NDArray[np.float64]:
        """Return how many pairs there are, how many are nearer than ``limit``, and how many lie where windows return.

        At a lag with k of n pairs near, ``2 k / n - 1`` of them do, if that is more than none: from no pair where half
        of the windows return to all where all do. Lags of fewer than :data:`_LEAST_PAIRS` pairs are left out.
        """
        pairs = np.bincount(self.lags)
        near = np.bincount(self.lags[self.distances <= limit], minlength=len(pairs))
        returning = np.maximum(2 * near - pairs, 0)[pairs >= _LEAST_PAIRS]
        return np.array([pairs.sum(), near.sum(), returning.sum()], np.float64)


@dataclass(frozen=True)
class Share:
    """Share of pairs of windows that are near-exact twins.

    Parameters
    ----------
    all
        Of all pairs.
    by_lag
        Root of the share of pairs at lags at which windows return, see :meth:`Pairs.counts`: 0 where twins are strewn
        over all lags, and 1 where all pairs are twins.
    """

    all: float
    by_lag: float

    @classmethod
    def of(cls, pairs: list[Pairs], limit: float) -> Share:
        """Return the shares of pairs, of one or several images, that are nearer than ``limit``."""
        count, near, returning = np.sum([one.counts(limit) for one in pairs], 0)
        return cls(float(near / count), float(np.sqrt(returning / count)))


@dataclass(frozen=True)
class Twins:
    """Near-exact twins among pairs of windows, beside what chance and copying would give.

    Parameters
    ----------
    size
        Width of the windows in tiles.
    own, natural
        Among pairs of the output, and of fresh draws.
    sources
        Among how many places of the sample a copier can choose.
    """

    size: float
    own: Share
    natural: Share
    sources: float

    @property
    def score(self) -> float:
        """0 as in fresh draws, 1 where each window is drawn at random from the sources: one pair in them is a twin.

        Of all pairs or by lag, whichever is more. A crop of the sample that is repeated in rows and columns has no more
        twins than a copier that chooses at random - fewer, since it uses every source equally often - but at few lags,
        and there all windows are: of one pair in M at the root of M.
        """
        strewn = self._excess(self.own.all, self.natural.all)
        returning = self._excess(self.own.by_lag, self.natural.by_lag)
        return max(strewn, returning) if returning > 0 else strewn

    def _excess(self, own: float, natural: float) -> float:
        natural = min(natural, 0.5)
        return (own - natural) * self.sources / (1 - natural)


def twins(
    output: TileSet, fresh: tuple[TileSet, ...], weights: NDArray[np.float32], sources: list[float], scale: float
) -> list[Twins]:
    """Return the twins for windows of each of :data:`SIZES`; sizes of which there are no pairs are left out.

    O(n^2) products of tiles for n of them, at most 1200.

    Parameters
    ----------
    output, fresh
        The output's tiles and those of its references.
    weights
        ``(V, U)``.
    sources
        For each size, among how many places a copier can choose.
    scale
        Energy of the output's departures over the references'. Where the output varies less, pairs are nearer without
        being copies, so distances are taken relative to it, down to 0.25: below that all tiles look alike, and are
        twins.
    """
    relative = float(np.clip(scale, _LEAST_SCALE, 1))
    own, others = window_pairs(output, weights), [window_pairs(tiles, weights) for tiles in fresh]
    found = []
    for i, size in enumerate(SIZES):
        right = np.concatenate([other[i].distances for other in others])
        if len(own[i].distances) and len(right):
            limit = float(np.quantile(right, _OF_COPIER / sources[i]))
            near, chance = Share.of([own[i]], limit * relative), Share.of([other[i] for other in others], limit)
            found.append(Twins(size, near, chance, sources[i]))
    return found


def window_pairs(tiles: TileSet, weights: NDArray[np.float32]) -> tuple[Pairs, Pairs, Pairs]:
    """Return the pairs of windows half a tile, one and two tiles wide."""
    tiles = tiles.middle(MOST_TILES)
    shares = weights / weights.sum()
    parts = zip(quarters(tiles.tiles), quarters(shares[np.newaxis, ..., np.newaxis])[..., 0], strict=True)
    distances = np.stack([_squares(part, part, share[0]) for part, share in parts])
    whole = distances.sum(0)
    masses = quarters(shares[np.newaxis, ..., np.newaxis]).sum((1, 2, 3, 4))
    upper = np.triu_indices(len(tiles), 1)
    lags = _lags(tiles.numbers, *upper)
    count = int(lags.max(initial=0)) + 1
    halves = np.concatenate([one[upper] / mass for one, mass in zip(distances, masses, strict=True)])
    quartered = np.concatenate([lags + count * k for k in range(len(masses))])
    return Pairs(halves, quartered), Pairs(whole[upper], lags), _wide(whole, tiles)


def _wide(whole: Distances, tiles: TileSet) -> Pairs:
    """Return the pairs of windows of four tiles that share none of them: the mean of these tiles' distances."""
    neighbors = tiles.neighbors()
    i, j = np.triu_indices(len(neighbors), 1)
    shared = (neighbors[i][:, :, np.newaxis] == neighbors[j][:, np.newaxis]).any((1, 2))
    i, j = i[~shared], j[~shared]
    mean = np.mean([whole[neighbors[i, k], neighbors[j, k]] for k in range(4)], 0, np.float32)
    return Pairs(np.asarray(mean, np.float32), _lags(tiles.numbers, neighbors[i, 0], neighbors[j, 0]))


def _lags(numbers: NDArray[np.int64], i: NDArray[np.intp], j: NDArray[np.intp]) -> NDArray[np.intp]:
    """Return a number for the lag between tiles i and j, the same from j to i."""
    u, v = (numbers[j] - numbers[i]).T
    back = (u < 0) | ((u == 0) & (v < 0))
    u, v = np.where(back, -u, u), np.where(back, -v, v)
    reach = int(np.abs(v).max(initial=0))
    return np.asarray(u * (2 * reach + 1) + v + reach, np.intp)


def _squares(one: Values, other: Values, share: NDArray[np.float32]) -> Distances:
    """Return the weighted squared differences, mean over channels, of two sets of windows, ``(n, m)``."""
    root = np.sqrt(share / one.shape[-1])[..., np.newaxis]
    middle = other.mean(0)
    a, b = (((windows - middle) * root).reshape(len(windows), -1) for windows in (one, other))
    powers = (a**2).sum(1)[:, np.newaxis] + (b**2).sum(1)
    return np.asarray(np.maximum(powers - 2 * (a @ b.T), 0), np.float32)


@dataclass(frozen=True)
class Library:
    """The sample's windows of half a tile, among which the output's are looked for.

    Parameters
    ----------
    windows
        For each quarter of the cell, ``(m, V / 2, U / 2, C)``.
    mean
        Mean tile of the texture.
    weights
        ``(V, U)``.
    """

    windows: tuple[Values, ...]
    mean: Values
    weights: NDArray[np.float32]

    def nearest(self, tiles: TileSet, inside: bool = False) -> NDArray[np.float64]:
        """Return how near the nearest window of the sample comes to each quarter of each tile, ``(k,)``.

        The squared difference over what both depart from the mean tile: 0 for a copy, about 1 for a stranger. That
        makes it blind to how strong departures are, so weak ones are not taken for copies.

        Parameters
        ----------
        tiles
            Whose quarters.
        inside
            They are the sample's own: windows that are the same place do not count.
        """
        own, mean, share = (
            quarters(tiles.tiles),
            *(quarters(x[np.newaxis]) for x in (self.mean, self.weights[..., None])),
        )
        found = [
            self._ratios(part, window, middle[0], weight[0, ..., 0], inside).min(1)
            for part, window, middle, weight in zip(own, self.windows, mean, share, strict=True)
            if len(window) > inside
        ]
        return np.concatenate(found) if found else np.zeros(0)

    def copied(self, output: TileSet, reference: tuple[TileSet, ...], inside: bool) -> tuple[float, float] | None:
        """Return the share of the output's windows that are in the sample, and of fresh draws'; None: no windows."""
        own, others = self.nearest(output), [self.nearest(tiles, inside) for tiles in reference]
        right = np.concatenate(others)
        if not len(own) or not len(right):
            return None
        limit = float(np.quantile(right, _BY_CHANCE))
        return float((own <= limit).mean()), float((right <= limit).mean())

    def _ratios(
        self, part: Values, windows: Values, mean: Values, weight: NDArray[np.float32], inside: bool
    ) -> NDArray[np.float64]:
        squares = _squares(part, windows, weight).astype(np.float64)
        own, other = (_squares(some, mean[np.newaxis], weight) for some in (part, windows))
        ratios = squares / np.maximum(own + other.T, 1e-9)
        return np.where(squares < 1e-6 * weight.sum(), np.inf, ratios) if inside else ratios


def sources(sample: Image, lattice: Lattice, size: float = 0.5) -> float:
    """Return how many places of the sample that the lattice calls equal hold a window of ``size`` tiles, at least 1."""
    room = np.maximum(np.array(sample.shape[1::-1]) - tile_box(lattice) * size, 1)
    return max(float(room.prod()) / lattice.area, 1.0)
