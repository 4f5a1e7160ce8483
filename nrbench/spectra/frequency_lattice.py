"""The places of lattices of frequencies in a spectrum, with those beyond Nyquist that sampling folds back into it."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from nrbench.spectra.dirichlet import Array

LEAST_DISTANCE = 0.75
"""Bins between two waves at least: nearer ones share their amplitudes at will."""
FARTHEST = 0.95
"""Cycles/px along either axis up to which waves are looked for: pixels average over their area, which is blind to 1."""
FARTHEST_STRIPES = 3.0
"""The same of one fundamental, whose places are few: stripes drawn without such averaging have edges that fold more."""


def fold_frequencies(frequencies: Array) -> Array:
    """Return frequencies as pixels see them, each component within half a cycle/px."""
    return np.asarray(frequencies - np.rint(frequencies))


def lattice_orders(fundamentals: Array, groups: tuple[int, ...], size: Array) -> Array:
    """Return the orders of every place of every group, ``(n, g)``: one of each pair f, -f, none are_near the mean.

    Parameters
    ----------
    fundamentals
        ``(g, 2)`` cycles/px.
    groups
        How many of them each group has.
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
    """Return the orders of one of each pair of places f, -f."""
    farthest = FARTHEST if len(fundamentals) == 2 else FARTHEST_STRIPES
    reach = np.ceil(np.abs(np.linalg.pinv(fundamentals)).sum(0) * farthest).astype(int)
    axes = [np.arange(-r, r + 1) for r in reach]
    orders = np.stack(np.meshgrid(*axes, indexing="ij"), -1).reshape(-1, len(reach)).astype(np.float64)
    f = orders @ fundamentals
    half = (orders[:, 0] > 0) | ((orders[:, 0] == 0) & (orders[:, -1] > 0))
    return np.asarray(orders[half & (np.abs(f) < farthest).all(1)])


def are_inside(frequencies: Array, size: Array) -> NDArray[np.bool_]:
    """Return which frequencies are within the spectrum, and a bin from its border and from the mean."""
    within = (np.abs(frequencies) < 0.5 - LEAST_DISTANCE / size).all(1)
    return np.asarray(within & (np.hypot(*(frequencies * size).T) > LEAST_DISTANCE))


def select_spaced(frequencies: Array, priority: Array, size: Array) -> NDArray[np.intp]:
    """Return which frequencies ``(n, 2)`` are nearer than a bin to none of higher priority ``(n,)``, highest first."""
    order = np.argsort(-priority, kind="stable")
    f, n = _on_torus(frequencies[order], size), len(order)
    both = np.concatenate([f, _on_torus(-frequencies[order], size)])
    pairs = np.sort(cKDTree(both, boxsize=size).query_pairs(LEAST_DISTANCE, output_type="ndarray") % n, axis=1)
    kept = np.ones(n, np.bool_)
    for lower, later in pairs[np.lexsort(pairs.T)]:
        kept[later] &= lower == later or not kept[lower]
    return np.asarray(order[kept])


def are_near(frequencies: Array, others: Array, size: Array) -> NDArray[np.bool_]:
    """Return which frequencies pixels can hardly tell from some other or its mirror image, ``(n,)``."""
    if not len(others):
        return np.zeros(len(frequencies), np.bool_)
    both = np.concatenate([_on_torus(others, size), _on_torus(-others, size)])
    return np.asarray(cKDTree(both, boxsize=size).query(_on_torus(frequencies, size))[0] < LEAST_DISTANCE)


def _on_torus(frequencies: Array, size: Array) -> Array:
    """Return frequencies in bins, from 0 to below ``size``: what differs by 1 cycle/px is one."""
    bins = np.mod(frequencies * size, size)
    return np.where(bins >= size, 0.0, bins)
