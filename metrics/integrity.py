"""Integrity: whether the elements of the output are whole, or joined of parts of different elements."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import lru_cache
from typing import ClassVar

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from nrbench.imaging.convert import Image
from nrbench.lattice.geometry import Points
from nrbench.plugins.forms import Column, Observation, Score

from .judgment.examination import examine
from .judgment.texture_reference import STRIPS, CannotTell, TextureReference
from .perception import limits
from .perception.visible import tint_places
from .randomness import gather_tiles
from .registration.coarse_plane import CoarsePlane, shift_plane
from .registration.followed import FollowedPicture
from .registration.lattice_net import LatticeNet, Mask, Values, split_cells

Lag = tuple[int, int]
_COLOR = np.array((0.7, 0.1, 0.8), np.float32)
_DIRECTIONS = 8
_DISTANCES = (0.25, 0.5)
"""Distances in s of two places of one element."""
_COMPOSITES = 4
"""Number of pictures of joined elements that are made of each reference."""
_FARTHEST = 3
"""Largest distance of joined elements, in cells."""
_LEAST_SHARE = 0.7
"""Share of the places of a cell that must be known."""
_LEAST_CELLS = 4


@dataclass(frozen=True)
class PairModel:
    """How the tones of two places of an element go together.

    Parameters
    ----------
    lag
        From the first to the second place, in places.
    whole, unrelated
        ``(8, 8, 3, 3)``: inverse covariance of their difference in whole elements, and between unrelated places.
    constant
        ``(8, 8)``: logarithm of the ratio of both determinants.
    """

    lag: Lag
    whole: NDArray[np.float32]
    unrelated: NDArray[np.float32]
    constant: NDArray[np.float32]


@dataclass(frozen=True)
class ElementModel:
    r"""How the tones of the parts of an element go together, learned from references.

    For each of 8 x 8 places of the cell and each lag (eight directions at a quarter and a half of s, and the lattice
    vectors, because threads run on), d is the difference of the residual colors of both places. Its covariance is W in
    the references, where elements are whole, and V = cov a + cov b if the places are unrelated. JND^2 is added to both.
    The evidence for a joint is the log-likelihood ratio of Student distributions,

    .. math:: e = \frac{\nu + 3}{2} \left[\ln(1 + d' W^{-1} d / \nu) - \ln(1 + d' V^{-1} d / \nu)\right]
              - \frac{1}{2} \ln \frac{|V|}{|W|},

    and that of a cell is the largest one in it. Pairs that never go together (W = V) give no evidence.

    Parameters
    ----------
    pairs
        The models of all lags.
    limit
        Evidence above which a cell counts as broken.
    power
        Share of cells above the limit where straight cuts join elements to others.
    chance
        Largest share of cells above the limit that chance explains in whole elements.
    """

    pairs: Sequence[PairModel]
    limit: float = 0.0
    power: float = 0.0
    chance: float = 1.0

    def weigh(self, values: Values, known: Mask) -> NDArray[np.float64]:
        """Return the evidence of each cell, ``(N1, N2)``; NaN where too few places are known."""
        shape = (known.shape[0] // limits.PLACES, known.shape[1] // limits.PLACES)
        largest = np.full(known.shape, -np.inf, np.float32)
        for pair in self.pairs:
            other, both = shift_plane(values, known, pair.lag)
            difference = values - other
            whole, unrelated = (_square_form(difference, m, shape) for m in (pair.whole, pair.unrelated))
            ratio = np.log1p(whole / limits.FREEDOM) - np.log1p(unrelated / limits.FREEDOM)
            evidence = (limits.FREEDOM + 3) / 2 * ratio - np.tile(pair.constant, shape) / 2
            largest = np.where(both, np.maximum(largest, evidence), largest)
        places = (limits.PLACES, limits.PLACES)
        seen = split_cells(np.isfinite(largest), places).mean((2, 3))
        return np.where(seen > _LEAST_SHARE, split_cells(largest, places).max((2, 3)), np.nan)


def _square_form(difference: Values, matrices: NDArray[np.float32], shape: tuple[int, int]) -> NDArray[np.float32]:
    """Return d' M d at each place, with one matrix for each place of the cell."""
    total = np.zeros(difference.shape[:2], np.float32)
    for i, j in ((0, 0), (1, 1), (2, 2), (0, 1), (0, 2), (1, 2)):
        factor = np.tile(matrices[..., i, j] * (1 + (i != j)), shape)
        total += difference[..., i] * difference[..., j] * factor
    return total


def list_lags(net: LatticeNet) -> list[Lag]:
    """Return the lags at which two places of one element are compared, in places."""
    angles = np.pi * np.arange(_DIRECTIONS) / _DIRECTIONS
    ends = np.concatenate([d * net.s * np.column_stack([np.cos(angles), np.sin(angles)]) for d in _DISTANCES])
    near = np.rint(limits.PLACES * ends @ np.linalg.inv(net.vectors)).astype(int)
    lags = {(int(i), int(j)) for i, j in near} - {(0, 0)}
    p = limits.PLACES
    return sorted(lags | {(p, 0), (0, p), (p, p), (p, -p)})


def learn_pairs(planes: Sequence[CoarsePlane], lags: Sequence[Lag]) -> list[PairModel]:
    """Estimate the covariances of all pairs of places. With few cells, 3 x 3 neighboring places are pooled."""
    return [_learn_pair(planes, lag) for lag in lags]


def _learn_pair(planes: Sequence[CoarsePlane], lag: Lag) -> PairModel:
    size = limits.PLACES
    sums, count = np.zeros((3, size, size, 3, 3)), np.zeros((size, size))
    for plane in planes:
        other, both = shift_plane(plane.values, plane.complete, lag)
        for k, a in enumerate((plane.values - other, plane.values, other)):
            cells = split_cells(np.where(both[..., np.newaxis], a, 0), (size, size))
            sums[k] += np.einsum("klpqi,klpqj->pqij", cells, cells)
        count += split_cells(both, (size, size)).sum((0, 1))
    if count.mean() < limits.FEW_CELLS:
        sums = ndimage.uniform_filter(sums, (1, 3, 3, 1, 1), mode="wrap")
        count = ndimage.uniform_filter(count, 3, mode="wrap")
    floor = np.eye(3) * limits.JND**2
    joint, first, second = sums / np.maximum(count, 1)[..., np.newaxis, np.newaxis]
    whole, unrelated = joint + floor, first + second + floor
    constant = np.linalg.slogdet(unrelated)[1] - np.linalg.slogdet(whole)[1]
    inverses = [np.linalg.inv(matrices).astype(np.float32) for matrices in (whole, unrelated)]
    return PairModel(lag, inverses[0], inverses[1], constant.astype(np.float32))


@lru_cache(maxsize=2)
def learn_elements(reference: TextureReference) -> ElementModel:
    """Learn the elements of a texture from its references.

    Noise that nobody sees is added to fresh draws before they are weighed, so that it breaks no element of an output.
    Cells of a sample are weighed by a model of its other strips, along both axes, because threads run through all
    strips along them.
    """
    net = reference.net
    lags = list_lags(net)
    planes = [CoarsePlane(fine, known, net.samples) for fine, known in reference.residuals]
    model = ElementModel(learn_pairs(planes, lags))
    rng = np.random.default_rng(0)
    if reference.from_sample:
        strips = [strip for axis in (0, 1) for strip in net.cut_strips(axis, STRIPS)]
        weighed = [_weigh_strip(planes[0], strip, lags) for strip in strips]
    else:
        noise = [rng.normal(0, limits.UNSEEN_NOISE, plane.values.shape).astype(np.float32) for plane in planes]
        weighed = [model.weigh(plane.values + n, plane.complete) for plane, n in zip(planes, noise, strict=True)]
    whole = [evidence[np.isfinite(evidence)] for evidence in weighed]
    whole = [evidence for evidence in whole if evidence.size]
    joined = np.concatenate([_weigh_composites(plane, model, net, rng) for plane in planes])
    if len(whole) < 2 or not joined.size:
        return model
    tried = [_set_limit(model.pairs, whole, joined, share, reference.from_sample) for share in limits.WHOLE_SHARES]
    return max(tried, key=lambda found: found.power - found.chance)


def _weigh_strip(plane: CoarsePlane, strip: Mask, lags: Sequence[Lag]) -> NDArray[np.float64]:
    """Return the evidence of the cells of a strip, by a model of the other strips."""
    rest = ElementModel(learn_pairs([plane.restrict(plane.known & ~strip)], lags))
    evidence = rest.weigh(plane.values, plane.complete)
    inside = split_cells(strip, plane.samples).mean((2, 3))
    return np.where(inside > 0.5, evidence, np.nan)


def _set_limit(
    pairs: Sequence[PairModel],
    whole: list[NDArray[np.float64]],
    joined: NDArray[np.float64],
    share: float,
    pooled: bool,
) -> ElementModel:
    """Return the model with the limit that a share of the whole elements exceeds.

    An output is as large as a draw, but as all strips of a sample together (``pooled``).
    """
    limit = float(np.quantile(np.concatenate(whole), 1 - share))
    shares = np.array([(evidence > limit).mean() for evidence in whole])
    spread = limits.DEVIATIONS * float(shares.std(ddof=1)) / (math.sqrt(len(shares)) if pooled else 1)
    return ElementModel(pairs, limit, float((joined > limit).mean()), float(shares.mean()) + spread + limits.OVERLOOKED)


def _weigh_composites(
    plane: CoarsePlane, model: ElementModel, net: LatticeNet, rng: np.random.Generator
) -> NDArray[np.float64]:
    """Return the evidence of cells through whose middle a straight cut joins elements some cells apart."""
    size, found = limits.PLACES, []
    numbers = np.moveaxis(np.indices(plane.complete.shape), 0, -1) / size @ net.vectors
    reach = np.clip(np.array(plane.complete.shape) // (4 * size), 1, _FARTHEST)
    for _ in range(_COMPOSITES):
        shift = tuple(size * rng.integers(1, reach + 1) * rng.choice((-1, 1), 2))
        other, known = np.roll(plane.values, shift, (0, 1)), np.roll(plane.complete, shift, (0, 1))
        angle = rng.uniform(0, np.pi)
        along = (numbers @ (np.cos(angle), np.sin(angle)) / (3 * net.s) + rng.random()) % 2
        first = along < 1
        evidence = model.weigh(np.where(first[..., np.newaxis], plane.values, other), plane.complete & known)
        balance = split_cells(first, (size, size)).mean((2, 3))
        found.append(evidence[(np.abs(balance - 0.5) < 0.3) & np.isfinite(evidence)])
    return np.concatenate(found)


@dataclass(frozen=True)
class Integrity:
    """The share of the output's elements that are whole.

    A method that copies patches may join the left half of one brick to the right half of another, or change the color
    of a thread. The mean cell cannot show this, because both parts lie in their places. Their tones do: in a whole
    element the tones of its parts go together (:class:`ElementModel`).

    Let p be the share of joined elements of the references above the limit of the evidence, q the largest share of
    whole ones that chance explains, and c the share of the output's cells. The score is 1 - (c - q) / (p - q), in [0,
    1]: the share of whole elements, corrected for those that the test misses and for those that it counts wrongly. The
    limit is the one with the largest p - q, which is ``detection_power``. Below a power of 0.3 the elements of the
    texture do not have tones that tell joined ones from whole ones, and the score is None.

    The references are fresh draws of the model, or strips of the sample, each weighed by a model of the others.
    Elements out of place are left out; they count for regularity.
    """

    version: ClassVar[str] = "11"
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
    model = learn_elements(reference)
    plane = CoarsePlane(*followed.residual, followed.net.samples)
    evidence = model.weigh(plane.values, plane.complete)
    judged = np.isfinite(evidence)
    power = model.power - model.chance
    if not gather_tiles(reference).varies:
        return Score.missing(Integrity.columns, "not applicable: the elements hardly vary, so joined ones look whole")
    if power < limits.LEAST_POWER:
        missing = Score.missing(
            Integrity.columns,
            "not measured: the tones of the parts of an element do not tell joined elements from whole ones",
        )
        return Score({**missing.values, "detection_power": power}, missing.reasons)
    if judged.sum() < _LEAST_CELLS:
        return Score.missing(Integrity.columns, "undecided: too few whole tiles in place")
    broken = judged & (np.nan_to_num(evidence) > model.limit)
    share = float(broken.sum() / judged.sum())
    excess = max(share - model.chance, 0.0)
    values = {
        "score": float(np.clip(1 - excess / power, 0, 1)),
        "broken_share": share,
        "broken_tiles": float(np.rint(excess * judged.sum())),
        "detection_power": power,
    }
    pictures = {"broken": draw_broken(observation.output, followed, broken)}
    return Score(values, {}, pictures, {"limit": model.limit, "chance": model.chance, "cells": int(judged.sum())})


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
