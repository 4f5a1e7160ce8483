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
from nrbench.reports.perils import drawn
from nrbench.reports.statistics.baselines import LEGEND, SIGN, NoCheat, is_right, sentence
from nrbench.reports.statistics.comparison import comparison
from nrbench.reports.statistics.perils import caption, places
from nrbench.reports.text import TextTable
from nrbench.runs.records import Run

Make = Callable[..., Any]
SCORES = {"randomness.variation": 0.1, "randomness.repetition": 2.0, "randomness.distance": 0.01}


@pytest.fixture
def mixed(make_cell: Make, make_run: Make) -> Run:
    """Return a run on a regular, a near-regular and a stochastic texture: a method, tiling, scatter, the oracle."""
    cells = []
    for texture, kind in (("wallpaper", "0"), ("brick", "I"), ("noise", "stochastic")):
        lattice = {"lattice_truth": None, "preserved": None, "score": None} if kind == "stochastic" else {}
        more: dict[str, Any] = {"kind": kind, "values": SCORES, **lattice}
        cells.append(make_cell(texture, "rsgf", **more))
        cells += [make_cell(texture, name, "none", reference=True, **more) for name in ("tiling", "scatter", "oracle")]
    run: Run = make_run(cells)
    return run


@pytest.mark.parametrize(
    ("method", "kind", "right"),
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
def test_the_class_tells_where_a_cheat_is_none(
    make_cell: Make, method: str, kind: str | None, right: bool | None
) -> None:
    """Tilings are right on perfectly regular textures, scatter on those without a lattice; else nothing is said."""
    record = make_cell("t", method, "none", reference=True, kind=kind)
    assert is_right(record) is right
    assert bool(sentence(record)) is (right is True)


def test_a_contestant_is_never_excused(make_cell: Make) -> None:
    """Only reference rows are cheats: a method that repeats a tile is judged on every kind of texture."""
    assert is_right(make_cell("t", "tiling", kind="0", reference=False)) is None


@pytest.mark.parametrize(
    ("count", "words", "sign"),
    [
        (NoCheat(0, 9), "", ""),
        (NoCheat(9, 9), "not a cheat here", f" {SIGN}"),
        (NoCheat(2, 9), "not a cheat on 2 of 9", f" {SIGN} 2/9"),
    ],
)
def test_all_and_partly_are_told_apart(count: NoCheat, words: str, sign: str) -> None:
    """On all textures of a group it is not a cheat here; on some it says on how many; on none nothing."""
    assert (count.words, count.sign) == (words, sign)


def test_the_comparison_marks_place_and_head(mixed: Run) -> None:
    """Each column counts the textures it is right on, and each of those places says so, no other."""
    found = comparison(mixed)
    assert {one.head.method: one.no_cheat for one in found.summaries} == {
        "rsgf": NoCheat(0, 3), "tiling": NoCheat(1, 3), "scatter": NoCheat(1, 3), "oracle": NoCheat(0, 3),
    }  # fmt: skip
    marked = [
        (row.texture, head.method)
        for row in found.rows
        for head, entry in zip(found.heads, row.entries, strict=True)
        if entry and entry.right
    ]
    assert marked == [("wallpaper", "tiling"), ("noise", "scatter")]


def test_replicates_count_as_one_texture(make_cell: Make, make_run: Make) -> None:
    """Three replicates of one texture are one texture: all of them, not one of three."""
    cells = [make_cell("w", "tiling", "none", replicate=i, reference=True, kind="0") for i in range(3)]
    assert comparison(make_run(cells)).summaries[0].no_cheat == NoCheat(1, 1)


def test_the_plane_counts_what_it_shows(mixed: Run) -> None:
    """A place says it of those textures only that it rests on: scatter is right on the one that is not scored."""
    shown = {place.head.method: place for place in places(comparison(mixed).summaries)}
    assert caption([shown["tiling"]]) == f"tiling {SIGN} 1/2"
    assert "not a cheat on 1 of 2" in shown["tiling"].words
    assert caption([shown["scatter"]]) == "scatter"


def test_the_plane_explains_its_sign(mixed: Run) -> None:
    """The line under the plane makes the picture higher where the sign occurs."""
    found = places(comparison(mixed).summaries)
    without = [place for place in found if not place.no_cheat.n]
    heights = [int(float(drawn(some, "svg").split(b'height="')[1].split(b"pt")[0])) for some in (found, without)]
    assert heights[0] > heights[1]


def test_every_table_has_mark_and_footnote(mixed: Run, tmp_path: Path) -> None:
    """Text, Markdown, LaTeX and HTML mark the places and explain the sign."""
    text, markdown = TextTable().render(mixed), MarkdownTables().render(mixed)
    assert f"✓ 0.90 {SIGN}" in text and f"reference {SIGN} 1/3" in text
    assert f"✓ 0.90 {SIGN} |" in markdown and f"*tiling* † {SIGN} 1/3" in markdown
    for words in (text, markdown):
        assert f"{SIGN} {LEGEND}" in " ".join(words.split())
    summary, places_ = (path.read_text("utf-8") for path in LatexTables().write(mixed, tmp_path))
    assert r"\textit{tiling}\nrbReference{}\nrbNoCheat{}\textsuperscript{1/3}" in summary
    assert r"\nrbPreserved{} 0.90\nrbNoCheat{}" in places_ and LEGEND in places_
    page = HtmlReport().render(mixed, tmp_path)
    assert f"{SIGN} not a cheat on 1 of 3" in page
    assert page.count(f"{SIGN} not a cheat here: on a texture of type 0") == 1
    assert page.count(f"{SIGN} not a cheat here: on a stochastic texture") == 1


def test_csv_has_it_cell_by_cell(mixed: Run, tmp_path: Path) -> None:
    """``cells.csv`` and ``comparison.csv`` say for each cheat whether it is right; empty for what is no cheat."""
    cells, table = CsvTables().write(mixed, tmp_path)[:2]
    with cells.open(newline="", encoding="utf-8") as file:
        said = {(row["texture"], row["method"]): row["reference_right"] for row in csv.DictReader(file)}
    assert said["wallpaper", "tiling"] == said["noise", "scatter"] == "True"
    assert said["brick", "tiling"] == said["wallpaper", "scatter"] == "False"
    assert {said[key] for key in said if key[1] in ("rsgf", "oracle")} == {""}
    with table.open(newline="", encoding="utf-8") as file:
        rows = {row["texture"]: row for row in csv.DictReader(file)}
    assert rows["wallpaper"]["tiling reference_right"] == "True"
    assert "oracle reference_right" not in rows["brick"]


def test_nothing_is_said_without_occasion(every_ending: Run, tmp_path: Path) -> None:
    """Where no cheat is right, no report has the sign or its explanation."""
    page = HtmlReport().render(every_ending, tmp_path)
    for words in (TextTable().render(every_ending), MarkdownTables().render(every_ending), page):
        assert SIGN not in words and LEGEND not in words
