"""Three tests for joined elements: unlike tones, parts that no element has, and steps across lines."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Protocol

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view
from numpy.typing import NDArray
from scipy import ndimage

from ..perception import limits
from ..registration.coarse_plane import CoarsePlane, shift_plane
from ..registration.lattice_net import LatticeNet, Mask, Values, split_cells
from .element_kernels import average_known, compare_tones, sum_products

Lag = tuple[int, int]
Evidence = NDArray[np.float64]
"""``(N1, N2)``: evidence that a cell is joined of parts; NaN where too few places are known."""
_DIRECTIONS = 8
_DISTANCES = (0.25, 0.5)
"""Distances in s of two places of one element."""
_LEAST_SHARE = 0.7
"""Share of the places of a cell that must be known."""
_WIDTH, _STEP = 4, 2
"""Side of the windows of half a cell that are compared with those of the references, and their distance, in places."""
_MOST_WINDOWS = 400
"""Largest number of windows at one place of the cell with which others are compared."""
_LEAST_WINDOWS = 3
_AT_ONCE = 64
"""Rows of windows that are cut at once; the root of the number of windows that are compared at once."""


class JointTest(Protocol):
    """What the references show of whole elements, by which joined ones are found."""

    def weigh(self, plane: CoarsePlane) -> Evidence:
        """Return the evidence of each cell."""


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
class UnlikeTones:
    r"""Evidence from the tones of the parts of an element, which go together in a whole one.

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
    """

    pairs: Sequence[PairModel]
    reach: int

    def weigh(self, plane: CoarsePlane) -> Evidence:
        """Return the evidence of each cell."""
        values, known = plane.values, plane.complete
        shape = (known.shape[0] // limits.PLACES, known.shape[1] // limits.PLACES)
        largest = np.full(known.shape, -np.inf, np.float32)
        for pair in self.pairs:
            ratio, both = compare_tones(values, known, *pair.lag, pair.whole, pair.unrelated, limits.FREEDOM)
            evidence = (limits.FREEDOM + 3) / 2 * np.log(ratio) - np.tile(pair.constant, shape) / 2
            if self.reach > 1:
                means, share = average_known(evidence, both, self.reach)
                both &= share > 0.5
                evidence = means / np.maximum(share, 0.5)
            largest = np.where(both, np.maximum(largest, evidence), largest)
        return _largest_in_cells(largest, (limits.PLACES, limits.PLACES))


def _largest_in_cells(field: NDArray[np.float32], places: NDArray[np.intp] | tuple[int, int]) -> Evidence:
    """Return the largest value of a field in each cell; NaN where too few places are finite."""
    cells = split_cells(field, places)
    return np.where(np.isfinite(cells).mean((2, 3)) > _LEAST_SHARE, cells.max((2, 3)), np.nan)


def list_lags(net: LatticeNet) -> list[Lag]:
    """Return the lags at which two places of one element are compared, in places."""
    angles = np.pi * np.arange(_DIRECTIONS) / _DIRECTIONS
    ends = np.concatenate([d * net.s * np.column_stack([np.cos(angles), np.sin(angles)]) for d in _DISTANCES])
    near = np.rint(limits.PLACES * ends @ np.linalg.inv(net.vectors)).astype(int)
    lags = {(int(i), int(j)) for i, j in near} - {(0, 0)}
    p = limits.PLACES
    return sorted(lags | {(p, 0), (0, p), (p, p), (p, -p)})


def learn_pair(planes: Sequence[CoarsePlane], lag: Lag) -> PairModel:
    """Estimate the covariances of all pairs of places. With few cells, 3 x 3 neighboring places are pooled."""
    size = limits.PLACES
    found = [sum_products(plane.values, plane.complete, *lag, size) for plane in planes]
    sums, count = (np.sum(parts, 0) for parts in zip(*found, strict=True))
    sums = sums.reshape(3, size, size, 3, 3)
    if count.mean() < limits.FEW_CELLS:
        sums = ndimage.uniform_filter(sums, (1, 3, 3, 1, 1), mode="wrap")
        count = ndimage.uniform_filter(count, 3, mode="wrap")
    floor = np.eye(3) * limits.JND**2
    joint, first, second = sums / np.maximum(count, 1)[..., np.newaxis, np.newaxis]
    whole, unrelated = joint + floor, first + second + floor
    constant = np.linalg.slogdet(unrelated)[1] - np.linalg.slogdet(whole)[1]
    inverses = [np.linalg.inv(matrices).astype(np.float32) for matrices in (whole, unrelated)]
    return PairModel(lag, inverses[0], inverses[1], constant.astype(np.float32))


@dataclass(frozen=True, eq=False)
class NovelParts:
    """Evidence from parts of elements that no element of the references has at their place of the cell.

    Windows of half a cell, at every quarter of a cell, less their mean color, are compared with all windows of the
    references at the same place. The level of a window is the logarithm of its mean squared difference to the nearest
    one. Its evidence is the departure of the level from the mean level of the references' own windows at that place,
    each compared with all others, in standard deviations.

    Parameters
    ----------
    windows
        ``(n, 48)`` windows of the references, at each of 4 x 4 places.
    mean, deviation
        ``(4, 4)``: of the levels of these windows.
    """

    windows: Sequence[NDArray[np.float32]]
    mean: NDArray[np.float32]
    deviation: NDArray[np.float32]

    @classmethod
    def learn(cls, planes: Sequence[CoarsePlane]) -> NovelParts:
        """Gather the windows of the references."""
        found = [_cut_windows(plane) for plane in planes]
        windows, mean, deviation = [], [], []
        for p, q in np.ndindex(_PER_CELL, _PER_CELL):
            own = np.concatenate([cells[:, :, p, q][known[:, :, p, q]] for cells, known in found])
            own = own[:: max(1, -(-len(own) // _MOST_WINDOWS))]
            levels = _find_levels(own, own, 1) if len(own) >= _LEAST_WINDOWS else np.zeros(1)
            windows.append(own)
            mean.append(levels.mean())
            deviation.append(np.hypot(levels.std(), limits.LEAST_LEVEL))
        side = (_PER_CELL, _PER_CELL)
        return cls(windows, *(np.array(a, np.float32).reshape(side) for a in (mean, deviation)))

    def weigh(self, plane: CoarsePlane) -> Evidence:
        """Return the evidence of each cell."""
        cells, known = _cut_windows(plane)
        evidence = np.full(known.shape, -np.inf, np.float32)
        for windows, (p, q) in zip(self.windows, np.ndindex(_PER_CELL, _PER_CELL), strict=True):
            here = known[:, :, p, q]
            if here.any() and len(windows) >= _LEAST_WINDOWS:
                own = cells[:, :, p, q][here]
                parts = (own[k : k + _AT_ONCE**2] for k in range(0, len(own), _AT_ONCE**2))
                levels = np.concatenate([_find_levels(part, windows, 0) for part in parts])
                evidence[:, :, p, q][here] = (levels - self.mean[p, q]) / self.deviation[p, q]
        return _largest_in_cells(evidence.swapaxes(1, 2).reshape(-1, known.shape[1] * _PER_CELL), (_PER_CELL,) * 2)


_PER_CELL = 4
"""Windows of a cell along each vector."""


def _cut_windows(plane: CoarsePlane) -> tuple[Values, Mask]:
    """Return the windows whose middles lie in each cell, ``(N1, N2, 4, 4, 48)``, and those that are known."""
    side, (rows, columns) = (_WIDTH, _WIDTH), plane.complete.shape
    views = sliding_window_view(plane.values, side, (0, 1))[::_STEP, ::_STEP]
    windows = np.zeros((rows // _STEP, columns // _STEP, 3 * _WIDTH**2), np.float32)
    known = np.zeros(windows.shape[:2], bool)
    for k in range(0, len(views), _AT_ONCE):
        part = views[k : k + _AT_ONCE]
        mean = np.asarray(sum(part[..., i, j] for i, j in np.ndindex(side)) / np.float32(_WIDTH**2))
        rest = part - mean[..., np.newaxis, np.newaxis]
        windows[1 + k : 1 + k + _AT_ONCE, 1:] = rest.reshape(*part.shape[:2], -1)
    known[1:, 1:] = sliding_window_view(plane.complete, side)[::_STEP, ::_STEP].all((2, 3))
    return split_cells(windows, (_PER_CELL, _PER_CELL)), split_cells(known, (_PER_CELL, _PER_CELL))


def _find_levels(windows: Values, others: Values, rank: int) -> NDArray[np.float32]:
    """Return the level of the difference of each window to the nearest other one, or to the next one (rank 1)."""
    squares = (windows**2).sum(1)[:, np.newaxis] + (others**2).sum(1) - 2 * windows @ others.T
    nearest = squares.min(1) if rank == 0 else np.partition(squares, rank, 1)[:, rank]
    return np.asarray(np.log(np.maximum(nearest, 0) / _WIDTH**2 + limits.JND**2 / 2), np.float32)


@dataclass(frozen=True, eq=False)
class Steps:
    """Evidence from steps across lines on which the references have none.

    The level of a line of half a cell along a lattice vector is the logarithm of the mean squared difference of the
    residual colors on its two sides, with JND^2 added. Its evidence is the departure from the mean of the references'
    levels at the same place of the cell, in standard deviations.

    Parameters
    ----------
    mean, deviation
        ``(2, n1, n2)``: of the levels of the lines across the two vectors.
    """

    mean: NDArray[np.float64]
    deviation: NDArray[np.float64]

    @classmethod
    def learn(cls, planes: Sequence[CoarsePlane]) -> Steps:
        """Learn the levels of lines in the references."""
        own = [_average_cells([_measure_steps(p, axis, (0, 0)) for p in planes], planes[0].samples) for axis in (0, 1)]
        mean, square = np.stack(own, 1)
        return cls(mean, np.sqrt(np.maximum(square - mean**2, 0) + limits.LEAST_LEVEL**2))

    def rate_joints(self, planes: Sequence[CoarsePlane]) -> float:
        """Return the squared differences where a cell is joined to an unrelated one over those in the references.

        JND^2 is added to both; the geometric mean over all lines.
        """
        n = planes[0].samples
        beyond = [(int(i * n[0]), int(j * n[1])) for i, j in ((1, 0), (0, 1), (1, 1))]
        joined = [
            _average_cells([_measure_steps(plane, axis, lag) for plane in planes for lag in beyond], n)[0]
            for axis in (0, 1)
        ]
        return float(np.exp(np.mean(np.stack(joined) - self.mean)))

    def weigh(self, plane: CoarsePlane) -> Evidence:
        """Return the evidence of each cell."""
        largest = np.full(plane.known.shape, -np.inf, np.float32)
        for axis, mean, deviation in zip((0, 1), self.mean, self.deviation, strict=True):
            levels, known = _measure_steps(plane, axis, (0, 0))
            repeats = (levels.shape[0] // mean.shape[0], levels.shape[1] // mean.shape[1])
            evidence = (levels - np.tile(mean, repeats)) / np.tile(deviation, repeats)
            largest = np.where(known, np.maximum(largest, evidence), largest)
        return _largest_in_cells(largest, plane.samples)


def _measure_steps(plane: CoarsePlane, axis: int, beyond: Lag) -> tuple[Values, Mask]:
    """Return the levels of all lines across a vector, and the known ones; the other side is ``beyond`` samples off."""
    lag = (int(axis == 0) + beyond[0], int(axis == 1) + beyond[1])
    other, both = shift_plane(plane.fine, plane.known, lag)
    squares = sum(np.moveaxis((plane.fine - other) ** 2, -1, 0)) * both  # numpy is slow along a short last axis
    length = max(int(plane.samples[1 - axis]) // 2, 2)
    sums, share = (
        ndimage.uniform_filter1d(a.astype(np.float32), length, axis=1 - axis, mode="constant") for a in (squares, both)
    )
    return np.log(sums / np.maximum(share, 0.3) + limits.JND**2), share > 0.6


def _average_cells(fields: Sequence[tuple[Values, Mask]], n: NDArray[np.intp]) -> NDArray[np.float64]:
    """Return the mean and the mean square of fields at each place of the cell, ``(2, n1, n2)``, over 3 x 3 places."""
    sums = np.zeros((3, *n))
    for levels, known in fields:
        seen = np.where(known, levels, 0)
        sums += [split_cells(a, n).sum((0, 1)) for a in (seen, seen * seen, known)]
    sums = ndimage.uniform_filter(sums, (1, 3, 3), mode="wrap")
    return np.asarray(sums[:2] / np.maximum(sums[2], 1e-6))


def learn_tests(planes: Sequence[CoarsePlane], net: LatticeNet) -> list[JointTest]:
    """Learn all tests from the residuals of the references."""
    pairs = [learn_pair(planes, lag) for lag in list_lags(net)]
    return [UnlikeTones(pairs, 1), UnlikeTones(pairs, 3), NovelParts.learn(planes), Steps.learn(planes)]
