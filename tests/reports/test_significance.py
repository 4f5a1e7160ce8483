from __future__ import annotations

import itertools
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.stats import bootstrap, chi2, rankdata

from nrbench.errors import BadInput
from nrbench.reports.statistics.estimates import bootstrap_intervals, expanded_tail
from nrbench.reports.statistics.method_comparison import compare_methods
from nrbench.reports.statistics.significance import (
    adjust_holm,
    compare_ranks,
    find_cliques,
    rank_biserial,
    signed_rank_p_values,
)
from nrbench.runs.records import Run

from .conftest import PERILS

Make = Callable[..., Any]


def _qualities(n: int, gaps: tuple[float, ...], seed: int = 0) -> np.ndarray:
    """Return distinct qualities of methods that are worse by ``gaps``, on n textures of different hardness."""
    rng = np.random.default_rng(seed)
    return rng.uniform(0.4, 0.8, (n, 1)) - np.array(gaps) + rng.normal(0, 0.05, (n, len(gaps)))


@pytest.mark.parametrize("n", [9, 12, 43])
def test_intervals_agree_with_scipy(n: int) -> None:
    """The intervals are SciPy's BCa intervals at the expanded level, up to the scatter of the resamples."""
    values = np.random.default_rng(n).beta(0.5, 0.8, n)
    level = 1 - 2 * expanded_tail(n)
    ours = bootstrap_intervals(values[None])[0]
    theirs = bootstrap((values,), np.mean, method="BCa", confidence_level=level, n_resamples=20_000, rng=1)
    width = ours[1] - ours[0]
    assert ours == pytest.approx(tuple(theirs.confidence_interval), abs=0.05 * width)


def test_intervals_do_not_depend_on_the_company() -> None:
    """An interval is the same alone and among others."""
    samples = np.random.default_rng(0).random((300, 9))
    assert bootstrap_intervals(samples)[17] == pytest.approx(bootstrap_intervals(samples[17:18])[0], abs=1e-12)


def test_pairs_agree_with_scikit_posthocs() -> None:
    """The adjusted p-values are those of ``posthoc_wilcoxon`` with Holm's method, and so are the average ranks."""
    posthocs = pytest.importorskip("scikit_posthocs", reason="needs scikit-posthocs, of the extra test")
    values = _qualities(14, (0.0, 0.02, 0.1, 0.12, 0.3))
    theirs = posthocs.posthoc_wilcoxon(values.T.tolist(), zero_method="zsplit", p_adjust="holm").to_numpy()
    ours = compare_ranks(values)
    off = ~np.eye(5, dtype=bool)
    assert ours.adjusted[off] == pytest.approx(theirs[off])
    p = np.random.default_rng(1).random(20) ** 3
    multipletests = pytest.importorskip("statsmodels.stats.multitest").multipletests
    assert adjust_holm(p) == pytest.approx(multipletests(p, method="holm")[1])


def test_friedman_agrees_with_the_definition() -> None:
    """Friedman's p-value is that of the chi-squared statistic of the rank sums."""
    values = _qualities(12, (0.0, 0.03, 0.05))
    ranks = rankdata(-values, axis=1)
    n, k = values.shape
    statistic = 12 * n / (k * (k + 1)) * ((ranks.mean(0) - (k + 1) / 2) ** 2).sum()
    ours = compare_ranks(values)
    assert ours.friedman == pytest.approx(chi2.sf(statistic, k - 1))
    assert ours.ranks == pytest.approx(tuple(ranks.mean(0)))


def test_equal_methods_do_not_differ() -> None:
    """Methods with the same values on every texture have p-value 1, and form one clique."""
    ours = compare_ranks(np.repeat(np.random.default_rng(0).random((12, 1)), 4, 1))
    assert not ours.different.any() and ours.cliques == ((0, 3),) and ours.friedman == 1


def test_a_method_that_is_always_worse_differs() -> None:
    """Two groups that are far apart are two cliques."""
    ours = compare_ranks(_qualities(20, (0.0, 0.005, 0.4, 0.402)))
    assert ours.cliques == ((0, 1), (2, 3))
    assert set(ours.order[:2]) == {0, 1}


def test_wilcoxon_of_a_known_example() -> None:
    """Ten differences of one sign have p = 2/1024; ties and zeros use the normal approximation."""
    rising = np.arange(1.0, 11.0)
    mixed = np.array([0, 0, 1, 1, 1, -1, 2, 2, 3, 3.0])
    p = signed_rank_p_values(np.stack([rising, -rising, mixed, np.zeros(10)], 1))
    assert p[:2] == pytest.approx(2 / 1024)
    assert 0.01 < p[2] < 0.2 and p[3] == 1


@given(st.integers(2, 9), st.integers(0, 2**31))
def test_cliques_hold_no_pair_that_differs(count: int, seed: int) -> None:
    """No clique holds a pair that differs, none lies in another, and equal neighbors share one."""
    half = np.triu(np.random.default_rng(seed).random((count, count)) < 0.4, 1)
    different = half | half.T
    cliques = find_cliques(different)
    for first, last in cliques:
        assert not different[first : last + 1, first : last + 1].any()
    assert all(a < c and b < d for (a, b), (c, d) in itertools.pairwise(cliques))
    for i in range(count - 1):
        assert different[i, i + 1] or any(a <= i and i + 1 <= b for a, b in cliques)


@settings(max_examples=30)
@given(st.lists(st.integers(-5, 5), max_size=9))
def test_effect_size_is_antisymmetric(values: list[int]) -> None:
    """The effect changes its sign with the differences, lies in [-1, 1], and is 1 if all are positive."""
    effect = rank_biserial(values)
    assert effect is None or -1 <= effect <= 1
    assert rank_biserial([-x for x in values]) == (None if effect is None else pytest.approx(-effect))
    assert rank_biserial([abs(x) + 1 for x in values]) == (1.0 if values else None)


def _run(make_cell: Make, make_run: Make, qualities: dict[str, dict[str, float]]) -> Run:
    cells = [
        make_cell(texture, method, perils=dict.fromkeys(PERILS, value))
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


def test_tests_begin_at_ten_textures(make_cell: Make, make_run: Make) -> None:
    """Ranks and p-values need ten textures; the differences and effect sizes do not."""
    for n in (9, 10):
        values = _qualities(n, (0.0, 0.2))
        run = _run(make_cell, make_run, {m: {f"t{i}": values[i, j] for i in range(n)} for j, m in enumerate("ab")})
        found = compare_methods(run)
        (against,) = found.against
        assert against.estimate.value == pytest.approx((values[:, 1] - values[:, 0]).mean())
        assert against.effect == -1
        assert (found.tests is None, against.p is None) == (n == 9, n == 9)
    assert [one.average_rank for one in found.summaries] == [1, 2]
    assert "Wilcoxon" in found.leading_legend


def test_a_chosen_baseline(ranked: Run) -> None:
    """The baseline can be any method; an unknown one is an error that names the methods."""
    found = compare_methods(ranked, baseline="shaky")
    assert found.baseline is not None and found.baseline.name == "shaky"
    assert "shaky" not in {one.method.name for one in found.against}
    with pytest.raises(BadInput, match=r"give one of: .*shaky"):
        compare_methods(ranked, baseline="nobody")


def test_without_tests_nothing_is_tested(ranked: Run) -> None:
    """Without tests there is no leading group, no p-value and no comparison with a baseline; the ranking stays."""
    found = compare_methods(ranked, tests=False)
    assert not found.against and found.tests is None and not found.leading_legend
    assert not any(one.leading for one in found.summaries)
    assert [one.rank for one in found.summaries] == [one.rank for one in compare_methods(ranked).summaries]
