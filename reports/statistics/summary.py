"""Each column of the comparison in numbers: counts, success rates, means and ranks."""

from __future__ import annotations

import itertools
import math
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from typing import Any

import pandas as pd

from nrbench.plugins.forms import Column
from nrbench.runs.records import Run
from nrbench.runs.store import FAILED

from .baselines import NOWHERE, NoCheat, no_cheat
from .randomness_kept import KEPT, KEPT_COLUMN, is_asked
from .statistics import Estimate, mean, mean_ranks, paired_difference, success_rate
from .verdicts import SCORE, column_label

HEADLINES = (SCORE, "randomness.variation", "randomness.repetition", "randomness.distance")
COSTS: Mapping[str, Column] = {
    "seconds": Column("Wall time of the synthesis, finding its own lattice included.", "s", (0, math.inf), "lower"),
    "peak_mib": Column("Peak memory above the idle worker.", "MiB", (0, math.inf), "lower"),
}


@dataclass(frozen=True)
class Head:
    """One column of the comparison: a method with its lattice source.

    Parameters
    ----------
    method, lattice_source
        As the cells have them.
    reference
        Whether it calibrates the scores and is never ranked.
    parameters
        All parameters of the method.
    """

    method: str
    lattice_source: str
    reference: bool
    parameters: Mapping[str, Any]

    @property
    def label(self) -> str:
        """The method, with its lattice source in parentheses."""
        return column_label(self.method, self.lattice_source)


@dataclass(frozen=True)
class Summary:
    """One column in numbers.

    Parameters
    ----------
    head
        Which column.
    counts
        Cells by ``cells, ok, refused, failed, missing``.
    success, success_answered
        Success rate with refusals counted as not preserved, and left out.
    means
        Mean over textures of every score and cost.
    ranks, ranks_answered
        Mean ranks by headline, refusals counted as the worst rank and left out; empty for a reference.
    no_cheat, no_cheat_scored
        On how many textures a reference is no cheat: of all, and of those whose regularity is scored.
    """

    head: Head
    counts: Mapping[str, int]
    success: Estimate
    success_answered: Estimate
    means: Mapping[str, Estimate]
    ranks: Mapping[str, Estimate]
    ranks_answered: Mapping[str, Estimate]
    no_cheat: NoCheat
    no_cheat_scored: NoCheat


@dataclass(frozen=True)
class Difference:
    """How much one column differs from another in one headline, over the textures that both have."""

    score: str
    first: Head
    second: Head
    estimate: Estimate


def heads(run: Run) -> list[Head]:
    """Return the columns: methods in the suite's order, then the reference rows."""
    found: dict[tuple[str, str], Head] = {}
    for record in run.cells:
        key = (record.method, record.lattice_source)
        found.setdefault(key, Head(*key, record.reference, dict(record.parameters)))
    return sorted(found.values(), key=lambda head: head.reference)


def known_columns(run: Run) -> dict[str, Column]:
    """Return every score's and cost's column by name, and that of the randomness kept where a run has it."""
    own = {KEPT: KEPT_COLUMN} if is_asked(run.columns) else {}
    return {**run.columns, **own, **COSTS}


def headlines(run: Run) -> dict[str, Column]:
    """Return the columns that methods are compared by, those that the run has."""
    known = known_columns(run)
    return {name: known[name] for name in (*HEADLINES, "seconds") if name in known}


def headlines_first(names: Iterable[str]) -> list[str]:
    """Return ``metric.name`` ordered so that the metrics of the headlines come first; otherwise as they are."""
    first = list(dict.fromkeys(name.partition(".")[0] for name in HEADLINES))
    place = {metric: i for i, metric in enumerate(first)}
    return sorted(names, key=lambda name: place.get(name.partition(".")[0], len(first)))


def summarize(run: Run, cells: pd.DataFrame) -> list[Summary]:
    """Return the summary of every column.

    Parameters
    ----------
    run
        The run.
    cells
        Its :func:`~nrbench.reports.statistics.verdicts.frame`.
    """
    contestants = cells[~cells["reference"].astype(bool)]
    ranked = {name: column.better for name, column in headlines(run).items() if column.better != "none"}
    worst = {name: mean_ranks(contestants, name, better) for name, better in ranked.items()}
    answered = {name: mean_ranks(contestants, name, better, True) for name, better in ranked.items()}
    return [_summary(run, head, cells, worst, answered) for head in heads(run)]


def _summary(
    run: Run,
    head: Head,
    cells: pd.DataFrame,
    worst: Mapping[str, Mapping[str, Estimate]],
    answered: Mapping[str, Mapping[str, Estimate]],
) -> Summary:
    own = cells[cells["column"] == head.label]
    return Summary(
        head=head,
        counts=_counts(own),
        success=success_rate(own),
        success_answered=success_rate(own, leave_refusals_out=True),
        means={name: mean(own, name) for name in known_columns(run)},
        ranks={name: by_column[head.label] for name, by_column in worst.items() if head.label in by_column},
        ranks_answered={name: by_column[head.label] for name, by_column in answered.items() if head.label in by_column},
        no_cheat=no_cheat(own),
        no_cheat_scored=no_cheat(own[own[SCORE].notna()]) if SCORE in own else NOWHERE,
    )


def _counts(cells: pd.DataFrame) -> dict[str, int]:
    status = cells["status"]
    by_status = {name: int((status == name).sum()) for name in ("ok", "refused", "missing")}
    return {"cells": len(cells), **by_status, "failed": int(status.isin(FAILED).sum())}


def differences(run: Run, cells: pd.DataFrame) -> list[Difference]:
    """Return the paired differences of every two columns of which the first is no reference.

    In every headline, and in the randomness kept.
    """
    pairs = [(a, b) for a, b in itertools.combinations(heads(run), 2) if not a.reference]
    own = {head.label: cells[cells["column"] == head.label] for head in heads(run)}
    return [
        Difference(name, a, b, paired_difference(own[a.label], own[b.label], name))
        for name in (*headlines(run), *({KEPT} & set(known_columns(run))))
        for a, b in pairs
    ]
