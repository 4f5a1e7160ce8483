"""Tables as CSV."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, ClassVar

import pandas as pd

from nrbench.runs.records import Run
from nrbench.storage import write_aside

from .statistics.baselines import is_right
from .statistics.comparison import Comparison, comparison
from .statistics.detections import STOCHASTIC, answers, median, rate
from .statistics.people import agreement_table, labels_table, people
from .statistics.perils import perils_table, places
from .statistics.statistics import Estimate
from .statistics.summary import Summary, known_columns

OWN_COLUMNS: Mapping[str, str] = {
    "suite": "Name of the suite.",
    "texture": "Name of the texture.",
    "family": "Family of the texture.",
    "kind": "Kind of the texture: 0, I, II, III or stochastic.",
    "regular_share": "Variance of the ideal image over mean total variance, 0 to 1.",
    "method": "The method, with the parameters that differ from its defaults.",
    "parameters": "All parameters of the method, as JSON.",
    "lattice_source": "Where the lattice came from: given, own, none, or the detector.",
    "replicate": "Number of the draw.",
    "reference": "Whether the row calibrates the scores and is never ranked.",
    "reference_right": "Whether what the reference does is right on this kind of texture: not a cheat here.",
    "status": "How the cell ended.",
    "phase": "Where it failed; empty where it did not.",
    "message": "Why it failed or refused.",
    "note": "What the method says of its run.",
    "key": "Hash of all that decides the result; the name of the cell's folder.",
}
"""What the columns of ``cells.csv`` say that are neither scores nor costs."""
_FORMULA = ("=", "+", "-", "@", "\t", "\r")


@dataclass(frozen=True)
class CsvTables:
    """Tables as CSV, UTF-8, one header line; floats are written so that they read back to the same bits.

    ``cells.csv`` has one row a cell and one column a score; ``comparison.csv`` the textures by methods; ``summary.csv``
    each method's counts, success rate, means and ranks, with 95 % intervals over textures; ``differences.csv`` the
    paired differences between methods; ``columns.csv`` what every column of ``cells.csv`` means, its unit, range and
    better way; ``perils.csv`` the places in the perils plane. Where detectors found the lattices, ``detections.csv``
    has one row an answer and ``detectors.csv`` each detector's share of right answers, with its interval over draws, by
    family, departure and level; an empty cell there stands for all of them (of the textures that have a lattice).

    Text that a spreadsheet would run as a formula gets an apostrophe in front.

    Parameters
    ----------
    labels
        Files of people's answers, as ``nrbench label`` has them saved: adds ``labels.csv``, one row an answer, and
        ``agreement.csv``, one row a pair of raters.
    """

    labels: tuple[Path, ...] = ()

    version: ClassVar[str] = "1"
    folder: ClassVar[str] = "tables"

    def write(self, run: Run, directory: Path) -> list[Path]:
        """Write the tables and return their paths."""
        found = comparison(run)
        tables = {
            "cells": cells_table(run),
            "comparison": comparison_table(found),
            "summary": summary_table(found),
            "differences": differences_table(found),
            "columns": columns_table(run),
        }
        if shown := places(found.summaries):
            tables["perils"] = perils_table(shown)
        if labelled := people(run, self.labels):
            tables |= {"labels": labels_table(run, self.labels), "agreement": agreement_table(labelled)}
        asked = answers(run)
        if not asked.empty:
            tables |= {"detections": asked, "detectors": detectors_table(asked)}
        return [_write(table, directory / f"{name}.csv") for name, table in tables.items()]


def cells_table(run: Run) -> pd.DataFrame:
    """Return the run's tidy table, and in it whether each reference is right on its texture."""
    table = run.table()
    right = pd.Series([is_right(record) for record in run.cells], table.index, dtype=object)
    table.insert(list(table.columns).index("reference") + 1, "reference_right", right)
    return table


def comparison_table(found: Comparison) -> pd.DataFrame:
    """Return textures by methods: verdict and mean score of each, and whether a reference is right there."""
    parts = {"verdict": "verdict", "score": "score", "right": "reference_right"}
    cheats = {i for row in found.rows for i, entry in enumerate(row.entries) if entry and entry.right is not None}
    places = [(i, part) for i in range(len(found.heads)) for part in parts if part != "right" or i in cheats]
    heads = [f"{found.heads[i].label} {parts[part]}" for i, part in places]
    rows = [
        [row.texture, row.family, row.kind, row.regular_share]
        + [getattr(row.entries[i], part, None) for i, part in places]
        for row in found.rows
    ]
    return pd.DataFrame(rows, columns=["texture", "family", "kind", "regular_share", *heads])


def summary_table(found: Comparison) -> pd.DataFrame:
    """Return one row a method and lattice source: counts, success rates, means and ranks with their intervals."""
    rows = [dict(_summary_items(one)) for one in found.summaries]
    empty = ["method", "lattice_source", "reference", "cells", "ok", "refused", "failed", "missing"]
    return pd.DataFrame(rows) if rows else pd.DataFrame(columns=empty)


def _summary_items(one: Summary) -> Iterator[tuple[str, Any]]:
    yield "method", one.head.method
    yield "lattice_source", one.head.lattice_source
    yield "reference", one.head.reference
    yield from one.counts.items()
    yield from _items("preserved", one.success)
    yield from _items("preserved_refusals_left_out", one.success_answered)
    for prefix, estimates in (("", one.means), ("rank.", one.ranks), ("rank_refusals_left_out.", one.ranks_answered)):
        for name, estimate in estimates.items():
            yield from _items(prefix + name, estimate)


def _items(name: str, estimate: Estimate) -> Iterator[tuple[str, Any]]:
    parts: Mapping[str, Any] = {"": estimate.value, "_low": estimate.low, "_high": estimate.high}
    yield from ((name + part, value) for part, value in parts.items())
    yield f"{name}_n", estimate.n
    yield f"{name}_of", estimate.of


def differences_table(found: Comparison) -> pd.DataFrame:
    """Return one row a headline and pair of methods: the mean of first minus second, with its interval."""
    names = ["score", "first", "second", "difference", "low", "high", "n", "of", "excludes_zero"]
    rows = []
    for one in found.differences:
        shown = one.estimate
        values = [shown.value, shown.low, shown.high, shown.n, shown.of, shown.excludes_zero]
        rows.append([one.score, one.first.label, one.second.label, *values])
    return pd.DataFrame(rows, columns=names)


def columns_table(run: Run) -> pd.DataFrame:
    """Return one row a column of the run's tables: its name, its sentence, unit, range and better way.

    Without numbers where a column holds words; a range without an end is infinite, a ratio and a truth value have no
    unit.
    """
    own = [[name, meaning, "", None, None, "none"] for name, meaning in OWN_COLUMNS.items()]
    known = known_columns(run)
    scores = [[name, one.meaning, one.unit, *map(float, one.range), one.better] for name, one in known.items()]
    return pd.DataFrame([*own, *scores], columns=["column", "meaning", "unit", "low", "high", "better"])


def detectors_table(asked: pd.DataFrame) -> pd.DataFrame:
    """Return one row a detector and group of textures: shares of right answers, errors, seconds.

    Parameters
    ----------
    asked
        The run's :func:`~nrbench.reports.statistics.detections.answers`.
    """
    keys = ["family", "departure", "level"]
    regular = asked[asked["departure"] != STOCHASTIC]
    rows = [_trust_row(name, {}, part) for name, part in regular.groupby("detector", sort=False)]
    for depth in (1, 2, 3):
        table = asked if depth < 3 else asked[asked["level"].notna()]
        for (name, *group), part in table.groupby(["detector", *keys[:depth]], sort=False):
            rows.append(_trust_row(name, dict(zip(keys, group, strict=False)), part))
    return pd.DataFrame(rows)


def _trust_row(name: Any, group: Mapping[str, Any], part: pd.DataFrame) -> dict[str, Any]:
    right = rate(part["right"])
    return {
        "detector": name,
        **{key: group.get(key) for key in ("family", "departure", "level")},
        **{"n": len(part), "right": int(part["right"].sum()), "found": int(part["found"].sum())},
        **{"share_right": right.value, "share_right_low": right.low, "share_right_high": right.high},
        "median_vector_error": median(part[part["right"]]["vector_error"]),
        "median_seconds": median(part["seconds"]),
    }


def _write(table: pd.DataFrame, path: Path) -> Path:
    text = table.map(_guarded).rename(columns=_guarded).to_csv(index=False, lineterminator="\n")
    write_aside(path, lambda aside: aside.write_bytes(text.encode("utf-8", "backslashreplace")))
    return path


def _guarded(value: Any) -> Any:
    """Return text with an apostrophe in front where a spreadsheet would run it; anything else as it is."""
    return f"'{value}" if isinstance(value, str) and value.startswith(_FORMULA) else value
