"""The paper's own search for waves: one at a time, on the analytic signal, as if waves were complex."""

from __future__ import annotations

import numpy as np
import scipy.fft
from numpy.typing import NDArray

from nrbench.spectra.dirichlet import Array, dirichlet_kernel
from nrbench.spectra.harmonic_fit import fit_frequencies
from nrbench.spectra.noise_floor import noise_floor
from nrbench.spectra.pursuit import FoundWaves, keep_significant, power_limit
from nrbench.spectra.spectrum import Planes, Spectrum, bin_numbers

Complex = NDArray[np.complex128]

FINE_GRID = np.stack(np.meshgrid(np.linspace(-1, 1, 9), np.linspace(-1, 1, 9)), -1).reshape(-1, 2)
"""Bins around a candidate: the paper searches [-1, 1]^2, "first sampling the coefficients with a fixed step size"."""
LINE = np.linspace(-1, 1, 9)
"""Steps of one search along an axis, in units of its reach."""
REACHES = 0.25 ** np.arange(1, 7)
"""Bins: how far each pair of searches, along x and along y, reaches; the last resolves 1e-4 bin."""


def analytic_signal(planes: Planes) -> Complex:
    """Return the planes, less their means, without one of each pair of coefficients f, -f, the other doubled.

    Kept are f_x > 0, and f_y > 0 where f_x = 0; both at the Nyquist frequency of x (the Hilbert transform along x,
    after Bracewell, on the DFT). Waves between bins leak across that border, and what leaks is cut off or mirrored:
    within a few bins of f_x = 0 the signal of a real wave is not one complex wave.

    Parameters
    ----------
    planes
        ``(H, W, C)``.

    Returns
    -------
    ndarray
        ``(H, W, C)``, complex; its real part is ``planes`` less the means.
    """
    values = scipy.fft.fft2(planes - planes.mean((0, 1)), axes=(0, 1))
    ky, kx = (scipy.fft.fftfreq(n, 1 / n) for n in planes.shape[:2])
    side = np.where(kx != 0, np.sign(kx), np.sign(ky)[:, np.newaxis])
    opposite = side[-np.arange(len(ky)) % len(ky)][:, -np.arange(len(kx)) % len(kx)]
    weight = 1 + np.where(opposite == -side, side, 0)
    return np.asarray(scipy.fft.ifft2(values * weight[..., np.newaxis], axes=(0, 1)), np.complex128)


def find_waves_analytic(spectrum: Spectrum, threshold: float | None, false_alarms: float, most: int) -> FoundWaves:
    """Return the waves above a threshold as the paper finds them (section 3.1), fitted to the picture at the end.

    The bin of the analytic signal's DFT with the largest coefficient; the maximum of the fractional transform within a
    bin of it, by samples and alternating one-dimensional searches; its complex wave subtracted; until no coefficient is
    above the threshold. Only then are all frequencies fitted jointly, to the real picture.

    Parameters
    ----------
    spectrum, threshold, false_alarms, most
        As for :func:`~nrbench.spectra.pursuit.pursue`.
    """
    floor = noise_floor(np.abs(spectrum.bins()) ** 2)
    limit = power_limit(spectrum, floor, threshold, false_alarms)
    waves = fit_frequencies(spectrum, find_complex_waves(spectrum, limit, most)).waves
    return FoundWaves(keep_significant(waves, limit), floor, limit)


def find_complex_waves(spectrum: Spectrum, limit: Array, most: int) -> Array:
    """Return the frequencies of the analytic signal's waves before the joint fit, ``(n, 2)`` cycles/px, as found.

    Parameters
    ----------
    spectrum
        Of the picture.
    limit
        ``(C, H, W // 2 + 1)``: least power of a wave, see :func:`~nrbench.spectra.pursuit.power_limit`.
    most
        At most so many.
    """
    search = _Search(Spectrum(_parts(analytic_signal(spectrum.planes))))
    bins, left, limits = _bins_above(search.spectrum, limit)
    for _ in range(most):
        power = (np.abs(left) ** 2 / 4).sum(1) * (np.abs(left) ** 2 / 4 > limits).any(1)
        if not power.any():
            break
        f = search.highest(bins[np.argmax(power)])
        search.subtract(f)
        left -= search.kernel(bins / spectrum.size, f) * search.amplitudes[-1]
    return np.array(search.frequencies).reshape(-1, 2)


class _Search:
    """The waves subtracted from an analytic signal so far."""

    def __init__(self, spectrum: Spectrum) -> None:
        self.spectrum = spectrum
        self.frequencies: list[Array] = []
        self.amplitudes: list[Complex] = []

    def left(self, f: Array) -> Complex:
        """Return the transform of what is left, ``(m, C)``, at frequencies ``(m, 2)``."""
        value = _join_complex(self.spectrum.values(f))
        for g, amplitude in zip(self.frequencies, self.amplitudes, strict=True):
            value = value - self.kernel(f, g) * amplitude
        return value

    def kernel(self, f: Array, g: Array) -> Array:
        """Return the transform of a complex wave of frequency g and amplitude 1, ``(m, 1)``."""
        height, width = self.spectrum.shape
        return (dirichlet_kernel(f[:, 0] - g[0], width) * dirichlet_kernel(f[:, 1] - g[1], height))[:, np.newaxis]

    def highest(self, start: Array) -> Array:
        """Return the frequency of the maximum within a bin of a bin, cycles/px."""
        size = self.spectrum.size
        best = self._best((start + FINE_GRID) / size)
        for reach in REACHES:
            for axis in (0, 1):
                steps = np.zeros((len(LINE), 2))
                steps[:, axis] = LINE * reach / size[axis]
                best = self._best(best + steps)
        return best

    def _best(self, f: Array) -> Array:
        return np.asarray(f[np.argmax((np.abs(self.left(f)) ** 2).sum(1))])

    def subtract(self, f: Array) -> None:
        """Subtract the wave of frequency ``f`` that is left."""
        height, width = self.spectrum.shape
        amplitude = self.left(f[np.newaxis])[0] / (height * width)
        self.frequencies.append(f)
        self.amplitudes.append(amplitude)


def _bins_above(spectrum: Spectrum, limit: Array) -> tuple[Array, Complex, Array]:
    """Return the bins (x, y) above the limit, ``(m, 2)``, their coefficients and their limits, ``(m, C)`` each."""
    ky, kx = bin_numbers(spectrum.shape)
    values = _join_complex(np.moveaxis(spectrum.bins().astype(np.complex128), 0, 2))
    rows, cols = np.nonzero((np.abs(values) ** 2 / 4 > np.moveaxis(limit, 0, 2)).any(2))
    return np.stack([kx[cols], ky[rows]], 1), values[rows, cols], np.ascontiguousarray(limit[:, rows, cols].T)


def _parts(signal: Complex) -> Array:
    return np.concatenate([signal.real, signal.imag], 2)


def _join_complex(values: Complex) -> Complex:
    """Return the transform of a complex signal from those of its real and its imaginary parts."""
    count = values.shape[-1] // 2
    return np.asarray(values[..., :count] + 1j * values[..., count:])
