"""The comparison: textures by methods, verdict and score in each place, success rates and means at the foot.

Built once; the terminal, HTML and every other format print it.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

from nrbench.runs.records import CellRecord, Run

from .baselines import is_right
from .summary import Difference, Head, Summary, differences, heads, summarize
from .summary_rows import FootRow, foot
from .verdicts import MARKS, SCORE, explanation, frame, verdict


@dataclass(frozen=True)
class Entry:
    """One place of the comparison: a texture, a method and a lattice source.

    Parameters
    ----------
    verdict
        A key of :data:`~nrbench.reports.statistics.verdicts.MARKS`.
    preserved
        How many replicates preserve the lattice.
    score
        Mean of ``regularity.score`` over replicates, in [0, 1]; None where there is none.
    records
        The cells, one a replicate.
    notes
        Numbers of the notes that apply.
    right
        Whether a reference is no cheat on the texture; None for what is no cheat anywhere, or a kind not known.
    """

    verdict: str
    preserved: int
    score: float | None
    records: Sequence[CellRecord]
    notes: Sequence[int] = ()
    right: bool | None = None

    @property
    def mark(self) -> str:
        """The verdict's mark."""
        return MARKS[self.verdict]

    @property
    def detail(self) -> str:
        """What stands beside the mark: the score, how many replicates agree, or the status that ended the cell."""
        if self.verdict in ("failed", "missing"):
            return self.records[0].status
        share = f"{self.preserved}/{len(self.records)} " if self.verdict == "mixed" else ""
        return share + ("" if self.score is None else f"{self.score:.2f}")

    @property
    def text(self) -> str:
        """Mark and detail."""
        return f"{self.mark} {self.detail}".rstrip()

    @property
    def explanation(self) -> str:
        """The sentences behind the verdict, one a replicate; empty where it speaks for itself."""
        return "\n".join(dict.fromkeys(filter(None, map(explanation, self.records))))


@dataclass(frozen=True)
class Row:
    """A texture of the comparison; an entry is None where the run has no such cell."""

    texture: str
    family: str
    kind: str | None
    regular_share: float | None
    description: str
    entries: Sequence[Entry | None]


@dataclass(frozen=True)
class Comparison:
    """The whole table.

    Parameters
    ----------
    heads
        Its columns, reference rows last.
    rows, foot
        Its lines.
    notes
        What methods say of their cells; number 1 is the first.
    summaries
        Each column in numbers.
    differences
        Paired differences between columns.
    counts
        Cells by status.
    """

    heads: Sequence[Head]
    rows: Sequence[Row]
    foot: Sequence[FootRow]
    notes: Sequence[str]
    summaries: Sequence[Summary]
    differences: Sequence[Difference]
    counts: Mapping[str, int]

    @property
    def legend(self) -> list[tuple[str, str]]:
        """The verdicts that occur, each with its mark."""
        found = {entry.verdict for row in self.rows for entry in row.entries if entry}
        return [(mark, name) for name, mark in MARKS.items() if name in found]

    @property
    def no_cheat(self) -> bool:
        """Whether any reference is no cheat on any texture."""
        return any(one.no_cheat.n for one in self.summaries)


def comparison(run: Run) -> Comparison:
    """Build the comparison of a run; a run without cells gives one without rows."""
    cells, columns = frame(run), heads(run)
    summaries = summarize(run, cells)
    notes = list(dict.fromkeys(record.note for record in run.cells if record.note))
    return Comparison(
        heads=columns,
        rows=_rows(run, columns, {note: number for number, note in enumerate(notes, 1)}),
        foot=foot(run, summaries),
        notes=notes,
        summaries=summaries,
        differences=differences(run, cells),
        counts=dict(Counter(record.status for record in run.cells).most_common()),
    )


def _rows(run: Run, columns: Sequence[Head], notes: Mapping[str, int]) -> list[Row]:
    places: dict[str, dict[tuple[str, str], list[CellRecord]]] = {}
    for record in run.cells:
        places.setdefault(record.texture, {}).setdefault((record.method, record.lattice_source), []).append(record)
    return [_row(found, columns, notes) for found in places.values()]


def _row(found: Mapping[tuple[str, str], list[CellRecord]], columns: Sequence[Head], notes: Mapping[str, int]) -> Row:
    records = [record for place in found.values() for record in place]
    shares = [record.regular_share for record in records if record.regular_share is not None]
    first = records[0]
    return Row(
        texture=first.texture,
        family=first.family,
        kind=first.kind,
        regular_share=sum(shares) / len(shares) if shares else None,
        description=first.cell.description,
        entries=[_entry(found.get((head.method, head.lattice_source), []), notes) for head in columns],
    )


def _entry(records: list[CellRecord], notes: Mapping[str, int]) -> Entry | None:
    if not records:
        return None
    verdicts = Counter(map(verdict, records))
    scores = [float(value) for record in records if (value := record.values.get(SCORE)) is not None]
    return Entry(
        verdict=next(iter(verdicts)) if len(verdicts) == 1 else "mixed",
        preserved=verdicts["preserved"],
        score=sum(scores) / len(scores) if scores else None,
        records=records,
        notes=sorted({notes[record.note] for record in records if record.note}),
        right=is_right(records[0]),
    )
