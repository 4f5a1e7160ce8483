"""The figure of one cell: its output with the metrics' pictures, its verdict and its scores."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from nrbench.plugins.forms import Value
from nrbench.runs.records import CellRecord, Run

from ..statistics.baselines import sentence
from ..statistics.summary import COSTS, Head, headlines, headlines_first
from ..statistics.verdicts import MARKS, SCORE, explanation, verdict
from .format import number, tip
from .pictures import Picture, Pictures


@dataclass(frozen=True)
class Layer:
    """A picture that can be laid over an output."""

    index: int
    title: str
    picture: Picture


@dataclass(frozen=True)
class ScoreLine:
    """One score of a cell in words, with what its column declares and, where there is none, why."""

    name: str
    text: str
    meaning: str
    reason: str


@dataclass(frozen=True)
class Figure:
    """One output with its verdict and scores.

    Parameters
    ----------
    record, head
        The cell, and its column.
    verdict, mark, shade, explanation
        As in the comparison.
    output
        The output's pixels; None where there are none.
    layers
        The metrics' pictures.
    headline, scores
        The headline scores, and all scores.
    no_cheat
        Why a reference is no cheat on the texture; empty where it is one.
    """

    record: CellRecord
    head: Head
    verdict: str
    mark: str
    shade: int | None
    explanation: str
    output: Picture | None
    layers: Sequence[Layer]
    headline: Sequence[ScoreLine]
    scores: Sequence[ScoreLine]
    no_cheat: str = ""


_LOST = 3
"""Lightest shade of what is lost."""


def shade(score: float | None) -> int | None:
    """Return a score's shade, 0 (worst) to 10."""
    return None if score is None else round(10 * min(1.0, max(0.0, score)))


def layer_titles(run: Run) -> list[str]:
    """Return the names of the metrics' pictures that occur in a run, those behind the headlines first."""
    return headlines_first(dict.fromkeys(title for record in run.cells for title in record.pictures))


def head_of(record: CellRecord) -> Head:
    """Return the column that a cell belongs to."""
    return Head(record.method, record.lattice_source, record.reference, record.parameters)


def _shade_of(score: Value, word: str) -> int | None:
    """Return a verdict's shade: its score's, but no lost one looks like one that passed."""
    found = shade(None if score is None else float(score))
    return found if found is None or word != "lost" else min(found, _LOST)


def figure(run: Run, record: CellRecord, pictures: Pictures) -> Figure:
    """Return a cell's figure."""
    score, word = record.values.get(SCORE), verdict(record)
    names = [name for name in headlines(run) if name != SCORE]
    return Figure(
        record=record,
        head=head_of(record),
        verdict=word,
        mark=MARKS[word],
        shade=_shade_of(score, word),
        explanation=explanation(record),
        output=pictures.picture(record.folder / "output.png") if record.status == "ok" else None,
        layers=_layers(record, pictures, layer_titles(run)),
        headline=[line for name in names if (line := score_line(run, record, name))],
        scores=[line for name in headlines_first(run.columns) if (line := score_line(run, record, name))],
        no_cheat=sentence(record),
    )


def _layers(record: CellRecord, pictures: Pictures, titles: Sequence[str]) -> list[Layer]:
    shown = ((index, title, _picture(record.pictures.get(title), pictures)) for index, title in enumerate(titles, 1))
    return [Layer(index, title, picture) for index, title, picture in shown if picture]


def _picture(path: Path | None, pictures: Pictures) -> Picture | None:
    return pictures.picture(path) if path else None


def score_line(run: Run, record: CellRecord, name: str) -> ScoreLine | None:
    """Return one score of a cell, or its seconds; None where the cell has no such score."""
    if name == "seconds":
        seconds = record.seconds
        return None if seconds is None else ScoreLine("time", f"{number(seconds)} s", tip(COSTS[name]), "")
    if name not in record.values:
        return None
    column = run.columns[name]
    value = record.values[name]
    unit = f" {column.unit}" if column.unit and value is not None else ""
    return ScoreLine(name, number(value) + unit, tip(column), record.reasons.get(name, ""))
