"""Appearance: color, light, contrast and detail of the output, as a whole and at its worst place, and seams."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property, lru_cache
from typing import Any, ClassVar, NamedTuple

import numpy as np
from numpy.typing import NDArray

from nrbench.imaging.convert import Image
from nrbench.imaging.wrapped_edges import SHORTEST, measure_edges
from nrbench.lattice.geometry import Lattice
from nrbench.plugins.forms import Again, Column, Observation, Score, Shape, Value

from .judgment.color_classes import measure_new_colors
from .judgment.examination import examine
from .judgment.texture_reference import FIRST_DRAW, STRIPS, CannotTell, perceive_draws
from .perception import limits
from .perception.visible import (
    Lab,
    SeenSample,
    measure_detail,
    measure_levels,
    measure_looks,
    measure_plateaus,
)
from .registration.lattice_net import (
    LatticeNet,
    Mask,
    fold_cells,
    sample_planes,
    split_cells,
    sum_boxes,
)
from .registration.net_kernels import average_blocks
from .seam_detection.seam_lines import Line, draw_line, find_worst_lines

Looks = NDArray[np.float64]
"""``(n, 9)``: features of windows, see :func:`~.perception.visible.measure_looks`."""
_SIZES = {"local": 1, "local_wide": 2}
"""Sides of the windows, in cells."""
_OCTAVES = slice(5, 7)
"""The features that are levels of the octaves beyond the finest one, which a trace of blur takes away."""
_COLOR_PAIRS = np.triu_indices(3, 1)
_BORDER = 6
"""Width in px of the border where blurs differ from those inside."""
_FEWEST_CELLS = 8
"""Least number of cells of a sample whose strips show how its surface varies."""
_LEAST_WINDOWS = 6
_WITHOUT_LATTICE = 24.0
"""Side in px of the windows of a texture without a lattice."""
_PARTS = 4
"""Number of strips along each axis of a sample, that show how much its means vary; threads run along one axis."""

_BLOCK = 1 << 18
"""Number of points whose products are summed at once."""

_SEAM_DRAWS = 2
_LEAST_SEAM_SIDE = 16
_LEAST_TILE_SIDE = 4


class _Scale(NamedTuple):
    """What counts as one unit in a set of features.

    Parameters
    ----------
    floors
        Floor of each feature: what is not seen.
    gains
        Weight of a departure below the mean. A loss of fine grain counts less than a gain.
    """

    floors: NDArray[np.float64]
    gains: NDArray[np.float64]

    def invert(self, covariance: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return the inverse of a covariance with the floors added."""
        return np.asarray(np.linalg.inv(covariance + np.diag(self.floors**2)))

    def measure(self, departures: Looks, inverse: NDArray[np.float64], own: Looks | None = None) -> NDArray[np.float64]:
        """Return the distances of departures, ``(k,)``, from the nearest segment between 0 and a departure in ``own``.

        Without any in ``own``, ``(m, n)``, the distances are those from 0.
        """
        seen, ends = (np.where(d < 0, d * self.gains, d) for d in (departures, departures[:0] if own is None else own))
        squared, weighed = np.einsum("ki,ij,kj->k", seen, inverse, seen), seen @ inverse
        if len(ends):
            lengths = np.einsum("ki,ij,kj->k", ends, inverse, ends)
            along = weighed @ ends.T
            part = np.clip(along / np.maximum(lengths, 1e-12), 0, 1)
            squared = (squared[:, np.newaxis] - part * (2 * along - part * lengths)).min(1)
        return np.asarray(np.sqrt(np.maximum(squared, 0)))


def _looks_scale() -> _Scale:
    bands = [limits.GRAIN_FLOOR, limits.FINE_FLOOR, *[limits.BAND_FLOOR] * 2, *[limits.CHROMA_FLOOR] * 2]
    return _Scale(np.array([*[limits.COLOR_FLOOR] * 3, *bands]), np.array([1, 1, 1, *[limits.LOSS] * 3, 1, 1, 1]))


def _scales() -> dict[str, _Scale]:
    """Return the scale of each kind of features of a whole picture."""
    return {
        "whole": _looks_scale(),
        "detail": _Scale(np.array(([limits.TURN_FLOOR] * 2 + [limits.CLUSTER_FLOOR] * 2) * 2), np.ones(8)),
        "tones": _Scale(np.array([limits.SPREAD_FLOOR]), np.zeros(1)),
        "surface": _Scale(np.full(24, limits.SPREAD_FLOOR), np.ones(24)),
        "contrast": _Scale(np.full(12, limits.SPREAD_FLOOR), np.ones(12)),
    }


class _Kind(NamedTuple):
    """One kind of window: its scale, the inverse covariance of its departures, and the distance that is allowed."""

    scale: _Scale
    inverse: NDArray[np.float64]
    largest: float

    def compare(self, departures: Looks, own: Looks | None) -> float:
        """Return the largest distance of departures over the one that is allowed."""
        return float(self.scale.measure(departures, self.inverse, own).max(initial=0.0)) / self.largest


@dataclass(frozen=True, eq=False)
class _Maps:
    """The local features of one picture: looks, detail, levels of oriented detail, and plateaus."""

    lab: Lab

    @cached_property
    def looks(self) -> NDArray[np.float32]:
        return measure_looks(self.lab)

    @cached_property
    def detail(self) -> NDArray[np.float32]:
        return measure_detail(self.lab)

    @cached_property
    def levels(self) -> NDArray[np.float32]:
        return measure_levels(self.lab)

    @cached_property
    def plateaus(self) -> NDArray[np.float32]:
        return measure_plateaus(self.lab)

    def measure_parts(self, net: LatticeNet, rows: int = 1, columns: int = 1) -> dict[str, Looks]:
        """Return the features of ``rows`` x ``columns`` parts of the picture, of each kind in :func:`_scales`."""
        return {"whole": _cut_means(self.looks, rows, columns), **self.measure_kinds(net, rows, columns)}

    def measure_kinds(self, net: LatticeNet, rows: int, columns: int, kept: bool = True) -> dict[str, Looks]:
        """Return the same but for the looks of the whole; the local features are ``kept`` for other parts."""
        thin, samples = replace(net), net.samples // 2
        vars(thin)["samples"] = samples
        border = min(_BORDER, min(net.shape) // 8)
        inside = np.concatenate([part.contains(part.points, border) for part in thin.parts()])
        strips = thin.cut_strips(1, rows), thin.cut_strips(0, columns)
        known = [inside & row & column for row in strips[0] for column in strips[1]]
        planes = thin.sample(self.detail, inside, 0.5)
        found = {"detail": np.array([_mean_of_places(planes, part, samples) for part in known])}
        if not kept:
            vars(self).pop("detail")
        planes = np.empty((*inside.shape, 15), np.float32)
        thin.sample(self.levels, inside, 0.5, planes[..., :12])
        if not kept:
            vars(self).pop("levels")
        thin.sample(self.lab[..., :3], inside, 1.0, planes[..., 12:])
        spreads = [_measure_spread(planes.copy() if kept else planes, part, samples) for part in known]
        found["surface"], found["contrast"] = (np.array(each) for each in zip(*spreads, strict=True))
        return found | {"tones": np.log(_cut_means(self.plateaus, rows, columns) + limits.PLATEAUS) / 2}


def _measure_light(lab: Lab, net: LatticeNet) -> Looks:
    """Return by how much L* is lighter than its mean cell in 3 x 3 parts of a picture, ``(9, 1)``.

    Each place of the cell is weighed by the inverse of its variance: joints and gaps, which have no tints, show the
    light best.
    """
    plane, known = net.sample(lab[..., :1], net.inside), net.inside[..., np.newaxis]
    rest = np.where(known, plane - net.tile(fold_cells(plane, net.inside, net.samples)), 0)
    weight = known / net.tile(fold_cells(rest**2, net.inside, net.samples) + np.float32(limits.JND**2))
    strips, (rest, weight) = (net.cut_strips(1, 3), net.cut_strips(0, 3)), ((rest * weight)[..., 0], weight[..., 0])
    parts = (row & column for row in strips[0] for column in strips[1])
    return np.array([[rest[part].sum() / max(weight[part].sum(), 1e-9)] for part in parts])


def _mean_of_places(planes: NDArray[np.float32], known: Mask, samples: NDArray[np.intp]) -> NDArray[np.float64]:
    """Return the mean of planes over all places of the cell, each of which counts alike wherever a picture is cut."""
    shown = split_cells(known, samples).any((0, 1))
    return np.asarray(fold_cells(planes, known, samples)[shown].sum(0, dtype=np.float64) / max(shown.sum(), 1))


def _measure_spread(planes: NDArray[np.float32], known: Mask, samples: NDArray[np.intp]) -> tuple[Looks, Looks]:
    """Return how levels and colors vary, between the places of the cell and from cell to cell.

    The covariance of planes with themselves one cell away, over four lags of the lattice, is that of the mean cell; the
    rest of their covariance is that from cell to cell. Neighbors alone are compared, so bends, drifts and slips of the
    lattice hardly matter.

    Parameters
    ----------
    planes
        Twelve levels, L*, a* and b* in the order of a net; they are changed.
    known, samples
        Known points, and samples of a cell.

    Returns
    -------
    surface
        (24,): logarithm of the standard deviation of each level over the mean cell, and from cell to cell.
    contrast
        (12,): the same of L*, a* and b*, and their three correlations.
    """
    means, share = average_blocks(planes, np.ascontiguousarray(known), *known.shape)
    planes -= (means[0, 0] / max(share[0, 0], 1e-9)).astype(np.float32)
    planes[~known] = 0

    def correlate(n1: int, n2: int) -> tuple[NDArray[np.float64], int]:
        height, width = known.shape
        one = np.s_[n1:, max(n2, 0) : width + min(n2, 0)]
        other = np.s_[: height - n1, max(-n2, 0) : width - max(n2, 0)]
        rows, (a, b) = max(_BLOCK // width, 1), (planes[one], planes[other])
        blocks = [np.s_[k : k + rows] for k in range(0, max(len(a), 1), rows)]
        products = np.sum([(a[k].reshape(-1, 15).T @ b[k].reshape(-1, 15)).astype(np.float64) for k in blocks], 0)
        return (products + products.T) / 2, int((known[one] & known[other]).sum())

    n1, n2 = (int(n) for n in samples)
    products, counts = zip(*(correlate(*lag) for lag in ((n1, 0), (0, n2), (n1, n2), (n1, -n2))), strict=True)
    between = sum(products) / max(sum(counts), 1)
    total, count = correlate(0, 0)
    surface, contrast = [], []
    for covariance in (between, total / max(count, 1) - between):
        variance = np.maximum(covariance.diagonal(), 0)
        surface.append(np.log(variance[:-3] + limits.LEVEL_OFFSET**2) / 2)
        seen = variance[-3:] + limits.JND**2
        correlation = covariance[-3:, -3:] / np.sqrt(np.outer(seen, seen))
        contrast += [np.log(seen) / 2, np.clip(correlation[*_COLOR_PAIRS], -1, 1)]
    return np.concatenate(surface), np.concatenate(contrast)


@dataclass(frozen=True, eq=False)
class LooksModel:
    r"""How windows of a texture look.

    The distance of features f from the mean is the root of (f - mean)' (C + F)^{-1} (f - mean), with the covariance C
    of the references and the squared floors F of what is not seen. Windows of one and two cells hold each place of the
    cell equally often, wherever they lie, so they differ only as the texture varies. Quarters of the picture show
    uneven light. The whole, its detail, its surface and its contrast are compared with parts as large as the sample.

    A method knows one sample, which may be untypical. Where fresh draws are the references, distances are therefore
    those from the segment between the mean and the sample, and those of a window from the nearest of the segments
    between the mean and the windows of the sample. Quarters are compared with the mean alone.

    Parameters
    ----------
    means
        The mean features of windows and whole (9,), of detail (8,), surface (24,), contrast (12,) and tones (1,).
    kinds
        The windows of each size, quarters, light, whole, detail, surface, contrast and tones.
    least, most_lacked
        (2,): least levels of the octaves of any window of one cell, and how far a window may lie below them, 20 ln.
    net
        The cell of the windows.
    """

    means: Mapping[str, Looks]
    kinds: Mapping[str, _Kind]
    least: Looks
    most_lacked: float
    net: LatticeNet

    def depart(self, lab: Lab) -> dict[str, Looks]:
        """Return how far the features of a picture lie from their means, of each kind."""
        maps = _Maps(lab)
        net = self.net.over((lab.shape[0], lab.shape[1]))
        halves = [
            part.half_cells(sample_planes(maps.looks, part.points, part.inside), part.inside) for part in net.parts()
        ]
        means, share = (np.concatenate(each) for each in zip(*halves, strict=True))
        found = {name: _window_means(means, share, size) - self.means["whole"] for name, size in _SIZES.items()}
        quarters, whole = _cut_means(maps.looks, 2, 2), _cut_means(maps.looks, 1, 1)
        vars(maps).pop("looks")  # large
        wholes = {"whole": whole, **maps.measure_kinds(net, 1, 1, kept=False)}
        found |= {"quarters": quarters - whole, "light": _measure_light(lab, net)}
        return found | {name: whole - self.means[name] for name, whole in wholes.items()}

    def measure(self, lab: Lab, own: Mapping[str, Looks]) -> dict[str, float]:
        """Return the largest distance of an output, over that which is allowed, of each kind; and what it lacks.

        Parameters
        ----------
        lab
            What is seen of the output.
        own
            How the sample departs from the mean, as :meth:`depart` finds it; empty if the sample is the reference.
        """
        found = self.depart(lab)
        ratios = {
            name: kind.compare(found[name], None if name in ("quarters", "light") else own.get(name))
            for name, kind in self.kinds.items()
        }
        return ratios | {"lack": _lack(found["local"] + self.means["whole"], self.least) / self.most_lacked}


def _lack(windows: Looks, least: Looks) -> float:
    """Return how far the worst window lies below the least levels of octaves, 20 ln."""
    return float((least - windows[:, _OCTAVES]).max(initial=0.0))


def _window_means(means: NDArray[np.float64], share: NDArray[np.float64], size: int) -> Looks:
    """Return the mean features of windows of ``size`` x ``size`` cells at every half cell, from those of half cells."""
    if min(share.shape) < 2 * size:
        return np.zeros((0, means.shape[-1]))
    total, weight = sum_boxes(means, 2 * size), sum_boxes(share, 2 * size)
    whole = weight > limits.WHOLE_WINDOW * (2 * size) ** 2
    return np.asarray(total[whole] / weight[whole][:, np.newaxis])


def _cut_means(planes: NDArray[Any], rows: int, columns: int) -> Looks:
    """Return the means of ``rows`` x ``columns`` parts of planes."""
    cut = [part for strip in np.array_split(planes, rows, 0) for part in np.array_split(strip, columns, 1)]
    return np.array([part.mean(0, dtype=np.float64).mean(0) for part in cut])


def _learn_looks(maps: Sequence[_Maps], net: LatticeNet, sample_shape: Shape, from_sample: bool) -> LooksModel:
    """Learn how a texture looks from the features of fresh draws, or of its sample alone."""
    planes = [sample_planes(each.looks, net.points, net.inside) for each in maps]
    windows = {name: _group_windows(planes, net, size, from_sample) for name, size in _SIZES.items()}
    every = [each.measure_parts(net) for each in maps]
    means = {name: np.mean([whole[name][0] for whole in every], 0) for name in every[0]}
    if from_sample:
        margin, unseen = limits.OF_SAMPLE_LOOKS, limits.UNSEEN_TONES
        wholes = _wholes_of_sample(maps[0], net)
    else:
        margin, unseen = limits.OF_LOOKS, 1.0
        side = min(max(round(a / b), 1) for a, b in zip(net.shape, sample_shape, strict=True))
        wholes = _wholes_of_draws(maps, net, means, side)
    kinds = _learn_windows(windows, means["whole"], margin, unseen) | wholes
    least, lacked = _learn_lack(windows["local"])
    if from_sample:
        least = np.minimum(least, _find_quietest(planes[0], net))
    return LooksModel(means, kinds, least, margin * max(limits.LACK, lacked), net)


def _learn_windows(
    windows: Mapping[str, list[list[Looks]]], mean: Looks, margin: float, unseen: float
) -> dict[str, _Kind]:
    """Return the kinds of windows of each size of which the references show enough; the wider of their sets counts."""
    kinds: dict[str, _Kind] = {}
    for name, sets in windows.items():
        if any(sum(map(len, groups)) < _LEAST_WINDOWS or len(groups) < 2 for groups in sets):
            break
        departures = [[group - mean for group in groups] for groups in sets]
        found = [_learn_kind(_looks_scale(), groups, limits.LEAST_LOCAL, margin, unseen) for groups in departures]
        kinds[name] = max(found, key=lambda kind: kind.largest)
    return kinds


def _learn_lack(sets: list[list[Looks]]) -> tuple[Looks, float]:
    """Return the least levels of octaves of windows, and how far those of one group lie below those of the others."""
    least, lacked = [], [0.0]
    for groups in (groups for groups in sets if len(groups) > 1):
        for k, group in enumerate(groups):
            least.append(np.concatenate([*groups[:k], *groups[k + 1 :]])[:, _OCTAVES].min(0))
            lacked.append(_lack(group, least[-1]))
    return np.min(least, 0) if least else np.full(2, -np.inf), max(lacked)


def _find_quietest(plane: NDArray[np.float32], net: LatticeNet) -> Looks:
    """Return the levels of octaves of a cell whose places are each as quiet as the quietest one of a sample.

    Prints have inks, so that some windows have equal elements, without the edges that others have. A sample shows few
    of them, but at each place of the cell some neighbors that are equal.
    """
    cells, known = split_cells(plane[..., _OCTAVES], net.samples), split_cells(net.inside, net.samples)
    return np.asarray(np.where(known[..., np.newaxis], cells, np.inf).min((0, 1)).mean((0, 1)))


def _wholes_of_draws(maps: Sequence[_Maps], net: LatticeNet, means: Mapping[str, Looks], side: int) -> dict[str, _Kind]:
    """Return the kinds of quarters and wholes: each draw against the others, cut into ``side`` x ``side``."""
    quarters = [_cut_means(each.looks, 2, 2) - _cut_means(each.looks, 1, 1) for each in maps]
    light = [_measure_light(each.lab, net) for each in maps]
    step = _Scale(np.array([limits.JND / 2]), np.ones(1))
    kinds = {
        "quarters": _learn_kind(_looks_scale(), quarters, limits.LEAST_WHOLE, limits.OF_MEANS),
        "light": _learn_kind(step, light, limits.LEAST_WHOLE, limits.OF_MEANS),
    }
    cut = {count: [each.measure_parts(net, count, count) for each in maps] for count in {side, max(side, 2)}}
    for name, scale in _scales().items():
        spread = name in ("surface", "contrast", "tones")
        groups = [part[name] - means[name] for part in cut[max(side, 2) if spread else side]]
        kinds[name] = _learn_kind(scale, groups, limits.LEAST_WHOLE, 1.0 if spread else limits.OF_LOOKS)
    return kinds


def _wholes_of_sample(maps: _Maps, net: LatticeNet) -> dict[str, _Kind]:
    """Return the kinds of quarters and wholes, as far as the strips of a sample show how its means vary."""
    strips = [maps.measure_parts(net, *cut) for cut in ((_PARTS, 1), (1, _PARTS))]
    kinds, looks = {}, _looks_scale()
    few = net.inside.sum() < _FEWEST_CELLS * net.samples.prod()
    for name, scale in _scales().items():
        if name == "contrast" or (few and name == "surface"):
            continue
        spread = np.atleast_2d(sum(np.cov(cut[name].T) / _PARTS for cut in strips))
        least = {
            "whole": limits.LEAST_OF_SAMPLE * limits.OF_MEANS,
            "detail": limits.LEAST_WHOLE * limits.OF_LOOKS,
            "tones": limits.LEAST_WHOLE * limits.OF_SAMPLE_LOOKS,
            "surface": limits.LEAST_WHOLE * limits.OF_SAMPLE_LOOKS * math.sqrt(3),
        }[name]
        kinds[name] = _Kind(scale, scale.invert(limits.UNEVEN_WHOLE * spread), least)
        if name == "whole":
            uneven = looks.invert(limits.UNEVEN_QUARTERS * spread)
    usual = float(looks.measure(_cut_means(maps.looks, 2, 2) - _cut_means(maps.looks, 1, 1), uneven).max())
    return kinds | {"quarters": _Kind(looks, uneven, limits.OF_MEANS * max(usual, limits.LEAST_OF_SAMPLE))}


def _learn_kind(scale: _Scale, groups: Sequence[Looks], least: float, margin: float, unseen: float = 1.0) -> _Kind:
    """Return the covariance of departures, and the largest distance of a group by that of all others.

    The standard deviation of colors is multiplied by ``unseen``: a sample shows few of the tones of a texture.
    """
    widths = np.where(np.arange(len(scale.floors)) < 3, unseen, 1.0)
    wider, far = np.outer(widths, widths), [least]
    for k, group in enumerate(groups):
        rest = np.concatenate([*groups[:k], *groups[k + 1 :]])
        far.append(float(scale.measure(group, scale.invert(wider * (rest.T @ rest) / len(rest))).max()))
    everything = np.concatenate(groups)
    return _Kind(scale, scale.invert(wider * (everything.T @ everything) / len(everything)), margin * max(far))


def _group_windows(
    planes: Sequence[NDArray[np.float32]], net: LatticeNet, size: int, from_sample: bool
) -> list[list[Looks]]:
    """Return sets of groups of windows: those of each draw, or those of four strips of the sample along each axis.

    Threads run through all strips along them. Strips along both axes hold each thread out once.
    """
    if not from_sample:
        return [[_window_means(*net.half_cells(plane, net.inside), size) for plane in planes]]
    found = []
    for axis in (0, 1):
        strips = [net.inside & strip for strip in net.cut_strips(axis, STRIPS)]
        groups = [_window_means(*net.half_cells(planes[0], strip), size) for strip in strips]
        found.append([group for group in groups if len(group)])
    return found


@lru_cache(maxsize=4)
def _looks_of_draws(again: Again, lattice: Lattice | None, shape: Shape, sample_shape: Shape) -> LooksModel:
    return _learn_looks(_measure_draws(again, shape), _make_net(lattice, shape), sample_shape, False)


@lru_cache(maxsize=2)
def _measure_draws(again: Again, shape: Shape) -> list[_Maps]:
    """Return the features of fresh draws; replicates of a texture, whose lattices differ by origin, share them."""
    return [_Maps(lab) for lab in perceive_draws(again, shape)[1]]


@lru_cache(maxsize=2)
def _looks_of_sample(sample: SeenSample, lattice: Lattice | None) -> LooksModel:
    net = replace(_make_net(lattice, sample.shape), known=sample.known)
    return _learn_looks([_Maps(sample.lab)], net, sample.shape, True)


@lru_cache(maxsize=2)
def _depart_sample(model: LooksModel, sample: SeenSample) -> Mapping[str, Looks]:
    """Return how the sample departs from the mean of fresh draws."""
    return model.depart(sample.lab)


def _make_net(lattice: Lattice | None, shape: Shape) -> LatticeNet:
    vectors = np.eye(2) * _WITHOUT_LATTICE if lattice is None else lattice.matrix
    return LatticeNet(shape, vectors, np.zeros(2) if lattice is None else np.array(lattice.origin))


def _compare_looks(observation: Observation) -> dict[str, float]:
    """Return the largest distances of an output, over those that are allowed."""
    lab, lattice = examine(observation).lab, examine(observation).known_lattice.lattice
    sample, output = examine(observation).sample, observation.output
    if observation.again is None:
        return _looks_of_sample(sample, lattice).measure(lab, {})
    shape = (min(max(output.shape[0], 128), 384), min(max(output.shape[1], 128), 384))
    model = _looks_of_draws(observation.again, lattice, shape, sample.shape)
    return model.measure(lab, _depart_sample(model, sample))


def _column(meaning: str, unit: str = "", better: str = "lower") -> Column:
    return Column(meaning, unit, (0.0, math.inf), better)  # type: ignore[arg-type]


@dataclass(frozen=True)
class Appearance:
    """Whether the output looks like the texture: its color, light, contrast, grain and sharpness.

    Nine features of what an eye sees (:func:`~nrbench.metrics.perception.visible.measure_looks`) are averaged over
    windows of one and of two cells, over quarters of the picture and over the whole; eight features of its detail
    (:func:`~nrbench.metrics.perception.visible.measure_detail`) over the whole, where each place of the cell counts
    alike. ``surface`` and ``contrast`` compare how the levels of oriented detail, and L*, a* and b*, vary over the cell
    and from cell to cell; ``light`` the light of 3 x 3 parts, and ``tones`` the share of plateaus. The largest distance
    of each kind from the references (:class:`LooksModel`) is divided by the largest one that these show. ``lack`` is
    how far the levels of two octaves, in a window of one cell, lie below the least ones of all windows of the
    references, over what is allowed: it sees a hole where the distances are wide. Where the colors of the elements come
    in classes, ``colors`` is the share of elements whose color belongs to none, over what chance explains
    (:mod:`~nrbench.metrics.judgment.color_classes`). A ratio up to 1 has the score 1, a ratio of 1.5 has 0, and the
    worst ratio counts. Fresh draws are the references; for a photograph they are four strips of the sample, each
    compared with the others, which do not show ``contrast`` and ``light``.

    Seams are searched on every straight line of at least half the image's side, in every direction, because the places
    where a method has cut are unknown. A tile that claims to be seamless when it is repeated is also measured across
    its border (:mod:`~nrbench.imaging.wrapped_edges`): ``extras["tile"]``, or the output itself if
    ``extras["tileable"]`` is not zero.
    """

    version: ClassVar[str] = "8"
    uses: ClassVar[tuple[str, ...]] = ("dominance",)
    columns: ClassVar[Mapping[str, Column]] = {
        "score": Column(
            "Color, light and detail kept, as a whole and at the worst place: 1 as a fresh draw.", better="higher"
        ),
        "local": _column("Distance of the window of one cell that looks strangest, over that of the references."),
        "local_wide": _column("The same for windows of two cells."),
        "quarters": _column("The same for quarters of the picture: uneven light."),
        "whole": _column("The same for the whole picture."),
        "detail": _column(
            "The same for the detail of the whole picture: streaks, relief, speckles, holes in the grain."
        ),
        "surface": _column(
            "The same for its surface: how the amplitude of detail varies over the cell and from cell to cell."
        ),
        "contrast": _column(
            "The same for the contrasts of L*, a* and b* and their correlations, over the cell and from cell to cell."
        ),
        "light": _column(
            "The same for the light in 3 x 3 parts, as the places show it that vary least from cell to cell."
        ),
        "tones": _column("The same for the share of neighboring pixels that are alike: plateaus of few tones."),
        "lack": _column("What the window with the least detail lacks, over what windows of the references lack."),
        "colors": _column("Share of elements whose color belongs to no class of the references, over what is allowed."),
        "seam": _column(
            "Visibility (size, and contrast to its parallels) of the worst line over that of fresh draws' worst line."
        ),
        "seam_step": _column("Step of brightness across the line with the most visible step.", "values"),
        "tileable": _column(
            "Largest departure of the wrapped edges from lines inside, over what these allow; up to 1 it repeats."
        ),
        "tile_bytes": _column("Bytes of the tile over those of the sample."),
    }

    def score(self, observation: Observation) -> Score:
        """Return the scores, and the picture ``seam`` that shows the most visible line."""
        return observation.shared(_score)


def _score(observation: Observation) -> Score:
    values: dict[str, Value] = dict.fromkeys(Appearance.columns)
    reasons: dict[str, str] = {}
    try:
        ratios, colors = _compare_looks(observation), _find_new_colors(observation)
        if colors and observation.again is None:  # a sample shows few of the ways in which inks meet
            ratios = {name: ratio / (1 if name == "lack" else limits.UNSEEN_TONES) for name, ratio in ratios.items()}
        ratios |= {name: ratio for name, ratio in colors.items() if ratio is not None}
        values |= ratios | {"score": float(np.clip(1 - limits.LOOKS_SLOPE * (max(ratios.values()) - 1), 0, 1))}
        few = "undecided: the references show too few windows of this size"
        reasons |= {name: few for name in (*_SIZES, "surface") if values[name] is None}
        single = "undecided: a sample alone does not show how much its contrast and light vary"
        reasons |= {name: single for name in ("contrast", "light") if values[name] is None}
        if values["colors"] is None:
            lost = "undecided: half of the reference itself is out of place by chance"
            reasons["colors"] = lost if colors else "not applicable: the colors of the elements form no classes"
    except CannotTell as reason:
        looks = [name for name in Appearance.columns if not name.startswith(("seam", "tile"))]
        reasons |= dict.fromkeys(looks, str(reason))
    values["seam"], values["seam_step"], line = _seam(observation)
    if line is None:
        small = f"undecided: the images are smaller than {_LEAST_SEAM_SIDE} px, too small to compare lines"
        reasons |= dict.fromkeys(("seam", "seam_step"), small)
    tile = _claimed_tile(observation.output, observation.extras)
    if isinstance(tile, str):
        reasons |= dict.fromkeys(("tileable", "tile_bytes"), tile)
    else:
        values["tile_bytes"] = tile.size / observation.sample.size
        edges = measure_edges(tile, examine(observation).known_lattice.lattice)
        values["tileable"] = max((edge.ratio for edge in edges if edge.ratios), default=None)
        if values["tileable"] is None:
            reasons["tileable"] = f"undecided: the sides of the tile are shorter than {SHORTEST} px"
    pictures = {} if line is None else {"seam": draw_line(observation.output, line)}
    records = {"reference": "sample" if observation.again is None else "fresh draws"}
    return Score(values, reasons, pictures, records)


def _find_new_colors(observation: Observation) -> dict[str, float | None]:
    """Return the share of elements with a color of no class, over that which is allowed, where there are classes.

    Where half of the reference is out of place by chance, colors would be read at wrong phases: the share is None.
    """
    examination = examine(observation)
    try:
        plane = examination.traced.coarse
        ratio = measure_new_colors(examination.reference, plane)
    except CannotTell:
        return {}
    if ratio is None:
        return {}
    return {"colors": None if limits.SLOPE * examination.reference.most_misplaced >= 1 else ratio}


# Seams, and the border of a tile that claims to be seamless.


def _seam(observation: Observation) -> tuple[float | None, float | None, Line | None]:
    """Return the visibility of the worst line over that of the references' worst, the largest step, and the line."""
    output, sample = observation.output, observation.sample
    if min(*output.shape[:2], *sample.shape[:2]) < _LEAST_SEAM_SIDE:
        return None, None, None
    lattice = _repeated_lattice(observation)
    own = find_worst_lines(output, lattice)
    if observation.again is None:
        others = [find_worst_lines(sample, lattice)]
    else:
        others = _lines_of_draws(observation.again, lattice, (output.shape[0], output.shape[1]))
    usual = [max(float(np.mean([_visibility(lines)[kind] for lines in others])), 1e-6) for kind in (0, 1)]
    ratios = [own_level / level for own_level, level in zip(_visibility(own), usual, strict=True)]
    kind = int(np.argmax(ratios))
    return ratios[kind], own[0].size, own[kind]


@lru_cache(maxsize=2)
def _lines_of_draws(again: Again, lattice: Lattice | None, shape: Shape) -> list[tuple[Line, Line]]:
    draws = [again(shape, FIRST_DRAW + k) for k in range(_SEAM_DRAWS)]
    return [find_worst_lines(draw.image, lattice) for draw in draws if draw is not None]


def _repeated_lattice(observation: Observation) -> Lattice | None:
    """Return the true lattice if sample and output hold two cells along each side; in less everything is regular."""
    lattice = observation.truth.lattice if observation.truth else None
    if lattice is None:
        return None
    room = np.minimum(observation.sample.shape[1::-1], observation.output.shape[1::-1])
    box = np.sqrt((lattice.canonical().matrix ** 2).sum(0))
    return lattice if (2 * box <= room).all() else None


def _visibility(lines: tuple[Line, Line]) -> tuple[float, float]:
    """Return the visibility of the worst lines by step and by gradient.

    This is the geometric mean of a line's size (step, or root of the excess of squared gradient) and of its strength.
    Strength alone saturates, since a strong line shows in its neighbors too. Size alone would count what a blur leaves
    along every row of tiles.
    """
    step, edge = lines
    return math.sqrt(step.strength * step.size), math.sqrt(edge.strength * math.sqrt(edge.size))


def _claimed_tile(output: Image, extras: Mapping[str, NDArray[Any]]) -> Image | str:
    """Return the tile that claims to be seamless when it is repeated, or the reason why there is none.

    Parameters
    ----------
    output
        The output.
    extras
        ``tile``: such a tile, ``(H, W)`` or ``(H, W, C)`` in [0, 1]; or ``tileable``: not zero if the output is one.
    """
    if "tile" in extras:
        tile = np.asarray(extras["tile"], np.float32)
        tile = tile[..., np.newaxis] if tile.ndim == 2 else tile
        if tile.ndim != 3 or min(tile.shape[:2]) < _LEAST_TILE_SIDE or tile.shape[2] not in (1, 3):
            return f"not applicable: extras['tile'] of shape {tile.shape} is no image of at least 4 px a side"
        return tile
    if "tileable" in extras and np.asarray(extras["tileable"]).any():
        return output
    return "not applicable: no tile in the extras, and the output does not claim to be tileable"
