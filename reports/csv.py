"""Write the tables of a run as CSV."""

from __future__ import annotations

import html
from dataclasses import dataclass
from pathlib import Path
from typing import Any, ClassVar

import pandas as pd

from nrbench.runs.records import Run
from nrbench.storage import write_files

from .statistics.frames import print_textures, tabulate_run
from .statistics.method_comparison import ComparisonOptions

_SHOWN = ("quality", "quality.regularity", "quality.integrity", "quality.randomness", "quality.appearance", "seconds")
"""The means that a notebook shows."""
_FORMULA = ("=", "+", "-", "@", "\t", "\r")


@dataclass(frozen=True)
class CsvTables(ComparisonOptions):
    """Tables as CSV in UTF-8 with one header line; floats read back to the same bits.

    - ``cells.csv``: one row a cell, one column a score.
    - ``comparison.csv``: textures by methods.
    - ``summary.csv``: for each method its rank, whether it is in the leading group, whether its quality is an upper
      bound, counts, success rate and means, with 95 % intervals. ``quality`` counts a failed or refused
      cell as 0, ``quality.score`` leaves it out.
    - ``differences.csv``: the paired differences between methods, and from 6 textures up the p-value of each pair of
      ranked methods, adjusted for all pairs.
    - ``columns.csv``: for every column of ``cells.csv`` its meaning, unit, range, and which values are better.
    - ``perils.csv``: the points of the perils plane.
    - ``baseline.csv``: for each method the difference in quality to one method, by default the best, with the
      p-value of ``differences.csv``.

    ``parameters.csv`` has all parameters of the methods with a preset, a label or changed parameters,
    ``improvements.csv`` the methods as published, with a preset, beside the same methods by default, and
    ``patches.csv`` how methods that copy patches choose, place and stitch them (table 1 of the report of 2004), if the
    run has such methods.

    If the suite has textures at two levels or more of one departure, ``levels.csv`` has the mean quality of each method
    at each level, and ``breaking_points.csv`` the first level at which it is below 0.5.

    If the suite tests claims, ``claims.csv`` has the mean of each series at each level, and ``claim_tests.csv`` what is
    expected and whether it held, failed or is undecided.

    If the suite has analogues of figures of the report of 2004, ``published.csv`` has one row a figure and method,
    ``published_rates.csv`` the success rates as published and as measured over the same figures, and
    ``published_classes.csv`` the agreement by class of texture, with kappa and the kappa of random pairings.
    ``published_table_2.csv`` and ``published_table_3.csv`` are tables 2 and 3 of the report, as it prints them.

    If detectors found the lattices, ``detections.csv`` has one row an answer, and ``detectors.csv`` each detector's
    share of right answers, with its interval over draws, by family, departure and level; an empty cell there stands for
    all of them (of the textures that have a lattice).

    Text that a spreadsheet would run as a formula starts with an apostrophe.

    Parameters
    ----------
    labels
        Answer files of the labelling pages of ``nrbench label``. They add ``labels.csv``, one row an answer, and
        ``agreement.csv``, one row a question and pair of raters.
    """

    labels: tuple[Path, ...] = ()

    version: ClassVar[str] = "1"
    folder: ClassVar[str] = "tables"

    def write(self, run: Run, directory: Path) -> list[Path]:
        """Write the tables and return their paths."""
        return write_files(directory, {f"{name}.csv": csv_text(table) for name, table in self.tables(run).items()})

    def notebook(self, run: Run) -> str:
        """Return the methods, and textures by methods, as HTML tables with marks, for notebooks."""
        suite = run.info.get("suite", {})
        title = f"{suite.get('name', 'run')} {suite.get('version', '')} in {run.root}: {len(run.cells)} cells"
        shown = self.tables(run)["summary"].set_index(["method", "lattice_source"])
        names = ["rank", "cells", "ok", "refused", "failed", "preserved", *_SHOWN]
        table = shown[[name for name in names if name in shown]].copy()
        if "leading" in shown:
            leading, references = shown["leading"].eq(True), shown["reference"].astype(bool)
            marks = [
                "★" if first else "†" if reference else "" for first, reference in zip(leading, references, strict=True)
            ]
            table.insert(0, " ", marks)
        textures = print_textures(self.comparison(run)).frame().set_index("texture").drop(columns="share")
        both = table, textures.rename_axis(index=None)
        parts = [one.to_html(float_format="{:.3g}".format, na_rep="–", escape=True) for one in both]
        legend = "★ leading group, † reference, never ranked. "
        legend += "✓ lattice preserved, ✗ lost, ! failed, N/A refused; beside it the quality."
        return f"<p>{html.escape(title)}</p>{parts[0]}<p>{legend}</p>{parts[1]}"

    def tables(self, run: Run) -> dict[str, pd.DataFrame]:
        """Return the tables by the names of their files."""
        return tabulate_run(run, self.comparison(run), self.labels)


def csv_text(table: pd.DataFrame) -> str:
    """Return a table as CSV, in which a spreadsheet runs no text as a formula."""
    return str(table.map(_disarm).rename(columns=_disarm).to_csv(index=False, lineterminator="\n"))


def _disarm(value: Any) -> Any:
    """Return text that a spreadsheet would run with an apostrophe in front, and any other value unchanged."""
    return f"'{value}" if isinstance(value, str) and value.startswith(_FORMULA) else value
