"""Write the tables of a run as CSV."""

from __future__ import annotations

import itertools
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, ClassVar

import pandas as pd

from nrbench.labelling.labels import labels_table
from nrbench.runs.records import Run
from nrbench.storage import write_text

from .plots.perils_points import PerilsPoint, perils_points
from .statistics.detections import GROUP_KEYS, STOCHASTIC, group_answers, tabulate_answers
from .statistics.expectations import ClaimResult, PublishedComparison, compare_with_published, evaluate_claims
from .statistics.labelers import LabelerComparison, compare_labelers
from .statistics.levels import LevelPanel, compare_levels
from .statistics.method_comparison import Comparison, compare_methods
from .statistics.summaries import describe_scores
from .statistics.verdicts import QUALITY, is_valid_baseline

OWN_COLUMNS: Mapping[str, str] = {
    "suite": "Name of the suite.",
    "texture": "Name of the texture.",
    "family": "Family of the texture.",
    "kind": "Kind of the texture: 0, I, II, III or stochastic.",
    "regular_share": "Variance of the ideal image over mean total variance, 0 to 1.",
    "method": "The method, with the parameters that differ from its defaults.",
    "parameters": "All parameters of the method, as JSON.",
    "lattice_source": "Source of the lattice: given, own, none, or the name of a detector.",
    "replicate": "Number of the draw.",
    "reference": "Whether the method is a reference, which calibrates the scores and is never ranked.",
    "reference_right": "Whether a baseline is valid on this kind of texture: its output is then a correct result.",
    "status": "How the cell ended.",
    "phase": "The phase in which the cell failed; empty if it did not fail.",
    "message": "Why the cell failed or was refused.",
    "note": "A note of the method on its run.",
    "key": "Hash of everything that determines the result; the name of the cell's folder.",
}
"""Descriptions of the columns of ``cells.csv`` that are neither scores nor costs."""
_FORMULA = ("=", "+", "-", "@", "\t", "\r")


@dataclass(frozen=True)
class CsvTables:
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
    tests
        Whether to test which methods differ. Without tests there is no leading group.
    baseline
        The method with which the others are compared, by its name or label; by default the best ranked one.
    population
        Whether intervals are over a population of textures, of which the suite is a sample, else over draws of its own.
    """

    labels: tuple[Path, ...] = ()
    tests: bool = True
    baseline: str = ""
    population: bool = False

    version: ClassVar[str] = "1"
    folder: ClassVar[str] = "tables"

    def write(self, run: Run, directory: Path) -> list[Path]:
        """Write the tables and return their paths."""
        texts = {directory / f"{name}.csv": csv_text(table) for name, table in self.tables(run).items()}
        for path, text in texts.items():
            write_text(path, text)
        return list(texts)

    def marks(self, run: Run) -> pd.DataFrame:
        """Return textures by methods with the marks of the verdicts, as the text report prints them."""
        comparison = compare_methods(run, self.tests, self.baseline, self.population)
        entries = {row.texture: [entry.text if entry else "" for entry in row.entries] for row in comparison.rows}
        return pd.DataFrame.from_dict(entries, orient="index", columns=[one.label for one in comparison.methods])

    def tables(self, run: Run) -> dict[str, pd.DataFrame]:
        """Return the tables by the names of their files."""
        comparison = compare_methods(run, self.tests, self.baseline, self.population)
        tables = {
            "cells": cells_table(run),
            "comparison": comparison_table(comparison),
            "summary": summary_table(comparison),
            "differences": differences_table(comparison),
            "columns": columns_table(run),
        }
        if comparison.against:
            tables["baseline"] = baseline_table(comparison)
        if points := perils_points(comparison.summaries):
            tables["perils"] = perils_table(points)
        if panels := compare_levels(run, comparison):
            tables |= {"levels": levels_table(panels), "breaking_points": breaking_points_table(panels)}
        if claims := evaluate_claims(run):
            tables |= {"claims": claims_table(claims), "claim_tests": claim_tests_table(claims)}
        if published := compare_with_published(run, comparison):
            tables |= {
                "published": published.verdicts,
                "published_rates": published_rates_table(published),
                "published_classes": published_classes_table(published),
            }
            for number, regular in ((2, True), (3, False)):
                heads, *lines = published.lines(regular)
                tables[f"published_table_{number}"] = pd.DataFrame(lines, columns=heads)
        if labelers := compare_labelers(run, self.labels):
            tables |= {"labels": labels_table(run, self.labels), "agreement": agreement_table(labelers)}
        answers = tabulate_answers(run)
        if not answers.empty:
            tables |= {"detections": answers, "detectors": detectors_table(answers)}
        return tables


def cells_table(run: Run) -> pd.DataFrame:
    """Return the run's table of cells, with the column ``reference_right``."""
    table = run.table()
    valid = pd.Series([is_valid_baseline(record) for record in run.cells], table.index, dtype=object)
    table.insert(list(table.columns).index("reference") + 1, "reference_right", valid)
    return table


def comparison_table(comparison: Comparison) -> pd.DataFrame:
    """Return textures by methods: verdict and quality, whether it is an upper bound, and whether a baseline is valid.

    Without a quality, ``regularity.score`` takes its place, in columns named ``score``.
    """
    score = "quality" if comparison.score == QUALITY else "score"
    names = ("texture", "family", "kind", "regular_share")
    columns: dict[str, Any] = {name: [getattr(row, name) for row in comparison.rows] for name in names}
    parts = {"verdict": "verdict", "score": score, "upper_bound": "upper_bound", "baseline_valid": "reference_right"}
    for i, method in enumerate(comparison.methods):
        entries = [row.entries[i] for row in comparison.rows]
        for part, name in parts.items():
            values = [getattr(entry, part) if entry else None for entry in entries]
            if part in ("verdict", "score") or any(value is not None for value in values):
                columns[f"{method.label} {name}"] = pd.Series(values, dtype=object)
    return pd.DataFrame(columns)


def summary_table(comparison: Comparison) -> pd.DataFrame:
    """Return one row a method and lattice source: rank, counts, success rates and means with intervals."""
    rows = []
    for one in comparison.summaries:
        row: dict[str, Any] = {"method": one.method.name, "lattice_source": one.method.lattice_source}
        row |= {"reference": one.method.reference, "rank": one.rank, "leading": one.leading if one.rank else None}
        row |= {"upper_bound": one.at_most, **one.counts}
        for name, estimate in one.all_means.items():
            row |= estimate.columns(name, f"{name}_")
        rows.append(row)
    first = ("method", "lattice_source", "reference", "rank", "leading", "upper_bound")
    empty = [*first, "cells", "ok", "refused", "failed", "missing"]
    return pd.DataFrame(rows).astype({"rank": "Int64"}) if rows else pd.DataFrame(columns=empty)


def differences_table(comparison: Comparison) -> pd.DataFrame:
    """Return one row a headline and pair of methods: the mean of first minus second, its interval and p-value."""
    parts = ("low", "high", "n", "of")
    rows = [
        {"score": one.score, "first": one.first.label, "second": one.second.label}
        | {**one.estimate.columns("difference", parts=parts), "p": one.p}
        for one in comparison.differences
    ]
    return pd.DataFrame(rows, columns=["score", "first", "second", "difference", *parts, "p"])


def baseline_table(comparison: Comparison) -> pd.DataFrame:
    """Return one row a method: its difference in quality to the baseline, and the adjusted p-value."""
    assert comparison.baseline is not None
    return pd.DataFrame(
        {"method": one.first.label, "baseline": comparison.baseline.label}
        | one.estimate.columns("difference")
        | {"p": one.p}
        for one in comparison.against
    )


def columns_table(run: Run) -> pd.DataFrame:
    """Return one row a column of ``cells.csv``: its name, meaning, unit, range, and which values are better.

    Columns that hold text have no range. An open range ends at infinity. A ratio and a truth value have no unit.
    """
    own = [[name, meaning, "", None, None, "none"] for name, meaning in OWN_COLUMNS.items()]
    scores = [
        [name, column.meaning, column.unit, *map(float, column.range), column.better]
        for name, column in describe_scores(run).items()
    ]
    return pd.DataFrame([*own, *scores], columns=["column", "meaning", "unit", "low", "high", "better"])


def perils_table(points: Sequence[PerilsPoint]) -> pd.DataFrame:
    """Return one row a point, with intervals and the number of textures that each coordinate rests on."""
    return pd.DataFrame(
        {
            **{"method": point.method.name, "lattice_source": point.method.lattice_source},
            "reference": point.method.reference,
            **point.structure.columns("structure_value", "structure_"),
            **point.randomness.columns("randomness_value", "randomness_"),
        }
        for point in points
    )


def levels_table(panels: Sequence[LevelPanel]) -> pd.DataFrame:
    """Return one row a departure, level and method: the mean quality with its interval."""
    return pd.DataFrame(
        {
            **{"departure": panel.departure, "level": level, "method": one.method.name},
            **{"lattice_source": one.method.lattice_source, "reference": one.method.reference},
            **estimate.columns("quality"),
        }
        for panel in panels
        for one in panel.series
        for level, estimate in zip(panel.levels, one.estimates, strict=True)
    )


def breaking_points_table(panels: Sequence[LevelPanel]) -> pd.DataFrame:
    """Return one row a departure and method: the level at which it breaks, and the number of levels with a quality."""
    return pd.DataFrame(
        {
            **{"departure": panel.departure, "method": one.method.name, "lattice_source": one.method.lattice_source},
            **{"reference": one.method.reference, "breaks_at": one.breaks_at},
            **{"levels_scored": len(one.scored), "levels": len(panel.levels)},
        }
        for panel in panels
        for one in panel.series
    )


def claims_table(results: Sequence[ClaimResult]) -> pd.DataFrame:
    """Return one row a claim, series and level: the mean with its interval."""
    rows = [
        {
            **{"claim": result.claim.name, "score": result.claim.score, "axis": result.claim.axis},
            **{"series": series.name, "level": level, "method": method},
            **estimate.columns("mean"),
        }
        for result in results
        for series in result.series
        for level, method, estimate in zip(series.levels, series.methods, series.estimates, strict=True)
    ]
    return pd.DataFrame(rows)


def claim_tests_table(results: Sequence[ClaimResult]) -> pd.DataFrame:
    """Return one row an expectation: the claim, its quote and outcome, the difference with its interval."""
    rows = [
        {
            **{"claim": result.claim.name, "source": result.claim.source, "quote": result.claim.quote},
            **{"claim_outcome": result.outcome, "expectation": test.words, "outcome": test.outcome},
            **test.difference.columns("difference", parts=("low", "high", "n")),
        }
        for result in results
        for test in result.expectations
    ]
    return pd.DataFrame(rows)


def published_rates_table(published: PublishedComparison) -> pd.DataFrame:
    """Return one row a group of figures and method: published and measured rates, and their difference."""
    parts = ("published", "same", "measured", "difference")
    rows = []
    for rate in published.rates:
        row = {"figures": rate.group, "method": rate.method.name, "lattice_source": rate.method.lattice_source}
        for part in parts:
            row |= getattr(rate, part).columns(part, f"{part}_", ("low", "high", "n"))
        rows.append(row)
    return pd.DataFrame(rows)


def published_classes_table(published: PublishedComparison) -> pd.DataFrame:
    """Return one row a class of textures: the agreement with its interval; kappa and its chance on the last row."""
    rows = [
        {"class": row.kind, "pairs": row.pairs, **row.agreement.columns("agreement", parts=("low", "high", "n"))}
        for row in published.classes
    ]
    table = pd.DataFrame(rows).rename(columns={"n": "figures"})
    chance = published.chance or (None, None)
    for name, value in {
        **published.kappa.columns("kappa", "kappa_", ("low", "high")),
        **{"chance_mean": chance[0], "chance_95": chance[1]},
    }.items():
        table[name] = pd.Series([value], [len(table) - 1], dtype=object)
    return table


def detectors_table(answers: pd.DataFrame) -> pd.DataFrame:
    """Return one row a detector and group of textures: shares of right answers, errors, seconds.

    Parameters
    ----------
    answers
        The table of :func:`tabulate_answers`.
    """
    tables = [answers[answers["departure"] != STOCHASTIC], answers, answers, answers[answers["level"].notna()]]
    return pd.DataFrame(
        {
            **dict(itertools.zip_longest(GROUP_KEYS, key)),
            **{"n": group.n, "right": round(group.n * (group.right.value or 0)), "found": group.found},
            **group.right.columns("share_right", "share_right_", ("low", "high")),
            **{"median_vector_error": group.vector_error, "median_seconds": group.seconds},
        }
        for depth, table in enumerate(tables, 1)
        for key, group in group_answers(table, GROUP_KEYS[:depth]).items()
    )


def agreement_table(comparison: LabelerComparison) -> pd.DataFrame:
    """Return one row a question and pair of raters: the number of items, and the agreement with its interval.

    Pairs with answers have the share of equal answers and kappa; a question without an automatic answer has the
    agreement of the orders of methods in their place.
    """
    return pd.DataFrame(
        {"question": name, "kind": kind, "first": agreement.first, "second": agreement.second, "items": agreement.n}
        | {"outputs": agreement.outputs, "share_equal": agreement.equal}
        | agreement.kappa.columns("kappa", "kappa_", ("low", "high"))
        | agreement.decided.columns("kappa_decided", "kappa_decided_", ("low", "high"))
        | agreement.spearman.columns("spearman", "spearman_", ("low", "high"))
        | agreement.tau.columns("tau", "tau_", ("low", "high"))
        | agreement.ordered.columns("ordered", "ordered_", ("low", "high"))
        for name, asked in comparison.questions.items()
        for kind, agreements in (
            ("judge and labelers", [*asked.ranks, *asked.with_verdict]),
            ("labelers", asked.between),
            ("self", asked.selves),
        )
        for agreement in agreements
    )


def csv_text(table: pd.DataFrame) -> str:
    """Return a table as CSV, in which a spreadsheet runs no text as a formula."""
    return str(table.map(_disarm).rename(columns=_disarm).to_csv(index=False, lineterminator="\n"))


def _disarm(value: Any) -> Any:
    """Return text that a spreadsheet would run with an apostrophe in front, and any other value unchanged."""
    return f"'{value}" if isinstance(value, str) and value.startswith(_FORMULA) else value
