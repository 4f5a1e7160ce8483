from __future__ import annotations

import csv
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from nrbench.reports.csv import CsvTables
from nrbench.reports.html import HtmlReport
from nrbench.reports.latex import LatexTables
from nrbench.reports.markdown import MarkdownTables
from nrbench.reports.plots.perils_plane import caption_text
from nrbench.reports.statistics.method_comparison import Comparison, compare_methods
from nrbench.reports.statistics.summaries import perils_points
from nrbench.reports.statistics.verdicts import (
    BASELINE_LEGEND,
    BASELINE_SIGN,
    BaselineValidity,
    explain_valid_baseline,
    is_valid_baseline,
)
from nrbench.reports.text import TextTable
from nrbench.runs.records import Run

Make = Callable[..., Any]
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
def comparison(mixed: Run) -> Comparison:
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
    assert bool(explain_valid_baseline(record)) is (valid is True)


@pytest.mark.parametrize(
    ("count", "words", "sign"),
    [
        (BaselineValidity(0, 9), "", ""),
        (BaselineValidity(9, 9), "valid baseline", f" {BASELINE_SIGN}"),
        (BaselineValidity(2, 9), "valid baseline on 2 of 9", f" {BASELINE_SIGN} 2/9"),
    ],
)
def test_all_and_some_textures_have_different_words(count: BaselineValidity, words: str, sign: str) -> None:
    """The words name the count if a baseline is valid on some textures but not on all; on none they are empty."""
    assert (count.words, count.sign) == (words, sign)


def test_the_comparison_marks_entries_and_methods(comparison: Comparison) -> None:
    """Each method counts the textures on which it is valid, and the entries of these textures alone are marked."""
    counts = {one.method.name: (one.validity.n, one.validity.of) for one in comparison.summaries}
    assert counts == {"rsgf": (0, 3), "tiling": (1, 3), "scatter": (1, 3), "oracle": (0, 3)}
    marked = [
        (row.texture, method.name)
        for row in comparison.rows
        for method, entry in zip(comparison.methods, row.entries, strict=True)
        if entry and entry.baseline_valid
    ]
    assert marked == [("wallpaper", "tiling"), ("noise", "scatter")]


def test_the_perils_plane_counts_only_scored_textures(comparison: Comparison) -> None:
    """A point counts only textures with a score: scatter is valid on the one texture without."""
    shown = {point.method.name: point for point in perils_points(comparison.summaries)}
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
    assert page.count(f"{BASELINE_SIGN} valid baseline: what this baseline does is correct on a texture of type 0") == 1
    assert (
        page.count(f"{BASELINE_SIGN} valid baseline: what this baseline does is correct on a stochastic texture") == 1
    )


def test_csv_has_it_cell_by_cell(mixed: Run, tmp_path: Path) -> None:
    """``cells.csv`` and ``comparison.csv`` say of each baseline whether it is valid; empty for other methods."""
    cells, table = CsvTables().write(mixed, tmp_path)[:2]
    with cells.open(newline="", encoding="utf-8") as file:
        valid = {(row["texture"], row["method"]): row["reference_right"] for row in csv.DictReader(file)}
    assert valid["wallpaper", "tiling"] == valid["noise", "scatter"] == "True"
    assert valid["brick", "tiling"] == valid["wallpaper", "scatter"] == "False"
    assert {valid[key] for key in valid if key[1] in ("rsgf", "oracle")} == {""}
    with table.open(newline="", encoding="utf-8") as file:
        rows = {row["texture"]: row for row in csv.DictReader(file)}
    assert rows["wallpaper"]["tiling reference_right"] == "True"
    assert "oracle reference_right" not in rows["brick"]


def test_no_sign_without_a_valid_baseline(every_ending: Run, tmp_path: Path) -> None:
    """If no baseline is valid, no report has the sign or its explanation."""
    page = HtmlReport().render(every_ending, tmp_path)
    for words in (TextTable().render(every_ending), MarkdownTables().render(every_ending), page):
        assert BASELINE_SIGN not in words and BASELINE_LEGEND not in words
