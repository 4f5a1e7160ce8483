"""From a lattice by which an image repeats to the smallest one: down to finer lattices while it agrees."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import NamedTuple

import numpy as np

from nrbench.detectors.agreement.evidence import Agreement, Evidence, reduced
from nrbench.detectors.agreement.proposals import SHORTEST
from nrbench.lattice.geometry import Points
from nrbench.lattice.sublattices import hermite_matrices

INDICES = (2, 3, 5, 7, 11, 13)
"""Finer lattices of these indices are tried, and theirs in turn."""
DEPTH = 8
"""At most so many descents one after the other: an index of 2^8 is beyond any candidate."""
MOST = 60
"""From one start so many lattices are asked at most: on a long ridge there is no end of them."""
BRANCHES = 4
"""At most so many finer lattices of one are followed, the likeliest first."""
APART = 0.4
"""A finer lattice stands out from the others where it rises by this share from what they add to the coarse mean."""
FEW = 10.0
"""Of so few vectors the scatter is seen half as well, and twice as many standard deviations are no surprise."""
HARDLY = 0.03
"""A finer lattice that misses the limit by no more than this, before it is fitted, is fitted and asked again."""


class Settled(NamedTuple):
    """A lattice that no finer one replaces.

    Parameters
    ----------
    basis
        Rows (x, y) px, reduced.
    repeated
        The mean correlation at its multiples.
    between
        The highest mean correlation at what a finer lattice would add.
    """

    basis: Points
    repeated: float
    between: float

    @property
    def relief(self) -> float:
        """By which share of ``repeated`` the correlation in between is lower; over 1 where that is negative."""
        return 1 - self.between / self.repeated


def finer_bases(basis: Points) -> list[Points]:
    """Return the reduced bases of all finer lattices of :data:`INDICES`, in that order."""
    return [reduced(matrix @ basis / index) for index in INDICES for matrix in hermite_matrices(index)]


def highest_between(evidence: Evidence, basis: Points) -> float:
    """Return the highest mean correlation at what any finer lattice of :data:`INDICES` would add."""
    return max(evidence.agreement(finer, basis).mean for finer in finer_bases(basis))


Rated = tuple[Agreement, Points]
"""What a finer lattice adds, and its basis."""


@dataclass(frozen=True)
class Descent:
    """The rule by which a finer lattice replaces a coarser one.

    Parameters
    ----------
    evidence
        The image's agreement with itself.
    loss
        A finer lattice is the right one where the correlation at the vectors that it adds is lower by no more than this
        share: what differs from tile to tile costs nothing, as it differs between coarse tiles too.
    chance
        As many tiles of that loss are forgiven besides, divided by the number of tiles: few tiles agree by chance.
    scatter
        A finer lattice is also the right one where what it adds lies within this many standard deviations of the
        correlations at single vectors, and stands out from what finer lattices of other indices add (:data:`APART`):
        where a few long threads or rows happen to match, a supercell holds the best of widely scattered vectors,
        whereas tiles that truly alternate set its vectors apart from all others.
    relief
        A lattice stands where the correlation at its multiples exceeds what any finer one adds by this share; else its
        multiples lie on a ridge, as in stripes, and any vector along it would do.
    known
        What was settled already, by rounded basis.
    """

    evidence: Evidence
    loss: float
    chance: float
    scatter: float
    relief: float
    known: dict[bytes, Settled | None] = field(default_factory=dict)

    def settle(self, basis: Points) -> Settled | None:
        """Return the finest lattice that stands among this one and the finer ones that it leads to; None: none does."""
        return self._settle(basis, 0, len(self.known) + MOST)

    def _settle(self, basis: Points, depth: int, most: int) -> Settled | None:
        key = np.rint(2 * basis).astype(np.int64).tobytes()
        if key not in self.known and len(self.known) < most:
            self.known[key] = None
            self.known[key] = self._settled(basis, depth, most)
        return self.known.get(key)

    def _settled(self, basis: Points, depth: int, most: int) -> Settled | None:
        own = self.evidence.agreement(basis)
        rated = self._finer(basis, own)
        if depth < DEPTH:
            for _, candidate in self._agreeing(rated, basis, own)[:BRANCHES]:
                below = self._settle(candidate, depth + 1, most)
                if below is not None:
                    return below
        highest = max(agreement.mean for agreement, _ in rated)
        stands = own.mean > 0 and own.mean - highest >= self.relief * own.mean
        return self._told(self.evidence.fit(basis)) if stands else None

    def _told(self, basis: Points) -> Settled:
        return Settled(basis, self.evidence.repeated(basis), highest_between(self.evidence, basis))

    def _finer(self, basis: Points, own: Agreement) -> list[Rated]:
        """Return the finer lattices with what they add; those that agree nearly well enough are fitted."""
        limit = self._limit(basis, own) - HARDLY
        rated = []
        for candidate in finer_bases(basis):
            added = self.evidence.agreement(candidate, basis)
            if added.mean >= limit and np.hypot(*candidate[0]) >= SHORTEST:
                added, candidate = self._fitted(added, candidate, basis)
            rated.append((added, candidate))
        return rated

    def _limit(self, basis: Points, own: Agreement) -> float:
        return own.mean * (1 - self.loss - self.chance / self.evidence.tiles(basis))

    def _fitted(self, added: Agreement, candidate: Points, basis: Points) -> Rated:
        fitted = self.evidence.fit(candidate)
        better = self.evidence.agreement(fitted, basis)
        return (better, fitted) if better.mean > added.mean else (added, candidate)

    def _agreeing(self, rated: list[Rated], basis: Points, own: Agreement) -> list[Rated]:
        """Return those finer lattices that may replace the coarse one, likeliest first."""
        limit = self._limit(basis, own)
        usual = self._usual(rated)
        found = []
        for added, candidate in rated:
            spread = np.sqrt((own.variance + added.variance) / 2)
            above, below = added.mean - usual, own.mean - added.mean
            near = above > APART * (above + below) and below <= self.scatter * spread * (1 + FEW / max(own.lags, 1))
            if (added.mean >= limit or near) and np.hypot(*candidate[0]) >= SHORTEST:
                found.append((added, candidate))
        return sorted(found, key=lambda one: -one[0].mean)

    def _usual(self, rated: list[Rated]) -> float:
        """Return what the likeliest finer lattice of any index adds: on a ridge, of every index the same."""
        sizes = np.cumsum([len(hermite_matrices(index)) for index in INDICES])[:-1]
        means = np.array([added.mean for added, _ in rated])
        return float(np.median([part.max() for part in np.split(means, sizes)]))
