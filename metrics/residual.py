"""What is left of an image when its mean tile is taken out: the tile-by-tile departures."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from nrbench.imaging.fold import Values, cut_tiles
from nrbench.lattice.geometry import Lattice, Points

from .judgement import Look
from .periodic import TOLERANCE

_ALIGNMENT = 0.4
"""Pixels by which an aligned tile may still be off: what edges then differ by is not held against it."""
_LEAST_NOISE = 0.03
_BLOCKS = 2
MOST_TILES = 1500


@dataclass(frozen=True)
class Residual:
    """The tiles of an image, less their mean.

    Parameters
    ----------
    lattice
        Reduced.
    mean
        ``(V, U, C)``: the image's own mean tile.
    departures
        ``(n, V, U, C)``: each tile less the mean.
    """

    lattice: Lattice
    mean: Values
    departures: Values

    @classmethod
    def of(cls, look: Look, noise: Points, rng: np.random.Generator, grid: tuple[int, int] | None = None) -> Residual:
        """Cut the tiles where they were found, so that a small misplacement does not count as variation.

        Parameters
        ----------
        look
            The image.
        noise
            Covariance in px^2 of the places at which tiles are found that are where they should be.
        rng
            Chooses the tiles where there are more than 1500.
        grid
            Samples (V, U) of a tile; None: what the image's own lattice needs. Images that are compared share one.
        """
        middles = found_middles(look, noise)
        if len(middles) > MOST_TILES:
            middles = middles[np.sort(rng.choice(len(middles), MOST_TILES, replace=False))]
        cut, _ = cut_tiles(look.image, look.tiles.lattice, middles, grid)
        mean = cut.mean(0) if len(cut) else np.zeros(cut.shape[1:], np.float32)
        return cls(look.tiles.lattice, mean, cut - mean)

    def energy(self, weights: Values) -> float:
        """Return the weighted mean of the squared departures; a mean of n tiles takes 1/n of them."""
        return _pooled([self], weights)

    def distances(self, weights: Values) -> NDArray[np.float64]:
        """Return the weighted mean squared difference of each pair of tiles, in each quarter of the cell, ``(m,)``."""
        rows, columns = (np.array_split(np.arange(side), _BLOCKS) for side in weights.shape)
        quarters = [(row[:, np.newaxis], column) for row in rows for column in columns]
        return np.concatenate(
            [_pairs(self.departures[:, row, column], weights[row, column]) for row, column in quarters]
        )


def found_middles(look: Look, noise: Points) -> Points:
    """Return the middles (x, y) px of the whole tiles where they were found, ``(n, 2)``.

    A tile's place is that of the window around it, plus as much of its own offset from there as exceeds the noise of
    such offsets: Wiener's filter, with the signal's covariance as what is left of the offsets' less the noise's.
    """
    whole = look.tiles.whole
    around, own = _offsets(look)
    keep = _shrinkage(_covariance(own), noise)
    return np.asarray(look.tiles.centers[whole] + around + own @ keep.T)


def offset_noise(looks: tuple[Look, ...]) -> Points:
    """Return the covariance in px^2 of tiles' own offsets in images whose tiles are where they should be."""
    return _covariance(np.concatenate([_offsets(look)[1] for look in looks]))


def _offsets(look: Look) -> tuple[Points, Points]:
    """Return for each whole tile the offset of the window around it, where that is in place, and its own from there."""
    tiles, placement = look.tiles, look.placement
    nearest = placement.nearest(tiles.centers[tiles.whole])
    inside = placement.misplacement[nearest] <= TOLERANCE
    around = placement.offsets[nearest] * inside[:, np.newaxis]
    return around, tiles.offsets[tiles.whole] - around


def _covariance(offsets: Points) -> Points:
    return offsets.T @ offsets / max(len(offsets), 1) + _LEAST_NOISE**2 * np.eye(2)


def _shrinkage(total: Points, noise: Points) -> Points:
    """Return the matrix that keeps of an offset what exceeds the noise."""
    values, vectors = np.linalg.eigh(noise)
    root = vectors @ np.diag(np.sqrt(values)) @ vectors.T
    back = np.linalg.inv(root)
    ratio, axes = np.linalg.eigh(back @ total @ back)
    return np.asarray(root @ axes @ np.diag(np.maximum(0, 1 - 1 / ratio)) @ axes.T @ back)


def reference_energy(residuals: list[Residual], weights: Values) -> float:
    """Return the energy of the departures of several images together."""
    return _pooled(residuals, weights)


def interior_weights(residuals: list[Residual]) -> Values:
    """Return weights ``(V, U)`` that spare edges: 1 where the mean tile is flat.

    An edge that is off by the remaining misalignment differs by gradient times that; where this exceeds the departures
    themselves the pixel counts for less.
    """
    energy = _pooled(residuals, np.ones(residuals[0].mean.shape[:2], np.float32))
    mean = np.mean([residual.mean for residual in residuals], 0)
    steep = ndimage.maximum_filter(_slope(mean, residuals[0].lattice), 3, mode="wrap")
    return np.asarray(1 / (1 + steep * _ALIGNMENT**2 / max(energy, 1e-9)), np.float32)


def _pooled(residuals: list[Residual], weights: Values) -> float:
    squares = sum(float(((r.departures.astype(np.float64) ** 2).mean(-1) * weights).sum()) for r in residuals)
    freedom = sum(len(r.departures) - 1 for r in residuals)
    return squares / max(freedom, 1) / float(weights.sum())


def _slope(tile: Values, lattice: Lattice) -> Values:
    """Return the squared gradient of a tile per px, mean over channels."""
    rows, columns = tile.shape[:2]
    along = (np.roll(tile, -1, 1) - np.roll(tile, 1, 1)) * columns / 2
    across = (np.roll(tile, -1, 0) - np.roll(tile, 1, 0)) * rows / 2
    gradient = np.stack([along, across], -1) @ np.linalg.inv(lattice.matrix).T
    return np.asarray((gradient**2).sum(-1).mean(-1), np.float32)


def _pairs(departures: Values, weights: Values) -> NDArray[np.float64]:
    share = np.sqrt(weights / (weights.sum() * departures.shape[-1]))
    flat = (departures * share[..., np.newaxis]).reshape(len(departures), -1).astype(np.float64)
    gram = flat @ flat.T
    power = np.diag(gram)
    upper = np.triu_indices(len(flat), 1)
    return np.asarray(np.maximum(power[upper[0]] + power[upper[1]] - 2 * gram[upper], 0))
