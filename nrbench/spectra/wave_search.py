"""The search for the waves of a picture: bins above the noise floor start waves, which are fitted and subtracted."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
import scipy
from numpy.typing import NDArray

from nrbench.spectra.spectrum import Array, Complex, Planes, Spectrum, bin_numbers, dirichlet_sum
from nrbench.spectra.wave_fit import Waves, fit_frequencies

ROUND_SHARE = 0.25
"""Least power of the candidates of a round, as a share of the strongest one's. The highest side lobe of a wave has
0.047 of its power, so that it is no candidate before the wave is subtracted."""
APART = 0.75
"""Bins: least distance of two waves. Of two nearer waves, the weaker one is dropped."""
SCALLOP = 0.164
"""Share of a wave's power at the nearest bin if it lies halfway between bins along both axes: (2 / pi)^4."""
GATHERED_SHARE = 0.65
"""Least share of a wave's power in the four bins around it: four times :data:`SCALLOP`."""
NEAREST_SHARE = 0.9
"""Least share of a wave's power at the nearest of :data:`OFFSETS`."""
ROUNDS = 20
TRIES = 2
"""Number of times that a candidate may start a wave."""
OFFSETS = np.linspace(-0.75, 0.75, 7)
"""Bins from a candidate, along x and along y, at which the magnitude is sampled before it is maximized."""
GRID = np.stack(np.meshgrid(OFFSETS, OFFSETS), -1).reshape(-1, 2)
STEPS, QUICK_STEPS = 20, 3
"""Number of steps of the final joint fit. After three steps the error of a frequency is a hundredth of a bin."""
LATER_STEPS = 6
"""Number of steps of the joint fit after faint waves are dropped; the other waves hardly change."""
CANDIDATES = 20
"""Number of candidates that are examined, over the largest number of waves: those that exceed the limit most."""

FLOOR_BLOCK = 8
"""Side, in bins, of the blocks whose medians are computed. The error of the floor is 18 % from the 64 powers of one
block, 6 % from nine blocks."""
RING_RATIO = 1.3
"""Ratio of the radii of neighboring rings."""

ANALYTIC_GRID = np.stack(np.meshgrid(np.linspace(-1, 1, 9), np.linspace(-1, 1, 9)), -1).reshape(-1, 2)
"""Bins around a candidate: the paper searches [-1, 1]^2, "first sampling the coefficients with a fixed step size"."""
ANALYTIC_LINE = np.linspace(-1, 1, 9)
"""Steps of one search along an axis, in units of its reach."""
ANALYTIC_REACHES = 0.25 ** np.arange(1, 7)
"""Bins: the reach of each pair of searches along x and along y; the last one resolves 1e-4 bin."""


@dataclass(frozen=True)
class WaveDetection:
    """The waves detected in a picture.

    Parameters
    ----------
    waves
        The fitted waves, in no particular order.
    floor
        ``(C, H, W // 2 + 1)``: mean power of the noise at the bins.
    limit
        As ``floor``: the power that a wave must reach in some channel.
    """

    waves: Waves
    floor: Array
    limit: Array

    @property
    def ratios(self) -> Array:
        """The waves' powers over the noise floor, ``(n, C)``."""
        floor = _nearest_bins(self.floor, self.waves.frequencies, self.waves.spectrum.shape)
        return self.waves.powers / np.maximum(floor, 1e-300)


def find_waves(
    spectrum: Spectrum, threshold: float | None, false_alarms: float, most: int, quick: bool = False
) -> WaveDetection:
    """Find the waves above a threshold; frequencies and amplitudes are fitted jointly.

    Candidates are bins of the DFT above the threshold. Each of the strongest candidates starts a wave, at the highest
    of several samples within a bin of it. All waves are then fitted jointly, the residual is computed at the candidates
    in closed form, and the next strongest candidates follow. The paper (section 3.1) adds one wave at a time and fits
    all waves at the end, so that interference shifts the weaker ones. A second pass computes the automatic threshold
    from the residual of the first.

    Parameters
    ----------
    spectrum
        The picture's spectrum.
    threshold
        Amplitude of a wave, units of 1/255; None: automatic, see :func:`power_limit`.
    false_alarms
        Probability that noise alone yields a wave, for the automatic threshold.
    most
        The largest number of waves.
    quick
        Set the threshold and collect candidates once instead of twice, and make few steps of the final joint fit: half
        the time, but waves next to stronger ones are missed.
    """
    passes, steps = (1, QUICK_STEPS) if quick else (2, STEPS)
    waves = Waves(spectrum, np.zeros((0, 2)))
    for _ in range(passes):
        residual = np.abs(waves.residual_bins()) ** 2
        floor = noise_floor(residual)
        limit = power_limit(spectrum, floor, threshold, false_alarms)
        waves = _add_waves(waves, residual, limit, most)
    waves = fit_frequencies(spectrum, waves.frequencies, steps=steps).waves
    return WaveDetection(_keep_significant(waves, limit, steps), floor, limit)


def power_limit(spectrum: Spectrum, floor: Array, threshold: float | None, false_alarms: float) -> Array:
    """Return the power that a wave must reach at each bin, ``(C, H, W // 2 + 1)``.

    Without a threshold, the limit is t times the mean power of the noise. Noise exceeds it at a frequency with
    probability exp(-t). The maximum over all frequencies, not only the bins, behaves like that over about 4 independent
    values per bin and channel. With t = ln(4 n C / false_alarms), noise exceeds the limit anywhere with at most
    probability ``false_alarms``, even if channels are correlated.
    """
    height, width = spectrum.shape
    if threshold is not None:
        return np.full_like(floor, (threshold / 255 * height * width / 2) ** 2)
    numerical = 1e-12 * float(spectrum.energy.max()) * height * width
    return np.maximum(floor * math.log(2 * height * width * len(floor) / false_alarms), numerical)


def noise_floor(power: Array) -> Array:
    """Return the local mean power of a spectrum's noise, ``(C, H, W // 2 + 1)``.

    The power of a coefficient of noise is exponentially distributed for any distribution of the pixels, so the mean is
    the median divided by ln 2. Spectral lines occupy few bins and hardly change a median. The floor is the higher of
    two: the median of the blocks around a bin (for spectra that depend on the direction), and the median of its ring
    (for spectra that are steep near 0, where the powers in a block differ too much).

    Parameters
    ----------
    power
        ``(C, H, W // 2 + 1)``: squared magnitudes in the order of ``rfft2``.
    """
    rings = _rings(power.shape[1], power.shape[2])
    return np.stack([np.maximum(_block_medians(plane), _ring_medians(plane, rings)) for plane in power]) / math.log(2)


def _block_medians(power: Array) -> Array:
    rows, cols = (_blocks(n) for n in power.shape)
    inside = power[rows[:, np.newaxis, :, np.newaxis], cols[:, np.newaxis, :]]
    medians = np.median(inside.reshape(len(rows), len(cols), -1), 2)
    smooth = scipy.ndimage.median_filter(np.pad(medians, ((1, 1), (0, 0)), "wrap"), 3, mode="nearest")[1:-1]
    row, col = (np.arange(n) * len(blocks) // n for n, blocks in zip(power.shape, (rows, cols), strict=True))
    return np.asarray(smooth[row[:, np.newaxis], col])


def _blocks(length: int) -> NDArray[np.intp]:
    """Return the bins of each block. All blocks have the same size."""
    parts = max(length // FLOOR_BLOCK, 1)
    return np.asarray((np.arange(parts) * length // parts)[:, np.newaxis] + np.arange(length // parts))


def _ring_medians(power: Array, rings: list[NDArray[np.intp]]) -> Array:
    flat, floor = power.ravel(), np.empty(power.size)
    for ring in rings:
        floor[ring] = np.median(flat[ring])
    return floor.reshape(power.shape)


def _rings(height: int, half: int) -> list[NDArray[np.intp]]:
    """Return the flat indices of the bins of each ring."""
    y = np.minimum(np.arange(height), height - np.arange(height))[:, np.newaxis] / height
    radius = np.hypot(y, np.arange(half) / (2 * max(half - 1, 1)))
    ring = np.floor(np.log(np.maximum(radius * height, 1)) / math.log(RING_RATIO)).astype(np.int16).ravel()
    order = np.argsort(ring, kind="stable")
    return [part for part in np.split(order, np.flatnonzero(np.diff(ring[order])) + 1) if len(part)]


def _add_waves(waves: Waves, residual: Array, limit: Array, most: int) -> Waves:
    """Return the waves and further ones that start at candidates of the residual power ``(C, H, W // 2 + 1)``."""
    spectrum = waves.spectrum
    bins = _candidates(residual, limit, spectrum.shape, CANDIDATES * most)
    limits = _nearest_bins(limit, bins / spectrum.size, spectrum.shape)
    if len(bins):
        promising = (_highest_near(waves, bins)[1] >= NEAREST_SHARE * limits).any(1)
        bins, limits = bins[promising], limits[promising]
    values, tries = spectrum.values(bins / spectrum.size), np.zeros(len(bins), np.intp)
    for _ in range(ROUNDS if len(bins) else 0):
        power = np.abs(values - waves.transform_at(bins / spectrum.size)) ** 2
        power[((power < SCALLOP * limits).all(1)) | (tries >= TRIES)] = 0
        chosen = _strongest(bins, power.sum(1))[: most - len(waves.frequencies)]
        if not len(chosen):
            break
        starts, powers = _highest_near(waves, bins[chosen])
        enough = (powers >= NEAREST_SHARE * limits[chosen]).any(1)
        tries[chosen] += np.where(enough, 1, TRIES)
        if enough.any():
            more = np.concatenate([waves.frequencies, starts[enough]])
            waves = _drop_doubles(fit_frequencies(spectrum, more, steps=1).waves)
    return waves


def _candidates(residual: Array, limit: Array, shape: tuple[int, int], most: int) -> Array:
    """Return the bins (x, y) near which a wave may remain, ``(m, 2)``; of a pair f, -f only one."""
    ky, kx = bin_numbers(shape)
    above = residual + np.roll(residual, 1, 1)
    blocks = np.pad(above[:, :, :-1] + above[:, :, 1:], ((0, 0), (0, 0), (1, 1)))
    columns = np.maximum(blocks[:, :, :-1], blocks[:, :, 1:])
    gathered = np.maximum(columns, np.roll(columns, -1, 1))
    candidate = ((residual > SCALLOP * limit) & (gathered > GATHERED_SHARE * limit)).any(0)
    candidate &= ~((ky[:, np.newaxis] < 0) & ((kx == 0) | (2 * kx == shape[1])))
    candidate[0, 0] = False
    rows, cols = np.nonzero(candidate)
    excess = (gathered[:, rows, cols] / limit[:, rows, cols]).max(0)
    strongest = np.sort(np.argsort(-excess, kind="stable")[:most])
    return np.stack([kx[cols], ky[rows]], 1)[strongest]


def _strongest(bins: Array, power: Array) -> NDArray[np.intp]:
    """Return the indices of the strong candidates that have no stronger candidate within two bins."""
    order = np.argsort(-power, kind="stable")
    order = order[power[order] >= max(ROUND_SHARE * float(power.max(initial=0)), 1e-300)]
    kept: list[int] = []
    for k in order:
        if not kept or np.abs(bins[kept] - bins[k]).max(1).min() > 2:
            kept.append(int(k))
    return np.array(kept, np.intp)


def _highest_near(waves: Waves, bins: Array) -> tuple[Array, Array]:
    """Return the frequency of the highest residual within a bin of each given bin, and its power ``(m, C)``."""
    spectrum, size = waves.spectrum, waves.spectrum.size
    residual = spectrum.around(bins / size, OFFSETS) - waves.transform_around(bins / size, OFFSETS)
    power = (np.abs(residual) ** 2).reshape(len(bins), -1, spectrum.channels)
    best = power.sum(2).argmax(1)
    return (bins + GRID[best]) / size, np.asarray(power[np.arange(len(bins)), best])


def _drop_doubles(waves: Waves) -> Waves:
    """Return the waves without those that are too near to a stronger wave or to frequency 0."""
    size, f = waves.spectrum.size, waves.frequencies
    power = waves.powers.sum(1)
    near = (np.hypot(*np.moveaxis((f[:, np.newaxis] - f) * size, 2, 0)) < APART) | (
        np.hypot(*np.moveaxis((f[:, np.newaxis] + f) * size, 2, 0)) < APART
    )
    weaker = (near & (power[:, np.newaxis] < power)).any(1) | (np.hypot(*(f * size).T) < APART / 2)
    return Waves(waves.spectrum, f[~weaker]) if weaker.any() else waves


def _keep_significant(waves: Waves, limit: Array, steps: int = STEPS) -> Waves:
    """Fit all waves, drop those below the limit ``(C, H, W // 2 + 1)``, and fit the others again."""
    waves = _drop_doubles(waves)
    while len(waves.frequencies):
        enough = (waves.powers >= _nearest_bins(limit, waves.frequencies, waves.spectrum.shape)).any(1)
        if enough.all():
            break
        fit = fit_frequencies(waves.spectrum, waves.frequencies[enough], steps=min(steps, LATER_STEPS))
        waves = _drop_doubles(fit.waves)
    return waves


def _nearest_bins(grid: Array, frequencies: Array, shape: tuple[int, int]) -> Array:
    """Return the values of a grid ``(C, H, W // 2 + 1)`` at the bins nearest to frequencies ``(n, 2)``: ``(n, C)``."""
    f = np.where(frequencies[:, :1] < 0, -frequencies, frequencies)
    cols = np.minimum(np.rint(f[:, 0] * shape[1]).astype(np.intp), grid.shape[2] - 1)
    return np.asarray(grid[:, np.rint(f[:, 1] * shape[0]).astype(np.intp) % shape[0], cols].T)


def analytic_signal(planes: Planes) -> Complex:
    """Return the analytic signal: one coefficient of each pair f, -f of the planes is doubled, the other is set to 0.

    The means are removed. Coefficients with f_x > 0 are kept, those with f_y > 0 if f_x = 0, and both at the Nyquist
    frequency of x (the Hilbert transform along x, after Bracewell, on the DFT). Waves between bins leak across the
    border f_x = 0, where the leakage is cut off or mirrored. Within a few bins of this border the signal of a real wave
    is therefore not a single complex wave.

    Parameters
    ----------
    planes
        ``(H, W, C)``.

    Returns
    -------
    ndarray
        ``(H, W, C)``, complex; its real part is ``planes`` minus the means.
    """
    values = scipy.fft.fft2(planes - planes.mean((0, 1)), axes=(0, 1))
    ky, kx = (scipy.fft.fftfreq(n, 1 / n) for n in planes.shape[:2])
    side = np.where(kx != 0, np.sign(kx), np.sign(ky)[:, np.newaxis])
    opposite = side[-np.arange(len(ky)) % len(ky)][:, -np.arange(len(kx)) % len(kx)]
    weight = 1 + np.where(opposite == -side, side, 0)
    return np.asarray(scipy.fft.ifft2(values * weight[..., np.newaxis], axes=(0, 1)), np.complex128)


def find_waves_analytic(spectrum: Spectrum, threshold: float | None, false_alarms: float, most: int) -> WaveDetection:
    """Find the waves above a threshold by the method of the paper (section 3.1).

    Each step takes the largest coefficient of the analytic signal's DFT, maximizes the fractional transform within a
    bin of it, by samples and alternating one-dimensional searches, and subtracts that complex wave. The steps end when
    no coefficient is above the threshold. All frequencies are then fitted jointly to the real picture.

    Parameters
    ----------
    spectrum, threshold, false_alarms, most
        As for :func:`find_waves`.
    """
    floor = noise_floor(np.abs(spectrum.bins) ** 2)
    limit = power_limit(spectrum, floor, threshold, false_alarms)
    waves = fit_frequencies(spectrum, find_complex_waves(spectrum, limit, most)).waves
    return WaveDetection(_keep_significant(waves, limit), floor, limit)


def find_complex_waves(spectrum: Spectrum, limit: Array, most: int) -> Array:
    """Return the frequencies of the analytic signal's waves, in the order of the search, ``(n, 2)`` cycles/px.

    Parameters
    ----------
    spectrum
        The picture's spectrum.
    limit
        ``(C, H, W // 2 + 1)``: least power of a wave, see :func:`power_limit`.
    most
        The largest number of waves.
    """
    search = _AnalyticSearch(spectrum)
    ky, kx = bin_numbers(spectrum.shape)
    values = _join_parts(np.moveaxis(search.spectrum.bins.astype(np.complex128), 0, 2))
    rows, cols = np.nonzero((np.abs(values) ** 2 / 4 > np.moveaxis(limit, 0, 2)).any(2))
    bins, residual = np.stack([kx[cols], ky[rows]], 1), values[rows, cols]
    limits = np.ascontiguousarray(limit[:, rows, cols].T)
    for _ in range(most):
        power = (np.abs(residual) ** 2 / 4).sum(1) * (np.abs(residual) ** 2 / 4 > limits).any(1)
        if not power.any():
            break
        f = search.maximize(bins[np.argmax(power)])
        search.subtract(f)
        residual -= search.kernel(bins / spectrum.size, f) * search.amplitudes[-1]
    return np.array(search.frequencies).reshape(-1, 2)


class _AnalyticSearch:
    """The waves subtracted so far from the analytic signal of a picture."""

    def __init__(self, spectrum: Spectrum) -> None:
        signal = analytic_signal(spectrum.planes)
        self.spectrum = Spectrum(np.concatenate([signal.real, signal.imag], 2))
        self.frequencies: list[Array] = []
        self.amplitudes: list[Complex] = []

    def residual(self, f: Array) -> Complex:
        """Return the transform of the signal minus the waves, ``(m, C)``, at frequencies ``(m, 2)``."""
        value = _join_parts(self.spectrum.values(f))
        for g, amplitude in zip(self.frequencies, self.amplitudes, strict=True):
            value = value - self.kernel(f, g) * amplitude
        return value

    def kernel(self, f: Array, g: Array) -> Array:
        """Return the transform of a complex wave of frequency g and amplitude 1, ``(m, 1)``."""
        height, width = self.spectrum.shape
        return (dirichlet_sum(f[:, 0] - g[0], width) * dirichlet_sum(f[:, 1] - g[1], height))[:, np.newaxis]

    def maximize(self, start: Array) -> Array:
        """Return the frequency of the maximum within a bin of ``start``, cycles/px."""
        size = self.spectrum.size
        best = self._best((start + ANALYTIC_GRID) / size)
        for reach in ANALYTIC_REACHES:
            for axis in (0, 1):
                steps = np.zeros((len(ANALYTIC_LINE), 2))
                steps[:, axis] = ANALYTIC_LINE * reach / size[axis]
                best = self._best(best + steps)
        return best

    def _best(self, f: Array) -> Array:
        return np.asarray(f[np.argmax((np.abs(self.residual(f)) ** 2).sum(1))])

    def subtract(self, f: Array) -> None:
        """Subtract the residual wave of frequency ``f``."""
        height, width = self.spectrum.shape
        amplitude = self.residual(f[np.newaxis])[0] / (height * width)
        self.frequencies.append(f)
        self.amplitudes.append(amplitude)


def _join_parts(values: Complex) -> Complex:
    """Return the transform of a complex signal from those of its real and its imaginary parts."""
    count = values.shape[-1] // 2
    return np.asarray(values[..., :count] + 1j * values[..., count:])
