"""The lattice detector of nrbench: the smallest lattice whose tiles best predict one another."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from functools import partial
from typing import Any, ClassVar, Literal

import numpy as np
from numpy.typing import NDArray

from nrbench.detectors.agreement.evidence import Evidence
from nrbench.detectors.agreement.evidence_kernels import reduce_all
from nrbench.detectors.agreement.likeness import SIDE, Likeness, compute_likeness, make_view, max_factor, views
from nrbench.detectors.agreement.search import StableLattice, SublatticeSearch, highest_added, propose_lattices
from nrbench.detectors.agreement.short_list import (
    SHARE,
    TOLERANCE,
    Rival,
    ShortList,
    is_same,
    relate_bases,
    share_certainty,
)
from nrbench.detectors.autocorrelation.surrogates import measure_surrogates
from nrbench.detectors.dominance import Dominance
from nrbench.detectors.frdft import Frdft
from nrbench.detectors.gncc import Gncc
from nrbench.errors import checker
from nrbench.imaging.convert import Image, crop_middle
from nrbench.lattice.comparison import relate
from nrbench.lattice.geometry import Lattice, Points, hermite_matrices, reduced_basis
from nrbench.plugins.forms import Alternative, Detection, NoLatticeFound, Role, Surface

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
WAVES = 12
"""Number of the strongest waves from which ``frdft`` proposes a lattice."""
SPECTRUM = 256
"""px; side of the middle of the image whose waves are searched."""
LONGEST = 0.8
"""Proposals with a vector above this share of the image's sides are left out, and ..."""
MIN_AREA = 8.0
"""... proposals with a smaller cell, px^2."""
REPLACE = 2.5
"""The best stable lattice is replaced by a rival that is more probable by this factor."""
LISTED = 6
"""Largest number of alternatives."""
COLOR_LOSS = 0.2
"""The colors repeat by a coarser lattice than the structure if their correlation at the vectors that the structure's
lattice adds is lower by this share."""
COLOR_SPLIT = 0.2
"""The colors need a coarser lattice than the chosen one if their correlation at its multiples exceeds that at the other
vectors by this share."""
COLOR_CELLS = (2, 3, 4, 6, 8)
"""Indices of the coarser lattices that are tried for the colors."""
FEWEST = 8
"""Least number of lattice vectors, and of tiles, for comparing the lattice of the colors with that of the shapes."""
_OTHER: dict[Role, Role] = {"structure": "color", "color": "structure", "": ""}

_check = checker("consensus")


@dataclass(frozen=True)
class Consensus:
    """The smallest lattice whose tiles best predict one another.

    Other detectors return supercells, subcells along the joints of a wall, and lattices that occur by chance. This one
    is built to avoid these errors.

    1. Slow lighting is removed from the image. Its colors, slopes and edges are correlated with their shifted copies;
       the mean of the three correlations is the likeness of the image to its shifted self
       (:mod:`nrbench.detectors.agreement.likeness`).
    2. Pairs of its most prominent peaks propose lattices, and so do the detectors ``gncc``, ``frdft`` and
       ``dominance``, without their tests against chance. Each lattice is fitted to sub-pixel precision at all its
       multiples at once (:class:`nrbench.detectors.agreement.evidence.Evidence`). Its merit is the share of the
       variance that is explained if each tile is predicted from all others. Supercells have a low merit because they
       have few tiles; wrong vectors have a low merit because their tiles differ.
    3. The best lattices are replaced by finer ones as long as the vectors that these add agree as well. A lattice that
       lies on a ridge is discarded (:mod:`nrbench.detectors.agreement.search`).
    4. The remaining lattices, their coarser and finer neighbors, and the proposals of the other detectors make a short
       list. A regression tells from the traits of each lattice how probable it is that it is exact, a sub- or
       supercell, or neither (:mod:`nrbench.detectors.agreement.short_list`). The stable lattice of the highest merit is
       returned, unless another one is much more probable.

    The alternatives are the rest of the short list, the most probable first; their ``evidence`` is the merit. If the
    colors repeat by a coarser lattice than slopes and edges, one of the two has the role ``"structure"``, the other one
    the role ``"color"``. People measure either one, so the probability is divided between them.

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

    version: ClassVar[str] = "2"

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

        The confidence is the probability that the lattice is exact, as measured on texture models and on textures that
        the models lack (``benchmarks/consensus_calibration.py``).

        Diagnostics: ``likeness`` (the correlation, right half, with the candidates and the pair), ``explained`` (the
        share of the variance), ``between`` (the highest correlation that a finer lattice adds), ``relief``, ``tiles``,
        ``sigmas``, ``traits`` (what the regression reads); with ``"surrogate"`` also ``tested`` (the contrast in the
        part that is tested), ``chance`` (the contrasts of the phase-randomized copies) and ``limit``.

        Raises
        ------
        NoLatticeFound
            If the image is constant or no lattice is stable. Unless ``reject`` is ``"none"``, also if the best lattice
            may have occurred by chance.
        """
        if (image[0] == image[0, 0]).all() and (image == image[0]).all():
            raise NoLatticeFound("the image is constant: it has no texture")
        search, proposals = self._prepare(image)
        detection = search.detect(proposals)
        if self.reject == "surrogate":
            detection = self._compare_with_surrogates(image, detection)
        return detection if self.reject == "none" else self._check_strength(detection)

    def list_rivals(self, image: Image) -> list[Rival]:
        """Return the lattices among which the detector chooses, the best stable one first; without any test.

        Raises
        ------
        NoLatticeFound
            If no lattice is stable.
        """
        search, proposals = self._prepare(image)
        return search.rate(proposals)[0]

    def order(self, rivals: list[Rival]) -> list[Rival]:
        """Return the chosen one of :meth:`list_rivals`, then the others, the most probable first.

        The best stable lattice is replaced only by a much more probable one (:data:`REPLACE`) that lies on no ridge.
        """
        ordered = sorted(rivals, key=lambda rival: -rival.probabilities.exact)
        least = math.log(max(self.relief, 0.02))
        first = next(rival for rival in rivals if rival.traits.best)
        for rival in ordered:
            if rival.traits.relief >= least and rival.probabilities.exact > REPLACE * first.probabilities.exact:
                first = rival
                break
        others = [rival for rival in ordered if rival is not first]
        if not first.role:
            others = [rival._replace(role="") for rival in others]
        return [first, *others]

    def _prepare(self, image: Image) -> tuple[_Search, dict[str, list[Points]]]:
        """Return the search at full detail, and the proposals of all detectors."""
        likeness = compute_likeness(crop_middle(image, PRECISE))
        search = _Search(self, Evidence(likeness.pooled), Evidence(likeness.colors), Evidence(likeness.structure))
        return search, self._propose(image, likeness, search.pooled)

    def _propose(self, image: Image, likeness: Likeness, evidence: Evidence) -> dict[str, list[Points]]:
        """Return the bases that each detector proposes, in the image's pixels; its own are named ``consensus``.

        Parameters
        ----------
        image
            The image.
        likeness, evidence
            Those of the middle of the image, which are used if it is the whole image.
        """
        if max(image.shape[:2]) <= SIDE:
            return {"consensus": self._best_proposals(evidence), **_ask_others(image, likeness)}
        proposals: dict[str, list[Points]] = {}
        for view in views(image):
            likeness = compute_likeness(view.image)
            evidence = Evidence(likeness.pooled)
            stable = self.find_stable(evidence, self._best_proposals(evidence))[:VOTES]
            own = {"consensus": [lattice.basis for lattice in stable]}
            for name, bases in (own | _ask_others(view.image, likeness)).items():
                proposals.setdefault(name, []).extend(basis * view.factor for basis in bases)
        return proposals

    def _best_proposals(self, evidence: Evidence) -> list[Points]:
        bases = propose_lattices(evidence, self.peaks, self.proposals)
        return sorted(bases, key=lambda basis: -self.merit(evidence, basis))[:STARTS]

    def find_stable(self, evidence: Evidence, bases: list[Points]) -> list[StableLattice]:
        """Return the stable lattices that are reached from the given ones, by merit."""
        search = self.make_search(evidence)
        stable = [search.find_finest(basis) for basis in bases if self.merit(evidence, basis) > 0]
        return sorted(filter(None, stable), key=lambda lattice: -self.merit(evidence, lattice.basis))

    def make_search(self, evidence: Evidence) -> SublatticeSearch:
        """Return the search for finer lattices with the parameters of this detector."""
        return SublatticeSearch(evidence, self.max_loss, self.tile_allowance, self.scatter, self.relief)

    def merit(self, evidence: Evidence, basis: Points) -> float:
        """Return the share of the variance that is explained, times the number of tiles ** size_exponent."""
        return float(evidence.explained_variance_loo(basis) * evidence.tiles(basis) ** self.size_exponent)

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
        contrast = evidence.repeated(basis) - highest_added(evidence, basis)
        return float(max(contrast, 0.0) * evidence.tiles(basis) ** self.size_exponent)

    def _best_contrast(self, image: Image) -> float:
        """Return the highest contrast of an image's proposals; 0 if there are none."""
        evidence = Evidence(compute_likeness(image).pooled)
        bases = propose_lattices(evidence, self.peaks, COMPARED)
        return max((self._contrast(evidence, basis) for basis in bases), default=0.0)


def _ask_others(image: Image, likeness: Likeness) -> dict[str, list[Points]]:
    """Return the lattices that the other detectors propose, without their tests against chance."""
    proposals = {
        "gncc": Gncc().propose(likeness.colors),
        "frdft": Frdft(waves=WAVES).propose(_main_color(crop_middle(image, SPECTRUM))),
        "dominance": Dominance().propose(likeness.colors),
    }
    return {name: [basis for basis in bases if _fits(basis, image)] for name, bases in proposals.items()}


def _main_color(image: Image) -> NDArray[np.float32]:
    """Return the image along the axis of color on which it varies most, ``(H, W, 1)``."""
    if image.shape[2] == 1:
        return image
    axis = np.linalg.eigh(np.cov(image.reshape(-1, image.shape[2]).T.astype(np.float64)))[1][:, -1]
    return np.asarray(image @ (axis * np.sign(axis.sum() or 1.0))[:, np.newaxis], np.float32)


def _fits(basis: Points, image: Image) -> bool:
    """Return whether the image holds more than two cells of a lattice, none of them thin."""
    height, width = image.shape[:2]
    area, lengths = abs(float(np.linalg.det(basis))), np.hypot(*basis.T)
    fits = bool((np.abs(basis) <= LONGEST * np.array([width, height])).all())
    return fits and MIN_AREA <= area < height * width / 2 and area > 0.1 * float(lengths.prod())


@dataclass
class _Search:
    """The choice among all proposals for one image."""

    detector: Consensus
    pooled: Evidence
    colors: Evidence
    structure: Evidence

    def detect(self, proposals: dict[str, list[Points]]) -> Detection:
        """Return the lattice with its alternatives and diagnostics."""
        rivals, candidates = self.rate(proposals)
        rivals = self.detector.order(rivals)
        detection = self._describe(rivals, candidates)
        if self._is_striped(rivals[0].basis):
            raise NoLatticeFound(
                "the image repeats along one direction by any vector: stripes, not a lattice", detection
            )
        return detection

    def rate(self, proposals: dict[str, list[Points]]) -> tuple[list[Rival], list[Points]]:
        """Return the best stable lattice and its rivals, and all candidates."""
        fitted = {
            name: bases if name == "consensus" else [self.pooled.fit(reduced_basis(basis)) for basis in bases]
            for name, bases in proposals.items()
        }
        candidates = [basis for bases in fitted.values() for basis in bases]
        stable = [lattice.basis for lattice in self.detector.find_stable(self.pooled, candidates)]
        short_list = ShortList(self.pooled, self.structure, partial(self.detector.merit, self.pooled))
        stable = [basis for basis in stable if short_list.is_possible(basis)]
        if not stable:
            raise NoLatticeFound("no two peaks of the correlation generate a lattice by which the image repeats")
        role, partner = self._find_partner(stable[0])
        fitted["consensus"] = [] if partner is None else [partner]
        rivals = short_list.rate(stable, fitted)
        if partner is None or not any(is_same(rival.basis, partner) for rival in rivals[1:]):
            return rivals, candidates
        first = rivals[0]._replace(role=role)
        others = [rival._replace(role=_OTHER[role]) if is_same(rival.basis, partner) else rival for rival in rivals[1:]]
        return [first, *others], candidates

    def _find_partner(self, basis: Points) -> tuple[Role, Points | None]:
        """Return whether a lattice is that of the structure or of the colors, and the other one of the two."""
        finer = self.detector.make_search(self.structure).find_finest(basis)
        if finer is not None and relate_bases(basis, finer.basis) > 1:
            own, added = self.colors.repeated(basis), self.colors.agreement(finer.basis, basis).mean
            if own > 0 and added < (1 - COLOR_LOSS) * own:
                return "color", finer.basis
        for index in COLOR_CELLS:
            for coarser in reduce_all(hermite_matrices(index) @ basis):
                if self._colors_need(coarser, basis):
                    return "structure", coarser
        return "", None

    def _colors_need(self, coarser: Points, basis: Points) -> bool:
        """Return whether the colors repeat by a coarser lattice, clearly better than by the other vectors."""
        own, others = self.colors.agreement(coarser), self.colors.agreement(basis, coarser)
        if min(own.lags, others.lags) < FEWEST or self.pooled.tiles(coarser) < FEWEST or own.mean <= 0:
            return False
        spread = math.sqrt(own.variance + others.variance)
        split = own.mean - others.mean
        return split > COLOR_SPLIT * own.mean and split > self.detector.scatter / 2 * spread

    def _describe(self, rivals: list[Rival], candidates: list[Points]) -> Detection:
        """Return the detection of the first rival, with the others as alternatives."""
        basis = rivals[0].basis
        lattice = Lattice.from_basis(basis).reduced()
        between, repeated = highest_added(self.pooled, basis), self.pooled.repeated(basis)
        peaks = np.concatenate([basis, *candidates])
        diagnostics: dict[str, Any] = {
            "likeness": Surface(self.pooled.gamma, (0, self.pooled.shape[0] - 1), peaks, basis),
            "explained": self.pooled.explained_variance_loo(basis),
            "between": between,
            "relief": 1 - between / repeated if repeated else 0.0,
            "tiles": self.pooled.tiles(basis),
            "sigmas": self.pooled.sigmas(basis),
            "traits": rivals[0].traits,
        }
        probabilities, certainties = share_certainty(rivals)
        alternatives = [
            _make_alternative(rival, certainty, lattice)
            for rival, certainty in zip(rivals[1:], certainties, strict=True)
        ]
        alternatives.sort(key=lambda one: -one.confidence)
        listed = tuple(alternatives[:LISTED])
        return Detection(lattice, probabilities.exact, diagnostics, listed, probabilities, rivals[0].role)

    def _is_striped(self, basis: Points) -> bool:
        """Return whether the lattice lies on a ridge of the colors' correlation, if the colors repeat as well.

        Edges are not a linear function of the pixels. The edges of fine stripes interfere with the pixel grid, which
        produces a lattice that the colors do not have.
        """
        own = self.colors.repeated(basis)
        striped = own > self.pooled.repeated(basis) / 2
        return striped and own - highest_added(self.colors, basis) < self.detector.relief * own


def _make_alternative(rival: Rival, certainty: float, chosen: Lattice) -> Alternative:
    lattice = Lattice.from_basis(rival.basis).reduced()
    change = relate(lattice, chosen, TOLERANCE, SHARE)
    return Alternative(lattice, certainty, change.name if change else "unrelated", rival.merit, rival.role)
