from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from nrbench.reports.html import HtmlReport
from nrbench.reports.latex import LatexTables
from nrbench.reports.markdown import MarkdownTables
from nrbench.reports.statistics.method_comparison import Comparison, compare_methods
from nrbench.reports.statistics.summaries import COSTS, list_patch_terms, other_score_rows, sort_headlines_first
from nrbench.reports.statistics.verdicts import SCORE
from nrbench.runs.records import Run
from nrbench.synthesizers.tile_set import TileSet

from .conftest import COLUMNS, PERILS

Make = Callable[..., Any]


def test_the_patches_of_a_run_are_those_of_its_plugins(make_cell: Make, make_run: Make, tmp_path: Path) -> None:
    """Methods that copy patches are listed once each, in the plugins' words; all three formats have the table."""
    methods = ("tile-set", "ann-pixel", "nowhere", "rsgf", "tile-set")
    run = make_run([make_cell(texture, method) for texture in "ab" for method in methods[: 4 + (texture == "b")]])
    terms = list_patch_terms(run)
    assert [one.method for one in terms] == ["tile-set", "rsgf"]
    assert terms[0].shape == "tile shape/size from translational symmetry analysis"
    assert (terms[0].placement, terms[0].stitching) == (TileSet.patch_placement, TileSet.patch_stitching)
    tables = LatexTables().write(run, tmp_path)
    latex = next(path for path in tables if path.name == "patches.tex").read_text("utf-8")
    for text in (MarkdownTables().render(run), HtmlReport().render(run, tmp_path), latex):
        for one in terms:
            assert one.shape.replace("-", "{-}" if text is latex else "-") in text and one.placement.split()[0] in text
    assert "translational symmetry" not in MarkdownTables().render(make_run([make_cell("a", "ann-pixel")]))


def test_references_come_last_and_are_not_ranked(ranked: Run) -> None:
    """Methods are sorted by mean quality; references come last in the order of the suite, without a rank."""
    summaries = compare_methods(ranked).summaries
    assert [(one.method.name, one.rank) for one in summaries] == [
        ("close", 1), ("good", 2), ("refuser", 3), ("shaky", 4), ("drifter", 5),
        ("oracle", None), ("copier", None), ("tiling", None),
    ]  # fmt: skip


def test_the_leading_group_is_not_significantly_worse(ranked: Run) -> None:
    """The best method leads, and so does each method whose paired difference to it has an interval that holds 0."""
    leading = {one.method.name for one in compare_methods(ranked).summaries if one.leading}
    assert {"close", "good"} <= leading
    assert not leading & {"shaky", "drifter", "oracle"}


def test_failures_count_zero_or_not_at_all(make_cell: Make, make_run: Make) -> None:
    """Failures and refusals have quality 0 in one mean and are left out of the other; undecided cells of both."""
    why = {"regularity.preserved": "undecided: too little power"}
    whole = dict.fromkeys(PERILS, 0.8)
    cells = [make_cell("a", perils=whole), make_cell("b", status="refused"), make_cell("c", status="timeout")]
    cells += [make_cell("d", preserved=None, reasons=why, perils={}), make_cell("e", perils=whole)]
    run = make_run(cells)
    counted, answered = compare_methods(run).summary_rows[:2]
    assert (counted.title, counted.values, counted.counts) == ("quality", ["0.40"], ["4 of 5"])
    assert (answered.values, answered.counts) == (["0.80"], ["2 of 5"])


def test_the_ranking_uses_textures_that_all_methods_share(make_cell: Make, make_run: Make) -> None:
    """A texture on which one method is undecided does not count for the others, unless none is left."""
    cells = [
        make_cell("a", "good", perils=dict.fromkeys(PERILS, 0.8)),
        make_cell("a", "bad", perils=dict.fromkeys(PERILS, 0.4)),
        make_cell("b", "good", preserved=None),
        make_cell("b", "bad", preserved=False, perils=dict.fromkeys(PERILS, 0.0)),
    ]
    means = {one.method.name: one.means["quality"] for one in compare_methods(make_run(cells)).summaries}
    assert (means["good"].value, means["bad"].value) == (0.8, 0.4)
    assert means["bad"].n == 1
    alone = {one.method.name: one.means["quality"] for one in compare_methods(make_run(cells[2:])).summaries}
    assert alone["bad"].value == 0


def test_replicates_are_averaged_first(make_cell: Make, make_run: Make) -> None:
    """A texture with many replicates counts as one texture in the mean quality."""
    cells = [make_cell("a", replicate=i, perils=dict.fromkeys(PERILS, 1.0)) for i in range(3)]
    cells.append(make_cell("b", perils=dict.fromkeys(PERILS, 0.0)))
    assert compare_methods(make_run(cells)).summaries[0].means["quality"].value == 0.5


def test_a_failure_on_a_texture_without_lattice_does_not_count(make_cell: Make, make_run: Make) -> None:
    """On a texture that has no lattice no output has a quality, so a failure there does not count as 0."""
    cells = [make_cell("a", perils=dict.fromkeys(PERILS, 0.8)), make_cell("n", status="error", lattice_truth=None)]
    estimate = compare_methods(make_run(cells)).summaries[0].means["quality"]
    assert (estimate.value, estimate.n) == (0.8, 1)


def test_rows_of_a_ranked_run(ranked: Run) -> None:
    """A ranked run has quality, the three perils, the success rate and the seconds, and entries show the quality."""
    comparison = compare_methods(ranked)
    titles = [line.title for line in comparison.summary_rows if not line.variant]
    assert titles == ["quality", *PERILS, "preserved", "seconds"]
    entry = comparison.rows[0].entries[1]
    assert entry is not None and entry.text == "✓ 0.70"


def test_without_quality_there_is_no_ranking(every_comparison: Comparison) -> None:
    """A run without qualities keeps the order of the suite, and entries show ``regularity.score``."""
    assert not every_comparison.has_ranking
    assert every_comparison.score == SCORE
    assert every_comparison.summary_rows[0].name == "preserved"


@pytest.mark.parametrize(
    ("texture", "label", "text"),
    [
        ("brick", "rsgf (given)", "✓ 0.90"),
        ("brick", "rsgf (own)", "✗ 0.20"),
        ("brick", "oracle", "✓ 0.90"),
        ("weave", "rsgf (given)", "? 0.60"),
        ("weave", "rsgf (own)", "(!)"),
        ("t-timeout", "rsgf (own)", "! timeout"),
        ("t-refused", "rsgf (own)", "N/A"),
        ("t-missing", "rsgf (own)", "· missing"),
    ],
)
def test_an_entry_shows_mark_and_score(every_comparison: Comparison, texture: str, label: str, text: str) -> None:
    """An entry shows the verdict's mark beside the score, or the status that ended the cell."""
    row = next(row for row in every_comparison.rows if row.texture == texture)
    entry = row.entries[[method.label for method in every_comparison.methods].index(label)]
    assert entry is not None
    assert entry.text == text


def test_replicates_that_disagree_are_mixed(make_cell: Make, make_run: Make) -> None:
    """If replicates disagree, the entry shows how many preserve the lattice, and the mean score."""
    cells = [make_cell(replicate=i, preserved=i > 0, score=0.3 * i) for i in range(3)]
    entry = compare_methods(make_run(cells)).rows[0].entries[0]
    assert entry is not None
    assert (entry.verdict, entry.text) == ("mixed", "~ 2/3 0.30")


def test_notes_are_numbered_once(make_cell: Make, make_run: Make) -> None:
    """Equal notes share a number."""
    cells = [make_cell("a", note="fell back"), make_cell("b", note="fell back"), make_cell("c", note="other")]
    comparison = compare_methods(make_run(cells))
    assert list(comparison.notes) == ["fell back", "other"]
    assert [list(row.entries[0].notes) for row in comparison.rows if row.entries[0]] == [[1], [1], [2]]


def test_success_rates_count_textures(make_cell: Make, make_run: Make) -> None:
    """The first summary rows are the success rates, with refusals counted and with refusals left out."""
    cells = [make_cell("a"), make_cell("b", preserved=False), make_cell("c", status="refused")]
    rate, answered = compare_methods(make_run(cells)).summary_rows[:2]
    assert (rate.values, rate.counts) == (["33 %"], ["1 of 3"])
    assert (answered.values, answered.counts) == (["50 %"], ["1 of 2, 1 left out"])


def test_a_run_without_cells_has_no_rows(make_run: Make) -> None:
    """A run without cells has no methods, no rows and no summary rows."""
    comparison = compare_methods(make_run([]))
    assert not [*comparison.methods, *comparison.rows, *comparison.summary_rows, *comparison.notes, *comparison.legend]


def test_other_scores_have_their_own_rows(
    every_ending: Run, every_comparison: Comparison, make_cell: Make, make_run: Make
) -> None:
    """The mean of a score that is no headline has a row of its own, unless no cell has the score."""
    run = make_run([make_cell(values={"cost.note": 3.0, "randomness.variation": 0.5})])
    comparison = compare_methods(run)
    lines = {line.name: line for line in other_score_rows(run, comparison.summaries)}
    assert lines["cost.note"].values == ["3.00"]
    assert not lines.keys() & {line.name for line in comparison.summary_rows}
    assert "cost.note" not in {line.name for line in other_score_rows(every_ending, every_comparison.summaries)}


def test_costs_appear_once(make_cell: Make, make_run: Make) -> None:
    """Seconds are a headline, memory is another score, and the columns of the metric cost repeat neither."""
    columns = {**COLUMNS, "cost.seconds": COSTS["seconds"], "cost.peak_mib": COSTS["peak_mib"]}
    run = make_run([make_cell(values={"cost.seconds": 1.0, "cost.peak_mib": 2.0}, peak_mib=2.0)], columns=columns)
    comparison = compare_methods(run)
    names = [line.name for line in (*comparison.summary_rows, *other_score_rows(run, comparison.summaries))]
    assert [name for name in names if name.endswith(("seconds", "peak_mib"))] == ["seconds", "peak_mib"]


def test_undecided_scores_enter_no_mean(make_cell: Make, make_run: Make) -> None:
    """A texture with an undecided verdict counts neither in the mean nor in n."""
    why = {"regularity.preserved": "undecided: too little power"}
    cells = [make_cell("a", score=0.5), make_cell("b", score=1.0, preserved=None, reasons=why)]
    comparison = compare_methods(make_run(cells))
    mean = comparison.summaries[0].means[SCORE]
    assert (mean.value, mean.n, mean.of) == (0.5, 1, 2)
    assert next(line for line in comparison.summary_rows if line.name == SCORE).counts[0] == "1 of 2"


def test_metrics_of_the_headlines_come_first() -> None:
    """Quality and the perils come first, the others keep their order."""
    names = ["appearance.seam", "randomness.x", "regularity.defects", "quality.score", "appearance.color"]
    assert sort_headlines_first(names) == [
        "quality.score", "regularity.defects", "randomness.x", "appearance.seam", "appearance.color",
    ]  # fmt: skip
