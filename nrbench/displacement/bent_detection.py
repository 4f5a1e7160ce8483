"""The lattice of an image that may be bent: detected in views, followed through the image, checked when straight.

Commands, Python functions, runs and methods find the lattice of a picture by :func:`recognize`. "Is this picture bent?"
has one answer for them, :attr:`.Deformation.bent` of what :func:`find_deformation` returns.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import replace
from typing import Final, NamedTuple

import numpy as np

from nrbench.errors import BadInput
from nrbench.imaging.convert import MIN_SIDE, Image, crop_middle, shrink
from nrbench.imaging.masks import Mask
from nrbench.imaging.mean_tile import fold
from nrbench.lattice.geometry import Lattice, Points
from nrbench.lattice.relation import lattice_error, relate
from nrbench.plugins.forms import Detection, Detector, NoLatticeFound, detect_known
from nrbench.plugins.registry import NamedDetector, bent_finders

from .deformation_field import LEAST_AMPLITUDE, Deformation
from .following import find_knots, follow_on, follow_roughly, merit, probe
from .growth import Knots

LARGEST_FOLLOWED: Final = 1024
"""px; larger side of an image up to which commands look for a bent lattice by themselves: it takes long."""

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
_REACHES_HALF = 0.4
"""The same, from which a lattice reaches about half of the image: with a correlation of 0.8, it covers half."""
_SMALLEST = 5.0
"""px; least s of a view's lattice. The windows of smaller cells hold too few pixels: they fit noise, too."""
_MOST_FOLLOWED = 4
"""Number of the most promising views whose lattices are followed."""
_COMPLETE = 0.7
"""Score of the knots of a lattice that agrees with another one, from which no third one is tried."""
_MOST_CONFIRMED = 2
"""Number of the best followed lattices for which the detector is run again, on the straightened image."""
_SURE_CONFIDENCE, _SURE = 0.9, 0.6
"""Confidence, and confidence times score, of an answer from which no further view is used."""
_LEAST = 0.25
"""Confidence times score below which an answer is not used."""
_STILL = 0.1
"""Largest displacement, in s, of any knot of an image that is taken for straight without being followed in full."""
_FOUND = 0.7
"""Share of such an image that knots must cover."""
_SAME = 0.04
"""Tolerance, in s, at which two lattices count as the same."""
View = tuple[Lattice, Points | None]
"""A lattice, and the middle (x, y) px of the view in which it was found; None: the whole image."""


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


def recognize(image: Image, detector: Detector, known: Mask | None = None) -> tuple[Detection, Followed | None]:
    """Return the lattice of an image, and how it was followed if the image is bent.

    The lattice that the detector finds is followed through the image. If it finds none, a bent lattice is looked for.

    Parameters
    ----------
    image
        ``(H, W, C)``.
    detector
        Looks at the image as it is.
    known
        The pixels that count; None: all.

    Returns
    -------
    detection
        Of a bent image: its mean lattice, and the places of its points as ``vertices``.
    followed
        None if the image is not bent, or larger than 1024 px.

    Raises
    ------
    NoLatticeFound
        If the detector finds none, and there is no bent lattice either, or the image is larger than 1024 px.
    """
    try:
        detection = detect_known(detector, image, known)
        deformation = (
            None if max(image.shape[:2]) > LARGEST_FOLLOWED else measure_deformation(image, detection.lattice, known)
        )
        if deformation is None or not deformation.bent:
            return detection, None
        followed = Followed(deformation, detection)
    except NoLatticeFound as none:
        bent = None if none.lattices else find_bent_lattice(image, known)
        if bent is None or bent.detection is None:
            raise none from None
        followed = bent
    assert followed.detection is not None
    found = followed.deformation
    mean = replace(followed.detection, lattice=found.lattice, has_origin=False, vertices=found.lattice_points)
    return mean, followed


def measure_deformation(image: Image, lattice: Lattice | None, known: Mask | None = None) -> Deformation | None:
    """Return the deformation of an image by its lattice, None: it is detected; None if it cannot be followed.

    ``known`` are the pixels that count; None: all.
    """
    try:
        found = find_deformation(image, lattice, known=known).deformation
    except (NoLatticeFound, BadInput):
        return None
    return found if found.covered else None


def find_bent_lattice(image: Image, known: Mask | None = None) -> Followed | None:
    """Return the lattice of a bent image in which a detector finds none; None if there is none.

    It is followed through the pixels that ``known`` counts, through all if that is None.

    Little time is spent on images without a lattice, and none on large ones (:data:`LARGEST_FOLLOWED`).
    """
    if max(image.shape[:2]) > LARGEST_FOLLOWED:
        return None
    try:
        followed = find_deformation(image, only_promising=True, known=known)
    except NoLatticeFound:
        return None
    return followed if followed.deformation.bent else None


def find_deformation(
    image: Image,
    lattice: Lattice | None = None,
    detector: Detector | None = None,
    only_promising: bool = False,
    known: Mask | None = None,
) -> Followed:
    """Return the lattice of an image, and its deformation.

    Parameters
    ----------
    image
        ``(H, W, C)``.
    lattice
        The lattice, about as it is on average or somewhere in the image; None: it is detected.
    detector
        The detector that finds the lattice of a straight image and confirms that of a straightened one; None: that of
        the role ``detector``.
    only_promising
        Whether to give up if no lattice that the quick detector finds in a view can be followed through about half of
        the image. This costs little where there is no lattice.
    known
        The pixels that count; None: all. The others show the mean tile of a given lattice. Knots at them are left out.

    Raises
    ------
    NoLatticeFound
        If no view has a lattice that can be followed, or if the given lattice cannot be followed, or only through an
        image that is bent too much to be straightened.
    BadInput
        If the image holds fewer than two cells of the given lattice.

    Notes
    -----
    ::

        the detector looks at the whole image
        if its lattice lies in the image without deformation: this is the answer
        for the lattices of the whole image and of a quick detector in views, then for those of the detector in views:
            follow the most promising ones through the image (find_knots)
            for the best two: straighten the image, and show it to the detector again
            an answer is a lattice that the detector finds again
            stop at an answer of high confidence whose knots cover most of the image
        return the answer of the highest confidence times score, else what the detector found

    Fine detail of large elements is not shown to the detector: the lattice is measured when it is followed. The quick
    detector has the role ``quick-detector``. It should rather be wrong than silent: a wrong lattice cannot be followed.
    """
    if known is not None:
        shown = image if lattice is None else fold(image, lattice, known).unfold(image.shape[:2])
        shown = np.where(known[..., np.newaxis], image, shown)
        followed = find_deformation(shown, lattice, detector, only_promising)
        knots = followed.deformation.knots.among(known)
        if followed.deformation.covered and not knots.spans_plane:
            raise NoLatticeFound("the lattice cannot be followed through the pixels that count")
        return followed._replace(deformation=replace(followed.deformation, image=image, knots=knots))
    if lattice is not None:
        return Followed(_follow_given(image, lattice), None)
    thorough, quick = (NamedDetector(name) for name in bent_finders())
    detector = detector or thorough
    middle = _best_lattice(quick, crop_middle(image, LARGEST_VIEW), 1)
    first, reason = _look(detector, image, _detail_factor([] if middle is None else [(middle, None)]))
    if first is not None:
        still = _look_straight(image, first.lattice, first.confidence)
        if still is not None:
            return _followed(still, first)
    # Views take long, so they are left to images that are not straight.
    quick_views = [view for group in _look_at_views(image, quick, 1) for view in group]
    factor = _detail_factor(quick_views)
    best: Followed | None = None
    for group in _proposals(image, detector, factor, first, quick_views, only_promising):
        for knots in _follow_all(image, group)[:_MOST_CONFIRMED]:
            answer = _answer(image, detector, factor, knots)
            if answer is not None and (best is None or _worth(answer) > _worth(best)):
                best = answer
            if best is not None and _worth(best) >= _SURE and (best.deformation.confidence or 0) >= _SURE_CONFIDENCE:
                return best
    if best is not None and _worth(best) >= _LEAST:
        return best
    if first is not None:
        knots = Knots.regular(first.lattice, image.shape[:2])
        return _followed(Deformation(image, knots, first.confidence), first)
    raise NoLatticeFound(reason or "no view has a lattice that can be followed through the image")


def _worth(answer: Followed) -> float:
    """Return how well a lattice explains an image; a supercell, whose window is too broad, explains less."""
    return (answer.deformation.confidence or 0.0) * answer.deformation.score


def _followed(deformation: Deformation, detection: Detection) -> Followed:
    """Return a lattice with the alternatives of a detection, named by their relation to the mean lattice."""
    named = ((each, relate(each.lattice, deformation.lattice)) for each in detection.alternatives)
    alternatives = tuple(replace(each, relation=change.name if change else "unrelated") for each, change in named)
    return Followed(deformation, replace(detection, alternatives=alternatives))


def _look(detector: Detector, image: Image, factor: int = 1) -> tuple[Detection | None, str]:
    """Return what a detector finds in an image shrunk by a factor, in px of the image, or None and the reason."""
    try:
        found = detector.detect(shrink(image, factor))
    except NoLatticeFound as none:
        return None, none.reason
    alternatives = [replace(each, lattice=_enlarge(each.lattice, factor)) for each in found.alternatives]
    return replace(found, lattice=_enlarge(found.lattice, factor), alternatives=tuple(alternatives)), ""


def _enlarge(lattice: Lattice, factor: int) -> Lattice:
    """Return a lattice of an image shrunk by a factor in px of the image."""
    x, y = lattice.origin
    origin = (factor * x + (factor - 1) / 2, factor * y + (factor - 1) / 2)
    return lattice if factor == 1 else Lattice.from_basis(factor * lattice.matrix, origin)


def _detail_factor(views: Sequence[View]) -> int:
    """Return the factor by which an image may be shrunk: few lattices of views then have an s under 12 px.

    Some are subcells, so their lower quartile counts.
    """
    periods = [lattice.s for lattice, _ in views]
    return max(1, int(float(np.quantile(periods, 0.25)) / _DETAIL)) if periods else 1


def _proposals(
    image: Image,
    detector: Detector,
    factor: int,
    whole: Detection | None,
    quick_views: Sequence[View],
    only_promising: bool,
) -> Iterator[list[View]]:
    """Yield groups of lattices of the whole image and of views, the most promising first.

    A lattice from a view is as strained as the image is there, and often wrong. How far it can be followed tells.
    """
    first: list[View] = [] if whole is None else [(whole.lattice, None)]
    ranked = _rank(image, quick_views)
    if only_promising and not (ranked and ranked[0][0] >= _REACHES_HALF):
        return
    yield first + [view for _, view in ranked[:_MOST_FOLLOWED]]
    for group in _look_at_views(image, detector, factor):
        yield [view for _, view in _rank(image, group)[:_MOST_FOLLOWED]]


def _rank(image: Image, views: Sequence[View]) -> list[tuple[float, View]]:
    """Return the promising ones among lattices of views with how far they can be followed at first, the best first."""
    found = [
        (probe(image, lattice, middle), (lattice, middle))
        for lattice, middle in views
        if middle is not None and lattice.s >= _SMALLEST
    ]
    return sorted((rated for rated in found if rated[0] >= _PROMISING), key=lambda rated: -rated[0])


def _follow_all(image: Image, views: list[View]) -> list[Knots]:
    """Follow lattices through an image until two of them agree, and return the knots of each, the best first."""
    found: list[tuple[float, int, Knots]] = []
    for number, (lattice, middle) in enumerate(views):
        knots = find_knots(image, lattice, middle)
        if knots is None or (score := Deformation(image, knots).score) < _LEAST:
            continue
        mean = knots.mean_lattice()
        agree = score >= _COMPLETE and any(_is_same(mean, other.mean_lattice()) for _, _, other in found)
        found.append((-merit(image, knots), number, knots))
        if agree:
            break
    kept: list[Knots] = []
    for _, _, knots in sorted(found, key=lambda ranked: ranked[:2]):
        if not any(_is_same(knots.mean_lattice(), other.mean_lattice()) for other in kept):
            kept.append(knots)
    return kept


def _look_at_views(image: Image, detector: Detector, factor: int) -> Iterator[list[View]]:
    """Yield the lattices of the views of each size, from large views to small ones, with the middles of the views."""
    height, width = image.shape[:2]
    scale = 2
    while min(height, width) // scale >= LEAST_VIEW * factor:
        rows, columns = (min(side // scale, LARGEST_VIEW * factor) for side in (height, width))
        found: list[View] = []
        for row, column in _PLACES:
            # Views of half the image's size overlap by half. Smaller ones are spread as far.
            top, left = round((height - rows) * (1 + row) / 4), round((width - columns) * (1 + column) / 4)
            if scale == 2:
                top, left = (height - rows) * row // 2, (width - columns) * column // 2
            lattice = _best_lattice(detector, image[top : top + rows, left : left + columns], factor)
            if lattice is not None:
                found.append((lattice, np.array([left + (columns - 1) / 2, top + (rows - 1) / 2])))
        yield found
        scale *= 2


def _best_lattice(detector: Detector, view: Image, factor: int) -> Lattice | None:
    """Return the lattice that a detector finds, or its best candidate."""
    try:
        return _enlarge(detector.detect(shrink(view, factor)).lattice, factor)
    except NoLatticeFound as none:
        return _enlarge(none.best.lattice, factor) if none.best else None


def _is_same(one: Lattice, other: Lattice) -> bool:
    return lattice_error(one, other, (1, 1), 0.0, _SAME).relation == "exact"


def _answer(image: Image, detector: Detector, factor: int, knots: Knots) -> Followed | None:
    """Show the straightened image to the detector, and return the lattice of knots if it finds the same one.

    If it finds another lattice, that one is followed on from the knots, and shown to it once more.
    """
    for last in (False, True):
        found = Deformation(image, knots)
        straight, lattice = found.rectify()
        detection = _look(detector, straight, factor)[0] if min(straight.shape[:2]) >= LEAST_VIEW else None
        if detection is None:
            return None
        if _is_same(detection.lattice, lattice):
            return _followed(replace(found, confidence=detection.confidence), detection)
        vectors = detection.lattice.matrix @ np.linalg.inv(knots.mean_lattice().matrix)
        other = None if last else follow_on(image, knots, vectors)
        if other is None:
            return None
        knots = other
    return None


def _follow_given(image: Image, lattice: Lattice) -> Deformation:
    height, width = image.shape[:2]
    if lattice.area > height * width / 2 or np.hypot(*lattice.reduced().t2) > np.hypot(height, width):
        raise BadInput(
            f"lattice {lattice.t1}, {lattice.t2}: an image of {width}x{height} px holds fewer than two cells of it; "
            "give the vectors of a smaller cell, in px"
        )
    still = _look_straight(image, lattice, None)
    if still is not None:
        return still
    knots = find_knots(image, lattice)
    if knots is None:
        raise NoLatticeFound("the given lattice cannot be followed through the image")
    deformation = Deformation(image, knots)
    height, width = deformation.rectify()[0].shape[:2]
    if deformation.is_smooth and min(height, width) < MIN_SIDE:
        raise NoLatticeFound(
            f"the given lattice is bent so much in the image that only {width}x{height} px of it can be straightened"
        )
    return deformation


def _look_straight(image: Image, lattice: Lattice, confidence: float | None) -> Deformation | None:
    """Return the answer for an image that is not bent: no knot lies off the lattice; None if it may be bent."""
    knots = follow_roughly(image, lattice)
    if knots is None:
        return None
    deformation = Deformation(image, knots, confidence)
    off = np.hypot(*deformation.field.T) / deformation.lattice.s
    still = deformation.amplitude < LEAST_AMPLITUDE and off.max() < _STILL
    return deformation if still and deformation.covered >= _FOUND else None
