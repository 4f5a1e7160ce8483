from __future__ import annotations

import numpy as np
import pandas as pd
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import ArrayLike

from nrbench.reports.statistics import estimates


def _cells(**columns: list[object]) -> pd.DataFrame:
    """Return a frame of cells, one column of the comparison, replicate 0 unless given."""
    size = len(next(iter(columns.values())))
    return pd.DataFrame({"replicate": [0] * size, "label": ["m"] * size, "applicable": [True] * size, **columns})


def _interval(values: ArrayLike) -> tuple[float, float]:
    """Return the bootstrap interval of the mean of one sample."""
    low, high = estimates.bootstrap_intervals(np.asarray(values, float)[None])[0]
    return float(low), float(high)


@pytest.mark.parametrize(
    ("successes", "n", "low", "high"),
    [(81, 263, 0.2553, 0.3662), (15, 148, 0.0624, 0.1605), (0, 20, 0.0, 0.1611), (1, 29, 0.0061, 0.1718)],
)
def test_wilson_gives_the_published_intervals(successes: int, n: int, low: float, high: float) -> None:
    """Wilson's interval agrees with Newcombe (1998), table I, method 3."""
    assert estimates.wilson_interval(successes, n) == pytest.approx((low, high), abs=6e-5)


def test_wilson_of_nothing_is_none() -> None:
    """Without trials there is no interval."""
    assert estimates.wilson_interval(0, 0) is None


@given(st.integers(1, 50), st.floats(0, 1))
def test_wilson_holds_the_share_inside_zero_and_one(n: int, share: float) -> None:
    """Wilson's interval lies in [0, 1] and contains the share, for whole and fractional successes."""
    estimate = estimates.wilson_interval(share * n, n)
    assert estimate is not None
    assert 0 <= estimate[0] <= share * n / n <= estimate[1] <= 1


def test_bootstrap_is_deterministic_and_ignores_order() -> None:
    """Equal values give an equal interval, whatever their order."""
    values = np.random.default_rng(0).random(12)
    assert _interval(values) == _interval(values[::-1])


def test_bootstrap_covers_the_mean_of_few_values() -> None:
    """On five normal values the interval holds the true mean about as often as it says (plain percentiles: 83 %)."""
    draws = np.random.default_rng(3).normal(0, 1, (300, 5))
    ends = np.array([_interval(draw) for draw in draws])
    assert ((ends[:, 0] <= 0) & (ends[:, 1] >= 0)).mean() > 0.88


def test_bootstrap_of_one_value_is_none_and_of_equal_values_a_point() -> None:
    """One value has no interval; the interval of equal values is a point."""
    assert estimates.estimate_mean([0.5], 1).ends is None
    assert _interval([0.5] * 6) == (0.5, 0.5)


@settings(max_examples=20)
@given(st.lists(st.floats(-10, 10), min_size=2, max_size=12))
def test_bootstrap_stays_between_the_extremes(values: list[float]) -> None:
    """A mean of resamples lies between the smallest and the largest value."""
    low, high = _interval(values)
    assert min(values) - 1e-9 <= low <= high <= max(values) + 1e-9


def test_mean_averages_replicates_before_textures() -> None:
    """A texture counts once, however many replicates it has; one without a value is not counted."""
    cells = _cells(texture=["a", "a", "a", "b", "c"], replicate=[0, 1, 2, 0, 0], score=[0.0, 0.0, 0.0, 1.0, np.nan])
    estimate = estimates.means_over_textures(cells, ["score"])["score"]
    assert (estimate.value, estimate.n, estimate.of) == (0.5, 2, 3)


def test_paired_difference_uses_common_samples_only() -> None:
    """Differences are taken sample by sample; a sample that one method lacks is left out."""
    first = _cells(texture=["a", "b", "c"], score=[1.0, 3.0, np.nan])
    second = _cells(texture=["b", "a", "c"], score=[2.0, 0.5, 9.0])
    estimate = estimates.paired_differences(first, second, ["score"])["score"]
    assert (estimate.value, estimate.n, estimate.of) == (0.75, 2, 3)
    assert estimate.excludes_zero


def test_success_rate_counts_failures_against_the_method() -> None:
    """Failed and refused cells count as not preserved; undecided, unscored and missing ones do not count."""
    verdicts = ["preserved", "lost", "failed", "refused", "undecided", "unscored", "missing"]
    estimate = estimates.success_rate(_cells(texture=list("abcdefg"), verdict=verdicts))
    assert (estimate.value, estimate.n, estimate.of) == (0.25, 4, 7)
    assert (estimate.low, estimate.high) == pytest.approx(_interval([1, 0, 0, 0]))


def test_success_rate_can_leave_refusals_out() -> None:
    """With refusals left out, failures still count."""
    cells = _cells(texture=list("abc"), verdict=["preserved", "failed", "refused"])
    assert estimates.success_rate(cells, leave_refusals_out=True).value == 0.5


def test_success_rate_skips_textures_without_a_lattice() -> None:
    """A texture without a lattice does not count in N, even if the method failed on it."""
    cells = _cells(texture=["a", "b"], verdict=["preserved", "failed"], applicable=[True, False])
    estimate = estimates.success_rate(cells)
    assert (estimate.value, estimate.n, estimate.of) == (1.0, 1, 1)


@pytest.mark.parametrize(
    ("table", "expected"),
    [
        ([[20, 5], [10, 15]], 0.4),
        ([[45, 15], [25, 15]], 0.1304),
        ([[25, 35], [5, 35]], 0.2593),
        ([[88, 14, 18], [10, 40, 10], [2, 6, 12]], 0.4915),
        ([[5, 0], [0, 5]], 1.0),
        ([[0, 5], [5, 0]], -1.0),
    ],
)
def test_kappa_gives_published_values(table: list[list[int]], expected: float) -> None:
    """Cohen's kappa of tables with known answers (the fourth is Cohen's own of 1960, with 200 cases)."""
    assert estimates.kappa(np.array(table, float)) == pytest.approx(expected, abs=6e-4)


def test_one_answer_throughout_has_no_kappa() -> None:
    """Kappa is NaN, and None in the estimate, if both raters always give the same answer."""
    table = np.zeros((1, 4, 3, 3))
    table[..., 0, 0] = 5
    assert np.isnan(estimates.kappa(table.sum(1))).all()
    assert estimates.mean_kappa(table).value is None


def _answers(rng: np.random.Generator, textures: int, each: int, agree: float) -> np.ndarray:
    """Return tables of two raters, two words at even odds, who agree beyond chance with the share ``agree``."""
    first = rng.integers(0, 2, (textures, each))
    second = np.where(rng.random((textures, each)) < agree, first, rng.integers(0, 2, (textures, each)))
    tables = np.zeros((textures, 2, 2))
    np.add.at(tables, (np.arange(textures)[:, None], first, second), 1)
    return tables


@pytest.mark.parametrize("agree", [0.0, 0.5, 0.9])
def test_kappa_of_synthetic_raters_is_known(agree: float) -> None:
    """Raters who copy each other with probability k, and otherwise toss a coin, have kappa k."""
    table = _answers(np.random.default_rng(0), 40, 100, agree)
    estimate = estimates.mean_kappa(table[None])
    assert estimate.value == pytest.approx(agree, abs=0.04)
    assert estimate.low is not None and estimate.high is not None
    assert estimate.low <= agree + 0.04 and estimate.high >= agree - 0.04
    assert (estimate.n, estimate.of) == (40, 40)


def test_interval_covers_the_true_kappa() -> None:
    """The 95 % interval contains the true kappa 0.6 in at least 52 of 60 sets of answers."""
    hits = 0
    for seed in range(60):
        estimate = estimates.mean_kappa(_answers(np.random.default_rng(seed), 12, 10, 0.6)[None])
        hits += (estimate.low or 0) <= 0.6 <= (estimate.high or 0)
    assert hits >= 52


def test_interval_is_over_textures() -> None:
    """Repeating all answers a hundred times leaves the interval unchanged."""
    table = _answers(np.random.default_rng(3), 8, 6, 0.6)[None]
    once, often = estimates.mean_kappa(table), estimates.mean_kappa(100 * table)
    assert (once.low, once.high) == pytest.approx((often.low, often.high))


def test_one_texture_has_no_interval() -> None:
    """Kappa of a single texture has no interval."""
    estimate = estimates.mean_kappa(_answers(np.random.default_rng(5), 1, 30, 0.5)[None])
    assert estimate.value is not None and estimate.low is None


@given(st.lists(st.tuples(st.integers(0, 4), st.integers(0, 3)), min_size=2, max_size=8))
def test_rank_agreement_counts_pairs(pairs: list[tuple[int, int]]) -> None:
    """Tau-b and the share of pairs in the same order follow from the counts of pairs; they do not depend on scale."""
    scores, answers = (np.array(values, float) for values in zip(*pairs, strict=True))
    signs = [
        (np.sign(scores[i] - scores[j]), np.sign(answers[i] - answers[j])) for i in range(len(pairs)) for j in range(i)
    ]
    tau, ordered = estimates.rank_agreement(scores, answers)
    untied = [one * other for one, other in signs if other]
    assert (tau, ordered) == pytest.approx(estimates.rank_agreement(scores**3 - 7, np.exp(answers)), nan_ok=True)
    if not untied:
        assert np.isnan(tau) and np.isnan(ordered)
        return
    known = sum(1 for one, _ in signs if one)
    assert tau == pytest.approx(sum(untied) / np.sqrt(known * len(untied)) if known else 0.0)
    assert ordered == pytest.approx(np.mean([(1 + sign) / 2 for sign in untied]))
