"""The regular part of a picture: the groups of harmonics that are stronger than its irregular structure."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from nrbench.spectra.harmonic_groups import (
    REPEATED,
    SHORTEST,
    Basis,
    SpectrumPeaks,
    are_inside,
    are_near,
    collect_peaks,
    find_finer_fundamentals,
    fit_given_fundamentals,
    fold_frequencies,
    lattice_orders,
    propose_basis,
    select_spaced,
    shortest_length,
    surplus_evidence,
)
from nrbench.spectra.spectrum import Array, Complex, Spectrum
from nrbench.spectra.wave_fit import FixedWaves, Waves, fit_frequencies, register_fundamentals
from nrbench.spectra.wave_search import WaveDetection, find_waves, find_waves_analytic

LEADERS = 24
"""Number of waves that are searched to find a group's fundamentals."""
MOST_GROUPS = 16
VOTERS = 60
"""Number of the strongest waves to which the fundamentals are fitted. More waves hardly change the result."""
FINEST = 0.25
"""Cycles/px: higher frequencies are not used to fit the fundamentals, because aliases of other waves lie there."""
COINCIDENCE = 0.3
"""Bins: waves coincide up to an integer combination of fundamentals if they are nearer than this."""
PROPOSAL_RATIO = 16.0
"""Least ratio of powers, wave over irregular structure, for a wave that proposes fundamentals."""
LONE_WAVE_RATIO = 100.0
"""Least ratio of powers for a single wave without harmonics."""
STRIPES_EVIDENCE = 8.0
"""Least evidence of one fundamental with harmonics, without the best wave, for regular stripes."""
LINE_EVIDENCE = 2.5
"""Evidence that is subtracted for each wave on the line. The random colors of threads are waves on a line, too."""
FARTHEST_MOVE = 0.5
"""Bins: the largest shift of a wave when its lattice is registered or replaced by a finer one."""
HARMONIC_RATIO = 4.0
"""Least ratio of powers, wave over irregular structure, for a harmonic at a point of a lattice."""
FOLDED_WEIGHT = 0.25
"""Weight of the power of a wave beyond the Nyquist frequency when it is compared with its alias below."""
MOST_HARMONICS = 900
"""Largest number of harmonics that are fitted: those of the highest power."""
LEAST_SHARE = 0.1
"""Least power of the spectrum at a harmonic that is fitted, as a share of a given threshold's power."""
DIRECTIONS = 12
LINE_REACH = 8
"""Number of bins that are sampled along a line to either side."""
FEWEST_SAMPLES = 4
"""Least number of samples for the median of a line."""


class RegularPart(NamedTuple):
    """The regular waves of a picture.

    Parameters
    ----------
    waves
        Waves of the frequencies ``orders @ fundamentals``, aliased to at most half a cycle/px, fitted to the picture.
    kept
        ``(n, C)``: the channels in which each wave is stronger than the irregular structure.
    fundamentals
        ``(g, 2)`` cycles/px.
    orders
        ``(n, g)`` integers.
    groups
        The number of fundamentals, 1 or 2, of each group; they follow each other in ``fundamentals``.
    weights
        ``(n, C)``: the inverse of the irregular structure's power at each wave; 0 in channels that are not kept.
    """

    waves: Waves
    kept: NDArray[np.bool_]
    fundamentals: Array
    orders: Array
    groups: tuple[int, ...]
    weights: Array


def find_regular_part(
    spectrum: Spectrum,
    threshold: float | None,
    false_alarms: float,
    most: int,
    analytic: bool = False,
    given: Array | None = None,
) -> RegularPart:
    """Find the regular waves of a picture, group by group.

    The strongest waves propose a lattice of frequencies or a single fundamental. The fundamentals are fitted to these
    waves. Then all harmonics are kept that are stronger than the irregular structure at their frequencies, and the
    fundamentals are fitted again to those. The residual of the picture proposes the next group, until no regular group
    remains.

    Parameters
    ----------
    spectrum
        The picture's spectrum.
    threshold
        Amplitude, in units of 1/255, above which every harmonic is kept. None: harmonics that are stronger than the
        irregular structure are kept.
    false_alarms
        Probability that noise alone yields a proposing wave.
    most
        The largest number of waves.
    analytic
        Search the proposing waves in the analytic signal, see :func:`~nrbench.spectra.wave_search.find_waves_analytic`.
    given
        ``(2, 2)`` cycles/px: fundamentals of the first group, with an error of at most about 2 %. None: they are
        searched.
    """
    part = _empty_part(spectrum)
    if given is not None:
        detection = _find_leaders(spectrum, threshold, false_alarms, most, analytic)
        part = _add_group(part, *fit_given_fundamentals(detection, given), threshold, most) or part
    while len(part.groups) < MOST_GROUPS:
        more = _find_next_group(part, threshold, false_alarms, most, analytic)
        if more is None:
            break
        part = more
    return part if part.groups != (2,) else _register(part, threshold, most)


def _find_leaders(
    spectrum: Spectrum, threshold: float | None, false_alarms: float, most: int, analytic: bool
) -> WaveDetection:
    """Return the waves that propose the fundamentals of a group."""
    if analytic:
        return find_waves_analytic(spectrum, threshold, false_alarms, min(LEADERS, most))
    return find_waves(spectrum, threshold, false_alarms, min(LEADERS, most), quick=True)


def _empty_part(spectrum: Spectrum) -> RegularPart:
    none, channels = np.zeros((0, 2)), np.zeros((0, spectrum.channels), np.bool_)
    return RegularPart(Waves(spectrum, none), channels, none, np.zeros((0, 0)), (), none)


def _register(part: RegularPart, threshold: float | None, most: int) -> RegularPart:
    """Return the part with its lattice registered to the picture; unchanged if that moves a wave too far."""
    fundamentals = register_fundamentals(part.waves, part.orders @ part.fundamentals, part.fundamentals)
    if _moves_far(part, fundamentals):
        return part
    return find_harmonics(part.waves.spectrum, fundamentals, part.groups, threshold, most)


def _moves_far(part: RegularPart, fundamentals: Array) -> bool:
    """Return whether other fundamentals move a wave of a part by more than :data:`FARTHEST_MOVE`."""
    bins = part.orders @ (part.fundamentals - fundamentals) * part.waves.spectrum.size
    return bool(np.abs(bins).max(initial=0.0) > FARTHEST_MOVE)


def _find_next_group(
    part: RegularPart, threshold: float | None, false_alarms: float, most: int, analytic: bool
) -> RegularPart | None:
    """Return the part with one more group; None if no regular group remains."""
    spectrum = part.waves.spectrum
    residual = Spectrum(part.waves.subtract(part.kept)) if part.groups else spectrum
    detection = _find_leaders(residual, threshold, false_alarms, most, analytic)
    strong = np.argsort(-detection.waves.powers.sum(1), kind="stable")
    strong = strong[(_stand_out_of_lines(detection) & _lie_apart(detection, part))[strong]]
    if part.groups == (2,):
        finer = find_finer_fundamentals(detection, strong, part.fundamentals)
        larger = None if finer is None else _add_group(_empty_part(spectrum), *finer, threshold, most)
        if finer is not None and larger is not None and not _moves_far(larger, finer[0]):
            return larger
    order = _drop_repeats(detection, part, strong)
    while len(order):
        peaks = collect_peaks(detection, order)
        basis = propose_basis(peaks)
        short = shortest_length(basis.vectors) < (REPEATED if threshold is None else SHORTEST)
        if not short and _is_regular(basis, peaks, detection, order[0], threshold):
            seeds = basis.orders[basis.explained]
            larger = _add_group(part, basis.vectors / spectrum.size, seeds, threshold, most)
            if larger is not None:
                return larger
        order = order[~basis.explained] if short and basis.explained.any() else order[1:]
    return None


def _is_regular(
    basis: Basis, peaks: SpectrumPeaks, detection: WaveDetection, strongest: np.intp, threshold: float | None
) -> bool:
    """Return whether a basis is a regular group: a lattice, stripes with harmonics, or a single clear wave."""
    harmonics = surplus_evidence(basis, peaks.weights) - LINE_EVIDENCE * (int(basis.explained.sum()) - 1)
    return len(basis.vectors) == 2 or harmonics > STRIPES_EVIDENCE or _is_clear_alone(detection, strongest, threshold)


def _lie_apart(detection: WaveDetection, part: RegularPart) -> NDArray[np.bool_]:
    """Return whether each wave, ``(n,)``, is far from all harmonics of the groups, from frequency 0 and the border."""
    f, size = detection.waves.frequencies, detection.waves.spectrum.size
    harmonics = fold_frequencies(lattice_orders(part.fundamentals, part.groups, size) @ part.fundamentals)
    return np.asarray(are_inside(f, size) & ~are_near(f, harmonics, size))


def _drop_repeats(detection: WaveDetection, part: RegularPart, order: NDArray[np.intp]) -> NDArray[np.intp]:
    """Return ``order`` without waves that differ from an earlier one by an integer combination of a group."""
    size, start = detection.waves.spectrum.size, 0
    for count in part.groups:
        basis, start = part.fundamentals[start : start + count], start + count
        f = detection.waves.frequencies[order]
        alike = np.zeros((len(f), len(f)), np.bool_)
        for sign in (1, -1):
            apart = f[:, np.newaxis] - sign * f
            rest = apart - np.rint(apart @ np.linalg.pinv(basis)) @ basis
            alike |= np.hypot(*np.moveaxis(rest * size, 2, 0)) < COINCIDENCE
        order = order[~np.tril(alike, -1).any(1)]
    return order


def _stand_out_of_lines(detection: WaveDetection) -> NDArray[np.bool_]:
    """Return whether each wave, ``(n,)``, is much stronger than the lines of the spectrum through it."""
    waves = detection.waves
    power = np.abs(waves.residual_bins()) ** 2
    floor = line_floor(power, waves.spectrum.shape, waves.frequencies, np.zeros((0, 2)))
    return np.asarray((detection.waves.powers > PROPOSAL_RATIO * floor).any(1))


def _is_clear_alone(detection: WaveDetection, wave: np.intp, threshold: float | None) -> bool:
    """Return whether a wave is much stronger than all around it, including other waves, or a threshold is given."""
    if threshold is not None:
        return True
    f = detection.waves.frequencies[wave : wave + 1]
    alone = Waves(detection.waves.spectrum, f)
    floor = line_floor(np.abs(alone.residual_bins()) ** 2, alone.spectrum.shape, f, f)
    return bool((alone.powers[0] > LONE_WAVE_RATIO * floor[0]).any())


def _add_group(
    part: RegularPart, vectors: Array, seeds: Array, threshold: float | None, most: int
) -> RegularPart | None:
    """Return the part with a further group and all its harmonics; None if the group has no harmonics.

    Parameters
    ----------
    part
        The groups before.
    vectors
        ``(1 or 2, 2)`` cycles/px: the group's fundamentals.
    seeds
        ``(m, 1 or 2)`` integers: the orders of its first waves.
    threshold, most
        As for :func:`find_regular_part`.
    """
    spectrum = part.waves.spectrum
    fundamentals = np.concatenate([part.fundamentals, vectors])
    groups = (*part.groups, len(vectors))
    n, g = part.orders.shape
    orders = np.zeros((n + len(seeds), g + len(vectors)))
    orders[:n, :g], orders[n:, g:] = part.orders, seeds
    orders = orders[(np.abs(orders @ fundamentals) < 0.5).all(1)]
    power = Waves(spectrum, orders @ fundamentals).powers.sum(1)
    strongest = orders[np.argsort(-power, kind="stable")[:VOTERS]]
    if not len(strongest):
        return None
    fundamentals = fit_frequencies(spectrum, fundamentals, strongest, steps=8).fundamentals
    larger = find_harmonics(spectrum, fundamentals, groups, threshold, most)
    if not larger.orders[:, g:].any():
        return None
    larger = find_harmonics(spectrum, _fit_fundamentals(larger), groups, threshold, most)
    return larger if larger.orders[:, g:].any() else None


def _fit_fundamentals(part: RegularPart) -> Array:
    """Return the fundamentals fitted to the waves; weights are the inverse power of the irregular structure."""
    f = part.orders @ part.fundamentals
    for voters in ((np.abs(f) < FINEST).all(1), (np.abs(f) < 0.5).all(1)):
        if np.linalg.matrix_rank(part.orders[voters]) >= len(part.fundamentals):
            weights = part.weights[voters]
            return fit_frequencies(part.waves.spectrum, part.fundamentals, part.orders[voters], 4, weights).fundamentals
    return part.fundamentals


def find_harmonics(
    spectrum: Spectrum, fundamentals: Array, groups: tuple[int, ...], threshold: float | None, most: int
) -> RegularPart:
    """Return all harmonics of the groups that are above the threshold; None: stronger than the irregular structure."""
    height, width = spectrum.shape
    limit = ((threshold or 0.0) / 255 * height * width / 2) ** 2
    orders, values = _distinct_orders(spectrum, fundamentals, groups, LEAST_SHARE * limit)
    f = fold_frequencies(orders @ fundamentals)
    waves = FixedWaves(spectrum, f, values)
    floor = line_floor(np.abs(Spectrum(waves.subtract()).bins) ** 2, spectrum.shape, f, f)
    power, least = waves.powers, 1e-12 * spectrum.energy.max() * spectrum.size.prod()
    if threshold is None:
        kept = power > HARMONIC_RATIO * floor + least
    else:
        kept = power > limit
        kept |= kept.any(1, keepdims=True)
    weights = kept / np.maximum(floor, least)
    some = np.flatnonzero(kept.any(1))
    best = some[np.argsort(-power[some].sum(1), kind="stable")[:most]]
    waves = FixedWaves(spectrum, f[best], values[best])
    return RegularPart(waves, kept[best], fundamentals, orders[best], groups, weights[best])


def _distinct_orders(
    spectrum: Spectrum, fundamentals: Array, groups: tuple[int, ...], least: float
) -> tuple[Array, Complex]:
    """Return the orders of the harmonics whose power is at least ``least``, and the spectrum there.

    Of aliases, only the strongest is returned.
    """
    orders = lattice_orders(fundamentals, groups, spectrum.size)
    f = orders @ fundamentals
    values = spectrum.values(fold_frequencies(f))
    power = (np.abs(values) ** 2).sum(1)
    weighted = power * np.where((np.abs(f) < 0.5).all(1), 1, FOLDED_WEIGHT)
    some = np.flatnonzero(power >= least)
    best = some[np.argsort(-weighted[some], kind="stable")[:MOST_HARMONICS]]
    best = best[select_spaced(fold_frequencies(f[best]), weighted[best], spectrum.size)]
    return orders[best], values[best]


def line_floor(power: Array, shape: tuple[int, int], frequencies: Array, waves: Array) -> Array:
    """Return the mean power of the irregular structure at frequencies, ``(n, C)``.

    The power of the irregular structure depends on the direction. Threads, for example, have one color along their
    length, so the power of their random colors lies on lines of the spectrum, and these lines contain the frequencies
    of the waves. The floor at a frequency is therefore the highest of the medians along twelve lines through it, each
    divided by ln 2 (the power of a coefficient is exponentially distributed). Bins next to a wave are left out. If too
    few bins remain, the median of the whole spectrum is used.

    Parameters
    ----------
    power
        ``(C, H, W // 2 + 1)``: squared magnitudes of the picture less the waves, in the order of ``rfft2``.
    shape
        (H, W) px.
    frequencies
        ``(n, 2)`` cycles/px.
    waves
        ``(m, 2)`` cycles/px: all waves that were subtracted.
    """
    usable = np.moveaxis(np.where(_beside_waves(waves, shape), np.inf, power), 0, 2)
    angles = np.pi * np.arange(DIRECTIONS) / DIRECTIONS
    steps = np.concatenate([np.arange(-LINE_REACH, -1), np.arange(2, LINE_REACH + 1)])
    lines = steps[:, np.newaxis] * np.stack([np.cos(angles), np.sin(angles)], 1)[:, np.newaxis]
    rows, cols = _half_spectrum_bins(frequencies[:, np.newaxis, np.newaxis] * shape[::-1] + lines, shape)
    samples = np.sort(usable[rows, cols], axis=2)
    counts = np.isfinite(samples).sum(2)
    middle = np.take_along_axis(samples, np.maximum(counts - 1, 0)[:, :, np.newaxis] // 2, 2)[:, :, 0]
    medians = np.where(counts >= FEWEST_SAMPLES, middle, 0).max(1, initial=0)
    overall = np.median(power.reshape(len(power), -1), 1)
    return np.asarray(np.where(medians > 0, medians, overall) / math.log(2))


def _beside_waves(waves: Array, shape: tuple[int, int]) -> NDArray[np.bool_]:
    """Return a mask of the bins at a wave or at the mean, or next to one of these, ``(H, W // 2 + 1)``."""
    around = np.stack(np.meshgrid([-1, 0, 1], [-1, 0, 1]), -1).reshape(-1, 2)
    places = np.concatenate([np.zeros((1, 2)), waves, -waves]) * np.array(shape[::-1])
    near = np.zeros((shape[0], shape[1] // 2 + 1), np.bool_)
    near[_half_spectrum_bins(np.rint(places)[:, np.newaxis] + around, shape)] = True
    return near


def _half_spectrum_bins(bins: Array, shape: tuple[int, int]) -> tuple[NDArray[np.intp], NDArray[np.intp]]:
    """Return the rows and columns of bins (x, y) in the half spectrum, which is symmetric."""
    x, y = (np.rint(bins[..., k]).astype(np.intp) for k in (0, 1))
    x = (x + shape[1] // 2) % shape[1] - shape[1] // 2
    return np.where(x < 0, -y, y) % shape[0], np.abs(x)
