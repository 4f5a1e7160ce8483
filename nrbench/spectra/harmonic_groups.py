"""Groups of harmonics: the fundamentals whose integer combinations are the frequencies of a picture's waves."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
import scipy
from numpy.typing import NDArray

from nrbench.lattice.geometry import hermite_matrices, reduce_bases, reduce_basis
from nrbench.spectra.spectrum import Array, Spectrum
from nrbench.spectra.wave_fit import Waves
from nrbench.spectra.wave_search import WaveDetection

LEAST_DISTANCE = 0.75
"""Bins: least distance of two waves. The amplitudes of nearer waves cannot be separated."""
FARTHEST = 0.95
"""Cycles/px along either axis up to which harmonics are examined. A pixel is the mean over its area, so that waves of
1 cycle/px have no effect."""
FARTHEST_STRIPES = 3.0
"""The same for groups of one fundamental, which have few harmonics. Stripes that are drawn without averaging over
pixels have harmonics far beyond 1 cycle/px."""

STRAY_SHARE = 0.1
"""Prior share of waves that belong to no lattice."""
PROPOSERS = 12
"""Number of the strongest waves that, with their sums and differences, propose fundamentals."""
SHORTEST = 1.5
"""Bins: least length of a fundamental. Shorter ones have fewer than 1.5 periods in the picture."""
FINALISTS = 20
"""Number of pairs of fundamentals that are fitted to the waves: those of the highest evidence before the fit."""

TOLERANCE = 0.05
"""Bins: standard deviation of a wave from its lattice in addition to its own error, because departures from regularity
shift waves."""
SHIFT = math.sqrt(6) / (2 * math.pi)
"""Bins: standard error of each component of a wave's frequency, times the root of the ratio of its power to that of the
noise. The Cramer-Rao bound is sqrt(24) / (2 pi) noise / (amplitude sqrt(n)), the ratio amplitude^2 n / (4 noise^2)."""
EMPHASIS = 0.75
"""Exponent of a wave's energy in its weight. With 1 the strongest waves decide; with 0 the many faint waves decide."""
LATTICE_EVIDENCE = 14.0
"""Least evidence (a log-likelihood ratio) of two fundamentals for a lattice, without their two best waves. The odds are
a million to one because tens of thousands of pairs are tried. About four waves of a lattice reach it."""
OFF_LINE_EVIDENCE = 3.0
"""Least evidence of the waves that do not lie on one line, without the best of them. Otherwise stripes and any single
other wave would be a lattice."""
UNCERTAINTIES = (0.03, 0.01, 0.003)
"""Relative uncertainties of given fundamentals before the first, the second and the third fit."""
LARGEST_INDEX = 6
"""Index of the finest lattice of frequencies that is tried if waves remain between the points of a lattice."""
FEWEST_WAVES = 4
"""Least number of waves at the points of a finer lattice."""
MAJORITY = 0.6
"""Least share of these waves in the residual power. Some irregular waves lie at such points by chance."""
REPEATED = 2.0
"""Bins: least length of a fundamental of which the picture shows two periods. With less, parts of a tile occur once."""
SUPERCELL_CHANCE = 1e-3
"""Probability that a tested tile is accepted although the colors are random."""
FEWEST_SUMS = 3
"""Least number of neighboring sums for the test of a larger tile."""


def fold_frequencies(frequencies: Array) -> Array:
    """Return the aliases of frequencies, with each component within half a cycle/px."""
    return np.asarray(frequencies - np.rint(frequencies))


def lattice_orders(fundamentals: Array, groups: tuple[int, ...], size: Array) -> Array:
    """Return the orders of all harmonics of all groups, ``(n, g)``: one of each pair f, -f, none near the mean.

    Parameters
    ----------
    fundamentals
        ``(g, 2)`` cycles/px.
    groups
        The number of fundamentals, 1 or 2, of each group.
    size
        (width, height) px.
    """
    rows, start = [np.zeros((0, len(fundamentals)))], 0
    for count in groups:
        columns = np.arange(start, start + count)
        start += count
        grid = _orders_of_group(fundamentals[columns])
        row = np.zeros((len(grid), len(fundamentals)))
        row[:, columns] = grid
        rows.append(row)
    orders = np.concatenate(rows)
    return np.asarray(orders[are_inside(fold_frequencies(orders @ fundamentals), size)])


def _orders_of_group(fundamentals: Array) -> Array:
    """Return the orders of the harmonics of one group below :data:`FARTHEST`, ``(n, 1 or 2)``; one of each pair."""
    farthest = FARTHEST if len(fundamentals) == 2 else FARTHEST_STRIPES
    reach = np.ceil(np.abs(np.linalg.pinv(fundamentals)).sum(0) * farthest).astype(int)
    axes = [np.arange(-r, r + 1) for r in reach]
    orders = np.stack(np.meshgrid(*axes, indexing="ij"), -1).reshape(-1, len(reach)).astype(np.float64)
    f = orders @ fundamentals
    half = (orders[:, 0] > 0) | ((orders[:, 0] == 0) & (orders[:, -1] > 0))
    return np.asarray(orders[half & (np.abs(f) < farthest).all(1)])


def are_inside(frequencies: Array, size: Array) -> NDArray[np.bool_]:
    """Return whether each frequency lies in the spectrum, at least a bin from its border and from frequency 0."""
    within = (np.abs(frequencies) < 0.5 - LEAST_DISTANCE / size).all(1)
    return np.asarray(within & (np.hypot(*(frequencies * size).T) > LEAST_DISTANCE))


def select_spaced(frequencies: Array, priority: Array, size: Array) -> NDArray[np.intp]:
    """Return the indices of the frequencies ``(n, 2)`` that keep a distance from all of higher priority ``(n,)``.

    The distance is :data:`LEAST_DISTANCE`, aliases and mirror images included. The highest priority comes first.
    """
    order = np.argsort(-priority, kind="stable")
    f, n = _on_torus(frequencies[order], size), len(order)
    both = np.concatenate([f, _on_torus(-frequencies[order], size)])
    pairs = np.sort(
        scipy.spatial.cKDTree(both, boxsize=size).query_pairs(LEAST_DISTANCE, output_type="ndarray") % n, axis=1
    )
    kept = np.ones(n, np.bool_)
    for lower, later in pairs[np.lexsort(pairs.T)]:
        kept[later] &= lower == later or not kept[lower]
    return np.asarray(order[kept])


def are_near(frequencies: Array, others: Array, size: Array) -> NDArray[np.bool_]:
    """Return whether each frequency, ``(n,)``, is near one of the others or its mirror image, aliases included."""
    if not len(others):
        return np.zeros(len(frequencies), np.bool_)
    both = np.concatenate([_on_torus(others, size), _on_torus(-others, size)])
    return np.asarray(scipy.spatial.cKDTree(both, boxsize=size).query(_on_torus(frequencies, size))[0] < LEAST_DISTANCE)


def _on_torus(frequencies: Array, size: Array) -> Array:
    """Return frequencies in bins, from 0 to below ``size``. Frequencies that differ by 1 cycle/px coincide."""
    bins = np.mod(frequencies * size, size)
    return np.where(bins >= size, 0.0, bins)


class SpectrumPeaks(NamedTuple):
    """The peaks of a spectrum from which fundamentals are estimated, strongest first.

    Parameters
    ----------
    places
        ``(n, 2)``: frequencies in bins.
    spreads
        ``(n,)``: standard error of each component, bins.
    weights
        ``(n,)``: the weight of each peak's evidence.
    """

    places: Array
    spreads: Array
    weights: Array


class Basis(NamedTuple):
    """Fundamentals of a set of peaks.

    Parameters
    ----------
    vectors
        ``(1 or 2, 2)`` bins, rows.
    orders
        ``(n, 1 or 2)`` integers: the combination nearest to each peak.
    explained
        ``(n,)``: whether each peak is more likely at this combination than at a random place.
    evidence
        ``(n,)``: weighted log-likelihood ratio of each peak's place, for the lattice against a random place.
    """

    vectors: Array
    orders: Array
    explained: NDArray[np.bool_]
    evidence: Array


def collect_peaks(
    detection: WaveDetection, members: NDArray[np.intp] | None = None, tolerance: float = TOLERANCE
) -> SpectrumPeaks:
    """Return the peaks of the waves with the indices ``members``, the strongest first; None: all waves, in order."""
    waves, energy = detection.waves, detection.waves.powers.sum(1)
    chosen = np.arange(len(energy)) if members is None else members
    spreads = np.hypot(SHIFT / np.sqrt(np.maximum(detection.ratios.max(1)[chosen], 1)), tolerance)
    weights = (energy[chosen] / max(float(energy[chosen].max(initial=0)), 1e-300)) ** EMPHASIS
    return SpectrumPeaks(waves.frequencies[chosen] * waves.spectrum.size, spreads, weights)


def find_fundamentals(peaks: SpectrumPeaks, finalists: int = FINALISTS) -> Basis | None:
    """Return the two fundamentals with the highest evidence; None if no two peaks are independent.

    A wave of the lattice lies at one of its points, up to an error; any other wave lies at a random place. The evidence
    of a wave is the logarithm of the ratio of the two densities, area / (2 pi s^2) exp(-d^2 / 2 s^2), where area is
    that of the lattice's cell. A lattice that is k times finer loses log k for every wave that it explains. It wins
    only if it explains waves that the coarser lattice does not. The result is the coarsest lattice of frequencies that
    explains the waves, thus the smallest tile. The lowest waves need not be present.

    The strongest peaks, their sums and their differences are paired. The best pairs are fitted to all peaks that they
    explain, and are then compared with their sublattices and superlattices of index 2 and 3.

    Parameters
    ----------
    peaks
        Strongest first.
    finalists
        The number of pairs that are fitted, at least 1.
    """
    pairs = _propose_pairs(peaks)
    if not len(pairs):
        return None
    rough = _rate_orders(pairs, peaks, 3.0)[1].sum(1)
    best = _best_fit(pairs[np.argsort(-rough, kind="stable")[:finalists]], peaks)
    return _basis(_improve_by_index(*best, peaks), peaks)


def find_fundamental(peaks: SpectrumPeaks) -> Basis:
    """Return the fundamental with the highest evidence among the strongest peak and its integer fractions."""
    first = peaks.places[0]
    candidates = [(first / k)[np.newaxis] for k in range(1, 9) if k == 1 or np.hypot(*(first / k)) >= SHORTEST]
    return _basis(_best_fit(np.stack(candidates), peaks)[1], peaks)


def propose_basis(peaks: SpectrumPeaks) -> Basis:
    """Return two fundamentals if their evidence suffices, in total and off its strongest line; else one."""
    pair = find_fundamentals(peaks)
    if (
        pair is None
        or surplus_evidence(pair, peaks.weights) <= LATTICE_EVIDENCE
        or off_line_evidence(pair, peaks.weights) <= OFF_LINE_EVIDENCE
    ):
        return find_fundamental(peaks)
    return pair


def surplus_evidence(basis: Basis, weights: Array) -> float:
    """Return the unweighted evidence of all peaks but the best g, where g is the number of fundamentals.

    Some fundamentals explain any g peaks.
    """
    evidence = np.sort(np.where(basis.explained, basis.evidence / weights, 0))
    return float(evidence[: -len(basis.vectors)].sum())


def off_line_evidence(basis: Basis, weights: Array) -> float:
    """Return the unweighted evidence of the peaks beside the line of most evidence, without the best one."""
    evidence = (basis.evidence / weights)[basis.explained]
    x, y = basis.orders[basis.explained].T
    line = int(np.argmax((np.outer(x, y) == np.outer(y, x)) @ evidence))
    off = evidence[x * y[line] != y * x[line]]
    return float(off.sum() - off.max(initial=0))


def _propose_pairs(peaks: SpectrumPeaks) -> Array:
    """Return reduced pairs of the strongest peaks, their sums and differences, ``(m, 2, 2)``."""
    leaders = peaks.places[:PROPOSERS]
    i, j = np.triu_indices(len(leaders), 1)
    steps = np.concatenate([leaders, leaders[i] + leaders[j], leaders[i] - leaders[j]])
    steps = np.where((steps[:, :1] < 0) | ((steps[:, :1] == 0) & (steps[:, 1:] < 0)), -steps, steps)
    steps = steps[np.hypot(*steps.T) >= SHORTEST]
    steps = steps[_first_of_equal(np.rint(steps * 4))]
    i, j = np.triu_indices(len(steps), 1)
    pairs = reduce_bases(np.stack([steps[i], steps[j]], 1), False)
    pairs = pairs[_are_usable(pairs)]
    return np.asarray(pairs[_first_of_equal(np.rint(np.abs(pairs.reshape(-1, 4)) * 8))])


def _first_of_equal(rows: Array) -> NDArray[np.intp]:
    """Return the first index of each distinct row, ascending, as :func:`numpy.unique`, which takes longer for rows."""
    order = np.lexsort(rows.T)
    ordered = rows[order]
    return np.sort(order[np.append(True, (ordered[1:] != ordered[:-1]).any(1))[: len(order)]])


def _are_usable(pairs: Array) -> NDArray[np.bool_]:
    """Return whether each reduced pair is linearly independent and no shorter than :data:`SHORTEST`."""
    short, long = np.hypot(pairs[..., 0], pairs[..., 1]).T
    return np.asarray((short >= SHORTEST) & (np.abs(_areas(pairs)) > 0.2 * short * long))


def _are_proper(bases: Array) -> NDArray[np.bool_]:
    """Return whether a vector of each basis is not 0, or two vectors, once reduced, pass :func:`_are_usable`."""
    if bases.shape[1] == 1:
        return np.asarray(bases.any((1, 2)))
    return _are_usable(reduce_bases(bases, False))


def _nearest_orders(bases: Array, places: Array) -> tuple[Array, Array]:
    """Return the nearest orders of each place, ``(m, n, g)``, and the squared distances, bins^2, ``(m, n)``.

    Two vectors are linearly independent (:func:`_are_usable`).
    """
    if bases.shape[1] == 1:
        dual = bases / (bases**2).sum(2, keepdims=True)
    else:
        (a, b), (c, d) = bases.transpose(1, 2, 0)
        dual = np.array([(d, -c), (-b, a)]).transpose(2, 0, 1) / _areas(bases)[:, np.newaxis, np.newaxis]
    orders = np.rint(places @ dual.transpose(0, 2, 1))
    apart = places - orders @ bases
    return orders, apart[..., 0] ** 2 + apart[..., 1] ** 2


def _areas(bases: Array) -> Array:
    """Return the signed areas that pairs of vectors ``(m, 2, 2)`` span, ``(m,)``."""
    return np.asarray(bases[:, 0, 0] * bases[:, 1, 1] - bases[:, 0, 1] * bases[:, 1, 0])


def _rate_orders(bases: Array, peaks: SpectrumPeaks, slack: float) -> tuple[Array, Array]:
    """Return the nearest orders of each peak for each basis, ``(m, n, g)``, and the evidence of each, ``(m, n)``.

    ``slack`` widens the errors of bases that are not fitted.
    """
    orders, square = _nearest_orders(bases, peaks.places)
    variance = (slack * peaks.spreads) ** 2
    # For one fundamental, the area is its length times the least length of a fundamental.
    area = np.abs(_areas(bases)) if bases.shape[1] == 2 else np.hypot(*bases[:, 0].T) * SHORTEST
    near = (1 - STRAY_SHARE) * area[:, np.newaxis] / (2 * np.pi * variance) * np.exp(-square / (2 * variance))
    near = np.where(orders.any(2), near, 0.0)
    return orders, np.asarray(peaks.weights * np.log(near + STRAY_SHARE))


def _fit_bases(bases: Array, peaks: SpectrumPeaks) -> Array:
    """Return bases ``(m, g, 2)``, each fitted by weighted least squares to the peaks that it explains, twice."""
    going = np.ones(len(bases), np.bool_)
    for slack in (3.0, 1.5):
        orders, evidence = _rate_orders(bases, peaks, slack)
        explained = orders * (evidence > 0)[..., np.newaxis]
        going &= _span(explained)
        rows = explained.transpose(0, 2, 1) / peaks.spreads**2
        matrices = np.where(going[:, np.newaxis, np.newaxis], rows @ explained, np.eye(bases.shape[1]))
        fitted = np.asarray(np.linalg.solve(matrices, rows @ peaks.places), np.float64)
        going &= _are_proper(fitted)
        bases = np.where(going[:, np.newaxis, np.newaxis], fitted, bases)
    return bases


def _span(orders: Array) -> NDArray[np.bool_]:
    """Return whether orders ``(..., n, g)`` have g dimensions: they are integers, and so is the determinant."""
    return np.asarray(np.linalg.det(np.swapaxes(orders, -1, -2) @ orders) > 0.5)


def _best_fit(bases: Array, peaks: SpectrumPeaks) -> tuple[float, Array]:
    """Fit bases ``(m, g, 2)``, at least one, to the peaks, and return the highest evidence and its vectors."""
    fitted = _fit_bases(bases, peaks)
    scores = _rate_orders(fitted, peaks, 1.0)[1].sum(1)
    best = 0
    for k in range(1, len(scores)):
        best = k if scores[k] > scores[best] + 1e-9 else best
    return float(scores[best]), fitted[best]


_INDEX_FORMS = np.concatenate([hermite_matrices(2), hermite_matrices(3)])
_CHANGES = np.concatenate([_INDEX_FORMS, np.linalg.inv(_INDEX_FORMS)])
"""Changes of basis to all sublattices of index 2 and 3, and to all superlattices."""


def _improve_by_index(score: float, basis: Array, peaks: SpectrumPeaks) -> Array:
    """Replace a basis by a sublattice or superlattice of small index as long as this increases the evidence.

    Peaks along one line say nothing of the second vector. The longer it is, the higher is the evidence, without end.
    """
    while True:
        found = _basis(basis, peaks)
        if not _span(found.orders[found.explained]):
            break
        relatives = _fit_bases(reduce_bases(_CHANGES @ basis, False), peaks)
        relatives = relatives[_are_proper(relatives)]
        scores = _rate_orders(relatives, peaks, 1.0)[1].sum(1)
        if scores.max(initial=-np.inf) <= score + 1e-6:
            break
        score, basis = float(scores.max()), relatives[np.argmax(scores)]
    return np.asarray(reduce_bases(basis[np.newaxis], False)[0])


def _basis(vectors: Array, peaks: SpectrumPeaks) -> Basis:
    orders, evidence = (values[0] for values in _rate_orders(vectors[np.newaxis], peaks, 1.0))
    return Basis(vectors, orders, evidence > 0, evidence)


def fit_given_fundamentals(detection: WaveDetection, given: Array) -> tuple[Array, Array]:
    """Return given fundamentals fitted to the waves near their integer combinations, and those waves' orders.

    Parameters
    ----------
    detection
        Waves of a picture.
    given
        ``(2, 2)`` cycles/px, with an error of at most about 2 %. They are returned unchanged if too few waves are near.

    Returns
    -------
    tuple
        ``(2, 2)`` cycles/px, and ``(n, 2)`` integers.
    """
    size = detection.waves.spectrum.size
    places, vectors = detection.waves.frequencies * size, given * size
    weights = np.sqrt(detection.waves.powers.sum(1))[:, np.newaxis]
    orders = np.eye(2)
    for uncertainty in UNCERTAINTIES:
        numbers = np.rint(places @ np.linalg.inv(vectors))
        misses = np.hypot(*(places - numbers @ vectors).T)
        near = (misses < uncertainty * np.hypot(*places.T) + 2 * TOLERANCE) & numbers.any(1)
        if np.linalg.matrix_rank(numbers[near]) < 2:
            break
        orders = numbers[near]
        vectors = np.linalg.lstsq(orders * weights[near], places[near] * weights[near], rcond=None)[0]
    return vectors / size, orders


def find_finer_fundamentals(
    detection: WaveDetection, order: NDArray[np.intp], fundamentals: Array
) -> tuple[Array, Array] | None:
    """Return a finer lattice of frequencies (a larger tile) that contains most waves of a lattice's residual.

    Parameters
    ----------
    detection
        Waves of the picture less the lattice's waves.
    order
        Indices of the waves that are used.
    fundamentals
        ``(2, 2)`` cycles/px.

    Returns
    -------
    tuple or None
        The fundamentals, ``(2, 2)`` cycles/px, of the lowest index, and the waves' orders, ``(n, 2)``; None if no
        lattice up to :data:`LARGEST_INDEX` contains most of the waves.
    """
    size = detection.waves.spectrum.size
    f, power = detection.waves.frequencies[order], detection.waves.powers[order].sum(1)
    for index in range(2, LARGEST_INDEX + 1):
        for form in hermite_matrices(index):
            finer = form @ fundamentals / index
            orders = np.rint(f @ np.linalg.inv(finer))
            near = np.hypot(*((f - orders @ finer) * size).T) < 3 * TOLERANCE
            most = near.sum() >= FEWEST_WAVES and power[near].sum() > MAJORITY * power.sum()
            seen = most and shortest_length(finer * size) >= REPEATED
            if seen and is_supercell(detection.waves.spectrum, orders[near] @ finer, fundamentals):
                return finer, orders[near]
    return None


def shortest_length(vectors: Array) -> float:
    """Return the length of the shortest vector of the lattice that one or two vectors ``(1 or 2, 2)`` span."""
    first = reduce_basis(vectors)[0] if len(vectors) == 2 else vectors[0]
    return float(np.hypot(*first))


def is_supercell(spectrum: Spectrum, frequencies: Array, fundamentals: Array) -> bool:
    """Return whether waves between the points of a lattice of frequencies indicate a larger tile.

    If the elements depart independently from a lattice, for example threads with random colors, the spectrum of the
    departures repeats with the lattice of frequencies. All waves at the same offset from its points are then
    copies of one random number, and their number is no evidence for a larger tile. The test takes the offset with the
    strongest waves, and compares the sum of their powers with the same sums at distances of one bin and more, on the
    line to the next point. For random colors, the ratio has the F distribution with 2 and 2 n degrees of freedom, where
    n is the number of neighboring sums. If the tile is repeated only twice, there are too few sums for a test, and the
    result is True.

    Parameters
    ----------
    spectrum
        Spectrum of the picture less the lattice's own waves.
    frequencies
        ``(n, 2)`` cycles/px: the waves, integer combinations of the larger tile's fundamentals.
    fundamentals
        ``(2, 2)`` cycles/px: the lattice's.
    """
    waves, size = Waves(spectrum, frequencies), spectrum.size
    offsets = _offsets_from_lattice(frequencies, fundamentals, size)
    powers = (np.abs(waves.transform_at(frequencies)) ** 2).sum(1)
    alike = np.hypot(*np.moveaxis((offsets[:, np.newaxis] - offsets) * size, 2, 0)) < 0.5
    strongest = alike[np.argmax(alike @ powers)]
    offset = offsets[strongest][0] * size
    length = float(np.hypot(*offset))
    steps = np.arange(1, max(int(length), 2))
    if 2 * len(steps) < FEWEST_SUMS:
        return True
    beside = np.concatenate([steps, -steps])[:, np.newaxis] * offset / length / size
    places = frequencies[strongest] + beside[:, np.newaxis]
    sums = (np.abs(waves.residual_at(places.reshape(-1, 2))) ** 2).sum(1).reshape(len(beside), -1).sum(1)
    ratio = float(powers[strongest].sum() / max(float(sums.mean()), 1e-300))
    return ratio > float(scipy.stats.f.isf(SUPERCELL_CHANCE, 2, 2 * len(beside)))


def _offsets_from_lattice(frequencies: Array, fundamentals: Array, size: Array) -> Array:
    """Return the shortest frequencies that differ from the given ones, or from their mirrors, by a lattice point."""
    corners = np.array([(0, 0), (0, 1), (1, 0), (1, 1)]) @ fundamentals
    numbers = frequencies @ np.linalg.inv(fundamentals)
    rests = ((numbers - np.floor(numbers)) @ fundamentals)[:, np.newaxis] - corners
    nearest = np.hypot(*np.moveaxis(rests * size, 2, 0)).argmin(1)
    rest = np.take_along_axis(rests, nearest[:, np.newaxis, np.newaxis], 1)[:, 0]
    mirrored = (rest[:, 0] < -1e-9) | ((np.abs(rest[:, 0]) <= 1e-9) & (rest[:, 1] < 0))
    return np.asarray(np.where(mirrored[:, np.newaxis], -rest, rest))
