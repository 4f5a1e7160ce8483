"""Tests for faults of a displacement field: phase steps along lines, displaced patches, amplitude and roughness."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np
import scipy.linalg
from numpy.typing import NDArray
from scipy.special import ndtr

from nrbench.lattice.geometry import Points

from .covariance import Covariance, SampledField

Values = NDArray[np.float64]
Flags = NDArray[np.bool_]
_DIRECTIONS = 12
"""Number of directions of lines."""
_PARTS = 3
"""Number of lines of one direction for each distance between nodes."""
_LEAST_SIDE = 0.1
"""Least share of the nodes of a block on either side of a line."""
_BLOCK = 18
"""Largest number of nodes along each side of a block. The time for a block grows with its sixth power."""
_LEAST_NODES = 12
"""Least number of reliable nodes of a block."""
_PATCHES = (2, 3)
"""Sides, in nodes, of the patches that may be displaced as a whole."""
_OUTLYING, _TIMES_MEDIAN, _MOST_OUTLIERS = 8.0, 6.0, 0.1
"""A node is an outlier if its log-likelihood ratio exceeds both the first number and the second one times the median.
At most the third share of the nodes is dropped: the tracker locks onto wrong places at a few nodes."""
_RAMP = 0.3
"""Standard deviation, in s, of the Gaussian that smooths a step: the window of a node shows both sides of the line."""
_FREE = 10.0
"""Standard deviation, in s, of the phase of the field. It is free, so any large number serves."""
_SLOPE = 0.03
"""Standard deviation of the slopes of an affine part of the field. An output that continues a bent sample has the mean
lattice of the sample, which departs by some percent from that of the texture; this is no step. A larger deviation costs
power: a step across an image looks like a slope."""


@dataclass(frozen=True)
class Faults:
    """Tests for a displacement of some nodes against the others, one for each set of nodes.

    Parameters
    ----------
    statistic
        ``(m,)``: log-likelihood ratio of the best displacement and none. Without faults, its distribution is about
        exponential with mean 1.
    distance
        ``(m,)``: length of the best displacement, in s.
    power
        ``(m,)``: the statistic that a displacement of s would have on average, without the part of chance.
    sets
        ``bool (m, nodes)``: the displaced nodes, row by row over the whole grid.
    """

    statistic: Values
    distance: Values
    power: Values
    sets: Flags


@dataclass(frozen=True)
class FieldTests:
    """All tests of one field.

    Parameters
    ----------
    field
        The field.
    lines
        Tests for a step along lines.
    patches
        Tests for displaced patches of up to 3 x 3 nodes.
    """

    field: SampledField
    lines: Faults
    patches: Faults


def measure_faults(field: SampledField, covariance: Covariance) -> FieldTests:
    """Test a field for steps along lines, in blocks that overlap by half, and for displaced patches.

    The displacements of a block are normal with the given covariance and any mean. A fault adds a constant vector to
    the displacements of some nodes: those on one side of a line, or those of a patch. The best vector and its
    log-likelihood ratio follow by generalized least squares. This is the matched filter for the fault in noise of that
    covariance. Time is linear in the number of blocks.
    """
    rows, columns = field.reliable.shape
    lines: list[Faults] = []
    patches: list[Faults] = []
    for block in _blocks(field):
        places = field.places.reshape(-1, 2)[block]
        precision = _precision(places, field.error.ravel()[block], covariance)
        values = field.displacement.reshape(-1, 2)[block]
        at = np.stack(np.divmod(block, columns), -1)
        for result, sets in ((lines, _half_planes(places)), (patches, _patches(at))):
            result.append(_test_sets(sets, precision, values, block, rows * columns))
    return FieldTests(field, _join(lines, rows * columns), _join(patches, rows * columns))


def drop_outliers(field: SampledField, covariance: Covariance) -> SampledField:
    """Return the field without the nodes that lie far from where all other nodes of their block put them."""
    rows, columns = field.reliable.shape
    statistic = np.zeros(rows * columns)
    for block in _blocks(field):
        precision = _precision(field.places.reshape(-1, 2)[block], field.error.ravel()[block], covariance)
        residual = precision @ field.displacement.reshape(-1, 2)[block]
        statistic[block] = np.maximum(statistic[block], (residual**2).sum(1) / np.diag(precision) / 2)
    usual = statistic[field.reliable.ravel()]
    if not len(usual):
        return field
    limit = max(_OUTLYING, _TIMES_MEDIAN * float(np.median(usual)), float(np.quantile(usual, 1 - _MOST_OUTLIERS)))
    return replace(field, reliable=field.reliable & (statistic <= limit).reshape(rows, columns))


def _blocks(field: SampledField) -> Iterator[NDArray[np.intp]]:
    """Yield the reliable nodes of each block that has enough of them."""
    rows, columns = field.reliable.shape
    for y in _block_starts(rows):
        for x in _block_starts(columns):
            inside = np.zeros((rows, columns), np.bool_)
            inside[y : y + _BLOCK, x : x + _BLOCK] = True
            block = np.flatnonzero((inside & field.reliable).ravel())
            if len(block) >= _LEAST_NODES:
                yield block


def _block_starts(side: int) -> list[int]:
    count = 1 + math.ceil(max(side - _BLOCK, 0) / (_BLOCK / 2))
    return [int(start) for start in np.unique(np.linspace(0, max(side - _BLOCK, 0), count).astype(int))]


def _covariance_between(places: Points, nodes: Points, covariance: Covariance) -> Values:
    """Return the covariance of displacements along one axis at places and at nodes, with a free phase and slope."""
    middle = nodes.mean(0)
    slope = (places - middle) @ (nodes - middle).T
    return np.asarray(covariance.between(places, nodes) + _FREE**2 + _SLOPE**2 * slope)


def _node_covariance(places: Points, error: Values, covariance: Covariance) -> Values:
    """Return the covariance matrix of measured displacements along one axis, with a free phase and slope."""
    matrix = _covariance_between(places, places, covariance)
    matrix[np.diag_indices_from(matrix)] += covariance.of_error(error)
    return matrix


def _precision(places: Points, error: Values, covariance: Covariance) -> Values:
    """Return the inverse of the covariance matrix of measured displacements along one axis."""
    matrix = _node_covariance(places, error, covariance)
    return np.asarray(scipy.linalg.inv(matrix, overwrite_a=True, check_finite=False))


def _half_planes(places: Points) -> Values:
    """Return how far nodes lie on one side of lines in all directions, ``(m, n)``.

    The value rises from 0 to 1 across the line, because the window of a node near the line shows both sides.
    """
    sets = []
    step = math.sqrt(float(np.ptp(places[:, 0]) * np.ptp(places[:, 1])) / len(places)) / _PARTS
    for angle in np.arange(_DIRECTIONS) * (math.pi / _DIRECTIONS):
        along = places @ (math.cos(angle), math.sin(angle))
        offsets = np.arange(along.min() + step / 2, along.max(), max(step, 1e-3))
        # Lines between the same nodes are one line.
        count, first = np.unique((along > offsets[:, np.newaxis]).sum(1), return_index=True)
        kept = first[(count >= _LEAST_SIDE * len(places)) & (count <= (1 - _LEAST_SIDE) * len(places))]
        sets.append(ndtr((along - offsets[kept, np.newaxis]) / _RAMP))
    return np.concatenate(sets)


def _patches(at: NDArray[np.int64]) -> Values:
    """Return the nodes of patches around each node, ``(m, n)``; ``at`` holds the row and column of each node."""
    apart = at[np.newaxis] - at[:, np.newaxis]
    sets = [np.asarray(((apart >= 0) & (apart < side)).all(-1)) for side in _PATCHES]
    # Patches of which more than a third is missing are left out.
    return 1.0 * np.concatenate([one[one.sum(1) >= 2 / 3 * side**2] for one, side in zip(sets, _PATCHES, strict=True)])


def _test_sets(sets: Values, precision: Values, values: Points, block: NDArray[np.intp], nodes: int) -> Faults:
    filters = sets @ precision
    energy = np.maximum((filters * sets).sum(1), 1e-12)
    moments = filters @ values
    every = np.zeros((len(sets), nodes), np.bool_)
    every[:, block] = sets > 0.5
    return Faults((moments**2).sum(1) / energy / 2, np.hypot(*moments.T) / energy, energy / 2, every)


def _join(parts: list[Faults], nodes: int) -> Faults:
    if not parts:
        return Faults(np.zeros(0), np.zeros(0), np.zeros(0), np.zeros((0, nodes), np.bool_))
    return Faults(
        *(np.concatenate([getattr(one, name) for one in parts]) for name in ("statistic", "distance", "power", "sets"))
    )


def smooth_field(field: SampledField, covariance: Covariance, places: Points) -> Points:
    """Return the most likely displacement at places ``(n, 2)``, in s, given the reliable nodes: simple kriging.

    Parameters
    ----------
    field
        The field.
    covariance
        Covariance of the field.
    places
        (x, y) in s. Each is predicted from the nodes of the block around it.
    """
    result = np.zeros((len(places), 2))
    rows, columns = field.reliable.shape
    y0, x0 = (_block_starts(side) for side in (rows, columns))
    step = np.array([_step(field.places[:, 0, 1]), _step(field.places[0, :, 0])])
    at = places[:, ::-1] / step
    # Each place belongs to the block whose middle is nearest.
    own = [
        np.abs(at[:, [axis]] - (np.array(starts) + min(_BLOCK, side) / 2)).argmin(1)
        for axis, (starts, side) in enumerate(((y0, rows), (x0, columns)))
    ]
    for j, y in enumerate(y0):
        for i, x in enumerate(x0):
            wanted = (own[0] == j) & (own[1] == i)
            inside = np.zeros((rows, columns), np.bool_)
            inside[y : y + _BLOCK, x : x + _BLOCK] = True
            block = np.flatnonzero((inside & field.reliable).ravel())
            if not len(block) or not wanted.any():
                continue
            nodes, values = field.places.reshape(-1, 2)[block], field.displacement.reshape(-1, 2)[block]
            cross = _covariance_between(places[wanted], nodes, covariance)
            matrix = _node_covariance(nodes, field.error.ravel()[block], covariance)
            result[wanted] = cross @ scipy.linalg.solve(matrix, values, overwrite_a=True, assume_a="pos")
    return result


def _step(along: Values) -> float:
    return float(along[-1] - along[0]) / max(len(along) - 1, 1) or 1.0
