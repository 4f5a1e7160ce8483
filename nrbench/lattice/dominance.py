"""Lattice detection by regions of dominance: the short pair of vectors on whose multiples the dominant peaks lie."""

from __future__ import annotations

import itertools
import math
from dataclasses import dataclass, replace
from typing import ClassVar, Literal, NamedTuple

import numpy as np
import scipy.special
from numpy.typing import NDArray

from nrbench.errors import BadInput
from nrbench.imaging.correlation import Correlation, half_autocorrelation
from nrbench.imaging.door import Image
from nrbench.lattice.detection import Detection, NoLatticeFound, Surface
from nrbench.lattice.excerpt import excerpt
from nrbench.lattice.geometry import Lattice, Points
from nrbench.lattice.peaks import find_peaks, subpixel
from nrbench.lattice.refinement import fit_multiples, fit_pair
from nrbench.lattice.regions import dominance
from nrbench.lattice.surrogates import chance, upper_limit
from nrbench.streams import pixels_hash, stream

MULTIPLES = 200
"""So many points of a lattice, the nearest to lag 0, are compared with peaks: enough, however large the image."""


class Ranking(NamedTuple):
    """Peaks ``(n, 2)`` px, the most dominant first, the correlation there, and vectors ``(k, 2)`` px to be paired."""

    peaks: Points
    values: NDArray[np.float64]
    candidates: Points


class Pair(NamedTuple):
    """A reduced pair of vectors (rows, px): how many multiples, hits among them, and support."""

    evidence: float
    vectors: Points
    multiples: int
    hits: int
    support: float


@dataclass(frozen=True)
class Dominance:
    """Regions of dominance: the dominant peaks of the autocorrelation, and the pair of vectors that explains them.

    From the paper (Liu, Collins and Tsin, section on lattices): peaks of the autocorrelation are ranked not by height
    but by their region of dominance, the largest disk around each that holds no higher peak; the lattice is generated
    by the shortest independent vectors that explain the dominant ones, found by votes as Lin, Wang and Yang (1997) do.

    Inferred: how many peaks are dominant, and what a vote is. A lattice that has n points within reach is compared with
    the n most dominant peaks there; those within ``tolerance`` of one of its points are hits. Its evidence is how much
    likelier the hits are at their own rate than by chance (n times the Kullback-Leibler divergence of the rate from the
    share of the plane that lies within the tolerance, nats). A lattice too fine has points without a peak, one too
    coarse has dominant peaks elsewhere, and both lose evidence: no number of peaks is to be set. Pairs are made of the
    ``candidates`` peaks whose regions are largest for their lengths.

    The confidence is the share of hits, from what chance would give (0) to all (1).

    It is meant to judge, where a photograph has no given lattice: no synthesizer should find its lattice by it.

    Parameters
    ----------
    prominence
        A peak stands above the highest pass to a higher one by this share of the most prominent peak: else the bumps of
        noise between the lattice's peaks, which dominate regions too, make it too fine.
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
        reach = _reach(gamma)
        ranking = self._rank(gamma, reach)
        best = self._search(ranking, reach)
        if best is None:
            raise NoLatticeFound("no two peaks of the autocorrelation could generate a lattice")
        found = self._detection(gamma, ranking, best)
        return found if self.reject == "none" else self._tested(image, found)

    def _rank(self, gamma: Correlation, reach: tuple[int, int]) -> Ranking:
        """Return the peaks by their regions of dominance, and the candidates by theirs over their lengths."""
        found = find_peaks(gamma, reach)
        prominent = found.prominences >= self.prominence * found.prominences.max(initial=0)
        lags, values = found.lags[prominent], found.values[prominent]
        peaks = subpixel(gamma, lags) if self.subpixel else lags.astype(np.float64)
        radii = dominance(peaks, values)
        order = np.lexsort((-values, -radii))
        relative = np.lexsort((np.hypot(*peaks.T), -radii / np.maximum(np.hypot(*peaks.T), 1e-9)))
        candidates = peaks[relative[: self.candidates]]
        return Ranking(
            peaks[order], values[order], fit_multiples(gamma, candidates, reach) if self.subpixel else candidates
        )

    def _search(self, ranking: Ranking, reach: tuple[int, int]) -> Pair | None:
        """Return the pair of the highest evidence, the shortest among equals; None where there is none."""
        lattices = dict[tuple[int, ...], Lattice]()
        for one, other in itertools.combinations(ranking.candidates, 2):
            area = abs(one[0] * other[1] - one[1] * other[0])
            if area > 0.1 * np.hypot(*one) * np.hypot(*other) and area >= 4:
                lattice = Lattice((one[0], one[1]), (other[0], other[1])).reduced()
                lattices.setdefault(tuple(np.rint(lattice.matrix.ravel() * 2).astype(int)), lattice)
        pairs = [self._rate(ranking, lattice, reach) for lattice in lattices.values()]
        best = max(pairs, key=lambda pair: (pair.evidence, -np.abs(pair.vectors).sum()), default=None)
        return best if best and best.evidence > 0 else None

    def _rate(self, ranking: Ranking, lattice: Lattice, reach: tuple[int, int]) -> Pair:
        """Return the evidence for a lattice: hits among as many dominant peaks as it has points."""
        s, area = float(np.hypot(*lattice.matrix[0])), lattice.area
        shrink = min(1.0, math.sqrt(MULTIPLES * area / (2 * reach[0] * reach[1])))
        window = np.array(reach) * shrink
        multiples = _count(lattice, window)
        dominant = np.flatnonzero((np.abs(ranking.peaks) <= window).all(1))[:multiples]
        radius = max(self.tolerance * s, 1.0)
        hits = dominant[np.hypot(*lattice.wrap(ranking.peaks[dominant]).T) <= radius]
        support = float(ranking.values[hits].sum()) / math.sqrt(max(multiples, 1))
        # The two vectors themselves are peaks: they were chosen so.
        share = min(math.pi * radius**2 / area, 1.0)
        return Pair(_divergence(len(hits) - 2, multiples - 2, share), lattice.matrix, multiples, len(hits), support)

    def _detection(self, gamma: Correlation, ranking: Ranking, best: Pair) -> Detection:
        """Return the lattice of the best pair, fitted, with what led to it."""
        first, second = fit_pair(gamma, best.vectors, _reach(gamma)) if self.subpixel else best.vectors
        lattice = Lattice((first[0], first[1]), (second[0], second[1])).reduced()
        share = math.pi * max(self.tolerance * lattice.s, 1.0) ** 2 / lattice.area
        confidence = (best.hits / best.multiples - share) / max(1 - share, 1e-9)
        surface = Surface(gamma, (0, gamma.shape[0] // 2), ranking.peaks[: best.multiples], np.stack([first, second]))
        numbers = {"evidence": best.evidence, "support": best.support, "multiples": best.multiples, "hits": best.hits}
        return Detection(lattice, min(max(confidence, 0.0), 1.0), {"correlation": surface, **numbers})

    def _tested(self, image: Image, found: Detection) -> Detection:
        """Return what was found, with what it was compared with, unless it is chance."""
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
        return found

    def _support(self, image: NDArray[np.float32]) -> float:
        """Return the support of an image's best pair; 0 where it has none."""
        gamma = half_autocorrelation(image)
        best = self._search(self._rank(gamma, _reach(gamma)), _reach(gamma))
        return best.support if best else 0.0


def _reach(gamma: Correlation) -> tuple[int, int]:
    """Return the largest lags that are looked at: three quarters of each side, all but 4 px at most."""
    width, height = gamma.shape[1], gamma.shape[0] // 2 + 1
    return min(width * 3 // 4, width - 4), min(height * 3 // 4, height - 4)


def _count(lattice: Lattice, window: Points) -> int:
    """Return how many lattice points other than 0 are within ``window`` of it along x and y, on one half-plane."""
    shape = (2 * int(window[1]) + 1, 2 * int(window[0]) + 1)
    return (len(lattice.shifted((shape[1] // 2, shape[0] // 2)).points(shape)) - 1) // 2


def _divergence(hits: int, trials: int, share: float) -> float:
    """Return how many nats likelier so many hits are at their own rate than at ``share``; 0 where they are fewer."""
    if trials <= 0 or hits <= share * trials:
        return 0.0
    rate = hits / trials
    return float(trials * (scipy.special.rel_entr(rate, share) + scipy.special.rel_entr(1 - rate, 1 - share)))


def _check(holds: bool, message: str) -> None:
    if not holds:
        raise BadInput(f"dominance: {message}")
