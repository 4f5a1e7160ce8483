from __future__ import annotations

import csv
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pytest

from nrbench.reports.csv import CsvTables
from nrbench.runs.records import Run

Make = Callable[..., Any]


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
    assert set(written) == {"cells", "comparison", "summary", "differences", "columns"}
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


def test_comparison_has_verdict_and_score(written: dict[str, Path]) -> None:
    """Each texture is a row; each method has a verdict and a score."""
    table = _read(written["comparison"]).set_index("texture")
    assert table.loc["brick", "rsgf (own) verdict"] == "lost"
    assert table.loc["brick", "rsgf (own) score"] == 0.2
    assert table.loc["t-refused", "rsgf (own) verdict"] == "refused"


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


def test_an_empty_run_gives_headers(make_run: Make, tmp_path: Path) -> None:
    """Without cells the tables have a header and no rows."""
    paths = CsvTables().write(make_run([]), tmp_path)
    assert all(path.is_file() for path in paths)
    assert [len(_read(path)) for path in paths[1:4]] == [0, 0, 0]


def test_every_column_of_the_cells_is_declared(written: dict[str, Path]) -> None:
    """``columns.csv`` has a line for each column of ``cells.csv``: meaning, unit, range and which values are better."""
    declared = _read(written["columns"]).set_index("column")
    assert set(_read(written["cells"]).columns) <= set(declared.index)
    assert declared["meaning"].str.len().min() > 5
    line = declared.loc["randomness.variation"]
    assert (line["low"], line["high"], line["better"]) == (0, float("inf"), "one")
    assert declared.loc["seconds", "unit"] == "s"
