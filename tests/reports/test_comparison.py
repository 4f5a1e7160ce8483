"""The comparison of methods: verdicts, ranks, levels, baselines, and what a notebook shows."""

import json
import math
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from nrbench.errors import BadInput
from nrbench.plugins.forms import Column
from nrbench.plugins.registry import usual_parameters
from nrbench.reports.csv import CsvTables
from nrbench.reports.html import HtmlReport
from nrbench.reports.json import JsonSummary
from nrbench.reports.latex import LatexTables
from nrbench.reports.markdown import MarkdownTables
from nrbench.reports.page.plots import caption_text
from nrbench.reports.statistics import verdicts
from nrbench.reports.statistics.expectations import (
    LevelPanel,
    LevelSeries,
    compare_levels,
)
from nrbench.reports.statistics.frames import print_improvements, print_patches
from nrbench.reports.statistics.method_comparison import Comparison, compare_methods
from nrbench.reports.statistics.summaries import (
    SummaryRow,
    other_score_rows,
    perils_points,
)
from nrbench.reports.statistics.verdicts import (
    BASELINE_LEGEND,
    BASELINE_SIGN,
    BOUND_LEGEND,
    BOUND_SIGN,
    SCORE,
    is_valid_baseline,
)
from nrbench.reports.text import TextTable
from nrbench.runs.records import CellRecord, Run
from nrbench.synthesizers.tile_set import TileSet

from .conftest import HOSTILE, PERILS, Make


def test_the_patches_of_a_run_are_those_of_its_plugins(make_cell: Make, make_run: Make, tmp_path: Path) -> None:
    """Methods that copy patches are listed once each, with their parameters; every format has the table."""
    methods = ("tile-set", "ann-pixel", "nowhere", "rsgf")
    cells = [make_cell(texture, method) for texture in "ab" for method in methods]
    cells += [make_cell("a", "tile-set:stitch=dynamic", parameters={"stitch": "dynamic"})]
    run = make_run(cells)
    terms = print_patches(run).rows
    assert [row[0].name for row in terms] == ["tile-set", "rsgf", "tile-set:stitch=dynamic"]
    shape = "tile shape/size from translational symmetry analysis"
    assert terms[0][1:] == (shape, TileSet.patch_placement, "seams, stitch=graphcut")
    assert terms[2][3] == "seams, stitch=dynamic"
    tables = LatexTables().write(run, tmp_path)
    latex = next(path for path in tables if path.name == "patches.tex").read_text("utf-8")
    csv = next(path for path in CsvTables().write(run, tmp_path) if path.name == "patches.csv").read_text("utf-8")
    plain = " ".join(TextTable(width=200).render(run).split())
    pages = (MarkdownTables().render(run), HtmlReport().render(run, tmp_path), JsonSummary().render(run), csv, plain)
    for text in (*pages, latex):
        for _, shape, placement, _ in terms:
            assert shape.replace("-", "{-}" if text is latex else "-") in text and placement.split()[0] in text
    assert "translational symmetry" not in MarkdownTables().render(make_run([make_cell("a", "ann-pixel")]))


def test_published_methods_stand_beside_improved_ones(make_cell: Make, make_run: Make, tmp_path: Path) -> None:
    """Each method with a preset has a row with the same method by default, and their known difference, in all formats.

    The name of a method need not tell its plugin. A changed preset, a changed default, and a method that ran with one
    source of the lattice only have no row, nor has a preset without the default. All parameters stand in a list.
    """
    known = (
        ("Ours", "", 0.7),
        ("rsgf:block=9", "", 0.9),
        ("RSGF 2011", "paper", 0.4),
        ("rsgf:preset=paper,block=9", "paper", 0.5),
        ("tile-set:preset=paper", "paper", 0.1),
        ("tile-set:block=9", "", 0.2),
    )
    cells = [
        make_cell(
            f"t{i}",
            name,
            perils=value + i / (50 if preset else 100),
            preset=preset,
            plugin=plugin,
            parameters=usual_parameters("synthesizers", plugin, preset) | ({"block": 9} if "block" in name else {}),
        )
        for name, preset, value in known
        for plugin in ["tile-set" if "tile" in name else "rsgf"]
        for i in range(10)
    ]
    assert not compare_methods(make_run([cell for cell in cells if cell.method != "Ours"])).improvements
    tiles = usual_parameters("synthesizers", "tile-set")
    run = make_run([*cells, make_cell("t0", "tile-set", "given", perils=0.5, parameters=tiles)])
    rows = print_improvements(compare_methods(run)).rows
    assert {row[1].label for row in rows} == {"RSGF 2011 (own)"}
    assert [row[0] for row in rows[:2]] == ["quality", "regularity"] and rows[0][4].startswith("+0.25 [0.2")
    texts = {path.name: path.read_text("utf-8") for path in LatexTables().write(run, tmp_path)}
    pages = [MarkdownTables().render(run), HtmlReport().render(run, tmp_path), TextTable(width=100).render(run)]
    for text in (*pages, texts["improvements.tex"]):
        assert "RSGF 2011" in text and "improved" in text and "+0.25" in text
    for text in (*pages, texts["summary.tex"]):
        assert "rsgf: block=40" in " ".join(text.replace("\\allowbreak{}", "").split())
    table = CsvTables().tables(run)["improvements"].set_index(["score", "method"])
    assert table.loc[("quality", "RSGF 2011"), "difference"] == pytest.approx(0.255)
    assert json.loads(JsonSummary().render(run))["tables"]["improvements"][0]["improved_method"] == "Ours"
    assert set(CsvTables().tables(run)["parameters"]["method"]) == {name for name, _, _ in known}


def test_references_come_last_and_are_not_ranked(ranked: Run) -> None:
    """Methods are sorted by mean quality; references come last in the order of the suite, without a rank."""
    summaries = compare_methods(ranked).summaries
    assert [(one.method.name, one.rank) for one in summaries] == [
        ("close", 1), ("good", 1), ("refuser", 3), ("shaky", 4), ("drifter", 5),
        ("oracle", None), ("copier", None), ("tiling", None),
    ]  # fmt: skip


def test_the_leading_group_is_not_significantly_worse(ranked: Run, make_cell: Make, make_run: Make) -> None:
    """The best method leads with each method that is not worse by the test; with three textures none does."""
    assert not any(one.leading for one in compare_methods(ranked).summaries)
    near, bad = tuple(0.7 + 0.1 * (-1) ** i for i in range(8)), tuple(0.2 + 0.01 * i for i in range(8))
    found = _rank(make_cell, make_run, {"good": (0.72,) * 8, "near": near, "bad": bad})
    assert [star for _, star, _ in found.values()] == [True, True, False]


def _numbers(row: SummaryRow) -> list[tuple[str, str]]:
    """Return the value and the count of each method as text."""
    return [(number.text, number.count) for number in row.numbers.values()]


def test_failures_count_zero_or_not_at_all(make_cell: Make, make_run: Make) -> None:
    """Failures and refusals have quality 0 in one mean and are left out of the other; undecided cells of both."""
    why = {"regularity.preserved": "undecided: too little power"}
    cells = [make_cell("a", perils=0.8), make_cell("b", status="refused"), make_cell("c", status="timeout")]
    cells += [make_cell("d", preserved=None, reasons=why, perils={}), make_cell("e", perils=0.8)]
    run = make_run(cells)
    counted, answered = compare_methods(run).summary_rows[:2]
    assert (counted.title, _numbers(counted)) == ("quality", [("0.40", "4 of 5")])
    assert _numbers(answered) == [("0.80", "2 of 5")]


def test_the_errors_of_both_lattices_stand_in_the_table(make_cell: Make, make_run: Make) -> None:
    """Medians in px, s and drift, and the share exact, of the lattices used and of output; torn ones are not exact."""
    run = make_run([])
    for number, (used, output) in enumerate([(0.2, 0.5), (0.4, 1.5), (2.0, None)]):
        values: dict[str, float | bool | None] = {}
        for start, error in (("lattice_recovery.", used), ("regularity.lattice_", output)):
            values |= {f"{start}vector_error": error, f"{start}exact": None if error is None else error < 1}
            values[f"{start}vector_error_in_s"] = None if error is None else error / 10
        values["lattice_recovery.drift"] = 5 * used
        run.columns.update(dict.fromkeys(values, Column("An error.", "px", (0.0, math.inf), "lower")))
        run.cells.append(make_cell(f"t{number}", "m", values=values))
    rows = compare_methods(run).summary_rows
    assert {row.title: _numbers(row)[0][0] for row in rows if row.name.startswith("lattice")} == {
        "lattice used px": "0.40", "lattice used s": "0.040",
        "lattice used drift": "2.00", "lattice used exact": "67 %",
        "lattice of output px": "1.00", "lattice of output s": "0.10", "lattice of output exact": "33 %",
    }  # fmt: skip


def test_the_ranking_uses_textures_that_most_methods_decide(make_cell: Make, make_run: Make) -> None:
    """A texture on which no more than half of the methods are decided does not count, unless none is left."""
    cells = [
        make_cell("a", "good", perils=0.8),
        make_cell("a", "bad", perils=0.4),
        make_cell("b", "good", preserved=None),
        make_cell("b", "bad", preserved=False, perils=0.0),
    ]
    means = {one.method.name: one.means["quality"] for one in compare_methods(make_run(cells)).summaries}
    assert (means["good"].value, means["bad"].value) == (0.8, 0.4)
    assert means["bad"].n == 1
    alone = {one.method.name: one.means["quality"] for one in compare_methods(make_run(cells[2:])).summaries}
    assert alone["bad"].value == 0


def test_an_undecided_cell_moves_nobody_else(make_cell: Make, make_run: Make) -> None:
    """If one of three methods is undecided on a texture, the others keep means and order, and its own is adjusted."""
    values = {"first": (0.9, 0.5, 0.1), "second": (0.8, 0.4, 0.1), "third": (0.7, 0.3, None)}
    cells = [
        make_cell(f"t{i}", name, preserved=value is not None, perils={} if value is None else value)
        for name, row in values.items()
        for i, value in enumerate(row)
    ]
    found = compare_methods(make_run(cells)).summaries
    assert [one.method.name for one in found] == ["first", "second", "third"]
    assert [one.means["quality"].value for one in found] == pytest.approx([0.5, 1.3 / 3, 0.95 / 3])


def test_a_refused_reference_is_not_zero(make_cell: Make, make_run: Make) -> None:
    """A reference that refuses is N/A, not 0.00; a peril that nobody measured is a dash."""
    cells = [make_cell("a", "tiling", "none", reference=True, status="refused")]
    cells += [make_cell("a", "m", perils={"regularity": 0.9, "integrity": None, "randomness": 0.8, "appearance": 1.0})]
    rows = {row.title: [text for text, _ in _numbers(row)] for row in compare_methods(make_run(cells)).summary_rows}
    assert rows["quality"] == [f"{BOUND_SIGN}0.80", "N/A"] and rows["integrity"] == ["–", "N/A"]
    assert rows["preserved"] == ["100 %", "N/A"]


def test_a_population_has_other_intervals(make_cell: Make, make_run: Make) -> None:
    """Over a population of textures the intervals are wide, one draw carries them, and the sentence says which."""
    cells = [make_cell(f"t{i}", "m", replicate=j, perils=0.2 + 0.04 * i + 0.005 * j) for i in range(20) for j in (0, 1)]
    run = make_run(cells)
    listed, drawn = compare_methods(run), compare_methods(run, population=True)
    widths = [np.ptp(one.summaries[0].means["quality"].ends) for one in (listed, drawn)]
    assert widths[1] > 5 * widths[0]
    assert "fixed list of 20 textures, over draws" in TextTable().render(run)
    assert "population of textures" in " ".join(TextTable(population=True).render(run).split())


def _rank(
    make_cell: Make, make_run: Make, qualities: Mapping[str, tuple[float, ...]]
) -> dict[str, tuple[int | None, bool, str]]:
    """Return rank, star and quality of methods, given their qualities on textures; those of ``bounded`` are bounds."""
    cells = []
    for name, values in qualities.items():
        unknown = {"integrity": None} if name == "bounded" else {}
        cells += [
            make_cell(f"t{i}", name, perils=dict.fromkeys(PERILS, value) | unknown) for i, value in enumerate(values)
        ]
    comparison = compare_methods(make_run(cells))
    rows = zip(comparison.summaries, _numbers(comparison.summary_rows[0]), strict=True)
    return {one.method.name: (one.rank, one.leading, value) for one, (value, _) in rows}


@pytest.mark.parametrize("textures", [8, 12])
def test_an_upper_bound_stands_behind_what_may_be_better(make_cell: Make, make_run: Make, textures: int) -> None:
    """A method whose mean is an upper bound has no star, and is ranked behind measured methods not surely worse."""
    near = tuple(0.7 + 0.2 * (-1) ** i for i in range(textures))
    bad = tuple(0.1 + 0.01 * i for i in range(textures))
    found = _rank(make_cell, make_run, {"bounded": (0.75,) * textures, "near": near, "bad": bad})
    assert {name: (rank, star) for name, (rank, star, _) in found.items()} == {
        "near": (1, True),
        "bounded": (2, False),
        "bad": (3, False),
    }
    assert found["bounded"][2] == f"{BOUND_SIGN}0.75" and BOUND_SIGN not in found["near"][2]


def test_an_upper_bound_may_be_the_best(make_cell: Make, make_run: Make) -> None:
    """If all measured methods are surely worse, an upper bound is the first, and no method has a star."""
    low, high = tuple(0.1 + 0.01 * i for i in range(6)), tuple(0.7 + 0.02 * i for i in range(6))
    found = _rank(make_cell, make_run, {"bad": low, "bounded": high})
    assert found["bounded"][:2] == (1, False) and found["bad"][:2] == (2, False)
    alone = _rank(make_cell, make_run, {"bounded": high})
    assert alone["bounded"] == (1, False, f"{BOUND_SIGN}0.75")


def test_every_report_marks_an_upper_bound(make_cell: Make, make_run: Make, tmp_path: Path) -> None:
    """Each format has the sign beside the quality and its explanation, and neither where all perils are measured."""
    whole = dict.fromkeys(PERILS, 0.75)
    for perils in ({**whole, "integrity": None}, whole):
        run = make_run([make_cell(f"t{i}", perils=perils) for i in range(2)])
        texts = [TextTable().render(run), MarkdownTables().render(run), HtmlReport().render(run, tmp_path)]
        texts += [path.read_text("utf-8").replace(r"$\le$", "≤") for path in LatexTables().write(run, tmp_path)[1:3]]
        shown = [("≤0.75" in text, BOUND_LEGEND in " ".join(text.split())) for text in texts]
        assert shown == [(perils is not whole,) * 2] * 5
        cells = json.loads(JsonSummary().render(run))["textures"]
        assert {one["entries"]["rsgf (own)"]["upper_bound"] for one in cells} == {perils is not whole}


def test_a_failure_on_a_texture_without_lattice_does_not_count(make_cell: Make, make_run: Make) -> None:
    """On a texture that has no lattice no output has a quality, so a failure there does not count as 0."""
    cells = [make_cell("a", perils=0.8), make_cell("n", status="error", lattice_truth=None)]
    estimate = compare_methods(make_run(cells)).summaries[0].means["quality"]
    assert (estimate.value, estimate.n) == (0.8, 1)


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
    assert entry.text == text


def test_replicates_that_disagree_are_mixed(make_cell: Make, make_run: Make) -> None:
    """If replicates disagree, the entry shows how many preserve the lattice, and the mean score."""
    cells = [make_cell(replicate=i, preserved=i > 0, score=0.3 * i) for i in range(3)]
    entry = compare_methods(make_run(cells)).rows[0].entries[0]
    assert (entry.verdict, entry.text) == ("mixed", "~ 2/3 0.30")


def test_other_scores_have_their_own_rows(
    every_ending: Run, every_comparison: Comparison, make_cell: Make, make_run: Make
) -> None:
    """The mean of a score that is no headline has a row of its own, unless no cell has the score."""
    run = make_run([make_cell(values={"cost.note": 3.0, "randomness.variation": 0.5})])
    comparison = compare_methods(run)
    lines = {line.name: line for line in other_score_rows(run, comparison.summaries)}
    assert _numbers(lines["cost.note"]) == [("3.00", "1 of 1")]
    assert not lines.keys() & {line.name for line in comparison.summary_rows}
    assert "cost.note" not in {line.name for line in other_score_rows(every_ending, every_comparison.summaries)}


def test_undecided_scores_enter_no_mean(make_cell: Make, make_run: Make) -> None:
    """A texture with an undecided verdict counts neither in the mean nor in n."""
    why = {"regularity.preserved": "undecided: too little power"}
    cells = [make_cell("a", score=0.5), make_cell("b", score=1.0, preserved=None, reasons=why)]
    comparison = compare_methods(make_run(cells))
    mean = comparison.summaries[0].means[SCORE]
    assert (mean.value, mean.n, mean.of) == (0.5, 1, 2)
    assert _numbers(next(line for line in comparison.summary_rows if line.name == SCORE))[0][1] == "1 of 2"


@pytest.mark.parametrize(
    ("cell", "verdict"),
    [
        ({"preserved": True}, "preserved"),
        ({"preserved": False}, "lost"),
        ({"preserved": None, "reasons": {"regularity.preserved": "undecided: low power"}}, "undecided"),
        ({"preserved": None, "reasons": {"regularity.preserved": "not applicable: stochastic"}}, "not applicable"),
        ({"preserved": None, "lattice_truth": None}, "not applicable"),
        ({"preserved": None, "reasons": {"regularity.preserved": "failed: ValueError"}}, "unscored"),
        ({"status": "refused"}, "refused"),
        ({"status": "missing"}, "missing"),
        *[({"status": status}, "failed") for status in ("error", "timeout", "memory", "crash", "invalid")],
    ],
)
def test_each_ending_has_its_verdict(make_cell: Make, cell: dict[str, object], verdict: str) -> None:
    """A cell's status, value and reason decide its verdict."""
    assert verdicts.verdict(make_cell(**cell)) == verdict


def test_a_cell_without_a_regularity_score_is_unscored(make_cell: Make) -> None:
    """A cell is unscored, not undecided, if the metric is not installed."""
    record = make_cell()
    bare = CellRecord(record.cell, record.folder, record.result)
    assert verdicts.verdict(bare) == "unscored"


@pytest.fixture(scope="module")
def panel(ranked: Run) -> LevelPanel:
    """Return the panel of a run with three levels of one departure."""
    (panel,) = compare_levels(ranked, compare_methods(ranked))
    return panel


def _series(panel: LevelPanel, method: str) -> LevelSeries:
    return next(one for one in panel.series if one.method and one.method.name == method)


def test_a_panel_has_the_methods_the_oracle_and_the_copier(panel: LevelPanel) -> None:
    """Ranked methods come first, then the oracle and the copier; other references have no line."""
    assert (panel.departure, list(panel.levels)) == ("bend", [1.0, 2.0, 4.0])
    names = [one.method.name for one in panel.series if one.method]
    assert names == ["close", "good", "refuser", "shaky", "drifter", "oracle", "copier"]


def test_a_method_breaks_at_the_first_level_below_one_half(panel: LevelPanel) -> None:
    """The first level with a quality below 0.5 counts, a refusal is 0, and a good method breaks at no level."""
    assert _series(panel, "refuser").breaks_at == 1
    assert (_series(panel, "good").breaks_at, _series(panel, "good").words) == (None, "–")


def test_levels_keep_the_order_of_the_suite(make_cell: Make, make_run: Make) -> None:
    """Levels go from the first of the suite to the last, also if their numbers fall; unscored levels are counted."""
    shares = (0.5, 0.42, 0.35)
    rows = [{"name": f"t{i}", "departure": "share", "level": level} for i, level in enumerate(shares)]
    qualities = (0.8, None, 0.2)
    cells = [make_cell(f"t{i}", perils={} if quality is None else quality) for i, quality in enumerate(qualities)]
    run = make_run(cells, suite={"content": {"texture": rows}})
    (panel,) = compare_levels(run, compare_methods(run))
    (series,) = panel.series
    assert (list(panel.levels), series.breaks_at, series.count) == ([*shares], 0.35, "2 of 3 levels scored")


def test_one_level_is_no_panel(make_cell: Make, make_run: Make) -> None:
    """A departure at one level has no panel; nor have textures that the run leaves out, nor a run without quality."""
    rows = [{"name": name, "departure": "bend", "level": i} for i, name in enumerate("ab")]
    suite = {"content": {"texture": rows}}
    run = make_run([make_cell("a", perils=1.0)], suite=suite)
    assert compare_levels(run, compare_methods(run)) == []
    run = make_run([make_cell("a"), make_cell("b")], suite=suite)
    assert compare_levels(run, compare_methods(run)) == []


SCORES = {"regularity": 1.0, "integrity": 0.9, "randomness": 0.1}


@pytest.fixture(scope="module")
def mixed(makers: tuple[Make, Make]) -> Run:
    """Return a run on a regular, a near-regular and a stochastic texture: a method, tiling, scatter, the oracle."""
    make_cell, make_run = makers
    cells = []
    for texture, kind in (("wallpaper", "0"), ("brick", "I"), ("noise", "stochastic")):
        lattice = {"lattice_truth": None, "preserved": None, "score": None} if kind == "stochastic" else {}
        more: dict[str, Any] = {"kind": kind, "perils": {} if lattice else SCORES, **lattice}
        cells.append(make_cell(texture, "rsgf", **more))
        cells += [make_cell(texture, name, "none", reference=True, **more) for name in ("tiling", "scatter", "oracle")]
    run: Run = make_run(cells)
    return run


@pytest.fixture(scope="module")
def mixed_comparison(mixed: Run) -> Comparison:
    """Return the comparison of that run."""
    return compare_methods(mixed)


@pytest.mark.parametrize(
    ("method", "kind", "valid"),
    [
        ("tiling", "0", True),
        ("supertile", "0", True),
        ("shuffle", "0", True),
        ("tiling", "I", False),
        ("tiling", "stochastic", False),
        ("scatter", "stochastic", True),
        ("random-phase", "stochastic", True),
        ("scatter", "0", False),
        ("tiling", None, None),
        ("oracle", "0", None),
        ("planted", "stochastic", None),
        ("no-such-plugin", "0", None),
    ],
)
def test_the_class_says_where_a_baseline_is_valid(
    make_cell: Make, method: str, kind: str | None, valid: bool | None
) -> None:
    """Tilings are valid on perfectly regular textures, scatter on textures without a lattice, nothing elsewhere."""
    record = make_cell("t", method, "none", reference=True, kind=kind)
    assert is_valid_baseline(record) is valid


def test_the_comparison_marks_entries_and_methods(mixed_comparison: Comparison) -> None:
    """Each method counts the textures on which it is valid, and the entries of these textures alone are marked."""
    counts = {one.method.name: (one.validity.n, one.validity.of) for one in mixed_comparison.summaries}
    assert counts == {"rsgf": (0, 3), "tiling": (1, 3), "scatter": (1, 3), "oracle": (0, 3)}
    marked = [
        (row.texture, method.name)
        for row in mixed_comparison.rows
        for method, entry in zip(mixed_comparison.methods, row.entries, strict=True)
        if entry and entry.baseline_valid
    ]
    assert marked == [("wallpaper", "tiling"), ("noise", "scatter")]


def test_the_perils_plane_counts_only_scored_textures(mixed_comparison: Comparison) -> None:
    """A point counts only textures with a score: scatter is valid on the one texture without."""
    shown = {point.method.name: point for point in perils_points(mixed_comparison.summaries)}
    assert caption_text(shown["tiling"]) == f"tiling {BASELINE_SIGN} 1/2"
    assert "valid baseline on 1 of 2" in shown["tiling"].words
    assert caption_text(shown["scatter"]) == "scatter"


def test_every_table_has_mark_and_footnote(mixed: Run, tmp_path: Path) -> None:
    """Text, Markdown, LaTeX and HTML mark the entries and explain the sign."""
    text, markdown = TextTable().render(mixed), MarkdownTables().render(mixed)
    assert f"✓ 0.10 {BASELINE_SIGN}" in text and f"reference {BASELINE_SIGN} 1/3" in text
    assert f"✓ 0.10 {BASELINE_SIGN} |" in markdown and f"*tiling* † {BASELINE_SIGN} 1/3" in markdown
    for words in (text, markdown):
        assert f"{BASELINE_SIGN} {BASELINE_LEGEND}" in " ".join(words.split())
    tables = {path.stem: path.read_text("utf-8") for path in LatexTables().write(mixed, tmp_path)}
    summary, places_ = tables["summary"], tables["comparison"]
    assert r"\textit{tiling}\nrbReference{}\nrbValidBaseline{}\textsuperscript{1/3}" in summary
    assert r"\nrbPreserved{} 0.10\nrbValidBaseline{}" in places_ and BASELINE_LEGEND in places_
    page = HtmlReport().render(mixed, tmp_path)
    assert f"{BASELINE_SIGN} valid baseline on 1 of 3" in page
    assert page.count(f'<p class="why">{BASELINE_SIGN} {BASELINE_LEGEND}') == 2


@pytest.fixture
def two_methods(make_cell: Make, make_run: Make) -> Run:
    """Return a run of two methods with known qualities."""
    cells = [
        make_cell(f"t{i}", method, perils=quality)
        for i in range(3)
        for method, quality in (("rsgf", 0.75), (HOSTILE, 0.25))
    ]
    return make_run(cells)


def test_a_run_has_its_tables(two_methods: Run) -> None:
    """The summary has one row a method with the mean quality; the comparison has one row a texture."""
    summary, comparison = two_methods.summary(), two_methods.comparison()
    assert summary.loc[("rsgf", "own"), "quality"] == pytest.approx(0.75)
    assert list(comparison.index) == ["t0", "t1", "t2"]
    assert comparison.loc["t1", "rsgf (own) verdict"] == "preserved"


def test_a_notebook_shows_the_methods(two_methods: Run) -> None:
    """The HTML has a table with both methods, and one of textures with marks, in which no name is markup."""
    shown = two_methods._repr_html_()
    assert "✓" in shown.rpartition("<table")[2]
    assert "<table" in shown and "rsgf" in shown and "0.75" in shown
    assert "<img" not in shown and "&lt;img" in shown


def test_a_plot_is_shown_and_saved(two_methods: Run, tmp_path: Path) -> None:
    """A notebook gets SVG; the ending of a path chooses the kind of file; another one is refused."""
    plot = two_methods.plot(width=4)
    assert plot._repr_svg_().lstrip().startswith("<?xml") and "svg" in plot._repr_svg_()
    assert plot.savefig(tmp_path / "plane.pdf").read_bytes().startswith(b"%PDF")
    with pytest.raises(BadInput, match=r"end the name in \.svg"):
        plot.save(tmp_path / "plane.gif")
