"""Fitting waves to a picture by least squares: amplitudes, frequencies, fundamentals; and the sum of waves."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import NamedTuple

import numpy as np
import scipy
from numpy.typing import NDArray

from nrbench.spectra.spectrum import (
    Array,
    Complex,
    DirichletKernel,
    Spectrum,
    bin_numbers,
    dirichlet_sum,
    pair_kernels,
    pair_sums,
)

LONGEST_STEP = 0.25
"""Bins: the largest step of a frequency. The misfit is nearly quadratic within a quarter of the main lobe."""
RIDGE = 1e-9
"""Added to the diagonals, as a share of the number of px, so that waves that coincide share an amplitude."""
ROWS = 64
"""Rows of a matrix that are computed at once, so that they stay in the cache."""
WINDOW = 0.2
"""Standard deviation, in units of the shortest period, of the window in which gain and level are free."""
GAIN_FLOOR = 0.05
"""Share of the waves' mean variance that is added to the variance in a window, so that flat windows have no gain."""
MISFIT_FLOOR = 0.1
"""Share of the median misfit added to the misfit around a pixel, whose inverse is the pixel's weight."""


@dataclass(frozen=True)
class Waves:
    """Waves of given frequencies, fitted to a picture by least squares.

    Coordinates start at the picture's center, so that cosines are orthogonal to sines at all frequencies. Two small
    systems of equations are then solved instead of one. Their entries are Dirichlet kernels at the differences and the
    sums of frequencies. A wave of frequency 0 represents the mean. n waves take O(n^3), for any size of the picture.

    Parameters
    ----------
    spectrum
        The picture's spectrum.
    frequencies
        ``(n, 2)`` cycles/px, without frequency 0, which is always added.
    """

    spectrum: Spectrum
    frequencies: Array

    @cached_property
    def _all(self) -> Array:
        return np.concatenate([np.zeros((1, 2)), self.frequencies])

    @cached_property
    def _both(self) -> tuple[Array, Complex]:
        """All frequencies and their mirror images ``(2 + 2 n, 2)``, and their complex amplitudes ``(2 + 2 n, C)``."""
        p, q = self.amplitudes
        weights = np.concatenate([p - 1j * q, p + 1j * q]) / 2
        return np.concatenate([self._all, -self._all]), np.asarray(weights, np.complex128)

    @cached_property
    def _kernels(self) -> tuple[DirichletKernel, DirichletKernel]:
        """The kernels at the differences and the sums, each ``(1 + n, 1 + n)``."""
        return pair_kernels(self._all, self.spectrum.shape)

    def _grams(self) -> tuple[Array, Array]:
        """Return the inner products of cosines and those of sines, ``(1 + n, 1 + n)`` each; their upper triangles."""
        differences, sums = (kernel.value for kernel in self._kernels)
        return (differences + sums) / 2, (differences - sums) / 2

    @cached_property
    def _factors(self) -> tuple[Array, Array]:
        """The Cholesky factors of the inner products, ``(1 + n, 1 + n)`` each."""
        factors: list[Array] = []
        for gram in self._grams():
            gram.flat[:: len(gram) + 1] += RIDGE * self.spectrum.size.prod()
            factors.append(scipy.linalg.lapack.dpotrf(gram.T, lower=True, overwrite_a=True)[0])
        return factors[0], factors[1]

    @cached_property
    def _transforms(self) -> tuple[Complex, Complex]:
        return self.spectrum.values_and_moments(self._all)

    @property
    def _values(self) -> Complex:
        """The picture's transform at all frequencies, ``(1 + n, C)``."""
        return self._transforms[0]

    @cached_property
    def amplitudes(self) -> tuple[Array, Array]:
        """The best amplitudes of cosines and sines about the center, ``(1 + n, C)`` each; row 0 is the mean's."""
        return _solve(self._factors[0], self._values.real), _solve(self._factors[1], -self._values.imag)

    @cached_property
    def powers(self) -> Array:
        """|FT|^2 of each single wave at its own frequency, ``(n, C)``."""
        p, q = self.amplitudes
        height, width = self.spectrum.shape
        return np.asarray((p[1:] ** 2 + q[1:] ** 2) * (height * width / 2) ** 2)

    @cached_property
    def explained(self) -> Array:
        """The energy that the waves explain, ``(C,)``."""
        value, (p, q) = self._values, self.amplitudes
        return np.asarray((p * value.real - q * value.imag).sum(0))

    def residual_at(self, frequencies: Array) -> Complex:
        """Return the transform of the picture less the waves, ``(m, C)``, at frequencies ``(m, 2)``."""
        return np.asarray(self.spectrum.values(frequencies) - self.transform_at(frequencies))

    def transform_at(self, frequencies: Array) -> Complex:
        """Return the transform of the waves, ``(m, C)``, at frequencies ``(m, 2)``; fastest on a grid."""
        (both, weights), factors = self._both, []
        for axis, length in enumerate(self.spectrum.shape[::-1]):
            distinct, which = np.unique(frequencies[:, axis], return_inverse=True)
            factors.append(dirichlet_sum(distinct[:, np.newaxis] - both[:, axis], length)[which])
        real = (factors[0] * factors[1]) @ np.concatenate([weights.real, weights.imag], 1)
        return np.asarray(real[:, : weights.shape[1]] + 1j * real[:, weights.shape[1] :])

    def transform_around(self, frequencies: Array, offsets: Array) -> Complex:
        """Return the transform of the waves on a small grid about each frequency, ``(m, k, k, C)``, y before x.

        Parameters
        ----------
        frequencies
            ``(m, 2)`` cycles/px.
        offsets
            ``(k,)`` bins along either axis.
        """
        (both, weights), tables = self._both, []
        for axis, length in enumerate(self.spectrum.shape[::-1]):
            distinct, which = np.unique(frequencies[:, axis, np.newaxis] + offsets / length, return_inverse=True)
            table = dirichlet_sum(distinct[:, np.newaxis] - both[:, axis], length)
            tables.append((table, which.reshape(-1, len(offsets))))
        (x, columns), (y, rows) = tables
        parts = np.concatenate([weights.T.real, weights.T.imag])[:, np.newaxis]
        transform = np.empty((len(frequencies), len(parts), len(offsets), len(offsets)))
        for k in range(len(frequencies)):
            np.matmul(y[rows[k]], (x[columns[k]] * parts).transpose(0, 2, 1), out=transform[k])
        channels = weights.shape[1]
        return np.moveaxis(transform[:, :channels] + 1j * transform[:, channels:], 1, 3)

    def residual_bins(self) -> Complex:
        """Return the transform of the picture less the waves at integer bins, ``(C, H, W // 2 + 1)``."""
        both, weights = self._both
        rows, cols = (
            dirichlet_sum((k / n)[:, np.newaxis] - both[:, axis], n)
            for k, n, axis in zip(bin_numbers(self.spectrum.shape), self.spectrum.shape, (1, 0), strict=True)
        )
        transform = [((rows * w.real) @ cols.T) + 1j * ((rows * w.imag) @ cols.T) for w in weights.T]
        return np.asarray(self.spectrum.bins - np.stack(transform))

    def normal_equations(self, weights: Array | None = None) -> tuple[Array, Array]:
        """Return the normal equations of the frequencies with the amplitudes eliminated (variable projection).

        Parameters
        ----------
        weights
            ``(n, C)``: the weight of each wave, e.g. the inverse of the noise's power at its frequency. None: 1.

        Returns
        -------
        tuple
            The matrix ``(n, 2, n, 2)`` and the right side ``(n, 2)``, for steps in cycles/px.
        """
        (p, q), (cosines, sines) = self.amplitudes, self._factors
        weights = np.ones((len(self.frequencies), 1)) if weights is None else weights
        root = np.sqrt(np.pad(weights, ((1, 0), (0, 0))))
        differences, sums = self._kernels
        crossing = (sums.slope - differences.slope) / 2, -(sums.slope + differences.slope) / 2
        sine_bend = (sums.curvature - differences.curvature) / 2
        cosine_bend = -(sums.curvature + differences.curvature) / 2
        matrix = _projected(sine_bend, crossing[0], cosines, p * root)
        matrix += _projected(cosine_bend, crossing[1], sines, q * root)
        by_sine = -self._transforms[1].imag * 2 * np.pi + np.einsum("ajk,jc->akc", crossing[0], p)
        by_cosine = self._transforms[1].real * 2 * np.pi - np.einsum("ajk,jc->akc", crossing[1], q)
        right = ((-p * by_sine + q * by_cosine) * root**2).sum(2)
        return np.ascontiguousarray(np.transpose(matrix, (2, 0, 3, 1))[1:, :, 1:]), np.ascontiguousarray(right.T[1:])

    def origin_amplitudes(self, kept: NDArray[np.bool_] | None = None) -> tuple[Array, Array, Array]:
        """Return the amplitudes about pixel (0, 0): cosine ``(n, C)``, sine ``(n, C)``, mean ``(C,)``.

        Parameters
        ----------
        kept
            ``(n, C)``: the channels in which each wave is kept; in the others its amplitude is 0. None: all.
        """
        p, q = self.amplitudes
        mask = np.ones((len(p) - 1, 1)) if kept is None else kept
        p_kept, q_kept = p[1:] * mask, q[1:] * mask
        phase = 2 * np.pi * (self.frequencies @ ((self.spectrum.size - 1) / 2))[:, np.newaxis]
        cosine = p_kept * np.cos(phase) - q_kept * np.sin(phase)
        sine = p_kept * np.sin(phase) + q_kept * np.cos(phase)
        return cosine, sine, self.spectrum.mean + p[0]

    def subtract(self, kept: NDArray[np.bool_] | None = None) -> Array:
        """Return the picture's planes without the waves (``kept`` as for :meth:`origin_amplitudes`)."""
        model = wave_sum(self.frequencies, *self.origin_amplitudes(kept), self.spectrum.shape)
        return np.asarray(self.spectrum.planes - model)


@dataclass(frozen=True)
class FixedWaves(Waves):
    """Waves whose frequencies are not fitted, so that neither moments nor derivatives of the kernels are needed.

    Parameters
    ----------
    spectrum, frequencies
        As for :class:`Waves`.
    transform
        ``(n, C)``: the picture's transform at the frequencies.
    """

    transform: Complex

    def _grams(self) -> tuple[Array, Array]:
        (x, y), (height, width) = self._all.T, self.spectrum.shape
        cosines, sines = np.zeros((2, len(x), len(x)))
        for start in range(0, len(x), ROWS):
            rows = slice(start, start + ROWS)
            across, down = pair_sums(x[rows], x[start:], width), pair_sums(y[rows], y[start:], height)
            differences, sums = across[0] * down[0], across[1] * down[1]
            cosines[rows, start:], sines[rows, start:] = (differences + sums) / 2, (differences - sums) / 2
        return cosines, sines

    @property
    def _values(self) -> Complex:
        return np.pad(self.transform, ((1, 0), (0, 0)))  # the mean is removed


def _solve(factor: Array, right: Array) -> Array:
    """Return the solution of a system of equations from its Cholesky factor."""
    return np.asarray(scipy.linalg.lapack.dpotrs(factor, right, lower=True)[0])


def _projected(bend: Array, crossing: Array, factor: Array, amplitudes: Array) -> Array:
    """Return the amplitude-weighted inner products of the slopes, minus the part that the waves explain."""
    n = len(factor)
    flat = np.concatenate(list(crossing), 1)
    shared = (flat.T @ _solve(factor, flat)).reshape(2, n, 2, n).transpose(0, 2, 1, 3)
    return np.asarray((bend - shared) * (amplitudes @ amplitudes.T))


class FrequencyFit(NamedTuple):
    """Waves whose frequencies are integer combinations of fundamentals.

    Parameters
    ----------
    fundamentals
        ``(g, 2)`` cycles/px.
    waves
        Waves of the frequencies ``orders @ fundamentals``.
    """

    fundamentals: Array
    waves: Waves


def fit_frequencies(
    spectrum: Spectrum,
    fundamentals: Array,
    orders: Array | None = None,
    steps: int = 20,
    weights: Array | None = None,
) -> FrequencyFit:
    """Return the joint least-squares fit nearest to a start: Levenberg's method on the variable projection.

    Parameters
    ----------
    spectrum
        The picture's spectrum.
    fundamentals
        ``(g, 2)`` cycles/px: the start of the fit. The errors of the frequencies should be less than half a bin.
    orders
        ``(n, g)`` integers: the frequencies are ``orders @ fundamentals``. None: each is its own fundamental.
    steps
        The largest number of steps.
    weights
        ``(n, C)``: the weight of each wave, the inverse of the noise's power at its frequency. None: 1.
    """
    orders = np.eye(len(fundamentals)) if orders is None else orders
    fit, damping = FrequencyFit(fundamentals, Waves(spectrum, orders @ fundamentals)), 1e-6
    for _ in range(steps if len(fundamentals) else 0):
        step = _step(fit, orders, damping, weights)
        longest = float(np.abs(orders @ step * spectrum.size).max())
        step *= min(1.0, LONGEST_STEP / max(longest, 1e-300))
        moved = fit.fundamentals + step
        trial = FrequencyFit(moved, Waves(spectrum, orders @ moved))
        better = weights is not None or trial.waves.explained.sum() >= fit.waves.explained.sum() * (1 - 1e-12)
        fit, damping = (trial, damping / 10) if better else (fit, max(damping, 1e-6) * 100)
        if longest < 1e-5 or damping > 1e6:
            break
    return fit


def _step(fit: FrequencyFit, orders: Array, damping: float, weights: Array | None) -> Array:
    matrix, right = fit.waves.normal_equations(weights)
    g = orders.shape[1]
    half = np.tensordot(orders, matrix, (0, 0))
    small = np.tensordot(half, orders, (2, 0)).transpose(0, 1, 3, 2).reshape(2 * g, 2 * g)
    diagonal = np.diag(small).copy()
    small = small + np.diag(damping * diagonal + 1e-12 * max(float(diagonal.max()), 1e-300))
    return np.asarray(np.linalg.solve(small, (orders.T @ right).ravel()).reshape(g, 2))


def wave_sum(
    frequencies: Array,
    cosine: Array,
    sine: Array,
    mean: Array,
    shape: tuple[int, int],
    offset: tuple[float, float] = (0.0, 0.0),
) -> Array:
    """Return mean + sum of cosine cos(2 pi f r) + sine sin(2 pi f r), ``(H, W, C)``: equation 6 of the FFTM paper.

    Each wave is a product of functions of x and of y: two matrix products a channel, O(n H W) in all.

    Parameters
    ----------
    frequencies
        ``(n, 2)`` cycles/px.
    cosine, sine
        ``(n, C)``.
    mean
        ``(C,)``.
    shape
        (height, width) px.
    offset
        (x, y) px of the window's first pixel, any real numbers.
    """
    x, y = (
        2 * np.pi * np.outer(f, np.arange(n) + o) for f, n, o in zip(frequencies.T, shape[::-1], offset, strict=True)
    )
    rows = np.concatenate([np.cos(y), np.sin(y)]).T
    cos, sin = np.cos(x), np.sin(x)
    planes = [
        rows @ np.concatenate([c * cos + s * sin, s * cos - c * sin]) + level
        for c, s, level in zip(cosine.T[..., np.newaxis], sine.T[..., np.newaxis], mean, strict=True)
    ]
    return np.stack(planes, -1)


def register_fundamentals(waves: Waves, frequencies: Array, fundamentals: Array) -> Array:
    """Return fundamentals after an affine registration of their waves to the picture, ``(2, 2)``.

    A plain fit of the waves is biased by elements of unusual color, although the edges of these elements are in place.
    Here the picture is compared with its waves as in image registration: gain and level of each channel are free in a
    window smaller than a tile, and one Gauss-Newton step finds the small affine displacement of the waves that reduces
    the misfit. Each pixel is weighted by the inverse of the misfit around it.

    Parameters
    ----------
    waves
        Waves fitted to the picture.
    frequencies
        ``(n, 2)`` cycles/px: their frequencies, not folded.
    fundamentals
        ``(2, 2)`` cycles/px. At the picture's border their error should be less than a tenth of a period.
    """
    sigma = WINDOW / float(np.linalg.svd(fundamentals)[1][0])
    planes = waves.spectrum.planes.astype(np.float64)
    model, moves = _model_and_moves(waves, frequencies)
    level, mean, shift = _smooth(model, sigma), _smooth(planes, sigma), _smooth(moves, sigma)
    variance = np.maximum(_smooth(model**2, sigma) - level**2, 0)
    variance += GAIN_FLOOR * variance.mean((0, 1)) + 1e-12
    gain = (_smooth(planes * model, sigma) - mean * level) / variance
    misfit = planes - mean - gain * (model - level)
    slope = (_smooth(moves * model[..., np.newaxis], sigma) - shift * level[..., np.newaxis]) / variance[
        ..., np.newaxis
    ]
    moves = gain[..., np.newaxis] * (moves - shift - slope * (model - level)[..., np.newaxis])
    strain = _weighted_lstsq(moves, misfit, _pixel_weights(misfit, sigma))[:4].reshape(2, 2)
    return np.asarray(fundamentals @ (np.eye(2) + strain))


def _model_and_moves(waves: Waves, frequencies: Array) -> tuple[Array, Array]:
    """Return the picture of the waves, ``(H, W, C)``, and its derivatives by strain and shift, ``(H, W, C, 6)``."""
    cosine, sine, mean = waves.origin_amplitudes()
    (height, width), turns = waves.spectrum.shape, 2 * np.pi * frequencies[:, np.newaxis]
    model = wave_sum(frequencies, cosine, sine, mean, (height, width))
    slopes = [
        wave_sum(frequencies, turns[..., k] * sine, -turns[..., k] * cosine, 0 * mean, (height, width)) for k in (0, 1)
    ]
    y, x = (np.arange(n) - (n - 1) / 2 for n in (height, width))
    strains = [slope * place for slope in slopes for place in (x[:, np.newaxis], y[:, np.newaxis, np.newaxis])]
    return model, np.stack([*strains, *slopes], -1)


def _smooth(planes: Array, sigma: float) -> Array:
    """Return Gaussian means around each pixel."""
    return np.asarray(
        scipy.ndimage.gaussian_filter(planes, (sigma, sigma, *[0] * (planes.ndim - 2)), mode="reflect", truncate=3)
    )


def _pixel_weights(misfit: Array, sigma: float) -> Array:
    by_channel = 1 / np.maximum((misfit**2).mean((0, 1)), 1e-12)
    around = _smooth((misfit**2 * by_channel).sum(2, keepdims=True), sigma)
    return np.asarray(by_channel / (around + MISFIT_FLOOR * np.median(around) + 1e-12))


def _weighted_lstsq(moves: Array, misfit: Array, weights: Array) -> Array:
    """Return the weighted least-squares solution, ``(6,)``."""
    flat, root = moves.reshape(-1, moves.shape[-1]), np.sqrt(weights).ravel()
    flat = flat * root[:, np.newaxis]
    matrix = flat.T @ flat
    matrix += 1e-9 * np.diag(np.diag(matrix)) + 1e-300 * np.eye(len(matrix))
    return np.asarray(np.linalg.solve(matrix, flat.T @ (misfit.ravel() * root)))
