"""Agreement beyond chance: Cohen's kappa of two raters, its mean over pairs, and its interval over textures."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from nrbench.streams import stream

from .statistics import RESAMPLES, Estimate, expanded_tail

Tables = NDArray[np.float64]
"""``(..., k, k)``: how often the first rater said i and the second j."""


def tables(
    first: Sequence[str], second: Sequence[str], units: Sequence[str], words: Sequence[str], known: Sequence[str]
) -> Tables:
    """Return the confusion table of each unit, ``(len(known), k, k)``.

    Parameters
    ----------
    first, second
        What each rater said of each item.
    units
        The unit (texture) that each item belongs to.
    words
        The k answers, in the table's order.
    known
        All units, in the result's order.
    """
    found = np.zeros((len(known), len(words), len(words)))
    for a, b, unit in zip(first, second, units, strict=True):
        found[known.index(unit), words.index(a), words.index(b)] += 1
    return found


def kappa(table: Tables) -> NDArray[np.float64]:
    """Return Cohen's kappa of confusion tables, in [-1, 1]; NaN where both raters always gave one and the same answer.

    Notes
    -----
    (p_o - p_e) / (1 - p_e), p_o the share of equal answers, p_e what two raters with these shares of answers share by
    chance: J. Cohen, "A coefficient of agreement for nominal scales", Educational and Psychological Measurement 20,
    1960. Always one answer leaves nothing beyond chance to be seen.
    """
    total = table.sum((-2, -1))
    with np.errstate(divide="ignore", invalid="ignore"):
        observed = np.trace(table, axis1=-2, axis2=-1) / total
        chance = (table.sum(-1) * table.sum(-2)).sum(-1) / total**2
        found: NDArray[np.float64] = np.where(chance < 1 - 1e-12, (observed - chance) / (1 - chance), np.nan)
    return found


def mean_kappa(pairs: Tables) -> Estimate:
    """Return the mean kappa over pairs of raters, with its bootstrap interval over textures.

    Textures are drawn with replacement, all pairs and all answers to a texture together, because answers to outputs of
    one texture are not independent evidence; the ends are expanded percentiles as in
    :func:`~nrbench.reports.statistics.statistics.bootstrap_mean`. Draws in which no pair has a kappa are left out; there is no
    interval where these are more than half, or for fewer than two textures. Time and memory grow with pairs times
    textures times resamples.

    Parameters
    ----------
    pairs
        ``(pairs, textures, k, k)``: the :func:`tables` of each pair.

    Returns
    -------
    Estimate
        ``n`` and ``of`` count textures: those with an answer of every pair, and all.
    """
    seen = pairs.sum((-2, -1)) > 0
    n, of = int(seen.all(0).sum()) if len(pairs) else 0, pairs.shape[1]
    value = _mean(kappa(pairs.sum(1))[:, None])
    if not np.isfinite(value).all() or int(seen.any(0).sum()) < 2:
        return Estimate(float(value[0]) if np.isfinite(value).all() else None, n=n, of=of)
    kept = pairs[:, seen.any(0)]
    units = kept.shape[1]
    weights = stream("bootstrap").multinomial(units, np.full(units, 1 / units), RESAMPLES).astype(np.float64)
    drawn = _mean(kappa(np.einsum("bt,ptij->pbij", weights, kept, optimize=True)))
    drawn = drawn[np.isfinite(drawn)]
    if len(drawn) < RESAMPLES / 2:
        return Estimate(float(value[0]), n=n, of=of)
    tail = expanded_tail(units)
    low, high = np.quantile(drawn, [tail, 1 - tail])
    return Estimate(float(value[0]), float(low), float(high), n, of)


def _mean(values: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the mean over the first axis of what is known; NaN where nothing is."""
    known = np.isfinite(values)
    count = known.sum(0)
    total = np.where(known, values, 0).sum(0)
    return np.where(count > 0, total / np.maximum(count, 1), np.nan)
