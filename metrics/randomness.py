"""Randomness: whether the output varies from tile to tile as the texture does, without repeating itself."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from functools import lru_cache
from typing import ClassVar

import numpy as np

from nrbench.plugins.forms import Column, Observation, Score, Value

from .judgment.examination import Examination, examine
from .judgment.texture_reference import CannotTell, TextureReference
from .judgment.tile_population import LEAST_PAIRS, LEAST_TILES, SAME, Population, Tiles, gather_tiles, square_distances
from .perception import limits
from .perception.visible import SeenSample


def _ratio(meaning: str) -> Column:
    return Column(meaning, range=(0.0, math.inf), better="one")


@dataclass(frozen=True)
class Randomness:
    """Variation, repetition, arrangement and distribution of the output's tiles, beside those of the texture.

    Tiles are cut from the straightened output, and the mean tile of the texture is subtracted. Their residual colors on
    4 x 4 places are compared with those of the references: fresh draws, or the tiles of the sample. Each of these has a
    score of 1 as long as chance explains the difference, as it shows in parts of the references as large as the sample:

    - ``variation``, the energy of the residuals over that of the references. Its score is the smaller over the larger.
    - ``repetition``, from the share t of pairs of windows (a half tile wide) that are twins, beyond chance: nearer than
      all but a few pairs of the references. 1 / t is the effective number of different windows; the score is its
      logarithm over that of the number of tiles. Twins that return at one lag count more, since a repeated crop is seen
      by its period. The column is t times the number of tiles of the sample: 0 as in fresh draws, 1 for a choice at
      random among them. Where a print has few inks, chance alone makes twins of equal elements.
    - ``arrangement``, the largest change of the correlation of tones at ten lags of the lattice: rows, checkerboards
      and blobs of one tone, and threads that lose theirs.
    - ``distance``, the energy distance between the distributions of tiles.
    - ``misplacement_ratio`` of ``regularity``, where the geometry of the texture varies: it may be lost as well.

    A method knows one sample, which may not be typical. With a model, variation, arrangement and distance are measured
    to the nearest point between fresh draws and sample. Repetition is not, because no sample excuses it.

    ``score`` is the smallest. Where the texture does not visibly vary, only the variation counts. Randomness is not
    scored where half of the tiles are out of place, nor where output or references show fewer than four whole tiles,
    unless most windows of the output look the same where those of the references differ: that is 0.
    """

    version: ClassVar[str] = "10"
    uses: ClassVar[tuple[str, ...]] = ("dominance",)
    columns: ClassVar[Mapping[str, Column]] = {
        "score": Column("The worst of the parts: 1 as a fresh draw, 0 one tile repeated.", better="higher"),
        "variation": _ratio("Tile-to-tile variation over that of the references."),
        "repetition": Column(
            "Twins among windows of half a tile: 0 as in fresh draws, 1 as a random choice among the sample's.",
            range=(-math.inf, math.inf),
            better="lower",
        ),
        "returning": Column("Share of the windows that return at one lag.", better="lower"),
        "arrangement": Column(
            "Largest change of the correlation of tones at a lag, beyond chance.", range=(0.0, 2.0), better="lower"
        ),
        "distance": Column("Distance between the tiles of output and references.", range=(-1.0, 1.0), better="lower"),
        "copied": Column("Share of windows of half a tile with a twin in the sample.", better="none"),
        "survival": _ratio("Share of odd (damaged, missing) cells over that of the references."),
    }

    def score(self, observation: Observation) -> Score:
        """Return the scores."""
        return observation.shared(_score)


def _score(observation: Observation) -> Score:
    examination = examine(observation)
    try:
        followed, reference = examination.followed, examination.reference
        if limits.SLOPE * examination.misplaced >= 1:
            raise CannotTell("not scored: half of the tiles are out of place")
        tiles = Tiles(followed.coarse)
        population = gather_tiles(reference)
        if min(len(tiles.features), len(population.features)) < LEAST_TILES:
            return _score_few(tiles, population)
    except CannotTell as reason:
        return Score.missing(Randomness.columns, str(reason))
    values: dict[str, Value] = dict.fromkeys(Randomness.columns)
    values["variation"] = math.exp(population.rate_energy(tiles.features))
    source = _cut_sample(reference, examination.sample)
    known = source is not None and not reference.from_sample and len(source.features) >= LEAST_TILES
    shown = source.features if source and known else None
    parts = {"variation": population.rate_variation(tiles.features, shown)}
    if population.varies:
        parts["repetition"], values["repetition"], values["returning"] = _rate_repetition(tiles, population)
        distance = population.measure_distance(tiles.features, shown)
        values["distance"] = distance
        parts["distance"] = 1 - max(distance - population.distance_limit, 0.0) / (1 - population.distance_limit)
        parts["distance"] = max(1 - limits.DISTANCE_SLOPE * (1 - parts["distance"]), 0.0)
        change = values["arrangement"] = _rate_arrangement(tiles, population, None if shown is None else source)
        if change is not None:
            parts["arrangement"] = max(1 - change, 0.0)
        values["copied"] = None if source is None else _find_copies(source, tiles, population)
    if (bending := _rate_bending(examination)) is not None:
        parts["misplacement_ratio"] = bending
    values["survival"] = _rate_survival(examination)
    values["score"] = min(parts.values())
    unseen = "not applicable: the texture does not visibly vary from tile to tile"
    why = {"survival": "not scored: the references show no odd cell"}
    if population.varies:
        why["arrangement"] = f"undecided: fewer than {LEAST_PAIRS} pairs of tiles at each lag"
        why["copied"] = "undecided: the sample shows too few whole tiles"
    reasons = {name: why.get(name, unseen) for name, value in values.items() if value is None}
    return Score(values, reasons, records={"parts": parts, "sources": population.sources})


def _score_few(tiles: Tiles, population: Population) -> Score:
    """Return a score of 0 if most windows of half a tile look the same and the references' do not, else none."""
    values: dict[str, Value] = dict.fromkeys(Randomness.columns)
    distances = tiles.compare_windows()[0]
    if population.varies and population.differences.size and distances.size and np.median(distances) < SAME:
        _, values["repetition"], values["returning"] = _rate_repetition(tiles, population)
        values["score"] = 0.0
    few = f"undecided: fewer than {LEAST_TILES} whole tiles to compare"
    return Score(values, {name: few for name, value in values.items() if value is None})


def _rate_repetition(tiles: Tiles, population: Population) -> tuple[float, float, float]:
    """Return the score of repetition, the share of twins times the sources, and the share that returns at one lag.

    The share t of twins among pairs of windows is (t - c) / (1 - c) beyond the share c that chance explains. Of n pairs
    at a lag, windows return if more than half of those that chance does not explain are twins.
    """
    distances, lags = tiles.compare_windows()
    limit, middle, chance = population.twins
    if not distances.size:
        return 1.0, 0.0, 0.0
    scale = np.clip(np.median(distances) / middle, limits.LEAST_SCALE, 1) if middle > limit else 1.0
    near = distances < limit * scale
    share, count = float(near.mean()), max(len(tiles.features), 3)
    most = chance + population.allow_twins(count)
    pairs = np.bincount(lags)
    pairs, twins = pairs[pairs > 0], np.bincount(lags, near)[pairs > 0]
    usual = np.maximum((1 + most) / 2, most + limits.ARRANGED_DEVIATIONS * np.sqrt(most * (1 - most) / pairs))
    often = (pairs >= limits.RETURNING) & (usual < 1)
    excess = np.maximum(twins - usual * pairs, 0) / np.maximum(1 - usual, 1e-9)
    returning = float(excess[often].sum() / max(pairs[often].sum(), 1))
    strewn = math.log(1 / max((share - most) / max(1 - most, 1e-9), 1e-9)) / math.log(count)
    return (
        min(float(np.clip(strewn, 0, 1)), max(1 - math.sqrt(returning * population.sources), 0.0)),
        (share - chance) / max(1 - chance, 1e-9) * population.sources,
        returning,
    )


def _rate_arrangement(tiles: Tiles, population: Population, source: Tiles | None) -> float | None:
    """Return the largest change of a correlation at a lag, beyond what chance explains; None if no lag has pairs.

    It is measured to the nearest point between the references and the sample.
    """
    usual, variance = population.arrangement
    change = population.arrange(tiles) - usual
    if not np.isfinite(change).any():
        return None
    if source is not None:
        way = np.nan_to_num(population.arrange(source) - usual)
        change -= way * np.clip(np.nansum(way * change) / max(float((way**2).sum()), 1e-9), 0, 1)
    variance = np.maximum(variance, 1 / len(tiles.features))
    allowed = np.maximum(limits.ARRANGED, limits.ARRANGED_DEVIATIONS * np.sqrt(variance))
    excess = np.maximum(np.abs(change) - allowed, 0) / np.maximum(1 - allowed, 0.3)
    return float(np.nan_to_num(excess).max(initial=0.0))


def _rate_bending(examination: Examination) -> float | None:
    """Return the score of the bending of the output beside the references'; None where the geometry does not vary."""
    usual = np.array([picture.bending for picture in examination.reference.pictures])
    if usual.mean() < limits.AMPLITUDE or examination.reference.from_sample:
        return None
    ratio = math.log(max(examination.followed.bending, 1e-3) / float(usual.mean()))
    allowed = max(limits.AMPLITUDE_TOLERANCE, limits.DEVIATIONS * float(np.log(usual).std(ddof=1)))
    return math.exp(-max(abs(ratio) - allowed, 0.0))


def _find_copies(sources: Tiles, tiles: Tiles, population: Population) -> float | None:
    """Return the share of windows of half a tile that have a twin at an equal place of the sample."""
    limit = population.twins[0]
    pairs = [(a, b) for (a, _), (b, _) in zip(tiles.quarters, sources.quarters, strict=True) if len(a) and len(b)]
    near = [(square_distances(a, b) < limit).any(1) for a, b in pairs]
    return float(np.concatenate(near).mean()) if near else None


@lru_cache(maxsize=2)
def _cut_sample(reference: TextureReference, sample: SeenSample) -> Tiles | None:
    """Return the tiles of a sample, None if it cannot be followed."""
    try:
        followed = reference.follow(sample.lab)
    except CannotTell:
        return None
    return Tiles(followed.coarse)


def _rate_survival(examination: Examination) -> float | None:
    """Return the share of odd cells, whose misfit stands out, over that of the references; None if there is none."""
    reference, followed = examination.reference, examination.followed
    usual = np.log(np.concatenate([picture.misfit[picture.valid] for picture in reference.pictures]))
    middle = float(np.median(usual))
    odd = middle + limits.ODD * max(float(np.median(np.abs(usual - middle))), 1e-6)
    share = float((usual > odd).mean())
    own = np.log(np.maximum(followed.misfit[followed.valid], 1e-9))
    return float((own > odd).mean()) / share if share > limits.SURE_SHARE else None
