"""The search for the waves of a picture: bins above the noise floor start waves, which are fitted and subtracted."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
import scipy.fft
from numpy.typing import NDArray
from scipy.ndimage import median_filter

from nrbench.spectra.spectrum import Array, Complex, Planes, Spectrum, bin_numbers, dirichlet_sum
from nrbench.spectra.wave_fit import Waves, fit_frequencies

STRONG = 0.25
"""A round takes all candidates of at least this share of the strongest one's power: the highest side lobe of a wave
has 0.047 of its power, so it waits until the wave is subtracted."""
APART = 0.75
"""Bins between two waves that the picture can tell apart; of nearer ones the weaker is dropped."""
SCALLOP = 0.164
"""Share of a wave's power at the nearest bin, where it lies halfway between bins both ways: (2 / pi)^4."""
GATHERED = 0.65
"""Share of a wave's power that the four bins around it hold at least: four times :data:`SCALLOP`."""
NEAREST = 0.9
"""Share of a wave's power at the nearest of :data:`OFFSETS`, at least."""
ROUNDS = 20
TRIES = 2
"""Times a candidate may start a wave."""
OFFSETS = np.linspace(-0.75, 0.75, 7)
"""Bins from a candidate, along x and along y, at which the magnitude is sampled before it is maximized."""
GRID = np.stack(np.meshgrid(OFFSETS, OFFSETS), -1).reshape(-1, 2)
LATER_STEPS = 6
"""Steps of the joint fit after faint waves were dropped: the rest hardly move."""
CANDIDATES = 20
"""Candidates examined for each wave that may be found: those that exceed the limit most."""

FLOOR_BLOCK = 8
"""Bins a side of the blocks whose medians are taken: 64 powers give the floor to 18 %, the nine around it to 6 %."""
RING_RATIO = 1.3
"""Ratio of the radii of neighboring rings."""

ANALYTIC_GRID = np.stack(np.meshgrid(np.linspace(-1, 1, 9), np.linspace(-1, 1, 9)), -1).reshape(-1, 2)
"""Bins around a candidate: the paper searches [-1, 1]^2, "first sampling the coefficients with a fixed step size"."""
ANALYTIC_LINE = np.linspace(-1, 1, 9)
"""Steps of one search along an axis, in units of its reach."""
ANALYTIC_REACHES = 0.25 ** np.arange(1, 7)
"""Bins: how far each pair of searches, along x and along y, reaches; the last resolves 1e-4 bin."""


class Effort(NamedTuple):
    """The effort of a search for waves.

    Parameters
    ----------
    passes
        How often the threshold is set and candidates are collected, at least 1. One pass is half the work and misses
        waves that stronger ones hide.
    steps
        Steps of the final joint fit. Three bring a wave within a hundredth of a bin.
    """

    passes: int
    steps: int


THOROUGH = Effort(2, 20)
QUICK = Effort(1, 3)


@dataclass(frozen=True)
class WaveDetection:
    """The waves detected in a picture.

    Parameters
    ----------
    waves
        Fitted, in no order.
    floor
        ``(C, H, W // 2 + 1)``: mean power of the noise at the bins.
    limit
        As ``floor``: the power that a wave must reach in some channel.
    """

    waves: Waves
    floor: Array
    limit: Array

    @property
    def powers(self) -> Array:
        """The waves' powers at their maxima, ``(n, C)``."""
        return self.waves.powers

    @property
    def ratios(self) -> Array:
        """The waves' powers over the noise floor, ``(n, C)``."""
        floor = _nearest_bins(self.floor, self.waves.frequencies, self.waves.spectrum.shape)
        return self.powers / np.maximum(floor, 1e-300)


Search = Callable[[Spectrum, float | None, float, int], WaveDetection]
"""A search, called with a spectrum, a threshold, a probability of false alarms, and the largest number of waves."""


def find_waves(
    spectrum: Spectrum, threshold: float | None, false_alarms: float, most: int, effort: Effort = THOROUGH
) -> WaveDetection:
    """Return the waves above a threshold, frequencies and amplitudes fitted jointly.

    Candidates are bins of the DFT above the threshold. The strongest start a wave each, at the highest of samples
    within a bin of them. All waves are then fitted jointly, the residual is known at the candidates in closed form, and
    the next strongest follow. The paper (section 3.1) takes one at a time and fits all at the end: interference then
    shifts the weaker ones. A second pass sets the automatic threshold by the noise that the first pass left.

    Parameters
    ----------
    spectrum
        The picture's spectrum.
    threshold
        Amplitude of a wave, units of 1/255; None: automatic, see :func:`power_limit`.
    false_alarms
        Probability that noise alone yields a wave, where automatic.
    most
        The largest number of waves.
    effort
        Passes and steps.
    """
    waves = Waves(spectrum, np.zeros((0, 2)))
    for _ in range(effort.passes):
        residual = np.abs(waves.residual_bins()) ** 2
        floor = noise_floor(residual)
        limit = power_limit(spectrum, floor, threshold, false_alarms)
        waves = _add_waves(waves, residual, limit, most)
    waves = fit_frequencies(spectrum, waves.frequencies, steps=effort.steps).waves
    return WaveDetection(_keep_significant(waves, limit, effort.steps), floor, limit)


def find_waves_quickly(spectrum: Spectrum, threshold: float | None, false_alarms: float, most: int) -> WaveDetection:
    """Return the waves of a short search, see :func:`find_waves`."""
    return find_waves(spectrum, threshold, false_alarms, most, QUICK)


def power_limit(spectrum: Spectrum, floor: Array, threshold: float | None, false_alarms: float) -> Array:
    """Return the power that a wave must reach at each bin, ``(C, H, W // 2 + 1)``.

    Automatic: noise exceeds t times its mean power with probability exp(-t). The maximum over all frequencies, which
    lie denser than the bins, behaves as one over about 4 independent values a bin and channel, so that
    t = ln(4 n C / false_alarms) is exceeded anywhere with at most that probability, whatever the channels share.
    """
    height, width = spectrum.shape
    if threshold is not None:
        return np.full_like(floor, (threshold / 255 * height * width / 2) ** 2)
    numerical = 1e-12 * float(spectrum.energy.max()) * height * width
    return np.maximum(floor * math.log(2 * height * width * len(floor) / false_alarms), numerical)


def noise_floor(power: Array) -> Array:
    """Return the local mean power of a spectrum's noise, ``(C, H, W // 2 + 1)``.

    The power of a coefficient of noise is exponentially distributed about its mean, whatever the pixels' law, so the
    mean is the median over ln 2; lines, which occupy few bins, hardly move a median. The floor is the higher of two:
    the median of the blocks around a bin (for spectra with a direction) and that of its ring (for spectra steep towards
    0, where a block holds too wide a range of powers).

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
    smooth = median_filter(np.pad(medians, ((1, 1), (0, 0)), "wrap"), 3, mode="nearest")[1:-1]
    row, col = (np.arange(n) * len(blocks) // n for n, blocks in zip(power.shape, (rows, cols), strict=True))
    return np.asarray(smooth[row[:, np.newaxis], col])


def _blocks(length: int) -> NDArray[np.intp]:
    """Return the bins of each block, all of one size: neighbors share a bin where the length does not divide."""
    parts = max(length // FLOOR_BLOCK, 1)
    return np.asarray((np.arange(parts) * length // parts)[:, np.newaxis] + np.arange(length // parts))


def _ring_medians(power: Array, rings: list[NDArray[np.intp]]) -> Array:
    flat, floor = power.ravel(), np.empty(power.size)
    for ring in rings:
        floor[ring] = np.median(flat[ring])
    return floor.reshape(power.shape)


def _rings(height: int, half: int) -> list[NDArray[np.intp]]:
    """Return the flat numbers of the bins of each ring."""
    y = np.minimum(np.arange(height), height - np.arange(height))[:, np.newaxis] / height
    radius = np.hypot(y, np.arange(half) / (2 * max(half - 1, 1)))
    ring = np.floor(np.log(np.maximum(radius * height, 1)) / math.log(RING_RATIO)).astype(np.int16).ravel()
    order = np.argsort(ring, kind="stable")
    return [part for part in np.split(order, np.flatnonzero(np.diff(ring[order])) + 1) if len(part)]


def _add_waves(waves: Waves, residual: Array, limit: Array, most: int) -> Waves:
    """Return the waves and all those that start at candidates of the residual power ``(C, H, W // 2 + 1)``."""
    spectrum = waves.spectrum
    bins = _candidates(residual, limit, spectrum.shape, CANDIDATES * most)
    limits = _nearest_bins(limit, bins / spectrum.size, spectrum.shape)
    if len(bins):
        promising = (_highest_near(waves, bins)[1] >= NEAREST * limits).any(1)
        bins, limits = bins[promising], limits[promising]
    values, tries = spectrum.values(bins / spectrum.size), np.zeros(len(bins), np.intp)
    for _ in range(ROUNDS if len(bins) else 0):
        power = np.abs(values - waves.transform_at(bins / spectrum.size)) ** 2
        power[((power < SCALLOP * limits).all(1)) | (tries >= TRIES)] = 0
        chosen = _strongest(bins, power.sum(1))[: most - len(waves.frequencies)]
        if not len(chosen):
            break
        starts, powers = _highest_near(waves, bins[chosen])
        enough = (powers >= NEAREST * limits[chosen]).any(1)
        tries[chosen] += np.where(enough, 1, TRIES)
        if enough.any():
            more = np.concatenate([waves.frequencies, starts[enough]])
            waves = _drop_doubles(fit_frequencies(spectrum, more, steps=1).waves)
    return waves


def _candidates(residual: Array, limit: Array, shape: tuple[int, int], most: int) -> Array:
    """Return the bins (x, y) near which a wave may be left, ``(m, 2)``; of a pair f, -f only one."""
    ky, kx = bin_numbers(shape)
    above = residual + np.roll(residual, 1, 1)
    blocks = np.pad(above[:, :, :-1] + above[:, :, 1:], ((0, 0), (0, 0), (1, 1)))
    columns = np.maximum(blocks[:, :, :-1], blocks[:, :, 1:])
    gathered = np.maximum(columns, np.roll(columns, -1, 1))
    candidate = ((residual > SCALLOP * limit) & (gathered > GATHERED * limit)).any(0)
    candidate &= ~((ky[:, np.newaxis] < 0) & ((kx == 0) | (2 * kx == shape[1])))
    candidate[0, 0] = False
    rows, cols = np.nonzero(candidate)
    excess = (gathered[:, rows, cols] / limit[:, rows, cols]).max(0)
    strongest = np.sort(np.argsort(-excess, kind="stable")[:most])
    return np.stack([kx[cols], ky[rows]], 1)[strongest]


def _strongest(bins: Array, power: Array) -> NDArray[np.intp]:
    """Return which candidates start a wave: strong ones, none within two bins of a stronger one."""
    order = np.argsort(-power, kind="stable")
    order = order[power[order] >= max(STRONG * float(power.max(initial=0)), 1e-300)]
    kept: list[int] = []
    for k in order:
        if not kept or np.abs(bins[kept] - bins[k]).max(1).min() > 2:
            kept.append(int(k))
    return np.array(kept, np.intp)


def _highest_near(waves: Waves, bins: Array) -> tuple[Array, Array]:
    """Return, for each bin, the frequency of the highest residual within a bin of it, and its power ``(m, C)``."""
    spectrum, size = waves.spectrum, waves.spectrum.size
    residual = spectrum.around(bins / size, OFFSETS) - waves.transform_around(bins / size, OFFSETS)
    power = (np.abs(residual) ** 2).reshape(len(bins), -1, spectrum.channels)
    best = power.sum(2).argmax(1)
    return (bins + GRID[best]) / size, np.asarray(power[np.arange(len(bins)), best])


def _drop_doubles(waves: Waves) -> Waves:
    """Return the waves without those that cannot be told from a stronger one or from the mean."""
    size, f = waves.spectrum.size, waves.frequencies
    power = waves.powers.sum(1)
    near = (np.hypot(*np.moveaxis((f[:, np.newaxis] - f) * size, 2, 0)) < APART) | (
        np.hypot(*np.moveaxis((f[:, np.newaxis] + f) * size, 2, 0)) < APART
    )
    weaker = (near & (power[:, np.newaxis] < power)).any(1) | (np.hypot(*(f * size).T) < APART / 2)
    return Waves(waves.spectrum, f[~weaker]) if weaker.any() else waves


def _keep_significant(waves: Waves, limit: Array, steps: int = THOROUGH.steps) -> Waves:
    """Return the waves that reach the limit ``(C, H, W // 2 + 1)`` once all are fitted, the rest fitted again."""
    waves = _drop_doubles(waves)
    while len(waves.frequencies):
        enough = (waves.powers >= _nearest_bins(limit, waves.frequencies, waves.spectrum.shape)).any(1)
        if enough.all():
            break
        fit = fit_frequencies(waves.spectrum, waves.frequencies[enough], steps=min(steps, LATER_STEPS))
        waves = _drop_doubles(fit.waves)
    return waves


def _nearest_bins(grid: Array, frequencies: Array, shape: tuple[int, int]) -> Array:
    """Return a grid ``(C, H, W // 2 + 1)`` at the bins nearest to frequencies ``(n, 2)``, as ``(n, C)``."""
    f = np.where(frequencies[:, :1] < 0, -frequencies, frequencies)
    cols = np.minimum(np.rint(f[:, 0] * shape[1]).astype(np.intp), grid.shape[2] - 1)
    return np.asarray(grid[:, np.rint(f[:, 1] * shape[0]).astype(np.intp) % shape[0], cols].T)


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


def find_waves_analytic(spectrum: Spectrum, threshold: float | None, false_alarms: float, most: int) -> WaveDetection:
    """Return the waves above a threshold as the paper finds them (section 3.1), fitted to the picture at the end.

    Each step takes the bin of the analytic signal's DFT with the largest coefficient, maximizes the fractional
    transform within a bin of it, by samples and alternating one-dimensional searches, and subtracts that complex wave,
    until no coefficient is above the threshold. Only then are all frequencies fitted jointly, to the real picture.

    Parameters
    ----------
    spectrum, threshold, false_alarms, most
        As for :func:`find_waves`.
    """
    floor = noise_floor(np.abs(spectrum.bins()) ** 2)
    limit = power_limit(spectrum, floor, threshold, false_alarms)
    waves = fit_frequencies(spectrum, find_complex_waves(spectrum, limit, most)).waves
    return WaveDetection(_keep_significant(waves, limit), floor, limit)


def find_complex_waves(spectrum: Spectrum, limit: Array, most: int) -> Array:
    """Return the frequencies of the analytic signal's waves before the joint fit, ``(n, 2)`` cycles/px, in order.

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
    values = _join_parts(np.moveaxis(search.spectrum.bins().astype(np.complex128), 0, 2))
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
        """Return the transform of the signal less the waves, ``(m, C)``, at frequencies ``(m, 2)``."""
        value = _join_parts(self.spectrum.values(f))
        for g, amplitude in zip(self.frequencies, self.amplitudes, strict=True):
            value = value - self.kernel(f, g) * amplitude
        return value

    def kernel(self, f: Array, g: Array) -> Array:
        """Return the transform of a complex wave of frequency g and amplitude 1, ``(m, 1)``."""
        height, width = self.spectrum.shape
        return (dirichlet_sum(f[:, 0] - g[0], width) * dirichlet_sum(f[:, 1] - g[1], height))[:, np.newaxis]

    def maximize(self, start: Array) -> Array:
        """Return the frequency of the maximum within a bin of a bin, cycles/px."""
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
