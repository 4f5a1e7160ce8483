"""The lattice detector of nrbench: the smallest lattice whose tiles best predict one another."""

from __future__ import annotations

import functools
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Any, ClassVar, Literal, NamedTuple

import numpy as np
from numpy.typing import NDArray

from nrbench.detectors.autocorrelation.lattice_evidence import LatticeEvidence, highest_added
from nrbench.detectors.autocorrelation.pixel_structure import detect_content
from nrbench.detectors.autocorrelation.repeated_holes import join_holes
from nrbench.detectors.candidate_search.candidates import (
    SHARE,
    TOLERANCE,
    Candidate,
    is_possible,
    rate_candidates,
    relate_bases,
)
from nrbench.detectors.candidate_search.self_similarity_map import (
    SIDE,
    SimilarityMap,
    compute_self_similarity,
    make_view,
    view_factors,
    view_mask,
)
from nrbench.detectors.candidate_search.sublattice_search import (
    MIN_CONTRAST,
    find_stable,
    propose_lattices,
    ridge_height,
)
from nrbench.detectors.candidate_search.superposed_lattices import find_wave_lattices
from nrbench.detectors.frdft import Frdft
from nrbench.detectors.gncc import Gncc
from nrbench.errors import checker
from nrbench.imaging.convert import Image
from nrbench.imaging.masks import Mask
from nrbench.lattice.geometry import Lattice, Points, Vector, reduce_basis
from nrbench.lattice.relation import relate
from nrbench.plugins.forms import Alternative, Detection, NoLatticeFound, Probabilities, Surface

PRECISE = 2048
"""px; side of the middle of the image that is analyzed at full detail: it holds enough of any period."""
WAVES = 12
"""Number of the strongest waves from which ``frdft`` proposes a lattice."""
SPECTRUM = 256
"""px; side of the middle of the image whose waves are searched."""
LONGEST = 0.8
"""Proposals with a vector above this share of the image's sides are left out."""
MIN_AREA = 8.0
"""px^2; proposals with a smaller cell are left out."""
CERTAIN = 0.8
"""Confidence from which the image is not looked at with less detail."""
COARSEST = 8
"""Largest factor by which the image is shrunk to look at it with less detail."""
MIN_PERIOD = 14.0
"""px; least length of the shorter vector of a lattice in an image that is shrunk. Lattices of half its cell, which
compete with it, are still resolved."""
FINEST = 5.0
"""px; screens of this period are found at any angle. Finer ones may repeat better with the grid of pixels."""
LISTED = 6
"""Largest number of alternatives."""

_check = checker("consensus")


@dataclass(frozen=True)
class Consensus:
    """The smallest lattice whose tiles best predict one another.

    Other detectors return supercells, subcells along the joints of a wall, and lattices that occur by chance. This one
    is built to avoid these errors.

    1. Slow lighting is removed from the image. Its colors, slopes and edges are correlated with their shifted copies.
       The mean of the three correlations is the self-similarity map
       (:mod:`nrbench.detectors.candidate_search.self_similarity_map`).
    2. Pairs of its most prominent peaks propose lattices, and so do the detectors ``gncc`` and ``frdft``, without their
       tests against chance. Each lattice is fitted to sub-pixel precision at all its multiples at once
       (:class:`nrbench.detectors.autocorrelation.lattice_evidence.LatticeEvidence`). Its merit is the share of the
       variance that is explained if each tile is predicted from all others. Supercells have a low merit because they
       have few tiles; wrong vectors have a low merit because their tiles differ.
    3. The best lattices are replaced by finer ones as long as the vectors that these add agree as well. A lattice that
       lies on a ridge is discarded (:mod:`nrbench.detectors.candidate_search.sublattice_search`).
    4. The remaining lattices, their coarser and finer neighbors, and the proposals of the other detectors are the
       candidates. A conditional logit computes from six traits of each candidate how probable it is that it is exact
       (:mod:`nrbench.detectors.candidate_search.candidates`). The most probable one is returned.
    5. If the strongest waves of the image belong to two to four lattices, such as the screens of printed inks, none of
       them is returned: the error names all (:mod:`nrbench.detectors.candidate_search.superposed_lattices`).
    6. If this lattice is not certain, the image is shrunk to half, a quarter ... of its size, as far as that leaves
       14 px a period, and the same is done again: fine grain that does not repeat hides the lattice of large elements.
       The most certain of these lattices is returned.

    The alternatives are the other candidates, the most probable first; their ``evidence`` is the merit.

    Images of more than 640 px a side are analyzed in several views, from the middle at full detail to the whole image
    at low detail. The views propose lattices; the choice is made on the middle 2048 px. Time grows as
    n log n up to this size and as n beyond.

    Parameters
    ----------
    reject
        ``"none"``: return any lattice. ``"bartlett"``: report no lattice if the mean correlation is less than
        ``sigmas`` times its spread by Bartlett's formula (:meth:`LatticeEvidence.sigmas`), or if the lattice explains
        less than ``min_explained`` of the variance.
    sigmas
        Limit for ``"bartlett"``. The best lattice proposed for noise reaches 9
        (``benchmarks/consensus_calibration.py``).
    min_explained
        Least share of the variance that must be explained, in [0, 1).

    References
    ----------
    .. [1] D. McFadden, "Conditional logit analysis of qualitative choice behavior", in: Frontiers in Econometrics,
       Academic Press, 1974, pp. 105-142.
    .. [2] M. S. Bartlett, "On the theoretical specification and sampling properties of autocorrelated time-series",
       Supplement to the Journal of the Royal Statistical Society 8(1), 1946, pp. 27-41.
    """

    reject: Literal["none", "bartlett"] = "bartlett"
    sigmas: float = 10.0
    min_explained: float = 0.02

    version: ClassVar[str] = "8"
    masks: ClassVar[bool] = True

    def __post_init__(self) -> None:
        _check(self.reject in ("none", "bartlett"), f"reject is {self.reject!r}; give none or bartlett")
        _check(self.sigmas >= 0, f"sigmas is {self.sigmas}; give 0 or more")
        _check(0 <= self.min_explained < 1, f"min_explained is {self.min_explained}; give a share from 0 to below 1")

    def detect(self, image: Image, known: Mask | None = None) -> Detection:
        """Return the lattice of ``image``. Its origin is (0, 0) because the detector does not find the phase.

        Pixels that ``known`` ``(H, W)`` has False do not count. If they themselves repeat, as the holes of a fence do,
        they are a channel of the image (:func:`~nrbench.detectors.autocorrelation.repeated_holes.join_holes`).

        The confidence is the probability that the lattice is exact, as measured on texture models and on textures that
        the models lack (``benchmarks/consensus_calibration.py``).

        Diagnostics: ``self_similarity`` (the map, right half, with the proposals and the pair), ``shrunk`` (the factor
        by which the image was shrunk, to whose pixels the map refers), ``explained`` (the share of the variance),
        ``between`` (the highest correlation that a finer lattice adds), ``relief``, ``tiles``, ``sigmas``, ``traits``
        (what the conditional logit reads).

        Raises
        ------
        NoLatticeFound
            If the image is constant, has no stable lattice, or is striped. Unless ``reject`` is ``"none"``, also if the
            best lattice may have occurred by chance, or if several lattices are superposed, which its ``lattices`` are.
        """
        return detect_content(self._detect, *join_holes(self, image, known))

    def _detect(self, image: Image, known: Mask | None = None) -> Detection:
        """Return the lattice of an image that is not constant, of any range."""
        waves = [] if self.reject == "none" or known is not None else find_wave_lattices(image)
        vectors = "; ".join(f"t1 = {_round(each.t1)}, t2 = {_round(each.t2)} px" for each in waves)
        if len(waves) > 1:
            raise NoLatticeFound(f"several lattices are superposed: {vectors}", None, waves)
        chosen, highest = None, (False, -1.0)
        for level in rate_levels(image, known):
            best = level.candidates[0]
            rating = (level.evidence.explained_variance_loo(best.basis) >= self.min_explained, best.probability)
            is_resolved = level.factor == 1 or np.hypot(*best.basis[0]) >= MIN_PERIOD
            if is_resolved and rating > highest:
                chosen, highest = level, rating
            if highest >= (True, CERTAIN):
                break
        if chosen is None:
            raise NoLatticeFound("no two peaks of the correlation generate a lattice by which the image repeats")
        detection = _describe(chosen)
        if chosen.is_striped():
            raise NoLatticeFound(
                "the image repeats along one direction by any vector: stripes, not a lattice", detection
            )
        if waves and waves[0].s < FINEST and not detection.lattice.is_equivalent(waves[0], waves[0].s / 8):
            reason = f"the waves repeat by {vectors}; periods under {FINEST:g} px may be mixed with the grid of pixels"
            raise NoLatticeFound(f"{reason}: enlarge the image, or give this lattice", detection, waves)
        return detection if self.reject == "none" else self._check_strength(detection)

    def _check_strength(self, detection: Detection) -> Detection:
        """Return the detection; raise if it explains too little or, by Bartlett's formula, may be chance."""
        explained, sigmas = (detection.diagnostics[name] for name in ("explained", "sigmas"))
        if explained < self.min_explained:
            raise NoLatticeFound(f"the best lattice explains only {explained:.1%} of the variance", detection)
        if sigmas < self.sigmas:
            raise NoLatticeFound(
                f"the best lattice ({sigmas:.1f} standard deviations) may be chance (below {self.sigmas:g})", detection
            )
        return detection


def _round(vector: Vector) -> str:
    return f"({vector[0]:.2f}, {vector[1]:.2f})"


class Level(NamedTuple):
    """The candidates of an image that was shrunk, all in its pixels.

    Parameters
    ----------
    factor
        The factor by which the image was shrunk.
    evidence
        The evidence of colors, slopes and edges.
    colors
        The evidence of the colors alone.
    candidates
        The candidates, the most probable first; at least one.
    proposals
        The bases of all lattices that were proposed.
    """

    factor: int
    evidence: LatticeEvidence
    colors: LatticeEvidence
    candidates: list[Candidate]
    proposals: list[Points]

    def is_striped(self) -> bool:
        """Return whether the best lattice lies on a ridge of the colors' correlation, if the colors repeat as well.

        Edges are not a linear function of the pixels. The edges of fine stripes interfere with the pixel grid, which
        produces a lattice that the colors do not have.
        """
        basis = self.candidates[0].basis
        own = self.colors.repeated(basis)
        striped = own > self.evidence.repeated(basis) / 2
        return striped and own - ridge_height(self.colors, basis) < MIN_CONTRAST * own


def rate_levels(image: Image, known: Mask | None = None) -> Iterator[Level]:
    """Yield the candidates of an image at full detail, at half, a quarter ..., where there are any."""
    proposer = _Proposer(image, known)
    factor = 1
    while factor == 1 or (factor <= COARSEST and min(image.shape[:2]) >= 2 * MIN_PERIOD * factor):
        similarity = proposer.compute_similarity(factor, PRECISE)
        evidence = LatticeEvidence(similarity.pooled)
        own, others = proposer.list_bases(factor)
        fitted = {name: [evidence.fit(reduce_basis(basis)) for basis in bases] for name, bases in others.items()}
        proposals = [*own, *(basis for bases in fitted.values() for basis in bases)]
        stable = [basis for basis in find_stable(evidence, proposals) if is_possible(evidence, basis)]
        if stable:
            candidates = rate_candidates(evidence, stable, fitted)
            yield Level(factor, evidence, LatticeEvidence(similarity.colors), candidates, proposals)
        factor *= 2


class _Proposer:
    """The lattices that are proposed for an image and its shrunk copies. What two copies share is computed once."""

    def __init__(self, image: Image, known: Mask | None) -> None:
        self.image, self.known = image, known
        self._propose = functools.cache(self._propose_for_view)
        self._find_waves = functools.cache(self._find_waves_of_middle)
        self._compute = functools.cache(
            lambda *view: compute_self_similarity(make_view(image, *view), view_mask(known, *view))
        )

    def compute_similarity(self, factor: int, side: int) -> SimilarityMap:
        """Return the self-similarity map of the middle of the shrunk image; ``side`` px in its pixels."""
        similarity: SimilarityMap = self._compute(factor, max(SIDE, min(side, max(self.image.shape[:2]) // factor)))
        return similarity

    def list_bases(self, factor: int) -> tuple[list[Points], dict[str, list[Points]]]:
        """Return the bases that pairs of peaks propose, and those of other detectors, in pixels of the shrunk image."""
        height, width = (length // factor for length in self.image.shape[:2])
        own: list[Points] = []
        others: dict[str, list[Points]] = {}
        for further in view_factors((height, width)):
            pairs, detected = self._propose(factor * further)
            own += [further * basis for basis in pairs]
            for name, bases in detected.items():
                others.setdefault(name, []).extend(further * basis for basis in bases)
        return own, others

    def _propose_for_view(self, factor: int) -> tuple[list[Points], dict[str, list[Points]]]:
        """Return the same for the view that is shrunk by a factor, in its pixels."""
        similarity = self.compute_similarity(factor, SIDE)
        shape = (similarity.pooled.shape[0] // 2 + 1, similarity.pooled.shape[1])
        others = {
            "gncc": Gncc().propose(similarity.colors),
            "frdft": [basis / factor for basis in self._find_waves(factor)],
        }
        fitting = {name: [basis for basis in bases if _fits(basis, shape)] for name, bases in others.items()}
        return propose_lattices(LatticeEvidence(similarity.pooled)), fitting

    def _find_waves_of_middle(self, factor: int) -> list[Points]:
        """Return the lattice of the waves of the image's middle, shrunk by a factor, in pixels of the image.

        An image that was analyzed as a whole has the same waves in its shrunk copies.
        """
        if factor > 1 and max(self.image.shape[:2]) <= SPECTRUM * factor // 2:
            waves: list[Points] = self._find_waves(factor // 2)
            return waves
        middle = make_view(self.image, factor, SPECTRUM)
        return [factor * basis for basis in Frdft(waves=WAVES).propose(_main_color(middle))]


def _main_color(image: Image) -> NDArray[np.float32]:
    """Return the image along the axis of color on which it varies most, ``(H, W, 1)``."""
    if image.shape[2] == 1:
        return image
    axis = np.linalg.eigh(np.cov(image.reshape(-1, image.shape[2]).T.astype(np.float64)))[1][:, -1]
    return np.asarray(image @ (axis * np.sign(axis.sum() or 1.0))[:, np.newaxis], np.float32)


def _fits(basis: Points, shape: tuple[int, int]) -> bool:
    """Return whether the image holds more than two cells of a lattice, none of them thin."""
    height, width = shape
    area, lengths = abs(float(np.linalg.det(basis))), np.hypot(*basis.T)
    fits = bool((np.abs(basis) <= LONGEST * np.array([width, height])).all())
    return fits and MIN_AREA <= area < height * width / 2 and area > 0.1 * float(lengths.prod())


def _describe(level: Level) -> Detection:
    """Return the detection of the most probable candidate, with the others as alternatives."""
    best, *others = level.candidates
    evidence, basis = level.evidence, best.basis
    lattice = Lattice.from_basis(level.factor * basis).oriented()
    between, repeated = highest_added(evidence, basis), evidence.repeated(basis)
    peaks = np.concatenate([basis, *level.proposals])
    diagnostics: dict[str, Any] = {
        "self_similarity": Surface(evidence.gamma, (0, evidence.shape[0] - 1), peaks, basis),
        "shrunk": level.factor,
        "explained": evidence.explained_variance_loo(basis),
        "between": between,
        "relief": 1 - between / repeated if repeated else 0.0,
        "tiles": evidence.tiles(basis),
        "sigmas": evidence.sigmas(basis),
        "traits": best.traits,
    }
    alternatives = tuple(_describe_alternative(other, level.factor, lattice) for other in others[:LISTED])
    return Detection(lattice, best.probability, diagnostics, alternatives, _sum_probabilities(best, others))


def _sum_probabilities(best: Candidate, others: Sequence[Candidate]) -> Probabilities:
    """Return what the best candidate is: exact, a multiple or fraction of another candidate, or neither."""
    nested = sum(other.probability for other in others if relate_bases(other.basis, best.basis) > 0)
    return Probabilities(best.probability, nested, max(1 - best.probability - nested, 0.0))


def _describe_alternative(candidate: Candidate, factor: int, chosen: Lattice) -> Alternative:
    lattice = Lattice.from_basis(factor * candidate.basis).oriented()
    change = relate(lattice, chosen, TOLERANCE, SHARE)
    return Alternative(lattice, candidate.probability, change.name if change else "unrelated", candidate.merit)
