"""Compare an earlier run with this one: which scores changed, by how much, and whether by more than noise."""

from __future__ import annotations

import json
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from textwrap import fill
from typing import Any, ClassVar, Literal

import numpy as np
import pandas as pd

from nrbench.errors import BadInput, strip_control
from nrbench.plugins.forms import Column
from nrbench.plugins.parameters import nearest
from nrbench.runs.records import Run
from nrbench.storage import write_text

from .markdown import escape_markdown
from .statistics.estimates import Estimate, means_over_textures, paired_differences
from .statistics.format import format_interval, format_number, format_signed, pluralize
from .statistics.summaries import count_statuses, describe_scores, headline_columns
from .statistics.verdicts import method_label, tabulate_cells

State = Literal["same", "better", "worse", "changed", "noise", "unknown"]
WORDS: Mapping[State, str] = {
    "same": "the same",
    "better": "better",
    "worse": "worse",
    "changed": "changed",
    "noise": "within noise",
    "unknown": "too few textures",
}
PRESERVED = "preserved"
"""The score that is 1 where the lattice is preserved, and 0 where it is lost or the cell failed or was refused."""
COSTS = ("seconds", "peak_mib")
"""Costs of a method. They depend on the machine, so they are no reason to fail unless they are named."""
HEADS = ("method", "score", "first", "second", "difference", "textures", "change")
"""The headings of the table of changes."""
LEGEND = (
    "Differences are second minus first, paired by texture and draw: means over the textures that both runs have, with "
    "95 % intervals over these textures. Better or worse: the interval excludes zero. One test in twenty does so by "
    "chance."
)


@dataclass(frozen=True)
class Changes:
    """What changed since another run: ``changes.md`` and ``changes.json``.

    For each method that both runs have, each score is compared on the textures that both runs have. Cells are paired by
    texture and draw. The table holds both means, the mean difference with its 95 % interval over textures, and whether
    the score is better, worse, the same, or moved within noise. ``nrbench compare`` prints the same table.

    Parameters
    ----------
    baseline
        The directory of the other run. Nothing is written without it.
    columns
        The scores; empty for the headlines, the share of preserved lattices and the seconds.
    """

    baseline: Path | None = None
    columns: tuple[str, ...] = ()

    version: ClassVar[str] = "1"
    folder: ClassVar[str] = "report"

    def write(self, run: Run, directory: Path) -> list[Path]:
        """Write the files and return their paths; none without a baseline."""
        if self.baseline is None:
            return []
        changes = self.compare(run)
        texts = {"changes.md": self.markdown(changes), "changes.json": json.dumps(changes.as_dict(), indent=1) + "\n"}
        for name, text in texts.items():
            write_text(directory / name, text)
        return [directory / name for name in texts]

    def compare(self, run: Run) -> RunChanges:
        """Return the changes from the baseline to a run.

        Raises
        ------
        BadInput
            If the baseline is no run, or neither run has a score that was named.
        """
        baseline = Run(self.baseline or Path())
        _ = baseline.info
        return compare_runs(baseline, run, self.columns)

    def text(self, changes: RunChanges) -> str:
        """Return the changes as a plain table with aligned columns."""
        rows = [HEADS, *(change.cells for change in changes.changes)]
        widths = [max(map(len, column)) for column in zip(*rows, strict=True)]
        lines = ["  ".join(map(str.ljust, row, widths)).rstrip() for row in rows]
        lines.insert(1, "─" * max(map(len, lines)))
        title = f"{changes.first.root} -> {changes.second.root}"
        return "\n".join([title, "", *lines, "", fill(LEGEND, 110), *map(strip_control, changes.notes)])

    def markdown(self, changes: RunChanges) -> str:
        """Return the changes as a Markdown table for a pull request."""
        rows = [HEADS, ["---"] * len(HEADS), *([*map(escape_markdown, change.cells)] for change in changes.changes)]
        table = [f"| {' | '.join(row)} |" for row in rows]
        title = f"**{escape_markdown(str(changes.first.root))} → {escape_markdown(str(changes.second.root))}**"
        notes = [f"- {escape_markdown(line)}" for line in changes.notes]
        return "\n".join([title, "", *table, "", LEGEND, *(["", *notes] if notes else [])]) + "\n"


@dataclass(frozen=True)
class Change:
    """How one score of one method changed.

    Parameters
    ----------
    method
        The method with its lattice source.
    reference
        Whether it is a reference method.
    score
        Name of the score.
    before, after
        Means over the textures of both runs that have a value in each.
    difference
        The mean of ``after - before``, paired.
    state
        ``same``: no value changed. ``better``, ``worse``, or ``changed`` where no way is better: the interval excludes
        zero. ``noise``: it does not. ``unknown``: fewer than two textures have a value in both runs.
    """

    method: str
    reference: bool
    score: str
    before: float | None
    after: float | None
    difference: Estimate
    state: State

    def as_dict(self) -> dict[str, Any]:
        """Return the change for JSON."""
        difference = self.difference.columns("difference", parts=("low", "high"))
        return {**vars(self), **difference, "textures": self.difference.n}

    @property
    def cells(self) -> list[str]:
        """The change as the texts of a table's row."""
        gap = f"{format_signed(self.difference.value)} {format_interval(self.difference)}".strip()
        numbers = (format_number(self.before), format_number(self.after))
        return [self.method, self.score, *numbers, gap, str(self.difference.n), WORDS[self.state]]


@dataclass(frozen=True)
class RunChanges:
    """The changes between two runs.

    Parameters
    ----------
    first, second
        The two runs.
    changes
        One for each method of both runs and each score.
    means
        Mean over textures of each score of the second run, by method without reference methods, and score.
    only_first, only_second
        Methods that only one of the runs has.
    counts
        For each method of both runs how its cells ended: ``ok``, ``refused``, ``missing`` and ``failed``, in the first
        and in the second run.
    pairs, equal_samples
        Number of cells of the second run that the first one has, too, and how many of them have the same sample.
    named
        Whether the caller chose the scores.
    """

    first: Run
    second: Run
    changes: Sequence[Change]
    means: Mapping[str, Mapping[str, float]]
    only_first: Sequence[str]
    only_second: Sequence[str]
    counts: Mapping[str, tuple[Mapping[str, int], Mapping[str, int]]]
    pairs: int
    equal_samples: int
    named: bool

    @property
    def worse(self) -> list[Change]:
        """The changes for the worse of methods that are no references; costs only if the caller named them."""
        counted = (change for change in self.changes if self.named or change.score not in COSTS)
        return [change for change in counted if change.state == "worse" and not change.reference]

    @property
    def newly_failed(self) -> list[str]:
        """The methods of which more cells fail or are refused in the second run."""

        def bad(counts: Mapping[str, int]) -> int:
            return counts["refused"] + counts["failed"] + counts["missing"]

        return [method for method, (before, after) in self.counts.items() if bad(after) > bad(before)]

    def below(self, score: str, limit: float) -> dict[str, float]:
        """Return the methods of the second run whose mean of a score is below a limit, with their means.

        Raises
        ------
        BadInput
            If the second run has no such score.
        """
        if score not in self.means:
            raise BadInput(f"--fail-under {score}: the run has no such score{nearest(score, self.means)}")
        return {method: value for method, value in self.means[score].items() if not value >= limit}

    @property
    def notes(self) -> list[str]:
        """What the table does not say: methods of one run, failures, other samples."""
        alone = ((self.first, self.only_first), (self.second, self.only_second))
        lines = [f"only in {run.root}: {', '.join(methods)}" for run, methods in alone if methods]
        for method, (before, after) in self.counts.items():
            if before != after:
                lines.append(f"{method}: {_count_text(before)} in the first run, {_count_text(after)} in the second")
        if self.equal_samples < self.pairs:
            other = self.pairs - self.equal_samples
            lines.append(f"{pluralize(other, 'cell')} of {self.pairs} have another sample, so their pairs scatter more")
        return [*lines, *self.obstacles]

    @property
    def obstacles(self) -> list[str]:
        """Why the runs cannot be compared: they share no cell, or their scores mean different things."""
        lines = []
        if not self.pairs:
            lines.append("the runs have no method on the same texture and draw in common: there is nothing to compare")
        first, second = (run.info.get("results_version") for run in (self.first, self.second))
        if first != second:
            lines.append(
                f"the runs were made by results versions {first} and {second}, whose scores are not comparable"
            )
        return lines

    def as_dict(self) -> dict[str, Any]:
        """Return all of it for JSON."""
        return {
            "first": str(self.first.root),
            "second": str(self.second.root),
            "changes": [change.as_dict() for change in self.changes],
            "only_first": list(self.only_first),
            "only_second": list(self.only_second),
            "cells": {method: {"first": a, "second": b} for method, (a, b) in self.counts.items()},
            "pairs": self.pairs,
            "equal_samples": self.equal_samples,
            "obstacles": self.obstacles,
        }


def compare_runs(first: Run, second: Run, scores: Sequence[str] = ()) -> RunChanges:
    """Compare the scores of two runs, method by method.

    Parameters
    ----------
    first, second
        The runs. The second one is usually the newer.
    scores
        Names of columns, as in ``cells.csv``; empty for the headlines, the share of preserved lattices and the seconds.

    Raises
    ------
    BadInput
        For a score that neither run has.
    """
    headlines = headline_columns(second) | headline_columns(first)
    columns = describe_scores(first) | describe_scores(second) | headlines
    columns[PRESERVED] = Column("Whether the lattice is preserved; failures and refusals count as no.", better="higher")
    chosen = list(scores) or [name for name in headlines if name != "seconds"] + [PRESERVED, "seconds"]
    if unknown := [name for name in chosen if name not in columns]:
        raise BadInput(f"score {unknown[0]!r} is not known{nearest(unknown[0], columns)}")
    before, after = ({str(label): rows for label, rows in _tabulate(run, chosen)} for run in (first, second))
    common = [label for label in before if label in after]
    samples, others = (_sample_hashes(run) for run in (first, second))
    both = samples.keys() & others.keys()
    contestants = {label: rows for label, rows in after.items() if not rows["reference"].any()}
    means = {label: means_over_textures(rows, chosen) for label, rows in contestants.items()}
    return RunChanges(
        first,
        second,
        [change for label in common for change in _changes(label, before[label], after[label], columns, chosen)],
        {name: {label: _number(means[label][name].value) for label in means} for name in chosen},
        [label for label in before if label not in after],
        [label for label in after if label not in before],
        {label: (_count(before[label]), _count(after[label])) for label in common},
        len(both),
        sum(samples[pair] == others[pair] for pair in both),
        bool(scores),
    )


def _tabulate(run: Run, scores: Sequence[str]) -> Any:
    """Return the cells by method, with the preserved lattices as numbers, and NaN for scores that the run lacks."""
    table = tabulate_cells(run)
    known = table["verdict"].map({"preserved": 1.0, "lost": 0.0, "failed": 0.0, "refused": 0.0})
    table[PRESERVED] = known.astype(float).where(table["applicable"].astype(bool))
    for name in scores:
        if name not in table:
            table[name] = np.nan
    return table.groupby("label", sort=False)


def _changes(
    label: str, before: pd.DataFrame, after: pd.DataFrame, columns: Mapping[str, Column], scores: Sequence[str]
) -> list[Change]:
    """Return the change of each score of one method that has a value in any of the runs."""
    reference = bool(before["reference"].any() or after["reference"].any())
    both = before.merge(after, on=["texture", "replicate"], suffixes=("_before", "_after"))
    differences = paired_differences(after, before, scores)
    merits = paired_differences(_merit(after, scores, columns), _merit(before, scores, columns), scores)
    found = []
    for name in scores:
        if before[name].isna().all() and after[name].isna().all():
            continue
        pair = both[["texture", f"{name}_before", f"{name}_after"]].dropna()
        means = pair.groupby("texture", sort=False).mean().mean()
        equal = len(pair) > 0 and bool((pair[f"{name}_before"] == pair[f"{name}_after"]).all())
        state = "same" if equal else _state(merits[name], columns[name])
        values = [None if math.isnan(value) else float(value) for value in means]
        found.append(Change(label, reference, name, values[0], values[1], differences[name], state))
    return found


def _merit(table: pd.DataFrame, scores: Sequence[str], columns: Mapping[str, Column]) -> pd.DataFrame:
    """Return the scores so that higher is better: two-sided ones as their distance from 1, below zero."""
    ways = {"lower": lambda values: -values, "one": lambda values: -(values - 1).abs()}
    return table.assign(**{name: ways[way](table[name]) for name in scores if (way := columns[name].better) in ways})


def _state(merit: Estimate, column: Column) -> State:
    if merit.excludes_zero is None or merit.value is None:
        return "unknown"
    if not merit.excludes_zero:
        return "noise"
    if column.better == "none":
        return "changed"
    return "better" if merit.value > 0 else "worse"


def _number(value: float | None) -> float:
    return math.nan if value is None else value


def _count(cells: pd.DataFrame) -> dict[str, int]:
    return {word: count for word, count in count_statuses(cells["status"]).items() if word != "cells"}


def _count_text(counts: Mapping[str, int]) -> str:
    return ", ".join(f"{count} {word}" for word, count in counts.items() if count) or "no cells"


def _sample_hashes(run: Run) -> dict[tuple[str, str, int], str]:
    return {
        (method_label(record.method, record.lattice_source), record.texture, record.replicate): record.cell.sample_hash
        for record in run.cells
    }
