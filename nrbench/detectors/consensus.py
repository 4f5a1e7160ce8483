"""The lattice detector of nrbench: the smallest lattice whose tiles best predict one another."""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, field, replace
from functools import partial
from typing import Any, ClassVar, Literal, NamedTuple

import numpy as np
from numpy.typing import NDArray

from nrbench.detectors.agreement.evidence import Evidence, reduced_basis
from nrbench.detectors.agreement.likeness import (
    MIN_PERIOD,
    SIDE,
    Likeness,
    compute_likeness,
    make_view,
    max_factor,
    view_factors,
)
from nrbench.detectors.agreement.search import (
    SublatticeSearch,
    highest_added,
    propose_lattices,
    ridge_height,
)
from nrbench.detectors.agreement.short_list import (
    SHARE,
    TOLERANCE,
    Rival,
    ShortList,
    is_same,
    reclassify,
    relate_bases,
    share_certainty,
)
from nrbench.detectors.autocorrelation.surrogates import measure_surrogates
from nrbench.detectors.dominance import Dominance
from nrbench.detectors.frdft import Frdft
from nrbench.detectors.gncc import Gncc
from nrbench.errors import checker
from nrbench.imaging.convert import Image, crop_middle, shrink
from nrbench.lattice.geometry import Lattice, Points, hermite_matrices
from nrbench.lattice.relation import relate
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
CERTAIN = 0.8
"""Confidence from which the image is not looked at with less detail."""
COARSEST = 8
"""Largest factor by which the image is shrunk to look at it with less detail."""
REPLACE = 2.5
"""The best stable lattice is replaced by a rival that is more probable by this factor."""
LISTED = 6
"""Largest number of alternatives."""
COLOR_SPLIT = 0.01
"""The colors repeat by a coarser lattice than the structure if their correlation at its multiples exceeds that at the
other vectors by this share, and ..."""
COLOR_ERRORS = 10.0
"""... by this number of standard errors. In models whose elements or threads are colored at random it reaches 9.6, in
240 draws; it exceeds 12 in nearly all that are dyed by a rule."""
COLOR_CELLS = (2, 3, 4, 6, 8)
"""Indices of the coarser lattices that are tried for the colors."""
FEWEST = 8
"""Least number of lattice vectors, and of tiles, for comparing the lattice of the colors with that of the shapes."""
_OTHER: dict[Role, Role] = {"structure": "color", "color": "structure", "": ""}

_check = checker("consensus")


class Choice(NamedTuple):
    """The lattice that was chosen among those of all details.

    Parameters
    ----------
    detail
        The number of the detail at which it was chosen.
    rivals
        The chosen lattice, then all others, the most probable first.
    """

    detail: int
    rivals: list[Rival]


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
    5. If this lattice is not certain, the image is shrunk to half, a quarter ... of its size, as far as that leaves
       12 px a period, and the same is done again: fine grain that does not repeat hides the lattice of large elements.
       The most certain of these lattices is returned.

    The alternatives are the rest of the short list, the most probable first; their ``evidence`` is the merit. If the
    colors repeat by a coarser lattice than slopes and edges, one of the two has the role ``"structure"``, the other one
    the role ``"color"``. People measure either one, so the probability is divided between them.

    Images of more than 640 px a side are analyzed in several views, from the middle at full detail to the whole image
    at low detail. The views propose lattices; the choice is made on the middle 2048 px. Time grows as
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

    version: ClassVar[str] = "6"
    uses: ClassVar[tuple[str, ...]] = ("dominance",)

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

        Diagnostics: ``likeness`` (the correlation, right half, with the candidates and the pair), ``shrunk`` (the
        factor by which the image was shrunk, to whose pixels ``likeness`` refers), ``explained`` (the share of the
        variance), ``between`` (the highest correlation that a finer lattice adds), ``relief``, ``tiles``, ``sigmas``,
        ``traits`` (what the regression reads); with ``"surrogate"`` also ``tested`` (the contrast in the part that is
        tested), ``chance`` (the contrasts of the phase-randomized copies) and ``limit``.

        Raises
        ------
        NoLatticeFound
            If the image is constant or no lattice is stable. Unless ``reject`` is ``"none"``, also if the best lattice
            may have occurred by chance.
        """
        if (image[0] == image[0, 0]).all() and (image == image[0]).all():
            raise NoLatticeFound("the image is constant: it has no texture")
        details: list[_Detail] = []
        chosen = self.choose(self._rate_details(image, details))
        if chosen is None:
            raise NoLatticeFound("no two peaks of the correlation generate a lattice by which the image repeats")
        detection = details[chosen.detail].describe(chosen.rivals)
        if self.reject == "surrogate":
            detection = self._compare_with_surrogates(image, detection)
        return detection if self.reject == "none" else self._check_strength(detection)

    def list_rivals(self, image: Image) -> list[tuple[int, list[Rival]]]:
        """Return the lattices among which the detector chooses, for each detail of the image at which there are any.

        Returns
        -------
        list[tuple[int, list[Rival]]]
            The factor by which the image was shrunk, and the lattices, the best stable one first; without any test.
        """
        return list(self._rate_details(image, []))

    def choose(self, details: Iterable[tuple[int, list[Rival]]]) -> Choice | None:
        """Return the choice among the lattices of :meth:`list_rivals`; None if there is none.

        Coarser details are read only until a lattice is certain (:data:`CERTAIN`). Of the lattices that are chosen at
        each detail, the most certain one is returned, of those that explain enough at their detail (``least``) if there
        are any. The lattices of the other details are further rivals.
        """
        orders: list[list[Rival]] = []
        best, highest = 0, (False, -1.0)
        for factor, rivals in details:
            order = self.order(rivals)
            orders.append(order)
            rating = (order[0].merit >= self.least, reclassify(order).exact)
            is_visible = factor == 1 or np.hypot(*order[0].basis[0]) >= MIN_PERIOD * factor
            if is_visible and rating > highest:
                best, highest = len(orders) - 1, rating
            if highest >= (True, CERTAIN):
                break
        if highest[1] < 0:
            return None
        first, *others = orders[best]
        for order in orders[:best] + orders[best + 1 :]:
            known = [first, *others]
            others += [one._replace(role="") for one in order if not any(is_same(one.basis, k.basis) for k in known)]
        return Choice(best, [first, *sorted(others, key=lambda rival: -rival.probabilities.exact)])

    def order(self, rivals: list[Rival]) -> list[Rival]:
        """Return the chosen lattice of one detail, then the others, the most probable first.

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

    def _rate_details(self, image: Image, details: list[_Detail]) -> Iterator[tuple[int, list[Rival]]]:
        """Yield the factor and the rivals of each detail at which there are any, and collect the details."""
        proposals = _Proposals(self, image)
        factor = 1
        while True:
            detail = self._prepare(shrink(image, factor), factor, proposals)
            if detail is not None:
                details.append(detail)
                yield factor, detail.rivals
            factor *= 2
            if factor > COARSEST or min(image.shape[:2]) < 2 * MIN_PERIOD * factor:
                return

    def _prepare(self, image: Image, factor: int, proposals: _Proposals) -> _Detail | None:
        """Return the rated lattices of an image that was shrunk by a factor; None if there are none."""
        likeness = compute_likeness(crop_middle(image, PRECISE))
        search = _Search(self, Evidence(likeness.pooled), Evidence(likeness.colors), Evidence(likeness.structure))
        try:
            rivals, candidates = search.rate(proposals.list_bases(image, factor, likeness, search.pooled))
        except NoLatticeFound:
            return None
        enlarged = [rival._replace(basis=factor * rival.basis) for rival in rivals]
        return _Detail(search, factor, enlarged, candidates)

    def best_proposals(self, evidence: Evidence) -> list[Points]:
        """Return the best of the lattices that pairs of peaks generate, fitted."""
        bases = propose_lattices(evidence, self.peaks, self.proposals)
        return sorted(bases, key=lambda basis: -self.merit(evidence, basis))[:STARTS]

    def find_stable(self, evidence: Evidence, bases: list[Points]) -> list[Points]:
        """Return the bases of the stable lattices that are reached from the given ones, by merit.

        A finer lattice explains little more than the one from which it is reached, so lattices that explain less than
        half of the least share (``least``) are left out. If all do, only the best one is used.
        """
        search = self.make_search(evidence)
        ordered = sorted(bases, key=lambda basis: -self.merit(evidence, basis))
        used = [basis for basis in ordered if evidence.explained_variance_loo(basis) >= self.least / 2] or ordered[:1]
        stable = [search.find_finest(basis) for basis in used if self.merit(evidence, basis) > 0]
        return sorted((one for one in stable if one is not None), key=lambda basis: -self.merit(evidence, basis))

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


@dataclass
class _Proposals:
    """The lattices that each detector proposes for an image and its shrunk copies. What two copies share is kept.

    Parameters
    ----------
    detector
        The detector.
    image
        The image at full detail. The bases that are kept are in its pixels.
    """

    detector: Consensus
    image: Image
    _waves: dict[int, list[Points]] = field(default_factory=dict, init=False)
    _votes: dict[int, dict[str, list[Points]]] = field(default_factory=dict, init=False)

    def list_bases(self, shrunk: Image, factor: int, likeness: Likeness, evidence: Evidence) -> dict[str, list[Points]]:
        """Return the bases that each detector proposes; those of the detector itself are named ``consensus``.

        Parameters
        ----------
        shrunk
            The image, shrunk by the factor. The bases are in its pixels.
        factor
            A power of 2.
        likeness, evidence
            Those of the middle of ``shrunk``, which are used if it is the whole.
        """
        if max(shrunk.shape[:2]) <= SIDE:
            own = {"consensus": self.detector.best_proposals(evidence)}
            return own | self._list_others(shrunk, factor, likeness)
        proposals: dict[str, list[Points]] = {}
        for further in view_factors((shrunk.shape[0], shrunk.shape[1])):
            for name, bases in self._look_at_view(factor * further).items():
                proposals.setdefault(name, []).extend(basis / factor for basis in bases)
        return proposals

    def _look_at_view(self, factor: int) -> dict[str, list[Points]]:
        """Return the bases that each detector proposes for the view that is shrunk by a factor."""
        if factor not in self._votes:
            view = make_view(self.image, factor, SIDE).image
            likeness = compute_likeness(view)
            evidence = Evidence(likeness.pooled)
            stable = self.detector.find_stable(evidence, self.detector.best_proposals(evidence))[:VOTES]
            votes = {"consensus": stable} | self._list_others(view, factor, likeness)
            self._votes[factor] = {name: [factor * basis for basis in bases] for name, bases in votes.items()}
        return self._votes[factor]

    def _list_others(self, view: Image, factor: int, likeness: Likeness) -> dict[str, list[Points]]:
        """Return what the other detectors propose for a view, in its pixels, without their tests against chance."""
        proposals = {
            "gncc": Gncc().propose(likeness.colors),
            "frdft": [basis / factor for basis in self._find_waves(factor)],
            "dominance": Dominance().propose(likeness.colors),
        }
        return {name: [basis for basis in bases if _fits(basis, view)] for name, bases in proposals.items()}

    def _find_waves(self, factor: int) -> list[Points]:
        """Return the lattice of the waves of the image's middle, shrunk by a factor.

        An image that was analyzed as a whole has the same waves in its shrunk copies.
        """
        if factor > 1 and max(self.image.shape[:2]) <= SPECTRUM * factor // 2:
            return self._find_waves(factor // 2)
        if factor not in self._waves:
            middle = make_view(self.image, factor, SPECTRUM).image
            self._waves[factor] = [factor * basis for basis in Frdft(waves=WAVES).propose(_main_color(middle))]
        return self._waves[factor]


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

    def rate(self, proposals: dict[str, list[Points]]) -> tuple[list[Rival], list[Points]]:
        """Return the best stable lattice and its rivals, and all candidates."""
        fitted = {
            name: bases if name == "consensus" else [self.pooled.fit(reduced_basis(basis)) for basis in bases]
            for name, bases in proposals.items()
        }
        candidates = [basis for bases in fitted.values() for basis in bases]
        stable = self.detector.find_stable(self.pooled, candidates)
        short_list = ShortList(self.pooled, self.colors, self.structure, partial(self.detector.merit, self.pooled))
        stable = [basis for basis in stable if short_list.is_possible(basis)]
        if not stable:
            raise NoLatticeFound("no two peaks of the correlation generate a lattice by which the image repeats")
        role, partner = self._find_partner(stable[0], short_list)
        fitted["consensus"] = [] if partner is None else [partner]
        rivals = short_list.rate(stable, fitted)
        if partner is None or not any(is_same(rival.basis, partner) for rival in rivals[1:]):
            return rivals, candidates
        first = rivals[0]._replace(role=role)
        others = [rival._replace(role=_OTHER[role]) if is_same(rival.basis, partner) else rival for rival in rivals[1:]]
        return [first, *others], candidates

    def _find_partner(self, basis: Points, short_list: ShortList) -> tuple[Role, Points | None]:
        """Return whether a lattice is that of the structure or of the colors, and the other one of the two."""
        finer = self.detector.make_search(self.structure).find_finest(basis)
        if finer is not None and relate_bases(basis, finer) > 1:
            change = np.rint(basis @ np.linalg.inv(finer)).astype(np.int64)
            if self._color_errors(finer, change[np.newaxis])[0] > COLOR_ERRORS:
                return "color", finer
        changes = np.concatenate([hermite_matrices(index) for index in COLOR_CELLS])
        errors = self._color_errors(basis, changes)
        best = int(np.argmax(errors))
        if errors[best] <= COLOR_ERRORS or short_list.differs_in_structure(basis, changes[best]):
            return "", None
        return "structure", reduced_basis(changes[best] @ basis)

    def _color_errors(self, basis: Points, changes: NDArray[np.int64]) -> list[float]:
        """Return by how much better the colors repeat by coarser lattices than by the other vectors of a lattice.

        The differences are in standard errors (:meth:`Evidence.split_error`); 0 if it is small, or if there are few
        vectors or tiles.
        """
        errors = []
        tiles = self.pooled.tiles(basis)
        for change, (own, others) in zip(changes, self.colors.split(basis, changes), strict=True):
            if min(own.lags, others.lags) < FEWEST or tiles < FEWEST * abs(np.linalg.det(change)) or own.mean <= 0:
                errors.append(0.0)
                continue
            split, error = own.mean - others.mean, math.sqrt(own.variance / own.lags + others.variance / others.lags)
            # Long threads of equal color make some supercells match, but the vectors of these scatter widely.
            scatter = self.detector.scatter / 2 * math.sqrt(own.variance + others.variance)
            ratio = split / max(error, 1e-6) if split > max(COLOR_SPLIT * own.mean, scatter) else 0.0
            if ratio > COLOR_ERRORS:
                ratio = split / max(self.colors.split_error(basis, change), 1e-6)
            errors.append(ratio)
        return errors

    def is_striped(self, basis: Points) -> bool:
        """Return whether the lattice lies on a ridge of the colors' correlation, if the colors repeat as well.

        Edges are not a linear function of the pixels. The edges of fine stripes interfere with the pixel grid, which
        produces a lattice that the colors do not have.
        """
        own = self.colors.repeated(basis)
        striped = own > self.pooled.repeated(basis) / 2
        return striped and own - ridge_height(self.colors, basis) < self.detector.relief * own


@dataclass(frozen=True)
class _Detail:
    """The rated lattices of an image that was shrunk by a factor.

    The bases of the rivals are in pixels of the image as it was given; those of all candidates, and all that the search
    knows, in pixels of the shrunk one.
    """

    search: _Search
    factor: int
    rivals: list[Rival]
    candidates: list[Points]

    def describe(self, rivals: Sequence[Rival]) -> Detection:
        """Return the detection of the first rival, with the others as alternatives.

        Raises
        ------
        NoLatticeFound
            If the image has stripes instead of a lattice.
        """
        basis, pooled = rivals[0].basis / self.factor, self.search.pooled
        lattice = Lattice.from_basis(rivals[0].basis).reduced()
        between, repeated = highest_added(pooled, basis), pooled.repeated(basis)
        peaks = np.concatenate([basis, *self.candidates])
        diagnostics: dict[str, Any] = {
            "likeness": Surface(pooled.gamma, (0, pooled.shape[0] - 1), peaks, basis),
            "shrunk": self.factor,
            "explained": pooled.explained_variance_loo(basis),
            "between": between,
            "relief": 1 - between / repeated if repeated else 0.0,
            "tiles": pooled.tiles(basis),
            "sigmas": pooled.sigmas(basis),
            "traits": rivals[0].traits,
        }
        probabilities, certainties = share_certainty(rivals)
        likely = sorted(zip(rivals[1:], certainties, strict=True), key=lambda pair: -pair[1])[:LISTED]
        listed = tuple(_make_alternative(rival, certainty, lattice) for rival, certainty in likely)
        detection = Detection(lattice, probabilities.exact, diagnostics, listed, probabilities, rivals[0].role)
        if self.search.is_striped(basis):
            raise NoLatticeFound(
                "the image repeats along one direction by any vector: stripes, not a lattice", detection
            )
        return detection


def _make_alternative(rival: Rival, certainty: float, chosen: Lattice) -> Alternative:
    lattice = Lattice.from_basis(rival.basis).reduced()
    change = relate(lattice, chosen, TOLERANCE, SHARE)
    return Alternative(lattice, certainty, change.name if change else "unrelated", rival.merit, rival.role)
