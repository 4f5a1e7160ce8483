"""The regular part of a picture: the groups of harmonics that stand out of its irregular structure."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from nrbench.spectra.harmonic_groups import (
    REPEATED,
    SHORTEST,
    Basis,
    Peaks,
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
from nrbench.spectra.spectrum import Array, Spectrum
from nrbench.spectra.wave_fit import FixedWaves, Waves, fit_frequencies, register_fundamentals
from nrbench.spectra.wave_search import Search, WaveDetection, find_waves_quickly

LEADERS = 24
"""Waves that are searched to find a group's fundamentals."""
MOST_GROUPS = 16
VOTERS = 60
"""Number of the strongest waves to which the fundamentals are fitted: more hardly change them."""
FINEST = 0.25
"""Cycles/px: finer waves do not count in the fit of fundamentals, as waves beyond Nyquist are folded on them."""
SAME = 0.3
"""Bins between waves whose difference is taken to be an integer combination."""
PROPOSING = 16.0
"""Power over the irregular structure's, from which on a wave may propose fundamentals."""
CLEAR = 100.0
"""The same for a wave that no harmonic supports."""
STRIPED = 8.0
"""Log-likelihood, beyond the best wave, above which one fundamental with harmonics is regular."""
ALIGNED = 2.5
"""Part of it that a wave has for lying on the line at all: the colors of threads are waves on a line, too."""
FARTHEST_MOVE = 0.5
"""Bins that a wave may move when its lattice is registered or replaced by a finer one."""
HARMONIC = 4.0
"""Power over the irregular structure's, from which on a wave at a point of a lattice is a harmonic."""
FOLDED = 0.25
"""Weight of the power of a wave beyond Nyquist, against that of one below that pixels cannot tell from it."""
CROWD = 900
"""Harmonics of a lattice that are fitted at most, those of the highest power."""
LEAST_SHARE = 0.1
"""Share of a given threshold's power that the picture's spectrum must have at a harmonic for the wave to be fitted."""
DIRECTIONS = 12
REACH = 8
"""Bins sampled along a line to either side."""
FEWEST = 4
"""Samples of a line that its median needs."""


class RegularPart(NamedTuple):
    """The regular waves of a picture.

    Parameters
    ----------
    waves
        Waves of the frequencies ``orders @ fundamentals``, folded, fitted to the picture.
    kept
        ``(n, C)``: the channels in which each stands out of the irregular structure.
    fundamentals
        ``(g, 2)`` cycles/px.
    orders
        ``(n, g)`` integers.
    groups
        The number of fundamentals, 1 or 2, of each group; they follow each other in ``fundamentals``.
    weights
        ``(n, C)``: the inverse of the irregular structure's power at each wave, 0 where it is not kept.
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
    search: Search = find_waves_quickly,
    given: Array | None = None,
) -> RegularPart:
    """Return the regular waves of a picture, group by group, as long as any is left.

    The strongest waves propose a lattice of frequencies, or one fundamental. It is fitted to them, all its harmonics
    are taken that stand out of the irregular structure at their frequencies, and it is fitted again to those. The
    residual of the picture proposes the next group.

    Parameters
    ----------
    spectrum
        The picture's spectrum.
    threshold
        Amplitude of a wave, units of 1/255, above which every harmonic is kept; None: those that stand out of the
        irregular structure.
    false_alarms
        Probability that noise alone yields a wave of those that propose.
    most
        The largest number of waves.
    search
        The search for the waves that propose.
    given
        ``(2, 2)`` cycles/px: fundamentals of the first group, right within about 2 %. None: they are searched.
    """
    part = _empty_part(spectrum)
    if given is not None:
        detection = search(spectrum, threshold, false_alarms, min(LEADERS, most))
        part = _add_group(part, *fit_given_fundamentals(detection, given), threshold, most) or part
    while len(part.groups) < MOST_GROUPS:
        more = _find_next_group(part, threshold, false_alarms, most, search)
        if more is None:
            break
        part = more
    return part if part.groups != (2,) else _register(part, threshold, most)


def _empty_part(spectrum: Spectrum) -> RegularPart:
    none, channels = np.zeros((0, 2)), np.zeros((0, spectrum.channels), np.bool_)
    return RegularPart(Waves(spectrum, none), channels, none, np.zeros((0, 0)), (), none)


def _register(part: RegularPart, threshold: float | None, most: int) -> RegularPart:
    """Return the part with its lattice registered; unchanged if that moved a wave by half a bin."""
    fundamentals = register_fundamentals(part.waves, part.orders @ part.fundamentals, part.fundamentals)
    if _moves_far(part, fundamentals):
        return part
    return find_harmonics(part.waves.spectrum, fundamentals, part.groups, threshold, most)


def _moves_far(part: RegularPart, fundamentals: Array) -> bool:
    """Return whether other fundamentals move some wave of a part by half a bin or more."""
    bins = part.orders @ (part.fundamentals - fundamentals) * part.waves.spectrum.size
    return bool(np.abs(bins).max(initial=0.0) > FARTHEST_MOVE)


def _find_next_group(
    part: RegularPart, threshold: float | None, false_alarms: float, most: int, search: Search
) -> RegularPart | None:
    """Return the part with one more group, None if nothing regular is left."""
    spectrum = part.waves.spectrum
    residual = Spectrum(part.waves.subtract(part.kept)) if part.groups else spectrum
    detection = search(residual, threshold, false_alarms, min(LEADERS, most))
    strong = np.argsort(-detection.powers.sum(1), kind="stable")
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
    basis: Basis, peaks: Peaks, detection: WaveDetection, strongest: np.intp, threshold: float | None
) -> bool:
    """Return whether fundamentals are those of a group: two, one with harmonics, or that of one clear wave."""
    harmonics = surplus_evidence(basis, peaks.weights) - ALIGNED * (int(basis.explained.sum()) - 1)
    return len(basis.vectors) == 2 or harmonics > STRIPED or _is_clear(detection, strongest, threshold)


def _lie_apart(detection: WaveDetection, part: RegularPart) -> NDArray[np.bool_]:
    """Return which waves lie at no harmonic of the groups, nor at the mean or the border of the spectrum, ``(n,)``."""
    f, size = detection.waves.frequencies, detection.waves.spectrum.size
    harmonics = fold_frequencies(lattice_orders(part.fundamentals, part.groups, size) @ part.fundamentals)
    return np.asarray(are_inside(f, size) & ~are_near(f, harmonics, size))


def _drop_repeats(detection: WaveDetection, part: RegularPart, order: NDArray[np.intp]) -> NDArray[np.intp]:
    """Return the waves of ``order`` that differ from none before them by a vector of one of the groups."""
    size, start = detection.waves.spectrum.size, 0
    for count in part.groups:
        basis, start = part.fundamentals[start : start + count], start + count
        f = detection.waves.frequencies[order]
        alike = np.zeros((len(f), len(f)), np.bool_)
        for sign in (1, -1):
            apart = f[:, np.newaxis] - sign * f
            rest = apart - np.rint(apart @ np.linalg.pinv(basis)) @ basis
            alike |= np.hypot(*np.moveaxis(rest * size, 2, 0)) < SAME
        order = order[~np.tril(alike, -1).any(1)]
    return order


def _stand_out_of_lines(detection: WaveDetection) -> NDArray[np.bool_]:
    """Return which waves stand out of the lines of the spectrum through them, ``(n,)``."""
    waves = detection.waves
    power = np.abs(waves.residual_bins()) ** 2
    floor = line_floor(power, waves.spectrum.shape, waves.frequencies, np.zeros((0, 2)))
    return np.asarray((detection.powers > PROPOSING * floor).any(1))


def _is_clear(detection: WaveDetection, wave: np.intp, threshold: float | None) -> bool:
    """Return whether a wave alone stands clearly out of all that is around it, other waves included."""
    if threshold is not None:
        return True
    f = detection.waves.frequencies[wave : wave + 1]
    alone = Waves(detection.waves.spectrum, f)
    floor = line_floor(np.abs(alone.residual_bins()) ** 2, alone.spectrum.shape, f, f)
    return bool((alone.powers[0] > CLEAR * floor[0]).any())


def _add_group(
    part: RegularPart, vectors: Array, seeds: Array, threshold: float | None, most: int
) -> RegularPart | None:
    """Return the part with a group of given fundamentals and first waves, and all its harmonics; None if it has none.

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
    """Return the fundamentals fitted to the waves, each weighted by the irregular structure there."""
    f = part.orders @ part.fundamentals
    for voters in ((np.abs(f) < FINEST).all(1), (np.abs(f) < 0.5).all(1)):
        if np.linalg.matrix_rank(part.orders[voters]) >= len(part.fundamentals):
            weights = part.weights[voters]
            return fit_frequencies(part.waves.spectrum, part.fundamentals, part.orders[voters], 4, weights).fundamentals
    return part.fundamentals


def find_harmonics(
    spectrum: Spectrum, fundamentals: Array, groups: tuple[int, ...], threshold: float | None, most: int
) -> RegularPart:
    """Return all harmonics of the groups that stand out of the irregular structure, or are above the threshold."""
    height, width = spectrum.shape
    limit = ((threshold or 0.0) / 255 * height * width / 2) ** 2
    orders = _distinct_orders(spectrum, fundamentals, groups, LEAST_SHARE * limit)
    f = fold_frequencies(orders @ fundamentals)
    waves = FixedWaves(spectrum, f)
    floor = line_floor(np.abs(Spectrum(waves.subtract()).bins()) ** 2, spectrum.shape, f, f)
    power, least = waves.powers, 1e-12 * spectrum.energy.max() * spectrum.size.prod()
    if threshold is None:
        kept = power > HARMONIC * floor + least
    else:
        kept = power > limit
        kept |= kept.any(1, keepdims=True)
    weights = kept / np.maximum(floor, least)
    there = np.flatnonzero(kept.any(1))
    there = there[np.argsort(-power[there].sum(1), kind="stable")[:most]]
    return RegularPart(FixedWaves(spectrum, f[there]), kept[there], fundamentals, orders[there], groups, weights[there])


def _distinct_orders(spectrum: Spectrum, fundamentals: Array, groups: tuple[int, ...], least: float) -> Array:
    """Return the orders of harmonics of at least some power; of those that pixels cannot tell apart the strongest."""
    orders = lattice_orders(fundamentals, groups, spectrum.size)
    power = (np.abs(spectrum.values(fold_frequencies(orders @ fundamentals))) ** 2).sum(1)
    orders, power = orders[power >= least], power[power >= least]
    f = orders @ fundamentals
    power *= np.where((np.abs(f) < 0.5).all(1), 1, FOLDED)
    best = np.argsort(-power, kind="stable")[:CROWD]
    return np.asarray(orders[best[select_spaced(fold_frequencies(f[best]), power[best], spectrum.size)]])


def line_floor(power: Array, shape: tuple[int, int], frequencies: Array, waves: Array) -> Array:
    """Return the mean power of the irregular structure at frequencies, ``(n, C)``.

    Departures from regularity act on elements, and elements are not alike in all directions: the colors of threads
    that keep them along their length lie on lines of the spectrum, through the very frequencies of the waves, and
    exceed the spectrum beside the line. So the floor is the highest of the medians along twelve lines through a
    frequency, each over ln 2 (the power of a coefficient is exponentially distributed about its mean). Bins beside a
    wave are left out; where too few remain, the floor is that of the whole spectrum.

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
    steps = np.concatenate([np.arange(-REACH, -1), np.arange(2, REACH + 1)])
    lines = steps[:, np.newaxis] * np.stack([np.cos(angles), np.sin(angles)], 1)[:, np.newaxis]
    rows, cols = _half_spectrum_bins(frequencies[:, np.newaxis, np.newaxis] * shape[::-1] + lines, shape)
    samples = np.sort(usable[rows, cols], axis=2)
    counts = np.isfinite(samples).sum(2)
    middle = np.take_along_axis(samples, np.maximum(counts - 1, 0)[:, :, np.newaxis] // 2, 2)[:, :, 0]
    medians = np.where(counts >= FEWEST, middle, 0).max(1, initial=0)
    overall = np.median(power.reshape(len(power), -1), 1)
    return np.asarray(np.where(medians > 0, medians, overall) / math.log(2))


def _beside_waves(waves: Array, shape: tuple[int, int]) -> NDArray[np.bool_]:
    """Return which bins are a wave's nearest or next to it, and those of the mean, ``(H, W // 2 + 1)``."""
    around = np.stack(np.meshgrid([-1, 0, 1], [-1, 0, 1]), -1).reshape(-1, 2)
    places = np.concatenate([np.zeros((1, 2)), waves, -waves]) * np.array(shape[::-1])
    near = np.zeros((shape[0], shape[1] // 2 + 1), np.bool_)
    near[_half_spectrum_bins(np.rint(places)[:, np.newaxis] + around, shape)] = True
    return near


def _half_spectrum_bins(bins: Array, shape: tuple[int, int]) -> tuple[NDArray[np.intp], NDArray[np.intp]]:
    """Return rows and columns of the half spectrum of bins (x, y), by its symmetry."""
    x, y = (np.rint(bins[..., k]).astype(np.intp) for k in (0, 1))
    x = (x + shape[1] // 2) % shape[1] - shape[1] // 2
    return np.where(x < 0, -y, y) % shape[0], np.abs(x)
