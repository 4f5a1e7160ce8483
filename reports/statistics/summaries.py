"""Summarize each method of a run: its means over textures, its rank, and its point in the perils plane."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any, ClassVar

import pandas as pd

from nrbench import plugins
from nrbench.plugins.forms import Column
from nrbench.runs.records import CellRecord, Run
from nrbench.runs.store import FAILED

from .estimates import NO_ESTIMATE, Estimate, estimate_means, estimate_proportion, stack_draws, success_rate
from .format import (
    describe_column,
    format_count,
    format_interval,
    format_number,
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
    RANDOMNESS,
    RANKING,
    SCORE,
    STRUCTURE,
    BaselineValidity,
    count_silences,
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
LATTICE_ERRORS: Mapping[str, str] = {"px": "vector_error", "s": "vector_error_in_s", "drift": "drift"}
"""The errors of a lattice, by the names of their rows; the last one only of the lattice that the method used."""
_RATES = ("preserved", "preserved_refusals_left_out", *(f"{name}_exact" for name in LATTICES))
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
    plugin, preset
        The name of its plugin, and of the preset that was chosen.
    """

    name: str
    lattice_source: str
    reference: bool
    parameters: Mapping[str, Any]
    plugin: str
    preset: str

    kind: ClassVar[str] = "plain method"

    @property
    def label(self) -> str:
        """The name, with the lattice source in parentheses."""
        return method_label(self.name, self.lattice_source)

    @property
    def text(self) -> str:
        """The label, as a cell of a table."""
        return self.label


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
        For each of :data:`LATTICES` the medians over outputs of :data:`LATTICE_ERRORS`, and the share that are exact.
    silences
        On how many outputs a peril has no score, by the peril, and by ``no peril`` or ``cannot tell``.
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
    silences: Mapping[tuple[str, str], int] = field(default_factory=dict)
    rank: int | None = None
    leading: bool = False

    kind: ClassVar[str] = "method"

    @property
    def label(self) -> str:
        """The label of the method."""
        return self.method.label

    @property
    def at_most(self) -> bool:
        """Whether the mean quality is an upper bound."""
        return RANKING in self.means and self.means[RANKING].at_most

    @property
    def silence_words(self) -> str:
        """On how many outputs a peril has no score; empty if on none."""
        counts = ((name.rpartition(".")[2], word, n) for (name, word), n in self.silences.items())
        return "; ".join(f"{peril}: {word} on {n} output{'s' * (n > 1)}" for peril, word, n in counts)

    def blank(self, name: str) -> str:
        """Return the text in the place of a mean that counts no texture."""
        return "no peril" if (name, "no peril") in self.silences else "–"

    @property
    def all_means(self) -> dict[str, Estimate]:
        """The success rates, the errors of lattices, and the means, by the names of their columns."""
        rates = {"preserved": self.success, "preserved_refusals_left_out": self.success_answered}
        return {**rates, **self.lattices, **self.means}


@dataclass(frozen=True)
class Number:
    """One number of a method, as tables print it.

    Parameters
    ----------
    estimate
        The estimate; None if there is none.
    rate
        Whether it is a success rate.
    share
        Whether its range is [0, 1]: then values below 0.001 are printed as 0.
    blank
        The text where there is no number: a dash, or N/A for a method that refused every cell.
    """

    estimate: Estimate | None
    rate: bool = False
    share: bool = False
    blank: str = "–"

    kind: ClassVar[str] = "number"

    @property
    def shown(self) -> Estimate:
        """The estimate with small values rounded."""
        one = self.estimate or NO_ESTIMATE
        return round_small(one) if self.share else one

    @property
    def text(self) -> str:
        """The value."""
        return format_value(self.shown, self.rate) if self.estimate else self.blank

    @property
    def interval(self) -> str:
        """The interval as ``[low, high]``; empty if there is none."""
        return format_interval(self.shown, self.rate)

    @property
    def count(self) -> str:
        """How many textures succeed for a rate; how many are counted for another number."""
        text = format_successes if self.rate else format_count
        return text(self.estimate) if self.estimate else ""

    @property
    def partial(self) -> bool:
        """Whether the count belongs beside the number: for a rate, and where textures are left out."""
        return self.shown.value is not None and (self.rate or self.shown.n < self.shown.of)


@dataclass(frozen=True)
class SummaryRow:
    """One number for each method.

    Parameters
    ----------
    name, column
        Its name, and the column that describes it.
    note
        How it is computed from the cells.
    numbers
        One for each method, by its label.
    rate
        Whether it is a success rate.
    variant
        Whether it is the number of the row before, computed without some of the cells.
    """

    name: str
    column: Column
    note: str
    numbers: Mapping[str, Number]
    rate: bool = False
    variant: bool = False

    kind: ClassVar[str] = "score"

    @property
    def title(self) -> str:
        """The name, without the metric for the four perils, and in words for the errors of lattices."""
        words = self.name.replace("_", " ") if self.name.startswith(tuple(LATTICES)) else self.name
        return words.rpartition(".")[2] if self.name in PERILS else words

    @property
    def meaning(self) -> str:
        """The description of the column, and how the number is computed."""
        return f"{describe_column(self.column)}\n{self.note}"


@dataclass(frozen=True)
class PerilsPoint:
    """One method with its lattice source in the perils plane.

    Parameters
    ----------
    method
        The method.
    structure
        Mean over textures of the smallest of ``quality.regularity``, ``quality.integrity`` and
        ``quality.appearance``: the horizontal coordinate.
    randomness
        Mean of ``quality.randomness`` over textures: the vertical coordinate. It rests only on the textures on which
        randomness is scored. It is not scored where the lattice is lost.
    validity
        On how many of the textures with a quality a baseline is valid.
    at_most, silences
        Whether the mean quality is an upper bound, and on how many outputs a peril is no peril or cannot be told.
    """

    method: Method
    structure: Estimate
    randomness: Estimate
    validity: BaselineValidity
    at_most: bool = False
    silences: str = ""

    @property
    def has_height(self) -> bool:
        """Whether the randomness is scored on any texture."""
        return self.randomness.value is not None

    @property
    def rests_on(self) -> str:
        """``" [k of n]"`` if randomness is scored on k of the n textures with a quality; empty if on all."""
        fewer = self.has_height and self.randomness.n < self.structure.n
        return f" [{self.randomness.n} of {self.structure.n}]" if fewer else ""

    @property
    def words(self) -> str:
        """The point in one sentence."""
        randomness = f"{format_number(self.randomness.value)} {format_interval(self.randomness)}"
        height = f"{randomness} (on {self.randomness.n} of {self.structure.n})" if self.has_height else "not scored"
        across = f"{format_number(self.structure.value)} {format_interval(self.structure)}"
        valid = f"; {self.validity.words}" if self.validity.n else ""
        silences = f"; {self.silences}" if self.silences else ""
        bound = "; the quality is an upper bound" if self.at_most else ""
        return f"{self.method.label}: in place, whole and alike {across}, randomness {height}{valid}{silences}{bound}"


def perils_points(summaries: Sequence[MethodSummary]) -> list[PerilsPoint]:
    """Return the point of every method that has a quality, in the order of the summaries."""
    points = [
        PerilsPoint(
            one.method, one.means[STRUCTURE], one.means[RANDOMNESS], one.validity_scored, one.at_most, one.silence_words
        )
        for one in summaries
        if STRUCTURE in one.means
    ]
    return [point for point in points if point.structure.value is not None]


def method_of(record: CellRecord) -> Method:
    """Return the method of a cell."""
    what = (record.method, record.lattice_source, record.reference, record.parameters)
    return Method(*what, record.cell.method, record.cell.preset)


def summarize_methods(run: Run, cells: pd.DataFrame, population: bool = False) -> list[MethodSummary]:
    """Return each method of a run in numbers, from the rows of its cells: in the suite's order, references last."""
    columns = describe_scores(run)
    by_label = dict(iter(cells.groupby("label", sort=False)))
    by_method: dict[str, list[CellRecord]] = {}
    for record in run.cells:
        by_method.setdefault(method_label(record.method, record.lattice_source), []).append(record)
    methods = (method_of(records[0]) for records in by_method.values())
    summaries = []
    for method in sorted(methods, key=lambda method: method.reference):
        rows = by_label[method.label]
        scored = rows[rows[STRUCTURE].notna()] if STRUCTURE in rows else rows.iloc[:0]
        estimates = estimate_means(stack_draws(rows, list(columns)), population=population)
        means = {name: one.within(column.range) for (name, column), one in zip(columns.items(), estimates, strict=True)}
        if COMPLETE in rows and RANKING in rows:
            bounds = rows.loc[rows[COMPLETE].eq(0), [RANKING, QUALITY]].notna().any()
            means |= {str(name): replace(means[str(name)], at_most=bool(found)) for name, found in bounds.items()}
        summaries.append(
            MethodSummary(
                method=method,
                counts=count_statuses(rows["status"]),
                success=success_rate(rows, leave_refusals_out=method.reference),
                success_answered=success_rate(rows, leave_refusals_out=True),
                means=means,
                validity=count_valid_textures(rows),
                validity_scored=count_valid_textures(scored),
                lattices=compare_lattices(rows),
                silences=count_silences(by_method[method.label]),
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
        for unit, column in LATTICE_ERRORS.items():
            if f"{columns}{column}" not in cells:
                continue
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
    rates = [_row("preserved", RATE, RATE_MEANING, summaries)]
    if refused:
        note = RATE_MEANING.replace("Failures and refusals count", "Refusals are left out. Failures count")
        answered = _row("preserved_refusals_left_out", RATE, note, summaries)
        rates.append(replace(answered, name="preserved (without refusals)", variant=True))
    columns = headline_columns(run)
    means = []
    for name, column in columns.items():
        undecided = " Undecided cells are left out." if name in (SCORE, *HEADLINES) else ""
        means.append(_row(name, column, MEAN_MEANING + undecided, summaries))
        if name == RANKING and (refused or any(one.counts["failed"] for one in summaries)):
            note = f"{MEAN_MEANING} Failures, refusals and undecided cells are left out."
            answered = _row(QUALITY, run.columns[QUALITY], note, summaries)
            means.append(replace(answered, name="quality (without failures)", variant=True))
    for name, (_, lattice) in LATTICES.items():
        error = Column(f"Error of {lattice}: its worst generating vector.", "", (0.0, math.inf), "lower")
        drift = f"Drift of {lattice}: its distance from the true one at a corner of the output if both meet at another."
        errors = {unit: replace(error, unit=unit) for unit in ("px", "s")} | {"drift": Column(drift, "px", error.range)}
        share = Column(f"Share of outputs on which {lattice}, is the true one to 1 px.", better="higher")
        lines = [
            *(_row(f"{name}_{unit}", errors[unit], "Median over outputs.", summaries) for unit in LATTICE_ERRORS),
            _row(f"{name}_exact", share, "With Wilson's 95 % interval over outputs.", summaries),
        ]
        rates += [row for row in lines if any(number.estimate for number in row.numbers.values())]
    seconds = len(means) - 1 if RANKING in columns else 0
    return [*means[:seconds], *rates, *means[seconds:]]


def other_score_rows(run: Run, summaries: Sequence[MethodSummary]) -> list[SummaryRow]:
    """Return a row of means for each further score that any method has.

    Wall time and peak memory appear once: the columns of the metric ``cost`` that repeat them are left out.
    """
    shown = {*headline_columns(run), PRESERVED, QUALITY, STRUCTURE, *(f"cost.{name}" for name in COSTS)}
    columns = describe_scores(run)
    names = [name for name in sort_headlines_first(columns) if name not in shown]
    rows = [_row(name, columns[name], MEAN_MEANING, summaries, with_refusals=False) for name in names]
    return [row for row in rows if any(number.estimate for number in row.numbers.values())]


def _row(
    name: str, column: Column, note: str, summaries: Sequence[MethodSummary], with_refusals: bool = True
) -> SummaryRow:
    """Return a number of all methods, by the name that it has in :attr:`MethodSummary.all_means`.

    A number that counts no texture is left out. In its place stands N/A, ``with_refusals``, for a method that refused
    every cell, and else a dash.
    """
    rate = name in _RATES
    numbers = {}
    for one in summaries:
        estimate = one.all_means.get(name, NO_ESTIMATE)
        refused = with_refusals and one.counts["refused"] == one.counts["cells"]
        blank = MARKS["refused"] if refused else one.blank(name)
        numbers[one.label] = Number(estimate if estimate.n else None, rate, column.range == (0.0, 1.0), blank)
    return SummaryRow(name, column, note, numbers, rate)


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
    return metric in plugins.names("metrics") and not plugins.find("metrics", metric).built_in


def sort_headlines_first(names: Iterable[str]) -> list[str]:
    """Return ``metric.name`` sorted so that the metrics of the headlines come first; otherwise in the given order."""
    order = {metric: i for i, metric in enumerate(HEADLINE_METRICS)}
    return sorted(names, key=lambda name: order.get(name.partition(".")[0], len(order)))
