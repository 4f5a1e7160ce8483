from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any

import pytest

from nrbench.reports.statistics import verdicts
from nrbench.runs.records import CellRecord, Run

Make = Callable[..., Any]


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


def test_marks_tell_verdicts_apart() -> None:
    """Every verdict has a mark of its own, and a meaning."""
    assert len(set(verdicts.MARKS.values())) == len(verdicts.MARKS)
    assert set(verdicts.MARKS) == set(verdicts.MEANINGS)


def test_table_holds_numbers(every_ending: Run) -> None:
    """Truth values become 0 and 1, None becomes NaN, and only cells that ended well have seconds."""
    table = verdicts.tabulate_cells(every_ending)
    assert len(table) == len(every_ending.cells)
    assert set(table["regularity.preserved"].dropna()) == {0.0, 1.0}
    assert table.loc[table["status"] == "ok", "seconds"].notna().all()
    assert math.isnan(table.loc[table["status"] == "timeout", "seconds"].iloc[0])


def test_table_of_an_empty_run_has_its_columns(make_run: Make) -> None:
    """A run without cells gives a table without rows."""
    table = verdicts.tabulate_cells(make_run([]))
    assert len(table) == 0
    assert {"texture", "verdict", "regularity.score"} <= set(table)
