"""Tests of claims: what held, failed and is undecided on made-up scores."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from nrbench.reports.csv import CsvTables
from nrbench.reports.html import HtmlReport
from nrbench.reports.plots.series_plot import plot_claim
from nrbench.reports.statistics.expectations import ClaimResult, evaluate_claims
from nrbench.runs.records import Run

Make = Callable[..., Any]
SMALL, LARGE = "rsgf:block=24", "rsgf"
NAMES = [f"t{i}" for i in range(8)]


@pytest.fixture
def make_claims(make_cell: Make, make_run: Make) -> Make:
    """Return a maker of runs with one claim: ``values(method, i)`` is the score of a method on texture i."""

    def make(
        values: Callable[[str, int], Any], expected: dict[str, Any], score: str = "randomness.variation", **claim: Any
    ) -> Run:
        cells = []
        for method in (SMALL, LARGE):
            for i, name in enumerate(NAMES):
                value = values(method, i)
                known = {"preserved": value} if score == "regularity.preserved" else {"values": {score: value}}
                cells.append(make_cell(name, method, lattice_source="given", **known))
        content = {
            "name": "tiny",
            "lattice": ["given"],
            "texture": [{"name": name, "dataset": "brick"} for name in NAMES],
            "claim": [
                {
                    "name": "blocks",
                    "quote": "Larger blocks & less randomness.",
                    "source": "a paper",
                    "score": score,
                    "axis": "block, px",
                    "series": [{"name": "rsgf", "levels": [24, 40], "methods": [SMALL, LARGE]}],
                    "expect": [{"series": "rsgf", "at": 40, **expected}],
                    **claim,
                }
            ],
        }
        return make_run(cells, suite={"content": content})

    return make


def only(run: Run) -> ClaimResult:
    """Return the one claim of a run."""
    (result,) = evaluate_claims(run)
    return result


def noise(i: int) -> float:
    """Return a number of mean near 0 that differs from texture to texture."""
    return 0.02 * float(np.sin(5.0 * i))


@pytest.mark.parametrize(
    ("gap", "relation", "outcome"),
    [
        (-0.3, "less", "held"),
        (0.3, "less", "failed"),
        (0.0, "less", "undecided"),
        (0.3, "greater", "held"),
        (-0.3, "greater", "failed"),
        (0.0, "equal", "held"),
        (0.3, "equal", "failed"),
        (0.1, "equal", "undecided"),
    ],
)
def test_a_difference_decides_a_claim(make_claims: Make, gap: float, relation: str, outcome: str) -> None:
    """The interval of the paired difference lies on the stated side, on the other, or on both."""
    expect = {"relation": relation, "other_at": 24, **({"margin": 0.1} if relation == "equal" else {})}
    run = make_claims(lambda method, i: 0.5 + 0.1 * i + (gap + noise(i)) * (method == LARGE), expect)
    result = only(run)
    assert result.outcome == outcome
    (test,) = result.expectations
    assert test.difference.value == pytest.approx(gap, abs=0.02)
    assert test.difference.n == len(NAMES)


def test_a_rate_is_compared_with_a_number(make_claims: Make) -> None:
    """Eight textures that are all preserved are more than half, with Wilson's interval; four of eight are not."""
    expect = {"relation": "less", "value": 0.5}
    assert only(make_claims(lambda *_: True, expect, "regularity.preserved")).outcome == "failed"
    assert only(make_claims(lambda *_: False, expect, "regularity.preserved")).outcome == "held"
    mixed = only(make_claims(lambda _, i: i % 2 == 0, expect, "regularity.preserved"))
    assert mixed.outcome == "undecided"
    assert [one.value for one in mixed.series[0].estimates] == [0.5, 0.5]


def test_one_failed_expectation_fails_the_claim(make_claims: Make) -> None:
    """A claim holds only if all its expectations hold."""
    up = {"series": "rsgf", "at": 40, "relation": "greater", "other_at": 24}
    near = {"series": "rsgf", "at": 24, "relation": "greater", "value": 0.4}
    low = {"series": "rsgf", "at": 24, "relation": "greater", "value": 0.9}
    for expect, outcome in (([up, near], "held"), ([up, low], "failed")):
        run = make_claims(lambda method, i: 0.5 + noise(i) + 0.3 * (method == LARGE), up, expect=expect)
        assert only(run).outcome == outcome


def test_levels_of_different_textures_are_paired_by_family(make_claims: Make) -> None:
    """If two levels have no texture in common, for example other sizes, their textures of one family are a pair."""
    halves = [NAMES[:4], NAMES[4:]]
    series = {"name": "rsgf", "levels": [24, 40], "methods": [SMALL, LARGE], "textures": halves}
    run = make_claims(
        lambda _, i: 0.5 + 0.1 * (i % 4) - 0.2 * (i // 4) + 0.3 * noise(i),
        {"relation": "less", "other_at": 24},
        series=[series],
    )
    for i, record in enumerate(run.cells):
        object.__setattr__(record.cell, "family", f"family-{i % 4}")
    (test,) = only(run).expectations
    assert (test.difference.n, test.outcome) == (4, "held")
    assert test.difference.value == pytest.approx(-0.2, abs=0.02)


def test_a_score_that_is_missing_leaves_a_claim_undecided(make_claims: Make) -> None:
    """Without values there is no interval, so nothing held and nothing failed."""
    assert only(make_claims(lambda *_: None, {"relation": "less", "other_at": 24})).outcome == "undecided"


def test_a_plot_shows_names_as_they_are(make_claims: Make) -> None:
    """Dollar signs in the name of an axis or a series are no formula: a broken one neither fails nor is left out."""
    series = {"name": r"$\frac$", "levels": [24, 40], "methods": [SMALL, LARGE]}
    expect = {"series": series["name"], "at": 40, "relation": "less", "other_at": 24}
    run = make_claims(lambda *_: 0.5, {}, series=[series], expect=[expect], axis=r"block $\frac{$")
    assert plot_claim("svg", only(run)).startswith(b"<?xml")


def test_a_run_without_claims_has_none(make_cell: Make, make_run: Make) -> None:
    """A suite that tests no claim has no such section."""
    assert evaluate_claims(make_run([make_cell()])) == []


def test_the_reports_quote_the_sentence_and_say_what_came_out(make_claims: Make, tmp_path: Path) -> None:
    """Page and tables hold the escaped quote, the outcome and the numbers; the plot is the same at every run."""
    run = make_claims(lambda method, i: 0.5 + noise(i) - 0.3 * (method == LARGE), {"relation": "less", "other_at": 24})
    page = HtmlReport().render(run, tmp_path)
    assert "Larger blocks &amp; less randomness." in page
    assert 'blocks: <span class="outcome held">held</span>' in page
    tables = {path.name: path.read_text("utf-8") for path in CsvTables().write(run, tmp_path)}
    assert "rsgf at 40 is less than rsgf at 24,held" in tables["claim_tests.csv"]
    assert len(tables["claims.csv"].splitlines()) == 3
    result = only(run)
    assert plot_claim("svg", result) == plot_claim("svg", result)
