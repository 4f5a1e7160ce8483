"""The covariance of a displacement field, estimated from fields without faults."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import scipy
from numpy.typing import NDArray
from scipy.spatial.distance import cdist
from scipy.special import j0

from nrbench.lattice.geometry import Points

Values = NDArray[np.float64]
Flags = NDArray[np.bool_]
_WAVE_LENGTHS = (24.0, 1.0, 28)
"""Longest and shortest wave length of the spectrum, in s, and the number of wave lengths."""
_BIN = 0.5
"""Width, in s, of the bins of distances."""
_FARTHEST = 8.0
"""Largest distance, in s, at which the covariance is estimated."""
_LEAST_PAIRS = 0.02
"""Number of pairs of a bin, over that of the fullest bin, below which the bin is ignored."""
_FLOOR = 0.01
"""Share of the variance that is added as the same spectrum for all wave lengths. The estimate misses waves that the few
references happen not to show."""
_LEAST_NOISE = 0.01
"""Smallest standard deviation, in s, of the error of a tracked displacement."""
_STEP = 0.02
"""Spacing, in s, of the table of the covariance."""


@dataclass(frozen=True)
class SampledField:
    """A displacement field at the nodes of an upright grid.

    Parameters
    ----------
    places
        ``(rows, columns, 2)``: the nodes (x, y) on the plane of the undisturbed lattice, in s.
    displacement
        ``(rows, columns, 2)``: displacement (x, y) of the content that belongs at each node, in s.
    reliable
        ``bool (rows, columns)``: whether the content was found inside the image.
    """

    places: Points
    displacement: Points
    reliable: Flags

    @property
    def centered(self) -> Points:
        """The displacement less its mean, 0 where it is not reliable, ``(rows, columns, 2)``."""
        mean = self.displacement[self.reliable].mean(0) if self.reliable.any() else np.zeros(2)
        return np.asarray(np.where(self.reliable[..., np.newaxis], self.displacement - mean, 0.0))


@dataclass(frozen=True)
class Correlogram:
    """Sums over the pairs of nodes of one or more fields, by distance.

    Parameters
    ----------
    distances
        ``(b,)``: mean distance of the pairs of each bin, in s; the first bin holds pairs of a node with itself.
    products
        ``(b,)``: mean product of two displacements along one axis, in s^2.
    pairs
        ``(b,)``: number of pairs.
    """

    distances: Values
    products: Values
    pairs: Values

    @classmethod
    def of(cls, fields: Sequence[SampledField]) -> Correlogram:
        """Return the correlogram of some fields together. The time is that of FFTs of twice the grid."""
        count = math.ceil(_FARTHEST / _BIN) + 1
        sums = np.zeros((3, count))
        for field in fields:
            rows, columns = field.reliable.shape
            table = np.concatenate([field.reliable[np.newaxis], np.moveaxis(field.centered, -1, 0)])
            power = np.abs(np.fft.fft2(table, (2 * rows, 2 * columns))) ** 2
            pairs = np.rint(np.fft.ifft2(power[0]).real)
            products = np.fft.ifft2(power[1:].sum(0)).real / 2
            step = np.array([_spacing(field.places, axis) for axis in (0, 1)])
            y, x = (np.fft.fftfreq(2 * n, 1 / (2 * n)) * one for n, one in zip((rows, columns), step, strict=True))
            distance = np.hypot(y[:, np.newaxis], x)
            ring = np.ceil(distance / _BIN).astype(np.intp)
            near = ring < count
            for row, weights in zip(sums, (pairs, products, pairs * distance), strict=True):
                row += np.bincount(ring[near], weights[near], minlength=count)
        use = sums[0] > _LEAST_PAIRS * sums[0].max()
        number = np.maximum(sums[0][use], 1)
        return cls(sums[2][use] / number, sums[1][use] / number, sums[0][use])


def _spacing(places: Points, axis: int) -> float:
    """Return the distance of the nodes along an axis of their grid; 1 if there is only one."""
    ends = np.take(places, (0, -1), axis)
    length = places.shape[axis] - 1
    return float(abs(np.diff(ends, axis=axis)[..., 1 - axis]).max() / length) if length else 1.0


@dataclass(frozen=True)
class Covariance:
    """The covariance of displacements along one axis: an isotropic spectrum, and the error of each node.

    The field is a sum of waves of all directions. The covariance of waves of one length is a Bessel function of the
    distance. The weights of the lengths are fitted to the correlogram by least squares. They are not negative, so the
    result is the covariance of some field, whatever the correlogram is.

    Parameters
    ----------
    weights
        ``(K,)``: variance of the waves of each length, in s^2.
    noise
        Variance of the error of each node, in s^2.
    """

    weights: Values
    noise: float

    @classmethod
    def fit(cls, correlogram: Correlogram) -> Covariance:
        """Return the covariance that fits a correlogram. Without any pair it is that of errors alone."""
        if not len(correlogram.pairs):
            return cls(np.zeros(_WAVE_LENGTHS[2]), _LEAST_NOISE**2)
        distances, importance = correlogram.distances, np.sqrt(correlogram.pairs)
        basis = np.column_stack([j0(distances[:, np.newaxis] * _wave_numbers()), distances == 0])
        weights, _ = scipy.optimize.nnls(basis * importance[:, np.newaxis], correlogram.products * importance)
        floor = _FLOOR * correlogram.products[0] / (len(weights) - 1)
        return cls(weights[:-1] + floor, float(max(weights[-1], _LEAST_NOISE**2)))

    @property
    def variance(self) -> float:
        """Variance of the displacements along one axis without errors, in s^2."""
        return float(self.weights.sum())

    @property
    def correlation_area(self) -> float:
        """Integral of the squared correlation over the plane, in s^2: the area that counts as one independent value."""
        table = np.arange(0, _FARTHEST, _STEP)
        correlation = j0(table[:, np.newaxis] * _wave_numbers()) @ self.weights / (self.variance + self.noise)
        return float(2 * math.pi * (table * correlation**2).sum() * _STEP)

    def between(self, places: Points, others: Points) -> Values:
        """Return the covariance of the field without errors at places ``(n, 2)`` and others ``(m, 2)``, in s."""
        apart = cdist(places, others)
        table = np.arange(0, float(apart.max(initial=0.0)) + 2 * _STEP, _STEP)
        return np.asarray(np.interp(apart, table, j0(table[:, np.newaxis] * _wave_numbers()) @ self.weights))


def _wave_numbers() -> Values:
    longest, shortest, count = _WAVE_LENGTHS
    return np.asarray(2 * math.pi / np.geomspace(longest, shortest, count))


@dataclass(frozen=True)
class Variogram:
    """Half of the mean squared difference of displacements along one axis, at short and at long distances.

    Unlike a variance it depends neither on the mean nor on the size of the field.

    Parameters
    ----------
    short
        Mean up to 1.25 s, in s^2.
    long
        Mean from 2 to 4 s, in s^2.
    area
        Area of the reliable nodes, in s^2.
    """

    short: float
    long: float
    area: float

    @classmethod
    def of(cls, fields: Sequence[SampledField]) -> Variogram:
        """Return the variogram of some fields together."""
        sums, area = np.zeros((2, 2)), 0.0
        for field in fields:
            pairs, squares, distance = _difference_lags(field)
            for row, (low, high) in zip(sums, ((1e-6, _SHORT), _LONG), strict=True):
                near = (distance >= low) & (distance <= high)
                row += pairs[near].sum(), squares[near].sum()
            area += float(field.reliable.sum()) * _spacing(field.places, 0) * _spacing(field.places, 1)
        (short_pairs, short), (long_pairs, long) = sums
        return cls(short / max(short_pairs, 1.0), long / max(long_pairs, 1.0), area)

    @property
    def amplitude(self) -> float:
        """Standard deviation of displacements along one axis, in s."""
        return math.sqrt(max(self.long, 0.0))

    @property
    def roughness(self) -> float:
        """Standard deviation of differences between neighbors over that between distant nodes."""
        return math.sqrt(max(self.short, 0.0) / max(self.long, 1e-12))


_SHORT, _LONG = 1.25, (2.0, 4.0)


def _difference_lags(field: SampledField) -> tuple[Values, Values, Values]:
    """Return for each lag the number of pairs, half the sum of squared differences for one axis, and the distance."""
    rows, columns = field.reliable.shape
    values = field.centered
    table = np.stack([field.reliable.astype(np.float64), *np.moveaxis(values, -1, 0), (values**2).sum(-1)])
    spectrum = np.fft.fft2(table, (2 * rows, 2 * columns))
    pairs = np.rint(np.fft.ifft2(np.abs(spectrum[0]) ** 2).real)
    products = np.fft.ifft2((np.abs(spectrum[1:3]) ** 2).sum(0)).real
    powers = np.fft.ifft2(spectrum[3] * np.conj(spectrum[0])).real
    # A lag and its opposite count together, so that each pair contributes the squares of both of its nodes.
    squares = (powers - products) / 2
    step = _spacing(field.places, 0), _spacing(field.places, 1)
    y, x = (np.fft.fftfreq(2 * n, 1 / (2 * n)) * one for n, one in zip((rows, columns), step, strict=True))
    return pairs, np.asarray(squares), np.hypot(y[:, np.newaxis], x)
