from __future__ import annotations

import numpy as np
import pytest

from nrbench.reports.statistics.kappa import kappa, mean_kappa, tables


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
    assert kappa(np.array(table, float)) == pytest.approx(expected, abs=6e-4)


def test_one_answer_throughout_has_no_kappa() -> None:
    """Where both always say one word there is nothing beyond chance: NaN, and None in the estimate."""
    table = np.zeros((1, 4, 3, 3))
    table[..., 0, 0] = 5
    assert np.isnan(kappa(table.sum(1))).all()
    assert mean_kappa(table).value is None


def _answers(rng: np.random.Generator, textures: int, each: int, agree: float) -> np.ndarray:
    """Return tables of two raters, two words at even odds, who agree beyond chance with the share ``agree``."""
    first = rng.integers(0, 2, (textures, each))
    second = np.where(rng.random((textures, each)) < agree, first, rng.integers(0, 2, (textures, each)))
    words = ("p", "l")
    units = np.repeat(np.arange(textures), each).astype(str)
    return tables(
        [words[i] for i in first.ravel()], [words[i] for i in second.ravel()], list(units), words, sorted(set(units))
    )


@pytest.mark.parametrize("agree", [0.0, 0.5, 0.9])
def test_kappa_of_synthetic_raters_is_known(agree: float) -> None:
    """Raters who copy the other with chance k, and else toss a coin, have kappa k."""
    table = _answers(np.random.default_rng(0), 40, 100, agree)
    found = mean_kappa(table[None])
    assert found.value == pytest.approx(agree, abs=0.04)
    assert found.low is not None and found.high is not None
    assert found.low <= agree + 0.04 and found.high >= agree - 0.04
    assert (found.n, found.of) == (40, 40)


def test_interval_covers_the_true_kappa() -> None:
    """Of 60 sets of labels of true kappa 0.6, the interval holds it about as often as it says."""
    hits = 0
    for seed in range(60):
        found = mean_kappa(_answers(np.random.default_rng(seed), 12, 10, 0.6)[None])
        hits += (found.low or 0) <= 0.6 <= (found.high or 0)
    assert hits >= 52


def test_interval_is_over_textures() -> None:
    """The same answers a hundred times over on each texture are no more evidence."""
    table = _answers(np.random.default_rng(3), 8, 6, 0.6)[None]
    once, often = mean_kappa(table), mean_kappa(100 * table)
    assert (once.low, once.high) == pytest.approx((often.low, often.high))


def test_mean_over_pairs_leaves_unknown_pairs_out() -> None:
    """A pair of raters without a common item changes nothing."""
    table = _answers(np.random.default_rng(4), 9, 9, 0.5)
    assert mean_kappa(np.stack([table, np.zeros_like(table)])).value == mean_kappa(table[None]).value


def test_one_texture_has_no_interval() -> None:
    """One texture says nothing of the scatter over textures."""
    found = mean_kappa(_answers(np.random.default_rng(5), 1, 30, 0.5)[None])
    assert found.value is not None and found.low is None
