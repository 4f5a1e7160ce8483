"""Randomness: whether the output varies from tile to tile as the texture does, without repeating itself."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, ClassVar

import numpy as np

from nrbench.plugins.forms import Column, Observation, Score, Value

from .residual_tiles.distance import distance
from .residual_tiles.rare_elements import survival
from .residual_tiles.repetition import SIZES, Library, Twins, sources, twins
from .residual_tiles.variation import Energies, energies
from .residual_tiles.variety import Variety
from .verdict.verdict import Judgement, judge, obstacle

__all__ = ["Randomness", "sources"]

_LEAST_TILES = 4
_LEAST_VARIANCE = (2 / 255) ** 2
"""Departures weaker than two gray levels (of 8 bits) cannot be told from rounding and resampling."""


@dataclass(frozen=True)
class Randomness:
    """How much the output departs from its own mean tile, of what kind, and how often it repeats itself.

    Every whole tile of the output is cut out where it was found (aligned, sub-pixel). Beside it stand the tiles of at
    least four fresh draws of the output's own size, cut on the same grid: so whatever depends on size, such as threads
    that are longer than a tile, or the share 1/n that a mean of n tiles takes, is the same in both. Edges of the mean
    tile count for less, so that what a misplacement within the tolerance leaves of them is no variation.

    ``variation`` is the energy of the tiles' departures over that of fresh draws, ``variation_color`` that of their
    mean colors alone. ``repetition`` counts near-exact twins among pairs of windows half a tile and one tile wide,
    whichever are more, ``repetition_wide`` those two tiles wide. The share of twins is placed between that of fresh
    draws (0) and that of the best possible copier (1), which picks at random among the sources in the sample that the
    lattice calls equal: with M of them one pair in M is a twin; one tile repeated reads about M. Where most windows
    return at one lag that counts for more: a crop of the sample that is repeated in rows and columns has few twins, but
    all at few lags, and reads about the root of M. ``distance`` is an energy distance between residual tiles, less the
    level of fresh draws to each other: noise buys nothing.

    Of a photograph the sample takes the place of fresh draws; energies are then compared in boxes of one extent, the
    smaller of sample's and output's, each about its own mean. Not scored where regularity is lost.
    """

    version: ClassVar[str] = "3"
    columns: ClassVar[Mapping[str, Column]] = {
        "variation": Column("Tile-by-tile variation over that of fresh draws.", "", (0.0, math.inf), "one"),
        "variation_color": Column(
            "Variation of the tiles' mean colors over that of fresh draws.", "", (0.0, math.inf), "one"
        ),
        "repetition": Column(
            "Near-exact twins among tiles: 0 as in fresh draws, 1 as the best possible copier.",
            "",
            (-math.inf, math.inf),
            "lower",
        ),
        "repetition_wide": Column("The same among windows two tiles wide.", "", (-math.inf, math.inf), "lower"),
        "copied": Column(
            "Share of windows half a tile wide with a near-exact twin in the sample, beyond chance.",
            "",
            (-math.inf, 1.0),
            "none",
        ),
        "distance": Column(
            "Energy distance of the tiles' departures to those of fresh draws, less that among fresh draws.",
            "",
            (-math.inf, math.inf),
            "lower",
        ),
        "survival": Column("Share of odd (damaged, missing) windows over that expected.", "", (0.0, math.inf), "one"),
    }

    def score(self, observation: Observation) -> Score:
        """Return the scores."""
        return self.of(observation, judge(observation))

    def of(self, observation: Observation, judgement: Judgement | None) -> Score:
        """Return the scores, given what regularity has found (None: no lattice in the truth)."""
        if judgement is None or obstacle(judgement):
            return Score.missing(self.columns, obstacle(judgement, observation))
        if judgement.unsure:
            return Score.missing(
                self.columns, f"not scored: the lattice may not be the sample's ({judgement.blindness})"
            )
        if judgement.preserved is False:
            return Score.missing(self.columns, f"not scored: regularity is lost ({judgement.faults[0]})")
        variety = Variety.of(observation, judgement)
        if variety.least < _LEAST_TILES:
            return Score.missing(self.columns, f"undecided: fewer than {_LEAST_TILES} whole tiles to compare")
        found = energies(variety)
        if min(found.reference, float(judgement.yardstick.periodic.variance.values.mean())) < _LEAST_VARIANCE:
            return Score.missing(self.columns, "not applicable: the texture hardly varies from tile to tile")
        return _scored(observation, judgement, variety, found)


def _scored(observation: Observation, judgement: Judgement, variety: Variety, found: Energies) -> Score:
    lattice = judgement.yardstick.lattice
    room = [sources(observation.sample, lattice, size) for size in SIZES]
    pairs = twins(variety.output, variety.reference, variety.weights, room, found.ratio)
    copied = Library(variety.windows, variety.mean, variety.weights).copied(
        variety.output, variety.reference, not variety.model
    )
    far, level = distance(variety.output, variety.fresh, variety.weights)
    elements = observation.truth.elements if observation.truth else {}
    odd, why, shares = survival(variety, elements)
    values: dict[str, Value] = {
        "variation": found.ratio,
        "variation_color": found.color_ratio,
        "repetition": max((one.score for one in pairs if one.size < 2), default=None),
        "repetition_wide": next((one.score for one in pairs if one.size == 2), None),
        "copied": None if copied is None else (copied[0] - copied[1]) / (1 - copied[1]),
        "distance": far - level,
        "survival": odd,
    }
    records = {"level_of_distance": level, **shares, **_records(variety, found, pairs)}
    return Score(values, {name: why for name, why in _reasons(why).items() if values[name] is None}, records=records)


def _reasons(survival: str) -> dict[str, str]:
    return {
        "variation_color": "not applicable: the tiles' mean colors hardly vary",
        "repetition": "undecided: no pairs of windows to compare",
        "repetition_wide": "undecided: no two windows of two tiles side by side in output and reference",
        "copied": "undecided: the sample holds too few windows of half a tile",
        "survival": survival,
    }


def _records(variety: Variety, found: Energies, pairs: list[Twins]) -> dict[str, Any]:
    half = pairs[0] if pairs else None
    return {
        "reference": "fresh draws" if variety.model else "sample",
        "tiles": len(variety.output),
        "sources": half.sources if half else None,
        "twins": {f"{one.size:g}": one.own.all for one in pairs},
        "twins_by_lag": {f"{one.size:g}": one.own.by_lag for one in pairs},
        "twins_of_reference": {f"{one.size:g}": one.natural.all for one in pairs},
        "deviation": {name: float(np.sqrt(value)) for name, value in found.all.items()},
    }
