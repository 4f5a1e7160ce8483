"""The search for the waves of a picture: candidates above a threshold, fitted, subtracted, until none is left."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from nrbench.spectra.dirichlet import Array
from nrbench.spectra.harmonic_fit import Waves, fit_frequencies
from nrbench.spectra.noise_floor import noise_floor
from nrbench.spectra.spectrum import Spectrum, bin_numbers

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
"""As :data:`SCALLOP`, at the nearest of :data:`OFFSETS`."""
ROUNDS = 20
TRIES = 2
"""Times a candidate may start a wave."""
OFFSETS = np.linspace(-0.75, 0.75, 7)
"""Bins from a candidate, along x and along y, at which the magnitude is sampled before it is maximized."""
GRID = np.stack(np.meshgrid(OFFSETS, OFFSETS), -1).reshape(-1, 2)
SETTLED = 6
"""Steps of the joint fit after faint waves were dropped: the rest hardly move."""
WATCHED = 20
"""Candidates looked at, for each wave that may be found: the strongest against the limit."""


class Effort(NamedTuple):
    """How hard a search for waves is.

    Parameters
    ----------
    passes
        How often the threshold is set and candidates are looked for, at least 1. One is half the work and misses waves
        that stronger ones hide.
    steps
        Of the final joint fit. Three bring a wave within a hundredth of a bin.
    """

    passes: int
    steps: int


THOROUGH = Effort(2, 20)
QUICK = Effort(1, 3)


@dataclass(frozen=True)
class FoundWaves:
    """The waves of a picture.

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

    def at_bins(self, frequencies: Array, grid: Array) -> Array:
        """Return ``grid`` at the bins nearest to frequencies ``(n, 2)``, as ``(n, C)``."""
        return _lookup(grid, frequencies, self.waves.spectrum.shape)

    @property
    def powers(self) -> Array:
        """The waves' powers at their maxima, ``(n, C)``: what |FT|^2 of each alone is."""
        return wave_powers(self.waves)

    @property
    def ratios(self) -> Array:
        """The waves' powers over the noise floor, ``(n, C)``."""
        return self.powers / np.maximum(self.at_bins(self.waves.frequencies, self.floor), 1e-300)


def wave_powers(waves: Waves) -> Array:
    """Return |FT|^2 of each wave alone at its frequency, ``(n, C)``."""
    p, q = waves.amplitudes
    height, width = waves.spectrum.shape
    return np.asarray((p[1:] ** 2 + q[1:] ** 2) * (height * width / 2) ** 2)


def find_waves(
    spectrum: Spectrum, threshold: float | None, false_alarms: float, most: int, effort: Effort = THOROUGH
) -> FoundWaves:
    """Return the waves above a threshold, frequencies and amplitudes fitted jointly.

    Candidates are bins of the DFT above the threshold. The strongest start a wave each, at the highest of samples
    within a bin of them; all waves are then fitted jointly, what they leave is known at the candidates in closed form,
    and the next strongest follow. The paper (section 3.1) takes one at a time and fits all at the end: interference
    then shifts the weaker ones. A second pass sets the threshold, where automatic, by the noise that the first left.

    Parameters
    ----------
    spectrum
        Of the picture.
    threshold
        Amplitude of a wave, units of 1/255; None: automatic, see :func:`power_limit`.
    false_alarms
        Probability that noise alone yields a wave, where automatic.
    most
        At most so many waves.
    effort
        How hard to look.
    """
    waves = Waves(spectrum, np.zeros((0, 2)))
    for _ in range(effort.passes):
        left = np.abs(waves.residual_bins()) ** 2
        floor = noise_floor(left)
        limit = power_limit(spectrum, floor, threshold, false_alarms)
        waves = _subtract(waves, left, limit, most)
    waves = fit_frequencies(spectrum, waves.frequencies, steps=effort.steps).waves
    return FoundWaves(keep_significant(waves, limit, effort.steps), floor, limit)


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


def _subtract(waves: Waves, left: Array, limit: Array, most: int) -> Waves:
    """Return the waves with all those added that candidates lead to."""
    spectrum = waves.spectrum
    bins = _candidates(left, limit, spectrum.shape, WATCHED * most)
    bins, limits = _promising(waves, bins, _lookup(limit, bins / spectrum.size, spectrum.shape))
    values, tries = spectrum.values(bins / spectrum.size), np.zeros(len(bins), np.intp)
    for _ in range(ROUNDS if len(bins) else 0):
        power = np.abs(values - waves.modelled(bins / spectrum.size)) ** 2
        power[((power < SCALLOP * limits).all(1)) | (tries >= TRIES)] = 0
        chosen = _strongest(bins, power.sum(1))[: most - len(waves.frequencies)]
        if not len(chosen):
            break
        starts, powers = _starts(waves, bins[chosen])
        enough = (powers >= NEAREST * limits[chosen]).any(1)
        tries[chosen] += np.where(enough, 1, TRIES)
        if enough.any():
            more = np.concatenate([waves.frequencies, starts[enough]])
            waves = _separate(fit_frequencies(spectrum, more, steps=1).waves)
    return waves


def _promising(waves: Waves, bins: Array, limits: Array) -> tuple[Array, Array]:
    """Return the candidates, and their limits, near which what the waves leave reaches the limit anywhere."""
    if not len(bins):
        return bins, limits
    enough = (_starts(waves, bins)[1] >= NEAREST * limits).any(1)
    return bins[enough], limits[enough]


def _candidates(left: Array, limit: Array, shape: tuple[int, int], most: int) -> Array:
    """Return the bins (x, y) near which a wave may be left, ``(m, 2)``; of a pair f, -f only one."""
    ky, kx = bin_numbers(shape)
    above = left + np.roll(left, 1, 1)
    blocks = np.pad(above[:, :, :-1] + above[:, :, 1:], ((0, 0), (0, 0), (1, 1)))
    columns = np.maximum(blocks[:, :, :-1], blocks[:, :, 1:])
    gathered = np.maximum(columns, np.roll(columns, -1, 1))
    watched = ((left > SCALLOP * limit) & (gathered > GATHERED * limit)).any(0)
    watched &= ~((ky[:, np.newaxis] < 0) & ((kx == 0) | (2 * kx == shape[1])))
    watched[0, 0] = False
    rows, cols = np.nonzero(watched)
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


def _starts(waves: Waves, bins: Array) -> tuple[Array, Array]:
    """Return, for each bin, the frequency of the highest residual within a bin of it, and its power ``(m, C)``."""
    spectrum, size = waves.spectrum, waves.spectrum.size
    left = spectrum.around(bins / size, OFFSETS) - waves.modelled_around(bins / size, OFFSETS)
    power = (np.abs(left) ** 2).reshape(len(bins), -1, spectrum.channels)
    best = power.sum(2).argmax(1)
    return (bins + GRID[best]) / size, np.asarray(power[np.arange(len(bins)), best])


def _separate(waves: Waves) -> Waves:
    """Return the waves without those that cannot be told from a stronger one or from the mean."""
    size, f = waves.spectrum.size, waves.frequencies
    power = wave_powers(waves).sum(1)
    near = (np.hypot(*np.moveaxis((f[:, np.newaxis] - f) * size, 2, 0)) < APART) | (
        np.hypot(*np.moveaxis((f[:, np.newaxis] + f) * size, 2, 0)) < APART
    )
    weaker = (near & (power[:, np.newaxis] < power)).any(1) | (np.hypot(*(f * size).T) < APART / 2)
    return Waves(waves.spectrum, f[~weaker]) if weaker.any() else waves


def keep_significant(waves: Waves, limit: Array, steps: int = THOROUGH.steps) -> Waves:
    """Return the waves that reach the limit ``(C, H, W // 2 + 1)`` once all are fitted, the rest fitted again."""
    waves = _separate(waves)
    while len(waves.frequencies):
        enough = (wave_powers(waves) >= _lookup(limit, waves.frequencies, waves.spectrum.shape)).any(1)
        if enough.all():
            break
        waves = _separate(fit_frequencies(waves.spectrum, waves.frequencies[enough], steps=min(steps, SETTLED)).waves)
    return waves


def _lookup(grid: Array, frequencies: Array, shape: tuple[int, int]) -> Array:
    f = np.where(frequencies[:, :1] < 0, -frequencies, frequencies)
    cols = np.minimum(np.rint(f[:, 0] * shape[1]).astype(np.intp), grid.shape[2] - 1)
    return np.asarray(grid[:, np.rint(f[:, 1] * shape[0]).astype(np.intp) % shape[0], cols].T)
