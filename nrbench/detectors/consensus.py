"""The lattice detector of nrbench: the smallest lattice whose tiles best predict one another."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import Any, ClassVar, Literal

import numpy as np

from nrbench.detectors.agreement.evidence import Evidence
from nrbench.detectors.agreement.likeness import SIDE, compute_likeness, make_view, max_factor, views
from nrbench.detectors.agreement.search import StableLattice, SublatticeSearch, highest_between, propose_lattices
from nrbench.detectors.autocorrelation.surrogates import measure_surrogates
from nrbench.errors import checker
from nrbench.imaging.convert import Image, crop_middle
from nrbench.lattice.geometry import Lattice, Points
from nrbench.plugins.forms import Detection, NoLatticeFound, Surface

TESTED = 256
"""px; side of the image that is compared with surrogates: the middle, shrunk as far as the lattice allows."""
PRECISE = 2048
"""px; side of the middle of the image that is analyzed at full detail: it holds enough of any period."""
STARTS = 8
"""Number of the best proposals from which finer lattices are searched."""
VOTES = 3
"""Number of the best lattices that each view of a large image contributes."""
COMPARED = 6
"""Number of the best pairs that are fitted in a phase-randomized copy."""
WEIGHTS = {"constant": -5.44, "sigmas": 3.75, "relief": 1.21, "tiles": -1.0}
"""Weights of a logistic regression on logarithms, fitted by ``benchmarks/consensus_calibration.py``."""
MAX_SIGMAS = 60.0
"""Standard deviations above which the confidence does not rise: few lattices of the fit had more."""

_check = checker("consensus")


@dataclass(frozen=True)
class Consensus:
    """The smallest lattice whose tiles best predict one another.

    Other detectors return supercells, subcells along the joints of a wall, and lattices that occur by chance. This one
    is built to avoid these errors.

    1. Slow lighting is removed from the image. Its colors, slopes and edges are correlated with their shifted copies;
       the mean of the three correlations is the likeness of the image to its shifted self
       (:mod:`nrbench.detectors.agreement.likeness`).
    2. Pairs of its most prominent peaks propose lattices. Each lattice is fitted to sub-pixel precision at all its
       multiples at once (:class:`nrbench.detectors.agreement.evidence.Evidence`). Its merit is the share of the
       variance that is explained if each tile is predicted from all others. Supercells have a low merit because they
       have few tiles; wrong vectors have a low merit because their tiles differ.
    3. The best lattices are replaced by finer ones as long as the vectors that these add agree as well. A lattice that
       lies on a ridge is discarded (:mod:`nrbench.detectors.agreement.search`).
    4. Of the remaining lattices the one of the highest merit is returned.

    Images of more than 640 px a side are analyzed in several views, from the middle at full detail to the whole image
    at low detail. The views propose lattices; the choice is made at full detail, on the middle 2048 px. Time grows as
    n log n up to this size and as n beyond.

    Parameters
    ----------
    max_loss
        A finer lattice is accepted if the mean correlation at the vectors that it adds is lower by no more than this
        share.
    tile_allowance
        The loss may be larger by this number divided by the number of tiles.
    scatter
        If correlations scatter from vector to vector, a finer lattice is also accepted if it misses by no more than
        this number of standard deviations and stands out from all others: long threads make some supercells match.
    relief
        Least share by which the correlation at a lattice's multiples exceeds the correlation at the vectors that any
        finer lattice adds.
    size_exponent
        The merit is multiplied by the number of tiles to this power: the smaller of two similar lattices is preferred.
    peaks
        Number of the most prominent peaks that are paired.
    proposals
        Number of the best pairs that are fitted.
    reject
        ``"none"``: return any stable lattice. ``"bartlett"``: report no lattice if the mean correlation is less than
        ``sigmas`` times its spread by Bartlett's formula (:meth:`Evidence.sigmas`). ``"surrogate"``: report no lattice
        if the contrast of the best one, by which its correlation exceeds that of any finer lattice, is within the range
        of phase-randomized copies of the image.
    sigmas
        Limit for ``"bartlett"``. The best lattice proposed for noise reaches 9
        (``benchmarks/consensus_calibration.py``).
    least
        Least share of the variance that must be explained, unless ``reject`` is ``"none"``.
    surrogates
        Number of phase-randomized copies.
    false_alarms
        Probability that a phase-randomized copy is accepted as a lattice.
    """

    max_loss: float = 0.08
    tile_allowance: float = 1.0
    scatter: float = 4.0
    relief: float = 0.08
    size_exponent: float = 0.06
    peaks: int = 80
    proposals: int = 24
    reject: Literal["none", "bartlett", "surrogate"] = "bartlett"
    sigmas: float = 10.0
    least: float = 0.02
    surrogates: int = 12
    false_alarms: float = 0.02

    version: ClassVar[str] = "1"

    def __post_init__(self) -> None:
        for name in ("max_loss", "relief", "least"):
            share = getattr(self, name)
            _check(0 <= share < 1, f"{name} is {share}; give a share from 0 to below 1")
        for name in ("tile_allowance", "scatter", "size_exponent", "sigmas"):
            _check(getattr(self, name) >= 0, f"{name} is {getattr(self, name)}; give 0 or more")
        for name in ("peaks", "proposals", "surrogates"):
            _check(getattr(self, name) >= 2, f"{name} is {getattr(self, name)}; give at least 2")
        kinds = ("none", "bartlett", "surrogate")
        _check(self.reject in kinds, f"reject is {self.reject!r}; give {', '.join(kinds[:-1])} or {kinds[-1]}")
        _check(0 < self.false_alarms < 1, f"false_alarms is {self.false_alarms}; give a probability, e.g. 0.01")

    def detect(self, image: Image) -> Detection:
        """Return the lattice of ``image``. Its origin is (0, 0) because the detector does not find the phase.

        The confidence is the probability that the lattice is exact; see :func:`confidence`. Diagnostics: ``likeness``
        (the correlation, right half, with the candidates and the pair), ``explained`` (the share of the variance),
        ``between`` (the highest correlation that a finer lattice adds), ``relief``, ``tiles``, ``sigmas``; with
        ``"surrogate"`` also ``tested`` (the contrast in the part that is tested), ``chance`` (the contrasts of the
        phase-randomized copies) and ``limit``.

        Raises
        ------
        NoLatticeFound
            If the image is constant or no lattice is stable. Unless ``reject`` is ``"none"``, also if the best lattice
            may have occurred by chance.
        """
        if np.ptp(image, (0, 1)).max() == 0:
            raise NoLatticeFound("the image is constant: it has no texture")
        likeness = compute_likeness(crop_middle(image, PRECISE))
        evidence = Evidence(likeness.pooled)
        candidates = self._candidates(image, evidence)
        detection = self._choose(evidence, Evidence(likeness.colors), candidates)
        if self.reject == "surrogate":
            detection = self._compare_with_surrogates(image, detection)
        return detection if self.reject == "none" else self._check_strength(detection)

    def _candidates(self, image: Image, evidence: Evidence) -> list[Points]:
        """Return the best lattices of all views, in the image's pixels; ``evidence`` is that of a small image."""
        if max(image.shape[:2]) <= SIDE:
            return self._best_proposals(evidence)
        view_evidence = [(view.factor, Evidence(compute_likeness(view.image).pooled)) for view in views(image)]
        return [
            stable.basis * factor
            for factor, evidence in view_evidence
            for stable in self._stable_lattices(evidence, self._best_proposals(evidence))[:VOTES]
        ]

    def _best_proposals(self, evidence: Evidence) -> list[Points]:
        bases = propose_lattices(evidence, self.peaks, self.proposals)
        return sorted(bases, key=lambda basis: -self._merit(evidence, basis))[:STARTS]

    def _stable_lattices(self, evidence: Evidence, bases: list[Points]) -> list[StableLattice]:
        """Return the stable lattices that are reached from the given ones, by merit."""
        search = SublatticeSearch(evidence, self.max_loss, self.tile_allowance, self.scatter, self.relief)
        stable = [search.find_finest(basis) for basis in bases if self._merit(evidence, basis) > 0]
        return sorted(filter(None, stable), key=lambda lattice: -self._merit(evidence, lattice.basis))

    def _merit(self, evidence: Evidence, basis: Points) -> float:
        return float(evidence.explained_variance_loo(basis) * evidence.tiles(basis) ** self.size_exponent)

    def _choose(self, evidence: Evidence, colors: Evidence, candidates: list[Points]) -> Detection:
        """Return the stable lattice of the highest merit at full detail, with its diagnostics."""
        lattices = self._stable_lattices(evidence, candidates)
        if not lattices:
            raise NoLatticeFound("no two peaks of the correlation generate a lattice by which the image repeats")
        best = lattices[0]
        basis = best.basis
        sigmas, tiles, explained = evidence.sigmas(basis), evidence.tiles(basis), evidence.explained_variance_loo(basis)
        diagnostics: dict[str, Any] = {
            "likeness": Surface(evidence.gamma, (0, evidence.shape[0] - 1), np.concatenate(candidates), basis),
            "explained": explained,
            "between": best.between,
            "relief": best.relief,
            "tiles": tiles,
            "sigmas": sigmas,
        }
        lattice = Lattice.from_basis(basis).reduced()
        detection = Detection(lattice, confidence(sigmas, best.relief, tiles), diagnostics)
        if self._is_striped(colors, basis, best.repeated):
            raise NoLatticeFound(
                "the image repeats along one direction by any vector: stripes, not a lattice", detection
            )
        return detection

    def _is_striped(self, colors: Evidence, basis: Points, repeated: float) -> bool:
        """Return whether the lattice lies on a ridge of the colors' correlation, if the colors repeat as well.

        Edges are not a linear function of the pixels. The edges of fine stripes interfere with the pixel grid, which
        produces a lattice that the colors do not have.
        """
        own = colors.repeated(basis)
        return own > repeated / 2 and own - highest_between(colors, basis) < self.relief * own

    def _compare_with_surrogates(self, image: Image, detection: Detection) -> Detection:
        """Return the detection with the contrasts of phase-randomized copies; raise if its own is not higher."""
        vectors = detection.lattice.matrix
        factor = max_factor(vectors)
        part = make_view(image, factor, TESTED).image
        evidence = Evidence(compute_likeness(part).pooled)
        tested = max(self._contrast(evidence, evidence.fit(vectors / factor)), self._best_contrast(part))
        copies, limit = measure_surrogates(image, part, self._best_contrast, self.surrogates, self.false_alarms)
        diagnostics = {**detection.diagnostics, "tested": tested, "chance": copies, "limit": limit}
        detection = replace(detection, diagnostics=diagnostics)
        if tested <= limit:
            raise NoLatticeFound(
                f"the best lattice (contrast {tested:.3f}) is no better than chance ({limit:.3f})", detection
            )
        return detection

    def _check_strength(self, detection: Detection) -> Detection:
        """Return the detection; raise if it explains too little or, by Bartlett's formula, may be chance."""
        explained, sigmas = (detection.diagnostics[name] for name in ("explained", "sigmas"))
        if explained < self.least:
            raise NoLatticeFound(f"the best lattice explains only {explained:.1%} of the variance", detection)
        if self.reject == "bartlett" and sigmas < self.sigmas:
            raise NoLatticeFound(
                f"the best lattice ({sigmas:.1f} standard deviations) may be chance (below {self.sigmas:g})", detection
            )
        return detection

    def _contrast(self, evidence: Evidence, basis: Points) -> float:
        """Return the correlation of a lattice minus the highest that a finer one adds, times tiles ** size_exponent."""
        contrast = evidence.repeated(basis) - highest_between(evidence, basis)
        return float(max(contrast, 0.0) * evidence.tiles(basis) ** self.size_exponent)

    def _best_contrast(self, image: Image) -> float:
        """Return the highest contrast of an image's proposals; 0 if there are none."""
        evidence = Evidence(compute_likeness(image).pooled)
        bases = propose_lattices(evidence, self.peaks, COMPARED)
        return max((self._contrast(evidence, basis) for basis in bases), default=0.0)


def confidence(sigmas: float, relief: float, tiles: float) -> float:
    """Return the probability that a lattice is exact: not a supercell, a subcell, wrong, or found by chance.

    Parameters
    ----------
    sigmas
        How far the correlation at its multiples lies above chance, in standard deviations.
    relief
        The share of this correlation by which the correlation at the further vectors of any finer lattice is lower.
    tiles
        The image's area in cells. At the same significance many small cells are more often subcells.

    Notes
    -----
    A logistic regression on the logarithms of the three. It is fitted to draws of 25 models and of noise, with
    departures from none to very strong ones, and predicts how often such a lattice was exact.
    """
    logit = WEIGHTS["constant"] + WEIGHTS["sigmas"] * math.log(min(max(sigmas, 1e-3), MAX_SIGMAS))
    logit += WEIGHTS["relief"] * math.log(max(relief, 1e-2)) + WEIGHTS["tiles"] * math.log(max(tiles, 1.0))
    return 1 / (1 + math.exp(-logit)) if logit > -700 else 0.0
