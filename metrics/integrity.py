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
from .judgment.texture_reference import STRIPS, CannotTell, TextureReference
from .judgment.tile_population import gather_tiles
from .perception import limits
from .perception.visible import tint_places
from .registration.coarse_plane import CoarsePlane, shift_plane
from .registration.followed import FollowedPicture
from .registration.lattice_net import LatticeNet, Mask, Values, fold_cells, split_cells

Lag = tuple[int, int]
_COLOR = np.array((0.7, 0.1, 0.8), np.float32)
_DIRECTIONS = 8
_DISTANCES = (0.25, 0.5)
"""Distances in s of two places of one element."""
_SHUFFLES = 4
"""Number of pictures of shuffled cells that are made of the references."""
_REACHES = (1, 3)
"""Sides, in places, of the neighborhoods over which evidence is averaged, of which the better one is used."""
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

    averaged over neighboring places, because a joint is a line, and grain is not. The evidence of a cell is the largest
    one in it. Pairs that never go together (W = V) give no evidence.

    Parameters
    ----------
    pairs
        The models of all lags.
    reach
        Side, in places, of the neighborhoods over which evidence is averaged.
    limit
        Evidence above which a cell counts as broken.
    power
        Share of cells above the limit where the cells of the references are shuffled.
    least
        That share where the cells are cut at the place that shows it least.
    chance
        Largest share of cells above the limit that chance explains in whole elements.
    """

    pairs: Sequence[PairModel]
    reach: int = 1
    limit: float = 0.0
    power: float = 0.0
    least: float = 0.0
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
            if self.reach > 1:
                sums = ndimage.uniform_filter(np.where(both, evidence, 0), self.reach, mode="constant")
                share = ndimage.uniform_filter(both.astype(np.float32), self.reach, mode="constant")
                both &= share > 0.5
                evidence = sums / np.maximum(share, 0.5)
            largest = np.where(both, np.maximum(largest, evidence), largest)
        places = (limits.PLACES, limits.PLACES)
        seen = split_cells(np.isfinite(largest), places).mean((2, 3))
        return np.where(seen > _LEAST_SHARE, split_cells(largest, places).max((2, 3)), np.nan)


def _square_form(difference: Values, matrices: NDArray[np.float32], shape: tuple[int, int]) -> NDArray[np.float32]:
    """Return d' M d at each place, with one matrix for each place of the cell."""
    places = (shape[0], limits.PLACES, shape[1], limits.PLACES)
    planes = [np.ascontiguousarray(difference[..., i]).reshape(places) for i in range(3)]
    total = np.zeros(places, np.float32)
    for i, j in ((0, 0), (1, 1), (2, 2), (0, 1), (0, 2), (1, 2)):
        total += planes[i] * planes[j] * (matrices[:, np.newaxis, :, i, j] * (1 + (i != j)))
    return total.reshape(difference.shape[:2])


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
    strips along them. The test is the one by which the smallest share of joined elements shows: limit and
    reach with the least ratio of chance to power, among those with enough power.
    """
    net, lags, rng = reference.net, list_lags(reference.net), np.random.default_rng(0)
    pictures = reference.departures if reference.from_sample else reference.residuals
    planes = [CoarsePlane(fine, known, net.samples) for fine, known in pictures]
    pairs = learn_pairs(planes, lags)
    if reference.from_sample:
        weighed = _weigh_strips(planes[0], net, lags)
    else:
        seen = [
            (plane.values + rng.normal(0, limits.UNSEEN_NOISE, plane.values.shape).astype(np.float32), plane.complete)
            for plane in planes
        ]
        weighed = [[ElementModel(pairs, reach).weigh(*plane) for plane in seen] for reach in _REACHES]
    shuffled = [shuffle_cells(plane, net, rng) for plane in (planes * _SHUFFLES)[: max(_SHUFFLES, len(planes))]]
    tried = [ElementModel(pairs)]
    for reach, cells in zip(_REACHES, weighed, strict=True):
        known = [evidence[np.isfinite(evidence)] for evidence in cells]
        whole = [evidence for evidence in known if evidence.size]
        model = ElementModel(pairs, reach)
        broken = [model.weigh(*picture) for picture in shuffled]
        joined = [evidence[np.isfinite(evidence)] for evidence in broken if np.isfinite(evidence).any()]
        if len(whole) > 1 and joined:
            shares = limits.WHOLE_SHARES
            tried += [_set_limit(model, whole, joined, share, reference.from_sample) for share in shares]
    able = [model for model in tried if model.power - model.chance >= limits.LEAST_POWER]
    if able:
        return min(able, key=lambda model: model.chance / model.power)
    return max(tried, key=lambda model: model.power - model.chance)


def _weigh_strips(plane: CoarsePlane, net: LatticeNet, lags: Sequence[Lag]) -> list[list[NDArray[np.float64]]]:
    """Return the evidence of the cells of each strip, by a mean cell and a model of the other strips, by reach."""
    found: list[list[NDArray[np.float64]]] = [[] for _ in _REACHES]
    for strip in (strip for axis in (0, 1) for strip in net.cut_strips(axis, STRIPS)):
        rest = plane.known & ~strip
        own = CoarsePlane(
            plane.fine - net.tile(fold_cells(plane.fine, rest, plane.samples)), plane.known, plane.samples
        )
        pairs = learn_pairs([own.restrict(rest)], lags)
        inside = split_cells(strip, plane.samples).mean((2, 3)) > 0.5
        for cells, reach in zip(found, _REACHES, strict=True):
            cells.append(ElementModel(pairs, reach).weigh(own.values, own.complete)[inside])
    return found


def _set_limit(
    model: ElementModel,
    whole: list[NDArray[np.float64]],
    joined: list[NDArray[np.float64]],
    share: float,
    pooled: bool,
) -> ElementModel:
    """Return the model with the limit that a share of the whole elements exceeds.

    An output is as large as a draw, but as all strips of a sample together (``pooled``).
    """
    limit = float(np.quantile(np.concatenate(whole), 1 - share))
    shares = np.array([(evidence > limit).mean() for evidence in whole])
    spread = limits.DEVIATIONS * float(shares.std(ddof=1)) / (math.sqrt(len(shares)) if pooled else 1)
    chance = float(shares.mean()) + spread + limits.OVERLOOKED
    power = float((np.concatenate(joined) > limit).mean())
    least = min(float((evidence > limit).mean()) for evidence in joined)
    return replace(model, limit=limit, power=power, least=least, chance=chance)


def shuffle_cells(plane: CoarsePlane, net: LatticeNet, rng: np.random.Generator) -> tuple[Values, Mask]:
    """Return the values and the known places of a picture whose cells, cut at a random place, change places.

    The joints are seen through the blur of the eye, as those of an output are.
    """
    size = (limits.PLACES, limits.PLACES)
    cut = rng.integers(0, limits.PLACES, 2)
    values, known = (split_cells(np.roll(a, -cut, (0, 1)), size) for a in (plane.values, plane.complete))
    from_cells = np.argwhere(known[:-1, :-1].mean((2, 3)) > _LEAST_SHARE)
    to_cells = rng.permutation(from_cells)
    shuffled: list[NDArray[Any]] = []
    for cells in (values, known):
        moved = np.zeros_like(cells)
        moved[tuple(to_cells.T)] = cells[tuple(from_cells.T)]
        shuffled.append(np.roll(moved.swapaxes(1, 2).reshape(*plane.complete.shape, *cells.shape[4:]), cut, (0, 1)))
    places = limits.PLACES / np.linalg.norm(net.vectors, axis=1)
    for k, blur in enumerate((limits.BLUR, limits.CHROMA_BLUR, limits.CHROMA_BLUR)):
        sums, share = (
            ndimage.gaussian_filter(a.astype(np.float32), blur * places) for a in (shuffled[0][..., k], shuffled[1])
        )
        shuffled[0][..., k] = sums / np.maximum(share, 1e-3)
    return shuffled[0], shuffled[1]


@dataclass(frozen=True)
class Integrity:
    """The share of the output's elements that are whole.

    A method that copies patches may join the left half of one brick to the right half of another, or change the color
    of a thread. The mean cell cannot show this, because both parts lie in their places. Their tones do: in a whole
    element the tones of its parts go together (:class:`ElementModel`).

    Let p be the share of the shuffled cells of the references above the limit of the evidence, r that share where the
    cells are cut at the place that shows it least, q the largest share of whole ones that chance explains, and c the
    share of the output's cells. The score is 1 - (c - q) / (r - q), in [0, 1]: the share of whole elements, corrected
    for those that the test misses and for those that it counts wrongly. The limit is the one with the smallest q / p;
    p - q is ``detection_power``. Where it cannot be 0.3, the elements of the texture do not have tones that tell joined
    ones from whole ones, and the score is None. It is None beside a sample of fewer than twelve cells, too, because
    other elements may have tones that it does not show.

    The references are fresh draws of the model, or strips of the sample, each weighed by a model of the others.
    Elements out of place are left out; they count for regularity.
    """

    version: ClassVar[str] = "12"
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
    shown = sum(known.sum() for _, known in reference.departures) / reference.net.samples.prod()
    if judged.sum() < _LEAST_CELLS or shown < limits.FEWEST_SHOWN:
        return Score.missing(Integrity.columns, "undecided: too few whole tiles in place")
    broken = judged & (np.nan_to_num(evidence) > model.limit)
    share = float(broken.sum() / judged.sum())
    excess = max(share - model.chance, 0.0)
    values = {
        "score": float(np.clip(1 - excess / max(model.least - model.chance, limits.LEAST_POWER), 0, 1)),
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
