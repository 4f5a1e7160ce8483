"""The lattices that an image may have, what tells the right one from the others, and how probable each of them is."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from nrbench.detectors.autocorrelation.lattice_evidence import LatticeEvidence, finer_bases, highest_added
from nrbench.detectors.candidate_search.sublattice_search import SHORTEST
from nrbench.lattice.geometry import Points, hermite_matrices, reduce_basis
from nrbench.lattice.relation import count_cells

NEIGHBORS = (2, 3, 4)
"""Lattices coarser and finer than the best one by these indices are rated."""
SPLIT_CHANGES = np.concatenate([hermite_matrices(2), hermite_matrices(3)])
"""Integer matrices H: a lattice is compared with the coarser lattices whose bases are H times its basis."""
RELIEFS = (2, 3, 5)
"""A lattice is compared with finer lattices of these indices."""
STABLE = 5
"""Number of the best stable lattices that are rated."""
MAX_SIGMAS = 60.0
"""Standard deviations above which the probability does not rise. Few lattices of the calibration had more."""
MIN_ERRORS, MAX_ERRORS = 3.0, 50.0
"""Standard errors below which an excess may be chance, and above which it is certain."""
MIN_RELIEF = 0.02
"""Smaller reliefs are not told apart."""
TOLERANCE = 1.0
"""px; two lattices are the same if their reduced vectors differ by no more than this."""
SHARE = 0.04
"""Two lattices are also the same if their reduced vectors differ by no more than this share of s."""

WEIGHTS: dict[str, float] = {
    "constant": -8.158,
    "significance": 3.226,
    "votes": 1.848,
    "nested_votes": 1.445,
    "relief": 1.17,
    "alternation": -2.838,
    "best": 0.171,
}
"""The weight of each field of :class:`Traits`, as ``benchmarks/consensus_calibration.py`` fits and prints them.

Textures: 801 draws of the seeds 1011, 1012 and 1013 (6 of each model, 1 of each further kind), 2217 choices; penalty 1;
candidates rated by the code of commit c2c1f5f."""


class Traits(NamedTuple):
    """What tells the exact lattice from its supercells, from its subcells and from chance matches.

    Parameters
    ----------
    constant
        1.
    significance
        Logarithm of how far the correlation at its multiples lies above chance, in standard deviations.
    votes
        Number of other detectors that propose it, 0 to 2.
    nested_votes
        Number of detectors that propose a subcell of it, plus the number of those that propose a supercell.
    relief
        Logarithm of the share of its correlation by which that at the vectors of any finer lattice is lower. It is low
        for supercells.
    alternation
        Logarithm of the largest excess of the correlation at the multiples of a supercell over that at all its other
        multiples, in standard errors of lines (:class:`Split`). The supercells are those of index 2 and 3 and those
        among the candidates. It is high for subcells, because the elements alternate. It is 0 where few long threads
        match by chance.
    best
        1 for the stable lattice of the highest merit, else 0.
    """

    constant: float
    significance: float
    votes: float
    nested_votes: float
    relief: float
    alternation: float
    best: float


class Candidate(NamedTuple):
    """A lattice that an image may have.

    Parameters
    ----------
    basis
        Rows (x, y) px, reduced.
    merit
        Its merit, by which stable lattices are ordered.
    traits
        What tells it from the other candidates.
    probability
        That it is exact, in [0, 1]. The sum over all candidates is at most 1.
    """

    basis: Points
    merit: float
    traits: Traits
    probability: float


def rate_candidates(
    evidence: LatticeEvidence, stable: Sequence[Points], proposals: Mapping[str, Sequence[Points]]
) -> list[Candidate]:
    """Return the best stable lattices, neighbors of the first one, and all proposals; the most probable first.

    Parameters
    ----------
    evidence
        The correlations of the image.
    stable
        The possible stable lattices, the best first, at least one.
    proposals
        The fitted bases of each other detector. A detector votes for them.
    """
    bases: list[Points] = []
    voted = [basis for part in proposals.values() for basis in part]
    for basis in (*stable[:STABLE], *voted, *_list_neighbors(evidence, stable[0])):
        if is_possible(evidence, basis) and not any(relate_bases(basis, other) == 1 for other in bases):
            bases.append(basis)
    traits = [_measure_traits(evidence, basis, bases, proposals) for basis in bases]
    rated = zip(bases, traits, classify(traits), strict=True)
    candidates = [Candidate(basis, evidence.merit(basis), own, float(share)) for basis, own, share in rated]
    return sorted(candidates, key=lambda candidate: -candidate.probability)


def classify(traits: Sequence[Traits], weights: Mapping[str, float] = WEIGHTS) -> NDArray[np.float64]:
    """Return the probability of each candidate to be the exact lattice, ``(n,)``: a conditional logit.

    The score of a candidate is the sum of its traits times their weights. The probabilities are proportional to the
    exponentials of the scores. The score 0 is that of the case that no candidate is exact.

    Parameters
    ----------
    traits
        Those of all candidates of one image.
    weights
        The weight of each trait.
    """
    scores = np.append(np.array(traits) @ [weights[name] for name in Traits._fields], 0.0)
    shares = np.exp(scores - scores.max())
    return np.asarray(shares[:-1] / shares.sum())


def is_possible(evidence: LatticeEvidence, basis: Points) -> bool:
    """Return whether a lattice can be rated.

    The image holds more than two cells, none of them is too thin, and lags within reach show both vectors. If all
    multiples within reach lie on one line, nothing in the image speaks for the other vector.
    """
    if evidence.tiles(basis) <= 2 or np.hypot(*basis[0]) < SHORTEST or evidence.repeated(basis) <= 0:
        return False
    return evidence.spans_plane(basis)


def relate_bases(basis: Points, other: Points) -> float:
    """Return the number of cells of ``other`` in a cell of ``basis``, both reduced; 0 if they are not nested."""
    tolerance = max(TOLERANCE, SHARE * min(np.hypot(*basis[0]), np.hypot(*other[0])))
    return count_cells(basis, other, tolerance)


def _list_neighbors(evidence: LatticeEvidence, basis: Points) -> Iterator[Points]:
    """Yield the coarser lattice of each index that splits the given one most, and the best finer one, fitted."""
    for index in NEIGHBORS:
        changes = hermite_matrices(index)
        excesses = [split.excess for split in evidence.split(basis, changes)]
        yield reduce_basis(changes[int(np.argmax(excesses))] @ basis)
        bases = finer_bases(basis, (index,))
        added = [agreement.mean for agreement in evidence.agreements(bases, basis)]
        yield evidence.fit(bases[int(np.argmax(added))])


def _measure_traits(
    evidence: LatticeEvidence, basis: Points, bases: Sequence[Points], proposals: Mapping[str, Sequence[Points]]
) -> Traits:
    """Return the traits of one of the bases, of which the first is the best stable lattice."""
    relief = 1 - highest_added(evidence, basis, RELIEFS) / max(evidence.repeated(basis), 1e-3)
    coarser = [np.rint(other @ np.linalg.inv(basis)) for other in bases if relate_bases(other, basis) > 1]
    splits = evidence.split(basis, np.array([*SPLIT_CHANGES, *coarser], np.int64))
    errors = max(split.errors for split in splits)
    cells = [[relate_bases(other, basis) for other in part] for part in proposals.values()]
    return Traits(
        constant=1.0,
        significance=math.log(np.clip(evidence.sigmas(basis), 1.0, MAX_SIGMAS)),
        votes=float(sum(1 in part for part in cells)),
        nested_votes=float(sum(any(0 < n < 1 for n in part) + any(n > 1 for n in part) for part in cells)),
        relief=math.log(np.clip(relief, MIN_RELIEF, 2.0)),
        alternation=math.log(np.clip(errors, MIN_ERRORS, MAX_ERRORS) / MIN_ERRORS),
        best=float(basis is bases[0]),
    )
