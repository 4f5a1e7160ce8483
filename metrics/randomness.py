"""Randomness: whether the output varies from tile to tile as the texture does, without repeating itself."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from functools import cached_property, lru_cache
from typing import ClassVar

import numpy as np
import scipy.spatial.distance
from numpy.typing import NDArray

from nrbench.plugins.forms import Column, Observation, Score, Value

from .judgment.examination import Examination, examine
from .judgment.texture_reference import CannotTell, TextureReference
from .perception import limits
from .perception.visible import perceive
from .registration.coarse_plane import CoarsePlane, shift_plane
from .registration.lattice_net import Mask, split_cells

Features = NDArray[np.float64]
"""``(n, 48)``: residual colors of a tile on 4 x 4 places."""
_LAGS = ((1, 0), (0, 1), (1, 1), (1, -1), (2, 0), (0, 2), (2, 2), (2, -2), (3, 0), (0, 3))
"""Lags, in cells, at which the tones of tiles are compared."""
_LEAST_PAIRS = 8
"""Least number of pairs of tiles at a lag."""
_COMPONENTS, _ARRANGED_COMPONENTS = 12, 3
"""Number of principal components of the features in distances, and in the arrangement."""
_MOST_TILES = 400
"""Largest number of tiles of which all pairs are compared; the first ones if there are more."""
_LEAST_TILES = 4
_SAME = (limits.VARIES * limits.JND) ** 2
"""Mean squared difference below which nobody tells two windows apart."""


def _ratio(meaning: str) -> Column:
    return Column(meaning, range=(0.0, math.inf), better="one")


@dataclass(frozen=True)
class Tiles:
    """The whole tiles of a straightened picture.

    Parameters
    ----------
    plane
        The residual of the picture.
    """

    plane: CoarsePlane

    @cached_property
    def grid(self) -> tuple[Features, Mask]:
        """``(N1, N2, 48)`` features, and the whole cells."""
        cells = self.plane.cells
        half = limits.PLACES // 2
        means = cells.reshape(*cells.shape[:2], half, 2, half, 2, 3).mean((3, 5), dtype=np.float64)
        return means.reshape(*cells.shape[:2], -1), self.plane.whole

    @cached_property
    def features(self) -> Features:
        """Features of the whole tiles."""
        values, whole = self.grid
        return values[whole]

    @cached_property
    def quarters(self) -> list[tuple[NDArray[np.float32], NDArray[np.intp]]]:
        """``(n, d)`` lightness residuals of the whole windows of half a tile, in four parts of the cell, and cells."""
        half, found = self.plane.samples // 2, []
        light, known = (split_cells(a, self.plane.samples) for a in (self.plane.fine[..., 0], self.plane.known))
        for i, j in np.ndindex(2, 2):
            part = np.s_[:, :, i * half[0] : (i + 1) * half[0], j * half[1] : (j + 1) * half[1]]
            whole = known[part].all((2, 3))
            windows = light[part][whole].reshape(int(whole.sum()), int(half.prod()))
            found.append((windows[:_MOST_TILES], np.argwhere(whole)[:_MOST_TILES]))
        return found

    def compare_windows(self) -> tuple[NDArray[np.float64], NDArray[np.intp]]:
        """Return the mean squared difference of all pairs of windows, and a number for the lag of each pair."""
        distances, lags = [], []
        for part, (windows, cells) in enumerate(self.quarters):
            first, second = np.triu_indices(len(windows), 1)
            distances.append(_square_distances(windows, windows)[first, second])
            lag = cells[second] - cells[first]
            lags.append((lag[:, 0] * 4096 + lag[:, 1]) * 4 + part)
        return np.concatenate(distances), np.concatenate(lags).astype(np.intp)


def _square_distances(a: NDArray[np.float32], b: NDArray[np.float32]) -> NDArray[np.float64]:
    if not a.size or not b.size:
        return np.zeros((len(a), len(b)))
    return np.asarray(scipy.spatial.distance.cdist(a, b, "sqeuclidean") / a.shape[1])


@dataclass(frozen=True, eq=False)
class Population:
    """The tiles of the references, to which those of an output are compared.

    Parameters
    ----------
    tiles
        The tiles of each reference picture.
    sources
        Number of tiles of the sample among which a copier can choose.
    parts
        Number of parts, along each axis, into which a reference is cut to show how parts of the sample's size differ.
    from_sample
        Whether the sample is the only reference.
    """

    tiles: list[Tiles]
    sources: float
    parts: int
    from_sample: bool

    @cached_property
    def features(self) -> Features:
        """Features of all tiles."""
        return np.concatenate([tiles.features for tiles in self.tiles])

    @cached_property
    def energy(self) -> float:
        """Mean squared departure of the tiles from their mean, in CIELAB; that of L* in windows if tiles are few."""
        if len(self.features) >= _LEAST_TILES:
            return float(self.features.var(0, ddof=1).mean())
        return float(np.median(self.differences)) / 2 if self.differences.size else math.inf

    @cached_property
    def differences(self) -> NDArray[np.float64]:
        """Mean squared differences of all pairs of windows of half a tile."""
        return np.concatenate([tiles.compare_windows()[0] for tiles in self.tiles])

    @property
    def varies(self) -> bool:
        """Whether an eye sees that the tiles differ."""
        return self.energy > _SAME

    @cached_property
    def _axes(self) -> NDArray[np.float64]:
        """``(48, k)``: principal axes over their standard deviation, with half a JND added.

        A sample holds too few tiles for axes of its own: three fixed ones, the mean L*, a* and b*, take their place.
        """
        if self.from_sample:
            means = np.tile(np.eye(3), (self.features.shape[1] // 3, 1)) * 3 / self.features.shape[1]
            return np.asarray(means / np.sqrt((self.features @ means).var(0) + (limits.JND / 2) ** 2))
        values, axes = np.linalg.eigh(np.cov(self.features.T))
        keep = np.argsort(values)[::-1][:_COMPONENTS]
        return np.asarray(axes[:, keep] / np.sqrt(np.maximum(values[keep], 0) + (limits.JND / 2) ** 2))

    def project(self, features: Features) -> NDArray[np.float64]:
        """Return the components of features less their own mean."""
        return np.asarray((features - features.mean(0)) @ self._axes)

    def _cut(self) -> Iterator[Features]:
        """Cut the references into parts of about the sample's size and yield the features of each."""
        for tiles in self.tiles:
            values, whole = tiles.grid
            rows, columns = (np.array_split(np.flatnonzero(whole.any(1 - axis)), self.parts) for axis in (0, 1))
            for i in rows:
                for j in columns:
                    part = values[np.ix_(i, j)][whole[np.ix_(i, j)]]
                    if len(part) >= _LEAST_TILES:
                        yield part

    def rate_energy(self, features: Features) -> float:
        """Return the logarithm of the energy of tiles over that of the references, with the least visible one added."""
        return math.log((float(features.var(0, ddof=1).mean()) + _SAME) / (self.energy + _SAME))

    def allow_energy(self, count: int) -> float:
        """Return the largest difference of the logarithm of the energy that chance explains for ``count`` tiles.

        It is three standard deviations over parts of the references, or of a mean over as many independent tiles as the
        output or the sample has, if that is more.
        """
        spread = float(np.std([self.rate_energy(part) for part in self._cut()] or [0.0]))
        own = ((self.features - self.features.mean(0)) ** 2).mean(1)
        single = float(own.std() / max(own.mean(), 1e-9)) / math.sqrt(min(count, self.sources))
        spread = max(spread / (self.parts if self.from_sample else 1), single)
        return max(limits.TOLERANCE, limits.DEVIATIONS * spread)

    @cached_property
    def _usual(self) -> tuple[NDArray[np.float64], float]:
        points = self.project(self.features)[: 2 * _MOST_TILES]
        return points, _mean_distance(points, points)

    def measure_distance(self, features: Features) -> float:
        """Return the energy distance between tiles and those of the references, over twice their mean distance.

        It is E|x - y| - (E|x - x'| + E|y - y'|) / 2 over E|x - y| (Székely and Rizzo 2004), about 0 for equal
        distributions and at most 1.
        """
        points, within = self._usual
        own = self.project(features)
        between = _mean_distance(own, points)
        return float(1 - (_mean_distance(own, own) + within) / (2 * max(between, 1e-9)))

    @cached_property
    def distance_limit(self) -> float:
        """Largest distance that chance explains: that of parts of the references."""
        parts = [self.measure_distance(part) for part in self._cut()]
        return max(limits.LEAST_DISTANCE, limits.OF_DISTANCE * max(parts, default=0.0))

    @cached_property
    def twins(self) -> tuple[float, float, float]:
        """Distance below which two windows are twins, the median distance, and the share of twins by chance."""
        distances = self.differences
        if not distances.size:
            return 0.0, 1.0, 0.0
        limit = max(float(np.quantile(distances, min(limits.TWINS / self.sources, 0.5))), _SAME)
        return limit, float(np.median(distances)), float((distances < limit).mean())

    def arrange(self, tiles: Tiles) -> NDArray[np.float64]:
        """Return the correlations of the first components of tiles at ten lags, ``(10, 3)``; NaN without pairs."""
        values, whole = tiles.grid
        axes = self._axes[:, :_ARRANGED_COMPONENTS]
        points = (values - values[whole].mean(0)) @ axes
        power = (points[whole] ** 2).mean(0) + 0.05
        found = np.full((len(_LAGS), axes.shape[1]), np.nan)
        for row, lag in zip(found, _LAGS, strict=True):
            other, both = shift_plane(points, whole, lag)
            if both.sum() >= _LEAST_PAIRS:
                row[:] = (points * other)[both].mean(0) / power
        return found

    @cached_property
    def arrangement(self) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Mean of the correlations over the references, and the variance of each component's, mean over the lags.

        The mean is NaN at the lags that a reference lacks.
        """
        found = np.array([self.arrange(tiles) for tiles in self.tiles])
        chance = 1 / max(float(np.mean([len(tiles.features) for tiles in self.tiles])), 1.0)
        mean = found.mean(0)
        known = np.isfinite(mean).all(1)
        if len(found) == 1 or not known.any():
            return mean, np.full(mean.shape[1], 2 * chance)
        spread = found[:, known].var(0, ddof=1).mean(0)
        return mean, np.maximum(spread, chance) * (1 + 1 / len(found))


def _mean_distance(a: NDArray[np.float64], b: NDArray[np.float64]) -> float:
    """Return the mean Euclidean distance of two different points, one of each set."""
    distances = scipy.spatial.distance.cdist(a, b)
    pairs = distances.size - (len(a) if a is b else 0)
    return float(distances.sum() / max(pairs, 1))


@lru_cache(maxsize=2)
def gather_tiles(reference: TextureReference) -> Population:
    """Return the population of the tiles of a reference."""
    net = reference.net
    tiles = [Tiles(CoarsePlane(fine, known, net.samples)) for fine, known in reference.departures]
    box = np.abs(net.vectors).sum(0)[::-1]
    sources = float(np.maximum(reference.sample_shape - box, 1).prod()) / abs(float(np.linalg.det(net.vectors)))
    side = min(a / b for a, b in zip(net.shape, reference.sample_shape, strict=True))
    parts = 2 if reference.from_sample else max(round(side), 1)
    return Population(tiles, max(sources, 1.5), parts, reference.from_sample)


@dataclass(frozen=True)
class Randomness:
    """Variation, repetition, arrangement and distribution of the output's tiles, beside those of the texture.

    Tiles are cut from the straightened output, and the mean tile of the texture is subtracted. Their residual colors on
    4 x 4 places are compared with those of the references: fresh draws, or the tiles of the sample. Each of these has a
    score of 1 as long as chance explains the difference, as it shows in parts of the references as large as the sample:

    - ``variation``, the energy of the residuals over that of the references. Its score is the smaller over the larger.
    - ``repetition``, from the share t of pairs of windows (a half tile wide) that are twins: nearer than all but a few
      pairs of the references. 1 / t is the effective number of different windows; the score is its logarithm over that
      of the number of tiles. Twins that return at one lag count more, since a repeated crop is seen by its period. The
      column is t times the number of tiles of the sample: 0 as in fresh draws, 1 for a choice at random among them.
    - ``arrangement``, the largest change of the correlation of tones at ten lags of the lattice: rows, checkerboards
      and blobs of one tone, and threads that lose theirs.
    - ``distance``, the energy distance between the distributions of tiles.
    - ``misplacement_ratio`` of ``regularity``, where the geometry of the texture varies: it may be lost as well.

    ``score`` is the smallest. Where the texture does not visibly vary, only the variation counts. Randomness is not
    scored where half of the tiles are out of place, nor where output or references show fewer than four whole tiles,
    unless most windows of the output look the same where those of the references differ: that is 0.
    """

    version: ClassVar[str] = "9"
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
        tiles = Tiles(CoarsePlane(*followed.residual, followed.net.samples))
        population = gather_tiles(reference)
        if min(len(tiles.features), len(population.features)) < _LEAST_TILES:
            return _score_few(tiles, population)
    except CannotTell as reason:
        return Score.missing(Randomness.columns, str(reason))
    values: dict[str, Value] = dict.fromkeys(Randomness.columns)
    level = population.rate_energy(tiles.features)
    values["variation"] = math.exp(level)
    parts = {"variation": math.exp(-max(abs(level) - population.allow_energy(len(tiles.features)), 0.0))}
    if population.varies:
        parts["repetition"], values["repetition"], values["returning"] = _rate_repetition(tiles, population)
        distance = population.measure_distance(tiles.features)
        values["distance"] = distance
        parts["distance"] = 1 - max(distance - population.distance_limit, 0.0) / (1 - population.distance_limit)
        parts["distance"] = max(1 - limits.DISTANCE_SLOPE * (1 - parts["distance"]), 0.0)
        change = values["arrangement"] = _rate_arrangement(tiles, population)
        if change is not None:
            parts["arrangement"] = max(1 - change, 0.0)
        values["copied"] = _find_copies(examination, tiles, population)
    bending = _rate_bending(examination)
    if bending is not None:
        parts["misplacement_ratio"] = bending
    values["survival"] = _rate_survival(examination)
    values["score"] = min(parts.values())
    unseen = "not applicable: the texture does not visibly vary from tile to tile"
    why = {"survival": "not scored: the references show no odd cell"}
    if population.varies:
        why["arrangement"] = f"undecided: fewer than {_LEAST_PAIRS} pairs of tiles at each lag"
        why["copied"] = "undecided: the sample shows too few whole tiles"
    reasons = {name: why.get(name, unseen) for name, value in values.items() if value is None}
    return Score(values, reasons, records={"parts": parts, "sources": population.sources})


def _score_few(tiles: Tiles, population: Population) -> Score:
    """Return a score of 0 if most windows of half a tile look the same and the references' do not, else none."""
    values: dict[str, Value] = dict.fromkeys(Randomness.columns)
    distances = tiles.compare_windows()[0]
    if population.varies and population.differences.size and distances.size and np.median(distances) < _SAME:
        _, values["repetition"], values["returning"] = _rate_repetition(tiles, population)
        values["score"] = 0.0
    few = f"undecided: fewer than {_LEAST_TILES} whole tiles to compare"
    return Score(values, {name: few for name, value in values.items() if value is None})


def _rate_repetition(tiles: Tiles, population: Population) -> tuple[float, float, float]:
    """Return the score of repetition, the share of twins times the sources, and the share that returns at one lag.

    Where k of n pairs at a lag are twins, max(2 k - n, 0) windows return: none if half of the pairs are twins.
    """
    distances, lags = tiles.compare_windows()
    limit, middle, chance = population.twins
    if not distances.size:
        return 1.0, 0.0, 0.0
    near = distances < limit * np.clip(np.median(distances) / middle, limits.LEAST_SCALE, 1)
    share = float(near.mean()) - chance
    _, number = np.unique(lags, return_inverse=True)
    pairs, twins = np.bincount(number), np.bincount(number, near)
    often = pairs >= limits.RETURNING
    returning = float(np.maximum(2 * twins - pairs, 0)[often].sum() / max(pairs[often].sum(), 1))
    count = max(len(tiles.features), 3)
    strewn = np.clip(math.log(1 / max(share, 1e-9)) / math.log(count), 0, 1)
    return (
        min(float(strewn), max(1 - math.sqrt(returning * population.sources), 0.0)),
        share * population.sources,
        returning,
    )


def _rate_arrangement(tiles: Tiles, population: Population) -> float | None:
    """Return the largest change of a correlation at a lag, beyond what chance explains; None if no lag has pairs."""
    usual, variance = population.arrangement
    gap = np.abs(population.arrange(tiles) - usual)
    if not np.isfinite(gap).any():
        return None
    variance = np.maximum(variance, 1 / len(tiles.features))
    allowed = np.maximum(limits.ARRANGED, limits.ARRANGED_DEVIATIONS * np.sqrt(variance))
    change = np.maximum(gap - allowed, 0) / np.maximum(1 - allowed, 0.3)
    return float(np.nan_to_num(change).max(initial=0.0))


def _rate_bending(examination: Examination) -> float | None:
    """Return the score of the bending of the output beside the references'; None where the geometry does not vary."""
    usual = np.array([picture.bending for picture in examination.reference.pictures])
    if usual.mean() < limits.AMPLITUDE or examination.reference.from_sample:
        return None
    ratio = math.log(max(examination.followed.bending, 1e-3) / float(usual.mean()))
    allowed = max(limits.AMPLITUDE_TOLERANCE, limits.DEVIATIONS * float(np.log(usual).std(ddof=1)))
    return math.exp(-max(abs(ratio) - allowed, 0.0))


def _find_copies(examination: Examination, tiles: Tiles, population: Population) -> float | None:
    """Return the share of windows of half a tile that have a twin at an equal place of the sample."""
    sample = np.ascontiguousarray(examination.observation.sample, np.float32)
    sources = _cut_sample(examination.reference, sample.tobytes(), sample.shape)
    if sources is None:
        return None
    limit = population.twins[0]
    pairs = [(a, b) for (a, _), (b, _) in zip(tiles.quarters, sources.quarters, strict=True) if len(a) and len(b)]
    near = [(_square_distances(a, b) < limit).any(1) for a, b in pairs]
    return float(np.concatenate(near).mean()) if near else None


@lru_cache(maxsize=2)
def _cut_sample(reference: TextureReference, pixels: bytes, shape: tuple[int, ...]) -> Tiles | None:
    """Return the tiles of a sample; cached, because many outputs have one sample."""
    try:
        followed = reference.follow(perceive(np.frombuffer(pixels, np.float32).reshape(shape)))
    except CannotTell:
        return None
    return Tiles(CoarsePlane(*followed.residual, followed.net.samples))


def _rate_survival(examination: Examination) -> float | None:
    """Return the share of odd cells, whose misfit stands out, over that of the references; None if there is none."""
    reference, followed = examination.reference, examination.followed
    usual = np.log(np.concatenate([picture.misfit[picture.valid] for picture in reference.pictures]))
    middle = float(np.median(usual))
    odd = middle + limits.ODD * max(float(np.median(np.abs(usual - middle))), 1e-6)
    share = float((usual > odd).mean())
    own = np.log(np.maximum(followed.misfit[followed.valid], 1e-9))
    return float((own > odd).mean()) / share if share > limits.SURE_SHARE else None
