"""Every format against a file that was read and approved.

``NRBENCH_GOLDEN=write python -m pytest tests/reports/test_golden.py`` writes the files again; read what changed.
"""

from __future__ import annotations

import csv
import json
import os
from itertools import zip_longest
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from nrbench.reports.csv import CsvTables
from nrbench.reports.json import JsonSummary
from nrbench.reports.latex import LatexTables
from nrbench.reports.markdown import MarkdownTables
from nrbench.reports.text import TextTable
from nrbench.runs.records import Run

from .conftest import PERILS, cell_maker, run_maker

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
    """Return a run of 12 textures, 6 of them with hostile names, with three methods and a reference."""
    root = tmp_path_factory.mktemp("golden") / "run"
    make = cell_maker(root)
    rng = np.random.default_rng(0)
    cells = []
    for i, name in enumerate([*HOSTILE.values(), *(f"plain-{k}" for k in range(6))]):
        hard = rng.uniform(0.4, 0.8)
        for method, worse in (("rsgf", 0.0), ("tile-set", 0.02), (HOSTILE["latex"], 0.25)):
            status = "refused" if (i, method) == (7, "tile-set") else "ok"
            parts = {name: round(float(hard - worse + rng.normal(0, 0.03)), 4) for name in PERILS}
            more = {"message": HOSTILE["markup"]} if status == "refused" else {"perils": parts}
            cells.append(make(name, method, preserved=worse < 0.1 or i % 2 == 0, status=status, **more))
        cells.append(make(name, "oracle", "none", reference=True, perils=dict.fromkeys(PERILS, 1.0)))
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
    """Each LaTeX table and the bibliography is byte for byte the approved file."""
    paths = LatexTables().write(golden_run, tmp_path)
    assert {path.name for path in paths} == {"patches.tex", "summary.tex", "comparison.tex", "methods.bib"}
    for path in paths:
        text = path.read_text("utf-8")
        assert text == _check(path.name, text)


@pytest.mark.parametrize("name", ["summary.csv", "comparison.csv", "baseline.csv", "significance.csv"])
def test_csv_is_as_approved(golden_run: Run, tmp_path: Path, name: str) -> None:
    """Each table has the approved words, and the approved numbers up to rounding."""
    text = next(path for path in CsvTables().write(golden_run, tmp_path) if path.name == name).read_text("utf-8")
    for ours, theirs in zip_longest(csv.reader(text.splitlines()), csv.reader(_check(name, text).splitlines())):
        assert [_number(word) for word in ours] == [pytest.approx(_number(word)) for word in theirs]


def test_json_is_as_approved(golden_run: Run) -> None:
    """The JSON has the approved content, and it is valid: no NaN, no infinity."""
    text = JsonSummary().render(golden_run)
    _same(json.loads(text), json.loads(_check("comparison.json", text)))


def _number(word: str) -> float | str:
    try:
        return float(word)
    except ValueError:
        return word


def _same(ours: Any, theirs: Any) -> None:
    if isinstance(theirs, dict):
        assert list(ours) == list(theirs)
        ours, theirs = list(ours.values()), list(theirs.values())
    if isinstance(theirs, list):
        assert len(ours) == len(theirs)
        for one, other in zip(ours, theirs, strict=True):
            _same(one, other)
    else:
        assert ours == (pytest.approx(theirs) if isinstance(theirs, float) else theirs)
