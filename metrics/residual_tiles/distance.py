"""Compute how far the tiles of an output are from those of fresh draws, including the texture inside the tiles."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import scipy
from numpy.typing import NDArray
from scipy import ndimage

from nrbench.imaging.convert import mean_channels
from nrbench.imaging.mean_tile import Values

from .tiles import TileSet, part_starts

Rows = NDArray[np.float32]
"""Features of tiles, one row for each tile."""
_MOST_TILES = 160
"""Tiles of each image between which distances are computed; of more tiles, evenly spaced ones."""
_PARTS = 4
"""Parts of a tile, along each side, whose mean departures are compared."""
_BANDS = (1.0, 2.0, 4.0)
"""Standard deviations, in samples, of the Gaussians between which the bands of detail lie."""
_ROUNDING = (1 / 255) ** 2 / 12
"""Variance that rounding to 8 bits adds."""
_ENERGY_STEP, _CONTRAST_STEP = 0.4, 0.1
"""Steps that an eye hardly notices: the energy of a band of detail changes by half, the contrast of a tile by a tenth.
They are added, as standard deviations, to the variation of fresh draws."""
_SHARE_OF_VARIANCE = 0.02
"""Share of the mean variance that is added to the variance of every direction of the part means."""
_LEAST_VARIANCE = (1 / 255) ** 2
_ALARMS, _FREEDOM = 0.003, 4
"""Probability that the distance of a fresh draw exceeds the tolerance, and number of independent squares whose sum the
statistic is in the worst case: there are four features of detail, and tiles of one thread vary together."""


@dataclass(frozen=True)
class Distance:
    """Distance between the tiles of an output and those of fresh draws.

    Parameters
    ----------
    value
        The energy distance, less its mean between one fresh draw and the others.
    usual
        What chance alone contributes to the energy distance, mean over fresh draws: positive.
    """

    value: float
    usual: float

    @property
    def tolerance(self) -> float:
        """The value that a fresh draw exceeds with a probability of 0.003.

        Without a difference of distributions the energy distance is a weighted sum of squares of nearly normal
        numbers (Szekely and Rizzo, 2013). Its mean is known from fresh draws. Its upper limit is that of as few squares
        as there can be: the fewer, the wider they scatter.
        """
        return float(scipy.stats.chi2.isf(_ALARMS, _FREEDOM) / _FREEDOM - 1) * self.usual

    @property
    def excess(self) -> float:
        """The value beyond chance, in [0, 1]: 0 up to the tolerance, the whole value from twice the tolerance on."""
        share = (self.value - self.tolerance) / max(self.tolerance, 1e-9)
        return float(np.clip(self.value, 0, 1) * np.clip(share, 0, 1))


def measure_distances(
    output: TileSet, fresh: Sequence[TileSet], weights: NDArray[np.float32], mean: Values
) -> dict[str, Distance]:
    """Return the energy distance between the tiles of an output and those of fresh draws, by group of features.

    Each tile is described twice. *parts*: the mean departures of its 4 x 4 parts from the mean tile of its own image,
    which describe colors and their arrangement. *detail*: the logarithms of the energy of its departures in three bands
    of detail, and its contrast, which is the regression coefficient of the tile on the mean tile of the fresh draws.
    Noise in place of the texture inside tiles, blur and a loss of contrast change *detail*.

    Features are whitened by their covariance over the tiles of fresh draws, plus what an eye hardly notices. The result
    is the normalized energy distance ``(2 E|X - Y| - E|X - X'| - E|Y - Y'|) / 2 E|X - Y|`` (Szekely and Rizzo, Energy
    statistics, 2013) between tiles X of the output and Y of fresh draws, less its mean between one fresh draw and the
    others. It is 0 if the distributions are equal, and 1 if each is concentrated in one place and these differ. A shift
    of all tiles by one standard deviation of one feature gives about 0.2 if it is the only feature, by two 0.45, by
    four 0.7. Computes O(n^2) distances for at most 160 tiles of each image.

    Parameters
    ----------
    output, fresh
        Tiles on one grid: at least two of each image, and at least two fresh sets.
    weights
        ``(V, U)``: weight of each sample of a tile.
    mean
        ``(V, U, C)``: the mean tile of the fresh draws.

    Returns
    -------
    dict
        ``parts`` and ``detail``; each value may be slightly negative.
    """
    sets = [output, *fresh]
    parts = [_part_means(tiles, weights) for tiles in sets]
    detail = [_detail(tiles, weights, mean) for tiles in sets]
    steps = np.array([_ENERGY_STEP] * len(_BANDS) + [_CONTRAST_STEP])
    variance = np.concatenate(detail[1:]).var(0, dtype=np.float64) + steps**2
    return {
        "parts": compare_sets(_whitened(parts)),
        "detail": compare_sets([np.asarray(rows / np.sqrt(variance), np.float32) for rows in detail]),
    }


def _part_means(tiles: TileSet, weights: NDArray[np.float32]) -> Rows:
    """Return the weighted mean departures of 4 x 4 parts of each tile."""
    few = _thin(tiles.departures)
    rows, columns = (part_starts(side, _PARTS) for side in weights.shape)
    weighted = few * np.repeat(weights[..., np.newaxis], few.shape[-1], -1)
    sums = np.add.reduceat(np.add.reduceat(weighted, rows, 1), columns, 2)
    masses = np.add.reduceat(np.add.reduceat(weights, rows, 0), columns, 1)
    return np.asarray((sums / masses[..., np.newaxis]).reshape(len(few), -1), np.float32)


def _detail(tiles: TileSet, weights: NDArray[np.float32], mean: Values) -> Rows:
    """Return for each tile the log energies of its departures in the bands of detail, and its contrast."""
    coarser, shares = np.ascontiguousarray(np.moveaxis(_thin(tiles.departures), -1, 1)), weights / weights.sum()
    features = []
    for deviation in _BANDS:
        finer = coarser
        coarser = _blur(finer, deviation)
        energy = np.tensordot(mean_channels(np.moveaxis((finer - coarser) ** 2, 1, -1)), shares, 2)
        features.append(np.log(energy + _ROUNDING))
    pattern = mean - mean.mean((0, 1))
    contrast = np.tensordot(_thin(tiles.tiles), pattern, 3) / max(float((pattern**2).sum()), 1e-9)
    return np.asarray(np.stack([*features, contrast], 1), np.float32)


def _blur(planes: Values, deviation: float) -> Values:
    """Return the planes ``(n, C, V, U)`` of tiles under a Gaussian; beyond the border of a tile its border is repeated.

    The sides are short, so that matrix products take a fraction of the time of :mod:`scipy.ndimage`. Rounding to
    float32 after each side gives the values of scipy.
    """
    down, along = (
        ndimage.gaussian_filter1d(np.eye(side), deviation, 0, mode="nearest", truncate=3.0) for side in planes.shape[2:]
    )
    rows = (down @ planes.astype(np.float64)).astype(np.float32)
    return np.asarray(
        (rows.reshape(-1, len(along)).astype(np.float64) @ along.T).astype(np.float32).reshape(rows.shape)
    )


def _thin(tiles: Values) -> Values:
    if len(tiles) <= _MOST_TILES:
        return tiles
    return tiles[np.linspace(0, len(tiles) - 1, _MOST_TILES).round().astype(np.intp)]


def _whitened(sets: list[Rows]) -> list[Rows]:
    """Whiten features by the covariance of all sets but the first."""
    covariance = np.atleast_2d(np.cov(np.concatenate(sets[1:]).T.astype(np.float64)))
    floor = _SHARE_OF_VARIANCE * float(np.trace(covariance)) / len(covariance) + _LEAST_VARIANCE
    values, vectors = np.linalg.eigh(covariance + floor * np.eye(len(covariance)))
    whitening = np.asarray(vectors / np.sqrt(values), np.float32)
    return [rows @ whitening for rows in sets]


def compare_sets(sets: list[Rows]) -> Distance:
    """Return the energy distance of the first set to all others, less the mean of that of each of these to the rest."""
    start = np.cumsum([0, *(len(rows) for rows in sets)])
    rows = np.concatenate(sets)
    lengths = _lengths(rows - rows[start[1] :].mean(0, dtype=np.float64).astype(np.float32))
    sums = np.add.reduceat(np.add.reduceat(lengths, start[:-1], 0, np.float64), start[:-1], 1)
    counts = np.array([len(rows) for rows in sets], np.float64)

    def distance(one: int, others: list[int]) -> tuple[float, float]:
        # E|Y - Y'| is over pairs within each of the other sets, because each is a draw. The second number is what the
        # distance of two draws of one distribution has on average if it is taken with the pairs of a tile with itself.
        between = float((sums[one, others] / counts[others]).mean() / counts[one])
        own = float(sums[one, one] / (counts[one] * (counts[one] - 1)))
        theirs = float((sums[others, others] / (counts[others] * (counts[others] - 1))).mean())
        chance = own / counts[one] + theirs / counts[others].sum()
        return (2 * between - own - theirs) / max(2 * between, 1e-12), chance / max(2 * between, 1e-12)

    fresh = list(range(1, len(sets)))
    value, chance = distance(0, fresh)
    usual = float(np.mean([distance(k, [j for j in fresh if j != k])[0] for k in fresh]))
    return Distance(value - usual, max(usual + chance, 0.0))


def _lengths(rows: Rows) -> NDArray[np.float32]:
    """Return the distances between all rows, in place: scipy's cdist computes in double precision.

    The rows are centered, so that squares of large features do not cancel.
    """
    powers = (rows**2).sum(1)
    squares = rows @ rows.T
    squares *= -2
    squares += powers
    squares += powers[:, np.newaxis]
    np.fill_diagonal(squares, 0)
    return np.asarray(np.sqrt(np.maximum(squares, 0, out=squares), out=squares))
