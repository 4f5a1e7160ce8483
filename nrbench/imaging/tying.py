"""Tying: waves sorted into groups of whole combinations of common fundamentals, and fitted jointly."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from nrbench.imaging.dirichlet import Array
from nrbench.imaging.harmonic_fit import Fit, refine
from nrbench.imaging.pursuit import APART, Found
from nrbench.lattice.fundamentals import Basis, Waveset, find_fundamental, find_fundamentals

TOLERANCE = 0.05
"""Bins that a wave may lie off its lattice beside its own error: departures from regularity shift waves."""
SHIFT = math.sqrt(6) / (2 * math.pi)
"""Standard error of a wave's frequency, bins a component, times the root of its power over the noise's: the Cramer-Rao
bound sqrt(24) / (2 pi) noise / (amplitude sqrt(n)), with amplitude^2 n / (4 noise^2) for that ratio."""
EMPHASIS = 0.75
"""Exponent of a wave's energy in its weight: 1 leaves the strongest alone to decide, 0 lets a crowd of faint ones."""
CONVINCED = 14.0
"""Log-likelihood, beyond the two best waves, above which two fundamentals are a lattice: odds of a million to one, as
ten thousands of pairs were tried. About four waves of a lattice reach it."""
MOST_GROUPS = 16


class Tied(NamedTuple):
    """Groups of waves on common fundamentals.

    Parameters
    ----------
    fit
        Of the waves' frequencies, ``orders @ fit.fundamentals``.
    orders
        ``(n, g)`` whole numbers.
    groups
        How many fundamentals, 1 or 2, each group has; they follow each other in ``fit.fundamentals``.
    """

    fit: Fit
    orders: Array
    groups: tuple[int, ...]


def waveset(found: Found, members: NDArray[np.intp] | None = None, tolerance: float = TOLERANCE) -> Waveset:
    """Return what is known of where waves lie, in bins, in the order given; the strongest should be first."""
    waves, energy = found.waves, found.powers.sum(1)
    chosen = np.arange(len(energy)) if members is None else members
    spreads = np.hypot(SHIFT / np.sqrt(np.maximum(found.ratios.max(1)[chosen], 1)), tolerance)
    weights = (energy[chosen] / max(float(energy[chosen].max(initial=0)), 1e-300)) ** EMPHASIS
    return Waveset(waves.frequencies[chosen] * waves.spectrum.size, spreads, weights)


def tie(found: Found, threshold: float | None, false_alarms: float, most: int) -> Tied:
    """Return the waves as groups on common fundamentals, fitted jointly, with the waves that belong to them added.

    The strongest lattice of frequencies first; it is taken out, and the rest make another group, as long as waves are
    left: two overlapping lattices are two groups, pinstripes one of one fundamental, a stray wave one by itself.
    A place of the lattices is known, so a wave there need only exceed what noise reaches at so few places.

    Parameters
    ----------
    found
        The waves of a picture.
    threshold, false_alarms, most
        As for :func:`~nrbench.imaging.pursuit.pursue`.
    """
    spectrum = found.waves.spectrum
    tied = _grouped(found)
    orders = np.concatenate([tied.orders, _missing(found, tied, threshold, false_alarms)])[:most]
    fit = refine(spectrum, tied.fit.fundamentals, orders)
    return Tied(fit, orders, tied.groups)


def _grouped(found: Found) -> Tied:
    """Return all waves in groups, the strongest group first, fitted jointly."""
    left = np.argsort(-found.powers.sum(1), kind="stable")
    total, vectors, blocks = len(left), list[Array](), list[Array]()
    sizes: list[int] = []
    while len(left):
        basis = _next_basis(waveset(found, left)) if len(sizes) < MOST_GROUPS else _alone(found, left)
        block = np.zeros((total, len(basis.vectors)))
        block[left[basis.explained]] = basis.orders[basis.explained]
        vectors, blocks, sizes = [*vectors, basis.vectors], [*blocks, block], [*sizes, len(basis.vectors)]
        left = left[~basis.explained]
    if not sizes:
        return Tied(Fit(np.zeros((0, 2)), found.waves), np.zeros((0, 0)), ())
    size = found.waves.spectrum.size
    orders = np.concatenate(blocks, 1)
    return Tied(refine(found.waves.spectrum, np.concatenate(vectors) / size, orders), orders, tuple(sizes))


def _next_basis(waves: Waveset) -> Basis:
    """Return two fundamentals where they explain more waves than any two would; else one."""
    pair = find_fundamentals(waves)
    if pair is not None and np.linalg.matrix_rank(pair.orders[pair.explained]) == 2:
        evidence = np.where(pair.explained, pair.evidence / waves.weights, 0)
        if evidence.sum() - np.sort(evidence)[-2:].sum() > CONVINCED:
            return pair
    return find_fundamental(waves)


def _alone(found: Found, left: NDArray[np.intp]) -> Basis:
    """Return the strongest wave as a group of its own."""
    places = waveset(found, left).places
    first = np.arange(len(left)) == 0
    return Basis(places[:1], first[:, np.newaxis].astype(np.float64), first, first.astype(np.float64))


def _missing(found: Found, tied: Tied, threshold: float | None, false_alarms: float) -> Array:
    """Return the orders of further waves of the groups, ``(m, g)``, strongest first."""
    waves, spectrum = tied.fit.waves, found.waves.spectrum
    orders = _places(tied, spectrum.size)
    f = orders @ tied.fit.fundamentals
    free = ~_taken(f, waves.frequencies, spectrum.size)
    orders, f = orders[free], f[free]
    if not len(f):
        return orders
    power = np.abs(waves.residual(f)) ** 2
    if threshold is None:
        limit = found.at_bins(f, found.floor) * math.log(power.size / false_alarms)
        limit = np.maximum(limit, found.at_bins(f, found.limit).min() * 1e-3)
    else:
        limit = found.at_bins(f, found.limit)
    above = np.flatnonzero((power > limit).any(1))
    return np.asarray(orders[above[np.argsort(-power[above].sum(1), kind="stable")]])


def _places(tied: Tied, size: Array) -> Array:
    """Return the orders of every place of every group of more than one wave, within half a cycle/px."""
    rows, start = [np.zeros((0, tied.orders.shape[1]))], 0
    for count in tied.groups:
        block, columns = tied.orders[:, start : start + count], np.arange(start, start + count)
        start += count
        if (block != 0).any(1).sum() > 1:
            grid = _half_grid(tied.fit.fundamentals[columns], size)
            row = np.zeros((len(grid), tied.orders.shape[1]))
            row[:, columns] = grid
            rows.append(row)
    return np.concatenate(rows)


def _half_grid(fundamentals: Array, size: Array) -> Array:
    """Return the orders of one of each pair f, -f within the spectrum, none within a bin of its borders."""
    reach = np.ceil(np.abs(np.linalg.pinv(fundamentals)).sum(0) / 2).astype(int)
    axes = [np.arange(-r, r + 1) for r in reach]
    orders = np.stack(np.meshgrid(*axes, indexing="ij"), -1).reshape(-1, len(reach)).astype(np.float64)
    f = orders @ fundamentals
    inside = (np.abs(f) < 0.5 - 1 / size).all(1) & (np.hypot(*(f * size).T) > 1)
    half = (orders[:, 0] > 0) | ((orders[:, 0] == 0) & (orders[:, -1] > 0))
    return np.asarray(orders[inside & half])


def _taken(f: Array, others: Array, size: Array) -> NDArray[np.bool_]:
    if not len(others):
        return np.zeros(len(f), np.bool_)
    apart = [np.hypot(*np.moveaxis((f[:, np.newaxis] - sign * others) * size, 2, 0)).min(1) for sign in (1, -1)]
    return np.asarray(np.minimum(*apart) < APART)
