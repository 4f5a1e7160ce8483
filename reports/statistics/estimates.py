"""Estimate means, success rates, differences and agreement over textures, each with a 95 % interval.

The texture is the unit: its replicates are averaged first, because draws of one texture are not independent evidence.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache
from typing import Any

import numpy as np
import pandas as pd
from numpy.typing import ArrayLike, NDArray
from scipy.special import ndtr, ndtri, stdtrit
from scipy.stats import kendalltau

from nrbench.streams import stream

LEVEL = 0.95
"""Confidence level of every interval."""
RESAMPLES = 9999
"""Number of bootstrap resamples."""
_BATCH = 256
"""Number of means whose resamples are in memory at the same time."""

ConfusionTables = NDArray[np.float64]
"""``(..., k, k)``: how often the first rater gave answer i and the second gave answer j."""


@dataclass(frozen=True)
class Estimate:
    """A number with its confidence interval and the number of textures that it rests on.

    Parameters
    ----------
    value
        The number; None if no texture was counted.
    low, high
        The ends of the interval; None if too few textures were counted.
    n, of
        Number of textures counted, and of all textures.
    at_most
        Whether the number is an upper bound.
    """

    value: float | None
    low: float | None = None
    high: float | None = None
    n: int = 0
    of: int = 0
    at_most: bool = False

    @property
    def ends(self) -> tuple[float, float] | None:
        """The interval; None if there is none."""
        return None if self.low is None or self.high is None else (self.low, self.high)

    @property
    def excludes_zero(self) -> bool | None:
        """Whether zero lies outside the interval; None if there is no interval."""
        return None if self.ends is None else self.ends[0] > 0 or self.ends[1] < 0

    def columns(
        self, name: str, prefix: str = "", parts: Sequence[str] = ("low", "high", "n", "of")
    ) -> dict[str, float | int | None]:
        """Return the value under a name, and other parts under their own names with a prefix, for a row of a table."""
        return {name: self.value, **{prefix + part: getattr(self, part) for part in parts}}


NO_ESTIMATE = Estimate(None)
"""The estimate of a number that does not exist."""


def wilson_interval(successes: float, n: int) -> tuple[float, float] | None:
    """Compute Wilson's score interval of a proportion.

    This is our own code because ``scipy.stats.binomtest`` accepts only whole numbers of successes, and a texture whose
    replicates disagree counts as a fraction.

    Parameters
    ----------
    successes
        From 0 to n. Fractions are allowed: a sum of shares in [0, 1] scatters less than a sum of zeros and ones with
        the same mean, so the interval is then conservative.
    n
        Number of trials.

    Returns
    -------
    tuple of float or None
        The ends of the interval; None if ``n`` is 0.

    References
    ----------
    E. B. Wilson, "Probable inference, the law of succession, and statistical inference", JASA 22, 1927.

    Examples
    --------
    >>> low, high = wilson_interval(2.5, 9)
    >>> round(low, 2), round(high, 2)
    (0.09, 0.6)
    """
    if n == 0:
        return None
    z = float(ndtri(0.5 + LEVEL / 2))
    share, shrink = successes / n, 1 + z * z / n
    center = (share + z * z / (2 * n)) / shrink
    half = z / shrink * math.sqrt(max(0.0, share * (1 - share)) / n + z * z / (4 * n * n))
    return max(0.0, min(share, center - half)), min(1.0, max(share, center + half))


def estimate_proportion(outcomes: ArrayLike) -> Estimate:
    """Return the share of true ``outcomes`` with Wilson's interval; the unit is the outcome, not the texture."""
    known = np.asarray(outcomes, bool)
    interval = wilson_interval(float(known.sum()), known.size)
    return NO_ESTIMATE if interval is None else Estimate(float(known.mean()), *interval, known.size, known.size)


def bootstrap_intervals(samples: NDArray[np.float64]) -> NDArray[np.float64]:
    """Compute bootstrap intervals of means: bias-corrected and accelerated (BCa), at expanded levels.

    Plain bootstrap intervals are too narrow for the ten or so textures of a suite, so the level is raised by the ratio
    of Student's to the normal quantile. The result agrees with the method ``BCa`` of ``scipy.stats.bootstrap`` at that
    level. It is our own code because a run has thousands of means of equally many textures: here they share the
    resamples, which is about a hundred times faster.

    Parameters
    ----------
    samples
        ``(k, n)``: k samples of n > 1 values. The order of the values does not matter.

    Returns
    -------
    numpy.ndarray
        ``(k, 2)``: the ends of the intervals. If all values of a sample are equal, both ends are that value.

    References
    ----------
    B. Efron, "Better bootstrap confidence intervals", JASA 82, 1987.
    T. C. Hesterberg, "What teachers should know about the bootstrap", The American Statistician 69, 2015.
    """
    ordered = np.sort(np.asarray(samples, np.float64), axis=1)
    parts = [_bca_ends(ordered[start : start + _BATCH]) for start in range(0, len(ordered), _BATCH)]
    return np.concatenate(parts) if parts else np.empty((0, 2))


def _bca_ends(samples: NDArray[np.float64]) -> NDArray[np.float64]:
    n = samples.shape[1]
    mean = samples.mean(1, keepdims=True)
    draws = np.sort(samples @ _resample_counts(n), axis=1)
    rounding = 1e-12 * np.abs(samples).max(1, keepdims=True)
    below = ((draws < mean - rounding).sum(1) + (draws <= mean + rounding).sum(1)) / (2 * RESAMPLES)
    bias = ndtri(np.clip(below, 0.5 / RESAMPLES, 1 - 0.5 / RESAMPLES))
    away = samples - mean
    largest = np.abs(away).max(1, keepdims=True)
    constant = np.ptp(samples, axis=1) <= rounding[:, 0]
    away = away / np.where(constant[:, None], 1.0, largest)
    acceleration = (away**3).sum(1) / (6 * np.where(constant, 1.0, (away**2).sum(1)) ** 1.5)
    reach = float(ndtri(expanded_tail(n)))
    z = bias + np.array([[reach], [-reach]])
    place = ndtr(bias + z / np.maximum(1 - acceleration * z, 1e-3)).T * (RESAMPLES - 1)
    left = np.minimum(place.astype(np.int64), RESAMPLES - 2)
    low, high = np.take_along_axis(draws, left, 1), np.take_along_axis(draws, left + 1, 1)
    ends = np.clip(low + (place - left) * (high - low), samples[:, :1], samples[:, -1:])
    return np.where(constant[:, None], samples[:, :1], ends)


def expanded_tail(n: int) -> float:
    """Return the tail of the bootstrap distribution of n values that is cut off at each end, after Hesterberg."""
    return float(ndtr(-math.sqrt(n / (n - 1)) * stdtrit(n - 1, 0.5 + LEVEL / 2)))


@lru_cache(maxsize=16)
def _resample_counts(n: int) -> NDArray[np.float64]:
    """Return the weight of each of n values in each resample, ``(n, RESAMPLES)``, the same at every call."""
    chosen = stream("bootstrap").integers(0, n, (RESAMPLES, n))
    places = np.arange(RESAMPLES)[:, None] * n + chosen
    counts = np.bincount(places.ravel(), minlength=RESAMPLES * n).reshape(RESAMPLES, n)
    return np.ascontiguousarray(counts.T / n)


def means_over_textures(cells: pd.DataFrame, names: Sequence[str]) -> dict[str, Estimate]:
    """Compute the mean of each score over textures, with bootstrap intervals.

    Parameters
    ----------
    cells
        Rows of one method and lattice source, with the columns ``texture`` and ``names`` (NaN: no value).
    names
        The scores.
    """
    by_texture = cells.groupby("texture", sort=False)[list(names)].mean()
    return dict(zip(names, estimate_means(list(by_texture.to_numpy(np.float64).T)), strict=True))


def paired_differences(first: pd.DataFrame, second: pd.DataFrame, names: Sequence[str]) -> dict[str, Estimate]:
    """Compute the mean of ``first - second`` of each score over the textures that both have, with bootstrap intervals.

    Cells are paired by texture and replicate: both methods received the same sample.
    """
    on = ["texture", "replicate"]
    both = first[[*on, *names]].merge(second[[*on, *names]], on=on, suffixes=("_first", "_second"))
    gaps = {name: both[f"{name}_first"] - both[f"{name}_second"] for name in names}
    return means_over_textures(pd.DataFrame({"texture": both["texture"], **gaps}), names)


def estimate_mean(values: ArrayLike, of: int) -> Estimate:
    """Return the mean of values, one a texture, with a bootstrap interval; ``of`` is the number of all textures."""
    return estimate_means([np.asarray(values, np.float64)], [of])[0]


def estimate_means(columns: Sequence[NDArray[np.float64]], of: Sequence[int] | None = None) -> list[Estimate]:
    """Return the mean of each column of values, one value a texture, with bootstrap intervals.

    Parameters
    ----------
    columns
        One-dimensional arrays; NaN is no value.
    of
        The number of all textures of each column; by default its length.
    """
    known = [column[np.isfinite(column)] for column in columns]
    ends: dict[int, tuple[float, float]] = {}
    for count in {len(values) for values in known} - {0, 1}:
        places = [i for i, values in enumerate(known) if len(values) == count]
        intervals = bootstrap_intervals(np.stack([known[i] for i in places])).tolist()
        ends |= {i: (low, high) for i, (low, high) in zip(places, intervals, strict=True)}
    totals = [len(column) for column in columns] if of is None else of
    estimates = []
    for i, (values, total) in enumerate(zip(known, totals, strict=True)):
        low, high = ends.get(i, (None, None))
        estimates.append(Estimate(float(values.mean()) if len(values) else None, low, high, len(values), total))
    return estimates


def estimate_rate(shares: ArrayLike, of: int) -> Estimate:
    """Return the mean of shares, one a texture, with an interval; ``of`` is the number of all textures.

    The interval is a bootstrap over textures. If all shares are 0 or all are 1, every resample is equal and the
    bootstrap says nothing about the uncertainty: then it is Wilson's interval of a proportion.
    """
    known = np.asarray(shares, np.float64)
    if known.size and known.min() == known.max() and known[0] in (0.0, 1.0):
        low, high = wilson_interval(float(known.sum()), known.size) or (None, None)
        return Estimate(float(known[0]), low, high, known.size, of)
    return estimate_mean(known, of)


def success_rate(cells: pd.DataFrame, leave_refusals_out: bool = False) -> Estimate:
    """Compute the mean over textures of the share of preserved replicates, with an interval over textures.

    A failed cell counts as not preserved. So does a refused cell, unless refusals are left out. Undecided, unscored and
    missing cells are left out. Textures without a lattice to preserve do not count at all.

    Parameters
    ----------
    cells
        Rows of one method and lattice source, with the columns ``texture``, ``verdict`` and ``applicable``.
    leave_refusals_out
        Leave refused cells out.
    """
    applicable = cells[cells["applicable"].astype(bool)]
    verdicts = ["preserved", "lost", "failed"] if leave_refusals_out else ["preserved", "lost", "failed", "refused"]
    counted = applicable[applicable["verdict"].isin(verdicts)]
    shares = counted["verdict"].eq("preserved").groupby(counted["texture"]).mean()
    return estimate_rate(shares, applicable["texture"].nunique())


def as_numbers(values: Sequence[Any]) -> NDArray[np.float64]:
    """Return scores as numbers: truth values as 0 and 1, None as NaN."""
    return np.array([np.nan if value is None else float(value) for value in values], np.float64)


def kappa(tables: ConfusionTables) -> NDArray[np.float64]:
    """Compute Cohen's kappa of confusion tables, in [-1, 1]; NaN if both raters always gave the same single answer.

    Notes
    -----
    Kappa is (p_o - p_e) / (1 - p_e), where p_o is the share of equal answers and p_e the share expected by chance from
    the raters' shares of each answer: J. Cohen, "A coefficient of agreement for nominal scales", Educational and
    Psychological Measurement 20, 1960. This is our own code because SciPy has no kappa, and the bootstrap needs kappa
    of many tables at once.
    """
    total = tables.sum((-2, -1))
    with np.errstate(divide="ignore", invalid="ignore"):
        observed = np.trace(tables, axis1=-2, axis2=-1) / total
        chance = (tables.sum(-1) * tables.sum(-2)).sum(-1) / total**2
        values: NDArray[np.float64] = np.where(chance < 1 - 1e-12, (observed - chance) / (1 - chance), np.nan)
    return values


def mean_kappa(pairs: ConfusionTables) -> Estimate:
    """Compute the mean kappa over pairs of raters, with a bootstrap interval over textures.

    Textures are drawn with replacement, and with each texture all answers of all pairs, because outputs of one
    texture are not independent evidence; the intervals of statistical packages treat every item as independent.
    Percentiles are expanded as in :func:`bootstrap_intervals`. Resamples in which no pair has a kappa are left out.
    Time and memory grow with pairs times textures times resamples.

    Parameters
    ----------
    pairs
        ``(pairs, textures, k, k)``: the table of each pair on each texture.

    Returns
    -------
    Estimate
        ``n`` is the number of textures that every pair answered. There is no interval for fewer than two textures, or
        if more than half of the resamples have no kappa.
    """
    answered = pairs.sum((-2, -1)) > 0
    n, of = int(answered.all(0).sum()) if len(pairs) else 0, pairs.shape[1]
    value = mean_of_known(kappa(pairs.sum(1))[:, None], 0)
    if not np.isfinite(value).all() or int(answered.any(0).sum()) < 2:
        return Estimate(float(value[0]) if np.isfinite(value).all() else None, n=n, of=of)
    tables = pairs[:, answered.any(0)]
    units = tables.shape[1]
    weights = stream("bootstrap").multinomial(units, np.full(units, 1 / units), RESAMPLES).astype(np.float64)
    draws = mean_of_known(kappa(np.einsum("bt,ptij->pbij", weights, tables, optimize=True)), 0)
    draws = draws[np.isfinite(draws)]
    if len(draws) < RESAMPLES / 2:
        return Estimate(float(value[0]), n=n, of=of)
    tail = expanded_tail(units)
    low, high = np.quantile(draws, [tail, 1 - tail]).tolist()
    return Estimate(float(value[0]), low, high, n, of)


def rank_agreement(scores: NDArray[np.float64], answers: NDArray[np.float64]) -> tuple[float, float]:
    """Compare the order of methods by a score with their order by people's answers.

    Parameters
    ----------
    scores, answers
        ``(n,)``: the score and the mean answer of each method.

    Returns
    -------
    tau
        Kendall's tau-b, in [-1, 1]. It does not reach 1 if the answers do not distinguish all methods that the score
        distinguishes.
    ordered
        Share of the pairs with different answers that the score puts in the same order, in [0, 1]; pairs with equal
        scores count half. Chance gives 0.5.

    Notes
    -----
    Both are NaN if all answers are equal: there is no order to compare with. If all scores are equal, the score does
    not know the order that there is: tau is 0.

    Examples
    --------
    >>> tau, ordered = rank_agreement(np.array([0.1, 0.4, 0.9]), np.array([0.0, 1.0, 1.0]))
    >>> round(tau, 2), ordered
    (0.82, 1.0)
    """
    i, j = np.triu_indices(len(answers), 1)
    differ = answers[i] != answers[j]
    if not differ.any():
        return math.nan, math.nan
    signs = np.sign(scores[i] - scores[j])[differ] * np.sign(answers[i] - answers[j])[differ]
    tau = float(kendalltau(scores, answers).statistic) if np.ptp(scores) else 0.0
    return tau, float((1 + signs.mean()) / 2)


def mean_of_known(values: NDArray[np.float64], axis: int) -> NDArray[np.float64]:
    """Return the mean of the finite values along an axis; NaN if there are none (``nanmean`` would warn)."""
    known = np.isfinite(values)
    count = known.sum(axis)
    return np.where(count > 0, np.where(known, values, 0).sum(axis) / np.maximum(count, 1), np.nan)
