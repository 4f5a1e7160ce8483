"""Claims of papers, and the verdicts of the report of 2004."""

from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pytest

from nrbench.reports.csv import CsvTables
from nrbench.reports.html import HtmlReport
from nrbench.reports.latex import LatexTables
from nrbench.reports.markdown import MarkdownTables
from nrbench.reports.page.plots import plot_claim
from nrbench.reports.statistics.expectations import (
    GROUPS,
    ClaimResult,
    PublishedComparison,
    compare_with_published,
    evaluate_claims,
    read_published,
)
from nrbench.reports.statistics.frames import print_published
from nrbench.reports.statistics.method_comparison import compare_methods
from nrbench.reports.text import TextTable
from nrbench.runs.records import Run
from nrbench.suites.suite import load_suite

from .conftest import Make

SMALL, LARGE = "rsgf:block=24", "rsgf"
NAMES = [f"t{i}" for i in range(10)]


@pytest.fixture
def make_claims(make_cell: Make, make_run: Make) -> Make:
    """Return a maker of runs with one claim: ``values(method, i)`` is the score of a method on texture i."""

    def make(
        values: Callable[[str, int], Any],
        expected: dict[str, Any],
        score: str = "randomness.variation",
        names: Sequence[str] = NAMES,
        **claim: Any,
    ) -> Run:
        cells = []
        for method in (SMALL, LARGE):
            for i, name in enumerate(names):
                value = values(method, i)
                known = {"preserved": value} if score == "regularity.preserved" else {"values": {score: value}}
                cells.append(make_cell(name, method, lattice_source="given", **known))
        content = {
            "name": "tiny",
            "lattice": ["given"],
            "texture": [{"name": name, "dataset": "brick"} for name in names],
        }
        stated = {
            "name": "blocks",
            "quote": "Larger blocks & less randomness.",
            "source": "a paper",
            "score": score,
            "axis": "block, px",
            "series": [{"name": "rsgf", "levels": [24, 40], "methods": [SMALL, LARGE]}],
            "expect": [{"series": "rsgf", "at": 40, **expected}],
        }
        return make_run(cells, suite={"content": {**content, "claim": [{**stated, **claim}]}})

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
        (-0.3, "less", "held"), (0.3, "less", "failed"), (0.0, "less", "undecided"), (0.3, "greater", "held"),
        (-0.3, "greater", "failed"), (0.0, "equal", "held"), (0.3, "equal", "failed"), (0.1, "equal", "undecided"),
    ],
)  # fmt: skip
def test_a_difference_decides_a_claim(make_claims: Make, gap: float, relation: str, outcome: str) -> None:
    """The interval of the paired difference lies on the stated side, on the other, or on both."""
    expect = {"relation": relation, "other_at": 24, **({"margin": 0.1} if relation == "equal" else {})}
    run = make_claims(lambda method, i: 0.3 + 0.1 * i + (gap + noise(i)) * (method == LARGE), expect)
    result = only(run)
    assert result.outcome == outcome
    (test,) = result.expectations
    assert test.difference.value == pytest.approx(gap, abs=0.02)
    assert test.difference.n == len(NAMES)


def test_a_rate_is_compared_with_a_number(make_claims: Make) -> None:
    """Ten textures that are all preserved are more than half, with Wilson's interval; five of ten are not."""
    expect = {"relation": "less", "value": 0.5}
    for share, outcome in ((0, "held"), (0.5, "undecided"), (1, "failed")):
        result = only(make_claims(lambda _, i, n=10 * share: i < n, expect, "regularity.preserved"))
        assert result.outcome == outcome
        assert [one.value for one in result.series[0].estimates] == [share, share]


def test_one_failed_expectation_fails_the_claim(make_claims: Make) -> None:
    """A claim holds only if all its expectations hold."""
    up = {"series": "rsgf", "at": 40, "relation": "greater", "other_at": 24}
    near = {"series": "rsgf", "at": 24, "relation": "greater", "value": 0.4}
    low = {"series": "rsgf", "at": 24, "relation": "greater", "value": 0.9}
    for expect, outcome in (([up, near], "held"), ([up, low], "failed")):
        run = make_claims(lambda method, i: 0.5 + noise(i) + (0.3 + noise(i)) * (method == LARGE), up, expect=expect)
        assert only(run).outcome == outcome


def test_levels_of_different_textures_are_paired_by_family(make_claims: Make) -> None:
    """If two levels have no texture in common, for example other sizes, their textures of one family are a pair."""
    names = [f"t{i}" for i in range(18)]
    halves = [names[:9], names[9:]]
    series = {"name": "rsgf", "levels": [24, 40], "methods": [SMALL, LARGE], "textures": halves}
    run = make_claims(
        lambda _, i: 0.5 + 0.1 * (i % 9) - 0.2 * (i // 9) + 0.3 * noise(i),
        {"relation": "less", "other_at": 24},
        names=names,
        series=[series],
    )
    for i, record in enumerate(run.cells):
        object.__setattr__(record.cell, "family", f"family-{i % 9}")
    (test,) = only(run).expectations
    assert (test.difference.n, test.outcome) == (9, "held")
    assert test.difference.value == pytest.approx(-0.2, abs=0.02)


def test_a_score_that_is_missing_leaves_a_claim_undecided(make_claims: Make) -> None:
    """Without values there is no interval, so nothing held and nothing failed."""
    assert only(make_claims(lambda *_: None, {"relation": "less", "other_at": 24})).outcome == "undecided"


def test_the_reports_quote_the_sentence_and_say_what_came_out(make_claims: Make, tmp_path: Path) -> None:
    """Page and tables hold the escaped quote, the outcome and the numbers; the plot is the same at every run."""
    run = make_claims(
        lambda method, i: 0.5 - (0.3 + noise(i)) * (method == LARGE), {"relation": "less", "other_at": 24}
    )
    page = HtmlReport().render(run, tmp_path)
    assert "Larger blocks &amp; less randomness." in page
    assert 'blocks: <span class="outcome held">held</span>' in page
    tables = {path.name: path.read_text("utf-8") for path in CsvTables().write(run, tmp_path)}
    assert "rsgf at 40 is less than rsgf at 24,held" in tables["claim_tests.csv"]
    assert len(tables["claims.csv"].splitlines()) == 3
    result = only(run)
    assert plot_claim("svg", result) == plot_claim("svg", result)


METHODS = ("graph-cuts", "tile-set", "regularized-patch", "patch-based", "quilting")


def _published_rate(method: str, first: int, last: int) -> float:
    table = read_published()
    words = table.loc[table["figure"].between(first, last), method].dropna().tolist()
    return words.count("preserved") / len(words)


@pytest.fixture
def make_report(make_cell: Make, make_run: Make) -> Make:
    """Return a maker of runs of all figures: ``verdict(figure, method)`` is the measured verdict of a cell."""

    def make(verdict: Callable[[Any, str], bool | None], methods: tuple[str, ...] = METHODS) -> Run:
        figures = read_published().to_dict("records")
        rows = [{"name": f"f{one['figure']}", "figure": one["figure"]} for one in figures]
        cells = [
            make_cell(f"f{one['figure']}", method, lattice_source="none", preserved=verdict(one, method))
            for one in figures
            for method in methods
        ]
        return make_run(cells, suite={"content": {"texture": rows}})

    return make


def compare(run: Run) -> PublishedComparison:
    """Return the comparison of a run that has one."""
    published = compare_with_published(run, compare_methods(run))
    assert published is not None
    return published


def test_the_published_rates_are_those_that_the_report_prints() -> None:
    """Table 2: 100 % for all four methods. Table 3: 53 %, 95 %, 86 % and 23 %. Image quilting: two of six."""
    assert [_published_rate(method, 3, 7) for method in METHODS[:4]] == [1] * 4
    assert [round(100 * _published_rate(method, 8, 45)) for method in METHODS[:4]] == [53, 95, 86, 23]
    assert _published_rate("quilting", 3, 45) == 2 / 6


def test_every_published_figure_has_an_analogue() -> None:
    """The suite report2004 has one texture for each figure of the tables."""
    figures = {row.figure for row in load_suite("report2004").texture if row.figure}
    assert figures == set(read_published()["figure"])


def test_a_run_that_repeats_the_report_agrees_with_it(make_report: Make) -> None:
    """If each cell has the published verdict, all differences are 0, agreement is 1 and kappa is 1."""
    published = compare(make_report(lambda figure, method: figure[method] == "preserved"))
    assert [one.difference.value for one in published.rates] == [0] * len(published.rates)
    assert {one.value for one in published.classes["agreement"]} == {1}
    assert (published.kappa.value, *published.kappa.ends) == pytest.approx((1, 1, 1))
    assert published.chance is not None and published.chance[0] < 0.9
    assert "measured verdicts: 1.00. If" in published.agreement  # an interval of no width is left out
    kinds = ["motif", "tiles", "brick", "woven", "damaged"]
    rows = ["odd figures", "even figures", "all, lattice alone", "all"]
    assert published.classes["class"].tolist() == [*kinds, *rows]


def test_rates_rest_on_the_same_figures(make_report: Make) -> None:
    """A figure without a measured verdict is left out of both rates, and the published rate of all figures is kept."""
    published = compare(make_report(lambda figure, _: None if figure["figure"] < 20 else True))
    (rate,) = [one for one in published.rates if one.words == "figures 8-29" and one.method.name == "patch-based"]
    assert (rate.published.n, rate.expected.n, rate.measured.n) == (22, 10, 10)
    assert rate.measured.value == 1
    assert rate.expected.value == pytest.approx(3 / 10)
    assert rate.difference.value == pytest.approx(7 / 10)


def test_each_group_has_the_methods_of_the_report(make_report: Make) -> None:
    """Methods are compared only over figures on which the report ran all methods of the group."""
    published = compare(make_report(lambda *_: True))
    found = {(one.words, one.method.name): one.published.n for one in published.rates}
    assert found == {
        **{("figures 3-7", name): 5 for name in METHODS[:4]},
        **{("figures 8-29", name): 22 for name in METHODS[:4]},
        **{("figures 8-45", name): 38 for name in ("graph-cuts", "tile-set")},
        ("six figures", "quilting"): 6,
    }
    assert set(GROUPS) == {group for group, _ in found}


def test_the_lattice_comes_from_where_the_report_took_it(make_cell: Make, make_run: Make) -> None:
    """tile-set counts with its own lattice, regularized-patch with the given one; default parameters come first."""
    sources = ("given", "own")
    names = ("tile-set:blend=4", "tile-set", "regularized-patch")
    cells = [make_cell("f8", name, lattice_source=source) for name in names for source in sources]
    run = make_run(cells, suite={"content": {"texture": [{"name": "f8", "figure": 8}]}})
    found = {(one.name, one.lattice_source) for one in compare(run).methods}
    assert found == {("tile-set", "own"), ("regularized-patch", "given")}


def test_kappa_has_an_interval_over_figures(make_report: Make, tmp_path: Path) -> None:
    """Verdicts that agree on two of three figures have a kappa between 0 and 1, inside its interval, in all reports."""
    run = make_report(lambda figure, method: (figure[method] == "preserved") ^ (figure["figure"] % 3 == 0))
    published = compare(run)
    low, high = published.kappa.ends or (1.0, 0.0)
    assert published.kappa.value is not None and 0 < low < published.kappa.value < high < 1
    CsvTables().write(run, tmp_path)
    table = pd.read_csv(tmp_path / "published_classes.csv")
    assert table["kappa_low"].iloc[-1] == pytest.approx(low)
    odd, even, *alike = table["pairs"].iloc[-4:]
    assert alike == [odd + even] * 2 and (table["kappa"].iloc[-4:-2] < 1).all()
    words = published.agreement.partition(", ")[0]
    for text in (HtmlReport().render(run, tmp_path), MarkdownTables().render(run), TextTable(width=200).render(run)):
        assert words in text.replace("\n", " ")


def test_an_output_of_broken_elements_is_lost(make_report: Make) -> None:
    """An output with its lattice counts as lost if under half of its elements are whole; if unknown, as kept."""
    run = make_report(lambda *_: True, methods=("graph-cuts",))
    run.columns["integrity.score"] = run.columns["quality.integrity"]
    for record, value in zip(run.cells, (0.49, 0.5, None), strict=False):
        record.values["integrity.score"] = value
    published = compare(run)
    assert published.verdicts["measured_share"].tolist() == [0, *[1] * 42]
    assert published.verdicts["lattice_share"].tolist() == [1] * 43
    assert published.footers(True)["success rate"][0][1] == "80% (4/5)"
    assert published.footers(True)["lattice alone"] == [("–", "100% (5/5)")]
    assert published.classes["pairs"].iloc[-2:].tolist() == [43, 43]


def test_random_pairing_keeps_what_descriptions_explain(make_report: Make) -> None:
    """If measured verdicts depend on the description alone, random pairing within descriptions reaches all of kappa."""
    first = {one["description"]: one for one in reversed(read_published().to_dict("records"))}
    published = compare(make_report(lambda figure, method: first[figure["description"]][method] == "preserved"))
    assert published.kappa.value == pytest.approx(published.chance[0], abs=1e-9)


def test_types_two_and_three_stand_below_type_one(make_report: Make, make_cell: Make) -> None:
    """Textures of types II and III that are no analogue have a row each below table 3, without a published rate."""
    run = make_report(lambda *_: True, methods=("quilting", "patch-based"))
    for number, kind in enumerate(("II", "II", "III")):
        run.cells.append(make_cell(f"t{number}", "quilting", lattice_source="none", preserved=number > 0, kind=kind))
    rows = {line[0]: line[2:] for line in print_published(compare(run))[1].frame().to_numpy().tolist()[-2:]}
    assert rows == {"type II": ["–, –", "–, 50% (1/2)"], "type III": ["–, –", "–, 100% (1/1)"]}
    assert list(compare(run).footers(True)) == ["success rate", "lattice alone"]


def test_only_figures_that_ran_are_shown(make_report: Make) -> None:
    """A run of some textures of the suite has a line for each of their figures, the heads, and the success rates."""
    run = make_report(lambda *_: True)
    run.cells[:] = [record for record in run.cells if record.cell.texture in ("f4", "f9", "f10")]
    published = compare(run)
    regular, near = (table.frame() for table in print_published(published))
    assert near["figure"].tolist() == ["9", "10", "success rate", "lattice alone"]
    assert regular.iloc[-2, 2:].tolist() == ["100% (1/1), 100% (1/1)"] * 4 + ["–, 100% (1/1)"]


def test_every_report_shows_the_comparison(make_report: Make, tmp_path: Path) -> None:
    """The page, the CSV tables and the LaTeX tables hold it, with the sentence that the textures are analogues."""
    run = make_report(lambda figure, _: figure["figure"] % 2 == 0)
    page = HtmlReport().render(run, tmp_path)
    assert PublishedComparison.sentence.partition(":")[2] in page
    assert "Table 3: near-regular textures" in page
    names = {path.name for path in CsvTables().write(run, tmp_path)}
    assert {"published.csv", "published_rates.csv", "published_classes.csv"} <= names
    LatexTables().write(run, tmp_path)
    text = (tmp_path / "published.tex").read_text("utf-8")
    assert text.count(r"\begin{table}") == 3
    assert r"\shortstack[l]{success rate,\\preserved/total} & \shortstack{53\% (20/38)\\50\% (19/38)}" in text
    tables = "Table 3\n" + (tmp_path / "published_table_3.csv").read_text("utf-8")
    for words in (page, MarkdownTables().render(run), TextTable(width=200).render(run), tables):
        assert "success rate" in words and "50% (19/38)" in words and "Table 3" in words
    assert r"45 & cans & \nrbLost{} \nrbLost{} & \nrbPreserved{} \nrbLost{}" in text
