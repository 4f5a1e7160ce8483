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
_TAPERS = 2
"""Number of tapers along each axis."""
_AROUND = 32
"""Number of nodes from which a displacement that is not reliable is interpolated."""
_ITERATIONS = 60
"""Number of steps of the likelihood's maximization."""
_LEAST_NOISE = 0.02
"""Standard deviation, in s, of the part of the error that does not depend on the correlation."""
_MOST_POWER = 3.0
"""Ratio of a periodogram to its expectation above which the excess is ignored."""
_USUAL_RANGE = 4.0
"""Ratio of the variances of two fields of a texture, up to which they count as equal."""
_LEAST_NODES = 12
"""Least number of reliable nodes of a field that counts."""
_LEAST_VARIANCE = 1e-12
"""Variance, in s^2, below which a value counts as zero."""
_FARTHEST = 8.0
"""Largest distance, in s, at which correlations count for the area of one independent value."""
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
    error
        ``(rows, columns)``: variance of the error of each displacement, up to a factor that all fields of a texture
        have in common, see :attr:`Covariance.noise`.
    """

    places: Points
    displacement: Points
    reliable: Flags
    error: Values

    @property
    def centered(self) -> Points:
        """The displacement less its mean, 0 where it is not reliable, ``(rows, columns, 2)``."""
        mean = self.displacement[self.reliable].mean(0) if self.reliable.any() else np.zeros(2)
        return np.asarray(np.where(self.reliable[..., np.newaxis], self.displacement - mean, 0.0))


def _grid_lags(shape: tuple[int, int], places: Points) -> Values:
    """Return the distance, in s, of two nodes of a grid for each lag of an FFT of some shape."""
    step = _spacing(places, 0), _spacing(places, 1)
    y, x = (np.fft.fftfreq(n, 1 / n) * one for n, one in zip(shape, step, strict=True))
    return np.asarray(np.hypot(y[:, np.newaxis], x))


def _spacing(places: Points, axis: int) -> float:
    """Return the distance of the nodes along an axis of their grid; 1 if there is only one."""
    ends = np.take(places, (0, -1), axis)
    length = places.shape[axis] - 1
    return float(abs(np.diff(ends, axis=axis)[..., 1 - axis]).max() / length) if length else 1.0


@dataclass(frozen=True)
class Covariance:
    """The covariance of displacements along one axis: an isotropic spectrum, and the error of each node.

    The field is a sum of waves of all directions. The covariance of waves of one length is a Bessel function of the
    distance.

    Parameters
    ----------
    weights
        ``(K,)``: variance of the waves of each length, in s^2.
    noise
        Factor of the variance of the error of each node, in s^2, see :attr:`SampledField.error`.
    """

    weights: Values
    noise: float

    @classmethod
    def fit(cls, fields: Sequence[SampledField]) -> Covariance:
        """Return the most likely covariance of some fields together. Without any node it is that of errors alone.

        The likelihood is that of the periodograms of the tapered fields, each of which is compared with its exact
        expectation: missing nodes and the ends of the grid spread the power of a wave in a known way (debiased Whittle
        likelihood; Sykulski, Olhede, Guillaumin, Lilly, Early, Biometrika 106, 2019). So waves of a small variance are
        measured beside others that are a thousand times stronger, and nodes may be missing. It is maximized by
        multiplications that keep variances positive (Zhou, Hu, Zhou, Lange, Journal of Computational and Graphical
        Statistics 28, 2019). Powers far above their expectation are cut to a multiple of it. Time is that of FFTs of
        twice the grid for each wave length.
        """
        parts = [_periodogram(field) for field in fields if field.reliable[1:-1, 1:-1].sum() >= _LEAST_NODES]
        if not parts:
            return cls(np.zeros(_WAVE_LENGTHS[2]), 0.0)
        expected = np.concatenate([one for one, _ in parts], 1)
        power = np.concatenate([one for _, one in parts])
        weights = np.full(len(expected), power.sum() / max(float(expected.sum()), _LEAST_VARIANCE))
        for _ in range(_ITERATIONS):
            model = weights @ expected + _LEAST_VARIANCE
            ascent = expected @ (np.minimum(power, _MOST_POWER * model) / model**2)
            weights = weights * np.sqrt(ascent / np.maximum(expected @ (1 / model), _LEAST_VARIANCE))
        return cls(weights[:-1], float(weights[-1]))

    def extended_to(self, field: SampledField) -> Covariance:
        """Return the covariance of a field that may be rougher, larger or much smaller than those that were fitted.

        Waves of each length have the variance of those fields, or that of the field itself where it is larger. A step
        along a line stays a surprise: its power lies on a line of the periodogram, and powers far above the expectation
        are ignored. If the field as a whole varies much less, the variances of those fields are lowered: large waves
        that cancel one another next to a step are no explanation for a field without any.
        """
        own = Covariance.fit([field])
        lowered = min(1.0, _USUAL_RANGE * own.variance / max(self.variance, _LEAST_VARIANCE))
        return Covariance(np.maximum(lowered * self.weights, own.weights), max(self.noise, own.noise))

    @property
    def variance(self) -> float:
        """Variance of the displacements along one axis without errors, in s^2."""
        return float(self.weights.sum())

    @property
    def correlation_area(self) -> float:
        """Integral of the squared correlation over the plane, in s^2: the area that counts as one independent value."""
        table = np.arange(0, _FARTHEST, _STEP)
        correlation = j0(table[:, np.newaxis] * _wave_numbers()) @ self.weights / max(self.variance, _LEAST_VARIANCE)
        return float(2 * math.pi * (table * correlation**2).sum() * _STEP)

    def between(self, places: Points, others: Points) -> Values:
        """Return the covariance of the field without errors at places ``(n, 2)`` and others ``(m, 2)``, in s."""
        apart = cdist(places, others)
        table = np.arange(0, float(apart.max(initial=0.0)) + 2 * _STEP, _STEP)
        return np.asarray(np.interp(apart, table, j0(table[:, np.newaxis] * _wave_numbers()) @ self.weights))

    def of_error(self, error: Values) -> Values:
        """Return the variance of the error of nodes, in s^2, given that up to the common factor."""
        return np.asarray(self.noise * error + _LEAST_NOISE**2)


def _wave_numbers() -> Values:
    longest, shortest, count = _WAVE_LENGTHS
    return np.asarray(2 * math.pi / np.geomspace(longest, shortest, count))


def _periodogram(field: SampledField) -> tuple[Values, Values]:
    """Return the expected periodogram of waves of each length and of errors, ``(K + 1, n)``, and the found one.

    Tapers are products of sines (Riedel, Sidorenko, IEEE Transactions on Signal Processing 43, 1995). The periodogram
    of a wave is the Fourier transform of its covariance times the autocorrelation of the taper. Nodes at the border,
    whose displacements are often wrong, are left out.
    """
    inner = np.s_[1:-1, 1:-1]
    reliable, error = field.reliable[inner], field.error[inner]
    rows, columns = reliable.shape
    twice = (2 * rows, 2 * columns)
    lags = _grid_lags(twice, field.places)
    tapers = np.einsum("iy,jx->ijyx", _sines(rows), _sines(columns)).reshape(-1, rows, columns)
    values = np.moveaxis(_fill(field.places[inner], field.displacement[inner], reliable), -1, 0)
    values = values - values.mean((1, 2), keepdims=True)
    power = (np.abs(scipy.fft.rfft2(values[:, np.newaxis] * tapers, twice)) ** 2).mean(0).sum(0)
    correlation = scipy.fft.irfft2((np.abs(scipy.fft.rfft2(tapers, twice)) ** 2).sum(0), twice)
    waves = scipy.fft.rfft2(correlation * j0(lags * _wave_numbers()[:, np.newaxis, np.newaxis])).real
    flat = np.full((1, *waves.shape[1:]), (tapers**2 * error * reliable).sum())
    expected = np.maximum(np.concatenate([waves, flat]), 0.0)
    return expected.reshape(len(expected), -1), power.ravel()


def _fill(places: Points, displacement: Points, reliable: Flags) -> Points:
    """Return displacements, those of nodes that are not reliable by thin plate splines through the others.

    Zeros in their place would spread the power of long waves over all wave lengths.
    """
    if reliable.all():
        return displacement
    filled = displacement.copy()
    spline = scipy.interpolate.RBFInterpolator(places[reliable], displacement[reliable], neighbors=_AROUND)
    filled[~reliable] = spline(places[~reliable])
    return filled


def _sines(count: int) -> Values:
    """Return the first sine tapers of some nodes, ``(_TAPERS, count)``."""
    number = np.arange(1, _TAPERS + 1)[:, np.newaxis]
    return np.asarray(np.sin(math.pi * number * np.arange(1, count + 1) / (count + 1)))


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
    return pairs, np.asarray(squares), _grid_lags((2 * rows, 2 * columns), field.places)
