"""Tying: waves sorted into groups of whole combinations of common fundamentals, and fitted jointly."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from nrbench.lattice.geometry import shortest_pair
from nrbench.lattice.sublattices import hermite_matrices
from nrbench.spectra.dirichlet import Array
from nrbench.spectra.fundamentals import Basis, Peaks, find_fundamental, find_fundamentals
from nrbench.spectra.pursuit import FoundWaves
from nrbench.spectra.supercell_test import is_supercell

TOLERANCE = 0.05
"""Bins that a wave may lie off its lattice beside its own error: departures from regularity shift waves."""
SHIFT = math.sqrt(6) / (2 * math.pi)
"""Standard error of a wave's frequency, bins a component, times the root of its power over the noise's: the Cramer-Rao
bound sqrt(24) / (2 pi) noise / (amplitude sqrt(n)), with amplitude^2 n / (4 noise^2) for that ratio."""
EMPHASIS = 0.75
"""Exponent of a wave's energy in its weight: 1 leaves the strongest alone to decide, 0 lets a crowd of faint ones."""
CONVINCED = 14.0
"""Log-likelihood, surplus_evidence the two best waves, above which two fundamentals are a lattice: odds of a million to one, as
ten thousands of pairs were tried. About four waves of a lattice reach it."""
SUPPORTED = 3.0
"""The same of the waves off one line, without the best of them: one more at least, or stripes of any profile would be a
lattice with any other wave."""
UNCERTAINTIES = (0.03, 0.01, 0.003)
"""Of given fundamentals, before and after they are fitted."""
LARGEST_INDEX = 6
"""Index of the finest lattice of frequencies that is tried where waves are left between the places of one."""
BETWEEN = 4
"""Waves between the places that prove it, at least."""
MAJORITY = 0.6
"""Share of the power of what is left that they have, at least: of irregular waves, some lie there by chance."""
MOST_GROUPS = 16
REPEATED = 2.0
"""Bins: of a fundamental below that the picture holds fewer than two periods, so that parts of a tile are seen once."""


def peaks_of(found: FoundWaves, members: NDArray[np.intp] | None = None, tolerance: float = TOLERANCE) -> Peaks:
    """Return what is known of where waves lie, in bins, in the order given; the strongest should be first."""
    waves, energy = found.waves, found.powers.sum(1)
    chosen = np.arange(len(energy)) if members is None else members
    spreads = np.hypot(SHIFT / np.sqrt(np.maximum(found.ratios.max(1)[chosen], 1)), tolerance)
    weights = (energy[chosen] / max(float(energy[chosen].max(initial=0)), 1e-300)) ** EMPHASIS
    return Peaks(waves.frequencies[chosen] * waves.spectrum.size, spreads, weights)


def propose_basis(waves: Peaks) -> Basis:
    """Return two fundamentals where they explain more waves than any two would, some off one line; else one."""
    pair = find_fundamentals(waves)
    if pair is None or surplus_evidence(pair, waves) <= CONVINCED or off_line_evidence(pair, waves) <= SUPPORTED:
        return find_fundamental(waves)
    return pair


def off_line_evidence(basis: Basis, waves: Peaks) -> float:
    """Return the evidence of waves that lie off the one line with the most of it, the best of them left out."""
    evidence = (basis.evidence / waves.weights)[basis.explained]
    x, y = basis.orders[basis.explained].T
    line = int(np.argmax((np.outer(x, y) == np.outer(y, x)) @ evidence))
    off = evidence[x * y[line] != y * x[line]]
    return float(off.sum() - off.max(initial=0))


def surplus_evidence(basis: Basis, waves: Peaks) -> float:
    """Return the evidence of the waves surplus_evidence the best ones, which any such fundamentals would explain."""
    evidence = np.sort(np.where(basis.explained, basis.evidence / waves.weights, 0))
    return float(evidence[: -len(basis.vectors)].sum())


def fit_given_fundamentals(found: FoundWaves, given: Array) -> tuple[Array, Array]:
    """Return given fundamentals fitted to the waves near their whole combinations, and those waves' orders.

    Parameters
    ----------
    found
        Waves of a picture.
    given
        ``(2, 2)`` cycles/px, right within about 2 %; they are returned where too few waves are near.

    Returns
    -------
    tuple
        ``(2, 2)`` cycles/px, and ``(n, 2)`` whole numbers.
    """
    places, vectors = found.waves.frequencies * found.waves.spectrum.size, given * found.waves.spectrum.size
    weights = np.sqrt(found.powers.sum(1))[:, np.newaxis]
    orders = np.eye(2)
    for uncertainty in UNCERTAINTIES:
        numbers = np.rint(places @ np.linalg.inv(vectors))
        misses = np.hypot(*(places - numbers @ vectors).T)
        near = (misses < uncertainty * np.hypot(*places.T) + 2 * TOLERANCE) & numbers.any(1)
        if np.linalg.matrix_rank(numbers[near]) < 2:
            break
        orders = numbers[near]
        vectors = np.linalg.lstsq(orders * weights[near], places[near] * weights[near], rcond=None)[0]
    return vectors / found.waves.spectrum.size, orders


def find_finer_fundamentals(
    found: FoundWaves, order: NDArray[np.intp], fundamentals: Array
) -> tuple[Array, Array] | None:
    """Return a finer lattice of frequencies, a larger tile, at which most of what one leaves lies; None if at none.

    Parameters
    ----------
    found
        Waves of what the lattice leaves of a picture.
    order
        Those that count.
    fundamentals
        ``(2, 2)`` cycles/px.

    Returns
    -------
    tuple or None
        The fundamentals, ``(2, 2)`` cycles/px, of the lowest index, and the waves' orders, ``(n, 2)``.
    """
    size = found.waves.spectrum.size
    f, power = found.waves.frequencies[order], found.powers[order].sum(1)
    for index in range(2, LARGEST_INDEX + 1):
        for form in hermite_matrices(index):
            finer = form @ fundamentals / index
            orders = np.rint(f @ np.linalg.inv(finer))
            near = np.hypot(*((f - orders @ finer) * size).T) < 3 * TOLERANCE
            most = near.sum() >= BETWEEN and power[near].sum() > MAJORITY * power.sum()
            seen = most and shortest_length(finer * size) >= REPEATED
            if seen and is_supercell(found.waves.spectrum, orders[near] @ finer, fundamentals):
                return finer, orders[near]
    return None


def shortest_length(vectors: Array) -> float:
    """Return the length of the shortest_length vector of the lattice that one or two vectors ``(1 or 2, 2)`` span."""
    first = shortest_pair(vectors)[0] if len(vectors) == 2 else vectors[0]
    return float(np.hypot(*first))
