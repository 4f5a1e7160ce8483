"""Integrity: share of elements that are whole, not joined of parts that do not belong together."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace
from typing import ClassVar

import numpy as np
import scipy
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from nrbench.imaging.convert import Image, gray, quantize
from nrbench.lattice.geometry import Points
from nrbench.plugins.forms import Column, Observation, Score

from .residual_tiles.dependence import sum_variance
from .residual_tiles.tiles import align_middles, draw_fresh, find_middles, measure_fresh, offset_noise
from .verdict.examination import examine
from .verdict.exponential_tail import ExponentialTail
from .verdict.measurements import Measurements
from .verdict.reference import NoFreshDraw, Reference
from .verdict.verdict import Verdict
from .whole_elements.composite_tiles import (
    Discriminant,
    Levels,
    Rows,
    WholeTiles,
    alteration_moments,
    compose_tiles,
    light_moments,
)
from .whole_elements.elements import (
    Box,
    Cutter,
    Element,
    Windows,
    find_color_axes,
    find_elements,
    subtract_mean,
    tile_element,
)
from .whole_elements.joint_test import Cuts, JointTest

_FRESH, _ALARMS = 0.95, 0.002
"""Score of fresh draws, and probability that a fresh draw scores less by chance."""
_RATES = tuple(0.09 * 2.0**-k for k in range(15))
"""Shares of whole elements beyond the limits that are tried."""
BROKEN_SURPRISAL = 8.0
"""Surprisal above which an element is surely broken: see ``benchmarks/validation.py alarms``."""
LEAST_POWER, LEAST_FOUND = 0.1, 12.0
"""Detection power below which elements are not judged; without a model, the least number of elements, without a common
pixel, that would be detected if all were joined. By the variance of a count of 12, an output without a whole element
then scores above a half with a probability of less than 5 %."""

_LEAST_WINDOWS, _LEAST_REFERENCES, _LEAST_OF_ELEMENT = 12, 6, 4
"""Least number of windows of one shape in the output, and of windows without a common pixel in each part of the
references; least number in an image of windows around one element."""
_PARTS = 2
"""Number of parts of the fresh draws."""
_FOLDS, _LEAST_WHOLE, _LEAST_AREA = 4, 12, 0.1
"""Without a model: number of strips of the sample; least number of windows without a common pixel; least area of an
element, over that of a cell. Smaller regions that vary together are grain."""
_ALTERATIONS, _ENOUGH_POWER = ((1.0, 1.0), (0.0, 1.0), (0.0, 0.05)), 0.5
"""Weights of uneven light, and of blur and bending, in the variation of whole elements: the first pair with at least
this detection power. In a gray texture a step of light cannot be distinguished from an element of two tones, and in an
element of a few pixels the border of a blurred region cannot."""
_MOST_REFERENCES, _MOST_ALTERED_PARTS = 400, 2
"""Largest number of windows in each part of the references, and of groups of windows that are altered."""
_TAIL = 0.9
"""Quantile above which the evidence of whole tiles has an exponential tail."""
_ALIGNMENT = 0.4
"""Misalignment of a tile, px: a fraction of the rounding of a whole-pixel copy."""
_ROUNDING = 1 / 255
_SHARE_OF_VARIANCE = 0.02
_LEAST_CONTRAST, _LOW = 0.8, 0.01
"""Share of a low quantile of the references' contrast below which a tile is ignored, and that quantile. After a strong
blur the parts of a tile cannot be distinguished."""
_ROUNDS = 3
_CALM, _LEAST_CALM, _MANY_CALM = 0.99, 0.25, 0.9
"""Tiles are calm if their evidence is below this quantile of that of the references. At least a quarter of the tiles
are calm. If more than nine tenths are calm, as in images without defects, the mean is not corrected."""

_DIM = 0.5
_MARK = np.array((0.9, 0.1, 0.1), np.float32)
_WORST, _SIDE, _GAP = 8, 96, 4
"""Tiles in the picture of the worst tiles, their height and the gap between them, px."""


@dataclass(frozen=True)
class Integrity:
    """Share of whole elements: elements that are not joined of parts that do not belong together.

    A brick has one color. A method that cuts and blends inside bricks makes two-tone bricks. These lie in their places,
    so regularity does not detect them. A window has the extent of an element: a brick, or a thread with its pieces on
    both sides of a crossing (:func:`~.whole_elements.elements.find_elements`). A cell can hold several elements. The
    windows are cut around all elements in place, at the displacements that the output shows, and their mean is
    subtracted. The variation of whole elements is learned from fresh draws, and that of composite elements from
    elements of fresh draws that are joined along straight cuts. Directions along which only composite elements vary
    provide the evidence (:class:`~.whole_elements.composite_tiles.Discriminant`). Each half of the fresh draws is
    measured by directions learned from the other half.

    *Score.* Of composite elements a share p has evidence above a limit, and of whole elements at most a share q. If a
    share b of the output's elements is broken, the share of elements above the limit is ``c = b p + (1 - b) q``. The
    score is ``1 - b = 1 - (c - q) / (p - q)``, between 0 and 1. It corrects for broken elements that the test misses
    and for whole ones that it counts. The limit is the one with the largest ``p - q``, which is ``detection_power``. q
    is the share of fresh elements above the limit. It is larger for few elements, so that a fresh draw scores less than
    0.95 with a probability of about 0.002 only. Windows of one thread are not independent. In fresh draws the variance
    of the number of windows above the limit is measured (:func:`~.residual_tiles.dependence.sum_variance`), and windows
    count in clumps of the size that explains it.
    Elements whose power is below 0.1 are not judged: their parts have no tone of their own, or too few are known.
    Without a model the power must also be so large that 12 elements would be detected if all were broken.

    *Broken tiles.* ``broken_share`` and ``broken_tiles`` count only elements whose evidence exceeds chance for each
    element alone, given their number (:class:`~.verdict.exponential_tail.ExponentialTail`). For a photograph they count
    those above the limit of the score, if there are more than chance explains. The pictures show them. An
    element that consists of several pieces, such as a thread, is counted once in every cell, so a joint breaks all
    windows that contain it. ``evidence_p90`` describes the tail and not the median, because most elements of a copier
    are whole copies.

    The effects of blur, uneven light and smooth bending on whole elements are no evidence
    (:func:`~.whole_elements.composite_tiles.alteration_moments`,
    :func:`~.whole_elements.composite_tiles.light_moments`), unless this leaves too little power: in a gray texture a
    step of light looks like an element of two tones. Tiles without contrast after a strong blur, and their neighbors,
    are left out. These are faults of appearance and of regularity. A warp of more than 0.15 s deforms elements and may
    break some; so may a seam that clips values.

    The scores do not depend on the lattice's origin. Elements that regularity detects as displaced are left out,
    because they lie over other elements.

    *Without a model* the sample replaces the fresh draws. It holds too few elements for the covariance of all samples
    of a window, so each cut is tested for itself (:class:`~.whole_elements.joint_test.JointTest`): in a whole element
    the mean colors of both sides go together. The sample is divided into four strips, each of which is measured by
    tests that are learned from the other three. The composite elements are joined of elements of the same strip. If the
    regions that vary together have little power, tiles take the place of elements.
    """

    version: ClassVar[str] = "10"
    uses: ClassVar[tuple[str, ...]] = ("dominance",)
    columns: ClassVar[Mapping[str, Column]] = {
        "score": Column(
            "1 = elements as whole as in fresh draws, 0 = no element whole; corrected for those that are missed.",
            better="higher",
        ),
        "broken_share": Column(
            "Share of the elements in place that are joined of parts that do not belong together.",
            better="lower",
        ),
        "broken_tiles": Column(
            "Number of elements in place that are joined of parts that do not belong together.",
            "tiles",
            (0.0, math.inf),
            "lower",
        ),
        "evidence_p90": Column(
            "90th percentile of the elements' evidence of being joined, over that of fresh draws.",
            range=(0.0, math.inf),
            better="lower",
        ),
        "detection_power": Column(
            "Share of fresh elements, joined along straight cuts, that the score would count beyond chance."
        ),
    }

    def score(self, observation: Observation) -> Score:
        """Return the scores, and pictures of all broken elements (``broken``) and of the worst ones (``worst``)."""
        return observation.shared(_score)


def _score(observation: Observation) -> Score:
    verdict = examine(observation).verdict
    if isinstance(verdict, str):
        return Score.missing(Integrity.columns, verdict)
    try:
        broken = find_broken(verdict, observation)
    except NoFreshDraw as without:
        return Score.missing(Integrity.columns, str(without))
    if isinstance(broken, str):
        return Score.missing(Integrity.columns, broken)
    values: dict[str, float | None] = {
        "score": broken.score,
        "broken_share": broken.share,
        "broken_tiles": float(len(broken.places)),
        "evidence_p90": broken.evidence_p90,
        "detection_power": broken.detection_power,
    }
    records = {
        "tiles": broken.tiles,
        "limit": BROKEN_SURPRISAL,
        "places": [[float(x), float(y)] for x, y in verdict.locate_in_output(broken.places)],
        "surprisals": [float(value) for value in broken.surprisals],
        "elements": [
            {"place": [float(value) for value in one.place], "sides": one.box.sides.tolist()} for one in broken.elements
        ],
    }
    if broken.detection_power < broken.least_power:
        reason = f"undecided: only {broken.detection_power:.0%} of joined elements would be detected"
        reasons = {name: reason for name in Integrity.columns if name != "detection_power"}
        return Score(values | dict.fromkeys(reasons), reasons, records=records)
    pictures = {"broken": draw_broken(verdict.output.image, broken)}
    if len(broken.places):
        pictures["worst"] = enlarge_worst(verdict.output.image, broken)
    return Score(values, {}, pictures, records)


@dataclass(frozen=True)
class BrokenTiles:
    """The broken elements of an output.

    Parameters
    ----------
    boxes
        One for each broken element: the shape of its window.
    places
        ``(n, 2)``: middles (x, y) px of the broken elements, largest surprisal first.
    surprisals
        ``(n,)``: about -log of the probability that the worst element of a fresh draw has more evidence.
    tiles
        Number of elements in place, whole within the output.
    score
        Estimated share of whole elements.
    evidence_p90
        90th percentile of the evidence over that of fresh draws.
    detection_power
        Share of composite elements of fresh draws that the score would count beyond chance.
    least_power
        Detection power below which the elements are not judged.
    elements
        The elements of a cell.
    """

    boxes: list[Box]
    places: Points
    surprisals: Levels
    tiles: int
    score: float
    evidence_p90: float
    detection_power: float
    least_power: float
    elements: list[Element]

    @classmethod
    def none(cls) -> BrokenTiles:
        """Return the result if no part of a cell varies together, so that joined elements look whole: no power."""
        nowhere, nothing = np.zeros((0, 2)), np.zeros(0)
        return cls([], nowhere, nothing, 0, 1.0, 0.0, 0.0, LEAST_POWER, [])

    @property
    def share(self) -> float:
        """Share of broken elements."""
        return min(len(self.places) / max(self.tiles, 1), 1.0)


@dataclass(frozen=True)
class LearnedElements:
    """What the references show of elements whose windows have one shape.

    Parameters
    ----------
    elements
        The elements.
    discriminants
        Two discriminants, each with the mean evidence of whole windows.
    whole, composite
        Evidence of whole and of composite windows, over that mean.
    cell_area
        Area of a cell, px^2.
    colors
        ``(C, k)``: the axes of color.
    usual
        Share of the whole windows below the limit at which the power is stated.
    images
        For each fresh draw, the numbers ``(n, 2)`` of the cells of its windows, and their evidence. Without a model
        there are none.
    """

    elements: list[Element]
    discriminants: list[tuple[Discriminant | JointTest, float]]
    whole: Levels
    composite: Levels
    cell_area: float
    colors: Points
    usual: float = _CALM
    images: tuple[tuple[NDArray[np.int64], Levels], ...] = ()

    @property
    def power(self) -> float:
        """Share of composite windows with more evidence than usual whole ones."""
        return float((self.composite > np.quantile(self.whole, self.usual)).mean())

    @property
    def box(self) -> Box:
        """The shape of the windows."""
        return self.elements[0].box

    @property
    def overlap(self) -> float:
        """Number of windows that contain the same pixel."""
        return max(len(self.elements) * self.box.area / self.cell_area, 1.0)


@dataclass(frozen=True)
class _Evidence:
    """Evidence of the output's windows around elements whose windows have one shape.

    Parameters
    ----------
    middles
        ``(n, 2)``: middles of the windows, (x, y) px.
    output
        ``(n,)``: their evidence.
    learned
        Statistics of the references.
    """

    middles: Points
    output: Levels
    learned: LearnedElements


def find_broken(verdict: Verdict, observation: Observation) -> BrokenTiles | str:
    """Return the broken elements of an output, or the reason why they cannot be found.

    If the verdict on regularity has no power, the places of the tiles are not known.
    """
    if verdict.lack_of_power:
        return f"undecided: {verdict.lack_of_power}"
    noise = offset_noise(verdict.references)
    learned = learn_references(verdict.reference, observation, noise)
    if isinstance(learned, str):
        return learned
    if not learned:
        return BrokenTiles.none()
    # Fresh draws are cut as the output is: on the lattice if the content is not displaced.
    displaced = verdict.reference.source == "sample" or _is_displaced(observation)
    middles = find_middles(verdict.output, noise) if displaced else align_middles(verdict.output, verdict.references)
    output = Cutter.from_measurements(verdict.output, middles).project_colors(learned[0].colors)
    evidence = []
    for one in learned:
        windows = [_select_in_place(output.cut(element), verdict) for element in one.elements]
        windows = [some for some in windows if len(some.middles) >= _LEAST_OF_ELEMENT]
        if sum(len(some.middles) for some in windows) >= _LEAST_WINDOWS:
            levels = [_output_evidence(one, subtract_mean(some.values)) for some in windows]
            middles = np.concatenate([some.middles for some in windows])
            evidence.append(_Evidence(middles, np.concatenate(levels), one))
    if not evidence:
        return f"undecided: fewer than {_LEAST_WINDOWS} whole elements in place to compare"
    return _count_broken(evidence, model=verdict.reference.source == "model")


def learn_references(reference: Reference, observation: Observation, noise: Points) -> list[LearnedElements] | str:
    """Return what the references show of the elements, in groups of one shape, or the reason why they show nothing.

    The list is empty if no part of a cell varies together.

    The references are fresh draws, or else the sample. Each half of the fresh draws, or each quarter of the sample, is
    measured by directions learned from the rest.

    Parameters
    ----------
    reference
        The reference of the verdict.
    observation
        The sample, and its fresh draws if there are any.
    noise
        2 x 2: covariance of tile offsets in images without displacements, px^2.
    """
    if reference.source == "sample":
        return _learn_sample(reference, observation.sample, noise)
    if _is_displaced(observation):
        measured = observation.shared(measure_fresh)
        cutters = [Cutter.from_measurements(one, find_middles(one, noise)) for one in measured]
    else:
        draws = observation.shared(draw_fresh)
        cutters = [Cutter(quantize(draw.image), reference.lattice) for draw in draws]
    colors = find_color_axes(cutters)
    if len(colors) != observation.output.shape[2]:
        return "undecided: the references hold no whole cell"
    cutters = [cutter.project_colors(colors) for cutter in cutters]
    groups: list[list[Element]] = []
    learned: list[LearnedElements] = []
    for grain in (False, True):
        groups = find_elements(cutters, grain=grain) or groups
        learned = [one for group in groups if (one := _learn(cutters, group, colors)) is not None] or learned
        if any(one.power >= LEAST_POWER for one in learned):
            break
    if not groups:
        return []
    return learned or f"undecided: the references hold fewer than {_PARTS} x {_LEAST_REFERENCES} whole elements"


def _is_displaced(observation: Observation) -> bool:
    """Return whether the model displaces the content of its draws."""
    return observation.truth is not None and observation.truth.displacement is not None


def _learn(cutters: list[Cutter], elements: list[Element], colors: Points) -> LearnedElements | None:
    """Return what fresh draws show of elements; None if they hold too few of them."""
    box = elements[0].box
    halves = [_Half([], [], [], []) for _ in range(_PARTS)]
    for number, cutter in enumerate(cutters):
        for element in elements:
            windows = cutter.cut(element)
            numbers = element.numbers(windows.middles, cutter.lattice)
            halves[number % _PARTS].add(cutter, windows, numbers, subtract_mean(windows.values))
    overlap = max(len(elements) * box.area / cutters[0].lattice.area, 1.0)
    if min(half.count for half in halves) / overlap < _LEAST_REFERENCES:
        return None
    parts = [half.whole_tiles(box) for half in halves]
    floor = _floor([windows for half in halves for windows in half.windows], box, [part.rows for part in parts])
    lit = light_moments(box, colors.sum(0))
    area = cutters[0].lattice.area
    for light, other in _ALTERATIONS:
        altered = [WholeTiles(part.rows, other * part.altered + light * lit) for part in parts]
        learned = _discriminate(elements, altered, floor, area, colors)
        if learned.power >= _ENOUGH_POWER:
            break
    images = [
        image
        for half, (test, level) in zip(halves, learned.discriminants, strict=True)
        for image in half.evidence(test, level)
    ]
    return replace(learned, whole=np.concatenate([levels for _, levels in images]), images=tuple(images))


def _discriminate(
    elements: list[Element], parts: list[WholeTiles], floor: Levels, area: float, colors: Points
) -> LearnedElements:
    """Return the evidence in each half of the fresh draws by the directions learned from the other half."""
    samples = elements[0].box.samples
    discriminants: list[tuple[Discriminant | JointTest, float]] = []
    whole, composite = [], []
    for rest, held in zip(parts[::-1], parts, strict=True):
        discriminant = Discriminant.fit(rest, held, floor, samples)
        evidence = discriminant.evidence(held.rows)
        level = max(float(evidence.mean()), 1e-9)
        discriminants.append((discriminant, level))
        whole.append(evidence / level)
        composite.append(discriminant.evidence(compose_tiles(held.rows, samples)) / level)
    return LearnedElements(elements, discriminants, np.concatenate(whole), np.concatenate(composite), area, colors)


def _learn_sample(reference: Reference, sample: Image, noise: Points) -> list[LearnedElements] | str:
    """Return what a sample shows of its elements, or else of its tiles, or the reason why it shows nothing.

    The windows are the sample's elements. They are its tiles if these have more power, and joined elements would be
    missed more often than found: elements that have no tone are not found by their tones.
    """
    measured = Measurements.at(sample, reference.periodic, reference.prepare_image(sample))
    cutter = Cutter.from_measurements(measured, find_middles(measured, noise))
    colors = find_color_axes([cutter])
    if len(colors) != sample.shape[2]:
        return "undecided: the sample holds no whole cell"
    cutter = cutter.project_colors(colors)
    groups = find_elements([cutter], _LEAST_AREA)
    learned = [one for group in groups if (one := _learn_joints(cutter, group, colors)) is not None]
    power = max((one.power for one in learned), default=-1.0)
    if power < _ENOUGH_POWER:
        tile = _learn_joints(cutter, [tile_element(cutter.lattice)], colors)
        learned = [tile] if tile is not None and tile.power > power else learned
    return learned or f"undecided: the sample holds fewer than {_LEAST_WHOLE} whole elements, or all in a row"


def _learn_joints(cutter: Cutter, elements: list[Element], colors: Points) -> LearnedElements | None:
    """Return what a sample shows of elements; None if it holds too few of them.

    The sample is divided into parallel strips. Each is measured by a test that is learned from the others.
    """
    cuts = Cuts.through(elements[0].box)
    elements = [Element(element.place, cuts.box) for element in elements]
    parts: list[list[Rows]] = [[] for _ in range(_FOLDS)]
    for element in elements:
        windows = cutter.cut(element)
        if len(windows.middles) > 1:
            rows = subtract_mean(windows.values) * math.sqrt(len(windows.middles) / (len(windows.middles) - 1))
            for part, own in zip(parts, _split(windows.middles, cuts.box), strict=True):
                part.append(rows[own])
    area = cutter.lattice.area
    count = sum(len(rows) for part in parts for rows in part) / max(len(elements) * cuts.box.area / area, 1.0)
    if count < _LEAST_WHOLE or min(sum(map(len, part)) for part in parts) < 2:
        return None
    step = -(-sum(len(rows) for part in parts for rows in part) // _MOST_REFERENCES)
    strips = [np.concatenate(part)[::step] for part in parts]
    if min(map(len, strips)) < 2:
        return None
    composites = [compose_tiles(strip, cuts.box.samples) for strip in strips]
    found: list[LearnedElements] = []
    for light in (colors.sum(0), None):
        tests = [
            JointTest.fit(cuts, np.concatenate(strips[:number] + strips[number + 1 :]), light)
            for number in range(len(strips))
        ]
        whole, joined = (
            np.concatenate([test.evidence(rows) for test, rows in zip(tests, held, strict=True)])
            for held in (strips, composites)
        )
        found.append(LearnedElements(elements, [(test, 1.0) for test in tests], whole, joined, area, colors, _TAIL))
        if found[-1].power >= _ENOUGH_POWER:
            break
    return max(found, key=lambda one: one.power)


@dataclass(frozen=True)
class _Half:
    """Windows of one half of the fresh draws, from each image and around each element.

    Their departures and the numbers of their cells lie beside them.
    """

    cutters: list[Cutter]
    windows: list[Windows]
    numbers: list[NDArray[np.int64]]
    rows: list[Rows]

    @property
    def count(self) -> int:
        return sum(map(len, self.rows))

    def add(self, cutter: Cutter, windows: Windows, numbers: NDArray[np.int64], rows: Rows) -> None:
        """Add windows around one element."""
        if len(rows):
            self.cutters.append(cutter)
            self.windows.append(windows)
            self.numbers.append(numbers)
            self.rows.append(rows)

    def evidence(self, test: Discriminant | JointTest, level: float) -> Iterator[tuple[NDArray[np.int64], Levels]]:
        """Yield for each image the numbers of the cells of its windows, and their evidence over ``level``."""
        for image in dict.fromkeys(self.cutters):
            own = [number for number, cutter in enumerate(self.cutters) if cutter is image]
            levels = test.evidence(np.concatenate([self.rows[number] for number in own])) / level
            yield np.concatenate([self.numbers[number] for number in own]), levels

    def whole_tiles(self, box: Box) -> WholeTiles:
        """Return at most as many windows as are needed, and the moments of their alterations."""
        rows = np.concatenate(self.rows)
        step = max(len(self.rows) // _MOST_ALTERED_PARTS, 1)
        altered = [
            alteration_moments(cutter, windows.middles, box)
            for cutter, windows in list(zip(self.cutters, self.windows, strict=True))[::step]
        ]
        return WholeTiles(rows[:: -(-len(rows) // _MOST_REFERENCES)], np.mean(altered, 0))


def _split(middles: Points, box: Box) -> list[NDArray[np.bool_]]:
    """Return the windows of a sample in parallel strips, along its longer side.

    All strips are empty if they are narrower than half a window, because windows of different strips would then show
    the same pixels.
    """
    widths = np.ptp(middles, axis=0) / _FOLDS / box.reach
    along = middles[:, int(np.argmax(widths))]
    place = np.argsort(np.argsort(along, kind="stable"), kind="stable") * _FOLDS // max(len(along), 1)
    return [(place == part) & (widths.max() >= 1) for part in range(_FOLDS)]


def _output_evidence(learned: LearnedElements, rows: Rows) -> Levels:
    """Return the evidence of an output's windows, the median over the discriminants.

    The variances along the directions of one of them can be much too small if it was learned from few windows.
    If many elements are broken, the mean of the calm windows is subtracted instead of the mean of all. Otherwise the
    cuts of the broken elements would change the mean and add evidence to whole ones.
    """
    calm_level = float(np.quantile(learned.whole, _CALM))
    for _ in range(_ROUNDS):
        evidence = np.median([discriminant.evidence(rows) / level for discriminant, level in learned.discriminants], 0)
        calm = evidence <= max(calm_level, float(np.quantile(evidence, _LEAST_CALM)))
        if calm.mean() > _MANY_CALM:
            break
        rows = rows - rows[calm].mean(0)
    return np.asarray(evidence)


def _floor(windows: list[Windows], box: Box, parts: list[Rows]) -> Levels:
    """Return the variance of rounding and of misalignment, plus a share of the texture's variance."""
    mean = np.mean([some.values.mean(0) for some in windows], 0)
    along = np.gradient(mean, axis=1) * box.samples[0]
    across = np.gradient(mean, axis=0) * box.samples[1]
    steep = ((np.stack([along, across], -1) @ np.linalg.inv(box.sides).T) ** 2).sum(-1)
    variance = float(np.mean([part.var(0).mean() for part in parts]))
    return np.asarray(_ROUNDING**2 + _SHARE_OF_VARIANCE * variance + _ALIGNMENT**2 * steep.ravel())


def _select_in_place(windows: Windows, verdict: Verdict) -> Windows:
    """Return the windows that are not displaced and not next to a tile without contrast."""
    output, tiles = verdict.output, verdict.output.tiles
    _, tile = cKDTree(tiles.centers).query(windows.middles)
    displaced = verdict.misplaced_windows[output.windows.find_nearest(windows.middles)] | verdict.displaced[tile]
    usual = np.quantile(np.concatenate([one.tiles.slope for one in verdict.references]), _LOW)
    empty = tiles.centers[tiles.slope < _LEAST_CONTRAST * usual]
    if not len(empty):
        return windows.take(~displaced)
    near, _ = cKDTree(tiles.lattice.to_cell(empty)).query(tiles.lattice.to_cell(windows.middles), p=np.inf)
    return windows.take(~(displaced | (near <= 1)))


@dataclass(frozen=True)
class _Surprisals:
    """Surprisals of single windows of one shape: -log of the probability that a whole window has more evidence.

    Parameters
    ----------
    output, composite
        ``(n,)``: of the windows of the output, and of composite windows of the references.
    overlap
        Number of windows that contain the same pixel.
    references
        Number of whole windows of the references.
    images
        As in :class:`LearnedElements`, with surprisals in place of the evidence.
    """

    output: Levels
    composite: Levels
    overlap: float
    references: int
    images: tuple[tuple[NDArray[np.int64], Levels], ...]

    @classmethod
    def of(cls, evidence: _Evidence) -> _Surprisals:
        learned = evidence.learned
        tail = ExponentialTail.fit(learned.whole, _TAIL, overlap=learned.overlap)
        output, composite = (
            tail.surprisal(levels) + math.log(len(levels)) for levels in (evidence.output, learned.composite)
        )
        images = tuple((numbers, tail.surprisal(one) + math.log(len(one))) for numbers, one in learned.images)
        return cls(output, composite, learned.overlap, len(learned.whole), images)

    def power(self, rate: float) -> float:
        """Return the share of composite windows that are counted at a rate of false alarms."""
        return float((self.composite > -math.log(rate)).mean())

    def clump(self, rate: float) -> float:
        """Return the number of windows that count as one: the variance over the mean of the number beyond a limit.

        It is measured in the fresh draws, and is at least the number of windows that contain the same pixel.
        """
        variance = beyond = 0.0
        for numbers, surprisals in self.images:
            above = surprisals > -math.log(rate)
            variance += sum_variance(numbers, above.astype(np.float64) - rate)
            beyond += float(above.sum())
        return max(self.overlap, variance / beyond) if beyond else self.overlap


@dataclass(frozen=True)
class _Limit:
    """The limit above which windows are counted for the score.

    Parameters
    ----------
    rate
        Share of whole windows that exceed it.
    power
        Share of composite windows that exceed it.
    chance
        Share of windows that is attributed to chance: the expected one, or more, so that a fresh draw almost surely
        scores :data:`_FRESH` or more.
    """

    rate: float
    power: float
    chance: float

    @classmethod
    def at(cls, rate: float, groups: list[_Surprisals]) -> _Limit:
        """Return the limit with a given rate.

        The number of whole windows beyond it has a negative binomial distribution: Poisson's, with a rate that is known
        from a number of references. Windows are counted in clumps, see :meth:`_Surprisals.clump`.
        """
        sizes = np.array([len(group.output) for group in groups], np.float64)
        clump = float(sizes @ [group.clump(rate) for group in groups] / sizes.sum())
        power = float(sizes @ [group.power(rate) for group in groups] / sizes.sum())
        known = rate * sum(group.references for group in groups) / clump
        mean = rate * sizes.sum() / clump
        most = float(scipy.stats.nbinom.isf(_ALARMS, known, known / (known + mean)) * clump / sizes.sum())
        return cls(rate, power, max(rate, (most - (1 - _FRESH) * power) / _FRESH))

    @property
    def net_power(self) -> float:
        """Share of composite windows that are counted and not attributed to chance."""
        return max(self.power - self.chance, 0.0)


def _count_broken(evidence: list[_Evidence], model: bool) -> BrokenTiles:
    """Return the broken elements, and the score.

    Of composite windows a share p exceeds the limit, of whole windows at most a share q. If a share b of the output's
    elements is broken, a share ``b p + (1 - b) q`` of its windows exceeds it. The score is ``1 - b``. The limit is the
    one with the largest ``p - q``.

    Without a model, few whole elements are known, and no element alone exceeds chance. Then the elements above the
    limit of the score are broken, if they are more than chance explains.
    """
    groups = [_Surprisals.of(one) for one in evidence]
    strong = [max(_Limit.at(rate, [group]).net_power for rate in _RATES) >= LEAST_POWER for group in groups]
    if any(strong):
        evidence = [one for one, keep in zip(evidence, strong, strict=True) if keep]
        groups = [group for group, keep in zip(groups, strong, strict=True) if keep]
    limit = max((_Limit.at(rate, groups) for rate in _RATES), key=lambda one: one.net_power)
    total = sum(len(group.output) for group in groups)
    apart = sum(len(group.output) / group.overlap for group in groups)
    counted = float(np.mean(np.concatenate([group.output for group in groups]) > -math.log(limit.rate)))
    surprisals = np.concatenate([group.output for group in groups]) - math.log(total)
    order = np.argsort(-surprisals, kind="stable")
    least = BROKEN_SURPRISAL
    if not model and counted > limit.chance:
        least = min(least, -math.log(limit.rate * total))
    order = order[surprisals[order] > least]
    middles = np.concatenate([one.middles for one in evidence])
    boxes = [one.learned.box for one in evidence for _ in one.middles]
    output = np.concatenate([one.output for one in evidence])
    whole = np.concatenate([one.learned.whole for one in evidence])
    return BrokenTiles(
        [boxes[number] for number in order],
        middles[order],
        surprisals[order],
        tiles=total,
        score=float(np.clip(1 - (counted - limit.chance) / max(limit.net_power, 1e-9), 0, 1)),
        evidence_p90=float(np.quantile(output, 0.9) / max(float(np.quantile(whole, 0.9)), 1e-9)),
        detection_power=limit.net_power,
        least_power=LEAST_POWER if model else max(LEAST_POWER, LEAST_FOUND / apart),
        elements=[element for one in evidence for element in one.learned.elements],
    )


def draw_broken(output: Image, broken: BrokenTiles) -> Image:
    """Return the output in faint gray, with the broken tiles in color and framed."""
    faint = np.repeat((1 - _DIM + _DIM * gray(output))[..., np.newaxis], 3, 2)
    colored = np.broadcast_to(output, (*output.shape[:2], 3))
    for place, box in zip(broken.places, broken.boxes, strict=True):
        reach = box.reach + 1
        x0, y0 = np.maximum(np.floor(place - reach), 0).astype(int)
        x1, y1 = np.ceil(place + reach).astype(int) + 1
        y, x = np.indices(output[y0:y1, x0:x1].shape[:2])
        uv = np.abs(box.coordinates(np.stack([x + x0, y + y0], -1) - place))
        inside, edge = (uv < 0.5).all(-1), (uv >= 0.5 - 1.0 / np.hypot(*box.sides.T)).any(-1)
        faint[y0:y1, x0:x1][inside] = colored[y0:y1, x0:x1][inside]
        faint[y0:y1, x0:x1][inside & edge] = _MARK
    return np.asarray(np.clip(faint, 0, 1), np.float32)


def enlarge_worst(output: Image, broken: BrokenTiles) -> Image:
    """Return up to eight of the worst tiles with their neighborhoods, two tiles wide, side by side, worst first."""
    reach = np.maximum(np.ceil(np.max([2 * box.reach for box in broken.boxes[:_WORST]], 0)).astype(int), 3)
    crops = [_enlarged_crop(output, place, reach) for place in broken.places[:_WORST]]
    gap = np.ones((max(crop.shape[0] for crop in crops), _GAP, output.shape[2]), np.float32)
    return np.concatenate([part for crop in crops for part in (crop, gap)][:-1], 1)


def _enlarged_crop(output: Image, place: Points, reach: NDArray[np.int64]) -> Image:
    middle = np.rint(place).astype(int)
    x, y = (
        np.clip(np.arange(m - r, m + r + 1), 0, side - 1)
        for m, r, side in zip(middle, reach, output.shape[1::-1], strict=True)
    )
    crop = output[np.ix_(y, x)]
    times = max(round(_SIDE / crop.shape[0]), 1)
    return np.asarray(crop.repeat(times, 0).repeat(times, 1))
