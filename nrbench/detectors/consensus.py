"""nrbench's own lattice detector: the smallest lattice from which each tile is best foretold by all the others."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any, ClassVar, Literal

import numpy as np

from nrbench.detectors.agreement.channels import likeness
from nrbench.detectors.agreement.confidence import confidence
from nrbench.detectors.agreement.evidence import Evidence
from nrbench.detectors.agreement.proposals import proposals
from nrbench.detectors.agreement.sublattice_search import Descent, Settled, highest_between
from nrbench.detectors.agreement.views import SIDE, middle, scale_for, view, views
from nrbench.detectors.chance.surrogates import chance as copies_of
from nrbench.detectors.chance.surrogates import upper_limit
from nrbench.errors import checker
from nrbench.imaging.convert import Image
from nrbench.lattice.geometry import Lattice, Points
from nrbench.plugins.forms import Detection, NoLatticeFound, Surface
from nrbench.streams import pixels_hash, stream

TESTED = 256
"""px; the test against chance is made on the middle of the image, shrunk as far as the lattice allows, of this side."""
PRECISE = 2048
"""px; at full detail no more than the middle of the image, of this side, is compared: it holds enough of any period."""


@dataclass(frozen=True)
class Consensus:
    """The smallest lattice from which each tile is best foretold by all the others.

    Built to be robust where published detectors err: to supercells, to subcells along a wall's joints, and to chance.

    1. Colors, slopes and edges of the image, less its slow lighting, are correlated with their shifted copies; the mean
       of the three is the image's likeness to itself at each lag (:mod:`nrbench.detectors.agreement.channels`).
    2. Pairs of its most prominent peaks propose lattices. Each is fitted to sub-pixel at all its multiples at once
       (:class:`nrbench.detectors.agreement.evidence.Evidence`) and rated by its merit: the share of the variance that is explained
       where each tile is predicted from all others. Supercells lose for want of tiles, wrong vectors for want of
       likeness.
    3. From each of the best, finer lattices are descended to, as long as the vectors that they add agree as well, and
       a lattice that lies on a ridge is none (:mod:`nrbench.detectors.agreement.sublattice_search`).
    4. Of what then stands, the one of the highest merit is the answer.

    Pictures over 640 px a side are looked at in several views, from the middle in full detail to the whole in little.
    The views propose; which lattice is right is decided at full detail, on the middle 2048 px. Time grows as n log n up
    to there and as n beyond.

    Parameters
    ----------
    loss
        A finer lattice is taken where the mean correlation at the vectors that it adds is lower by no more than this
        share.
    chance
        As many tiles of that loss are forgiven besides, divided by the number of tiles.
    scatter
        Where correlations scatter from vector to vector, a finer lattice that misses by no more than as many standard
        deviations, and stands out from all others, is taken too: threads that run on make some supercells match.
    relief
        The correlation at a lattice's multiples exceeds what any finer one adds by this share.
    small
        The merit is multiplied by the number of tiles to this power: of two lattices alike the smaller is right.
    peaks
        Only so many peaks, the most prominent, are paired.
    proposals
        Only so many pairs, the best, are fitted.
    reject
        ``"none"``: answer wherever a lattice stands. ``"bartlett"``: no lattice where the mean correlation is less than
        ``sigmas`` times its spread by Bartlett's formula (:meth:`Evidence.sigmas`).
        ``"surrogate"``: no lattice where its contrast, by which its
        correlation exceeds that of any finer one, is within reach of phase-randomized copies of the image.
    sigmas
        With ``"bartlett"``. Of noise, the best lattice proposed reaches 9 (``benchmarks/consensus_calibration.py``).
    least
        Unless ``reject`` is ``"none"``: the least share of the variance that must be explained.
    surrogates
        Number of phase-randomized copies.
    false_alarms
        Probability at which a phase-randomized copy would be taken for a lattice.
    """

    loss: float = 0.08
    chance: float = 1.0
    scatter: float = 4.0
    relief: float = 0.08
    small: float = 0.06
    peaks: int = 80
    proposals: int = 24
    reject: Literal["none", "bartlett", "surrogate"] = "bartlett"
    sigmas: float = 10.0
    least: float = 0.02
    surrogates: int = 12
    false_alarms: float = 0.02

    version: ClassVar[str] = "1"

    def __post_init__(self) -> None:
        for name in ("loss", "relief", "least"):
            share = getattr(self, name)
            _check(0 <= share < 1, f"{name} is {share}; give a share from 0 to below 1")
        for name in ("chance", "scatter", "small", "sigmas"):
            _check(getattr(self, name) >= 0, f"{name} is {getattr(self, name)}; give 0 or more")
        for name in ("peaks", "proposals", "surrogates"):
            _check(getattr(self, name) >= 2, f"{name} is {getattr(self, name)}; give at least 2")
        kinds = ("none", "bartlett", "surrogate")
        _check(self.reject in kinds, f"reject is {self.reject!r}; give {', '.join(kinds[:-1])} or {kinds[-1]}")
        _check(0 < self.false_alarms < 1, f"false_alarms is {self.false_alarms}; give a probability, e.g. 0.01")

    def detect(self, image: Image) -> Detection:
        """Return the lattice of ``image``; its origin is (0, 0), the detector finds no phase.

        The confidence is the probability that the lattice is exact, see :mod:`nrbench.detectors.agreement.confidence`.
        Diagnostics: ``likeness`` (the correlation, right half, with the candidates and the pair), ``explained``,
        ``between`` (the most that a finer lattice adds), ``relief``, ``tiles``, ``sigmas``; with ``"surrogate"``,
        ``tested`` (the contrast on the part that was tested), ``chance`` (that of the copies) and ``limit``.

        Raises
        ------
        NoLatticeFound
            Where the image is constant, no lattice stands, or, unless ``reject`` is ``"none"``, the best one may be
            chance.
        """
        if np.ptp(image, (0, 1)).max() == 0:
            raise NoLatticeFound("the image is constant: it has no texture")
        seen = likeness(middle(image, PRECISE))
        evidence = Evidence(seen.pooled)
        detection = self._detection(evidence, Evidence(seen.colors), self._seen(image, evidence))
        if self.reject == "surrogate":
            detection = self._compared(image, detection)
        return detection if self.reject == "none" else self._checked(detection)

    def _seen(self, image: Image, evidence: Evidence) -> list[Points]:
        """Return the best lattices of all views, in the image's pixels; ``evidence`` is that of a small image."""
        if max(image.shape[:2]) <= SIDE:
            return self._best(evidence)
        seen = [(one.factor, Evidence(likeness(one.image).pooled)) for one in views(image)]
        return [
            settled.basis * factor
            for factor, there in seen
            for settled in self._standing(there, self._best(there))[:VOTES]
        ]

    def _best(self, evidence: Evidence) -> list[Points]:
        """Return the proposals of the highest merit."""
        proposed = proposals(evidence, self.peaks, self.proposals).bases
        return sorted(proposed, key=lambda basis: -self._merit(evidence, basis))[:STARTS]

    def _standing(self, evidence: Evidence, bases: list[Points]) -> list[Settled]:
        """Return the lattices that stand among those that are descended to, by merit."""
        descent = Descent(evidence, self.loss, self.chance, self.scatter, self.relief)
        settled = [descent.settle(basis) for basis in bases if self._merit(evidence, basis) > 0]
        return sorted(filter(None, settled), key=lambda one: -self._merit(evidence, one.basis))

    def _merit(self, evidence: Evidence, basis: Points) -> float:
        return float(evidence.foretold(basis) * evidence.tiles(basis) ** self.small)

    def _detection(self, evidence: Evidence, colors: Evidence, seen: list[Points]) -> Detection:
        """Return the lattice that stands with the highest merit at full detail, with what led to it."""
        standing = self._standing(evidence, seen)
        if not standing:
            raise NoLatticeFound("no two peaks of the correlation generate a lattice that the image repeats by")
        settled = standing[0]
        basis = settled.basis
        sigmas, tiles, explained = evidence.sigmas(basis), evidence.tiles(basis), evidence.foretold(basis)
        diagnostics: dict[str, Any] = {
            "likeness": Surface(evidence.gamma, (0, evidence.shape[0] - 1), np.concatenate(seen), basis),
            "explained": explained,
            "between": settled.between,
            "relief": settled.relief,
            "tiles": tiles,
            "sigmas": sigmas,
        }
        lattice = Lattice.from_basis(basis).reduced()
        detection = Detection(lattice, confidence(sigmas, settled.relief, tiles), diagnostics)
        if self._striped(colors, basis, settled.repeated):
            raise NoLatticeFound(
                "the image repeats along one direction by any vector: stripes, not a lattice", detection
            )
        return detection

    def _striped(self, colors: Evidence, basis: Points, repeated: float) -> bool:
        """Return whether the pixels themselves, without edges, that repeat as well, only lie on a ridge.

        Edges are no linear function of the pixels: those of fine stripes beat with the pixels' grid, a lattice.
        """
        own = colors.repeated(basis)
        return own > repeated / 2 and own - highest_between(colors, basis) < self.relief * own

    def _compared(self, image: Image, detection: Detection) -> Detection:
        """Return what was detected, with what phase-randomized copies reach, unless it is no better."""
        vectors = detection.lattice.matrix
        factor = scale_for(vectors)
        part = view(image, factor, TESTED).image
        evidence = Evidence(likeness(part).pooled)
        tested = max(self._contrast(evidence, evidence.fit(vectors / factor)), self._best_contrast(part))
        copies = copies_of(part, self._best_contrast, stream("detection", pixels_hash(image)), self.surrogates)
        limit = upper_limit(copies, self.false_alarms)
        told = {**detection.diagnostics, "tested": tested, "chance": copies, "limit": limit}
        detection = replace(detection, diagnostics=told)
        if tested <= limit:
            raise NoLatticeFound(
                f"the best lattice (contrast {tested:.3f}) is no better than chance ({limit:.3f})", detection
            )
        return detection

    def _checked(self, detection: Detection) -> Detection:
        """Return what was detected unless it explains too little, or, by Bartlett's formula, may be chance."""
        explained, sigmas = (detection.diagnostics[name] for name in ("explained", "sigmas"))
        if explained < self.least:
            raise NoLatticeFound(f"the best lattice explains only {explained:.1%} of the variance", detection)
        if self.reject == "bartlett" and sigmas < self.sigmas:
            raise NoLatticeFound(
                f"the best lattice ({sigmas:.1f} standard deviations) may be chance (below {self.sigmas:g})", detection
            )
        return detection

    def _contrast(self, evidence: Evidence, basis: Points) -> float:
        """Return by how much a lattice's correlation stands out from that of any finer one, times tiles ** small."""
        contrast = evidence.repeated(basis) - highest_between(evidence, basis)
        return float(max(contrast, 0.0) * evidence.tiles(basis) ** self.small)

    def _best_contrast(self, image: Image) -> float:
        """Return the highest contrast that an image's proposals have; 0 where there are none."""
        evidence = Evidence(likeness(image).pooled)
        bases = proposals(evidence, self.peaks, COMPARED).bases
        return max((self._contrast(evidence, basis) for basis in bases), default=0.0)


STARTS = 8
"""So many of the best proposals are descended from."""
VOTES = 3
"""So many of the best lattices of each view of a large picture are asked at full detail."""
COMPARED = 6
"""So many of the best pairs of a phase-randomized copy are fitted."""


_check = checker("consensus")
