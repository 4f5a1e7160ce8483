"""Build the comparison of a run: textures by methods, with verdict and score in each entry, and summary rows below.

Every report format prints this one table.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

from nrbench.runs.records import CellRecord, Run

from .format import pluralize
from .summary import (
    Method,
    MethodSummary,
    PairedDifference,
    SummaryRow,
    compare_pairs,
    list_methods,
    summarize_methods,
    summary_rows,
)
from .verdicts import MARKS, SCORE, explain_verdict, is_valid_baseline, tabulate_cells, verdict


@dataclass(frozen=True)
class Entry:
    """One entry of the comparison: a texture, a method and a lattice source.

    Parameters
    ----------
    verdict
        A key of :data:`~nrbench.reports.statistics.verdicts.MARKS`.
    preserved
        Number of replicates that preserve the lattice.
    score
        Mean of ``regularity.score`` over replicates, in [0, 1]; None if there is none.
    records
        The cells, one a replicate.
    notes
        Numbers of the notes that apply.
    baseline_valid
        Whether a baseline is valid on the texture; None for a method that is no baseline, or an unknown kind.
    """

    verdict: str
    preserved: int
    score: float | None
    records: Sequence[CellRecord]
    notes: Sequence[int] = ()
    baseline_valid: bool | None = None

    @property
    def mark(self) -> str:
        """The mark of the verdict."""
        return MARKS[self.verdict]

    @property
    def detail(self) -> str:
        """The text beside the mark: the score, how many replicates agree, or the status that ended the cell."""
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
        """Why replicates are neither preserved nor lost, one line a reason; empty if there is nothing to explain."""
        return "\n".join(dict.fromkeys(filter(None, map(explain_verdict, self.records))))


@dataclass(frozen=True)
class TextureRow:
    """A texture of the comparison; an entry is None if the run has no such cell."""

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
    title
        One line: the suite, its hash, and how many cells ended with each status.
    methods
        Its columns, reference methods last.
    rows, summary_rows
        The textures, and the rows below them.
    notes
        The notes of methods on their cells; number 1 is the first.
    summaries
        Each method in numbers.
    differences
        Paired differences between methods.
    counts
        Cells by status.
    """

    title: str
    methods: Sequence[Method]
    rows: Sequence[TextureRow]
    summary_rows: Sequence[SummaryRow]
    notes: Sequence[str]
    summaries: Sequence[MethodSummary]
    differences: Sequence[PairedDifference]
    counts: Mapping[str, int]

    @property
    def legend(self) -> list[tuple[str, str]]:
        """The verdicts that occur, each with its mark."""
        verdicts = {entry.verdict for row in self.rows for entry in row.entries if entry}
        return [(mark, name) for name, mark in MARKS.items() if name in verdicts]

    @property
    def has_valid_baseline(self) -> bool:
        """Whether any baseline is valid on any texture."""
        return any(one.validity.n for one in self.summaries)


def compare_methods(run: Run) -> Comparison:
    """Build the comparison of a run; without rows if the run has no cells."""
    cells, methods = tabulate_cells(run), list_methods(run)
    summaries = summarize_methods(run, cells)
    notes = list(dict.fromkeys(record.note for record in run.cells if record.note))
    rows = _texture_rows(run, methods, {note: number for number, note in enumerate(notes, 1)})
    counts = dict(Counter(record.status for record in run.cells).most_common())
    return Comparison(
        title=_title(run, len(rows), counts),
        methods=methods,
        rows=rows,
        summary_rows=summary_rows(run, summaries),
        notes=notes,
        summaries=summaries,
        differences=compare_pairs(run, cells),
        counts=counts,
    )


def _title(run: Run, textures: int, counts: Mapping[str, int]) -> str:
    suite = run.info.get("suite", {})
    name = f"{suite.get('name', 'run')} {suite.get('version', '')}".rstrip()
    sizes = f"{pluralize(textures, 'texture')}, {pluralize(len(run.cells), 'cell')}"
    ended = ", ".join(f"{count} {status}" for status, count in counts.items())
    return f"{name} ({suite.get('hash', 'no hash')}): {sizes}" + (f": {ended}" if ended else "")


def _texture_rows(run: Run, methods: Sequence[Method], notes: Mapping[str, int]) -> list[TextureRow]:
    records: dict[str, dict[tuple[str, str], list[CellRecord]]] = {}
    for record in run.cells:
        records.setdefault(record.texture, {}).setdefault((record.method, record.lattice_source), []).append(record)
    return [_texture_row(by_method, methods, notes) for by_method in records.values()]


def _texture_row(
    by_method: Mapping[tuple[str, str], list[CellRecord]], methods: Sequence[Method], notes: Mapping[str, int]
) -> TextureRow:
    records = [record for replicates in by_method.values() for record in replicates]
    shares = [record.regular_share for record in records if record.regular_share is not None]
    first = records[0]
    return TextureRow(
        texture=first.texture,
        family=first.family,
        kind=first.kind,
        regular_share=sum(shares) / len(shares) if shares else None,
        description=first.cell.description,
        entries=[_entry(by_method.get((method.name, method.lattice_source), []), notes) for method in methods],
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
        baseline_valid=is_valid_baseline(records[0]),
    )
