"""Lattice detection by regions of dominance: the shortest pair of vectors that explains the dominant peaks."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import ClassVar, Literal, NamedTuple

import numpy as np
import scipy.special
from numpy.typing import NDArray

from nrbench.detectors.agreement.evidence import Evidence
from nrbench.detectors.agreement.sublattice_search import highest_between
from nrbench.detectors.autocorrelation.dominance_kernels import rate_pairs
from nrbench.detectors.autocorrelation.peaks import UNIT, find_peaks, subpixel
from nrbench.detectors.autocorrelation.refinement import fit_multiples, fit_pair
from nrbench.detectors.autocorrelation.regions import dominance
from nrbench.detectors.chance.excerpt import excerpt
from nrbench.detectors.chance.surrogates import chance, upper_limit
from nrbench.errors import checker
from nrbench.imaging.convert import Image
from nrbench.imaging.correlation import Correlation, half_autocorrelation
from nrbench.lattice.geometry import Lattice, Points
from nrbench.plugins.forms import Detection, NoLatticeFound, Surface
from nrbench.streams import pixels_hash, stream

MULTIPLES = 200
"""So many points of a lattice, the nearest to lag 0, are compared with peaks: enough, however large the image."""
STRIPES = 0.08
"""Where a finer lattice adds vectors at which the correlation is lower by less than this share, the peaks of the coarse
one lie on a ridge: a grating's."""
LEVELS = 5
"""Thresholds of prominence that are tried, each half the one before."""
QUANTILE = 2.326
"""Rates of hits differ where the 1 % and 99 % bounds of a normal law do not overlap."""
SAME_CELL = 1.5
"""Cells whose areas differ by less than this factor are as small as each other: the next coarser lattice has twice."""


class Ranking(NamedTuple):
    """Peaks ``(n, 2)`` px, the most dominant first, the correlation there, and vectors ``(k, 2)`` px to be paired."""

    peaks: Points
    values: NDArray[np.float64]
    candidates: Points


class Pairs(NamedTuple):
    """Reduced pairs of vectors ``(m, 2, 2)`` px, one a lattice: the areas of their cells, px^2, and what they explain.

    ``evidence``, in nats, is that of ``hits`` among ``multiples``; ``low`` and ``high`` bound the share of hits beyond
    chance; ``peaks`` are those compared with, the most dominant first.
    """

    vectors: Points
    areas: NDArray[np.float64]
    multiples: NDArray[np.float64]
    hits: NDArray[np.float64]
    support: NDArray[np.float64]
    low: NDArray[np.float64]
    high: NDArray[np.float64]
    evidence: NDArray[np.float64]
    peaks: Points


class Choice(NamedTuple):
    """One of several pairs."""

    pairs: Pairs
    row: int

    def get(self, name: str) -> float:
        """Return what there is of that name for the pair."""
        return float(getattr(self.pairs, name)[self.row])


@dataclass(frozen=True)
class Dominance:
    """Regions of dominance: the dominant peaks of the autocorrelation, and the pair of vectors that explains them.

    From the paper (Liu, Collins and Tsin, section on lattices): peaks of the autocorrelation are ranked not by height
    but by their region of dominance, the largest disk around each that holds no higher peak; the lattice is generated
    by the shortest independent vectors that explain the dominant ones, found by votes as Lin, Wang and Yang (1997) do.

    Inferred: how many peaks are dominant, and what explains them. A lattice that has n points within reach is compared
    with the n most dominant peaks there; those within ``tolerance`` of one of its points are hits. A lattice too fine
    has points without a peak, one too coarse has dominant peaks elsewhere: no number of peaks is to be set. Hits must
    be likelier at their own rate than by chance (n times the Kullback-Leibler divergence of the rate from the share of
    the plane that lies within the tolerance) by more than the logarithm of the number of pairs tried over
    ``false_alarms``. Of these, all whose rate is no worse than the best as far as counts can tell (Wilson's 1 % and
    99 % bounds overlap) explain the peaks, and the smallest cell is taken. Pairs are made of the ``candidates`` peaks
    whose regions are largest for their lengths.

    The confidence is the lower bound of the share of hits, from what chance would give (0) to all (1).

    It is meant to judge, where a photograph has no given lattice: no synthesizer should find its lattice by it.

    Parameters
    ----------
    prominence
        Only peaks count that stand above the highest pass to a higher one by this share of the most prominent peak's:
        else the bumps of noise between the lattice's peaks, which dominate regions too, make it too fine. On a ridge
        (the rows of a wall) only the highest peak stands high above any pass, so smaller shares are tried as well, each
        half the one before: the largest counts at which a pair explains the peaks as well as at any.
    candidates
        So many peaks are paired.
    tolerance
        Largest distance of a hit, as a share of the shortest vector, in (0, 0.5); at least 1 px.
    subpixel
        Fit candidates, and at last the pair, to the peaks at their multiples, to fractions of a pixel.
    reject
        ``"none"``: answer wherever there is a pair. ``"surrogate"``: no lattice where its support does not exceed that
        of phase-randomized copies of the image (of its middle, where it is large): the sum of correlations at the hits
        over the root of the number of points, which fades where what repeats does not do so far away.
    surrogates
        Number of phase-randomized copies.
    false_alarms
        Probability at which a phase-randomized copy would be taken for a lattice.
    """

    prominence: float = 0.25
    candidates: int = 24
    tolerance: float = 0.15
    subpixel: bool = True
    reject: Literal["none", "surrogate"] = "surrogate"
    surrogates: int = 30
    false_alarms: float = 0.01

    version: ClassVar[str] = "1"
    paper: ClassVar[str] = """@article{liu2004computational,
  author  = {Liu, Yanxi and Collins, Robert T. and Tsin, Yanghai},
  title   = {A Computational Model for Periodic Pattern Perception Based on Frieze and Wallpaper Groups},
  journal = {IEEE Transactions on Pattern Analysis and Machine Intelligence},
  volume  = {26},
  number  = {3},
  pages   = {354--371},
  year    = {2004},
}"""

    def __post_init__(self) -> None:
        _check(0 <= self.prominence < 1, f"prominence is {self.prominence}; give a share from 0 to below 1")
        _check(self.candidates >= 2, f"candidates is {self.candidates}; give at least 2")
        _check(0 < self.tolerance < 0.5, f"tolerance is {self.tolerance}; give a share between 0 and 0.5")
        _check(self.reject in ("none", "surrogate"), f"reject is {self.reject!r}; give none or surrogate")
        _check(self.surrogates >= 2, f"surrogates is {self.surrogates}; give at least 2")
        _check(0 < self.false_alarms < 1, f"false_alarms is {self.false_alarms}; give a probability, e.g. 0.01")

    def detect(self, image: Image) -> Detection:
        """Return the lattice of ``image``; its origin is (0, 0), the method finds no phase.

        Diagnostics: ``correlation`` (right half, with the dominant peaks and the pair), ``evidence``, ``support``,
        ``multiples`` and ``hits`` (numbers); where tested, ``tested_support``, ``surrogate_support`` and ``limit``.

        Raises
        ------
        NoLatticeFound
            Where the image is constant, has too few peaks, or, unless ``reject`` is ``"none"``, the dominant peaks lie
            no better on a lattice than by chance.
        """
        if np.ptp(image, (0, 1)).max() == 0:
            raise NoLatticeFound("the image is constant: it has no texture")
        gamma = half_autocorrelation(image)
        best = self._search(gamma)
        if best is None:
            raise NoLatticeFound("no two peaks of the autocorrelation could generate a lattice")
        found = self._detection(gamma, best)
        return found if self.reject == "none" else self._tested(image, found)

    def _rankings(self, gamma: Correlation, reach: tuple[int, int]) -> list[Ranking]:
        """Return the peaks at each threshold of prominence, by their regions of dominance, the highest first."""
        found = find_peaks(gamma, reach)
        spots = subpixel(gamma, found.lags) if self.subpixel else found.lags.astype(np.float64)
        thresholds = self.prominence * found.prominences.max(initial=0) / 2.0 ** np.arange(LEVELS)
        kept = [np.flatnonzero(found.prominences >= threshold) for threshold in thresholds]
        kept = [some for i, some in enumerate(kept) if i == 0 or len(some) > len(kept[i - 1])]
        orders = [_ranked(spots[some], found.values[some], self.candidates) for some in kept]
        paired = np.unique(np.concatenate([some[best] for some, (_, best) in zip(kept, orders, strict=True)]))
        vectors = spots.copy()
        if self.subpixel:
            vectors[paired] = fit_multiples(gamma, spots[paired], reach)
        return [
            Ranking(spots[some[order]], found.values[some[order]], vectors[some[best]])
            for some, (order, best) in zip(kept, orders, strict=True)
        ]

    def _search(self, gamma: Correlation) -> Choice | None:
        """Return the shortest pair that explains the dominant peaks; None where there is no pair better than chance."""
        reach = _reach(gamma)
        levels = [self._rated(ranking, reach) for ranking in self._rankings(gamma, reach)]
        needed = np.log(max(sum(len(pairs.areas) for pairs in levels), 1) / self.false_alarms)
        chosen = [choice for pairs in levels if (choice := _smallest(pairs, needed))]
        lowest = max((choice.get("low") for choice in chosen), default=0.0)
        explained = next((choice for choice in chosen if choice.get("high") >= lowest), None)
        return explained or _likeliest(levels)

    def _rated(self, ranking: Ranking, reach: tuple[int, int]) -> Pairs:
        """Return every pair of candidates with its hits; its own two vectors, peaks by choice, are none."""
        heights = np.rint(ranking.values * UNIT).astype(np.int64)
        rows = rate_pairs(
            ranking.peaks, heights, ranking.candidates, np.array(reach, np.float64), self.tolerance, MULTIPLES
        )
        vectors, (multiples, hits, sums) = rows[:, :4].reshape(-1, 2, 2), rows[:, 4:].T
        areas = np.abs(vectors[:, 0, 0] * vectors[:, 1, 1] - vectors[:, 0, 1] * vectors[:, 1, 0])
        radii = np.maximum(self.tolerance * np.hypot(*vectors[:, 0].T), 1)
        shares = np.minimum(np.pi * radii**2 / areas, 0.99)
        trials, found = np.maximum(multiples - 2, 0), np.maximum(hits - 2, 0)
        low, high = ((bound - shares) / (1 - shares) for bound in _bounds(found, trials))
        support = sums / UNIT / np.sqrt(np.maximum(multiples, 1))
        evidence = _divergence(found, trials, shares)
        return Pairs(vectors, areas, multiples, hits, support, low, high, evidence, ranking.peaks)

    def _detection(self, gamma: Correlation, best: Choice) -> Detection:
        """Return the lattice of the best pair, fitted, with what led to it."""
        pair = best.pairs.vectors[best.row]
        first, second = fit_pair(gamma, pair, _reach(gamma)) if self.subpixel else pair
        lattice = Lattice.from_basis((first, second)).reduced()
        numbers = {name: best.get(name) for name in ("evidence", "support", "multiples", "hits")}
        dominant = best.pairs.peaks[: int(numbers["multiples"])]
        surface = Surface(gamma, (0, gamma.shape[0] // 2), dominant, np.stack([first, second]))
        return Detection(lattice, min(max(best.get("low"), 0.0), 1.0), {"correlation": surface, **numbers})

    def _tested(self, image: Image, found: Detection) -> Detection:
        """Return what was found, with what it was compared with, unless it is a grating or chance."""
        part, rng = excerpt(image, found.lattice), stream("detection", pixels_hash(image))
        whole = part.shape == image.shape
        reached = found.diagnostics["support"] if whole else self._support(part)
        copies = chance(part, self._support, rng, self.surrogates)
        limit = upper_limit(copies, self.false_alarms)
        more = {"tested_support": reached, "surrogate_support": copies, "limit": limit}
        found = replace(found, diagnostics={**found.diagnostics, **more})
        if reached <= limit:
            raise NoLatticeFound(
                f"the best lattice (support {reached:.2f}) is no better than chance ({limit:.2f})", found
            )
        seen, basis = Evidence(found.diagnostics["correlation"].values), found.lattice.matrix
        if seen.repeated(basis) - highest_between(seen, basis) < STRIPES * seen.repeated(basis):
            raise NoLatticeFound("the peaks are one ridge: stripes, which repeat by any vector along them", found)
        return found

    def _support(self, image: NDArray[np.float32]) -> float:
        """Return the support of an image's best pair; 0 where it has none."""
        best = self._search(half_autocorrelation(image))
        return best.get("support") if best else 0.0


def _reach(gamma: Correlation) -> tuple[int, int]:
    """Return the largest lags that are looked at: three quarters of each side, all but 4 px at most."""
    width, height = gamma.shape[1], gamma.shape[0] // 2 + 1
    return min(width * 3 // 4, width - 4), min(height * 3 // 4, height - 4)


def _ranked(peaks: Points, values: NDArray[np.float64], candidates: int) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Return the order of the peaks by their regions of dominance, and the candidates' by theirs over their lengths."""
    radii, lengths = dominance(peaks, values), np.hypot(*peaks.T)
    relative = np.lexsort((lengths, -radii / np.maximum(lengths, 1e-9)))
    return np.lexsort((-values, -radii)), relative[:candidates]


def _smallest(pairs: Pairs, needed: float) -> Choice | None:
    """Return the pair of the smallest cell of those that explain as much as any, as far as their counts can tell."""
    possible = pairs.evidence > needed
    if not possible.any():
        return None
    explaining = possible & (pairs.high >= pairs.low[possible].max())
    equals = explaining & (pairs.areas < SAME_CELL * pairs.areas[explaining].min())
    return Choice(pairs, int(np.where(equals, pairs.evidence, -1).argmax()))


def _likeliest(levels: Sequence[Pairs]) -> Choice | None:
    """Return the pair of the highest evidence; None where there is none."""
    best = [Choice(pairs, int(pairs.evidence.argmax())) for pairs in levels if pairs.evidence.max(initial=0) > 0]
    return max(best, key=lambda choice: choice.get("evidence"), default=None)


def _bounds(hits: NDArray[np.float64], trials: NDArray[np.float64]) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return Wilson's bounds of the rates of hits at :data:`QUANTILE`; 0 and 1 where nothing was tried."""
    squares = QUANTILE**2 / np.maximum(trials, 1e-9)
    rates = hits / np.maximum(trials, 1)
    middle, half = rates + squares / 2, np.sqrt(squares * (rates * (1 - rates) + squares / 4))
    return (middle - half) / (1 + squares), (middle + half) / (1 + squares)


def _divergence(
    hits: NDArray[np.float64], trials: NDArray[np.float64], shares: NDArray[np.float64]
) -> NDArray[np.float64]:
    """Return how many nats likelier so many hits are at their own rate than at ``shares``; 0 where they are fewer."""
    rates = hits / np.maximum(trials, 1)
    nats = scipy.special.rel_entr(rates, shares) + scipy.special.rel_entr(1 - rates, 1 - shares)
    return np.asarray(np.where(rates > shares, trials * nats, 0.0))


_check = checker("dominance")
