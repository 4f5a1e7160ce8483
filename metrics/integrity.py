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
from nrbench.plugins.forms import Column, Observation, Score

from .judgment.examination import examine
from .judgment.joint_tests import Evidence, JointTest, Steps, UnlikeTones, learn_tests
from .judgment.texture_reference import STRIPS, CannotTell, TextureReference
from .judgment.tile_population import gather_tiles
from .perception import limits
from .perception.visible import tint_places
from .registration.coarse_plane import CoarsePlane
from .registration.followed import FollowedPicture
from .registration.lattice_net import LatticeNet, Mask, Values, average_blocks, fold_cells, split_cells

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
    usual
        The same where the cells are cut at a place that shows it as the median of all cuts does.
    chance
        Largest share of cells above the limit that chance explains in whole elements.
    unlike
        How much a joint stands out from the detail of the elements (:class:`Steps`).
    """

    name: str
    test: JointTest
    limit: float = 0.0
    power: float = 0.0
    usual: float = 0.0
    chance: float = 1.0
    unlike: float = 0.0


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
    these, because threads run through all strips across them.
    """
    net, ((fine, known),) = reference.net, reference.departures
    plane = CoarsePlane(fine, known, net.samples)
    found = [Weighed([], []) for _ in _NAMES]
    shown = split_cells(plane.complete, (limits.PLACES, limits.PLACES)).mean((2, 3)) > _LEAST_SHARE
    for strips in _number_strips(shown, tests):
        pictures = [plane, *(shuffle_cells(plane, net, rng, strips) for _ in range(_SHUFFLES // 2))]
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
            weighed.whole.append([whole[strips == k] for k in range(STRIPS)])
            weighed.joined += joined
    return found


def _number_strips(shown: Mask, tests: Sequence[JointTest]) -> list[NDArray[np.intp]]:
    """Return the number of the strip of each cell, ``(N1, N2)``, along two vectors: of about as many cells."""
    i, j = (np.asarray(number) for number in np.indices(shown.shape))
    tones = next(test for test in tests if isinstance(test, UnlikeTones))
    p = limits.PLACES
    related = {pair.lag: float(pair.constant.mean()) for pair in tones.pairs}
    straight = max(related[p, 0], related[0, p]) >= max(related[p, p], related[p, -p])
    lines = (i, j) if straight else (i - j, i + j)
    found: list[NDArray[np.intp]] = []
    for line in lines:
        edges = np.quantile(line[shown], np.arange(1, STRIPS) / STRIPS) if shown.any() else np.zeros(1)
        found.append(np.searchsorted(edges, line, side="left"))
    return found


def _unseen_noise(plane: CoarsePlane, rng: np.random.Generator) -> Values:
    """Return smooth noise that has the amplitude that is not seen on the places of the cells."""
    steps = plane.samples // limits.PLACES
    noise = ndimage.zoom(rng.normal(0, 1, plane.values.shape), (*steps, 1), order=1)
    return np.asarray(noise * (limits.UNSEEN_NOISE / average_blocks(noise, steps).std()), np.float32)


@lru_cache(maxsize=2)
def learn_elements(reference: TextureReference) -> LimitedTest:
    """Learn the tests for joined elements from the references, and return the one that detects them best.

    The best test, with its limit, is the one by which the smallest share of joined elements shows: that with the least
    ratio of chance to power, among those with enough power.
    """
    net, rng = reference.net, np.random.default_rng(0)
    pictures = reference.departures if reference.from_sample else reference.residuals
    tests = learn_tests([CoarsePlane(fine, known, net.samples) for fine, known in pictures], net)
    weighed = weigh_sample(reference, tests, rng) if reference.from_sample else weigh_draws(reference, rng)
    unlike = next(test.unlike for test in tests if isinstance(test, Steps))
    tried = [
        _set_limit(LimitedTest(name, test, unlike=unlike), own, share, reference.from_sample)
        for name, test, own in zip(_NAMES, tests, weighed, strict=True)
        for share in limits.WHOLE_SHARES
    ]
    return max(tried, key=_rate)


def _rate(test: LimitedTest) -> tuple[bool, float]:
    """Return by what tests are compared: enough power comes first."""
    able = test.power - test.chance >= limits.LEAST_POWER
    return able, -test.chance / test.power if able else test.power - test.chance


def _set_limit(test: LimitedTest, weighed: Weighed, share: float, pooled: bool) -> LimitedTest:
    """Return the test with the limit that a share of the whole elements exceeds.

    An output is as large as a draw, but as all strips of a sample together (``pooled``).
    """
    divisions, joined = [_drop_unknown(parts) for parts in weighed.whole], _drop_unknown(weighed.joined)
    if min(len(parts) for parts in divisions) < 2 or not joined:
        return test
    whole = np.concatenate([part for parts in divisions for part in parts])
    limit = float(np.quantile(whole, 1 - share))
    variances = [
        np.var([(part > limit).mean() for part in parts], ddof=1) / len(parts) ** pooled for parts in divisions
    ]
    spread = math.sqrt(float(np.mean(variances)))
    chance = float((whole > limit).mean()) + limits.DEVIATIONS * spread + limits.OVERLOOKED
    usual = float(np.median([(part > limit).mean() for part in joined]))
    power = float((np.concatenate(joined) > limit).mean())
    return replace(test, limit=limit, power=power, usual=usual, chance=chance)


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
    per_pixel = net.samples / np.linalg.norm(net.vectors, axis=1)
    for k, blur in enumerate((limits.BLUR, limits.CHROMA_BLUR, limits.CHROMA_BLUR)):
        sums, share = (
            ndimage.gaussian_filter(a.astype(np.float32), blur * per_pixel)
            for a in (shuffled[0][..., k] * shuffled[1], shuffled[1])
        )
        shuffled[0][..., k] = sums / np.maximum(share, 1e-3)
    return CoarsePlane(shuffled[0], shuffled[1], net.samples)


@dataclass(frozen=True)
class Integrity:
    """The share of the output's elements that are whole.

    A method that copies patches may join the left half of one brick to the right half of another, cut a can in two, or
    change the color of a thread. The mean cell cannot show this, because the parts lie in their places. Three tests do:
    in a whole element the tones of its parts go together (``UnlikeTones``); each part is like that of another
    element at the same place (``NovelParts``); and no step runs along a line on which no element has one
    (:class:`Steps`). The test is used by which the smallest share of joined elements shows.

    Let p be the share of the shuffled cells of the references above the limit of the evidence, r that share for the
    median of the places where they are cut, q the largest share of whole ones that chance explains, and c the share of
    the output's cells. The score is 1 - (c - q) / (r - q), in [0, 1]: the share of whole elements, corrected
    for those that the test misses and for those that it counts wrongly. The limit is the one with the smallest q / p;
    p - q is ``detection_power``.

    Where the power cannot be 0.3, the score is None, for one of two reasons. *Not applicable*: there is no peril,
    because the elements do not visibly vary, or because the step across a joint hardly stands out from the detail of
    the elements. *Not measured*: joints can be seen, but no test detects them. Beside a sample of fewer than twelve
    cells the score is undecided.

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
        """Return the scores, and the picture ``broken``, which shows the cells with evidence of a joint."""
        return observation.shared(_score)


def _score(observation: Observation) -> Score:
    examination = examine(observation)
    try:
        followed, reference = examination.followed, examination.reference
    except CannotTell as reason:
        return Score.missing(Integrity.columns, str(reason))
    if limits.SLOPE * examination.misplaced >= 1:
        return Score.missing(Integrity.columns, "not scored: half of the tiles are out of place")
    if not gather_tiles(reference).varies:
        return Score.missing(Integrity.columns, "not applicable: the elements hardly vary, so joined ones look whole")
    best = learn_elements(reference)
    power = best.power - best.chance
    evidence = best.test.weigh(CoarsePlane(*followed.residual, followed.net.samples))
    judged = evidence[np.isfinite(evidence)]
    shown = sum(known.sum() for _, known in reference.departures) / reference.net.samples.prod()
    if judged.size < _LEAST_CELLS or shown < limits.FEWEST_SHOWN:
        return Score.missing(Integrity.columns, "undecided: too few whole tiles in place")
    if power < limits.LEAST_POWER:
        silence = _LOOK_WHOLE if best.unlike < limits.SEEN_STEP else _NO_POWER
        missing = Score.missing(Integrity.columns, silence)
        return Score({**missing.values, "detection_power": power}, missing.reasons)
    share = float((judged > best.limit).mean())
    excess = max(share - best.chance, 0.0)
    values = {
        "score": float(np.clip(1 - excess / max(best.usual - best.chance, limits.LEAST_POWER), 0, 1)),
        "broken_share": share,
        "broken_tiles": float(np.rint(excess * judged.size)),
        "detection_power": power,
    }
    pictures = {"broken": draw_broken(observation.output, followed, np.nan_to_num(evidence, nan=-np.inf) > best.limit)}
    records = {"test": best.name, "limit": best.limit, "chance": best.chance, "cells": int(judged.size)}
    return Score(values, {}, pictures, records)


_LOOK_WHOLE = "not applicable: the detail of the elements hides a joint, so joined ones look whole"
_NO_POWER = "not measured: no test tells joined elements from whole ones"


def draw_broken(output: Image, followed: FollowedPicture, broken: Mask) -> Image:
    """Return the output in faint gray, with the broken cells tinted."""
    y, x = np.indices(output.shape[:2])
    phase: Points = followed.expected[followed.in_place].mean(0) if followed.in_place.any() else np.zeros(2)
    cell = (
        (np.stack([x, y], -1) - followed.net.origin) @ np.linalg.inv(followed.net.vectors) - followed.net.first - phase
    )
    number = np.clip(np.floor(cell).astype(int), 0, np.array(broken.shape) - 1)
    marked = broken[number[..., 0], number[..., 1]][..., np.newaxis]
    return tint_places(output, marked, _COLOR)
