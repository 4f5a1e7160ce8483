"""Estimates with intervals, and tests of whether methods differ."""

import itertools

import numpy as np
import pandas as pd
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.stats import bootstrap, permutation_test, ttest_ind

from nrbench.errors import BadInput
from nrbench.reports.statistics import estimates
from nrbench.reports.statistics.estimates import (
    ALPHA,
    PairTests,
    adjust_means,
    compare_pairs,
    detectable_losses,
    expanded_tail,
    p_values_by_flips,
)
from nrbench.reports.statistics.method_comparison import compare_methods
from nrbench.runs.records import Run

from .conftest import Make


def _cells(**columns: list[object]) -> pd.DataFrame:
    """Return a frame of cells, one column of the comparison, replicate 0 unless given."""
    size = len(next(iter(columns.values())))
    return pd.DataFrame({"replicate": [0] * size, "label": ["m"] * size, "applicable": [True] * size, **columns})


def _qualities(n: int, gaps: tuple[float, ...], seed: int = 0) -> np.ndarray:
    """Return distinct qualities of methods that are worse by ``gaps``, on n textures of different hardness."""
    rng = np.random.default_rng(seed)
    return rng.uniform(0.4, 0.8, (n, 1)) - np.array(gaps) + rng.normal(0, 0.05, (n, len(gaps)))


@pytest.mark.parametrize(
    ("successes", "n", "low", "high"),
    [(81, 263, 0.2553, 0.3662), (15, 148, 0.0624, 0.1605), (0, 20, 0.0, 0.1611), (1, 29, 0.0061, 0.1718)],
)
def test_rates_have_the_published_intervals(successes: int, n: int, low: float, high: float) -> None:
    """The interval of a rate agrees with Newcombe (1998), table I, method 3; without outcomes there is none."""
    estimate = estimates.estimate_proportion(np.arange(n) < successes)
    assert estimate.ends == pytest.approx((low, high), abs=6e-5)
    assert estimates.estimate_proportion([]).ends is None


def test_draws_of_two_methods_give_the_interval_of_welch() -> None:
    """With many draws of each texture the interval over draws is that of Welch's t for the mean of two samples."""
    rng = np.random.default_rng(1)
    one, other = rng.normal(0.2, 0.1, 40), rng.normal(0.6, 0.3, 40)
    scattered = np.tile(np.stack([one, other]), (5, 1))
    ends = estimates.draw_intervals(scattered[None])[0]
    half = ttest_ind(one, -other, equal_var=False).confidence_interval()
    assert (ends[1] - ends[0]) * np.sqrt(5) == pytest.approx((half.high - half.low) / 2, rel=0.02)
    assert ends.mean() == pytest.approx(scattered.mean())


def test_two_draws_of_each_texture_cover_the_mean_of_the_list() -> None:
    """The interval over draws holds the mean of a fixed list in 93 to 97 % of all runs, however the textures differ."""
    rng = np.random.default_rng(0)
    level, scatter = rng.uniform(0.2, 0.9, (1, 24, 1)), rng.uniform(0.02, 0.2, (1, 24, 1))
    ends = estimates.draw_intervals(level + scatter * rng.standard_normal((4000, 24, 2)))
    assert 0.93 < ((ends[:, 0] <= level.mean()) & (level.mean() <= ends[:, 1])).mean() < 0.97


def test_data_that_carry_no_interval_have_none() -> None:
    """One draw, equal values, five textures that scatter, a single draw of a texture, 38 draws: a mean alone."""
    values = np.random.default_rng(0).random((1, 24, 2))
    assert estimates.estimate_means(values)[0].ends is not None
    single, five = values.copy(), values.copy()
    single[0, 0, 0] = np.nan
    five[0, 5:] = 1.0
    for bare in (values[..., :1], np.ones((1, 24, 2)), single, five, values[:, :19]):
        for population in (False, True):
            (estimate,) = estimates.estimate_means(bare, population=population)
            assert estimate.value == pytest.approx(np.nanmean(np.nanmean(bare, 2)))
            assert estimate.ends is None or (population and len(np.unique(np.nanmean(bare, 2))) >= 9)


def test_a_population_scatters_more_than_draws() -> None:
    """The bootstrap over textures and draws agrees with SciPy's over texture means and is wider than over draws."""
    rng = np.random.default_rng(2)
    values = rng.uniform(0.2, 0.9, (1, 12, 1)) + rng.normal(0, 0.01, (1, 12, 4))
    (ends,) = estimates.population_intervals(values)
    level = 1 - 2 * expanded_tail(12)
    theirs = bootstrap((values.mean(2)[0],), np.mean, method="percentile", confidence_level=level, rng=1)
    assert ends == pytest.approx(tuple(theirs.confidence_interval), abs=0.05 * np.ptp(ends))
    assert np.ptp(ends) > 5 * np.ptp(estimates.draw_intervals(values)[0])


def test_mean_averages_replicates_before_textures() -> None:
    """A texture counts once, however many replicates it has; one without a value is not counted."""
    cells = _cells(texture=["a", "a", "a", "b", "c"], replicate=[0, 1, 2, 0, 0], score=[0.0, 0.0, 0.0, 1.0, np.nan])
    estimate = estimates.means_over_textures(cells, ["score"])["score"]
    assert (estimate.value, estimate.n, estimate.of) == (0.5, 2, 3)


def test_success_rate_counts_failures_against_the_method() -> None:
    """Failed and refused cells count as not preserved, or the refused ones not at all; others do not count.

    A texture without a lattice does not count in N, even if the method failed on it.
    """
    verdicts = ["preserved", "lost", "failed", "refused", "undecided", "unscored", "missing", "failed"]
    cells = _cells(texture=list("abcdefgh"), verdict=verdicts, applicable=[True] * 7 + [False])
    estimate = estimates.success_rate(cells)
    assert (estimate.value, estimate.n, estimate.of) == (0.25, 4, 7)
    assert estimate.ends == estimates.estimate_proportion([True, False, False, False]).ends
    assert estimates.success_rate(cells, leave_refusals_out=True).value == pytest.approx(1 / 3)


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
    """Kappa is None if both raters always give the same answer; that of a single texture has no interval."""
    table = np.zeros((1, 4, 3, 3))
    table[..., 0, 0] = 5
    assert estimates.mean_kappa(table).value is None
    estimate = estimates.mean_kappa(_answers(np.random.default_rng(5), 1, 30, 0.5)[None])
    assert estimate.value is not None and estimate.low is None


def _answers(rng: np.random.Generator, textures: int, each: int, agree: float) -> np.ndarray:
    """Return tables of two raters, two words at even odds, who agree beyond chance with the share ``agree``."""
    first = rng.integers(0, 2, (textures, each))
    second = np.where(rng.random((textures, each)) < agree, first, rng.integers(0, 2, (textures, each)))
    tables = np.zeros((textures, 2, 2))
    np.add.at(tables, (np.arange(textures)[:, None], first, second), 1)
    return tables


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


@pytest.mark.parametrize("n", [6, 12, 40])
def test_a_single_pair_has_the_permutation_test_of_scipy(n: int) -> None:
    """For two methods the p-value is that of SciPy's permutation test of paired samples."""
    values = _qualities(n, (0.0, 0.03), seed=n)
    theirs = permutation_test((values[:, 0], values[:, 1]), lambda a, b: (a - b).mean(), permutation_type="samples")
    assert compare_pairs(values).p[0, 1] == pytest.approx(theirs.pvalue, abs=0.015)


def test_equal_methods_do_not_differ() -> None:
    """Methods with the same values on every texture have p-value 1, and form one clique."""
    ours = compare_pairs(np.repeat(np.random.default_rng(0).random((12, 1)), 4, 1))
    off = ~np.eye(4, dtype=bool)
    assert (ours.p[off] == 1).all() and not ours.better.any() and ours.cliques == ((0, 3),)


def test_a_method_that_is_always_worse_differs() -> None:
    """Two groups that are far apart are two cliques, and the sign says which is better, whatever one refusal."""
    ours = compare_pairs(_qualities(20, (0.0, 0.005, 0.4, 0.402)))
    assert ours.cliques == ((0, 1), (2, 3))
    assert ours.better[:2, 2:].all() and not ours.better[2:].any()
    values = _qualities(18, (0.0, 0.1))
    values[4, 0] = 0.0
    assert not compare_pairs(values).better[1, 0]


def test_a_detectable_loss_is_found() -> None:
    """A loss of the size that is called detectable is found in 80 % of comparisons; without scatter there is none."""
    gaps = 0.1 * np.random.default_rng(0).standard_normal((200, 12, 3))
    loss = np.median([detectable_losses(one)[0] for one in gaps[:40]])
    found = [p_values_by_flips(one + np.array((loss, 0, 0)), one_sided=True)[0] <= ALPHA for one in gaps]
    assert 0.65 < np.mean(found) < 0.95
    assert np.isnan(detectable_losses(np.full((12, 2), 0.3))).all()
    assert np.isnan(detectable_losses(gaps[0, :5])).all()


def test_equal_methods_rarely_differ_anywhere() -> None:
    """Among five equal methods on six textures, any pair differs in at most 5 % of the tables, up to chance."""
    found = [compare_pairs(_qualities(6, (0.0,) * 5, seed)).better.any() for seed in range(200)]
    assert np.mean(found) < 0.05 + 2.6 * np.sqrt(0.05 * 0.95 / 200)


def test_cells_of_a_method_do_not_move_two_others() -> None:
    """Without cells of a third method the means of two others differ by the same amount, and have the same order."""
    values = _qualities(12, (0.0, 0.02, 0.1))
    holed = values.copy()
    holed[[1, 4, 7], 2] = np.nan
    whole, part = adjust_means(values), adjust_means(holed)
    assert np.diff(part)[0] == pytest.approx(np.diff(whole)[0])
    easy = values.copy()
    easy[np.argsort(values[:, 0])[:5], 2] = np.nan
    assert adjust_means(easy)[2] == pytest.approx(whole[2], abs=0.03)
    assert np.nanmean(easy[:, 2]) > whole[2] + 0.05


@given(st.integers(2, 9), st.integers(0, 2**31))
def test_cliques_hold_no_pair_that_differs(count: int, seed: int) -> None:
    """No clique holds a pair that differs, none lies in another, and equal neighbors share one."""
    half = np.triu(np.random.default_rng(seed).random((count, count)) < 0.4, 1)
    different = half | half.T
    cliques = PairTests(np.where(different, 0.0, 1.0), half, np.full((count, count), 9.0)).cliques
    for first, last in cliques:
        assert not different[first : last + 1, first : last + 1].any()
    assert all(a < c and b < d for (a, b), (c, d) in itertools.pairwise(cliques))
    for i in range(count - 1):
        assert different[i, i + 1] or any(a <= i and i + 1 <= b for a, b in cliques)


def _run(make_cell: Make, make_run: Make, qualities: dict[str, dict[str, float]]) -> Run:
    cells = [
        make_cell(texture, method, perils=value)
        for method, by_texture in qualities.items()
        for texture, value in by_texture.items()
    ]
    return make_run(cells)


def test_methods_on_few_textures_are_no_yardstick(make_cell: Make, make_run: Make) -> None:
    """A method that ran on a few easy textures has no rank, and does not decide who leads among the others."""
    hard = {f"t{i}": 0.55 + 0.01 * (i % 5) for i in range(24)}
    run = _run(make_cell, make_run, {
        "good": hard,
        "worse": {name: value - 0.1 for name, value in hard.items()},
        "easy": {f"e{i}": 0.9 for i in range(5)},
    })  # fmt: skip
    by_name = {one.method.name: one for one in compare_methods(run).summaries}
    assert (by_name["good"].rank, by_name["good"].leading) == (1, True)
    assert (by_name["worse"].rank, by_name["worse"].leading) == (2, False)
    assert (by_name["easy"].rank, by_name["easy"].leading) == (None, False)


def test_a_method_that_shares_no_texture_with_the_best_does_not_lead(make_cell: Make, make_run: Make) -> None:
    """Without common textures the difference to the best is unknown, so there is no star."""
    run = _run(make_cell, make_run, {
        "best": {f"a{i}": 0.8 + i / 99 for i in range(6)},
        "other": {f"b{i}": 0.7 + i / 99 for i in range(6)},
    })  # fmt: skip
    assert [one.leading for one in compare_methods(run).summaries] == [True, False]


def test_tests_begin_at_six_textures(make_cell: Make, make_run: Make) -> None:
    """Stars and p-values need six textures; the differences do not."""
    for n in (5, 6):
        values = _qualities(n, (0.0, 0.2))
        run = _run(make_cell, make_run, {m: {f"t{i}": values[i, j] for i in range(n)} for j, m in enumerate("ab")})
        found = compare_methods(run)
        (against,) = found.against
        assert against.estimate.value == pytest.approx((values[:, 1] - values[:, 0]).mean())
        assert (found.tests is None, against.p is None) == (n == 5, n == 5)
        assert [one.leading for one in found.summaries] == [n == 6, False]
        assert ("sign flips" in found.leading_sentence, "fewer than 6" in found.leading_sentence) == (n == 6, n == 5)


def test_a_chosen_baseline(ranked: Run) -> None:
    """The baseline can be any method; an unknown one is an error that names the methods."""
    found = compare_methods(ranked, baseline="shaky")
    assert found.baseline is not None and found.baseline.name == "shaky"
    assert "shaky" not in {one.first.name for one in found.against}
    with pytest.raises(BadInput, match=r"give one of: .*shaky"):
        compare_methods(ranked, baseline="nobody")


def test_without_tests_nothing_is_tested(ranked: Run) -> None:
    """Without tests there is no leading group, no p-value and no comparison with a baseline; the ranking stays."""
    found = compare_methods(ranked, tests=False)
    assert not found.against and found.tests is None and not found.leading_legend
    assert not any(one.leading for one in found.summaries)
    assert [one.rank for one in found.summaries] == [one.rank for one in compare_methods(ranked).summaries]
