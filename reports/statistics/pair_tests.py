"""Rank methods that lack textures, and test which methods differ: all pairs at once, by sign flips."""

from __future__ import annotations

import itertools
from dataclasses import dataclass
from functools import lru_cache
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.special import ndtri

from nrbench.streams import stream

from .estimates import FEWEST, RESAMPLES, mean_of_known

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
