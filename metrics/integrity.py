"""Integrity: whether the elements of the output are whole, or joined of parts of different elements."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import lru_cache
from typing import Any, ClassVar

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from nrbench.imaging.convert import Image
from nrbench.lattice.geometry import Points
from nrbench.plugins.forms import Column, Observation, Score, Value

from .judgment.examination import examine
from .judgment.joint_tests import Evidence, JointTest, Steps, UnlikeTones, learn_tests
from .judgment.texture_reference import STRIPS, CannotTell, TextureReference
from .judgment.tile_population import gather_tiles
from .perception import limits
from .perception.visible import draw_in_bands, tint_places
from .registration.coarse_plane import CoarsePlane, shift_plane
from .registration.followed import FollowedPicture
from .registration.lattice_net import LatticeNet, Mask, Values, fold_cells, split_cells
from .registration.node_kernels import spread_nodes

_COLOR = np.array((0.7, 0.1, 0.8), np.float32)
_SHUFFLES = 4
"""Number of pictures of shuffled cells that are made of the references."""
_LEAST_SHARE = 0.7
"""Share of the places of a cell that must be known to change places."""
_LEAST_CELLS = 4
_NAMES = ("tones", "tones", "novelty", "steps")
"""Names of the tests, in the order of :func:`learn_tests`."""


@dataclass(frozen=True)
class LimitedTest:
    """A test with the limit of its evidence.

    Parameters
    ----------
    name
        Its name in the records.
    test
        The test, learned from all references.
    limit
        Evidence above which a cell counts as broken.
    power
        Share of cells above the limit where the cells of the references are shuffled.
    chance
        Largest share of cells above the limit that chance explains in whole elements.
    """

    name: str
    test: JointTest
    limit: float = 0.0
    power: float = 0.0
    chance: float = 1.0

    @property
    def able(self) -> bool:
        """Whether enough of the joined elements are detected."""
        return self.power - self.chance >= limits.LEAST_POWER


@dataclass(frozen=True)
class ElementModel:
    """What the references show of whole elements.

    Parameters
    ----------
    joint
        The test that detects best where elements are joined in their places.
    tear
        The novelty of parts that lie elsewhere in their cells.
    unlike
        How much a joint stands out from the detail of the elements (:meth:`Steps.rate_joints`).
    """

    joint: LimitedTest
    tear: LimitedTest
    unlike: float


@dataclass
class Weighed:
    """The evidence of one test in the references, each weighed by a test that was learned without it.

    Parameters
    ----------
    whole
        Evidence of the cells as they are, by parts of the references; several divisions of them into parts.
    joined
        Evidence of shuffled cells, by cuts.
    """

    whole: list[list[Evidence]]
    joined: list[Evidence]


def weigh_draws(reference: TextureReference, rng: np.random.Generator) -> list[Weighed]:
    """Weigh each half of the fresh draws by the other half, for each test.

    Noise that nobody sees is added before, so that it breaks no element of an output.
    """
    net = reference.net
    planes = [CoarsePlane(fine, known, net.samples) for fine, known in reference.residuals]
    found = [Weighed([[]], []) for _ in _NAMES]
    for k in (0, 1):
        seen = [replace(p, fine=p.fine + _unseen_noise(p, rng)) for p in planes[k::2]]
        joined = [shuffle_cells(plane, net, rng) for plane in planes[k::2][: _SHUFFLES // 2]]
        for test, own in zip(learn_tests(planes[1 - k :: 2], net), found, strict=True):
            own.whole[0] += [test.weigh(plane) for plane in seen]
            own.joined += [test.weigh(plane) for plane in joined]
    return found


def weigh_sample(reference: TextureReference, tests: Sequence[JointTest], rng: np.random.Generator) -> list[Weighed]:
    """Weigh each of four strips of a sample by the mean cell and the tests of the others.

    The strips run along both lattice vectors, or along their sum and difference if tones go together farther along
    these, because threads run through all strips across them. The sample counts as it is and moved by half a pixel,
    which nobody sees.
    """
    net, ((fine, known),) = reference.net, reference.departures
    plane = CoarsePlane(fine, known, net.samples)
    found = [Weighed([], []) for _ in _NAMES]
    shown = split_cells(plane.complete, (limits.PLACES, limits.PLACES)).mean((2, 3)) > _LEAST_SHARE
    for strips in _number_strips(shown, tests):
        pictures = [plane, *(shuffle_cells(plane, net, rng, strips) for _ in range(_SHUFFLES // 2))]
        pictures.append(_misplace(plane, net.tile(reference.model.mean), net, rng))
        evidence = np.full((len(_NAMES), len(pictures), *net.cells), np.nan)
        for strip in np.unique(strips[shown]):
            rest = known & net.spread(strips != strip)
            mean = net.tile(fold_cells(fine, rest, net.samples))
            learned = learn_tests([CoarsePlane(fine - mean, rest, net.samples)], net)
            for m, picture in enumerate(pictures):
                own = replace(picture, fine=picture.fine - mean)
                for k, test in enumerate(learned):
                    evidence[k, m][strips == strip] = test.weigh(own)[strips == strip]
        for weighed, (whole, *joined) in zip(found, evidence, strict=True):
            moved = joined.pop()
            weighed.whole.append([np.concatenate([whole[strips == k], moved[strips == k]]) for k in range(STRIPS)])
            weighed.joined += joined
    return found


def _number_strips(shown: Mask, tests: Sequence[JointTest]) -> list[NDArray[np.intp]]:
    """Return the number of the strip of each cell, ``(N1, N2)``, along two vectors: of about as many cells."""
    i, j = (np.asarray(number) for number in np.indices(shown.shape))
    tones = next(test for test in tests if isinstance(test, UnlikeTones))
    p = limits.PLACES
    related = {pair.lag: float(pair.constant.mean()) for pair in tones.pairs}
    straight = max(related[p, 0], related[0, p]) >= max(related[p, p], related[p, -p])
    found: list[NDArray[np.intp]] = []
    for line in (i, j) if straight else (i - j, i + j):
        edges = np.quantile(line[shown], np.arange(1, STRIPS) / STRIPS) if shown.any() else np.zeros(1)
        found.append(np.searchsorted(edges, line, side="left"))
    return found


def _misplace(plane: CoarsePlane, mean: Values, net: LatticeNet, rng: np.random.Generator) -> CoarsePlane:
    """Return a picture moved by half a pixel in a random direction, which is not seen."""
    angle = rng.uniform(0, 2 * np.pi)
    step = 0.5 * np.array([math.cos(angle), math.sin(angle)]) @ np.linalg.inv(net.vectors) * net.samples
    moved = ndimage.shift(plane.fine + mean, (*step, 0), order=1, mode="nearest")
    return replace(plane, fine=np.asarray(moved - mean, np.float32))


def _unseen_noise(plane: CoarsePlane, rng: np.random.Generator) -> Values:
    """Return smooth noise that has the amplitude that is not seen on the places of the cells."""
    steps, shape = plane.samples // limits.PLACES, plane.values.shape
    at = (np.linspace(0, side - 1, side * step) for side, step in zip(shape[:2], steps, strict=True))
    noise = spread_nodes(rng.normal(0, 1, shape), *at)
    return np.asarray(noise * (limits.UNSEEN_NOISE / split_cells(noise, steps).mean((2, 3)).std()), np.float32)


@lru_cache(maxsize=2)
def learn_elements(reference: TextureReference) -> ElementModel:
    """Learn the tests for joined and torn elements from the references.

    Of the tests for joined elements, the best one, with its limit, is the one by which the smallest share of them
    shows: that with the least ratio of chance to power, among those with enough power. The limit of torn elements lies
    halfway between whole ones and those of which parts are moved by a quarter of s.
    """
    net, rng, pooled = reference.net, np.random.default_rng(0), reference.from_sample
    pictures = reference.departures if pooled else reference.residuals
    planes = [CoarsePlane(fine, known, net.samples) for fine, known in pictures]
    tests = learn_tests(planes, net)
    weighed = weigh_sample(reference, tests, rng) if pooled else weigh_draws(reference, rng)
    tried = [
        _set_limit(LimitedTest(name, test), own, share, pooled)
        for name, test, own in zip(_NAMES, tests, weighed, strict=True)
        for share in limits.WHOLE_SHARES
    ]
    novelty, own = tests[_NAMES.index("novelty")], weighed[_NAMES.index("novelty")]
    mean = net.tile(reference.model.mean)
    torn = [novelty.weigh(tear_cells(plane, mean, net, rng)) for plane in (planes * _SHUFFLES)[:_SHUFFLES]]
    tear = _set_limit(LimitedTest("torn", novelty), Weighed(own.whole, torn), limits.WHOLE_SHARES[-1], pooled, True)
    steps = next(test for test in tests if isinstance(test, Steps))
    return ElementModel(max(tried, key=_rate), tear, steps.rate_joints(planes))


def _rate(test: LimitedTest) -> tuple[bool, float]:
    """Return by what tests are compared: enough power comes first."""
    return test.able, -test.chance / test.power if test.able else test.power - test.chance


def _set_limit(test: LimitedTest, weighed: Weighed, share: float, pooled: bool, halfway: bool = False) -> LimitedTest:
    """Return the test with the limit that a share of the whole elements exceeds, or one halfway to the joined ones.

    An output is as large as a draw, but as all strips of a sample together (``pooled``).
    """
    divisions, joined = [_drop_unknown(parts) for parts in weighed.whole], _drop_unknown(weighed.joined)
    if min(len(parts) for parts in divisions) < 2 or not joined:
        return test
    whole = np.concatenate([part for parts in divisions for part in parts])
    limit = float(np.quantile(whole, 1 - share))
    if halfway:
        limit = (limit + max(float(np.median(np.concatenate(joined))), limit)) / 2
    shares = [[(part > limit).mean() for part in parts] for parts in divisions]
    spread = math.sqrt(np.mean([np.var(own, ddof=1) / len(own) ** pooled for own in shares]))
    chance = float((whole > limit).mean()) + limits.DEVIATIONS * spread + limits.OVERLOOKED
    power = float((np.concatenate(joined) > limit).mean())
    return replace(test, limit=limit, power=power, chance=chance)


def _drop_unknown(parts: Sequence[Evidence]) -> list[Evidence]:
    """Return what is known of each part, and only parts of which something is."""
    return [part[np.isfinite(part)] for part in parts if np.isfinite(part).any()]


def shuffle_cells(
    plane: CoarsePlane, net: LatticeNet, rng: np.random.Generator, strips: NDArray[np.intp] | None = None
) -> CoarsePlane:
    """Return a picture whose cells, cut at a random place, change places, within strips of cells if they are given.

    The joints are seen through the blur of the eye, as those of an output are.
    """
    cut = rng.integers(0, net.samples)
    values, known = (split_cells(np.roll(a, -cut, (0, 1)), net.samples) for a in (plane.fine, plane.known))
    from_cells = np.argwhere(known[:-1, :-1].mean((2, 3)) > _LEAST_SHARE)
    number = np.zeros(len(from_cells)) if strips is None else strips[tuple(from_cells.T)]
    to_cells = from_cells[np.argsort(number, kind="stable")]
    from_cells = from_cells[np.lexsort((rng.random(len(number)), number))]
    shuffled: list[NDArray[Any]] = []
    for cells in (values, known):
        moved = np.zeros_like(cells)
        moved[tuple(to_cells.T)] = cells[tuple(from_cells.T)]
        shuffled.append(np.roll(moved.swapaxes(1, 2).reshape(*plane.known.shape, *cells.shape[4:]), cut, (0, 1)))
    return _blur_joints(shuffled[0], shuffled[1], net)


def tear_cells(plane: CoarsePlane, mean: Values, net: LatticeNet, rng: np.random.Generator) -> CoarsePlane:
    """Return a picture of which half of the cells, cut at a random place, show what lies a quarter of s beside them."""
    angle = rng.uniform(0, 2 * np.pi)
    step = limits.MOST_STEP * net.s * np.array([math.cos(angle), math.sin(angle)]) @ np.linalg.inv(net.vectors)
    down, right = (int(k) for k in np.rint(step * net.samples))
    moved, both = shift_plane(plane.fine + mean, plane.known, (down, right))
    chosen = np.roll(net.spread(rng.random(net.cells) < 0.5), rng.integers(0, net.samples), (0, 1))
    return _blur_joints(np.where(chosen[..., np.newaxis], moved - mean, plane.fine), both, net)


def _blur_joints(values: Values, known: Mask, net: LatticeNet) -> CoarsePlane:
    """Return a picture whose joints are seen through the blur of the eye."""
    per_pixel, seen = net.samples / np.linalg.norm(net.vectors, axis=1), np.empty_like(values)
    for k, blur in enumerate((limits.BLUR, limits.CHROMA_BLUR, limits.CHROMA_BLUR)):
        sums, share = (
            ndimage.gaussian_filter(a.astype(np.float32), blur * per_pixel) for a in (values[..., k] * known, known)
        )
        seen[..., k] = sums / np.maximum(share, 1e-3)
    return CoarsePlane(seen, known, net.samples)


@dataclass(frozen=True)
class Integrity:
    """The share of the output's elements that are whole.

    A method that copies patches may join the left half of one brick to the right half of another, cut a can in two, or
    change the color of a thread. The mean cell cannot show this, because the parts lie in their places. Three tests do:
    in a whole element the tones of its parts go together (``UnlikeTones``); each part is like that of another
    element at the same place (``NovelParts``); and no step runs along a line on which no element has one
    (:class:`Steps`). The test is used by which the smallest share of joined elements shows.

    Let p be the share of the shuffled cells of the references above the limit of the evidence, q the largest share of
    whole ones that chance explains, and c the share of the output's cells. The score is 1 - (c - q) / (p - q), in
    [0, 1]: the share of whole elements, corrected for those that the test misses and for those that it counts wrongly.
    The limit is the one with the smallest q / p; p - q is ``detection_power``.

    Parts that lie elsewhere in their cells, but so near or so small that no window is out of place, tear an element,
    too. They are sought by novelty, with a limit halfway to the evidence where cells of the references show what lies a
    quarter of s beside them. The smaller of both scores counts.

    Where the power cannot be 0.3 and no element is torn, the score is None, for one of two reasons. *Not applicable*:
    there is no peril, because the elements do not visibly vary, or because the step across a joint hardly stands out
    from the detail of the elements. *Not measured*: joints can be seen, but no test detects them. Beside a sample of
    fewer than twelve cells the score is undecided.

    The references are fresh draws of the model, half of them weighed by the others, or strips of the sample, each
    weighed by the others. Elements out of place are left out; they count for regularity.
    """

    version: ClassVar[str] = "13"
    uses: ClassVar[tuple[str, ...]] = ("dominance",)
    columns: ClassVar[Mapping[str, Column]] = {
        "score": Column("Share of the elements that are whole: 1 as in a fresh draw.", better="higher"),
        "broken_share": Column("Share of the cells with more evidence of a joint than the limit.", better="lower"),
        "broken_tiles": Column("Number of those cells beyond chance.", "tiles", (0.0, float("inf")), "lower"),
        "detection_power": Column(
            "Share of joined elements that is detected, less that of whole ones.", range=(-1.0, 1.0), better="higher"
        ),
    }

    def score(self, observation: Observation) -> Score:
        """Return the scores, and the picture ``broken`` of the cells with evidence of a joint, if there are any."""
        return observation.shared(_score)


def _score(observation: Observation) -> Score:
    examination = examine(observation)
    try:
        followed, reference = examination.followed, examination.reference
        if limits.SLOPE * examination.misplaced >= 1:
            raise CannotTell("not scored: half of the tiles are out of place")
    except CannotTell as reason:
        return Score.missing(Integrity.columns, str(reason))
    model = learn_elements(reference)
    plane = followed.coarse
    varies = gather_tiles(reference).varies
    tests = [test for test, used in ((model.joint, varies), (model.tear, True)) if used and test.able]
    evidence = [test.test.weigh(plane) for test in tests]
    known = min([int(np.isfinite(own).sum()) for own in evidence], default=_LEAST_CELLS)
    shown = sum(known.sum() for _, known in reference.departures) / reference.net.samples.prod()
    silence = _explain_silence(model, varies, known >= _LEAST_CELLS and shown >= limits.FEWEST_SHOWN)
    found = [_count_broken(test, own) for test, own in zip(tests, evidence, strict=True)]
    worst = min(range(len(found)), key=lambda k: float(found[k]["score"] or 0), default=0)
    if silence and (not found or found[worst]["score"] == 1 or known < _LEAST_CELLS or silence == _FEW):
        missing = Score.missing(Integrity.columns, silence)
        return Score({**missing.values, "detection_power": model.joint.power - model.joint.chance}, missing.reasons)
    test = tests[worst]
    broken = np.nan_to_num(evidence[worst], nan=-np.inf) > test.limit
    pictures = {"broken": draw_broken(observation.output, followed, broken)} if broken.any() else {}
    records = {"test": test.name, "limit": test.limit, "chance": test.chance, "cells": known}
    return Score(found[worst], {}, pictures, records)


def _count_broken(test: LimitedTest, evidence: Evidence) -> dict[str, Value]:
    """Return the columns of the score by one test."""
    judged = evidence[np.isfinite(evidence)]
    share = float((judged > test.limit).mean()) if judged.size else 0.0
    excess = max(share - test.chance, 0.0)
    return {
        "score": float(np.clip(1 - excess / max(test.power - test.chance, limits.LEAST_POWER), 0, 1)),
        "broken_share": share,
        "broken_tiles": float(np.rint(excess * judged.size)),
        "detection_power": test.power - test.chance,
    }


def _explain_silence(model: ElementModel, varies: bool, enough: bool) -> str:
    """Return why joined elements are not detected; nothing if they are."""
    if not varies:
        return _ALIKE
    if not enough:
        return _FEW
    if model.joint.able:
        return ""
    return _LOOK_WHOLE if model.unlike < limits.SEEN_STEP else _NO_POWER


_FEW = "undecided: too few whole tiles in place"
_ALIKE = "not applicable: the elements hardly vary, so joined ones look whole"
_LOOK_WHOLE = "not applicable: the detail of the elements hides a joint, so joined ones look whole"
_NO_POWER = "not measured: no test tells joined elements from whole ones"


def draw_broken(output: Image, followed: FollowedPicture, broken: Mask) -> Image:
    """Return the output in faint gray, with the broken cells tinted."""
    phase: Points = followed.expected[followed.in_place].mean(0) if followed.in_place.any() else np.zeros(2)

    def draw(band: Image, top: int) -> Image:
        cells = np.floor(followed.net.locate_pixels(band.shape[:2], top) - phase[:, np.newaxis, np.newaxis])
        i, j = (cell.clip(0, number - 1) for cell, number in zip(cells.astype(np.intp), broken.shape, strict=True))
        return tint_places(band, broken[i, j], _COLOR)

    return draw_in_bands(output, draw)
