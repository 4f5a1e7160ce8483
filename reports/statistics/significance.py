"""Test whether methods differ: Friedman's test, Wilcoxon's test of every pair with Holm's correction, and effect sizes.

The unit is the texture: each value is a mean over the replicates of one texture.
"""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import pandas as pd
from numpy.typing import NDArray
from scipy.stats import friedmanchisquare, rankdata, wilcoxon

from nrbench.runs.records import Run

from .estimates import Estimate, estimate_means
from .summaries import Method, headline_columns
from .verdicts import RANKING

FEWEST = 10
"""The tests need at least so many textures: with fewer, Wilcoxon's test of several pairs can hardly be significant."""
ALPHA = 0.05
"""Significance level."""

Floats = NDArray[np.float64]


@dataclass(frozen=True)
class RankTests:
    """The ranks of methods over textures, and which methods differ.

    Parameters
    ----------
    order
        Indices of the methods from the best average rank to the worst.
    ranks
        Average rank of each method over the textures, in the order of the input; 1 is the best.
    n
        Number of textures.
    friedman
        p-value of Friedman's test that all methods have equal ranks; None for two methods.
    adjusted
        ``(k, k)``: p-values of Wilcoxon's signed-rank test of each pair, adjusted by Holm's method for all pairs.
    different
        ``(k, k)``: the pairs that differ. No pair differs unless Friedman's test says that the methods do.
    cliques
        First and last position in ``order`` of each longest series of neighbors of which no two differ.
    """

    order: tuple[int, ...]
    ranks: tuple[float, ...]
    n: int
    friedman: float | None
    adjusted: Floats
    different: NDArray[np.bool_]
    cliques: tuple[tuple[int, int], ...]


def compare_ranks(values: Floats) -> RankTests:
    """Rank methods on each texture, and test whether they differ.

    Parameters
    ----------
    values
        ``(textures, methods)``, without NaN; higher is better. At least 2 methods and 2 textures.

    References
    ----------
    J. Demsar, "Statistical comparisons of classifiers over multiple data sets", JMLR 7, 2006.
    A. Benavoli, G. Corani and F. Mangili, "Should we really use post-hoc tests based on mean-ranks?", JMLR 17, 2016.
    """
    count = values.shape[1]
    ranks = rankdata(-values, axis=1).mean(0)
    order = np.argsort(ranks, kind="stable")
    first, second = np.triu_indices(count, 1)
    p = adjust_holm(signed_rank_p_values(values[:, first] - values[:, second]))
    adjusted = np.ones((count, count))
    adjusted[first, second] = adjusted[second, first] = p
    friedman = None
    if count > 2:
        equal = bool((values == values[:, :1]).all())
        friedman = 1.0 if equal else float(friedmanchisquare(*values.T).pvalue)
    different = (adjusted < ALPHA) & (friedman is None or friedman < ALPHA)
    return RankTests(
        tuple(order.tolist()),
        tuple(ranks.tolist()),
        len(values),
        friedman,
        adjusted,
        different,
        find_cliques(different[np.ix_(order, order)]),
    )


def signed_rank_p_values(differences: Floats) -> Floats:
    """Return the two-sided p-value of Wilcoxon's signed-rank test of each column of paired differences.

    Differences of zero are split evenly between the signs. A column without zeros and ties has the exact distribution,
    if it has at most 50 values; the others have the normal approximation.

    Parameters
    ----------
    differences
        ``(textures, pairs)``, without NaN.
    """
    n, count = differences.shape
    size = np.sort(np.abs(differences), axis=0)
    distinct = (size[0] > 0) & (np.diff(size, axis=0) > 0).all(0) & (n <= 50)
    p = np.ones(count)
    some = np.flatnonzero(size[-1] > 0)
    for exact, columns in ((True, some[distinct[some]]), (False, some[~distinct[some]])):
        if len(columns):
            method: Any = "exact" if exact else "asymptotic"
            tested: Any = wilcoxon(differences[:, columns], None, "zsplit", method=method, axis=0)
            p[columns] = tested.pvalue
    return p


def adjust_holm(p: Floats) -> Floats:
    """Return p-values adjusted for their number by Holm's step-down method, in the order given.

    Examples
    --------
    >>> import numpy as np
    >>> adjust_holm(np.array([0.01, 0.04, 0.03])).tolist()
    [0.03, 0.06, 0.06]
    """
    order = np.argsort(p, kind="stable")
    adjusted = np.empty_like(p)
    adjusted[order] = np.minimum(1.0, np.maximum.accumulate(p[order] * (len(p) - np.arange(len(p)))))
    return adjusted


def find_cliques(different: NDArray[np.bool_]) -> tuple[tuple[int, int], ...]:
    """Return the longest series of at least two neighbors of which no two differ, as first and last index.

    Parameters
    ----------
    different
        ``(k, k)``: which methods differ, in the order of their ranks.
    """
    found: list[tuple[int, int]] = []
    for first in range(len(different)):
        last = first
        while last + 1 < len(different) and not different[first : last + 1, last + 1].any():
            last += 1
        if last > first and (not found or last > found[-1][1]):
            found.append((first, last))
    return tuple(found)


def rank_biserial(differences: Sequence[float] | Floats) -> float | None:
    """Compute the matched-pairs rank-biserial correlation, the effect size of Wilcoxon's test.

    It is the sum of the ranks of positive differences minus that of negative ones, over the sum of all ranks: 1 if the
    first method is better on every texture, -1 if it is worse on every texture, 0 if they are even.

    Parameters
    ----------
    differences
        One a texture. Zeros are left out.

    Returns
    -------
    float or None
        In [-1, 1]; None if all differences are zero or there are none.

    References
    ----------
    D. S. Kerby, "The simple difference formula: an approach to teaching nonparametric correlation", Comprehensive
    Psychology 3, 2014.
    """
    values = np.asarray(differences, np.float64)
    values = values[np.isfinite(values) & (values != 0)]
    if not len(values):
        return None
    ranks = rankdata(np.abs(values))
    return float((ranks * np.sign(values)).sum() / ranks.sum())


@dataclass(frozen=True)
class PairedDifference:
    """The mean difference of two methods in one score, over the textures that both have."""

    score: str
    first: Method
    second: Method
    estimate: Estimate


@dataclass(frozen=True)
class BaselineDifference:
    """A method beside the method that all are compared with.

    Parameters
    ----------
    method
        The method.
    estimate
        Mean over textures of its quality minus that of the other method.
    effect
        The rank-biserial correlation of the differences, in [-1, 1].
    p
        p-value of Wilcoxon's signed-rank test, adjusted by Holm's method for all methods of the list; None with fewer
        than :data:`~nrbench.reports.statistics.significance.FEWEST` textures, and without tests.
    """

    method: Method
    estimate: Estimate
    effect: float | None
    p: float | None


def find_leading_group(cells: pd.DataFrame, best: Method, ranked: Sequence[Method]) -> tuple[set[str], str]:
    """Return the labels of the leading group, and what the group is.

    A method that shares fewer than half of the best method's textures with it is not in the group: their difference is
    not known.
    """
    behind = _differences(cells, RANKING, best)
    gaps = {one.label: behind[one.label].dropna().to_numpy() for one in ranked if one != best}
    near = {label: gap for label, gap in gaps.items() if 2 * len(gap) >= behind[best.label].count()}
    what = "leading group: the method of the highest mean quality, and the methods"
    if near and all(len(gap) >= FEWEST for gap in near.values()):
        p = adjust_holm(np.array([_signed_rank_p(gap) for gap in near.values()]))
        tied = (p >= ALPHA).tolist()
        rule = f"{what} that do not differ from it over textures (Wilcoxon's test with Holm's correction, 5 %)"
    else:
        tied = [one.low is None or one.low <= 0 for one in estimate_means(list(near.values()))]
        rule = f"{what} whose paired difference to it over textures has a 95 % interval that contains 0"
    return {best.label, *itertools.compress(near, tied)}, rule


def _differences(cells: pd.DataFrame, score: str, first: Method) -> pd.DataFrame:
    """Return a score of ``first`` minus that of every method, by texture and label: means over paired replicates."""
    scores = cells.pivot(index=["texture", "replicate"], columns="label", values=score)
    return scores.rsub(scores[first.label], axis=0).groupby(level="texture").mean()


def _signed_rank_p(differences: Floats) -> float:
    return float(signed_rank_p_values(differences[:, None])[0])


def rank_by_texture(cells: pd.DataFrame, ranked: Sequence[Method]) -> RankTests | None:
    """Return the tests over the textures on which every ranked method has a quality; None with too few."""
    qualities = cells.pivot_table(RANKING, "texture", "label")[[one.label for one in ranked]].dropna()
    return compare_ranks(qualities.to_numpy()) if len(qualities) >= FEWEST and len(ranked) > 1 else None


def compare_with(cells: pd.DataFrame, other: Method, methods: Sequence[Method]) -> list[BaselineDifference]:
    """Return the difference of each method to ``other`` in quality; methods without common textures are left out."""
    gaps = -_differences(cells, RANKING, other)
    known = [one for one in methods if gaps[one.label].notna().any()]
    estimates = estimate_means([gaps[one.label].to_numpy() for one in known])
    clean = [gaps[one.label].dropna().to_numpy() for one in known]
    many = [_signed_rank_p(gap) for gap in clean if len(gap) >= FEWEST]
    adjusted = iter(adjust_holm(np.array(many)).tolist())
    return [
        BaselineDifference(one, estimate, rank_biserial(gap), next(adjusted) if estimate.n >= FEWEST else None)
        for one, gap, estimate in zip(known, clean, estimates, strict=True)
    ]


def list_differences(run: Run, methods: Sequence[Method], cells: pd.DataFrame) -> list[PairedDifference]:
    """Return the differences of all pairs whose first method is no reference, in every headline."""
    pairs = [(a, b) for a, b in itertools.combinations(methods, 2) if not a.reference]
    textures = {str(label): set(names) for label, names in cells.groupby("label")["texture"]}
    common = [len(textures[a.label] & textures[b.label]) for a, b in pairs]
    found = []
    for name in headline_columns(run):
        gaps = {a.label: _differences(cells, name, a) for a in methods if not a.reference}
        estimates = estimate_means([gaps[a.label][b.label].to_numpy() for a, b in pairs], common)
        found += [PairedDifference(name, a, b, one) for (a, b), one in zip(pairs, estimates, strict=True)]
    return found
