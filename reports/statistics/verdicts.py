"""What a cell's regularity comes to in one word, and the table that all statistics start from."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
import pandas as pd

from nrbench.runs.records import CellRecord, Run
from nrbench.runs.store import FAILED

from .baselines import is_right
from .randomness_kept import KEPT, derived
from .statistics import as_numbers

PRESERVED, SCORE = "regularity.preserved", "regularity.score"
MARKS: Mapping[str, str] = {
    "preserved": "✓",
    "lost": "✗",
    "undecided": "?",
    "not applicable": "–",
    "refused": "N/A",
    "failed": "!",
    "unscored": "(!)",
    "missing": "·",
    "mixed": "~",
}
"""Each verdict's mark: told apart without color."""
MEANINGS: Mapping[str, str] = {
    "preserved": "the lattice is preserved",
    "lost": "the lattice is lost",
    "undecided": "too little power to tell at this regular share",
    "not applicable": "no lattice in the truth",
    "refused": "outside the method's domain, says the method",
    "failed": "the method failed",
    "unscored": "the score failed or is absent",
    "missing": "not run yet",
    "mixed": "replicates disagree",
}


def verdict(record: CellRecord) -> str:
    """Return one of :data:`MARKS`' keys (never ``mixed``, which takes several cells)."""
    if record.status == "missing" or record.status == "refused":
        return record.status
    if record.status in FAILED:
        return "failed"
    preserved = record.values.get(PRESERVED)
    if preserved is not None:
        return "preserved" if preserved else "lost"
    return _without_answer(record)


def _without_answer(record: CellRecord) -> str:
    reason = record.reasons.get(PRESERVED, "")
    if PRESERVED not in record.values or reason.startswith("failed:"):
        return "unscored"
    unasked = record.lattice_truth is None and not reason.startswith("undecided")
    return "not applicable" if unasked or reason.startswith("not applicable") else "undecided"


def explanation(record: CellRecord) -> str:
    """Return the sentence behind a verdict that is neither preserved nor lost; empty for those."""
    if record.status != "ok":
        where = f"{record.status} in {record.phase}" if record.phase else record.status
        return f"{where}: {record.message}" if record.message else where
    return record.reasons.get(PRESERVED, "")


def column_label(method: str, lattice_source: str) -> str:
    """Return what a column is called: the method, with its lattice source in parentheses where it has one."""
    return method if lattice_source == "none" else f"{method} ({lattice_source})"


def frame(run: Run) -> pd.DataFrame:
    """Return what statistics start from: one row a cell, scores as numbers.

    Returns
    -------
    pandas.DataFrame
        ``texture, replicate, column`` (method and lattice source)``, reference, right`` (whether a reference is no
        cheat on the texture)``, status, verdict, applicable`` (whether there is a lattice to preserve)``, seconds,
        peak_mib``, every score as float (NaN: none), and what of the randomness is kept, where the scores that it is
        made of are there (see :mod:`~nrbench.reports.statistics.randomness_kept`). Where the verdict is undecided ``regularity.score`` and
        what is kept are left out: no faults were seen there because none would have been.
    """
    content: dict[str, Any] = {
        "texture": [record.texture for record in run.cells],
        "replicate": [record.replicate for record in run.cells],
        "column": [column_label(record.method, record.lattice_source) for record in run.cells],
        "reference": [record.reference for record in run.cells],
        "right": [is_right(record) is True for record in run.cells],
        "status": [record.status for record in run.cells],
        "verdict": [verdict(record) for record in run.cells],
        "applicable": [_applicable(record) for record in run.cells],
        "seconds": as_numbers([record.seconds if record.status == "ok" else None for record in run.cells]),
        "peak_mib": as_numbers([record.peak_mib if record.status == "ok" else None for record in run.cells]),
    }
    scores = {name: as_numbers([record.values.get(name) for record in run.cells]) for name in run.columns}
    found = pd.DataFrame({**content, **scores, **derived(pd.DataFrame(scores))})
    found.loc[found["verdict"] == "undecided", [name for name in (SCORE, KEPT) if name in found]] = np.nan
    return found


def _applicable(record: CellRecord) -> bool:
    known = record.lattice_truth is not None or record.values.get(PRESERVED) is not None
    return known and verdict(record) != "not applicable"
