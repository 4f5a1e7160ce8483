"""Compare an earlier run with this one: which scores changed, by how much, and whether by more than noise."""

from __future__ import annotations

import html
import json
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from textwrap import fill
from typing import Any, ClassVar, Literal

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from nrbench.errors import BadInput, strip_control
from nrbench.plugins.forms import Column
from nrbench.plugins.parameters import nearest
from nrbench.runs.records import Run
from nrbench.storage import write_files

from .markdown import escape_markdown, pipe_table
from .statistics.estimates import (
    ALPHA,
    FEWEST,
    POWER,
    Estimate,
    detectable_losses,
    estimate_means,
    mean_of_known,
    p_values_by_flips,
    stack_draws,
)
from .statistics.format import format_interval, format_number, format_signed, pluralize
from .statistics.summaries import count_statuses, describe_scores, headline_columns
from .statistics.verdicts import tabulate_cells

Floats = NDArray[np.float64]
State = Literal["same", "better", "worse", "changed", "noise", "unknown"]
WORDS: Mapping[State, str] = {
    "same": "the same",
    "better": "better",
    "worse": "worse",
    "changed": "changed",
    "noise": "within draws",
    "unknown": "too few textures",
}
PRESERVED = "preserved"
"""The score that is 1 where the lattice is preserved, and 0 where it is lost or the cell failed or was refused."""
COSTS = ("seconds", "peak_mib")
"""Costs of a method. They depend on the machine, so they are no reason to fail unless they are named."""
HEADS = ("method", "score", "first", "second", "difference", "detectable", "textures", "change")
"""The headings of the table of changes."""
FAILED = "failed"
"""The score that is 1 where a cell failed, was refused or is missing, and 0 where it has an output."""
LEGEND = (
    "Differences are second minus first: means over the textures that both runs have, with 95 % intervals over draws "
    "where these carry one. Better or worse: by more than other draws of the textures would move it, tested by sign "
    f"flips within textures, for all methods and scores at once, at {100 * ALPHA:g} % for the whole table. It takes "
    f"{FEWEST} textures. Detectable: the loss that such a comparison finds in {100 * POWER:g} % of all cases. It is "
    "smaller with more replicates or textures, or fewer columns."
)


@dataclass(frozen=True)
class Changes:
    """What changed since another run: ``changes.md`` and ``changes.json``.

    For each method that both runs have, each score is compared on the textures that both runs have. Where the samples
    are equal, cells are paired; where they are other draws, means over draws are compared. The table holds both means,
    the difference with its 95 % interval over draws, and whether the score is better, worse, the same, or moved by no
    more than draws do. ``nrbench compare`` prints the same table.

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

    def write(self, run: Run, directory: Path) -> list[Path]:
        """Write the files and return their paths; none without a baseline."""
        if self.baseline is None:
            return []
        changes = self.compare(run)
        texts = {"changes.md": changes.markdown(), "changes.json": json.dumps(changes.as_dict(), indent=1) + "\n"}
        return write_files(directory, texts)

    def compare(self, run: Run) -> RunChanges:
        """Return the changes from the baseline to a run.

        Raises
        ------
        BadInput
            If the baseline is no run, neither run has a score that was named, or the runs have no cell in common.
        """
        baseline = Run(self.baseline or Path())
        _ = baseline.info
        return compare_runs(baseline, run, self.columns)


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
        The mean of ``after - before``.
    p
        p-value that the score is worse, adjusted for all scores and methods; None if too few textures are known.
    detectable
        The loss that is found with a power of 0.8; None if no loss can be, or nothing scatters.
    state
        ``same``: no value changed. ``better``, ``worse``, or ``changed`` where no way is better: by more than draws do.
        ``noise``: by no more. ``unknown``: fewer than six textures have a value in both runs.
    """

    method: str
    reference: bool
    score: str
    before: float | None
    after: float | None
    difference: Estimate
    p: float | None
    detectable: float | None
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
        least = format_number(self.detectable)
        return [self.method, self.score, *numbers, gap, least, str(self.difference.n), WORDS[self.state]]


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
    newly_failed
        The methods of which a cell had an output in the first run, and has none in the second for the same sample.
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
    newly_failed: Sequence[str]
    pairs: int
    equal_samples: int
    named: bool

    @property
    def worse(self) -> list[Change]:
        """The changes for the worse of methods that are no references; costs only if the caller named them."""
        return [change for change in self.changes if change.state == "worse" and _counts(change, self.named)]

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
            lines.append(
                f"{pluralize(other, 'cell')} of {self.pairs} have another sample, so draws are compared, not pairs"
            )
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

    def table(self) -> pd.DataFrame:
        """Return one row for each method and score: both means, the difference with its interval, and the change."""
        return pd.DataFrame([change.as_dict() for change in self.changes])

    def _repr_html_(self) -> str:
        """Return the table and the notes as HTML, for notebooks."""
        table = pd.DataFrame([change.cells for change in self.changes], columns=HEADS).to_html(index=False)
        return table + "".join(f"<p>{html.escape(strip_control(note))}</p>" for note in (LEGEND, *self.notes))

    def text(self) -> str:
        """Return the changes as a plain table with aligned columns."""
        rows = [HEADS, *(change.cells for change in self.changes)]
        widths = [max(map(len, column)) for column in zip(*rows, strict=True)]
        lines = ["  ".join(map(str.ljust, row, widths)).rstrip() for row in rows]
        lines.insert(1, "─" * max(map(len, lines)))
        title = f"{self.first.root} -> {self.second.root}"
        return "\n".join([title, "", *lines, "", fill(LEGEND, 110), *map(strip_control, self.notes)])

    def markdown(self) -> str:
        """Return the changes as a Markdown table for a pull request."""
        table = pipe_table(HEADS, ([*map(escape_markdown, change.cells)] for change in self.changes))
        title = f"**{escape_markdown(str(self.first.root))} → {escape_markdown(str(self.second.root))}**"
        notes = [f"- {escape_markdown(line)}" for line in self.notes]
        return "\n".join([title, "", table, "", LEGEND, *(["", *notes] if notes else [])]) + "\n"

    def as_dict(self) -> dict[str, Any]:
        """Return all of it for JSON."""
        return {
            "first": str(self.first.root),
            "second": str(self.second.root),
            "changes": [change.as_dict() for change in self.changes],
            "only_first": list(self.only_first),
            "only_second": list(self.only_second),
            "cells": {method: {"first": a, "second": b} for method, (a, b) in self.counts.items()},
            "newly_failed": list(self.newly_failed),
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
        For a score that neither run has, and for runs of the same methods that have no texture in common.
    """
    headlines = headline_columns(second) | headline_columns(first)
    columns = describe_scores(first) | describe_scores(second) | headlines
    columns[PRESERVED] = Column("Whether the lattice is preserved; failures and refusals count as no.", better="higher")
    columns[FAILED] = Column("Whether the cell failed, was refused or is missing.", better="lower")
    chosen = list(scores) or [*(name for name in headlines if name != "seconds"), PRESERVED, FAILED, "seconds"]
    if unknown := [name for name in chosen if name not in columns]:
        raise BadInput(f"score {unknown[0]!r} is not known{nearest(unknown[0], columns)}")
    before, after = (_tabulate(run, chosen) for run in (first, second))
    common = [label for label in before if label in after]
    keys = ["texture", "replicate"]
    pairs = {label: before[label].merge(after[label], on=keys, suffixes=("_before", "_after")) for label in common}
    if common and not any(map(len, pairs.values())):
        raise BadInput(f"{first.root} and {second.root}: have no texture in common; compare runs of one suite")
    alike = {label: both["sample_before"] == both["sample_after"] for label, both in pairs.items()}
    moves = [move for label in common for move in _moves(before[label], after[label], alike[label], columns, chosen)]
    contestants = {label: rows for label, rows in after.items() if not rows["reference"].any()}
    means = {
        label: mean_of_known(mean_of_known(stack_draws(rows, chosen), 2), 1) for label, rows in contestants.items()
    }
    lost = {label: (both[f"{FAILED}_after"] > both[f"{FAILED}_before"]) & alike[label] for label, both in pairs.items()}
    return RunChanges(
        first,
        second,
        _decide(moves, columns, bool(scores)),
        {name: {label: float(means[label][i]) for label in means} for i, name in enumerate(chosen)},
        [label for label in before if label not in after],
        [label for label in after if label not in before],
        {label: (_count(before[label]), _count(after[label])) for label in common},
        [label for label, found in lost.items() if found.any() and not after[label]["reference"].any()],
        sum(map(len, pairs.values())),
        sum(int(same.sum()) for same in alike.values()),
        bool(scores),
    )


def _counts(change: Change, named: bool) -> bool:
    """Return whether a change for the worse is a reason to fail."""
    return not change.reference and (named or change.score not in COSTS)


def _tabulate(run: Run, scores: Sequence[str]) -> dict[str, pd.DataFrame]:
    """Return the cells by method, with the hashes of their samples, and NaN for scores that the run lacks."""
    table = tabulate_cells(run)
    known = table["verdict"].map({"preserved": 1.0, "lost": 0.0, "failed": 0.0, "refused": 0.0})
    table[PRESERVED] = known.astype(float).where(table["applicable"].astype(bool))
    table[FAILED] = table["status"].ne("ok").astype(float)
    table["sample"] = [record.cell.sample_hash for record in run.cells]
    for name in scores:
        if name not in table:
            table[name] = np.nan
    return {str(label): rows for label, rows in table.groupby("label", sort=False)}


def _moves(
    before: pd.DataFrame,
    after: pd.DataFrame,
    alike: pd.Series[bool],
    columns: Mapping[str, Column],
    names: Sequence[str],
) -> list[tuple[Change, pd.Series[float]]]:
    """Return for each score of a method its change, not yet decided, and its improvement on each texture.

    If all samples are equal, the differences of the cells are taken, else those of the means over draws.
    """
    reference = bool(before["reference"].any() or after["reference"].any())
    keys = ["texture", "replicate"] if alike.all() else ["texture"]
    rows = [
        one.merge(other[keys].drop_duplicates(), on=keys).sort_values(["texture", "replicate"])
        for one, other in ((before, after), (after, before))
    ]
    textures = sorted(set(rows[0]["texture"]))
    ends = [stack_draws(part, names) for part in rows]
    merits = [stack_draws(_merit(part, names, columns), names) for part in rows]
    if alike.all():
        estimates, gains = estimate_means(ends[1] - ends[0]), mean_of_known(merits[1] - merits[0], 2)
    else:
        estimates, gains = _compare_draws(*ends), mean_of_known(merits[1], 2) - mean_of_known(merits[0], 2)
    moves = []
    for i, name in enumerate(names):
        if before[name].isna().all() and after[name].isna().all():
            continue
        known = np.isfinite(gains[i])
        means = [mean_of_known(mean_of_known(end[i, known], 1)[None], 1)[0] for end in ends]
        values = [None if math.isnan(value) else float(value) for value in means]
        equal = (
            known.any() and ends[0].shape == ends[1].shape and np.array_equal(ends[0][i], ends[1][i], equal_nan=True)
        )
        state: State = "same" if equal else "unknown"
        change = Change(
            str(after["label"].iloc[0]), reference, name, values[0], values[1], estimates[i], None, None, state
        )
        moves.append((change, pd.Series(gains[i], textures)))
    return moves


def _compare_draws(before: Floats, after: Floats) -> list[Estimate]:
    """Return the differences of means over draws that are not paired, with intervals over the draws of both."""
    draws = max(before.shape[2], after.shape[2])
    sides = [
        np.pad(side, ((0, 0), (0, 0), (0, draws - side.shape[2])), constant_values=np.nan) for side in (before, after)
    ]
    known = np.isfinite(mean_of_known(sides[0], 2) + mean_of_known(sides[1], 2))[..., None]
    strata = np.where(np.concatenate([known, known], 1), np.concatenate([-sides[0], sides[1]], 1), np.nan)
    return [
        Estimate(None, of=before.shape[1])
        if one.value is None
        else Estimate(2 * one.value, one.low and 2 * one.low, one.high and 2 * one.high, one.n // 2, before.shape[1])
        for one in estimate_means(strata)
    ]


def _merit(table: pd.DataFrame, scores: Sequence[str], columns: Mapping[str, Column]) -> pd.DataFrame:
    """Return the scores so that higher is better: two-sided ones as their distance from 1, below zero."""
    ways = {"lower": lambda values: -values, "one": lambda values: -(values - 1).abs()}
    return table.assign(**{name: ways[way](table[name]) for name in scores if (way := columns[name].better) in ways})


def _decide(
    moves: Sequence[tuple[Change, pd.Series[float]]], columns: Mapping[str, Column], named: bool
) -> list[Change]:
    """Return the changes with their states: the reasons to fail are tested together, and the other scores together."""
    decided: dict[int, Change] = {}
    for counted in (True, False):
        family = [i for i, (change, _) in enumerate(moves) if _counts(change, named) == counted]
        if not family:
            continue
        gains = pd.DataFrame({i: moves[i][1] for i in family}).to_numpy(np.float64)
        p_better, p_worse = (p_values_by_flips(sign * gains, one_sided=True).tolist() for sign in (1, -1))
        least = detectable_losses(gains).tolist()
        for i, better, worse, loss in zip(family, p_better, p_worse, least, strict=True):
            change = moves[i][0]
            if change.state == "same" or math.isnan(worse):
                decided[i] = change
                continue
            moved: State = "better" if better <= ALPHA else "worse" if worse <= ALPHA else "noise"
            if columns[change.score].better == "none":
                moved = "changed" if 2 * min(better, worse) <= ALPHA else "noise"
            decided[i] = replace(change, p=worse, detectable=None if math.isnan(loss) else loss, state=moved)
    return [decided[i] for i in range(len(moves))]


def _count(cells: pd.DataFrame) -> dict[str, int]:
    return {word: count for word, count in count_statuses(cells["status"]).items() if word != "cells"}


def _count_text(counts: Mapping[str, int]) -> str:
    return ", ".join(f"{count} {word}" for word, count in counts.items() if count) or "no cells"
