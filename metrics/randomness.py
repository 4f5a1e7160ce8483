"""Randomness: whether the output varies from tile to tile as the texture does, without repeating itself."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from itertools import pairwise
from typing import Any, ClassVar

import numpy as np
from numpy.typing import NDArray

from nrbench.imaging.fold import Values
from nrbench.plugins.forms import Column, Observation, Score, Value

from .residual_tiles.repetition import SIZES, copied_share, count_sources, find_twins
from .residual_tiles.tiles import ComparedTiles, TileSet, quarters
from .verdict.examination import examine
from .verdict.verdict import Verdict

_LEAST_TILES = 4
_LEAST_VARIANCE = (2 / 255) ** 2
"""Departures weaker than two gray levels (of 8 bits) cannot be told from rounding and resampling."""
_LEAST_COLOR = (1 / 255) ** 2
"""Mean colors that vary by less than a gray level (of 8 bits) are not compared."""
_MOST_TILES = 160
"""Tiles of each image between which distances are computed; of more tiles, evenly spaced ones."""
_PARTS = 4
"""Parts of a tile, along each side, whose mean departures are compared."""
_OUTLYING = 4.5
"""A window is odd if the logarithm of its worst spot exceeds the median by this many median absolute deviations."""
_SPOTS = 3
"""Spots along each side of a window of half a tile; damage is local."""


def _ratio(meaning: str) -> Column:
    return Column(meaning, range=(0.0, math.inf), better="one")


def _excess(meaning: str) -> Column:
    return Column(meaning, range=(-math.inf, math.inf), better="lower")


@dataclass(frozen=True)
class Randomness:
    """Variation of the output's tiles about their mean, its distribution, and its repetition.

    Every whole tile of the output is cut at its displacement, to fractions of a pixel. The tiles of at least four fresh
    draws of the output's size are cut on the same grid. Effects of the size, such as threads that are longer than a
    tile or the share 1/n that a mean of n tiles takes, are then equal in both. Edges of the mean tile get less weight,
    so that displacements within the tolerance do not count as variation.

    ``variation`` is the energy of the tiles' departures from their mean over that of fresh draws; ``variation_color``
    is the same for the tiles' mean colors. ``repetition`` counts near-exact twins among pairs of windows half a tile
    and one tile wide, and takes the larger excess; ``repetition_wide`` counts those two tiles wide. The scale is 0 for
    the share of twins in fresh draws, and 1 for that of the best possible copier, which chooses at random among the M
    places of the sample that are equal modulo the lattice: one pair in M is a twin. One tile repeated has a repetition
    of about M. Twins at lags at which most windows return count for more: a crop of the sample that is repeated in rows
    and columns has few twins, but all at few lags, and a repetition of about the square root of M. ``distance`` is an
    energy distance between the departures of output and fresh draws, less that among fresh draws, so that adding noise
    does not improve it.

    For a photograph the sample replaces the fresh draws. Energies are then compared in boxes as large as the smaller of
    sample and output, each about its own mean tile. Randomness is not scored where regularity is lost.
    """

    version: ClassVar[str] = "3"
    columns: ClassVar[Mapping[str, Column]] = {
        "variation": _ratio("Tile-to-tile variation over that of fresh draws."),
        "variation_color": _ratio("Variation of the tiles' mean colors over that of fresh draws."),
        "repetition": _excess(
            "Excess of near-exact twins among windows up to a tile: 0 as in fresh draws, 1 as the best copier."
        ),
        "repetition_wide": _excess(
            "Excess of near-exact twins among windows two tiles wide: 0 as in fresh draws, 1 as the best copier."
        ),
        "copied": Column(
            "Share of windows of half a tile with a near-exact twin in the sample, beyond chance.",
            range=(-math.inf, 1.0),
        ),
        "distance": _excess(
            "Energy distance between the tiles' departures of output and fresh draws, less that among fresh draws."
        ),
        "survival": _ratio("Share of odd (damaged, missing) windows over the expected share."),
    }

    def score(self, observation: Observation) -> Score:
        """Return the scores."""
        verdict = examine(observation).verdict
        if isinstance(verdict, str):
            return Score.missing(self.columns, verdict)
        return self.score_verdict(observation, verdict)

    def score_verdict(self, observation: Observation, verdict: Verdict) -> Score:
        """Return the scores, given the verdict on regularity."""
        if verdict.lattice_doubtful:
            reason = f"not scored: the lattice may not be the sample's ({verdict.lack_of_power})"
            return Score.missing(self.columns, reason)
        if verdict.preserved is False:
            return Score.missing(self.columns, f"not scored: regularity is lost ({verdict.faults[0]})")
        tiles = ComparedTiles.of(observation, verdict)
        if tiles.fewest < _LEAST_TILES:
            return Score.missing(self.columns, f"undecided: fewer than {_LEAST_TILES} whole tiles to compare")
        energies = Energies.of(tiles)
        if min(energies.reference, float(verdict.reference.periodic.variance.values.mean())) < _LEAST_VARIANCE:
            return Score.missing(self.columns, "not applicable: the texture hardly varies from tile to tile")

        lattice, sample = verdict.reference.lattice, observation.sample
        sources = [count_sources(sample, lattice, size) for size in SIZES]
        twins = find_twins(tiles.output, tiles.reference, tiles.weights, sources, energies.ratio)
        distance, level = energy_distance(tiles.output, tiles.fresh, tiles.weights)
        elements = observation.truth.elements if observation.truth else {}
        survival, no_survival, odd_shares = survival_of_odd_windows(tiles, elements)
        values: dict[str, Value] = {
            "variation": energies.ratio,
            "variation_color": energies.color_ratio,
            "repetition": max((one.score for one in twins if one.size < 2), default=None),
            "repetition_wide": next((one.score for one in twins if one.size == 2), None),
            "copied": copied_share(tiles),
            "distance": distance - level,
            "survival": survival,
        }
        reasons = {
            "variation_color": "not applicable: the tiles' mean colors hardly vary",
            "repetition": "undecided: no pairs of windows to compare",
            "repetition_wide": "undecided: no two windows of two tiles side by side in output and reference",
            "copied": "undecided: the sample holds too few windows of half a tile",
            "survival": no_survival,
        }
        records: dict[str, Any] = {
            "level_of_distance": level,
            **odd_shares,
            "reference": "fresh draws" if tiles.model else "sample",
            "tiles": len(tiles.output),
            "sources": twins[0].sources if twins else None,
            "twins": {f"{one.size:g}": one.own.all for one in twins},
            "twins_by_lag": {f"{one.size:g}": one.own.by_lag for one in twins},
            "twins_of_reference": {f"{one.size:g}": one.natural.all for one in twins},
            "deviation": {name: float(np.sqrt(getattr(energies, name))) for name in ("output", "reference", "sample")},
        }
        return Score(values, {name: reasons[name] for name, value in values.items() if value is None}, records=records)


@dataclass(frozen=True)
class Energies:
    """Mean squared departures of tiles.

    Parameters
    ----------
    output, reference, sample
        Of all pixels.
    color, reference_color
        Of the tiles' mean colors, in output and reference.
    """

    output: float
    reference: float
    sample: float
    color: float
    reference_color: float

    @classmethod
    def of(cls, tiles: ComparedTiles) -> Energies:
        """Return the energies over boxes of the extent that output and reference have in common.

        In each box the mean tile of the box is subtracted: n tiles leave n - 1 degrees of freedom. If elements are
        longer than a tile more energy is lost, and more in a smaller box, so the boxes must be equal.
        """
        output, color = _pooled_energy(tiles.blocks[0], tiles.weights)
        reference, reference_color = _pooled_energy(tiles.blocks[1], tiles.weights)
        return cls(output, reference, _pooled_energy([tiles.sample], tiles.weights)[0], color, reference_color)

    @property
    def ratio(self) -> float:
        """Energy of the output over that of the reference."""
        return self.output / max(self.reference, 1e-12)

    @property
    def color_ratio(self) -> float | None:
        """The same for the mean colors; None if they hardly vary."""
        return None if self.reference_color < _LEAST_COLOR else self.color / self.reference_color


def _pooled_energy(sets: Iterable[TileSet], weights: NDArray[np.float32]) -> tuple[float, float]:
    """Return the weighted mean squared departure of pixels, and that of the tiles' mean colors."""
    shares, total, color, freedom = weights / weights.sum(), 0.0, 0.0, 0
    for tiles in sets:
        if len(tiles) > 1:
            left = tiles.departures
            means = np.tensordot(left, shares, ([1, 2], [0, 1]))
            total += (len(tiles) - 1) * float(np.tensordot((left**2).mean(-1), shares, 2).mean(dtype=np.float64))
            color += (len(tiles) - 1) * float((means**2).mean(dtype=np.float64))
            freedom += len(tiles) - 1
    return total / max(freedom, 1), color / max(freedom, 1)


def energy_distance(output: TileSet, fresh: tuple[TileSet, ...], weights: NDArray[np.float32]) -> tuple[float, float]:
    """Return the energy distance between the departures of output and fresh draws, and that among fresh draws.

    ``2 E|X - Y| - E|X - X'| - E|Y - Y'|`` (Szekely and Rizzo, Energy statistics, 2013) over ``E|Y - Y'|``. It is 0 if
    both have the same distribution; the estimate can be negative, since X and X' are different tiles. Departures are
    those from each image's own mean tile. The distance is the mean of two: one between all samples of the tiles, and
    one between the means of 4 x 4 parts of the tiles. In the many dimensions of all samples the first hardly depends on
    anything but the strength of departures, which noise can mimic. The level of fresh draws, each against all others,
    is the expected distance of an output without defects. Computes O(n^2) products for at most 160 tiles of each image.

    Parameters
    ----------
    output, fresh
        Tiles on one grid: at least two of each image, and at least two fresh sets.
    weights
        ``(V, U)``: weight of each sample of a tile.
    """
    both = [_compare_sets([rows(tiles, weights) for tiles in (output, *fresh)]) for rows in (_samples, _part_means)]
    own, level = np.mean(both, 0)
    return float(own), float(level)


def _compare_sets(sets: list[NDArray[np.float32]]) -> tuple[float, float]:
    """Return the energy distance of the first set to all others, and the mean one of each of these to the rest."""
    start = np.cumsum([0, *(len(part) for part in sets)])
    lengths = _lengths(np.concatenate(sets))
    spans = [slice(a, b) for a, b in pairwise(start)]
    sums = np.array([[lengths[a, b].sum(dtype=np.float64) for b in spans] for a in spans])
    counts = np.array([len(part) for part in sets], np.float64)

    def distance(one: int, others: list[int]) -> float:
        # E|Y - Y'| is over pairs within each of the other sets, because each is a draw.
        between = (sums[one, others] / counts[others]).mean() / counts[one]
        own = sums[one, one] / (counts[one] * (counts[one] - 1))
        theirs = (sums[others, others] / (counts[others] * (counts[others] - 1))).mean()
        return float((2 * between - own - theirs) / max(theirs, 1e-12))

    fresh = range(1, len(sets))
    return distance(0, list(fresh)), float(np.mean([distance(k, [j for j in fresh if j != k]) for k in fresh]))


def _samples(tiles: TileSet, weights: NDArray[np.float32]) -> NDArray[np.float32]:
    few = _thin(tiles.departures)
    share = np.sqrt(weights / weights.sum() / few.shape[-1])[..., np.newaxis]
    return np.asarray((few * share).reshape(len(few), -1), np.float32)


def _part_means(tiles: TileSet, weights: NDArray[np.float32]) -> NDArray[np.float32]:
    """Return the weighted mean departures of 4 x 4 parts of each tile."""
    few = _thin(tiles.departures)
    rows, columns = (_starts(side, _PARTS) for side in weights.shape)
    sums = np.add.reduceat(np.add.reduceat(few * weights[..., np.newaxis], rows, 1), columns, 2)
    masses = np.add.reduceat(np.add.reduceat(weights, rows, 0), columns, 1)
    return np.asarray((sums / masses[..., np.newaxis]).reshape(len(few), -1), np.float32)


def _starts(side: int, parts: int) -> NDArray[np.int64]:
    """Return where the parts of a side begin; a side shorter than the parts has fewer."""
    return np.unique(np.linspace(0, side, parts + 1).astype(int)[:-1])


def _thin(departures: Values) -> Values:
    if len(departures) <= _MOST_TILES:
        return departures
    return departures[np.linspace(0, len(departures) - 1, _MOST_TILES).round().astype(np.intp)]


def _lengths(rows: NDArray[np.float32]) -> NDArray[np.float32]:
    """Return the distances between all rows, in place: scipy's cdist computes in double precision."""
    powers = (rows**2).sum(1)
    squares = rows @ rows.T
    squares *= -2
    squares += powers
    squares += powers[:, np.newaxis]
    np.fill_diagonal(squares, 0)
    return np.asarray(np.sqrt(np.maximum(squares, 0, out=squares), out=squares))


def survival_of_odd_windows(
    tiles: ComparedTiles, elements: Mapping[str, NDArray[np.float64]]
) -> tuple[float | None, str, dict[str, float]]:
    """Return the share of odd windows in the output over the expected share, or the reason for None; and both shares.

    A window of half a tile is odd if the largest mean squared departure from the texture's mean tile, in any of its
    3 x 3 spots, is an outlier among the windows of sample and fresh draws: more than 4.5 median absolute deviations
    above the median, in logarithms. The expected share is that in sample and fresh draws. Without fresh draws it is
    that in the sample, which scatters much if few windows are odd. If the model knows its elements and none in the
    sample is damaged, there is nothing to survive.

    Parameters
    ----------
    tiles
        The compared tiles.
    elements
        Departures of the sample's elements, see :class:`~nrbench.plugins.forms.Texture`; empty if they are not known.
    """
    damage = [rows for name, rows in elements.items() if name.endswith(".damage")]
    if elements and not any((rows > 0).any() for rows in damage):
        return None, "not applicable: no element of the sample is damaged or missing", {}
    own = _log_worst_spots(quarters(tiles.output.tiles), tiles)
    windows = [tiles.windows, *(quarters(some.tiles) for some in tiles.fresh if tiles.model)]
    usual = np.concatenate([_log_worst_spots(some, tiles) for some in windows])
    middle = float(np.median(usual))
    limit = middle + _OUTLYING * float(np.median(np.abs(usual - middle)))
    shares = {"odd_windows": float((own > limit).mean()), "odd_expected": float((usual > limit).mean())}
    if not shares["odd_expected"]:
        return None, "not applicable: no window of the texture stands out from the rest", shares
    return shares["odd_windows"] / shares["odd_expected"], "", shares


def _log_worst_spots(windows: Iterable[Values], tiles: ComparedTiles) -> NDArray[np.float64]:
    """Return the logarithm of the worst spot of each window; ``windows`` are given by quarters of the cell."""
    means = quarters(tiles.mean[np.newaxis])[:, 0]
    weights = quarters(tiles.weights[np.newaxis, ..., np.newaxis])[:, 0, ..., 0]
    worst = []
    for part, mean, weight in zip(windows, means, weights, strict=True):
        squares = ((part - mean) ** 2).mean(-1) * weight
        rows, columns = (_starts(side, _SPOTS) for side in squares.shape[1:])
        sums = np.add.reduceat(np.add.reduceat(squares, rows, 1), columns, 2)
        heights, widths = np.diff([*rows, squares.shape[1]]), np.diff([*columns, squares.shape[2]])
        worst.append(np.asarray(sums / (heights[:, np.newaxis] * widths), np.float32).max((1, 2)))
    return np.asarray(np.log(np.concatenate(worst).astype(np.float64) + 1e-8))
