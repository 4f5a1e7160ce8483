"""Randomness: whether the output varies from tile to tile as the texture does, without repeating itself."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from nrbench.imaging.door import Image
from nrbench.imaging.fold import tile_grid
from nrbench.lattice.geometry import Lattice
from nrbench.synthesis import Column, Observation, Score

from .judgement import Judgement, judge, obstacle
from .periodic import tile_box
from .regularity import no_score
from .residual import Residual, interior_weights, offset_noise, reference_energy

_LEAST_TILES = 4
_LEAST_VARIANCE = (2 / 255) ** 2
_TWINS_OF_COPIER = 0.1


@dataclass(frozen=True)
class Randomness:
    """How much the output departs from its own mean tile, and how often it repeats itself.

    Every whole tile of the output is cut out where it was found (aligned, sub-pixel), and the mean of them all taken
    out. ``variation`` is the energy of what is left over that of fresh draws. ``repetition`` counts near-exact twins:
    pairs of tiles, quarter by quarter, that differ less than nearly all pairs of fresh draws do. The share of twins is
    placed between that of fresh draws (0) and that of the best possible copier (1), which picks at random among the
    sources in the sample that the lattice calls equal: with M of them one pair in M is a twin. One tile repeated reads
    about M. Edges of the mean tile count for less, so that what a misplacement within the tolerance leaves of them is
    no variation.

    Of a photograph the sample itself takes the place of fresh draws. Not scored where regularity is lost.
    """

    version: ClassVar[str] = "1"
    columns: ClassVar[Mapping[str, Column]] = {
        "variation": Column("Tile-by-tile variation over that of fresh draws.", "", (0.0, math.inf), "one"),
        "repetition": Column(
            "Near-exact twins among tiles: 0 as in fresh draws, 1 as the best possible copier.",
            "",
            (-math.inf, math.inf),
            "lower",
        ),
    }

    def score(self, observation: Observation) -> Score:
        """Return the scores."""
        judgement = judge(observation)
        if judgement is None or obstacle(judgement):
            return no_score(self.columns, obstacle(judgement))
        if judgement.preserved is False:
            return no_score(self.columns, f"not scored: regularity is lost ({judgement.faults[0]})")
        noise = offset_noise(judgement.references)
        grid = tile_grid(judgement.yardstick.lattice)
        references = [Residual.of(look, noise, observation.rng, grid) for look in judgement.references]
        output = Residual.of(judgement.output, noise, observation.rng, grid)
        if min(len(residual.departures) for residual in (output, *references)) < _LEAST_TILES:
            return no_score(self.columns, f"undecided: fewer than {_LEAST_TILES} whole tiles to compare")
        return _scored(self.columns, observation.sample, judgement, output, references)


def _scored(
    columns: Mapping[str, Column], sample: Image, judgement: Judgement, output: Residual, references: list[Residual]
) -> Score:
    weights = interior_weights(references)
    energy = reference_energy(references, weights)
    if min(energy, float(judgement.yardstick.periodic.variance.values.mean())) < _LEAST_VARIANCE:
        return no_score(columns, "not applicable: the texture hardly varies from tile to tile")
    choices = sources(sample, judgement.yardstick.lattice)
    pairs = np.concatenate([residual.distances(weights) for residual in references])
    limit = float(np.quantile(pairs, _TWINS_OF_COPIER / choices))
    natural, twins = float((pairs <= limit).mean()), float((output.distances(weights) <= limit).mean())
    values = {
        "variation": output.energy(weights) / energy,
        "repetition": (twins - natural) * choices / (1 - natural),
    }
    records = {
        "reference": "fresh draws" if judgement.yardstick.source == "model" else "sample",
        "tiles": len(output.departures),
        "sources": choices,
        "twins": twins,
        "twins_of_reference": natural,
    }
    return Score(values, records=records)


def sources(sample: Image, lattice: Lattice) -> float:
    """Return how many places of the sample that the lattice calls equal hold a window half a tile wide."""
    room = np.maximum(np.array(sample.shape[1::-1]) - tile_box(lattice) / 2, 1)
    return max(float(room.prod()) / lattice.area, 1.0)
