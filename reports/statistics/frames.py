"""The tables of a run: tidy frames of numbers, and tables of formatted cells that every format prints."""

from __future__ import annotations

import itertools
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import pandas as pd

from nrbench import plugins
from nrbench.labelling.labels import labels_table
from nrbench.plugins.parameters import list_parameters
from nrbench.runs.records import CellRecord, Run

from .detections import GROUP_KEYS, STOCHASTIC, VERTEX_COLUMNS, group_answers, tabulate_answers
from .expectations import (
    ClaimResult,
    LevelPanel,
    PublishedComparison,
    compare_levels,
    compare_with_published,
    evaluate_claims,
)
from .format import format_interval, format_number, format_signed
from .labelers import LabelerComparison, compare_labelers
from .method_comparison import Comparison
from .summaries import Method, Number, SummaryRow, describe_scores, method_of, perils_points
from .verdicts import QUALITY, is_valid_baseline

CELL_COLUMNS: Mapping[str, str] = {
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


def tabulate_run(run: Run, comparison: Comparison, labels: Sequence[Path] = ()) -> dict[str, pd.DataFrame]:
    """Return all tables of a run as tidy frames, by the names of their CSV files.

    Parameters
    ----------
    run, comparison
        The run and its comparison.
    labels
        Answer files of the labelling pages.
    """
    panels, claims = compare_levels(run, comparison), evaluate_claims(run)
    published, labelers = compare_with_published(run, comparison), compare_labelers(run, labels)
    answers = tabulate_answers(run)
    frames = {
        "cells": cells_table(run),
        "comparison": comparison_table(comparison),
        "summary": summary_table(comparison),
        "differences": differences_table(comparison),
        "columns": columns_table(run),
        "baseline": baseline_table(comparison),
        "improvements": improvements_table(comparison),
        "parameters": print_parameters(comparison).frame(),
        "patches": print_patches(run).frame(),
        "perils": perils_table(comparison),
        "levels": levels_table(panels),
        "breaking_points": breaking_points_table(panels),
        "claims": claims_table(claims),
        "claim_tests": claim_tests_table(claims),
        **(published_tables(published) if published else {}),
        "labels": labels_table(run, labels) if labelers else pd.DataFrame(),
        "agreement": agreement_table(labelers) if labelers else pd.DataFrame(),
        "detections": answers,
        "detectors": detectors_table(answers) if len(answers) else pd.DataFrame(),
    }
    always = ("cells", "comparison", "summary", "differences", "columns")
    return {name: frame for name, frame in frames.items() if name in always or not frame.empty}


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
        row: dict[str, Any] = {**_name_method(one.method), "rank": one.rank}
        row["leading"] = one.leading if one.rank else None
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
    return pd.DataFrame(
        {"method": one.first.label, "baseline": one.second.label} | one.estimate.columns("difference") | {"p": one.p}
        for one in comparison.against
    )


def improvements_table(comparison: Comparison) -> pd.DataFrame:
    """Return one row a headline and method with a preset: its mean, that without the preset, the difference and p."""
    return pd.DataFrame(
        {"score": one.score, **_name_method(one.published.method, reference=False), "improved_method": improved.name}
        | one.published.all_means[one.score].columns("published", "published_")
        | one.improved.all_means[one.score].columns("improved", "improved_")
        | one.difference.columns("difference", "difference_")
        | {"p": one.p}
        for one in comparison.improvements
        for improved in [one.improved.method]
    )


def columns_table(run: Run) -> pd.DataFrame:
    """Return one row a column of ``cells.csv``: its name, meaning, unit, range, and which values are better.

    Columns that hold text have no range. An open range ends at infinity. A ratio and a truth value have no unit.
    """
    described = [[name, meaning, "", None, None, "none"] for name, meaning in CELL_COLUMNS.items()]
    scores = [
        [name, column.meaning, column.unit, *map(float, column.range), column.better]
        for name, column in describe_scores(run).items()
    ]
    return pd.DataFrame([*described, *scores], columns=["column", "meaning", "unit", "low", "high", "better"])


def perils_table(comparison: Comparison) -> pd.DataFrame:
    """Return one row a point: intervals, the number of textures of each coordinate, and the perils without a score."""
    return pd.DataFrame(
        {
            **_name_method(point.method),
            **point.structure.columns("structure_value", "structure_"),
            **point.randomness.columns("randomness_value", "randomness_"),
            **{"upper_bound": point.at_most, "silences": point.silences},
        }
        for point in perils_points(comparison.summaries)
    )


def levels_table(panels: Sequence[LevelPanel]) -> pd.DataFrame:
    """Return one row a departure, level and method: the mean quality with its interval."""
    return pd.DataFrame(
        {
            **{"departure": panel.departure, "level": level, **_name_method(one.method)},
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
            **{"departure": panel.departure, **_name_method(one.method), "breaks_at": one.breaks_at},
            **{"levels_scored": len(one.scored), "levels": len(panel.levels)},
        }
        for panel in panels
        for one in panel.series
    )


def claims_table(results: Sequence[ClaimResult]) -> pd.DataFrame:
    """Return one row a claim, series and level: the mean with its interval."""
    return pd.DataFrame(
        {
            **{"claim": result.claim.name, "score": result.claim.score, "axis": result.claim.axis},
            **{"series": series.name, "level": level, "method": series.method_at(level)},
            **estimate.columns("mean"),
        }
        for result in results
        for series, measured in zip(result.claim.series, result.series, strict=True)
        for level, estimate in zip(measured.levels, measured.estimates, strict=True)
    )


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


def published_tables(published: PublishedComparison) -> dict[str, pd.DataFrame]:
    """Return the verdicts, the rates, the agreement by class with its kappa, and tables 2 and 3."""
    rates = [
        {"figures": one.words, **_name_method(one.method, reference=False)}
        | one.published.columns("published", "published_", ("low", "high", "n"))
        | one.expected.columns("same", "same_", ("low", "high", "n"))
        | one.measured.columns("measured", "measured_", ("low", "high", "n"))
        | one.difference.columns("difference", "difference_", ("low", "high", "n"))
        for one in published.rates
    ]
    classes = pd.DataFrame(
        {
            **{"class": row["class"], "pairs": row["pairs"]},
            **row["agreement"].columns("agreement", parts=("low", "high", "n")),
            **row["kappa"].columns("kappa", "kappa_", ("low", "high")),
            **dict(zip(("chance_mean", "chance_95"), row["chance"] or (None, None), strict=True)),
        }
        for row in published.classes.to_dict("records")
    ).rename(columns={"n": "figures"})
    return {
        "published": published.verdicts,
        "published_rates": pd.DataFrame(rates),
        "published_classes": classes,
        **{f"published_table_{one.name[-1]}": one.frame() for one in print_published(published)},
    }


def detectors_table(answers: pd.DataFrame) -> pd.DataFrame:
    """Return one row a detector and group of textures: shares of right answers, errors, seconds, vertices.

    Parameters
    ----------
    answers
        The table of :func:`tabulate_answers`.
    """
    tables = [answers[answers["departure"] != STOCHASTIC], answers, answers, answers[answers["level"].notna()]]
    return pd.DataFrame(
        {
            **{key: row.get(key) for key in GROUP_KEYS},
            **{"n": row["n"], "right": round(row["n"] * (row["right"].value or 0)), "found": row["found"]},
            **row["right"].columns("share_right", "share_right_", ("low", "high")),
            **{"median_vector_error": row["vector_error"], "median_seconds": row["seconds"]},
            **{f"mean_{name}": row[name] for name in VERTEX_COLUMNS},
        }
        for depth, table in enumerate(tables, 1)
        for row in group_answers(table, GROUP_KEYS[:depth]).to_dict("records")
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


def _name_method(method: Method | None, reference: bool = True) -> dict[str, Any]:
    """Return the columns that name a method."""
    assert method is not None
    names = {"method": method.name, "lattice_source": method.lattice_source}
    return {**names, "reference": method.reference} if reference else names


@dataclass(frozen=True)
class PrintedTable:
    """A table of formatted cells, which each format prints in its own way.

    Parameters
    ----------
    name
        Its name.
    heads
        The heads of its columns: text, a :class:`~nrbench.reports.statistics.summaries.SummaryRow` or a
        :class:`~nrbench.reports.statistics.summaries.MethodSummary`.
    rows
        The cells: text, a number, a method, an entry of the comparison or one of the report of 2004; None if empty.
        Two texts are the published and the measured rate.
    fixed
        Number of columns that stand at the left of each part if the table is split.
    rules
        The rows above which there is a rule.
    title
        What stands above it.
    splits
        Whether columns that do not fit follow in further parts; else the table is printed whole.
    """

    name: str
    heads: Sequence[Any]
    rows: Sequence[Sequence[Any]]
    fixed: int = 1
    rules: Sequence[int] = ()
    title: str = ""
    splits: bool = False

    def pick(self, columns: Iterable[int]) -> PrintedTable:
        """Return the table with the fixed columns and some of the others, by their numbers from 0."""
        chosen = [*range(self.fixed), *(self.fixed + i for i in columns)]
        return replace(
            self, heads=[self.heads[i] for i in chosen], rows=[[row[i] for i in chosen] for row in self.rows]
        )

    def split(self, widths: Sequence[float], limit: float) -> list[PrintedTable]:
        """Return parts that are no wider than a limit, with at least one column beside the fixed ones in each.

        Parameters
        ----------
        widths
            The widths of all columns with the space beside them, in the unit of the limit.
        limit
            The largest width of a part, with the fixed columns.
        """
        first, parts, left = sum(widths[: self.fixed]), list[list[int]](), 0.0
        for index, width in enumerate(widths[self.fixed :]):
            left -= width
            if not parts or left < 0:
                parts.append([])
                left = limit - first - width
            parts[-1].append(index)
        return [self.pick(part) for part in parts] if self.splits else [self]

    def split_every(self, count: int) -> list[PrintedTable]:
        """Return parts of at most so many columns beside the fixed ones."""
        columns = range(len(self.heads) - self.fixed)
        return [self.pick(columns[i : i + count]) for i in columns[::count]] if self.splits else [self]

    def split_rows(self) -> list[PrintedTable]:
        """Return the rows between each two rules as a part, for tables that may be higher than a page."""
        ends = [0, *self.rules, len(self.rows)]
        return [replace(self, rows=self.rows[a:b], rules=()) for a, b in itertools.pairwise(ends)]

    def frame(self) -> pd.DataFrame:
        """Return the texts of the cells."""
        texts = [[cell_text(cell) for cell in row] for row in self.rows]
        return pd.DataFrame(texts, columns=[getattr(head, "label", head) for head in self.heads])


def cell_text(cell: Any) -> str:
    """Return a cell as plain text."""
    if cell is None or isinstance(cell, str):
        return cell or ""
    return ", ".join(cell) if isinstance(cell, tuple) else str(cell.text)


def print_methods(comparison: Comparison, lines: Sequence[SummaryRow]) -> PrintedTable:
    """Return methods by scores; a rule stands above the references."""
    rows = [[one, *(line.numbers[one.label] for line in lines)] for one in comparison.summaries]
    references = [i for i, one in enumerate(comparison.methods) if one.reference]
    return PrintedTable("summary", ["method", *lines], rows, rules=[i for i in references[:1] if i], splits=True)


def print_textures(comparison: Comparison) -> PrintedTable:
    """Return textures by methods."""
    rows = [
        [row.texture, "–" if row.regular_share is None else f"{row.regular_share:.2f}", *row.entries]
        for row in comparison.rows
    ]
    return PrintedTable("comparison", ["texture", "share", *comparison.summaries], rows, fixed=2, splits=True)


def print_published(published: PublishedComparison) -> list[PrintedTable]:
    """Return tables 2 and 3 of the report of 2004, as far as the run has figures; the rates stand below a rule."""
    tables = []
    for number, regular in ((2, True), (3, False)):
        figures, footers = published.table(regular), published.footers(regular)
        rows = [[str(figure), words, *entries] for figure, words, _, entries in figures]
        rows += [[name, "preserved/total", *pairs] for name, pairs in footers.items()]
        heads = ["figure", "description", *published.methods]
        if figures:
            table = PrintedTable(f"published-{number}", heads, rows, 2, [len(figures)], published.titles[regular])
            tables.append(table)
    return tables


def print_rates(published: PublishedComparison) -> PrintedTable:
    """Return the published and the measured success rates over the same figures."""
    rows = [
        [
            one.words,
            one.method,
            *(Number(rate, rate=True) for rate in (one.published, one.expected, one.measured)),
            f"{format_signed(one.difference.value)} {format_interval(one.difference)}",
        ]
        for one in published.rates
    ]
    heads = ["figures", "method", "published, all", "published", "measured", "difference"]
    return PrintedTable("published-rates", heads, rows, fixed=2)


def print_improvements(comparison: Comparison) -> PrintedTable:
    """Return each score of the methods as published, with a preset, beside that of the same methods by default."""
    rows = [
        [
            line.title,
            one.published.method,
            *(line.numbers[each.label] for each in (one.published, one.improved)),
            f"{format_signed(one.difference.value)} {format_interval(one.difference)}".rstrip(),
        ]
        for line in comparison.summary_rows
        for one in comparison.improvements
        if one.score == line.name
    ]
    rules = [i for i in range(1, len(rows)) if rows[i][0] != rows[i - 1][0]]
    heads = ["score", "method", "as published", "improved", "difference"]
    title = "As published, and improved: the methods with a preset, beside the same methods by default"
    return PrintedTable("improvements", heads, rows, 2, rules, title)


def print_parameters(comparison: Comparison) -> PrintedTable:
    """Return all parameters of the methods whose names are not those of plugins, and do not show all parameters."""
    methods = {one.name: one for one in comparison.methods}
    rows = [
        [name, f"{one.plugin}: {list_parameters(one.parameters, ', ')}"]
        for name, one in methods.items()
        if name not in (one.plugin, f"{one.plugin}:{list_parameters(one.parameters)}")
    ]
    return PrintedTable("parameters", ["method", "parameters"], rows, title="All parameters of the methods")


def print_detectors(summaries: pd.DataFrame) -> PrintedTable:
    """Return detectors by accuracy, vertices, calibration and time."""
    rows = [
        [
            one["detector"],
            *(Number(rate if rate.n else None, rate=True) for rate in (one["exact"], one["false"])),
            *map(format_number, (one[name] for name in ("vector_error", *VERTEX_COLUMNS))),
            *map(format_number, (one["calibration"].error, one["seconds"])),
        ]
        for one in summaries.to_dict("records")
    ]
    heads = ["detector", "exact", "false", "error", "recall", "precision", "calibration", "seconds"]
    return PrintedTable("detectors", heads, rows)


def print_patches(run: Run) -> PrintedTable:
    """Return table 1 of the report of 2004, as the methods that copy patches declare for their parameters.

    A row is a method, what a patch is, how its place is chosen, and how it is joined to the others.
    """
    records = {record.method: record for record in run.cells if not record.cell.reference}
    classes = method_classes(records.values())
    rows: list[Sequence[Any]] = []
    for record in records.values():
        if (cls := classes.get(record.cell.method)) is not None:
            defaults = {key: getattr(cls, key, "") for key in getattr(cls, "__dataclass_fields__", {})}
            terms = plugins.describe_patches(cls, {**defaults, **record.parameters})
            method = replace(method_of(record), lattice_source="none")
            rows += [(method, *terms)] if len(terms) == len(plugins.PATCH_TERMS) else []
    heads = ["method", "patch shape/size", "patch placement", "patch stitching"]
    title = "Table 1: how methods that copy patches choose, place and stitch them"
    return PrintedTable("patches", heads, rows, title=title)


def method_classes(cells: Iterable[CellRecord]) -> dict[str, type | None]:
    """Return the class of each installed method of some cells by its name, in the order of the cells."""
    names = dict.fromkeys(record.cell.method for record in cells)
    installed = set(plugins.names("synthesizers"))
    return {name: plugins.find("synthesizers", name).cls for name in names if name in installed}
