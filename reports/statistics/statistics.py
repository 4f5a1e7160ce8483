"""Statistics of cells: rates, means, differences and ranks, each with an interval over textures.

A texture is the unit: its replicates are averaged first, because draws of one texture are not independent evidence.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import pandas as pd
from numpy.typing import ArrayLike, NDArray
from scipy.special import ndtr, ndtri, stdtrit

from nrbench.streams import stream

LEVEL = 0.95
"""Confidence of every interval."""
RESAMPLES = 9999


@dataclass(frozen=True)
class Estimate:
    """A number with its interval, and how much it rests on.

    Parameters
    ----------
    value
        The number; None where nothing was counted.
    low, high
        The interval's ends; None where too little was counted.
    n, of
        Textures counted, and textures that there are.
    """

    value: float | None
    low: float | None = None
    high: float | None = None
    n: int = 0
    of: int = 0

    @property
    def excludes_zero(self) -> bool | None:
        """Whether the interval leaves zero out; None where there is none."""
        if self.low is None or self.high is None:
            return None
        return self.low > 0 or self.high < 0


def wilson(successes: float, n: int, level: float = LEVEL) -> tuple[float, float] | None:
    """Return Wilson's score interval of a proportion; None where n is 0.

    Parameters
    ----------
    successes
        From 0 to n. It need not be whole: a sum of shares in [0, 1] scatters less than one of zeros and ones of the
        same mean, so the interval is then on the safe side.
    n
        Number of trials.
    level
        Confidence.

    Notes
    -----
    E. B. Wilson, "Probable inference, the law of succession, and statistical inference", JASA 22, 1927.
    """
    if n == 0:
        return None
    z = float(ndtri(0.5 + level / 2))
    share, shrink = successes / n, 1 + z * z / n
    centre = (share + z * z / (2 * n)) / shrink
    half = z / shrink * math.sqrt(max(0.0, share * (1 - share)) / n + z * z / (4 * n * n))
    return max(0.0, min(share, centre - half)), min(1.0, max(share, centre + half))


def bootstrap_mean(
    values: ArrayLike, level: float = LEVEL, rng: np.random.Generator | None = None
) -> tuple[float, float] | None:
    """Return the bootstrap interval of a mean; None for fewer than two values.

    Percentiles are widened by the ratio of Student's to the normal quantile, because plain percentiles are too narrow
    for the ten or so textures of a suite ("expanded percentile interval": T. C. Hesterberg, "What teachers should know
    about the bootstrap", The American Statistician 69, 2015).

    Parameters
    ----------
    values
        One-dimensional; order does not matter.
    level
        Confidence.
    rng
        By default one and the same stream for every call: equal values give an equal interval.
    """
    sample = np.sort(np.asarray(values, np.float64))
    n = sample.size
    if n < 2:
        return None
    rng = rng or stream("bootstrap")
    means = sample[rng.integers(0, n, (RESAMPLES, n))].mean(1)
    tail = expanded_tail(n, level)
    low, high = np.quantile(means, [tail, 1 - tail])
    return float(low), float(high)


def expanded_tail(n: int, level: float = LEVEL) -> float:
    """Return the share of resamples that an expanded percentile interval of ``n`` > 1 units leaves out at each end."""
    return float(ndtr(-math.sqrt(n / (n - 1)) * stdtrit(n - 1, 0.5 + level / 2)))


def texture_means(cells: pd.DataFrame, score: str) -> pd.Series[float]:
    """Return a score's mean over each texture's replicates, textures without a value left out."""
    return cells.groupby("texture", sort=False)[score].mean().dropna()


def mean(cells: pd.DataFrame, score: str) -> Estimate:
    """Return a score's mean over textures, with its bootstrap interval.

    Parameters
    ----------
    cells
        Rows of one method and lattice source, with columns ``texture`` and ``score`` (NaN where there is none).
    score
        The column.
    """
    return _estimate(texture_means(cells, score), cells["texture"].nunique())


def paired_difference(first: pd.DataFrame, second: pd.DataFrame, score: str) -> Estimate:
    """Return the mean of ``first - second`` over the textures that both have, with its bootstrap interval.

    Cells are paired by texture and replicate: both methods saw the same sample.
    """
    on = ["texture", "replicate"]
    both = first[[*on, score]].merge(second[[*on, score]], on=on, suffixes=("_first", "_second"))
    both["difference"] = both[f"{score}_first"] - both[f"{score}_second"]
    return _estimate(texture_means(both, "difference"), both["texture"].nunique())


def _estimate(values: pd.Series[float], of: int) -> Estimate:
    if values.empty:
        return Estimate(None, n=0, of=of)
    low, high = bootstrap_mean(values.to_numpy(np.float64)) or (None, None)
    return Estimate(float(values.mean()), low, high, len(values), of)


def success_rate(cells: pd.DataFrame, leave_refusals_out: bool = False) -> Estimate:
    """Return the share of textures whose lattice is preserved, with Wilson's interval over textures.

    A failed cell counts as not preserved, and so does a refused one unless refusals are left out. Undecided, not scored
    and missing cells are left out; textures to which the question does not apply are not in N.

    Parameters
    ----------
    cells
        Rows of one method and lattice source, with columns ``texture``, ``verdict`` and ``applicable``.
    leave_refusals_out
        Leave refused cells out.
    """
    asked = cells[cells["applicable"].astype(bool)]
    counted = ["preserved", "lost", "failed"] if leave_refusals_out else ["preserved", "lost", "failed", "refused"]
    counts = asked[asked["verdict"].isin(counted)]
    shares = counts["verdict"].eq("preserved").groupby(counts["texture"]).mean()
    of, n = asked["texture"].nunique(), len(shares)
    if n == 0:
        return Estimate(None, n=0, of=of)
    low, high = wilson(float(shares.sum()), n) or (None, None)
    return Estimate(float(shares.mean()), low, high, n, of)


def ranks(cells: pd.DataFrame, score: str, better: str, leave_refusals_out: bool = False) -> pd.DataFrame:
    """Return each column's rank on each texture, 1 the best, averaged over replicates; NaN where it was left out.

    Ties share their mean rank. The worst rank of its sample goes to a failed cell, to a refused one unless refusals are
    left out, and to one that has no value because the lattice is lost. Other cells without a value are left out.

    Parameters
    ----------
    cells
        Rows of every column that is ranked, with ``texture``, ``replicate``, ``column``, ``verdict`` and ``score``.
    score, better
        The column, and its better way: ``"higher"``, ``"lower"`` or ``"one"``.
    leave_refusals_out
        Leave refused cells out.

    Returns
    -------
    pandas.DataFrame
        Textures by columns.
    """
    losing = ["failed"] if leave_refusals_out else ["failed", "refused"]
    worst = cells["verdict"].isin(losing) | (cells["verdict"].eq("lost") & cells[score].isna())
    scored = cells.assign(goodness=_goodness(cells[score], better).mask(worst, -np.inf))
    table = scored.pivot(index=["texture", "replicate"], columns="column", values="goodness")
    last = table.notna().sum(axis=1)
    ranked = table.rank(axis=1, ascending=False)
    ranked = ranked.apply(lambda one: one.mask(table[one.name].eq(-np.inf), last))
    by_texture: pd.DataFrame = ranked.groupby(level="texture", sort=False).mean()
    return by_texture


def mean_ranks(cells: pd.DataFrame, score: str, better: str, leave_refusals_out: bool = False) -> dict[str, Estimate]:
    """Return the mean of :func:`ranks` over textures by column, with bootstrap intervals."""
    table = ranks(cells, score, better, leave_refusals_out)
    return {str(name): _estimate(table[name].dropna(), len(table)) for name in table.columns}


def _goodness(values: pd.Series[float], better: str) -> pd.Series[float]:
    if better == "one":
        return -(values - 1).abs()
    return -values if better == "lower" else values


def as_numbers(values: Sequence[Any]) -> NDArray[np.float64]:
    """Return scores as numbers: truth values as 0 and 1, None as NaN."""
    return np.array([np.nan if value is None else float(value) for value in values], np.float64)
