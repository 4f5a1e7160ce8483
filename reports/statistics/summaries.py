"""Summarize each method of a run: its means over textures, its rank, and its point in the perils plane."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import pandas as pd

from nrbench import plugins
from nrbench.plugins.forms import Column
from nrbench.runs.records import Run
from nrbench.runs.store import FAILED

from .estimates import NO_ESTIMATE, Estimate, estimate_means, estimate_proportion, stack_draws, success_rate
from .format import (
    describe_column,
    format_count,
    format_interval,
    format_successes,
    format_value,
    round_small,
)
from .verdicts import (
    COMPLETE,
    DERIVED_COLUMNS,
    MARKS,
    PERILS,
    PRESERVED,
    QUALITY,
    RANKING,
    SCORE,
    STRUCTURE,
    BaselineValidity,
    count_valid_textures,
    has_quality,
    method_label,
)

HEADLINES = (RANKING, *PERILS)
_TILES = ("randomness.variation", "randomness.repetition", "randomness.distance")
HEADLINES_WITHOUT_QUALITY = (SCORE, "integrity.score", *_TILES, "appearance.score")
HEADLINE_METRICS = ("quality", "regularity", "integrity", "randomness", "appearance")
COSTS: Mapping[str, Column] = {
    "seconds": Column("Wall time of the synthesis, including its own lattice detection.", "s", (0, math.inf), "lower"),
    "peak_mib": Column("Peak memory above the idle worker.", "MiB", (0, math.inf), "lower"),
}
LATTICES: Mapping[str, tuple[str, str]] = {
    "lattice_used": ("lattice_recovery.", "the lattice that the method used"),
    "lattice_of_output": ("regularity.lattice_", "the lattice of the output, fitted to its windows that are in place"),
}
"""The lattices that are compared with the true one: the beginnings of the names of their columns, and their meaning."""
RATE = Column("Share of outputs whose lattice is preserved.", better="higher")
RATE_MEANING = (
    "With Wilson's 95 % interval over outputs. Failures and refusals count as not preserved. Undecided cells are left "
    "out."
)
MEAN_MEANING = "Mean over textures, with a 95 % interval. A texture counts as the mean over its draws."


@dataclass(frozen=True)
class Method:
    """A method with its lattice source: one column of the comparison.

    Parameters
    ----------
    name, lattice_source
        As in the cells.
    reference
        Whether it calibrates the scores and is never ranked.
    parameters
        All parameters of the method.
    """

    name: str
    lattice_source: str
    reference: bool
    parameters: Mapping[str, Any]

    @property
    def base(self) -> str:
        """The name without parameters."""
        return self.name.partition(":")[0]

    @property
    def label(self) -> str:
        """The name, with the lattice source in parentheses."""
        return method_label(self.name, self.lattice_source)


@dataclass(frozen=True)
class MethodSummary:
    """One method in numbers.

    Parameters
    ----------
    method
        The method.
    counts
        Number of ``cells``, and of those that are ``ok``, ``refused``, ``failed`` and ``missing``.
    success, success_answered
        Success rate; refusals of a method count as not preserved, or are left out.
    means
        Mean over textures of every score and cost.
    validity, validity_scored
        On how many textures a baseline is valid: of all, and of those with a quality.
    lattices
        For each of :data:`LATTICES` the median error over outputs in px and in s, and the share that are exact.
    rank
        Position by mean quality, 1 the best; None for a reference, without a quality, and if the method has a quality
        on fewer than half as many textures as the method with the most.
    leading
        Whether it is in the leading group.
    """

    method: Method
    counts: Mapping[str, int]
    success: Estimate
    success_answered: Estimate
    means: Mapping[str, Estimate]
    validity: BaselineValidity
    validity_scored: BaselineValidity
    lattices: Mapping[str, Estimate]
    rank: int | None = None
    leading: bool = False

    @property
    def at_most(self) -> bool:
        """Whether the mean quality is an upper bound."""
        return RANKING in self.means and self.means[RANKING].at_most

    @property
    def all_means(self) -> dict[str, Estimate]:
        """The success rates, the errors of lattices, and the means, by the names of their columns."""
        rates = {"preserved": self.success, "preserved_refusals_left_out": self.success_answered}
        return {**rates, **self.lattices, **self.means}


@dataclass(frozen=True)
class SummaryRow:
    """One number for each method.

    Parameters
    ----------
    name, column
        Its name, and the column that describes it.
    note
        How it is computed from the cells.
    estimates
        One for each method; None if there is none.
    rate
        Whether it is a success rate.
    variant
        Whether it is the number of the row before, computed without some of the cells.
    blanks
        For each method the text where there is no number: a dash, or N/A if it refused every cell.
    """

    name: str
    column: Column
    note: str
    estimates: Sequence[Estimate | None]
    rate: bool = False
    variant: bool = False
    blanks: Sequence[str] = ()

    @property
    def title(self) -> str:
        """The name, without the metric for the four perils, and in words for the errors of lattices."""
        words = self.name.replace("_", " ") if self.name.startswith(tuple(LATTICES)) else self.name
        return words.rpartition(".")[2] if self.name in PERILS else words

    @property
    def meaning(self) -> str:
        """The description of the column, and how the number is computed."""
        return f"{describe_column(self.column)}\n{self.note}"

    @property
    def values(self) -> list[str]:
        """The values as text."""
        blanks = self.blanks or ["–"] * len(self.shown)
        pairs = zip(self.shown, blanks, strict=True)
        return [format_value(estimate, self.rate) if estimate else blank for estimate, blank in pairs]

    @property
    def intervals(self) -> list[str]:
        """The intervals as text; empty if there is none."""
        return [format_interval(estimate, self.rate) if estimate else "" for estimate in self.shown]

    @property
    def shown(self) -> list[Estimate | None]:
        """The estimates as tables show them."""
        share = self.column.range == (0.0, 1.0)
        return [round_small(one) if one and share else one for one in self.estimates]

    @property
    def counts(self) -> list[str]:
        """How many textures succeed for a rate; how many are counted for other rows."""
        text = format_successes if self.rate else format_count
        return [text(estimate) if estimate else "" for estimate in self.estimates]


def list_methods(run: Run) -> list[Method]:
    """Return the methods in the order of the suite, reference methods last."""
    methods: dict[tuple[str, str], Method] = {}
    for record in run.cells:
        key = (record.method, record.lattice_source)
        methods.setdefault(key, Method(*key, record.reference, dict(record.parameters)))
    return sorted(methods.values(), key=lambda method: method.reference)


def summarize_methods(run: Run, cells: pd.DataFrame, population: bool = False) -> list[MethodSummary]:
    """Return each method of a run in numbers, from the rows of its cells, in the order of the suite."""
    columns, methods = describe_scores(run), list_methods(run)
    own_cells = dict(iter(cells.groupby("label", sort=False)))
    summaries = []
    for method in methods:
        own = own_cells[method.label]
        scored = own[own[STRUCTURE].notna()] if STRUCTURE in own else own.iloc[:0]
        estimates = estimate_means(stack_draws(own, list(columns)), population=population)
        means = {name: one.within(column.range) for (name, column), one in zip(columns.items(), estimates, strict=True)}
        if COMPLETE in own and RANKING in own:
            bounds = own.loc[own[COMPLETE].eq(0), [RANKING, QUALITY]].notna().any()
            means |= {str(name): replace(means[str(name)], at_most=bool(found)) for name, found in bounds.items()}
        summaries.append(
            MethodSummary(
                method=method,
                counts=count_statuses(own["status"]),
                success=success_rate(own, leave_refusals_out=method.reference),
                success_answered=success_rate(own, leave_refusals_out=True),
                means=means,
                validity=count_valid_textures(own),
                validity_scored=count_valid_textures(scored),
                lattices=compare_lattices(own),
            )
        )
    return summaries


def compare_lattices(cells: pd.DataFrame) -> dict[str, Estimate]:
    """Return the errors of the lattices of some cells, see :class:`MethodSummary`.

    An output on which no lattice can be fitted, because fewer than half of its windows lie on one, is not exact.
    """
    found: dict[str, Estimate] = {}
    for name, (columns, _) in LATTICES.items():
        if f"{columns}exact" not in cells:
            continue
        exact = cells[f"{columns}exact"]
        if name == "lattice_of_output":
            exact = exact.where(exact.notna() | cells[SCORE].isna(), 0.0)
        outcomes = exact.dropna().astype(float) > 0
        for unit, column in {"px": "vector_error", "s": "vector_error_in_s"}.items():
            errors = cells[f"{columns}{column}"].dropna().astype(float)
            middle = float(errors.median()) if len(errors) else None
            found[f"{name}_{unit}"] = Estimate(middle, n=len(errors), of=len(outcomes))
        found[f"{name}_exact"] = estimate_proportion(outcomes)
    return found


def count_statuses(status: pd.Series[str]) -> dict[str, int]:
    """Return the number of ``cells``, and of those that are ``ok``, ``refused``, ``missing`` and ``failed``."""
    by_status = {name: int((status == name).sum()) for name in ("ok", "refused", "missing")}
    return {"cells": len(status), **by_status, "failed": int(status.isin(FAILED).sum())}


def summary_rows(run: Run, summaries: Sequence[MethodSummary]) -> list[SummaryRow]:
    """Return the rows: quality and perils, or without quality the success rate and other scores, then seconds."""
    if not summaries:
        return []
    refused = any(one.counts["refused"] for one in summaries)
    rates = [SummaryRow("preserved", RATE, RATE_MEANING, _known(one.success for one in summaries), rate=True)]
    if refused:
        note = RATE_MEANING.replace("Failures and refusals count", "Refusals are left out. Failures count")
        estimates = _known(one.success_answered for one in summaries)
        rates.append(SummaryRow("preserved (without refusals)", RATE, note, estimates, rate=True, variant=True))
    columns = headline_columns(run)
    means = []
    for name, column in columns.items():
        undecided = " Undecided cells are left out." if name in (SCORE, *HEADLINES) else ""
        means.append(SummaryRow(name, column, MEAN_MEANING + undecided, _known(one.means[name] for one in summaries)))
        if name == RANKING and (refused or any(one.counts["failed"] for one in summaries)):
            estimates = _known(one.means[QUALITY] for one in summaries)
            note = f"{MEAN_MEANING} Failures, refusals and undecided cells are left out."
            means.append(SummaryRow("quality (without failures)", run.columns[QUALITY], note, estimates, variant=True))
    seconds = len(means) - 1 if RANKING in columns else 0
    rates += _lattice_rows(summaries)
    blanks = [MARKS["refused"] if one.counts["refused"] == one.counts["cells"] else "–" for one in summaries]
    return [replace(row, blanks=blanks) for row in (*means[:seconds], *rates, *means[seconds:])]


def _lattice_rows(summaries: Sequence[MethodSummary]) -> list[SummaryRow]:
    """Return the rows of the errors of lattices that any method has."""
    rows = []
    for name, (_, lattice) in LATTICES.items():
        for unit in ("px", "s"):
            part = Column(f"Error of {lattice}: its worst generating vector.", unit, (0.0, math.inf), "lower")
            rows.append(_lattice_row(f"{name}_{unit}", part, "Median over outputs.", summaries))
        share = Column(f"Share of outputs on which {lattice}, is the true one to 1 px.", better="higher")
        rows.append(_lattice_row(f"{name}_exact", share, "With Wilson's 95 % interval over outputs.", summaries))
    return [row for row in rows if any(row.estimates)]


def _lattice_row(name: str, column: Column, note: str, summaries: Sequence[MethodSummary]) -> SummaryRow:
    estimates = _known(one.lattices.get(name, NO_ESTIMATE) for one in summaries)
    return SummaryRow(name, column, note, estimates, rate=name.endswith("exact"))


def other_score_rows(run: Run, summaries: Sequence[MethodSummary]) -> list[SummaryRow]:
    """Return a row of means for each further score that any method has.

    Wall time and peak memory appear once: the columns of the metric ``cost`` that repeat them are left out.
    """
    shown = {*headline_columns(run), PRESERVED, QUALITY, STRUCTURE, *(f"cost.{name}" for name in COSTS)}
    columns = describe_scores(run)
    rows = [
        SummaryRow(name, columns[name], MEAN_MEANING, _known(one.means[name] for one in summaries))
        for name in sort_headlines_first(columns)
        if name not in shown
    ]
    return [row for row in rows if any(row.estimates)]


def _known(estimates: Iterable[Estimate]) -> list[Estimate | None]:
    """Return None for each estimate that counts no texture."""
    return [estimate if estimate.n else None for estimate in estimates]


def describe_scores(run: Run) -> dict[str, Column]:
    """Return the column of every score and cost by name, and of what is derived from the quality if the run has it."""
    return {**run.columns, **(DERIVED_COLUMNS if has_quality(run) else {}), **COSTS}


def headline_columns(run: Run) -> dict[str, Column]:
    """Return the columns by which methods are compared, as far as the run has them.

    The columns of metrics that are not part of nrbench follow: their authors want to see them beside the headlines.
    """
    columns = describe_scores(run)
    names = HEADLINES if RANKING in columns else HEADLINES_WITHOUT_QUALITY
    added_metrics = {metric for metric in {name.partition(".")[0] for name in columns} if _is_added(metric)}
    added = [name for name in columns if name.partition(".")[0] in added_metrics]
    return {name: columns[name] for name in (*names, "seconds", *added) if name in columns}


def _is_added(metric: str) -> bool:
    """Return whether a metric is installed that is not part of nrbench."""
    return metric in plugins.names("metrics") and not plugins.find("metrics", metric).own


def sort_headlines_first(names: Iterable[str]) -> list[str]:
    """Return ``metric.name`` sorted so that the metrics of the headlines come first; otherwise in the given order."""
    order = {metric: i for i, metric in enumerate(HEADLINE_METRICS)}
    return sorted(names, key=lambda name: order.get(name.partition(".")[0], len(order)))
