"""The regular part of a texture: which groups of waves are regular, all their harmonics, and nothing else."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from nrbench.spectra.dirichlet import Array
from nrbench.spectra.frequency_lattice import are_inside, are_near, fold_frequencies, lattice_orders
from nrbench.spectra.fundamentals import SHORTEST, Basis, Peaks
from nrbench.spectra.harmonic_fit import Waves, fit_frequencies
from nrbench.spectra.harmonic_grouping import (
    MOST_GROUPS,
    REPEATED,
    find_finer_fundamentals,
    fit_given_fundamentals,
    peaks_of,
    propose_basis,
    shortest_length,
    surplus_evidence,
)
from nrbench.spectra.line_floor import line_floor
from nrbench.spectra.pursuit import QUICK, FoundWaves, find_waves, wave_powers
from nrbench.spectra.regular_waves import RegularPart, find_harmonics, subtract_waves
from nrbench.spectra.spectrum import Spectrum
from nrbench.spectra.wave_registration import register_fundamentals

Search = Callable[[Spectrum, float | None, float, int], FoundWaves]
"""Waves of a spectrum above a threshold, with a probability of false alarms, at most so many."""
LEADERS = 24
"""Waves looked for to find a group's fundamentals."""
VOTERS = 60
"""Waves, the strongest, by which the fundamentals are fitted: more change them no more."""
FINEST = 0.25
"""Cycles/px: finer waves have no say in where the fundamentals lie, as others, surplus_evidence Nyquist, are fold_frequencies on them."""
SAME = 0.3
"""Bins between waves whose difference is taken to be a whole combination."""
PROPOSING = 16.0
"""Power over the irregular structure's, from which on a wave may propose fundamentals."""
CLEAR = 100.0
"""The same for a wave that no harmonic supports."""
STRIPED = 8.0
"""Log-likelihood, surplus_evidence the best wave, above which one fundamental with harmonics is regular."""
ALIGNED = 2.5
"""Of that, a wave's for being on the line at all: the colors of threads are waves on a line, too, and not regular."""
FARTHEST_MOVE = 0.5
"""Bins."""


def find_waves_quickly(spectrum: Spectrum, threshold: float | None, false_alarms: float, most: int) -> FoundWaves:
    """Return the waves of a short search."""
    return find_waves(spectrum, threshold, false_alarms, most, QUICK)


def find_regular_part(
    spectrum: Spectrum,
    threshold: float | None,
    false_alarms: float,
    most: int,
    search: Search = find_waves_quickly,
    given: Array | None = None,
) -> RegularPart:
    """Return the regular waves of a picture, group by group, as long as any is left.

    The strongest waves propose a lattice of frequencies, or one fundamental; it is fitted to them, all its harmonics
    are taken that stand out of the irregular structure at their places, and it is fitted again to those. What is left
    of the picture proposes the next group.

    Parameters
    ----------
    spectrum
        Of the picture.
    threshold
        Amplitude of a wave, units of 1/255; None: by the irregular structure.
    false_alarms
        Probability that noise alone yields a wave of those that propose.
    most
        At most so many waves.
    search
        How the waves that propose are looked for.
    given
        ``(2, 2)`` cycles/px: fundamentals of the first group, right within about 2 %. None: they are looked for.
    """
    part = _nothing(spectrum)
    if given is not None:
        found = search(spectrum, threshold, false_alarms, min(LEADERS, most))
        part = _grown(part, *fit_given_fundamentals(found, given), threshold, most) or part
    while len(part.groups) < MOST_GROUPS:
        more = _next_group(part, threshold, false_alarms, most, search)
        if more is None:
            break
        part = more
    return part if part.groups != (2,) else _registered(part, threshold, most)


def _nothing(spectrum: Spectrum) -> RegularPart:
    """Return no waves."""
    none = np.zeros((0, 2))
    return RegularPart(
        Waves(spectrum, none), np.zeros((0, spectrum.channels), np.bool_), none, np.zeros((0, 0)), (), none
    )


def _registered(part: RegularPart, threshold: float | None, most: int) -> RegularPart:
    """Return the part with its lattice register_fundamentals; as it was, where that would move a wave by half a bin."""
    spectrum = part.waves.spectrum
    fundamentals = register_fundamentals(part.waves, part.orders @ part.fundamentals, part.fundamentals)
    return part if _moved(part, fundamentals) else find_harmonics(spectrum, fundamentals, part.groups, threshold, most)


def _moved(part: RegularPart, fundamentals: Array) -> bool:
    """Return whether some wave of a part lies half a bin or more from where other fundamentals would have it."""
    bins = part.orders @ (part.fundamentals - fundamentals) * part.waves.spectrum.size
    return bool(np.abs(bins).max(initial=0.0) > FARTHEST_MOVE)


def _next_group(
    part: RegularPart, threshold: float | None, false_alarms: float, most: int, search: Search
) -> RegularPart | None:
    """Return the part with one more group, None where nothing regular is left."""
    spectrum = part.waves.spectrum
    left = Spectrum(subtract_waves(part.waves, part.kept)) if part.groups else spectrum
    found = search(left, threshold, false_alarms, min(LEADERS, most))
    strong = np.argsort(-found.powers.sum(1), kind="stable")
    strong = strong[(_out_of_line(found) & _apart(found, part))[strong]]
    if part.groups == (2,) and (finer := find_finer_fundamentals(found, strong, part.fundamentals)) is not None:
        larger = _grown(_nothing(spectrum), *finer, threshold, most)
        if larger is not None and not _moved(larger, finer[0]):
            return larger
    order = _news(found, part, strong)
    while len(order):
        waves = peaks_of(found, order)
        basis = propose_basis(waves)
        short = shortest_length(basis.vectors) < (REPEATED if threshold is None else SHORTEST)
        if not short and _is_regular(basis, waves, found, order[0], threshold):
            seeds = basis.orders[basis.explained]
            grown = _grown(part, basis.vectors / spectrum.size, seeds, threshold, most)
            if grown is not None:
                return grown
        order = order[~basis.explained] if short and basis.explained.any() else order[1:]
    return None


def _is_regular(basis: Basis, waves: Peaks, found: FoundWaves, strongest: np.intp, threshold: float | None) -> bool:
    """Return whether fundamentals are those of a group: two, one with harmonics, or that of one clear wave."""
    harmonics = surplus_evidence(basis, waves) - ALIGNED * (int(basis.explained.sum()) - 1)
    return len(basis.vectors) == 2 or harmonics > STRIPED or _is_clear(found, strongest, threshold)


def _apart(found: FoundWaves, part: RegularPart) -> NDArray[np.bool_]:
    """Return which waves lie at no place of the groups, nor at the mean or the border of the spectrum, ``(n,)``."""
    f, size = found.waves.frequencies, found.waves.spectrum.size
    places = fold_frequencies(lattice_orders(part.fundamentals, part.groups, size) @ part.fundamentals)
    return np.asarray(are_inside(f, size) & ~are_near(f, places, size))


def _news(found: FoundWaves, part: RegularPart, order: NDArray[np.intp]) -> NDArray[np.intp]:
    """Return the waves of ``order`` that differ from none before them by a vector of the groups."""
    f, size, start = found.waves.frequencies, found.waves.spectrum.size, 0
    for count in part.groups:
        basis, start = part.fundamentals[start : start + count], start + count
        order = order[_first_of_class(f[order], basis, size)]
    return order


def _first_of_class(f: Array, basis: Array, size: Array) -> NDArray[np.bool_]:
    """Return which frequencies differ from none before them by a whole combination of the basis."""
    alike = np.zeros((len(f), len(f)), np.bool_)
    for sign in (1, -1):
        apart = f[:, np.newaxis] - sign * f
        rest = apart - np.rint(apart @ np.linalg.pinv(basis)) @ basis
        alike |= np.hypot(*np.moveaxis(rest * size, 2, 0)) < SAME
    return np.asarray(~np.tril(alike, -1).any(1))


def _out_of_line(found: FoundWaves) -> NDArray[np.bool_]:
    """Return which waves stand out of the lines of the spectrum through them, too, ``(n,)``."""
    waves = found.waves
    power = np.abs(waves.residual_bins()) ** 2
    floor = line_floor(power, waves.spectrum.shape, waves.frequencies, np.zeros((0, 2)))
    return np.asarray((found.powers > PROPOSING * floor).any(1))


def _is_clear(found: FoundWaves, wave: np.intp, threshold: float | None) -> bool:
    """Return whether a wave alone stands clearly out of all that is around it, other waves included."""
    if threshold is not None:
        return True
    f = found.waves.frequencies[wave : wave + 1]
    alone = Waves(found.waves.spectrum, f)
    floor = line_floor(np.abs(alone.residual_bins()) ** 2, alone.spectrum.shape, f, f)
    return bool((wave_powers(alone)[0] > CLEAR * floor[0]).any())


def _grown(part: RegularPart, vectors: Array, seeds: Array, threshold: float | None, most: int) -> RegularPart | None:
    """Return the part with a group of given fundamentals and first waves, with all its harmonics."""
    spectrum = part.waves.spectrum
    fundamentals = np.concatenate([part.fundamentals, vectors])
    groups = (*part.groups, len(vectors))
    n, g = part.orders.shape
    orders = np.zeros((n + len(seeds), g + len(vectors)))
    orders[:n, :g], orders[n:, g:] = part.orders, seeds
    strongest = _strongest_orders(spectrum, fundamentals, orders)
    if not len(strongest):
        return None
    fundamentals = fit_frequencies(spectrum, fundamentals, strongest, steps=8).fundamentals
    chosen = find_harmonics(spectrum, fundamentals, groups, threshold, most)
    if not chosen.orders[:, g:].any():
        return None
    chosen = find_harmonics(spectrum, _aligned(chosen), groups, threshold, most)
    return chosen if chosen.orders[:, g:].any() else None


def _aligned(part: RegularPart) -> Array:
    """Return the fundamentals fitted to the waves, each weighted by the irregular structure there."""
    f = part.orders @ part.fundamentals
    baseband = (np.abs(f) < 0.5).all(1)
    voters = (np.abs(f) < FINEST).all(1)
    if np.linalg.matrix_rank(part.orders[voters]) < len(part.fundamentals):
        voters = baseband
    if np.linalg.matrix_rank(part.orders[voters]) < len(part.fundamentals):
        return part.fundamentals
    return fit_frequencies(
        part.waves.spectrum, part.fundamentals, part.orders[voters], 4, part.weights[voters]
    ).fundamentals


def _strongest_orders(spectrum: Spectrum, fundamentals: Array, orders: Array) -> Array:
    """Return the strongest of the waves below Nyquist."""
    orders = orders[(np.abs(orders @ fundamentals) < 0.5).all(1)]
    power = wave_powers(Waves(spectrum, orders @ fundamentals)).sum(1)
    return np.asarray(orders[np.argsort(-power, kind="stable")[:VOTERS]])
