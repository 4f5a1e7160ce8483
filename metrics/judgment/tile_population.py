"""The tiles of a picture, and the population of the tiles of a reference, with which those of outputs are compared."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass
from functools import cached_property, lru_cache

import numpy as np
import scipy.spatial.distance
from numpy.typing import NDArray

from ..perception import limits
from ..registration.coarse_plane import CoarsePlane, shift_plane
from ..registration.lattice_net import Mask, split_cells
from .texture_reference import TextureReference

Features = NDArray[np.float64]
"""``(n, 48)``: residual colors of a tile on 4 x 4 places."""
_LAGS = ((1, 0), (0, 1), (1, 1), (1, -1), (2, 0), (0, 2), (2, 2), (2, -2), (3, 0), (0, 3))
"""Lags, in cells, at which the tones of tiles are compared."""
LEAST_PAIRS = 8
"""Least number of pairs of tiles at a lag."""
_COMPONENTS, _ARRANGED_COMPONENTS = 12, 3
"""Number of principal components of the features in distances, and in the arrangement."""
_MOST_TILES = 400
"""Largest number of tiles of which all pairs are compared; the first ones if there are more."""
LEAST_TILES = 4
"""Least number of whole tiles that are compared."""
SAME = (limits.VARIES * limits.JND) ** 2
"""Mean squared difference below which nobody tells two windows apart."""


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

    @cached_property
    def _square_distances(self) -> list[NDArray[np.float64]]:
        return [square_distances(windows, windows) for windows, _ in self.quarters]

    def compare_windows(self) -> tuple[NDArray[np.float64], NDArray[np.intp]]:
        """Return the mean squared difference of all pairs of windows, and a number for the lag of each."""
        distances, lags, (rows, columns) = [], [], self.plane.whole.shape
        for part, ((_, cells), square) in enumerate(zip(self.quarters, self._square_distances, strict=True)):
            first, second = np.triu_indices(len(cells), 1)
            distances.append(square[first, second])
            lag = cells[second] - cells[first]
            lags.append(((lag[:, 0] + rows) * 2 * columns + lag[:, 1] + columns) * 4 + part)
        return np.concatenate(distances), np.concatenate(lags).astype(np.intp)

    def scatter_twins(self, limit: float) -> float:
        """Return the variance, from window to window, of the share of windows nearer than a limit, beyond chance."""
        found = []
        for square in self._square_distances:
            if len(square) > 2:
                share = ((square < limit).sum(1) - 1) / (len(square) - 1)
                found.append(share.var() - share.mean() * (1 - share.mean()) / (len(square) - 1))
        return max(float(np.mean(found)), 0.0) if found else 0.0


def square_distances(a: NDArray[np.float32], b: NDArray[np.float32]) -> NDArray[np.float64]:
    """Return the mean squared differences of the windows of two sets, ``(n, d)`` and ``(m, d)``: ``(n, m)``."""
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
        if len(self.features) >= LEAST_TILES:
            return float(self.features.var(0, ddof=1).mean())
        return float(np.median(self.differences)) / 2 if self.differences.size else math.inf

    @cached_property
    def differences(self) -> NDArray[np.float64]:
        """Mean squared differences of all pairs of windows of half a tile."""
        return np.concatenate([tiles.compare_windows()[0] for tiles in self.tiles])

    @property
    def varies(self) -> bool:
        """Whether an eye sees that the tiles differ."""
        return self.energy > SAME

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
                    if len(part) >= LEAST_TILES:
                        yield part

    @cached_property
    def _energies(self) -> tuple[float, NDArray[np.float64]]:
        """Standard deviation of the rated energy of parts of the references, and energies of tiles over their mean."""
        own = ((self.features - self.features.mean(0)) ** 2).mean(1)
        return float(np.std([self.rate_energy(part) for part in self._cut()] or 0)), own / max(own.mean(), 1e-9)

    def rate_energy(self, features: Features) -> float:
        """Return the logarithm of the energy of tiles over that of the references, with the least visible one added."""
        return math.log((float(features.var(0, ddof=1).mean()) + SAME) / (self.energy + SAME))

    def rate_variation(self, features: Features, sample: Features | None = None) -> float:
        """Return the score of the energy of tiles: the smaller over the larger, beyond what chance explains.

        Chance explains a difference of three standard deviations over parts of the references, or of a mean over as
        many independent tiles as the output or the sample has, or of the lines of tiles of a sample and an output, if
        that is more. From the interval between the references and the sample from which a method has made the tiles,
        only the number of these tiles counts.
        """
        level, (spread, own) = self.rate_energy(features), self._energies
        single = float(own.std())
        spread = max(
            spread / (self.parts if self.from_sample else 1),
            single / math.sqrt(min(len(features), self.sources)),
            self._scatter_lines(own, len(features)) if self.from_sample else 0,
        )
        change = abs(level) - max(limits.TOLERANCE, limits.DEVIATIONS * spread)
        if sample is not None:
            shown = self.rate_energy(sample)
            away = max(level - max(shown, 0.0), min(shown, 0.0) - level)
            change = min(change, away - max(limits.TOLERANCE, limits.DEVIATIONS * single / math.sqrt(len(features))))
        return math.exp(-max(change, 0.0))

    def _scatter_lines(self, energies: NDArray[np.float64], count: int) -> float:
        """Return the deviation by which mean energies of a sample and of ``count`` tiles differ if only lines scatter.

        A line of cells along a lattice vector may be a thread, whose tiles are alike.
        """
        found = []
        for number in np.argwhere(self.tiles[0].grid[1]).T:
            held = np.bincount(number)
            means = (np.bincount(number, energies) / np.maximum(held, 1))[held > 0]
            found.append(float(means.std(ddof=1)) / math.sqrt(len(means)) if len(means) > 1 else 0.0)
        return max(found) * math.sqrt(1 + len(energies) / count)

    @cached_property
    def _usual(self) -> tuple[NDArray[np.float64], float]:
        points = self.project(self.features)[: 2 * _MOST_TILES]
        return points, _mean_distance(points, points)

    def measure_distance(self, features: Features, sample: Features | None = None) -> float:
        """Return the energy distance between tiles and those of the references, over twice their mean distance.

        It is E|x - y| - (E|x - x'| + E|y - y'|) / 2 over E|x - y| (Székely and Rizzo 2004), about 0 for equal
        distributions and at most 1. With the sample from which a method has made the tiles, y is of the mixture
        (1 - t) of the references and t of the sample that is nearest: the energy distance is a quadratic in t. Of more
        than 800 tiles of an output, 800 at even steps are compared.
        """
        points, within = self._usual
        own = self.project(features)
        if len(own) > 2 * _MOST_TILES:
            own = own[np.linspace(0, len(own) - 1, 2 * _MOST_TILES).astype(np.intp)]
        between, alone = _mean_distance(own, points), _mean_distance(own, own)
        if sample is not None:
            source = self.project(sample)
            far, shown, across = (_mean_distance(source, other) for other in (own, source, points))
            bend = max(2 * across - within - shown, 1e-9)
            part = float(np.clip((between - far + across - within) / bend, 0, 1))
            within = (1 - part) ** 2 * within + 2 * part * (1 - part) * across + part**2 * shown
            between = (1 - part) * between + part * far
        return float(1 - (alone + within) / (2 * max(between, 1e-9)))

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
        limit = max(float(np.quantile(distances, min(limits.TWINS / self.sources, 0.5))), SAME)
        return limit, float(np.median(distances)), float((distances < limit).mean())

    @cached_property
    def _scatter_twins(self) -> float:
        return float(np.mean([tiles.scatter_twins(self.twins[0]) for tiles in self.tiles]))

    def allow_twins(self, count: int) -> float:
        """Return the share of twins, beyond that of the references, that chance explains in ``count`` tiles.

        Where elements are alike, as in a print of two inks, twins are no repetition, and their share has the variance
        of a U-statistic (Hoeffding 1948), 4 v / n + 2 t (1 - t) / n^2, with the share t of twins by chance and the
        variance v of the twins of single windows: in the n tiles of an output, and in those of the sample.
        """
        chance = self.twins[2]
        often = max(chance - limits.TWINS / self.sources, 0.0)
        pairs = often * (1 - often)
        single = min(self._scatter_twins, pairs)
        variance = sum(4 * single / n + 2 * pairs / n**2 for n in (count, self.sources))
        return min(limits.DEVIATIONS * math.sqrt(variance), 1 - chance)

    def arrange(self, tiles: Tiles) -> NDArray[np.float64]:
        """Return the correlations of the first components of tiles at ten lags, ``(10, 3)``; NaN without pairs."""
        values, whole = tiles.grid
        axes = self._axes[:, :_ARRANGED_COMPONENTS]
        points = (values - values[whole].mean(0)) @ axes
        power = (points[whole] ** 2).mean(0) + 0.05
        found = np.full((len(_LAGS), axes.shape[1]), np.nan)
        for row, lag in zip(found, _LAGS, strict=True):
            other, both = shift_plane(points, whole, lag)
            if both.sum() >= LEAST_PAIRS:
                row[:] = (points * other)[both].mean(0) / power
        return found

    @cached_property
    def arrangement(self) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Mean of the correlations over the references, and the variance of each component's, mean over the lags.

        The mean is NaN at the lags that a reference lacks. The variance in one sample is that of its pairs at each lag.
        """
        found = np.array([self.arrange(tiles) for tiles in self.tiles])
        chance = 1 / max(float(np.mean([len(tiles.features) for tiles in self.tiles])), 1.0)
        mean = found.mean(0)
        known = np.isfinite(mean).all(1)
        if len(found) == 1 or not known.any():
            whole = self.tiles[0].grid[1]
            both = [shift_plane(whole.astype(np.float32), whole, lag)[1].sum() for lag in _LAGS]
            pairs = np.maximum(1 / np.maximum(both, 1), chance)[:, np.newaxis]
            return mean, np.broadcast_to(pairs + chance, mean.shape)
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
    tiles = [Tiles(CoarsePlane(fine, known, net.samples)) for fine, known in reference.shown]
    box = np.abs(net.vectors).sum(0)[::-1]
    sources = float(np.maximum(reference.sample_shape - box, 1).prod()) / abs(float(np.linalg.det(net.vectors)))
    side = min(a / b for a, b in zip(net.shape, reference.sample_shape, strict=True))
    parts = 2 if reference.from_sample else max(round(side), 1)
    return Population(tiles, max(sources, 1.5), parts, reference.from_sample)
