"""Near-exact twins: windows of the output that are there twice, and those that are in the sample."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from nrbench.imaging.door import Image
from nrbench.imaging.fold import Values
from nrbench.lattice.geometry import Lattice

from .periodic import tile_box
from .tileset import TileSet, quarters

Distances = NDArray[np.float32]
MOST_TILES = 1200
"""Pairs of more tiles than this are not compared: the tiles in the middle stand for all."""
SIZES = (0.5, 1.0, 2.0)
"""Widths of the windows that are compared, in tiles."""
_OF_COPIER = 0.1
"""Near-exact: so near that pairs of fresh draws are a tenth as often as the copier's twins would be."""
_BY_CHANCE = 0.02
"""Near-exact in the sample: nearer than all but this share of a fresh draw's windows."""
_LEAST_SCALE = 0.25
"""Departures are measured against the output's own energy, down to this share of the fresh draws'."""


@dataclass(frozen=True)
class Twins:
    """Share of pairs of windows that are near-exact twins, beside what chance and copying would give.

    Parameters
    ----------
    size
        Width of the windows in tiles.
    share, natural
        Among pairs of the output, and of fresh draws.
    sources
        Among how many places of the sample a copier can choose.
    """

    size: float
    share: float
    natural: float
    sources: float

    @property
    def score(self) -> float:
        """0 as in fresh draws, 1 where each window is drawn at random from the sources: one pair in them is a twin."""
        return (self.share - self.natural) * self.sources / (1 - self.natural)


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
    own, others = pair_distances(output, weights), [pair_distances(tiles, weights) for tiles in fresh]
    found = []
    for i, size in enumerate(SIZES):
        right = np.concatenate([other[i] for other in others])
        if len(own[i]) and len(right):
            limit = float(np.quantile(right, _OF_COPIER / sources[i]))
            near, chance = float((own[i] <= limit * relative).mean()), float((right <= limit).mean())
            found.append(Twins(size, near, min(chance, 0.5), sources[i]))
    return found


def pair_distances(tiles: TileSet, weights: NDArray[np.float32]) -> tuple[Distances, Distances, Distances]:
    """Return the weighted mean squared difference of each pair of windows half a tile, one and two tiles wide."""
    tiles = tiles.middle(MOST_TILES)
    shares = weights / weights.sum()
    parts = zip(quarters(tiles.tiles), quarters(shares[np.newaxis, ..., np.newaxis])[..., 0], strict=True)
    distances = np.stack([_squares(part, part, share[0]) for part, share in parts])
    whole = distances.sum(0)
    masses = quarters(shares[np.newaxis, ..., np.newaxis]).sum((1, 2, 3, 4))
    upper = np.triu_indices(len(tiles), 1)
    halves = np.concatenate([one[upper] / mass for one, mass in zip(distances, masses, strict=True)])
    return halves, whole[upper], _wide(whole, tiles.neighbors())


def _wide(whole: Distances, neighbors: NDArray[np.intp]) -> Distances:
    """Return the mean of four tiles' distances, for pairs of windows that share no tile."""
    i, j = np.triu_indices(len(neighbors), 1)
    mean = sum(whole[neighbors[i, k], neighbors[j, k]] for k in range(4)) / np.float32(4)
    shared = (neighbors[i][:, :, np.newaxis] == neighbors[j][:, np.newaxis]).any((1, 2))
    return np.asarray(mean)[~shared] if len(i) else np.zeros(0, np.float32)


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
