"""Test whether methods differ: Friedman's test, Wilcoxon's test of every pair with Holm's correction, and effect sizes.

The unit is the texture: each value is a mean over the replicates of one texture.
"""

from __future__ import annotations

import itertools
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import pandas as pd
from numpy.typing import NDArray
from scipy.stats import friedmanchisquare, rankdata, wilcoxon

from nrbench.runs.records import Run

from .estimates import Estimate, estimate_means, mean_of_known
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


def find_leading_group(draws: TextureDraws, best: Method, ranked: Sequence[Method]) -> tuple[set[str], str]:
    """Return the labels of the leading group, and what the group is.

    A method that shares fewer than half of the best method's textures with it is not in the group: their difference is
    not known.
    """
    gaps = {one.label: draws.differences(best, one)[draws.ranking] for one in ranked if one != best}
    near = {label: gap for label, gap in gaps.items() if 2 * np.isfinite(gap).sum() >= draws.count(best)}
    what = "leading group: the method of the highest mean quality, and the methods"
    if near and all(np.isfinite(gap).sum() >= FEWEST for gap in near.values()):
        p = adjust_holm(np.array([_signed_rank_p(gap) for gap in near.values()]))
        tied = (p >= ALPHA).tolist()
        rule = f"{what} that do not differ from it over textures (Wilcoxon's test with Holm's correction, 5 %)"
    else:
        tied = [one.low is None or one.low <= 0 for one in estimate_means(list(near.values()))]
        rule = f"{what} whose paired difference to it over textures has a 95 % interval that contains 0"
    return {best.label, *itertools.compress(near, tied)}, rule


def _signed_rank_p(differences: Floats) -> float:
    known = differences[np.isfinite(differences)]
    return float(signed_rank_p_values(known[:, None])[0]) if len(known) else 1.0


def rank_by_texture(draws: TextureDraws, ranked: Sequence[Method]) -> RankTests | None:
    """Return the tests over the textures on which every ranked method has a quality; None with too few."""
    values = np.stack([draws.means(one)[draws.ranking] for one in ranked], axis=1)
    complete = values[np.isfinite(values).all(1)]
    return compare_ranks(complete) if len(complete) >= FEWEST and len(ranked) > 1 else None


def compare_with(draws: TextureDraws, other: Method, methods: Sequence[Method]) -> list[BaselineDifference]:
    """Return the difference of each method to ``other`` in quality; methods without common textures are left out."""
    gaps = [(one, -draws.differences(other, one)[draws.ranking]) for one in methods]
    known = [(one, gap) for one, gap in gaps if np.isfinite(gap).any()]
    estimates = estimate_means([gap for _, gap in known])
    many = [_signed_rank_p(gap) for _, gap in known if np.isfinite(gap).sum() >= FEWEST]
    adjusted = iter(adjust_holm(np.array(many)).tolist())
    return [
        BaselineDifference(one, estimate, rank_biserial(gap), next(adjusted) if estimate.n >= FEWEST else None)
        for (one, gap), estimate in zip(known, estimates, strict=True)
    ]


@dataclass(frozen=True)
class TextureDraws:
    """The headline scores of every method, by texture and replicate.

    Parameters
    ----------
    names
        The scores.
    values
        ``(scores, textures, replicates)`` for each label; NaN is no value.
    present
        ``(textures, replicates)`` for each label: whether the run has the cell.
    """

    names: Sequence[str]
    values: Mapping[str, Floats]
    present: Mapping[str, NDArray[np.bool_]]

    @classmethod
    def of(cls, run: Run, cells: pd.DataFrame) -> TextureDraws:
        """Collect the scores of a run."""
        names = list(headline_columns(run))
        textures, row = np.unique(cells["texture"].to_numpy(object).astype(str), return_inverse=True)
        replicates, column = np.unique(cells["replicate"].to_numpy(np.int64), return_inverse=True)
        scores = cells[names].to_numpy(np.float64)
        values: dict[str, Floats] = {}
        present: dict[str, NDArray[np.bool_]] = {}
        for name, where in cells.groupby("label", sort=False).indices.items():
            label = str(name)
            values[label] = np.full((len(names), len(textures), len(replicates)), np.nan)
            values[label][:, row[where], column[where]] = scores[where].T
            present[label] = np.zeros((len(textures), len(replicates)), bool)
            present[label][row[where], column[where]] = True
        return cls(names, values, present)

    @property
    def ranking(self) -> int:
        """The index of the quality that ranks."""
        return self.names.index(RANKING)

    def means(self, method: Method) -> Floats:
        """Return the mean over replicates of each score on each texture, ``(scores, textures)``."""
        return mean_of_known(self.values[method.label], -1)

    def count(self, method: Method) -> int:
        """Return the number of textures on which a method has the quality that ranks."""
        return int(np.isfinite(self.means(method)[self.ranking]).sum())

    def differences(self, first: Method, second: Method) -> Floats:
        """Return the mean over replicates of first minus second on each texture, ``(scores, textures)``."""
        return mean_of_known(self.values[first.label] - self.values[second.label], -1)

    def common(self, first: Method, second: Method) -> int:
        """Return the number of textures that both methods ran on."""
        return int((self.present[first.label] & self.present[second.label]).any(1).sum())


def list_differences(run: Run, methods: Sequence[Method], draws: TextureDraws) -> list[PairedDifference]:
    """Return the differences of all pairs whose first method is no reference, in every headline."""
    pairs = [(a, b) for a, b in itertools.combinations(methods, 2) if not a.reference]
    gaps = [draws.differences(a, b) for a, b in pairs]
    common = [draws.common(a, b) for a, b in pairs]
    found = []
    for index, name in enumerate(draws.names):
        estimates = estimate_means([gap[index] for gap in gaps], common)
        found += [PairedDifference(name, a, b, one) for (a, b), one in zip(pairs, estimates, strict=True)]
    return found
