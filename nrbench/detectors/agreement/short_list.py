"""The short list: the lattices that an image may have, what tells them apart, and how probable each of them is."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from nrbench.detectors.agreement.evidence import Evidence
from nrbench.detectors.agreement.evidence_kernels import reduce_all
from nrbench.detectors.agreement.search import SHORTEST, finer_bases, highest_added
from nrbench.detectors.agreement.weights import CHOSEN, WEIGHTS
from nrbench.lattice.geometry import Points, hermite_matrices
from nrbench.lattice.relation import count_cells
from nrbench.plugins.forms import Probabilities, Role

NEIGHBORS = (2, 3, 4)
"""Lattices coarser and finer than the best one by these indices are rated."""
SPLITS = (2, 3)
"""A lattice is compared with coarser lattices of these indices, ..."""
SPLIT_CHANGES = np.concatenate([hermite_matrices(index) for index in SPLITS])
"""... which are these integer matrices times its basis."""
RELIEFS = (2, 3, 5)
"""A lattice is compared with finer lattices of these indices."""
FIRST = 5
"""Number of the best stable lattices that are rated."""
MAX_SIGMAS = 60.0
"""Standard deviations above which the probability does not rise: few lattices of the fit had more."""
FEWEST_LAGS = 3
"""Least number of vectors whose scatter tells a standard error."""
LEAST_ERROR = 1e-3
"""Standard errors below this share of the correlation do not matter."""
MAX_ERRORS = 30.0
"""Standard errors above which an excess is certain."""
SURE_ERRORS = 5.0
"""Standard errors of slopes and edges below which an excess may be chance, and ..."""
MAX_STRUCTURE_ERRORS = 100.0
"""... above which it is certain."""
SMALL_RELIEF = 1 / math.e
"""A lattice of a larger relief is distinct from finer ones in any case."""
BY_LINES = 3.0
"""Standard errors from which an excess is compared with the scatter of lines, too: it takes longer to compute."""
STRUCTURE_LOSS = 0.75
"""Elements differ in structure, and not in color alone, if slopes and edges lose more than this share of what the
colors lose at the vectors that a finer lattice adds. Cloth in two dyes reaches 0.7, cells with two similar halves have
at least 0.8."""
LEAST_CORRELATION = 0.01
"""Losses are shares of a correlation of at least this size."""
TOLERANCE = 1.0
"""px; two lattices are the same if their reduced vectors differ by no more than this, or than ..."""
SHARE = 0.04
"""... this share of s."""
LEAST_SECOND = 0.02
"""A second lattice that is less probable does not matter."""
DETECTORS = ("gncc", "frdft", "dominance")
"""The detectors whose proposals count as votes."""


class Traits(NamedTuple):
    """What tells an exact lattice from a supercell, a subcell and a chance match.

    Parameters
    ----------
    sigmas
        Logarithm of how far the correlation at its multiples lies above chance, in standard deviations.
    tiles
        Logarithm of the image's area in cells.
    relief
        Logarithm of the share of its correlation by which that at the vectors of any finer lattice is lower.
    structure_relief
        The same for slopes and edges alone, not as a logarithm. It is small if only the colors tell tiles apart.
    split_2, split_3
        The share of its correlation by which the correlation at a supercell of this index exceeds that at all its
        other vectors. It is large if the lattice is too fine.
    structure_split
        The largest of these for slopes and edges alone.
    alternation
        Logarithm of the largest excess of a supercell of index 2 or 3, in standard errors of the mean. It is large if
        two elements that differ little alternate: the excess is small then, but the same at all vectors.
    structure_alternation
        The same for slopes and edges alone, over :data:`SURE_ERRORS`; the errors are those of lines
        (:meth:`Evidence.split_error`) if these are larger. It is large if elements of different shape alternate. It is
        0 if they differ in color alone, or by chance.
    distinction
        Logarithm of the least excess, in the same units, of slopes and edges at its multiples over those at the vectors
        that a finer lattice of index 2 or 3 adds. It is large for a cell with two halves that differ little. It is 0
        for a supercell, and where the relief is not small (:data:`SMALL_RELIEF`).
    split_error
        Logarithm of the standard error of the excess of supercells of index 2, as a share of its correlation. It is
        large if noise hides such an alternation.
    merit
        Its merit over that of the best stable lattice.
    best
        1 for the best stable lattice, else 0.
    gncc, frdft, dominance
        1 if the detector proposes this lattice, else 0.
    finer, coarser
        Number of detectors that propose a subcell, and a supercell.
    """

    sigmas: float
    tiles: float
    relief: float
    structure_relief: float
    split_2: float
    split_3: float
    structure_split: float
    alternation: float
    structure_alternation: float
    distinction: float
    split_error: float
    merit: float
    best: float
    gncc: float
    frdft: float
    dominance: float
    finer: float
    coarser: float


class Splits(NamedTuple):
    """How lattices coarser than a given one, of one index, split its multiples.

    Parameters
    ----------
    excesses
        By how much the mean correlation at each exceeds that at all other vectors; -1 where there are none.
    errors
        The standard errors of the excesses; infinite if they are not known.
    bases
        The coarser lattices, ``(n, 2, 2)``.
    """

    excesses: list[float]
    errors: list[float]
    bases: Points


class Rival(NamedTuple):
    """One lattice of the short list.

    Parameters
    ----------
    basis
        Rows (x, y) px, reduced.
    merit
        Its merit, by which stable lattices are ordered.
    traits
        What tells it from its rivals.
    probabilities
        What it is, by itself; the sum of ``exact`` over all rivals may exceed 1.
    role
        Whether this is the lattice of the structure or of the colors; the other one is among the rivals then.
    """

    basis: Points
    merit: float
    traits: Traits
    probabilities: Probabilities
    role: Role = ""


@dataclass(frozen=True)
class ShortList:
    """Rates the lattices that an image may have.

    Parameters
    ----------
    pooled
        The evidence of colors, slopes and edges.
    colors, structure
        The evidence of the colors alone, and that of slopes and edges.
    merit
        The function that rates a basis.
    """

    pooled: Evidence
    colors: Evidence
    structure: Evidence
    merit: Callable[[Points], float]

    def rate(self, stable: Sequence[Points], proposals: Mapping[str, Sequence[Points]]) -> list[Rival]:
        """Return the best stable lattice, its neighbors, and the lattices that any detector proposes; each once.

        Parameters
        ----------
        stable
            The stable lattices, the best first, at least one; all of them possible.
        proposals
            The fitted bases of each detector of :data:`DETECTORS`. Others are rated and are no votes.
        """
        bases: list[Points] = []
        everything = (*stable[:FIRST], *(basis for part in proposals.values() for basis in part))
        for basis in (*everything, *self._neighbors(stable[0])):
            if self.is_possible(basis) and not any(is_same(basis, other) for other in bases):
                bases.append(basis)
        best = max(self.merit(stable[0]), 1e-3)
        rivals = []
        for number, basis in enumerate(bases):
            traits = self._measure(basis, best, number == 0, proposals)
            rivals.append(Rival(basis, self.merit(basis), traits, classify(traits)))
        return rivals

    def is_possible(self, basis: Points) -> bool:
        """Return whether a lattice can be rated.

        The image holds more than two cells, none of them is too thin, and lags within reach show both vectors. If all
        multiples within reach lie on one line, nothing in the image speaks for the other vector.
        """
        if self.pooled.tiles(basis) <= 2 or np.hypot(*basis[0]) < SHORTEST or self.pooled.repeated(basis) <= 0:
            return False
        return self.pooled.spans_plane(basis)

    def _neighbors(self, basis: Points) -> Iterator[Points]:
        """Yield the coarser lattice of each index that splits the given one most, and the best finer one, fitted."""
        for index in NEIGHBORS:
            splits = self._split(self.pooled, basis, index)
            yield splits.bases[int(np.argmax(splits.excesses))]
        for index in NEIGHBORS:
            bases = finer_bases(basis, (index,))
            added = self.pooled.agreements(bases, basis)
            yield self.pooled.fit(bases[int(np.argmax([one.mean for one in added]))])

    def _split(self, evidence: Evidence, basis: Points, index: int) -> Splits:
        """Return by how much the correlation at each supercell of an index exceeds that at all other vectors."""
        changes = hermite_matrices(index)
        excesses, errors = [], []
        for own, others in evidence.split(basis, changes):
            known = min(own.lags, others.lags)
            excesses.append(own.mean - others.mean if known > 0 else -1.0)
            error = math.sqrt(own.variance / max(own.lags, 1) + others.variance / max(others.lags, 1))
            errors.append(max(error, 1e-6) if known >= FEWEST_LAGS else math.inf)
        return Splits(excesses, errors, reduce_all(changes @ basis))

    def differs_in_structure(self, basis: Points, change: NDArray[np.int64]) -> bool:
        """Return whether slopes and edges, too, repeat better by a coarser lattice; else the colors alone do.

        The share of the correlation that is lost at the other vectors is compared (:data:`STRUCTURE_LOSS`).

        Parameters
        ----------
        basis
            Rows (x, y) px.
        change
            ``(2, 2)``: an integer matrix H; the basis of the coarser lattice is H times ``basis``.
        """
        losses = []
        for evidence in (self.structure, self.colors):
            own, others = evidence.split(basis, change[np.newaxis])[0]
            losses.append((own.mean - others.mean) / max(own.mean, LEAST_CORRELATION))
        return losses[0] > STRUCTURE_LOSS * losses[1]

    def _count_errors(self, basis: Points, change: NDArray[np.int64]) -> float:
        """Return by how many standard errors slopes and edges repeat better by a coarser lattice than by other vectors.

        0 if there are few vectors, or if the elements differ in color alone. The error is that of lines
        (:meth:`Evidence.split_error`) if it is larger than that of vectors.

        Parameters
        ----------
        basis
            Rows (x, y) px.
        change
            ``(2, 2)``: an integer matrix H; the basis of the coarser lattice is H times ``basis``.
        """
        own, others = self.structure.split(basis, change[np.newaxis])[0]
        excess = own.mean - others.mean
        if min(own.lags, others.lags) < FEWEST_LAGS or excess <= 0 or not self.differs_in_structure(basis, change):
            return 0.0
        error = math.sqrt(own.variance / own.lags + others.variance / others.lags)
        if excess > BY_LINES * error:
            error = max(error, self.structure.split_error(basis, change))
        return excess / max(error, 1e-6)

    def _measure(self, basis: Points, best: float, first: bool, proposals: Mapping[str, Sequence[Points]]) -> Traits:
        pooled, structure = (max(one.repeated(basis), 1e-3) for one in (self.pooled, self.structure))
        relief = min(max(1 - highest_added(self.pooled, basis, RELIEFS) / pooled, 0.02), 2.0)
        splits = [self._split(self.pooled, basis, index) for index in SPLITS]
        split_2, split_3 = (max(part.excesses) / pooled for part in splits)
        split_error = max(splits[0].errors) / pooled
        coarser = [self._split(self.structure, basis, index) for index in SPLITS]
        structure_split = max(max(part.excesses) for part in coarser) / structure
        ratios = np.concatenate([np.divide(part.excesses, part.errors) for part in coarser])
        alternation = self._count_errors(basis, SPLIT_CHANGES[int(np.argmax(ratios))])
        bases = finer_bases(basis, SPLITS)
        added = [one.mean for one in self.structure.agreements(bases, basis)]
        nearest = bases[int(np.argmax(added))]
        change = np.rint(basis @ np.linalg.inv(nearest)).astype(np.int64)
        distinction = self._count_errors(nearest, change) if relief < SMALL_RELIEF else 0.0
        cells = {name: [relate_bases(other, basis) for other in part] for name, part in proposals.items()}
        votes = [cells.get(name, []) for name in DETECTORS]
        return Traits(
            math.log(min(max(self.pooled.sigmas(basis), 0.1), MAX_SIGMAS)),
            math.log(max(self.pooled.tiles(basis), 1.0)),
            math.log(relief),
            min(max(1 - max(added) / structure, 0.0), 2.0),
            min(max(split_2, -0.5), 1.5),
            min(max(split_3, -0.5), 1.5),
            min(max(structure_split, -0.5), 1.5),
            math.log(min(max(max(np.divide(part.excesses, part.errors).max() for part in splits), 1.0), MAX_ERRORS)),
            math.log(min(max(alternation, SURE_ERRORS), MAX_STRUCTURE_ERRORS) / SURE_ERRORS),
            math.log(min(max(distinction, SURE_ERRORS), MAX_STRUCTURE_ERRORS) / SURE_ERRORS),
            math.log(min(max(split_error, LEAST_ERROR), 1.0)),
            min(max(self.merit(basis) / best, -1.0), 1.2),
            float(first),
            float(1 in votes[0]),
            float(1 in votes[1]),
            float(1 in votes[2]),
            float(sum(any(0 < ratio < 1 for ratio in vote) for vote in votes)),
            float(sum(any(ratio > 1 for ratio in vote) for vote in votes)),
        )


def relate_bases(basis: Points, other: Points) -> float:
    """Return the number of cells of ``other`` in a cell of ``basis``, both reduced; 0 if they are not nested."""
    tolerance = max(TOLERANCE, SHARE * min(np.hypot(*basis[0]), np.hypot(*other[0])))
    return count_cells(basis, other, tolerance)


def is_same(basis: Points, other: Points) -> bool:
    """Return whether two reduced bases are the same lattice, within :data:`TOLERANCE` and :data:`SHARE`."""
    return relate_bases(basis, other) == 1


def classify(traits: Traits) -> Probabilities:
    """Return the probabilities of any lattice of the short list, by :data:`~.weights.WEIGHTS`."""
    return _apply(WEIGHTS, [1.0, *traits])


def reclassify(rivals: Sequence[Rival]) -> Probabilities:
    """Return the probabilities of the chosen lattice, the first one, by :data:`~.weights.CHOSEN`.

    It was chosen because it is the most probable. The best of several estimates is too high if another one is nearly as
    probable, and too low if it stands out.
    """
    return _apply(CHOSEN, describe_choice(rivals))


def describe_choice(rivals: Sequence[Rival]) -> list[float]:
    """Return what :func:`reclassify` reads: 1, and five logarithms.

    The first two are those of the probabilities ``exact`` and ``sub_or_supercell`` of the chosen lattice over ``none``,
    within +-8. The others are those of the highest probability to be exact of a coarser lattice, of a finer one, and of
    one that is neither, each at least that of :data:`LEAST_SECOND`. If the chosen lattice is that of the structure or
    of the colors, the other one of the two does not count.
    """
    first = rivals[0]
    exact, nested, none = (math.log(max(share, 1e-6)) for share in first.probabilities)
    highest = [LEAST_SECOND] * 3
    for rival in rivals[1:]:
        if rival.probabilities.exact > min(highest) and not (first.role and rival.role):
            cells = relate_bases(rival.basis, first.basis)
            relation = 0 if cells > 1 else 1 if cells > 0 else 2
            highest[relation] = max(highest[relation], rival.probabilities.exact)
    own = [min(max(share - none, -8.0), 8.0) for share in (exact, nested)]
    return [1.0, *own, *(math.log(share) for share in highest)]


def _apply(weights: Mapping[str, Sequence[float]], terms: Sequence[float]) -> Probabilities:
    """Return the probabilities of a multinomial logistic regression; the score of ``none`` is 0."""
    scores = [float(np.dot(weights[name], terms)) if name in weights else 0.0 for name in Probabilities._fields]
    shares = np.exp(np.array(scores) - max(scores))
    return Probabilities(*(shares / shares.sum()).tolist())


def share_certainty(rivals: Sequence[Rival]) -> tuple[Probabilities, list[float]]:
    """Return the probabilities of the chosen lattice, and those of the others to be exact: at most one is exact.

    Where the colors repeat by another lattice than the structure, either may be meant. The probability of the chosen
    one is divided equally between the two. The probabilities of the others are lowered if all add up to more than 1.

    Parameters
    ----------
    rivals
        The chosen lattice, then the others.
    """
    exact, nested, none = reclassify(rivals)
    partners = [bool(rivals[0].role and rival.role) for rival in rivals[1:]]
    if any(partners):
        exact, nested = exact / 2, nested + exact / 2
    free = 1 - exact * (1 + any(partners))
    total = sum(rival.probabilities.exact for rival, pair in zip(rivals[1:], partners, strict=True) if not pair)
    scale = min(1.0, free / total) if total > 0 else 1.0
    others = [
        exact if pair else scale * rival.probabilities.exact for rival, pair in zip(rivals[1:], partners, strict=True)
    ]
    return Probabilities(exact, nested, none), others
