"""Randomness: whether the output varies from tile to tile as the texture does, without repeating itself."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from typing import Any, ClassVar

import numpy as np
from numpy.typing import NDArray

from nrbench.imaging.convert import mean_channels
from nrbench.imaging.mean_tile import Values
from nrbench.plugins.forms import Column, Observation, Score, Value

from .residual_tiles.dependence import sum_variance
from .residual_tiles.distance import measure_distances
from .residual_tiles.repetition import SIZES, Twins, copied_share, count_sources, find_twins
from .residual_tiles.tiles import ComparedTiles, TileSet, part_starts, quarters
from .verdict.examination import examine
from .verdict.reference import NoFreshDraw
from .verdict.verdict import Verdict

_LEAST_TILES = 4
_LEAST_VARIANCE = (2 / 255) ** 2
"""Departures weaker than two gray levels (of 8 bits) cannot be told from rounding and resampling."""
_LEAST_COLOR = (1 / 255) ** 2
"""Mean colors that vary by less than a gray level (of 8 bits) are not compared."""
_LEAST_TOLERANCE, _DEVIATIONS = 0.1, 3.0
"""Tolerance of the logarithm of the variation: at least 0.1, because differences of 10 % are not visible, and at least
three standard deviations over fresh draws, which one of 370 exceeds."""
_RESOLUTION = 5.0
"""Twins that are less frequent than one fifth of those of the best copier cannot be told from chance."""
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
    and columns has few twins, but all at few lags, and a repetition of about the square root of M. ``distance`` is the
    distance between the distributions of the tiles of output and fresh draws, see
    :func:`~.residual_tiles.distance.measure_distances`. It includes the detail inside tiles: adding noise does not
    improve it.

    ``score`` is the smallest of three numbers, each 1 for a fresh draw and 0 for one tile repeated:

    - the smaller over the larger variation of output and fresh draws, beyond a tolerance of three standard deviations
      over fresh draws (see :class:`Energies`);
    - the logarithm of the effective number of different windows, over that of a fresh draw (see
      :func:`score_repetition`);
    - 1 less the distance, beyond what chance explains (see :class:`~.residual_tiles.distance.Distance`).

    For a photograph the sample replaces the fresh draws. Energies are then compared in boxes as large as the smaller of
    sample and output, each about its own mean tile. Randomness is not scored where regularity is lost.
    """

    version: ClassVar[str] = "6"
    uses: ClassVar[tuple[str, ...]] = ("dominance",)
    columns: ClassVar[Mapping[str, Column]] = {
        "score": Column(
            "The worst of variation, repetition and distance: 1 as a fresh draw, 0 one tile repeated.", better="higher"
        ),
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
        "distance": Column(
            "Distance between the tiles of output and fresh draws: 0 equal distributions, 1 no tile in common.",
            range=(-math.inf, 1.0),
            better="lower",
        ),
        "survival": _ratio("Share of odd (damaged, missing) windows over the expected share."),
    }

    def score(self, observation: Observation) -> Score:
        """Return the scores."""
        return observation.shared(_score)


def _score(observation: Observation) -> Score:
    verdict = examine(observation).verdict
    if isinstance(verdict, str):
        return Score.missing(Randomness.columns, verdict)
    try:
        return score_tiles(observation, verdict)
    except NoFreshDraw as without:
        return Score.missing(Randomness.columns, str(without))


def score_tiles(observation: Observation, verdict: Verdict) -> Score:
    """Return the scores of randomness, given the verdict on regularity."""
    columns = Randomness.columns
    if verdict.lattice_doubtful:
        return Score.missing(columns, f"not scored: the lattice may not be the sample's ({verdict.lack_of_power})")
    if verdict.preserved is False:
        return Score.missing(columns, f"not scored: regularity is lost ({verdict.faults[0]})")
    tiles = ComparedTiles.of(observation, verdict)
    if tiles.fewest < _LEAST_TILES:
        return Score.missing(columns, f"undecided: fewer than {_LEAST_TILES} whole tiles to compare")
    energies = Energies.of(tiles)
    if min(energies.reference, float(verdict.reference.periodic.variance.values.mean())) < _LEAST_VARIANCE:
        return Score.missing(columns, "not applicable: the texture hardly varies from tile to tile")

    sample, lattice = verdict.reference.straighten(observation.sample)
    sources = [count_sources(sample, lattice, size) for size in SIZES]
    twins = find_twins(tiles.output, tiles.reference, tiles.weights, sources, energies.ratio)
    distances = measure_distances(tiles.output, tiles.fresh, tiles.weights, tiles.mean)
    elements = observation.truth.elements if observation.truth else {}
    survival, no_survival, odd_shares = survival_of_odd_windows(tiles, elements)
    narrow = [one for one in twins if one.size < 2]
    parts = {
        "variation": energies.score,
        "repetition": score_repetition(narrow, len(tiles.output)),
        "distance": 1 - max(one.excess for one in distances.values()),
    }
    if verdict.geometry_score is not None:
        parts["geometry"] = verdict.geometry_score
    values: dict[str, Value] = {
        "score": min(parts.values()),
        "variation": energies.ratio,
        "variation_color": energies.color_ratio,
        "repetition": max((one.score for one in narrow), default=None),
        "repetition_wide": next((one.score for one in twins if one.size == 2), None),
        "copied": copied_share(tiles),
        "distance": max(one.value for one in distances.values()),
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
        "parts_of_score": parts,
        "distances": {name: one.value for name, one in distances.items()},
        "tolerances_of_distances": {name: one.tolerance for name, one in distances.items()},
        **odd_shares,
        "reference": "fresh draws" if tiles.model else "sample",
        "tiles": len(tiles.output),
        "sources": twins[0].sources if twins else None,
        "twins": {f"{one.size:g}": one.own.all for one in twins},
        "twins_by_lag": {f"{one.size:g}": one.own.by_lag for one in twins},
        "twins_of_reference": {f"{one.size:g}": one.natural.all for one in twins},
        "deviation": {name: float(np.sqrt(getattr(energies, name))) for name in ("output", "reference", "sample")},
        "tolerance_of_variation": energies.tolerance,
    }
    return Score(values, {name: reasons[name] for name, value in values.items() if value is None}, records=records)


def score_repetition(twins: Iterable[Twins], tiles: int) -> float:
    """Return the score of repetition in [0, 1]: 1 if no window is repeated, 0 if all windows are equal.

    If a share t of all pairs of windows are twins beyond chance, the output looks as if its windows were drawn from 1/t
    different ones, its *effective number of windows*. The score is the logarithm of this number over that of the
    largest number that can be measured: the number of tiles of the output, or five times the number M of places in the
    sample from which a copier can choose. The best copier thus has ``log M / log(min(tiles, 5 M))``.

    A crop of the sample that is repeated in rows and columns has few twins, but these return at fixed lags. If a share
    r of all pairs return at their lag, see :meth:`~.residual_tiles.repetition.Pairs.count`, the score is at most 1 - r
    M, because a share of 1/M returns if the whole sample is repeated.

    Parameters
    ----------
    twins
        The twins among windows of one or more widths; the most repeated width counts.
    tiles
        Number of tiles of the output.
    """
    score = 1.0
    for one in twins:
        largest = max(min(tiles, _RESOLUTION * one.sources), 2.0)
        chance = min(one.natural.all, 0.5)
        share = max((one.own.all - chance) / (1 - chance), 1 / largest)
        returning = max(one.own.by_lag**2 - one.natural.by_lag**2, 0.0) * one.sources
        score = min(score, math.log(1 / share) / math.log(largest), 1 - returning)
    return max(score, 0.0)


@dataclass(frozen=True)
class Energies:
    """Mean squared departures of tiles.

    Parameters
    ----------
    output, reference, sample
        Of all pixels.
    color, reference_color
        Of the tiles' mean colors, in output and reference.
    scatter
        Standard deviation of the logarithm of the ratio of output to reference, over fresh draws.
    """

    output: float
    reference: float
    sample: float
    color: float
    reference_color: float
    scatter: float = 0.0

    @classmethod
    def of(cls, tiles: ComparedTiles) -> Energies:
        """Return the energies over boxes of the extent that output and reference have in common.

        In each box the mean tile of the box is subtracted: n tiles leave n - 1 degrees of freedom. If elements are
        longer than a tile more energy is lost, and more in a smaller box, so the boxes must be equal.
        """
        output, color = _pooled_energy(tiles.blocks[0], tiles.weights)
        reference, reference_color = _pooled_energy(tiles.blocks[1], tiles.weights)
        sample, _ = _pooled_energy([tiles.sample], tiles.weights)
        return cls(output, reference, sample, color, reference_color, _scatter(tiles))

    @property
    def ratio(self) -> float:
        """Energy of the output over that of the reference."""
        return self.output / max(self.reference, 1e-12)

    @property
    def tolerance(self) -> float:
        """Tolerance of the logarithm of the ratio: three standard deviations over fresh draws, at least 0.1."""
        return max(_DEVIATIONS * self.scatter, _LEAST_TOLERANCE)

    @property
    def score(self) -> float:
        """The smaller over the larger energy of output and reference, in [0, 1]; 1 within the tolerance."""
        return float(np.exp(min(self.tolerance - abs(math.log(max(self.ratio, 1e-12))), 0.0)))

    @property
    def color_ratio(self) -> float | None:
        """The same for the mean colors; None if they hardly vary."""
        return None if self.reference_color < _LEAST_COLOR else self.color / self.reference_color


def _scatter(tiles: ComparedTiles) -> float:
    """Return the standard deviation of the logarithm of the energy of an output over that of the reference.

    It is measured on the fresh draws, or the halves of the sample, in two ways, of which the larger counts: by the
    covariances of the tiles of one line (:func:`~.residual_tiles.dependence.sum_variance`), and from image to image.
    The latter sees what tiles share that do not lie on a line, but is measured on few images.
    """
    energies = [_tile_energies(one, tiles.weights) for one in tiles.fresh]
    mean, size = float(np.mean(np.concatenate(energies))), float(np.mean([len(one) for one in energies]))
    lines = [
        sum_variance(one.numbers, own - mean) / len(own) ** 2 for one, own in zip(tiles.fresh, energies, strict=True)
    ]
    variance = max(float(np.mean(lines)), float(np.var([one.mean() for one in energies], ddof=1)))
    images = size / len(tiles.output) + size / sum(map(len, tiles.reference))
    return math.sqrt(variance * images) / max(mean, 1e-12)


def _tile_energies(tiles: TileSet, weights: NDArray[np.float32]) -> NDArray[np.float64]:
    """Return the weighted mean squared departure of each tile, ``(n,)``."""
    squares = mean_channels(tiles.departures**2).reshape(len(tiles), -1)
    return np.asarray(squares @ (weights / weights.sum()).ravel(), np.float64)


def _pooled_energy(sets: Iterable[TileSet], weights: NDArray[np.float32]) -> tuple[float, float]:
    """Return the weighted mean squared departure of pixels, and that of the tiles' mean colors."""
    shares, total, color, freedom = weights / weights.sum(), 0.0, 0.0, 0
    for tiles in sets:
        if len(tiles) > 1:
            left = tiles.departures
            means = np.tensordot(left, shares, ([1, 2], [0, 1]))
            total += (len(tiles) - 1) * float(np.tensordot(mean_channels(left**2), shares, 2).mean(dtype=np.float64))
            color += (len(tiles) - 1) * float((means**2).mean(dtype=np.float64))
            freedom += len(tiles) - 1
    return total / max(freedom, 1), color / max(freedom, 1)


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
        squares = mean_channels((part - mean) ** 2) * weight
        rows, columns = (part_starts(side, _SPOTS) for side in squares.shape[1:])
        sums = np.add.reduceat(np.add.reduceat(squares, rows, 1), columns, 2)
        heights, widths = np.diff([*rows, squares.shape[1]]), np.diff([*columns, squares.shape[2]])
        worst.append(np.asarray(sums / (heights[:, np.newaxis] * widths), np.float32).max((1, 2)))
    return np.asarray(np.log(np.concatenate(worst).astype(np.float64) + 1e-8))
