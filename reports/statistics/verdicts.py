"""Give each cell of a run a verdict, and tabulate verdicts and scores as the table that all statistics start from.

Here are also the two facts about a cell that every report shows beside its verdict: its quality, and whether a baseline
is valid on its texture.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import pandas as pd

from nrbench import plugins
from nrbench.errors import BadInput
from nrbench.plugins.forms import Column, describe_silence
from nrbench.runs.records import CellRecord, Run
from nrbench.runs.store import FAILED

PRESERVED, SCORE = "regularity.preserved", "regularity.score"
_VERDICTS = (
    ("preserved", "✓", "the lattice is preserved"),
    ("lost", "✗", "the lattice is lost"),
    ("undecided", "?", "faults could not have been detected at this regular share"),
    ("not applicable", "–", "the texture has no lattice"),
    ("refused", "N/A", "the method refused this input as outside its domain"),
    ("failed", "!", "the method failed"),
    ("unscored", "(!)", "the regularity score failed or is absent"),
    ("missing", "·", "not run yet"),
    ("mixed", "~", "replicates disagree"),
)
MARKS: Mapping[str, str] = {name: mark for name, mark, _ in _VERDICTS}
"""Each verdict's mark. The marks differ without color."""
MEANINGS: Mapping[str, str] = {name: meaning for name, _, meaning in _VERDICTS}
_EXPLAINED = frozenset(("refused", "undecided", "failed", "unscored"))
QUALITY = "quality.score"
COMPLETE = "quality.complete"
PERILS = ("quality.regularity", "quality.integrity", "quality.randomness", "quality.appearance")
REGULARITY, INTEGRITY, RANDOMNESS, APPEARANCE = PERILS
RANKING, STRUCTURE = "quality", "perils.structure"
DERIVED_COLUMNS: Mapping[str, Column] = {
    RANKING: Column(
        "The number that methods are ranked by: quality.score, or 0 where a method failed or refused; a refusal of a "
        "reference does not count.",
        better="higher",
    ),
    STRUCTURE: Column(
        "Elements in place, whole and alike: the smallest of quality.regularity, quality.integrity and "
        "quality.appearance, of those that are measured.",
        better="higher",
    ),
}
"""Columns that reports compute from the scores of the metric ``quality``."""
LEADING_SIGN, BASELINE_SIGN, BOUND_SIGN = "★", "‡", "≤"
BOUND_LEGEND = (
    "upper bound: a peril could not be measured; a method with one is in no leading group, and is ranked below the "
    "measured methods that are not significantly worse"
)
BASELINE_LEGEND = "valid baseline: what this baseline does is correct on this kind of texture"
SHARES_LEGEND = "k/n: on k of n textures"
"""The explanation of :attr:`BaselineValidity.share`."""


def verdict(record: CellRecord) -> str:
    """Return the verdict on a cell, a key of :data:`MARKS`; never ``mixed``, which needs several cells."""
    if record.status in ("missing", "refused"):
        return record.status
    if record.status in FAILED:
        return "failed"
    preserved, reason = record.values.get(PRESERVED), record.reasons.get(PRESERVED, "")
    if preserved is not None:
        return "preserved" if preserved else "lost"
    if PRESERVED not in record.values or reason.startswith("failed:"):
        return "unscored"
    no_lattice = record.lattice_truth is None and not reason.startswith("undecided")
    return "not applicable" if no_lattice or reason.startswith("not applicable") else "undecided"


def bound_sign(record: CellRecord) -> str:
    """Return the sign of an upper bound if the quality of a cell is one, else nothing."""
    return BOUND_SIGN if record.values.get(COMPLETE) is False else ""


def name_silence(record: CellRecord, peril: str) -> str:
    """Return ``no peril`` or ``cannot tell`` if a cell has a quality but no score of a peril; else nothing.

    A quality of 0 is no upper bound, because no other peril can lower it: nothing is returned.
    """
    if peril not in PERILS or record.values.get(QUALITY) is None or record.values.get(peril) is not None:
        return ""
    word = describe_silence(record.reasons.get(peril, ""))
    return word if word == "no peril" or record.values.get(COMPLETE) is False else ""


def count_silences(records: Sequence[CellRecord]) -> dict[tuple[str, str], int]:
    """Return on how many outputs each peril is ``no peril``, and on how many one ``cannot tell``: those that occur."""
    counts = Counter((peril, name_silence(record, peril)) for peril in PERILS for record in records)
    return {(peril, word): count for (peril, word), count in counts.items() if word}


def explain_verdict(record: CellRecord, column: str = PRESERVED) -> str:
    """Return why a cell is neither preserved nor lost, or has no other score; empty if it is or has."""
    if record.status != "ok":
        where = f"{record.status} in {record.phase}" if record.phase else record.status
        return f"{where}: {record.message}" if record.message else where
    return record.reasons.get(column, "")


def count_reasons(run: Run) -> list[tuple[str, str, int]]:
    """Count the distinct reasons for which cells are neither preserved nor lost.

    Returns
    -------
    list of (str, str, int)
        The verdict, a key of :data:`MARKS`, the reason, and the number of cells; the most frequent first.
    """
    told = ((verdict(record), explain_verdict(record)) for record in run.cells)
    counts = Counter((word, " ".join(reason.split())) for word, reason in told if word in _EXPLAINED)
    return [(word, reason, count) for (word, reason), count in counts.most_common()]


def method_label(method: str, lattice_source: str) -> str:
    """Return the method, with its lattice source in parentheses if it has one."""
    return method if lattice_source == "none" else f"{method} ({lattice_source})"


def tabulate_cells(run: Run) -> pd.DataFrame:
    """Return one row a cell, with scores as numbers.

    Returns
    -------
    pandas.DataFrame
        The columns ``texture``, ``replicate``, ``label`` (method and lattice source), ``reference``,
        ``baseline_valid``, ``status``, ``verdict``, ``applicable`` (whether the texture has a lattice to preserve),
        ``seconds``, ``peak_mib``, and every score as float (NaN: no value); also :data:`DERIVED_COLUMNS` if the run has
        a quality. ``regularity.score`` is NaN where the verdict is undecided: there no fault was found because none
        could have been detected.
    """
    return run.shared(_tabulate_cells).copy()


def _tabulate_cells(run: Run) -> pd.DataFrame:
    content: dict[str, Any] = {
        "texture": [record.texture for record in run.cells],
        "replicate": [record.replicate for record in run.cells],
        "label": [method_label(record.method, record.lattice_source) for record in run.cells],
        "reference": [record.reference for record in run.cells],
        "baseline_valid": [is_valid_baseline(record) is True for record in run.cells],
        "status": [record.status for record in run.cells],
        "verdict": [verdict(record) for record in run.cells],
        "applicable": [_has_lattice(record) for record in run.cells],
        "seconds": np.array([record.seconds if record.status == "ok" else None for record in run.cells], np.float64),
        "peak_mib": np.array([record.peak_mib if record.status == "ok" else None for record in run.cells], np.float64),
        **{name: np.array([record.values.get(name) for record in run.cells], np.float64) for name in run.columns},
    }
    table = pd.DataFrame(content)
    if SCORE in table:
        table.loc[table["verdict"] == "undecided", SCORE] = np.nan
    if has_quality(run):
        judged = table["applicable"] | table["texture"].isin(table.loc[table[QUALITY].notna(), "texture"])
        ended = table["verdict"].eq("failed") | (table["verdict"].eq("refused") & ~table["reference"])
        table[RANKING] = table[QUALITY].mask(judged & ended, 0.0)
        table[STRUCTURE] = table[[REGULARITY, INTEGRITY, APPEARANCE]].min(axis=1)
    return table


def keep_listed_textures(cells: pd.DataFrame) -> pd.DataFrame:
    """Return the table without the ranking quality of textures on which that of most methods is undecided.

    Rubble is called lost where a fault of a good output could stay undetected, so a texture on which hardly any method
    is decided says nothing about the others. If no texture is left, the table is unchanged.

    Parameters
    ----------
    cells
        The table of :func:`tabulate_cells`.
    """
    if RANKING not in cells:
        return cells
    ranked = cells[~cells["reference"] & (cells["status"] != "missing")]
    decided = ranked[RANKING].notna().groupby([ranked["texture"], ranked["label"]]).any().groupby("texture").mean()
    listed = decided.index[decided > 0.5]
    if listed.empty:
        return cells
    return cells.assign(**{RANKING: cells[RANKING].where(cells["texture"].isin(listed))})


def has_quality(run: Run) -> bool:
    """Return whether the metric ``quality`` has scored any cell of a run."""
    return QUALITY in run.columns and any(QUALITY in record.values for record in run.cells)


def _has_lattice(record: CellRecord) -> bool:
    known = record.lattice_truth is not None or record.values.get(PRESERVED) is not None
    return known and verdict(record) != "not applicable"


@dataclass(frozen=True)
class BaselineValidity:
    """The number of textures on which a baseline is valid.

    Parameters
    ----------
    n, of
        Textures of the kinds on which the baseline is valid, and all textures.
    """

    n: int
    of: int

    @property
    def words(self) -> str:
        """The count in words; empty if the baseline is valid nowhere, or the method is no baseline."""
        if not self.n:
            return ""
        return "valid baseline" if self.n == self.of else f"valid baseline on {self.n} of {self.of}"

    @property
    def share(self) -> str:
        """``"k/n"`` if the baseline is valid on some textures but not on all; else empty."""
        return f"{self.n}/{self.of}" if 0 < self.n < self.of else ""

    @property
    def sign(self) -> str:
        """A space, the sign of a valid baseline, and the share; empty if the words are."""
        return f" {BASELINE_SIGN} {self.share}".rstrip() if self.n else ""


def is_valid_baseline(record: CellRecord) -> bool | None:
    """Return whether a baseline is valid on the cell's texture, as its class declares by ``right_on``.

    A baseline is a reference method that fools some scores, such as the repetition of one tile. On some kinds of
    texture it is correct: repeating a tile is valid if all tiles are equal.

    Returns
    -------
    bool or None
        None for methods that are no baselines, for textures of unknown kind, and for a plugin that is not registered
        where the run is read.
    """
    if not record.reference or not record.kind:
        return None
    try:
        kinds = frozenset(getattr(plugins.find("synthesizers", record.cell.method).cls, "right_on", ()))
    except BadInput:
        return None
    return record.kind in kinds if kinds else None


def count_valid_textures(cells: pd.DataFrame) -> BaselineValidity:
    """Count the textures on which a baseline is valid.

    Parameters
    ----------
    cells
        The rows of one method in :func:`tabulate_cells`.
    """
    valid = cells.groupby("texture")["baseline_valid"].any()
    return BaselineValidity(int(valid.sum()), len(valid))
