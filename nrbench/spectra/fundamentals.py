"""Fundamentals: the coarsest lattice of frequencies whose whole combinations explain the waves of a texture."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

STRAY = 0.1
"""Prior share of waves that belong to no lattice."""
PROPOSERS = 12
"""Only so many of the strongest waves, with their sums and differences, propose fundamentals."""
SHORTEST = 1.5
"""Bins: a fundamental below that has fewer than 1.5 periods in the picture, and nothing repeats."""
FINALISTS = 20
"""Pairs that are fitted to the waves, the best by their first evidence."""


class Peaks(NamedTuple):
    """The waves to be explained, strongest first.

    Parameters
    ----------
    places
        ``(n, 2)``: frequencies in bins.
    spreads
        ``(n,)``: standard error of each component, bins.
    weights
        ``(n,)``: how much each counts.
    """

    places: Array
    spreads: Array
    weights: Array


class Basis(NamedTuple):
    """Fundamentals of a set of waves.

    Parameters
    ----------
    vectors
        ``(1 or 2, 2)`` bins, rows.
    orders
        ``(n, 1 or 2)`` whole numbers: each wave's nearest combination.
    explained
        ``(n,)``: which waves lie nearer to theirs than chance has it.
    evidence
        ``(n,)``: log-likelihood of each wave's place against a place anywhere.
    """

    vectors: Array
    orders: Array
    explained: NDArray[np.bool_]
    evidence: Array


def find_fundamentals(waves: Peaks, finalists: int = FINALISTS) -> Basis | None:
    """Return the two fundamentals with the highest evidence; None where no two independent waves are.

    A wave of the lattice lies at one of its points, but for its error; any other wave lies anywhere. The ratio of the
    two densities, area / (2 pi s^2) exp(-d^2 / 2 s^2) with the area of the lattice's cell, is the evidence of one wave:
    so a lattice k times finer pays log k for every wave it explains, and wins only where it explains waves that the
    coarser one leaves. That is the coarsest lattice of frequencies, the smallest tile, and no lattice is preferred for
    holding the lowest waves: they may be missing.

    Proposed are the strongest waves, their sums and differences, in pairs; the best, fitted to all waves that they
    explain, then compete with their own sublattices and superlattices of index 2 and 3.

    Parameters
    ----------
    waves
        Strongest first.
    finalists
        How many pairs are fitted, at least 1.
    """
    steps = _proposals(waves)
    pairs = _pairs(steps)
    if not len(pairs):
        return None
    rough = _evidence(pairs, waves, 3.0).sum(1)
    best: tuple[float, Array] | None = None
    for k in np.argsort(-rough, kind="stable")[:finalists]:
        fitted = _fitted(pairs[k], waves)
        score = float(_evidence(fitted[np.newaxis], waves, 1.0).sum())
        if best is None or score > best[0] + 1e-9:
            best = score, fitted
    assert best is not None
    return _basis(_descended(*best, waves), waves)


def find_fundamental(waves: Peaks) -> Basis:
    """Return the fundamental on whose multiples the strongest wave (at least one) and most on its line lie."""
    first = waves.places[0]
    best: tuple[float, Array] | None = None
    for divisor in range(1, 9):
        vector = first / divisor
        if np.hypot(*vector) < SHORTEST and divisor > 1:
            break
        fitted = _fitted(vector[np.newaxis], waves)
        score = float(_evidence(fitted[np.newaxis], waves, 1.0).sum())
        if best is None or score > best[0] + 1e-9:
            best = score, fitted
    assert best is not None
    return _basis(best[1], waves)


def _proposals(waves: Peaks) -> Array:
    leaders = waves.places[:PROPOSERS]
    i, j = np.triu_indices(len(leaders), 1)
    steps = np.concatenate([leaders, leaders[i] + leaders[j], leaders[i] - leaders[j]])
    steps = np.where((steps[:, :1] < 0) | ((steps[:, :1] == 0) & (steps[:, 1:] < 0)), -steps, steps)
    steps = steps[np.hypot(*steps.T) >= SHORTEST]
    _, first = np.unique(np.rint(steps * 4), axis=0, return_index=True)
    return np.asarray(steps[np.sort(first)])


def _pairs(steps: Array) -> Array:
    """Return the reduced pairs of independent steps, ``(m, 2, 2)``."""
    i, j = np.triu_indices(len(steps), 1)
    a, b = _reduced(steps[i], steps[j])
    fine = _are_sound(a, b)
    pairs = np.stack([a, b], 1)[fine]
    _, first = np.unique(np.rint(np.abs(pairs.reshape(-1, 4)) * 8), axis=0, return_index=True)
    return np.asarray(pairs[np.sort(first)])


def _are_sound(a: Array, b: Array) -> NDArray[np.bool_]:
    """Return which reduced pairs are independent and not shorter than is allowed."""
    area, short = np.abs(a[:, 0] * b[:, 1] - a[:, 1] * b[:, 0]), np.hypot(*a.T)
    return np.asarray((short >= SHORTEST) & (area > 0.2 * short * np.hypot(*b.T)))


def _reduced(a: Array, b: Array) -> tuple[Array, Array]:
    """Return Lagrange-Gauss reduced pairs, shorter first, all at once."""
    for _ in range(12):
        swap = ((a**2).sum(1) > (b**2).sum(1))[:, np.newaxis]
        a, b = np.where(swap, b, a), np.where(swap, a, b)
        steps = np.rint((a * b).sum(1) / np.maximum((a**2).sum(1), 1e-12))
        if not steps.any():
            break
        b = b - steps[:, np.newaxis] * a
    swap = ((a**2).sum(1) > (b**2).sum(1))[:, np.newaxis]
    return np.where(swap, b, a), np.where(swap, a, b)


def _split(bases: Array, places: Array) -> tuple[Array, Array]:
    """Return each place's nearest orders ``(m, n, g)`` and its squared distance from there, bins^2, ``(m, n)``."""
    orders = np.rint(places @ np.linalg.pinv(bases))
    return orders, ((places - orders @ bases) ** 2).sum(2)


def _evidence(bases: Array, waves: Peaks, slack: float) -> Array:
    """Return the evidence of each wave for each basis, ``(m, n)``; ``slack`` widens the errors of unfitted bases."""
    orders, square = _split(bases, waves.places)
    variance = (slack * waves.spreads) ** 2
    area = _areas(bases)[:, np.newaxis]
    near = (1 - STRAY) * area / (2 * np.pi * variance) * np.exp(-square / (2 * variance))
    near = np.where((orders == 0).all(2), 0.0, near)
    return np.asarray(waves.weights * np.log(near + STRAY))


def _areas(bases: Array) -> Array:
    """Return the areas of the cells; for one fundamental, its length times that of the shortest that could be."""
    if bases.shape[1] == 2:
        return np.asarray(np.abs(np.linalg.det(bases)))
    return np.asarray(np.hypot(*bases[:, 0].T) * SHORTEST)


def _fitted(basis: Array, waves: Peaks) -> Array:
    """Return a basis fitted by weighted least squares to the waves it explains, twice."""
    for slack in (3.0, 1.5):
        explained = _evidence(basis[np.newaxis], waves, slack)[0] > 0
        orders = _split(basis[np.newaxis], waves.places)[0][0][explained]
        if np.linalg.matrix_rank(orders) < len(basis):
            break
        weights = 1 / waves.spreads[explained, np.newaxis]
        moved = np.linalg.lstsq(orders * weights, waves.places[explained] * weights, rcond=None)[0]
        if not _is_sound(moved):
            break
        basis = moved
    return basis


def _is_sound(basis: Array) -> bool:
    """Return whether no combination is shorter than is allowed, and two are independent."""
    if len(basis) == 1:
        return bool(np.hypot(*basis[0]) > 0)
    return bool(_are_sound(*_reduced(basis[:1], basis[1:]))[0])


def _descended(score: float, basis: Array, waves: Peaks) -> Array:
    """Return the best basis among a basis and, again and again, its relatives of small index."""
    while True:
        relatives = [_fitted(_reduced_pair(change @ basis), waves) for change in _CHANGES]
        relatives = [r for r in relatives if _is_sound(r)]
        scores = [float(_evidence(r[np.newaxis], waves, 1.0).sum()) for r in relatives]
        if not scores or max(scores) <= score + 1e-6:
            return _reduced_pair(basis)
        score, basis = max(scores), relatives[int(np.argmax(scores))]


def _reduced_pair(basis: Array) -> Array:
    a, b = _reduced(basis[:1], basis[1:])
    return np.concatenate([a, b])


def _relatives() -> list[Array]:
    """Return the changes of basis to all sublattices of index 2 and 3 (Hermite normal forms), and back."""
    forms = [
        np.array([[a, b], [0, k // a]], np.float64)
        for k in (2, 3)
        for a in range(1, k + 1)
        if k % a == 0
        for b in range(k // a)
    ]
    return forms + [np.asarray(np.linalg.inv(form), np.float64) for form in forms]


_CHANGES = _relatives()


def _basis(vectors: Array, waves: Peaks) -> Basis:
    evidence = _evidence(vectors[np.newaxis], waves, 1.0)[0]
    orders = _split(vectors[np.newaxis], waves.places)[0][0]
    return Basis(vectors, orders, evidence > 0, evidence)
