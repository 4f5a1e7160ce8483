"""The waves of regular groups: which harmonics stand out of the irregular structure at their places."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from nrbench.spectra.dirichlet import Array
from nrbench.spectra.frequency_lattice import fold_frequencies, lattice_orders, select_spaced
from nrbench.spectra.harmonic_fit import FixedWaves, Waves
from nrbench.spectra.line_floor import line_floor
from nrbench.spectra.pursuit import wave_powers
from nrbench.spectra.spectrum import Spectrum
from nrbench.spectra.wave_sum import origin_amplitudes, wave_sum

HARMONIC = 4.0
"""Power over the irregular structure's, from which on a wave at a place of a lattice is taken to be there."""
FOLDED = 0.25
"""How much the power counts of a wave beyond Nyquist, against that of one below that pixels cannot tell from it."""
CROWD = 900
"""Places of a lattice that are fitted at most, those of the highest power."""
HEARD = 0.1
"""Share of a given threshold's power that the picture's spectrum must have at a place for a wave to be fitted there."""


class RegularPart(NamedTuple):
    """The regular waves of a picture.

    Parameters
    ----------
    waves
        At ``orders @ fundamentals``, fitted.
    kept
        ``(n, C)``: the channels in which each stands out of the irregular structure.
    fundamentals
        ``(g, 2)`` cycles/px.
    orders
        ``(n, g)`` whole numbers.
    groups
        How many fundamentals, 1 or 2, each group has; they follow each other in ``fundamentals``.
    weights
        ``(n, C)``: the inverse of the irregular structure's power at each, 0 where it is not kept.
    """

    waves: Waves
    kept: NDArray[np.bool_]
    fundamentals: Array
    orders: Array
    groups: tuple[int, ...]
    weights: Array


def subtract_waves(waves: Waves, kept: NDArray[np.bool_] | None = None) -> Array:
    """Return the planes subtract_waves the waves."""
    shape = waves.spectrum.shape
    return np.asarray(waves.spectrum.planes - wave_sum(waves.frequencies, *origin_amplitudes(waves, kept), shape))


def _spaced_places(spectrum: Spectrum, fundamentals: Array, groups: tuple[int, ...], least: float) -> Array:
    """Return the orders of places of at least some power, of such as pixels cannot tell apart the one with more."""
    orders = lattice_orders(fundamentals, groups, spectrum.size)
    power = (np.abs(spectrum.values(fold_frequencies(orders @ fundamentals))) ** 2).sum(1)
    orders, power = orders[power >= least], power[power >= least]
    f = orders @ fundamentals
    power *= np.where((np.abs(f) < 0.5).all(1), 1, FOLDED)
    best = np.argsort(-power, kind="stable")[:CROWD]
    return np.asarray(orders[best[select_spaced(fold_frequencies(f[best]), power[best], spectrum.size)]])


def _limit(spectrum: Spectrum, threshold: float | None) -> float:
    """Return the power of a wave of the threshold's amplitude; 0 where there is none."""
    height, width = spectrum.shape
    return ((threshold or 0.0) / 255 * height * width / 2) ** 2


def find_harmonics(
    spectrum: Spectrum, fundamentals: Array, groups: tuple[int, ...], threshold: float | None, most: int
) -> RegularPart:
    """Return all harmonics of the groups that stand out of the irregular structure."""
    limit = _limit(spectrum, threshold)
    orders = _spaced_places(spectrum, fundamentals, groups, HEARD * limit)
    f = fold_frequencies(orders @ fundamentals)
    waves = FixedWaves(spectrum, f)
    floor = line_floor(np.abs(Spectrum(subtract_waves(waves)).bins()) ** 2, spectrum.shape, f, f)
    power, least = wave_powers(waves), 1e-12 * spectrum.energy.max() * spectrum.size.prod()
    if threshold is None:
        kept = power > HARMONIC * floor + least
    else:
        kept = power > limit
        kept |= kept.any(1, keepdims=True)
    weights = kept / np.maximum(floor, least)
    there = np.flatnonzero(kept.any(1))
    there = there[np.argsort(-power[there].sum(1), kind="stable")[:most]]
    return RegularPart(FixedWaves(spectrum, f[there]), kept[there], fundamentals, orders[there], groups, weights[there])
