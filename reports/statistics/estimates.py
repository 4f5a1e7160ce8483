"""Estimate means, success rates, differences and agreement with 95 % intervals, and test which methods differ.

Two questions have two intervals. *Over draws*: the textures are a fixed list, and new draws of each would give other
values. *Over textures*: the textures are a sample of a population, and other textures would give other values, too.
The tests compare all pairs of methods at once, by sign flips.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import lru_cache
from typing import Any

import numpy as np
import pandas as pd
from numpy.typing import ArrayLike, NDArray
from scipy.special import ndtr, ndtri, stdtrit
from scipy.stats import binomtest, kendalltau

from nrbench.streams import stream

LEVEL = 0.95
"""Confidence level of every interval."""
RESAMPLES = 9999
"""Number of bootstrap resamples."""
FEWEST = 6
"""A test needs so many textures: with five no sign test of a pair can be significant at 5 %. An interval over draws
needs so many that scatter."""
FEWEST_DRAWS = 40
"""An interval over draws needs so many draws, such as two of each of 20 textures. With fewer, a run of a method that
refuses 6 % of all samples often holds no refusal, and its interval is too narrow (``benchmarks/table_errors.py``)."""
FEWEST_DIFFERENT = 9
"""An interval over a population needs so many textures that differ (``benchmarks/table_errors.py``)."""

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
        The ends of the interval; None if the data carry none.
    n, of
        Number of textures counted, and of all textures; of outputs for a rate.
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

    def __neg__(self) -> Estimate:
        value, low, high = (None if end is None else -end for end in (self.value, self.high, self.low))
        return replace(self, value=value, low=low, high=high)

    def within(self, limits: tuple[float, float]) -> Estimate:
        """Return the estimate with the ends of its interval inside the range of its score."""
        low, high = (None, None) if self.ends is None else np.clip(self.ends, *limits).tolist()
        return replace(self, low=low, high=high)

    def columns(
        self, name: str, prefix: str = "", parts: Sequence[str] = ("low", "high", "n", "of")
    ) -> dict[str, float | int | None]:
        """Return the value under a name, and other parts under their own names with a prefix, for a row of a table."""
        return {name: self.value, **{prefix + part: getattr(self, part) for part in parts}}


NO_ESTIMATE = Estimate(None)
"""The estimate of a number that does not exist."""


def estimate_proportion(outcomes: ArrayLike, of: int | None = None) -> Estimate:
    """Return the share of true ``outcomes`` with Wilson's interval.

    The draws of a fixed list of textures scatter less than as many draws of one binomial distribution, so the interval
    is then conservative.

    Parameters
    ----------
    outcomes
        Truth values, one a draw.
    of
        Number of all draws; by default that of the outcomes.

    References
    ----------
    E. B. Wilson, "Probable inference, the law of succession, and statistical inference", JASA 22, 1927.
    """
    known = np.asarray(outcomes, bool)
    n, total = known.size, known.size if of is None else of
    if n == 0:
        return Estimate(None, of=total)
    ends = binomtest(int(known.sum()), n).proportion_ci(LEVEL, "wilson")
    return Estimate(float(known.mean()), float(ends.low), float(ends.high), n, total)


def estimate_means(
    values: NDArray[np.float64], of: Sequence[int] | None = None, population: bool = False
) -> list[Estimate]:
    """Return the mean over textures of each of several scores; a texture counts as the mean over its draws.

    Parameters
    ----------
    values
        ``(scores, textures, draws)``; NaN is no value.
    of
        The number of all textures of each score; by default the length of the axis.
    population
        Whether the interval is over textures and draws, else over draws: :func:`draw_intervals` and
        :func:`population_intervals` say when there is one.
    """
    counts = np.isfinite(values).sum(2)
    means = mean_of_known(values, 2)
    n, mean = (counts > 0).sum(1), mean_of_known(means, 1)
    ends = population_intervals(values) if population else draw_intervals(values)
    known: list[list[float | None]] = [
        [None if math.isnan(x) else x for x in row] for row in np.column_stack([mean, ends]).tolist()
    ]
    rows = zip(known, n.tolist(), of or [values.shape[1]] * len(values), strict=True)
    return [Estimate(value, low, high, count, total) for (value, low, high), count, total in rows]


def draw_intervals(values: NDArray[np.float64]) -> NDArray[np.float64]:
    """Compute intervals of means over a fixed list of textures, over draws: Student's t, stratified by texture.

    The variance of the mean is the sum of the variances of the textures' means. Its degrees of freedom are
    Satterthwaite's in the form of Welch (1947), which allows for the error of the variances themselves; two draws of
    each texture suffice. There is no interval unless every texture has two draws, :data:`FEWEST` textures have draws
    that differ, and there are :data:`FEWEST_DRAWS` draws in all: few draws do not tell how often rare values occur.

    Parameters
    ----------
    values
        ``(scores, textures, draws)``; NaN is no value.

    Returns
    -------
    numpy.ndarray
        ``(scores, 2)``: the ends of the intervals, NaN where there is none.

    References
    ----------
    B. L. Welch, "The generalization of Student's problem when several different population variances are involved",
    Biometrika 34, 1947.
    """
    known = np.isfinite(values)
    counts = known.sum(2)
    away = np.where(known, values - mean_of_known(values, 2)[..., None], 0.0)
    parts = (away**2).sum(2) / np.maximum(counts * (counts - 1), 1)
    largest = np.abs(np.where(known, values, 0.0)).max(2, initial=0.0)
    parts[parts <= (1e-12 * largest) ** 2] = 0.0
    carried = ((parts > 0).sum(1) >= FEWEST) & (counts.sum(1) >= FEWEST_DRAWS) & (counts != 1).all(1)
    variance, n = parts.sum(1), np.maximum((counts > 0).sum(1), 1)
    with np.errstate(divide="ignore", invalid="ignore"):
        freedom = np.maximum(variance**2 / (parts**2 / (counts + 1)).sum(1) - 2, 1.0)
        half = np.where(carried, stdtrit(freedom, 0.5 + LEVEL / 2) * np.sqrt(variance) / n, np.nan)
    return mean_of_known(mean_of_known(values, 2), 1)[:, None] + half[:, None] * (-1.0, 1.0)


def population_intervals(values: NDArray[np.float64]) -> NDArray[np.float64]:
    """Compute intervals of means over a population of textures: a hierarchical bootstrap over textures and draws.

    Textures are drawn with replacement, and of each the draws. Percentiles of few textures are too narrow, so the level
    is raised by the ratio of Student's to the normal quantile. There is no interval for fewer than
    :data:`FEWEST_DIFFERENT` different textures. It is our own code because ``scipy.stats.bootstrap`` draws at one level
    only.

    Parameters
    ----------
    values
        ``(scores, textures, draws)``; NaN is no value.

    Returns
    -------
    numpy.ndarray
        ``(scores, 2)``: the ends of the intervals, NaN where there is none.

    References
    ----------
    A. C. Davison and D. V. Hinkley, "Bootstrap methods and their application", 1997, section 3.8.
    T. C. Hesterberg, "What teachers should know about the bootstrap", The American Statistician 69, 2015.
    """
    means = mean_of_known(values, 2)
    known, ends = np.isfinite(means), np.full((len(values), 2), np.nan)
    if values.shape[1] < FEWEST_DIFFERENT or not len(values):
        return ends
    filled = np.nan_to_num(np.where(np.isfinite(values), values, means[..., None]))
    weights = _resample_weights(*values.shape[1:])
    with np.errstate(invalid="ignore", divide="ignore"):
        totals = weights.reshape(RESAMPLES, -1) @ filled.reshape(len(values), -1).T
        draws = np.sort(totals / (weights.sum(2) @ known.T), axis=0)
    for i, row in enumerate(known):
        if len(np.unique(means[i, row])) >= FEWEST_DIFFERENT:
            tail = expanded_tail(int(row.sum()))
            ends[i] = np.quantile(draws[: np.isfinite(draws[:, i]).sum(), i], (tail, 1 - tail))
    return ends


def expanded_tail(n: int) -> float:
    """Return the tail of the bootstrap distribution of n values that is cut off at each end, after Hesterberg."""
    return float(ndtr(-math.sqrt(n / (n - 1)) * stdtrit(n - 1, 0.5 + LEVEL / 2)))


@lru_cache(maxsize=8)
def _resample_weights(textures: int, draws: int) -> NDArray[np.float64]:
    """Return the weight of each draw in each resample, ``(RESAMPLES, textures, draws)``, the same at every call."""
    rng = stream("bootstrap")
    chosen = rng.integers(0, textures, (RESAMPLES, textures, 1)) * draws
    places = (chosen + rng.integers(0, draws, (RESAMPLES, textures, draws))).reshape(RESAMPLES, -1)
    size = textures * draws
    counts = np.bincount((np.arange(RESAMPLES)[:, None] * size + places).ravel(), minlength=RESAMPLES * size)
    return counts.reshape(RESAMPLES, textures, draws) / draws


def stack_draws(cells: pd.DataFrame, names: Sequence[str]) -> NDArray[np.float64]:
    """Return the scores ``names`` as ``(scores, textures, draws)``, from rows with ``texture`` and ``replicate``."""
    if cells.empty or not names:
        return np.empty((len(names), cells["texture"].nunique(), 1))
    table = cells.groupby(["texture", "replicate"])[list(names)].mean().unstack()
    return table.to_numpy(np.float64).reshape(len(table), len(names), -1).swapaxes(0, 1)


def means_over_textures(cells: pd.DataFrame, names: Sequence[str]) -> dict[str, Estimate]:
    """Compute the mean of each score over textures, with intervals over a population of textures.

    Parameters
    ----------
    cells
        Rows of one method and lattice source, with the columns ``texture`` and ``names`` (NaN: no value), and
        ``replicate`` if there are several draws.
    names
        The scores.
    """
    rows = cells if "replicate" in cells else cells.assign(replicate=0)
    return dict(zip(names, estimate_means(stack_draws(rows, names), population=True), strict=True))


def estimate_mean(values: ArrayLike, of: int) -> Estimate:
    """Return the mean of values, one a texture, with an interval over a population of ``of`` textures."""
    return estimate_means(np.asarray(values, np.float64)[None, :, None], [of], population=True)[0]


def success_rate(cells: pd.DataFrame, leave_refusals_out: bool = False) -> Estimate:
    """Compute the share of outputs that preserve the lattice, with Wilson's interval over outputs.

    A failed cell counts as not preserved. So does a refused cell, unless refusals are left out. Undecided, unscored and
    missing cells are left out. Textures without a lattice to preserve do not count at all.

    Parameters
    ----------
    cells
        Rows of one method and lattice source, with the columns ``verdict`` and ``applicable``.
    leave_refusals_out
        Leave refused cells out.
    """
    applicable = cells[cells["applicable"].astype(bool)]
    verdicts = ["preserved", "lost", "failed"] if leave_refusals_out else ["preserved", "lost", "failed", "refused"]
    counted = applicable[applicable["verdict"].isin(verdicts)]
    return estimate_proportion(counted["verdict"].eq("preserved"), len(applicable))


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
    Percentiles are expanded as in :func:`population_intervals`. Resamples in which no pair has a kappa are left out.
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


ALPHA = 0.05
"""The chance that any two equal methods of a table are called different."""
POWER = 0.8
"""The power with which a detectable loss is found."""
Floats = NDArray[np.float64]


@dataclass(frozen=True)
class PairTests:
    """Which methods differ in a score.

    Parameters
    ----------
    p
        ``(k, k)``: p-values, adjusted for all pairs of the table; NaN for a pair with fewer than
        :data:`~nrbench.reports.statistics.estimates.FEWEST` common textures.
    better
        ``(k, k)``: whether the method of the row is better than that of the column; a higher score is better.
    common
        ``(k, k)``: number of textures that both methods have.
    """

    p: Floats
    better: NDArray[np.bool_]
    common: Floats

    @property
    def cliques(self) -> tuple[tuple[int, int], ...]:
        """The longest series of at least two neighbors of which no two differ, as first and last index."""
        found: list[tuple[int, int]] = []
        different = ~(self.p > ALPHA)
        for first in range(len(different)):
            last = first
            while last + 1 < len(different) and not different[first : last + 1, last + 1].any():
                last += 1
            if last > first and (not found or last > found[-1][1]):
                found.append((first, last))
        return tuple(found)


def compare_pairs(values: Floats) -> PairTests:
    """Test all pairs of methods at once: a table calls any equal methods different in at most 5 % of cases.

    The p-values are those of :func:`p_values_by_flips`, of the differences of all pairs. A method that is best by
    chance needs no further correction, because all pairs are tested.

    Parameters
    ----------
    values
        ``(textures, methods)``: means over draws; NaN is no value. A pair is tested on the textures that both have.
    """
    count = values.shape[1]
    first, second = np.triu_indices(count, 1)
    gaps = values[:, first] - values[:, second]

    def square(upper: NDArray[Any], sign: int = 1) -> Floats:
        matrix = np.full((count, count), np.nan)
        matrix[first, second], matrix[second, first] = upper, sign * upper
        return matrix

    p = square(p_values_by_flips(gaps))
    return PairTests(p, (p <= ALPHA) & (square(np.nansum(gaps, 0), -1) > 0), square(np.isfinite(gaps).sum(0)))


def p_values_by_flips(gaps: Floats, one_sided: bool = False) -> Floats:
    """Return a p-value for each column of differences, adjusted for all columns: the largest statistic, step-down.

    The statistic of a column is the sum of its differences, one a texture, over the root of their sum of squares. Its
    distribution comes from changes of sign: where nothing differs, each difference could as well have the other sign. A
    texture's sign is changed for all columns together, so that the largest statistic of all columns, by which each is
    judged, has the dependence of the data. Step-down: a column is compared with the columns that are not larger. Up to
    12 textures all signs are tried.

    Parameters
    ----------
    gaps
        ``(textures, columns)``; NaN is no value.
    one_sided
        Whether only positive sums count, else both signs.

    Returns
    -------
    numpy.ndarray
        ``(columns,)``; NaN for a column with fewer than :data:`~nrbench.reports.statistics.estimates.FEWEST` values.

    References
    ----------
    P. H. Westfall and S. S. Young, "Resampling-based multiple testing", 1993, algorithm 2.8.
    J. P. Romano and M. Wolf, "Exact and approximate stepdown methods for multiple hypothesis testing", JASA 100, 2005.
    """
    statistics = _flipped_statistics(gaps, one_sided)
    order = np.argsort(statistics[:, 0], kind="stable")
    largest = np.maximum.accumulate(statistics[order], axis=0)
    p = (largest >= statistics[order, :1] - 1e-9).mean(1)
    adjusted = np.empty(len(order))
    adjusted[order] = np.maximum.accumulate(p[::-1])[::-1]
    return np.where(np.isfinite(gaps).sum(0) >= FEWEST, adjusted, np.nan)


def _flipped_statistics(gaps: Floats, one_sided: bool) -> Floats:
    """Return the statistic of each column under each change of signs, ``(columns, flips)``, the observed ones first."""
    known = np.isfinite(gaps)
    clean = np.where(known & (known.sum(0) >= FEWEST) & (np.abs(gaps) > 1e-12), gaps, 0.0)
    size = np.sqrt((clean**2).sum(0))
    statistics = (clean / np.where(size > 0, size, 1.0)).T @ _sign_flips(len(gaps)).T
    return np.concatenate([statistics, -statistics], 1) if one_sided else np.abs(statistics)


def detectable_losses(gaps: Floats) -> Floats:
    """Return the loss of each column that the one-sided test of all columns finds with a power of :data:`POWER`.

    Parameters
    ----------
    gaps
        ``(textures, columns)``; NaN is no value. Their scatter about their mean is that between draws.

    Returns
    -------
    numpy.ndarray
        ``(columns,)``; NaN where the column does not scatter, or has too few textures for any loss to be found.

    Notes
    -----
    Let c be the level that the largest statistic exceeds by chance in :data:`ALPHA` of all cases. As a value of
    Student's t of n differences it is t = c ((n - 1) / (n - c^2))^(1/2). The mean difference must exceed t standard
    errors by the normal quantile of the power times (1 + t^2 / (2 n - 2))^(1/2), the standard deviation of a t value.
    """
    level = np.quantile(_flipped_statistics(gaps, True).max(0), 1 - ALPHA)
    n = np.isfinite(gaps).sum(0)
    found = (n > level**2) & (n >= FEWEST)
    n = np.where(found, n, level**2 + 2)
    error = np.sqrt(mean_of_known((gaps - mean_of_known(gaps, 0)) ** 2, 0) / (n - 1))
    t = level * np.sqrt((n - 1) / (n - level**2))
    losses = error * (t + ndtri(POWER) * np.sqrt(1 + t**2 / (2 * n - 2)))
    return np.where(found & (losses > 1e-9), losses, np.nan)


@lru_cache(maxsize=4)
def _sign_flips(textures: int) -> Floats:
    """Return signs, ``(flips, textures)``, the observed ones first: all up to a common sign, or a random selection."""
    if textures <= 12:
        return np.array([(1.0, *rest) for rest in itertools.product((1.0, -1.0), repeat=max(textures - 1, 0))])
    signs = stream("bootstrap", "signs").choice((-1.0, 1.0), (RESAMPLES + 1, textures))
    signs[0] = 1.0
    return signs


def adjust_means(values: Floats) -> Floats:
    """Return the mean of each method over all textures, by least squares where it lacks some.

    The model is a number for the method plus one for the texture, as for missing plots in a block design. So a method
    is compared with what the others have on its textures. Two methods with the same textures differ by exactly the mean
    of their differences, whatever the others have.

    Parameters
    ----------
    values
        ``(textures, methods)``: means over draws; NaN is no value.

    References
    ----------
    F. Yates, "The analysis of replicated experiments when the field results are incomplete", Empire Journal of
    Experimental Agriculture 1, 1933.

    Examples
    --------
    >>> import numpy as np
    >>> adjust_means(np.array([[0.9, 0.8], [0.5, 0.4], [0.1, np.nan]])).round(3).tolist()
    [0.5, 0.4]
    """
    row, column = np.nonzero(np.isfinite(values))
    textures = len(values)
    design = np.zeros((len(row), textures + values.shape[1]))
    places = np.arange(len(row))
    design[places, row] = design[places, textures + column] = 1.0
    fitted = np.linalg.lstsq(design, values[row, column], rcond=None)[0]
    means: Floats = fitted[textures:] + fitted[np.unique(row)].mean()
    return means
