"""The lattice of an image that may be bent: detected in views, followed through the image, checked when straight.

A lattice that is followed becomes knots: places in the image of its points and of points between them
(:class:`~nrbench.tracking.growth.Knots`). Their score is the share of the image that they cover times their mean
correlation with the mean tile.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from typing import Final, NamedTuple

import numpy as np

from nrbench.errors import BadInput
from nrbench.imaging.convert import MIN_SIDE, Image, shrink
from nrbench.lattice.geometry import Lattice, Points
from nrbench.lattice.relation import lattice_error, relate
from nrbench.plugins.forms import Detection, Detector, NoLatticeFound
from nrbench.tracking.bent_lattice import LEAST_AMPLITUDE, Deformation
from nrbench.tracking.following import find_knots, follow_on, merit, probe, rate_knots
from nrbench.tracking.growth import Knots, fit_basis
from nrbench.tracking.tracker import MeanTile, Track, track_tiles

__all__ = ["Followed", "find_deformation"]

LARGEST_VIEW: Final = 512
"""px; largest side of a view other than the whole image, as the detector sees it."""
_DETAIL: Final = 12.0
"""px; least s of the image that the detector sees."""
LEAST_VIEW: Final = 48
"""px; smallest side of a view, as the detector sees it."""
_PLACES = ((1, 1), (0, 0), (2, 2), (0, 2), (2, 0), (1, 0), (1, 2), (0, 1), (2, 1))
"""Row and column, in half sides, of overlapping views of half the image's size, in the order in which they are used."""
_PROMISING = 0.12
"""Score of the knots that a view's lattice first reaches, from which it is followed in full."""
_HALFWAY = 0.4
"""The same, from which a lattice reaches about half of the image: with a correlation of 0.8, it covers half."""
_MOST_FOLLOWED = 4
"""Number of the most promising views whose lattices are followed."""
_COMPLETE = 0.7
"""Score of the knots of a lattice that agrees with another one, from which no third one is tried."""
_MOST_CONFIRMED = 2
"""Number of the best followed lattices for which the detector is run again, on the straightened image."""
_ENOUGH, _CONFIDENT = 0.6, 0.9
"""Confidence times score of an answer, and confidence, from which no further view is used."""
_LEAST = 0.25
"""The same, below which the answer is not used."""
_STILL = 0.1
"""Largest displacement, in s, of any whole tile of an image that is taken for straight without being followed."""
_TRACKED = 0.9
"""Share of the tiles that must be found in such an image."""
_SAME = 0.04
"""Tolerance, in s, at which two lattices count as the same."""


class Followed(NamedTuple):
    """A lattice that was followed through an image.

    Parameters
    ----------
    deformation
        Where it lies.
    detection
        What the detector found where the image is straight, with the alternatives: in the straightened image, or in the
        image itself if it is not bent. None if the lattice was given.
    """

    deformation: Deformation
    detection: Detection | None


def find_deformation(
    image: Image, detector: Detector, quick: Detector, lattice: Lattice | None = None, only_promising: bool = False
) -> Followed:
    """Return the lattice of an image, and its deformation.

    The detector looks at the whole image; fine detail of large elements is left out, because the lattice is measured
    when it is followed. If the lattice that it finds lies in the image without deformation, this is the answer.
    Otherwise lattices of the whole image and of overlapping views, from half the image's size down, are followed
    through the image (:func:`~nrbench.tracking.following.find_knots`), and the straightened image is shown to the
    detector again. The answer is the first one that the detector confirms with a high confidence and whose knots
    cover most of the image, else the one of the highest confidence times score.

    Parameters
    ----------
    image
        ``(H, W, C)``.
    detector
        The detector that finds the lattice of a straight image and confirms that of a straightened one.
    quick
        A faster detector, whose lattices of views are tried before those of ``detector``. It should rather be wrong
        than silent: a wrong lattice cannot be followed.
    lattice
        The lattice, about as it is on average or somewhere in the image; None: it is detected.
    only_promising
        Whether to give up if no lattice that ``quick`` finds in a view can be followed through about half of the image.
        This costs little where there is no lattice.

    Raises
    ------
    NoLatticeFound
        If no view has a lattice that can be followed, or if the given lattice cannot be followed, or only through an
        image that is bent too much to be straightened.
    BadInput
        If the image holds fewer than two cells of the given lattice.
    """
    if lattice is not None:
        return Followed(_follow_given(image, lattice), None)
    quick_views = [proposal for group in _look_at_views(image, quick) for proposal in group]
    detector = _Shrinking(detector, _detail_factor(quick_views))
    first, reason = _look(detector, image)
    if first is not None:
        still = _still(image, first.lattice, first.confidence)
        if still is not None:
            return _followed(still, first)
    best: _Answer | None = None
    for group in _proposals(image, detector, first, quick_views, only_promising):
        for knots in _follow_all(image, group)[:_MOST_CONFIRMED]:
            answer = _answer(image, detector, knots)
            if answer is not None and (best is None or answer.worth > best.worth):
                best = answer
            if best is not None and best.worth >= _ENOUGH and best.detection.confidence >= _CONFIDENT:
                return best.followed(image)
    if best is not None and best.worth >= _LEAST:
        return best.followed(image)
    if first is not None:
        return _followed(_unmeasured(image, first), first)
    raise NoLatticeFound(reason or "no view has a lattice that can be followed through the image")


def _followed(deformation: Deformation, detection: Detection) -> Followed:
    """Return a lattice with the alternatives of a detection, named by their relation to the mean lattice."""
    alternatives = []
    for alternative in detection.alternatives:
        change = relate(alternative.lattice, deformation.lattice)
        alternatives.append(replace(alternative, relation=change.name if change else "unrelated"))
    return Followed(deformation, replace(detection, alternatives=tuple(alternatives)))


@dataclass(frozen=True)
class _Shrinking:
    """A detector that looks at an image shrunk by a factor."""

    detector: Detector
    factor: int

    def detect(self, image: Image) -> Detection:
        try:
            return self._enlarged(self.detector.detect(shrink(image, self.factor)))
        except NoLatticeFound as none:
            raise NoLatticeFound(none.reason, none.best and self._enlarged(none.best)) from None

    def _enlarged(self, detection: Detection) -> Detection:
        alternatives = tuple(
            replace(alternative, lattice=self._enlarge(alternative.lattice)) for alternative in detection.alternatives
        )
        return replace(detection, lattice=self._enlarge(detection.lattice), alternatives=alternatives)

    def _enlarge(self, lattice: Lattice) -> Lattice:
        x, y = lattice.origin
        origin = (self.factor * x + (self.factor - 1) / 2, self.factor * y + (self.factor - 1) / 2)
        return Lattice.from_basis(self.factor * lattice.matrix, origin)


_Proposal = tuple[Lattice, Points | None]
"""A lattice, and the middle (x, y) px of the view that it comes from; None: of the whole image."""


def _detail_factor(proposals: Sequence[_Proposal]) -> int:
    """Return the factor by which an image may be shrunk: few lattices of views then have an s under 12 px.

    Some are subcells, so their lower quartile counts.
    """
    periods = [lattice.s for lattice, _ in proposals]
    return max(1, int(float(np.quantile(periods, 0.25)) / _DETAIL)) if periods else 1


@dataclass(frozen=True)
class _Answer:
    """Knots, what the detector finds in the image that they straighten, and their score."""

    knots: Knots
    detection: Detection
    score: float

    @property
    def worth(self) -> float:
        """How well the lattice explains the image, where a supercell, whose window is too broad, explains less."""
        return self.detection.confidence * self.score

    def followed(self, image: Image) -> Followed:
        """Return the result."""
        return _followed(Deformation.of(image, self.knots, self.detection.confidence), self.detection)


def _look(detector: Detector, image: Image) -> tuple[Detection | None, str]:
    """Return what a detector finds, or None and the reason."""
    try:
        return detector.detect(image), ""
    except NoLatticeFound as none:
        return None, none.reason


def _proposals(
    image: Image,
    detector: _Shrinking,
    whole: Detection | None,
    quick_views: Sequence[_Proposal],
    only_promising: bool,
) -> Iterator[list[_Proposal]]:
    """Yield groups of lattices of the whole image and of views, the most promising first.

    A lattice from a view is as strained as the image is there, and often wrong. How far it can be followed tells.
    """
    first: list[_Proposal] = [] if whole is None else [(whole.lattice, None)]
    ranked = _rank(image, quick_views)
    if only_promising and not (ranked and ranked[0][0] >= _HALFWAY):
        return
    yield first + [proposal for _, proposal in ranked[:_MOST_FOLLOWED]]
    for group in _look_at_views(image, detector):
        yield [proposal for _, proposal in _rank(image, group)[:_MOST_FOLLOWED]]


def _rank(image: Image, proposals: Sequence[_Proposal]) -> list[tuple[float, _Proposal]]:
    """Return the promising ones among lattices of views with how far they can be followed at first, the best first."""
    found = [(probe(image, lattice, middle), (lattice, middle)) for lattice, middle in proposals if middle is not None]
    return sorted((rated for rated in found if rated[0] >= _PROMISING), key=lambda rated: -rated[0])


def _follow_all(image: Image, proposals: list[_Proposal]) -> list[Knots]:
    """Follow lattices through an image until two of them agree, and return the knots of each, the best first."""
    found: list[tuple[float, int, Knots]] = []
    for number, (lattice, middle) in enumerate(proposals):
        knots = find_knots(image, lattice, middle)
        if knots is None or rate_knots(knots, image) < _LEAST:
            continue
        mean = knots.mean_lattice()
        agree = rate_knots(knots, image) >= _COMPLETE and any(
            _is_same(mean, other.mean_lattice()) for _, _, other in found
        )
        found.append((-merit(image, knots), number, knots))
        if agree:
            break
    kept: list[Knots] = []
    for _, _, knots in sorted(found, key=lambda ranked: ranked[:2]):
        if not any(_is_same(knots.mean_lattice(), other.mean_lattice()) for other in kept):
            kept.append(knots)
    return kept


def _look_at_views(image: Image, detector: Detector) -> Iterator[list[_Proposal]]:
    """Yield the lattices of the views of each size, from large views to small ones, with the middles of the views."""
    height, width = image.shape[:2]
    factor = detector.factor if isinstance(detector, _Shrinking) else 1
    scale = 2
    while min(height, width) // scale >= LEAST_VIEW * factor:
        rows, columns = (min(side // scale, LARGEST_VIEW * factor) for side in (height, width))
        found: list[_Proposal] = []
        for row, column in _PLACES:
            # Views of half the image's size overlap by half. Smaller ones are spread as far.
            top, left = round((height - rows) * (1 + row) / 4), round((width - columns) * (1 + column) / 4)
            if scale == 2:
                top, left = (height - rows) * row // 2, (width - columns) * column // 2
            lattice = _best_lattice(detector, image[top : top + rows, left : left + columns])
            if lattice is not None:
                found.append((lattice, np.array([left + (columns - 1) / 2, top + (rows - 1) / 2])))
        yield found
        scale *= 2


def _best_lattice(detector: Detector, view: Image) -> Lattice | None:
    """Return the lattice that a detector finds, or its best candidate."""
    try:
        return detector.detect(view).lattice
    except NoLatticeFound as none:
        return none.best.lattice if none.best else None


def _is_same(one: Lattice, other: Lattice) -> bool:
    return lattice_error(one, other, (1, 1), 0.0, _SAME).relation == "exact"


def _answer(image: Image, detector: Detector, knots: Knots) -> _Answer | None:
    """Let the detector confirm or correct the lattice of knots on the straightened image."""
    answer, change = _confirm(image, detector, knots)
    if answer is not None or change is None:
        return answer
    other = follow_on(image, knots, change)
    return None if other is None else _confirm(image, detector, other)[0]


def _confirm(image: Image, detector: Detector, knots: Knots) -> tuple[_Answer | None, Points | None]:
    """Return the answer if the detector finds the same lattice when the image is straight.

    Otherwise return the cell coordinates of the vectors of the lattice that it finds instead; None if there is none.
    """
    deformation = Deformation.of(image, knots)
    straight, lattice = deformation.rectify()
    if min(straight.shape[:2]) < LEAST_VIEW:
        return None, None
    detection, _ = _look(detector, straight)
    if detection is None:
        return None, None
    if _is_same(detection.lattice, lattice):
        return _Answer(knots, detection, rate_knots(knots, image)), None
    vectors = detection.lattice.matrix @ np.linalg.inv(knots.mean_lattice().matrix)
    return None, vectors


def _follow_given(image: Image, lattice: Lattice) -> Deformation:
    height, width = image.shape[:2]
    if lattice.area > height * width / 2 or np.hypot(*lattice.reduced().t2) > np.hypot(height, width):
        raise BadInput(
            f"lattice {lattice.t1}, {lattice.t2}: an image of {width}x{height} px holds fewer than two cells of it; "
            "give the vectors of a smaller cell, in px"
        )
    still = _still(image, lattice, None)
    if still is not None:
        return still
    knots = find_knots(image, lattice)
    if knots is None:
        raise NoLatticeFound("the given lattice cannot be followed through the image")
    deformation = Deformation.of(image, knots)
    height, width = deformation.straighten()[0].shape[:2]
    if min(height, width) < MIN_SIDE:
        raise NoLatticeFound(
            f"the given lattice is bent so much in the image that only {width}x{height} px of it can be straightened"
        )
    return deformation


def _still(image: Image, lattice: Lattice, confidence: float | None) -> Deformation | None:
    """Return the answer for an image that is not bent: no whole tile lies off the lattice; None if it may be bent."""
    track = _track(image, lattice)
    if track is None or len(track.numbers) < 9:
        return None
    deformation = _from_track(track, confidence)
    off = np.hypot(*deformation.field.T) / deformation.lattice.s
    still = deformation.amplitude < LEAST_AMPLITUDE and off.max() < _STILL
    return deformation if still and deformation.covered >= _TRACKED else None


def _track(image: Image, lattice: Lattice) -> Track | None:
    reduced = lattice.reduced()
    tile = MeanTile.of(image, reduced)
    return None if tile.flat else track_tiles(image, reduced, tile)


def _from_track(track: Track, confidence: float | None) -> Deformation:
    numbers = track.numbers.astype(np.float64)
    places = track.locate(numbers)
    fit = fit_basis(numbers, places)
    lattice = Lattice.from_basis(fit[:2], fit[2])
    correlation = np.full(len(numbers), float(np.median(track.correlation)))
    return Deformation(track.image, lattice, numbers, places, correlation, track.tracked_share(0.5), confidence)


def _unmeasured(image: Image, detection: Detection) -> Deformation:
    """Return the lattice of the whole image where no deformation could be measured."""
    points = detection.lattice.points(image.shape[:2])
    cells = detection.lattice.to_cell(points)
    return Deformation(image, detection.lattice, cells, points, np.zeros(len(cells)), 0.0, detection.confidence)
