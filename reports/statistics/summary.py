"""Summarize each method of a run in numbers: counts, success rates, means, ranks and paired differences."""

from __future__ import annotations

import itertools
import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import pandas as pd

from nrbench.plugins.forms import Column
from nrbench.runs.records import Run
from nrbench.runs.store import FAILED

from .estimates import Estimate, mean_ranks, means_over_textures, paired_differences, success_rate
from .format import describe_column, format_count, format_interval, format_number, format_percent, format_successes
from .verdicts import (
    PRESERVED,
    RANDOMNESS_KEPT,
    RANDOMNESS_KEPT_COLUMN,
    SCORE,
    BaselineValidity,
    count_valid_textures,
    has_randomness,
    method_label,
)

HEADLINES = (SCORE, "randomness.variation", "randomness.repetition", "randomness.distance")
COSTS: Mapping[str, Column] = {
    "seconds": Column("Wall time of the synthesis, including its own lattice detection.", "s", (0, math.inf), "lower"),
    "peak_mib": Column("Peak memory above the idle worker.", "MiB", (0, math.inf), "lower"),
}
RATE_MEANING = (
    "Share of textures whose lattice is preserved, with Wilson's 95 % interval over textures. A texture counts as the "
    "mean over its replicates. Failures and refusals count as not preserved. Undecided cells are left out."
)
MEAN_MEANING = "Mean over textures, with a 95 % bootstrap interval. A texture counts as the mean over its replicates."
RANK_MEANING = (
    "Mean rank among the methods over textures (1 is best), with a 95 % bootstrap interval. A method takes the worst "
    "rank if it fails, if it refuses, or if it has no score because the lattice is lost. Reference rows are not ranked."
)


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
        Success rate; refusals count as not preserved, or are left out.
    means
        Mean over textures of every score and cost.
    ranks, ranks_answered
        Mean rank by headline; refusals take the worst rank, or are left out. Empty for a reference.
    validity, validity_scored
        On how many textures a baseline is valid: of all, and of those whose regularity is scored.
    """

    method: Method
    counts: Mapping[str, int]
    success: Estimate
    success_answered: Estimate
    means: Mapping[str, Estimate]
    ranks: Mapping[str, Estimate]
    ranks_answered: Mapping[str, Estimate]
    validity: BaselineValidity
    validity_scored: BaselineValidity


@dataclass(frozen=True)
class PairedDifference:
    """The mean difference of two methods in one score, over the textures that both have."""

    score: str
    first: Method
    second: Method
    estimate: Estimate


@dataclass(frozen=True)
class SummaryRow:
    """A row below the comparison: one estimate for each method.

    Parameters
    ----------
    name, meaning
        Its name and its description.
    estimates
        One for each method; None if there is none.
    rate
        Whether it is a success rate.
    """

    name: str
    meaning: str
    estimates: Sequence[Estimate | None]
    rate: bool = False

    @property
    def values(self) -> list[str]:
        """The values as text; a dash if there is none."""
        text = format_percent if self.rate else format_number
        return [text(estimate.value) if estimate else "–" for estimate in self.estimates]

    @property
    def intervals(self) -> list[str]:
        """The intervals as text; empty if there is none."""
        return [format_interval(estimate, self.rate) if estimate else "" for estimate in self.estimates]

    @property
    def counts(self) -> list[str]:
        """How many textures succeed for a rate; how many are counted for other rows."""
        text = format_successes if self.rate else format_count
        return [text(estimate) if estimate else "" for estimate in self.estimates]


def list_methods(run: Run) -> list[Method]:
    """Return the methods in the order of the suite, then the reference methods."""
    methods: dict[tuple[str, str], Method] = {}
    for record in run.cells:
        key = (record.method, record.lattice_source)
        methods.setdefault(key, Method(*key, record.reference, dict(record.parameters)))
    return sorted(methods.values(), key=lambda method: method.reference)


def describe_scores(run: Run) -> dict[str, Column]:
    """Return the column of every score and cost by name, and of the randomness kept if the run has its scores."""
    own = {RANDOMNESS_KEPT: RANDOMNESS_KEPT_COLUMN} if has_randomness(run.columns) else {}
    return {**run.columns, **own, **COSTS}


def headline_columns(run: Run) -> dict[str, Column]:
    """Return the columns by which methods are compared, as far as the run has them."""
    columns = describe_scores(run)
    return {name: columns[name] for name in (*HEADLINES, "seconds") if name in columns}


def sort_headlines_first(names: Iterable[str]) -> list[str]:
    """Return ``metric.name`` sorted so that the metrics of the headlines come first; otherwise in the given order."""
    first = list(dict.fromkeys(name.partition(".")[0] for name in HEADLINES))
    order = {metric: i for i, metric in enumerate(first)}
    return sorted(names, key=lambda name: order.get(name.partition(".")[0], len(first)))


def summarize_methods(run: Run, cells: pd.DataFrame) -> list[MethodSummary]:
    """Return the summary of every method.

    Parameters
    ----------
    run
        The run.
    cells
        Its :func:`~nrbench.reports.statistics.verdicts.tabulate_cells`.
    """
    contestants = cells[~cells["reference"].astype(bool)]
    ranked = {name: column.better for name, column in headline_columns(run).items() if column.better != "none"}
    ranks, answered = (
        {name: mean_ranks(contestants, name, better, leave_out) for name, better in ranked.items()}
        for leave_out in (False, True)
    )
    summaries = []
    for method in list_methods(run):
        own = cells[cells["label"] == method.label]
        scored = own[own[SCORE].notna()] if SCORE in own else own.iloc[:0]
        summaries.append(
            MethodSummary(
                method=method,
                counts=_count_statuses(own["status"]),
                success=success_rate(own),
                success_answered=success_rate(own, leave_refusals_out=True),
                means=means_over_textures(own, list(describe_scores(run))),
                ranks={name: by_label[method.label] for name, by_label in ranks.items() if method.label in by_label},
                ranks_answered={
                    name: by_label[method.label] for name, by_label in answered.items() if method.label in by_label
                },
                validity=count_valid_textures(own),
                validity_scored=count_valid_textures(scored),
            )
        )
    return summaries


def _count_statuses(status: pd.Series[str]) -> dict[str, int]:
    by_status = {name: int((status == name).sum()) for name in ("ok", "refused", "missing")}
    return {"cells": len(status), **by_status, "failed": int(status.isin(FAILED).sum())}


def compare_pairs(run: Run, cells: pd.DataFrame) -> list[PairedDifference]:
    """Return the paired differences in every headline and in the randomness kept.

    The pairs are all pairs of methods of which the first is no reference.
    """
    pairs = [(a, b) for a, b in itertools.combinations(list_methods(run), 2) if not a.reference]
    own = dict(iter(cells.groupby("label", sort=False)))
    names = [*headline_columns(run), *({RANDOMNESS_KEPT} & set(describe_scores(run)))]
    estimates = [paired_differences(own[a.label], own[b.label], names) for a, b in pairs]
    return [
        PairedDifference(name, a, b, by_name[name])
        for name in names
        for (a, b), by_name in zip(pairs, estimates, strict=True)
    ]


def summary_rows(run: Run, summaries: Sequence[MethodSummary]) -> list[SummaryRow]:
    """Return the rows below the comparison: success rates, means and ranks; none if the run has no methods."""
    if not summaries:
        return []
    rates = [_row("preserved", RATE_MEANING, [one.success for one in summaries], rate=True)]
    if any(one.counts["refused"] for one in summaries):
        meaning = RATE_MEANING.replace("Failures and refusals count", "Refusals are left out. Failures count")
        rates.append(_row("… refusals left out", meaning, [one.success_answered for one in summaries], rate=True))
    means = []
    for name, column in headline_columns(run).items():
        undecided = " Undecided cells are left out." if name == SCORE else ""
        meaning = f"{describe_column(column)}\n{MEAN_MEANING}{undecided}"
        means.append(_row(name, meaning, [one.means[name] for one in summaries]))
    if sum(not one.method.reference for one in summaries) < 2:
        return [*rates, *means]
    ranked = [name for name, column in headline_columns(run).items() if column.better != "none"]
    ranks = [_row(f"rank: {name}", RANK_MEANING, [one.ranks.get(name) for one in summaries]) for name in ranked]
    return [*rates, *means, *ranks]


def other_score_rows(run: Run, summaries: Sequence[MethodSummary]) -> list[SummaryRow]:
    """Return a row of means for each further score that any method has.

    Wall time and peak memory appear once: the columns of the metric ``cost`` that repeat them are left out.
    """
    shown = {*headline_columns(run), PRESERVED, RANDOMNESS_KEPT, *(f"cost.{name}" for name in COSTS)}
    columns = describe_scores(run)
    rows = [
        _row(name, f"{describe_column(columns[name])}\n{MEAN_MEANING}", [one.means[name] for one in summaries])
        for name in sort_headlines_first(columns)
        if name not in shown
    ]
    return [row for row in rows if any(row.estimates)]


def _row(name: str, meaning: str, estimates: Sequence[Estimate | None], rate: bool = False) -> SummaryRow:
    return SummaryRow(name, meaning, [estimate if estimate and estimate.n else None for estimate in estimates], rate)
