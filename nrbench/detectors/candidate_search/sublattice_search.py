"""The search for lattices: pairs of autocorrelation peaks propose lattices, which are replaced by finer ones."""

from __future__ import annotations

import itertools
import statistics
from collections.abc import Iterable
from dataclasses import dataclass, field
from functools import cache

import numpy as np

from nrbench.detectors.autocorrelation.lattice_evidence import (
    INDICES,
    Agreement,
    LatticeEvidence,
    finer_bases,
    highest_added,
)
from nrbench.detectors.autocorrelation.peaks import (
    UNIT,
    dilate,
    find_prominent_peaks,
    fit_multiples,
    quantize_correlation,
    subpixel,
)
from nrbench.detectors.autocorrelation.vector_pair_kernels import mean_correlations
from nrbench.lattice.geometry import Points, hermite_matrices, reduce_bases

PEAKS = 80
"""Number of the most prominent peaks that are paired."""
FITTED = 24
"""Number of the best pairs that are fitted."""
STARTS = 8
"""Number of the best of these lattices from which finer ones are searched."""
MIN_EXPLAINED = 0.01
"""Least share of the variance that is explained by a lattice from which finer ones are searched."""
MAX_LOSS = 0.08
"""A finer lattice replaces a coarser one if the correlation at the vectors that it adds is lower by no more than this
share. Differences from tile to tile are not a loss, because they also occur between the coarser tiles."""
TILE_ALLOWANCE = 1.0
"""The loss may be larger by this number divided by the number of tiles: few tiles agree by chance."""
MAX_Z = 4.0
"""A finer lattice also replaces a coarser one if the correlation at the vectors that it adds is lower by no more than
this number of standard deviations of the correlations at single vectors, and if it stands out (:data:`APART`). If a few
long threads or rows match by chance, a supercell consists of the best of widely scattered vectors. If tiles truly
alternate, the correlations at its vectors are separate from all others."""
MIN_CONTRAST = 0.08
"""A lattice is stable if the correlation at its multiples exceeds that at the vectors that any finer lattice adds by
this share. Otherwise its multiples lie on a ridge, as in stripes, and any other vector along the ridge agrees, too."""
FURTHEST = 0.55
"""Candidates lie within this share of the image's sides. Longer vectors have no multiple within the image."""
RATED = 0.6
"""Multiples within this share of the sides are rated."""
SHORTEST = 2.6
"""px; least length of a vector. Shorter vectors lie within one period of any sampled pattern."""
DEPTH = 8
"""Largest number of steps from coarser to finer lattices. No candidate has an index of 2^8."""
MOST = 60
"""Largest number of lattices that are visited from one start. It ends the search along a long ridge."""
BRANCHES = 4
"""Largest number of finer lattices that are followed from one lattice: those of the highest correlation."""
APART = 0.4
"""A finer lattice stands out if its mean correlation lies above this share of the way from the usual mean of finer
lattices to the mean of the coarser one."""
FEW = 10.0
"""Number of vectors for which twice as many standard deviations are allowed, because their scatter is uncertain."""
NEARLY = 0.03
"""A finer lattice is fitted and rated again if it misses the limit by at most this and :data:`NEARLY_SHARE`."""
NEARLY_SHARE = 0.3
"""The largest such miss, as a share of the coarser one's correlation. Without it, all finer lattices of a faint one
would be fitted, which takes half a minute at 512 x 512."""


def propose_lattices(evidence: LatticeEvidence) -> list[Points]:
    """Return the fitted ``(2, 2)`` bases of the best pairs of peaks, the one of the highest merit first, each once.

    A pair is rated by its :meth:`LatticeEvidence.explained_variance_loo`, with the highest correlation within one pixel
    of each multiple. This is accurate enough to select the pairs that are fitted.
    """
    vectors = _find_prominent_vectors(evidence)
    if len(vectors) < 2:
        return []
    rated = mean_correlations(quantize_correlation(dilate(evidence.gamma, 1)), vectors, float(UNIT), RATED)
    pairs, repeated = rated[:, :4].reshape(-1, 2, 2), rated[:, 4]
    tiles = evidence.shape[0] * evidence.shape[1] / np.abs(np.linalg.det(pairs))
    explained = repeated - (1 - repeated) / (tiles - 1)
    order = np.argsort(-explained, kind="stable")
    bases: dict[bytes, Points] = {}
    seen: set[bytes] = set()
    for basis in reduce_bases(pairs[order[explained[order] > 0]]):
        if len(bases) == FITTED:
            break
        if _key(basis, 1.0) not in seen:
            seen.add(_key(basis, 1.0))
            fitted = evidence.fit(basis)
            bases.setdefault(_key(fitted, 0.5), fitted)
    return _sort_by_merit(evidence, bases.values())[:STARTS]


def find_stable(evidence: LatticeEvidence, bases: list[Points]) -> list[Points]:
    """Return the fitted bases of the stable lattices that are reached from the given ones, by merit.

    A finer lattice explains little more than the one from which it is reached, so lattices that explain too little
    (:data:`MIN_EXPLAINED`) are left out. If all do, only the best one is used.
    """
    search = SublatticeSearch(evidence)
    ordered = _sort_by_merit(evidence, bases)
    used = [basis for basis in ordered if evidence.explained_variance_loo(basis) >= MIN_EXPLAINED] or ordered[:1]
    stable = [search.find_finest(basis) for basis in used if evidence.merit(basis) > 0]
    return _sort_by_merit(evidence, [basis for basis in stable if basis is not None])


def _sort_by_merit(evidence: LatticeEvidence, bases: Iterable[Points]) -> list[Points]:
    return sorted(bases, key=lambda basis: -evidence.merit(basis))


def _find_prominent_vectors(evidence: LatticeEvidence) -> Points:
    """Return the most prominent peaks, fitted to their own multiples, ``(n, 2)`` px in ascending length."""
    gamma, (height, width) = evidence.gamma, evidence.shape
    reach = min(int(FURTHEST * width), width - 4), min(int(FURTHEST * height), height - 4)
    if min(reach) < 1:
        return np.zeros((0, 2))
    peaks = find_prominent_peaks(gamma, reach)
    order = np.argsort(-peaks.prominences, kind="stable")[:PEAKS]
    vectors = fit_multiples(gamma, subpixel(gamma, peaks.lags[order]), reach)
    lengths = np.hypot(*vectors.T)
    order = np.argsort(lengths, kind="stable")
    return np.ascontiguousarray(vectors[order[lengths[order] >= SHORTEST]])


def _key(basis: Points, grain: float) -> bytes:
    return np.rint(basis / grain).astype(np.int64).tobytes()


def ridge_height(evidence: LatticeEvidence, basis: Points) -> float:
    """Return the mean correlation that finer lattices of every index reach at the vectors that they add.

    Along a ridge, as in stripes, any vector agrees. If a cell consists of two similar halves, only lattices of even
    index agree.
    """
    return min(highest_added(evidence, basis, (index,)) for index in INDICES)


Finer = tuple[Agreement, Points]
"""A finer lattice: the agreement at the vectors that it adds, and its basis."""


@dataclass
class SublatticeSearch:
    """The rule by which a finer lattice replaces a coarser one.

    Parameters
    ----------
    evidence
        The image's autocorrelation.
    """

    evidence: LatticeEvidence
    _visited: dict[bytes, Points | None] = field(default_factory=dict, init=False)

    def find_finest(self, basis: Points) -> Points | None:
        """Return the fitted basis of the finest stable lattice reached from this one; None if no lattice is stable."""
        return self._visit(basis, 0, len(self._visited) + MOST)

    def _visit(self, basis: Points, depth: int, most: int) -> Points | None:
        key = _key(basis, 0.5)
        if key not in self._visited and len(self._visited) < most:
            self._visited[key] = None
            self._visited[key] = self._descend(basis, depth, most)
        return self._visited.get(key)

    def _descend(self, basis: Points, depth: int, most: int) -> Points | None:
        own = self.evidence.agreement(basis)
        rated = self._rate_finer(basis, own)
        if depth < DEPTH:
            for _, candidate in self._replacements(rated, basis, own)[:BRANCHES]:
                below = self._visit(candidate, depth + 1, most)
                if below is not None:
                    return below
        highest = max(agreement.mean for agreement, _ in rated)
        if own.mean <= 0 or own.mean - highest < MIN_CONTRAST * own.mean:
            return None
        return self.evidence.fit(basis)

    def _rate_finer(self, basis: Points, own: Agreement) -> list[Finer]:
        """Return all finer lattices. Those that reach the limit, or miss it by little, are fitted."""
        limit = self._limit(basis, own) - min(NEARLY, NEARLY_SHARE * abs(own.mean))
        rated = []
        bases = finer_bases(basis)
        for candidate, added in zip(bases, self.evidence.agreements(bases, basis), strict=True):
            if added.mean >= limit and np.hypot(*candidate[0]) >= SHORTEST:
                fitted = self.evidence.fit(candidate)
                better = self.evidence.agreement(fitted, basis)
                if better.mean > added.mean:
                    added, candidate = better, fitted
            rated.append((added, candidate))
        return rated

    def _limit(self, basis: Points, own: Agreement) -> float:
        return own.mean * (1 - MAX_LOSS - TILE_ALLOWANCE / self.evidence.tiles(basis))

    def _replacements(self, rated: list[Finer], basis: Points, own: Agreement) -> list[Finer]:
        """Return the finer lattices that may replace the coarser one, by descending correlation."""
        limit = self._limit(basis, own)
        usual = _usual_mean(rated)
        replacements = []
        for added, candidate in rated:
            spread = np.sqrt((own.variance + added.variance) / 2)
            above, below = added.mean - usual, own.mean - added.mean
            near = above > APART * (above + below) and below <= MAX_Z * spread * (1 + FEW / max(own.lags, 1))
            if (added.mean >= limit or near) and np.hypot(*candidate[0]) >= SHORTEST:
                replacements.append((added, candidate))
        return sorted(replacements, key=lambda finer: -finer[0].mean)


def _usual_mean(rated: list[Finer]) -> float:
    """Return the median over the indices of the highest mean; along a ridge it is the same for every index."""
    means = [added.mean for added, _ in rated]
    starts = _first_of_each_index()
    return statistics.median(max(means[start:end]) for start, end in itertools.pairwise(starts))


@cache
def _first_of_each_index() -> list[int]:
    return [0, *itertools.accumulate(len(hermite_matrices(index)) for index in INDICES)]
