"""Least squares of waves in a picture, in closed form: amplitudes, frequencies, fundamentals of tied frequencies."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from nrbench.spectra.dirichlet import Array, DirichletKernel, dirichlet_kernel, pair_kernels
from nrbench.spectra.spectrum import Spectrum, bin_numbers

LONGEST_STEP = 0.25
"""Bins that a frequency may move in one step: the fit is nearly quadratic within a quarter of the main lobe."""
RIDGE = 1e-9
"""Of the number of px, added to the diagonals: waves that coincide then share an amplitude."""


@dataclass(frozen=True)
class Waves:
    """Waves of given frequencies on a picture, and all inner products that their least squares needs.

    With coordinates from the picture's centre, cosines are orthogonal to sines, whatever the frequencies: two small
    systems instead of one, every entry a Dirichlet kernel at the difference and at the sum of two frequencies. A wave
    of frequency 0 stands for the mean. n waves cost O(n^3), whatever the picture's size.

    Parameters
    ----------
    spectrum
        Of the picture.
    frequencies
        ``(n, 2)`` cycles/px; 0 is put before the first.
    """

    spectrum: Spectrum
    frequencies: Array

    @cached_property
    def _all(self) -> Array:
        return np.concatenate([np.zeros((1, 2)), self.frequencies])

    @cached_property
    def _kernels(self) -> tuple[DirichletKernel, DirichletKernel]:
        """The kernels at the differences and the sums, each ``(1 + n, 1 + n)``."""
        return pair_kernels(self._all, self.spectrum.shape)

    @cached_property
    def _grams(self) -> tuple[Array, Array]:
        """The inner products of cosines and those of sines, ``(1 + n, 1 + n)`` each."""
        apart, together = (kernel.value for kernel in self._kernels)
        ridge = RIDGE * apart[0, 0] * np.eye(len(apart))
        cosines, sines = (apart + together) / 2 + ridge, (apart - together) / 2 + ridge
        return cosines, sines

    @cached_property
    def _transforms(self) -> tuple[NDArray[np.complex128], NDArray[np.complex128]]:
        return self.spectrum.at(self._all)

    @cached_property
    def amplitudes(self) -> tuple[Array, Array]:
        """The best amplitudes of cosines and sines about the centre, ``(1 + n, C)`` each; row 0 is the mean's."""
        value = self._transforms[0]
        p, q = np.linalg.solve(self._grams[0], value.real), np.linalg.solve(self._grams[1], -value.imag)
        return np.asarray(p, np.float64), np.asarray(q, np.float64)

    @cached_property
    def explained(self) -> Array:
        """The energy that the waves explain, ``(C,)``."""
        value, (p, q) = self._transforms[0], self.amplitudes
        return np.asarray((p * value.real - q * value.imag).sum(0))

    def residual(self, frequencies: Array) -> NDArray[np.complex128]:
        """Return the transform of what the waves leave, ``(m, C)``, at frequencies ``(m, 2)``."""
        return np.asarray(self.spectrum.values(frequencies) - self.modelled(frequencies))

    def modelled(self, frequencies: Array) -> NDArray[np.complex128]:
        """Return the transform of the waves, ``(m, C)``, at frequencies ``(m, 2)``; best on a grid."""
        (p, q), both = self.amplitudes, np.concatenate([self._all, -self._all])
        weights, factors = np.concatenate([p - 1j * q, p + 1j * q]) / 2, []
        for axis, length in enumerate(self.spectrum.shape[::-1]):
            distinct, which = np.unique(frequencies[:, axis], return_inverse=True)
            factors.append(dirichlet_kernel(distinct[:, np.newaxis] - both[:, axis], length)[which])
        real = (factors[0] * factors[1]) @ np.concatenate([weights.real, weights.imag], 1)
        return np.asarray(real[:, : weights.shape[1]] + 1j * real[:, weights.shape[1] :])

    def modelled_around(self, frequencies: Array, offsets: Array) -> NDArray[np.complex128]:
        """Return the transform of the waves on a small grid about each frequency, ``(m, k, k, C)``, y before x.

        Parameters
        ----------
        frequencies
            ``(m, 2)`` cycles/px.
        offsets
            ``(k,)`` bins along either axis.
        """
        (p, q), both = self.amplitudes, np.concatenate([self._all, -self._all])
        weights, factors = np.concatenate([p - 1j * q, p + 1j * q]).T / 2, []
        for axis, length in enumerate(self.spectrum.shape[::-1]):
            distinct, which = np.unique(frequencies[:, axis, np.newaxis] + offsets / length, return_inverse=True)
            table = dirichlet_kernel(distinct[:, np.newaxis] - both[:, axis], length)
            factors.append((table, which.reshape(-1, len(offsets))))
        (x, columns), (y, rows) = factors
        parts = np.concatenate([weights.real, weights.imag])[:, np.newaxis]
        found = np.empty((len(frequencies), len(parts), len(offsets), len(offsets)))
        for k in range(len(frequencies)):
            np.matmul(y[rows[k]], (x[columns[k]] * parts).transpose(0, 2, 1), out=found[k])
        channels = len(weights)
        return np.moveaxis(found[:, :channels] + 1j * found[:, channels:], 1, 3)

    def residual_bins(self) -> NDArray[np.complex128]:
        """Return the transform of what the waves leave at whole bins, ``(C, H, W // 2 + 1)``: two matrix products."""
        (p, q), (height, width) = self.amplitudes, self.spectrum.shape
        ky, kx = (k[:, np.newaxis] / n for k, n in zip(bin_numbers((height, width)), (height, width), strict=True))
        both = np.concatenate([self._all, -self._all])
        rows, cols = dirichlet_kernel(ky - both[:, 1], height), dirichlet_kernel(kx - both[:, 0], width)
        weights = np.concatenate([p - 1j * q, p + 1j * q]) / 2
        modelled = [((rows * w.real) @ cols.T) + 1j * ((rows * w.imag) @ cols.T) for w in weights.T]
        return np.asarray(self.spectrum.bins() - np.stack(modelled))

    @cached_property
    def normal(self) -> tuple[Array, Array]:
        """The normal equations of the frequencies with the amplitudes eliminated, all waves weighted alike."""
        return self.weighted_normal(np.ones((len(self.frequencies), 1)))

    def weighted_normal(self, weights: Array) -> tuple[Array, Array]:
        """Return the normal equations of the frequencies with the amplitudes eliminated (variable projection).

        Parameters
        ----------
        weights
            ``(n, C)`` or ``(n, 1)``: how much each wave counts, the inverse of the noise's power where it is.

        Returns
        -------
        tuple
            The matrix ``(n, 2, n, 2)`` and the right side ``(n, 2)``, for steps in cycles/px.
        """
        (p, q), (cosines, sines) = self.amplitudes, self._grams
        root = np.sqrt(np.pad(weights, ((1, 0), (0, 0))))
        apart, together = self._kernels
        crossing = (together.slope - apart.slope) / 2, -(together.slope + apart.slope) / 2
        sine_bend, cosine_bend = (together.curvature - apart.curvature) / 2, -(together.curvature + apart.curvature) / 2
        matrix = _projected(sine_bend, crossing[0], cosines, p * root)
        matrix += _projected(cosine_bend, crossing[1], sines, q * root)
        by_sine = -self._transforms[1].imag * 2 * np.pi + np.einsum("ajk,jc->akc", crossing[0], p)
        by_cosine = self._transforms[1].real * 2 * np.pi - np.einsum("ajk,jc->akc", crossing[1], q)
        right = ((-p * by_sine + q * by_cosine) * root**2).sum(2)
        return np.ascontiguousarray(np.transpose(matrix, (2, 0, 3, 1))[1:, :, 1:]), np.ascontiguousarray(right.T[1:])


@dataclass(frozen=True)
class FixedWaves(Waves):
    """The same, where only amplitudes are asked for: sums over rows and columns replace the kernels' closed forms.

    Four matrix products of n x width and n x height numbers: for hundreds of waves a tenth of the kernels' time.
    """

    @cached_property
    def _grams(self) -> tuple[Array, Array]:
        apart, together = np.ones((2, len(self._all), len(self._all)))
        for f, length in zip(self._all.T, self.spectrum.shape[::-1], strict=True):
            angles = 2 * np.pi * np.outer(f, np.arange(length) - (length - 1) / 2)
            cosine, sine = np.cos(angles), np.sin(angles)
            cosines, sines = cosine @ cosine.T, sine @ sine.T
            apart, together = apart * (cosines + sines), together * (cosines - sines)
        ridge = RIDGE * apart[0, 0] * np.eye(len(apart))
        return (apart + together) / 2 + ridge, (apart - together) / 2 + ridge


def _projected(bend: Array, crossing: Array, gram: Array, amplitudes: Array) -> Array:
    """Return the slopes' inner products, weighted by the amplitudes, less what the waves themselves explain of them."""
    n = len(gram)
    flat = np.concatenate(list(crossing), 1)
    shared = (flat.T @ np.linalg.solve(gram, flat)).reshape(2, n, 2, n).transpose(0, 2, 1, 3)
    return np.asarray((bend - shared) * (amplitudes @ amplitudes.T))


class FrequencyFit(NamedTuple):
    """Waves whose frequencies are whole combinations of fundamentals.

    Parameters
    ----------
    fundamentals
        ``(g, 2)`` cycles/px.
    waves
        At ``orders @ fundamentals``.
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
        Of the picture.
    fundamentals
        ``(g, 2)`` cycles/px: where to start; the frequencies should be right within half a bin.
    orders
        ``(n, g)`` whole numbers: the frequencies are ``orders @ fundamentals``. None: each is its own fundamental.
    steps
        At most so many.
    weights
        ``(n, C)``: how much each wave counts where noise is not alike at all: the inverse of its power there. None: 1.
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
    matrix, right = fit.waves.normal if weights is None else fit.waves.weighted_normal(weights)
    g = orders.shape[1]
    half = np.tensordot(orders, matrix, (0, 0))
    small = np.tensordot(half, orders, (2, 0)).transpose(0, 1, 3, 2).reshape(2 * g, 2 * g)
    diagonal = np.diag(small).copy()
    small = small + np.diag(damping * diagonal + 1e-12 * max(float(diagonal.max()), 1e-300))
    return np.asarray(np.linalg.solve(small, (orders.T @ right).ravel()).reshape(g, 2))
