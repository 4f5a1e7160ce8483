"""The tables of a run as CSV, text, Markdown and LaTeX: their rules, and files that were read and approved.

``NRBENCH_GOLDEN=write python -m pytest tests/reports/test_tables.py`` writes the files again; read what changed.
"""

import csv
import json
import os
import re
import shutil
import subprocess
from collections.abc import Callable
from io import StringIO
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pytest
from hypothesis import given
from hypothesis import strategies as st

from nrbench import plugins
from nrbench.errors import BadInput
from nrbench.plugins.parameters import parse_spec
from nrbench.reports.csv import CsvTables
from nrbench.reports.json import JsonSummary
from nrbench.reports.latex import LatexTables, escape_latex
from nrbench.reports.markdown import MarkdownTables, escape_markdown
from nrbench.reports.statistics import format as text_format
from nrbench.reports.statistics.frames import PrintedTable
from nrbench.reports.text import TextTable
from nrbench.runs.records import Run

from .conftest import PERILS, Make, cell_maker, run_maker


def _read(path: Path) -> pd.DataFrame:
    return pd.read_csv(path, keep_default_na=False, na_values=[""])


@pytest.fixture(scope="module")
def written(every_ending: Run) -> dict[str, Path]:
    """Return the tables of a run with every status, by name."""
    return {path.stem: path for path in CsvTables().write(every_ending, every_ending.root / "tables")}


def test_cells_read_back_to_the_same_bits(make_cell: Make, make_run: Make, tmp_path: Path) -> None:
    """Floats survive writing and reading bit by bit."""
    values = np.random.default_rng(0).random(20) / 3
    run = make_run([make_cell(f"t{i}", score=float(value)) for i, value in enumerate(values)])
    with CsvTables().write(run, tmp_path / "tables")[0].open(newline="", encoding="utf-8") as file:
        assert [float(row["regularity.score"]) for row in csv.DictReader(file)] == values.tolist()


def test_every_cell_is_a_row(every_ending: Run, written: dict[str, Path]) -> None:
    """One row a cell, whatever its status, quotes and line breaks in messages included."""
    assert set(written) == {"cells", "comparison", "summary", "differences", "columns", "patches"}
    assert {path.suffix for path in written.values()} == {".csv"}
    cells = _read(written["cells"])
    assert list(cells["status"]) == [record.status for record in every_ending.cells]
    assert list(cells["texture"]) == [record.texture for record in every_ending.cells]


def test_summary_has_one_row_a_method(written: dict[str, Path]) -> None:
    """Counts add up, and the success rate has its interval and n of N."""
    summary = _read(written["summary"]).set_index(["method", "lattice_source"])
    own = summary.loc[("rsgf", "own")]
    assert own["cells"] == own["ok"] + own["refused"] + own["failed"] + own["missing"] == 9
    assert own["preserved_low"] <= own["preserved"] <= own["preserved_high"]
    assert (own["preserved"], own["preserved_n"], own["preserved_of"]) == (0.0, 7, 9)
    assert own["preserved_refusals_left_out_n"] == 6


def test_formulas_do_not_run(make_cell: Make, make_run: Make, tmp_path: Path) -> None:
    """Text that a spreadsheet would run starts with an apostrophe; negative numbers stay numbers."""
    attack = '=HYPERLINK("http://x","y")'
    cell = make_cell(attack, "+m", score=-0.5, status="ok", note="@sum(a)\nb", message="-1+2")
    paths = CsvTables().write(make_run([cell]), tmp_path)
    with paths[0].open(newline="", encoding="utf-8") as file:
        row = next(csv.DictReader(file))
    assert (row["texture"], row["note"], row["message"]) == (f"'{attack}", "'@sum(a)\nb", "'-1+2")
    assert row["regularity.score"] == "-0.5"
    for path in paths:
        with path.open(newline="", encoding="utf-8") as file:
            assert not [text for line in csv.reader(file) for text in line if text.startswith(("=", "+", "@"))]


def test_every_column_of_the_cells_is_declared(written: dict[str, Path]) -> None:
    """``columns.csv`` has a line for each column of ``cells.csv``: meaning, unit, range and which values are better."""
    declared = _read(written["columns"]).set_index("column")
    assert set(_read(written["cells"]).columns) <= set(declared.index)
    assert declared["meaning"].str.len().min() > 5
    line = declared.loc["randomness.variation"]
    assert (line["low"], line["high"], line["better"]) == (0, float("inf"), "one")
    assert declared.loc["seconds", "unit"] == "s"


def test_an_empty_run_says_so(make_run: Make) -> None:
    """A run without cells gives one sentence, as text and in Markdown."""
    for report in (TextTable(), MarkdownTables()):
        assert "There are no cells." in report.render(make_run([]))


def test_columns_of_choice(every_ending: Run) -> None:
    """The table of methods has the named columns only, above each reason for no verdict with the number of its cells.

    An unknown column is refused with the nearest name.
    """
    text = TextTable(width=200, columns=("randomness.variation", "seconds")).render(every_ending)
    for reason in ("? 1 cell undecided: undecided: too little power", "(!) 1 cell unscored: failed: KeyError: 'x'"):
        assert reason in text
    head = next(line for line in text.splitlines() if line.startswith("method") or " method " in line)
    assert "variation" in head and "seconds" in head and "score" not in head
    with pytest.raises(BadInput, match="did you mean 'seconds'"):
        TextTable(columns=("second",)).render(every_ending)


@pytest.mark.parametrize(
    ("escape", "text", "escaped"),
    [
        (escape_markdown, "[a](b) ![c](d) *e* _f_", r"\[a\](b) !\[c\](d) \*e\* \_f\_"),
        (escape_markdown, "`g` <h> i|j @k", r"\`g\` \<h\> i\|j \@k"),
        (escape_markdown, "http://x www.y", r"http\://x www\.y"),
        (escape_markdown, "a\nb\x1b[1m", "a b"),
        (escape_latex, "a_b & 50% of $x #1 {y}", r"a\_b \& 50\% of \$x \#1 \{y\}"),
        (escape_latex, "~^\\", r"\textasciitilde{}\textasciicircum{}\textbackslash{}"),
        (escape_latex, "a\n\x1b[31mb\tc", "a b c"),
        (escape_latex, "--", "{-}{-}"),
    ],
)
def test_nothing_in_a_name_is_markup(escape: Callable[[str], str], text: str, escaped: str) -> None:
    """Links, emphasis, code, HTML, mentions, addresses and commands read as they are; line breaks and escapes go."""
    assert escape(text) == escaped


def _write_latex(run: Run, directory: Path, **options: Any) -> dict[str, str]:
    return {path.stem: path.read_text("utf-8") for path in LatexTables(**options).write(run, directory)}


def test_latex_widths_are_checked(make_run: Make, tmp_path: Path) -> None:
    """An unknown width is an error; a run without cells writes no file."""
    with pytest.raises(BadInput, match="width='narrow': input should be 'column', 'text' or 'page'"):
        plugins.build("reports", "latex", {"width": "narrow"})
    assert LatexTables().write(make_run([]), tmp_path) == []


@pytest.mark.skipif(shutil.which("pdflatex") is None, reason="needs pdfLaTeX")
def test_pdflatex_reads_it(every_ending: Run, tmp_path: Path) -> None:
    """A paper with booktabs alone compiles with both tables, hostile names included."""
    paths = LatexTables().write(every_ending, tmp_path)
    body = "\n".join(rf"\input{{{path.name}}}" for path in paths)
    head = "\\documentclass{article}\n\\usepackage[T1]{fontenc}\n\\usepackage{booktabs}\n\\begin{document}\n"
    code, log = _compile(f"{head}{body}\n\\end{{document}}\n", tmp_path)
    assert code == 0, log[-2000:]


@pytest.fixture(scope="module")
def wide_run(makers: tuple[Make, Make]) -> Run:
    """Return a run of 16 methods on 24 textures, with intervals; some have presets, long names and many parameters."""
    make_cell, make_run = makers
    names = [plugin.name for plugin in plugins.inventory("synthesizers")][:14]
    parameters = {f"parameter_{i}": "gncc:preset=paper" for i in range(12)} | {"file": "/" + "folder" * 20}
    more = {"parameters": parameters, "preset": "paper"}
    names += ["command:" + "unbroken" * 6, "regularized-patch:preset=paper,tolerance=0.125,block=40"]
    return make_run([
        make_cell(f"hexagon-material-{i}", name, source, perils=0.03 * i, preserved=i % 2 == 0, **known)
        for name in names
        for source, known in [("gncc:preset=paper", more) if ":" in name else ("own", {})]
        for i in range(24)
    ] + [make_cell("hexagon-material-0", "regularized-patch", "gncc:preset=paper", perils=0.5)])  # fmt: skip


@pytest.mark.skipif(shutil.which("pdflatex") is None, reason="needs pdfLaTeX")
@pytest.mark.parametrize("width", ["column", "text", "page"])
def test_tables_fit_what_they_are_made_for(wide_run: Run, tmp_path: Path, width: str) -> None:
    """No table is wider than its column or page, and none is higher than a page."""
    paths = LatexTables(width=width).write(wide_run, tmp_path)
    body = "\n".join(rf"\input{{{path.stem}}}" for path in paths if path.suffix == ".tex")
    head = f"\\documentclass[{'a4paper' if width == 'text' else 'twocolumn'}]{{article}}\n\\usepackage[T1]{{fontenc}}"
    _, log = _compile(f"{head}\\usepackage{{booktabs}}\\begin{{document}}{body}\\end{{document}}", tmp_path)
    assert "Overfull" not in log and "too large" not in log


@pytest.mark.skipif(shutil.which("pdflatex") is None, reason="needs pdfLaTeX")
def test_the_article_of_the_docs_compiles(wide_run: Run, tmp_path: Path) -> None:
    """The article of docs/paper.md compiles with the files that its commands write, without an overfull line."""
    root = tmp_path / "runs" / "paper"
    page = (Path(__file__).parents[2] / "docs" / "paper.md").read_text("utf-8")
    command = next(line for line in page.splitlines() if line.startswith("nrbench report"))
    for name, parameters in map(parse_spec, re.findall(r"--format (\S+)", command)):
        report = plugins.build("reports", name, parameters)
        report.write(wide_run, root / getattr(report, "folder", "report"))
    article = page.partition("```latex\n")[2].partition("```")[0]
    code, log = _compile(article, tmp_path)
    assert code == 0 and "Overfull" not in log, log[-2000:]


def _compile(source: str, folder: Path) -> tuple[int, str]:
    """Return the exit code and the log of pdfLaTeX."""
    (folder / "article.tex").write_text(source)
    line = ["pdflatex", "-interaction=nonstopmode", "-halt-on-error", "-draftmode", "article.tex"]
    done = subprocess.run(line, cwd=folder, capture_output=True, timeout=60)
    return done.returncode, done.stdout.decode(errors="replace")


def test_latex_holds_what_was_chosen(wide_run: Run, tmp_path: Path) -> None:
    """Chosen methods and textures, no intervals and no float; the means remain those of the whole run."""
    whole = _write_latex(wide_run, tmp_path / "whole")
    report = LatexTables(methods=("gpn*",), textures=("*-1", "*-2"), intervals=False, bare=True)
    part = {path.stem: path.read_text("utf-8") for path in report.write(wide_run, tmp_path)}
    rows = [line for line in part["summary"].splitlines() if line.startswith("gpnn")]
    assert rows[0].split(" & ")[1] in next(line for line in whole["summary"].splitlines() if line.startswith("gpnn"))
    assert "scriptsize {" not in part["summary"] and "scriptsize {" in whole["summary"]
    assert r"\begin{table" not in part["summary"] + part["comparison"] and r"\caption" not in part["summary"]
    names = re.findall(r"^hexagon\S+", part["comparison"], re.MULTILINE)
    assert names == ["hexagon{-}material{-}1", "hexagon{-}material{-}2"]
    with pytest.raises(BadInput, match="no texture 'nowhere'"):
        LatexTables(textures=("nowhere",)).write(wide_run, tmp_path)


GOLDEN = Path(__file__).parent / "golden"
HOSTILE = {
    "markup": '<b onclick="x">&amp;\'"</b>',
    "latex": r"50% of $x_1 & \input{x} #~^",
    "markdown": "`a` | *b* [c](http://d) <!--",
    "formula": "=HYPERLINK(1)",
    "right to left": "\u202eabc \u05d0\u05d1\u05d2 \u0627\u0644",
    "emoji": "tile \U0001f9f1 \U0001f469\u200d\U0001f3a8",
}


@pytest.fixture(scope="module")
def golden_run(tmp_path_factory: pytest.TempPathFactory) -> Run:
    """Return a run of 12 textures, 6 of them with hostile names, with three methods and a reference.

    The quality of one cell is an upper bound.
    """
    root = tmp_path_factory.mktemp("golden") / "run"
    make = cell_maker(root)
    rng = np.random.default_rng(0)
    cells = []
    for i, name in enumerate([*HOSTILE.values(), *(f"plain-{k}" for k in range(6))]):
        hard = rng.uniform(0.4, 0.8)
        for method, worse in (("rsgf", 0.0), ("tile-set", 0.02), (HOSTILE["latex"], 0.25)):
            status = "refused" if (i, method) == (7, "tile-set") else "ok"
            parts = {name: round(float(hard - worse + rng.normal(0, 0.03)), 4) for name in PERILS[:3]}
            parts |= {"appearance": None if (i, worse) == (8, 0.25) else 0.97}
            more = {"message": HOSTILE["markup"]} if status == "refused" else {"perils": parts}
            cells.append(make(name, method, preserved=worse < 0.1 or i % 2 == 0, status=status, **more))
        cells.append(make(name, "oracle", "none", reference=True, perils=1.0))
    return run_maker(root)(cells, versions={"nrbench": "0", "numpy": "2"}, created="2026-01-01 00:00 UTC")


def _check(name: str, content: str) -> str:
    """Return the approved content of a file, or write it first."""
    file = GOLDEN / name
    if os.environ.get("NRBENCH_GOLDEN") == "write":
        file.write_bytes(content.encode("utf-8", "backslashreplace"))
    return file.read_text("utf-8")


@pytest.mark.parametrize(("name", "report"), [("comparison.md", MarkdownTables()), ("comparison.txt", TextTable())])
def test_text_is_as_approved(golden_run: Run, name: str, report: MarkdownTables | TextTable) -> None:
    """The format is byte for byte the approved file."""
    text = report.render(golden_run)
    assert text == _check(name, text)


def test_latex_is_as_approved(golden_run: Run, tmp_path: Path) -> None:
    """The table of methods is byte for byte the approved file, beside the other tables and the bibliography."""
    texts = {path.name: path.read_text("utf-8") for path in LatexTables().write(golden_run, tmp_path)}
    assert set(texts) == {"patches.tex", "summary.tex", "comparison.tex", "methods.bib"}
    assert texts["summary.tex"] == _check("summary.tex", texts["summary.tex"])


def test_csv_is_as_approved(golden_run: Run, tmp_path: Path) -> None:
    """The summary has the approved words, and the approved numbers up to rounding."""
    CsvTables().write(golden_run, tmp_path)
    text = (tmp_path / "summary.csv").read_text("utf-8")
    pd.testing.assert_frame_equal(pd.read_csv(StringIO(text)), pd.read_csv(StringIO(_check("summary.csv", text))))


def test_json_is_as_approved(golden_run: Run) -> None:
    """The JSON has the approved content up to rounding, and it is valid: no NaN, no infinity."""
    text = JsonSummary().render(golden_run)
    ours, theirs = (
        json.loads(one, parse_float=lambda number: f"{float(number):.6g}", parse_constant=pytest.fail)
        for one in (text, _check("comparison.json", text))
    )
    assert list(ours) == list(theirs) and ours == theirs


@pytest.mark.parametrize(
    ("value", "text"),
    [
        (None, "–"), (float("nan"), "–"), (True, "yes"), (False, "no"), (0.0, "0.00"), (0.876, "0.88"), (1, "1.00"),
        (0.0123, "0.012"), (-0.5, "−0.50"), (12.34, "12.3"), (1234.5, "1234"), (3.2e7, "3.20e+07"), (2e-5, "2.0e−05"),
    ],
)  # fmt: skip
def test_numbers_read_well(value: float | None, text: str) -> None:
    """Numbers are short at every size."""
    assert text_format.format_number(value) == text


@given(st.lists(st.floats(1, 50), min_size=3, max_size=12))
def test_a_table_is_split_where_it_must(widths: list[float]) -> None:
    """Each column stands in one part, in order; a part of several columns fits, and the next one would not have."""
    table = PrintedTable("table", [*map(str, range(len(widths)))], [], splits=True)
    parts = [[int(head) for head in part.heads] for part in table.split(widths, 60.0)]
    assert [column for part in parts for column in part[1:]] == [*range(1, len(widths))]
    assert all(part[0] == 0 for part in parts)
    wide = [sum(widths[column] for column in part) for part in parts]
    assert all(width <= 60 + 1e-6 for width, part in zip(wide, parts, strict=True) if len(part) > 2)
    assert all(width + widths[after[1]] > 60 - 1e-6 for width, after in zip(wide, parts[1:], strict=False))


def test_a_table_is_split_every_so_many_columns() -> None:
    """Each part has the fixed columns and at most so many others."""
    table = PrintedTable("table", [*"abcdefg"], [], fixed=2, splits=True)
    assert [part.heads for part in table.split_every(2)] == [[*"abcd"], [*"abef"], [*"abg"]]
