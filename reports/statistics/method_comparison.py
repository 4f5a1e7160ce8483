"""Compare the methods of a run: their ranking by quality, and the table of textures by methods.

Every report format prints the one :class:`Comparison` that :func:`compare_methods` builds.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

from nrbench.errors import BadInput
from nrbench.plugins.parameters import nearest
from nrbench.runs.records import CellRecord, Run

from .format import pluralize
from .significance import (
    BaselineDifference,
    PairedDifference,
    RankTests,
    compare_with,
    find_leading_group,
    list_differences,
    rank_by_texture,
)
from .summaries import (
    Method,
    MethodSummary,
    SummaryRow,
    other_score_rows,
    rank_methods,
    summarize_methods,
    summary_rows,
)
from .verdicts import (
    MARKS,
    PRESERVED,
    QUALITY,
    SCORE,
    explain_verdict,
    has_quality,
    is_valid_baseline,
    keep_common_textures,
    method_label,
    tabulate_cells,
    verdict,
)


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
        Mean over replicates of :attr:`Comparison.score`, in [0, 1]; None if there is none.
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
class ComparisonRow:
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
    score
        Name of the score beside the marks: ``quality.score`` if the run has it, else ``regularity.score``.
    scored
        Whether the run has verdicts or qualities.
    methods
        Its columns: methods from the highest mean quality to the lowest, then reference methods.
    rows, summary_rows
        The textures, and the numbers that summarize each method.
    notes
        The notes of methods on their cells; number 1 is the first.
    summaries
        Each method in numbers.
    differences
        Paired differences between methods.
    counts
        Cells by status.
    baseline
        The method with which :attr:`against` compares the others; None without a ranking or without tests.
    against
        The difference of each other method to it in quality.
    ranked
        The methods of :attr:`tests`, in the order of its input.
    tests
        Ranks over the textures on which every ranked method has a quality; None with fewer than
        :data:`~nrbench.reports.statistics.significance.FEWEST` of them, and without tests.
    tested
        Whether tests and a leading group were wanted.
    leading_legend
        What the sign of the leading group means in this table.
    """

    title: str
    score: str
    scored: bool
    methods: Sequence[Method]
    rows: Sequence[ComparisonRow]
    summary_rows: Sequence[SummaryRow]
    notes: Sequence[str]
    summaries: Sequence[MethodSummary]
    differences: Sequence[PairedDifference]
    counts: Mapping[str, int]
    baseline: Method | None = None
    against: Sequence[BaselineDifference] = ()
    ranked: Sequence[Method] = ()
    tests: RankTests | None = None
    tested: bool = True
    leading_legend: str = ""

    @property
    def legend(self) -> list[tuple[str, str]]:
        """The verdicts that occur, each with its mark."""
        verdicts = {entry.verdict for row in self.rows for entry in row.entries if entry}
        return [(mark, name) for name, mark in MARKS.items() if name in verdicts]

    @property
    def score_meaning(self) -> str:
        """The number beside the marks, in words."""
        if self.score == QUALITY:
            return "quality, the worst of regularity, integrity and randomness; 1 as a fresh draw"
        return "regularity.score, 0 to 1"

    @property
    def has_ranking(self) -> bool:
        """Whether methods are ranked."""
        return any(one.rank for one in self.summaries)

    @property
    def has_valid_baseline(self) -> bool:
        """Whether any baseline is valid on any texture."""
        return any(one.validity.n for one in self.summaries)


def compare_methods(run: Run, tests: bool = True, baseline: str = "") -> Comparison:
    """Build the comparison of a run, or return the one that was built before; without rows if the run has no cells.

    Parameters
    ----------
    run
        The run.
    tests
        Whether to test which methods differ. Without tests there is no leading group.
    baseline
        The name, or the label with its lattice source, of the method with which the others are compared; by default
        the best ranked one.

    Raises
    ------
    BadInput
        If the run has no such method, or the name stands for several.
    """
    return run.shared(_build_comparison, tests, baseline)


def _build_comparison(run: Run, tests: bool, baseline: str) -> Comparison:
    cells = keep_common_textures(tabulate_cells(run))
    summaries = summarize_methods(run, cells)
    other = _find_method([one.method for one in summaries], baseline)
    rule, ranks, against = "", None, []
    ranked = rank_methods(summaries)
    best = next((one.method for one in ranked if one.rank == 1), None)
    fit = [one.method for one in ranked if one.rank]
    if tests and best is not None:
        leading, rule = find_leading_group(cells, best, fit)
        ranks = rank_by_texture(cells, fit)
        places = dict(zip([one.label for one in fit], ranks.ranks, strict=True)) if ranks else {}
        ranked = [
            replace(one, leading=one.method.label in leading, average_rank=places.get(one.method.label))
            for one in ranked
        ]
        other = other or best
        against = compare_with(cells, other, [one.method for one in ranked if one.method != other])
    methods = [one.method for one in ranked]
    score = QUALITY if has_quality(run) else SCORE
    notes = list(dict.fromkeys(record.note for record in run.cells if record.note))
    rows = _texture_rows(run, methods, score, {note: number for number, note in enumerate(notes, 1)})
    counts = dict(Counter(record.status for record in run.cells).most_common())
    return Comparison(
        title=_title(run, len(rows), counts),
        score=score,
        scored=PRESERVED in run.columns or score == QUALITY,
        methods=methods,
        rows=rows,
        summary_rows=summary_rows(run, ranked),
        notes=notes,
        summaries=ranked,
        differences=list_differences(run, methods, cells),
        counts=counts,
        baseline=other if against else None,
        against=against,
        ranked=fit if ranks else (),
        tests=ranks,
        tested=tests,
        leading_legend=rule,
    )


def _find_method(methods: Sequence[Method], name: str) -> Method | None:
    """Return the method of a label or name; None if the name is empty."""
    if not name:
        return None
    found = [one for one in methods if name == one.label] or [one for one in methods if name in (one.name, one.base)]
    if len(found) == 1:
        return found[0]
    labels = ", ".join(one.label for one in found or methods)
    what = "is not unique" if found else "is no method of this run"
    raise BadInput(f"baseline {name!r} {what}; give one of: {labels}")


def _title(run: Run, textures: int, counts: Mapping[str, int]) -> str:
    suite = run.info.get("suite", {})
    name = f"{suite.get('name', 'run')} {suite.get('version', '')}".rstrip()
    sizes = f"{pluralize(textures, 'texture')}, {pluralize(len(run.cells), 'cell')}"
    ended = ", ".join(f"{count} {status}" for status, count in counts.items())
    return f"{name} ({suite.get('hash', 'no hash')}): {sizes}" + (f": {ended}" if ended else "")


def _texture_rows(run: Run, methods: Sequence[Method], score: str, notes: Mapping[str, int]) -> list[ComparisonRow]:
    by_texture: dict[str, list[CellRecord]] = {}
    for record in run.cells:
        by_texture.setdefault(record.texture, []).append(record)
    rows = []
    for records in by_texture.values():
        by_method: dict[str, list[CellRecord]] = {}
        for record in records:
            by_method.setdefault(method_label(record.method, record.lattice_source), []).append(record)
        shares = [record.regular_share for record in records if record.regular_share is not None]
        rows.append(
            ComparisonRow(
                texture=records[0].texture,
                family=records[0].family,
                kind=records[0].kind,
                regular_share=sum(shares) / len(shares) if shares else None,
                description=records[0].cell.description,
                entries=[_entry(by_method.get(method.label, []), score, notes) for method in methods],
            )
        )
    return rows


def _entry(records: list[CellRecord], score: str, notes: Mapping[str, int]) -> Entry | None:
    if not records:
        return None
    verdicts = Counter(map(verdict, records))
    scores = [float(value) for record in records if (value := record.values.get(score)) is not None]
    return Entry(
        verdict=next(iter(verdicts)) if len(verdicts) == 1 else "mixed",
        preserved=verdicts["preserved"],
        score=sum(scores) / len(scores) if scores else None,
        records=records,
        notes=sorted({notes[record.note] for record in records if record.note}),
        baseline_valid=is_valid_baseline(records[0]),
    )


def choose_rows(run: Run, comparison: Comparison, names: Sequence[str]) -> Sequence[SummaryRow]:
    """Return the numbers of the named scores in their order, or the headlines if none is named.

    Parameters
    ----------
    run, comparison
        The run and its comparison.
    names
        Names of columns, as in ``columns.csv``, or titles of headlines.

    Raises
    ------
    BadInput
        For a score that no method has.
    """
    if not names:
        return comparison.summary_rows
    rows = {row.name: row for row in (*comparison.summary_rows, *other_score_rows(run, comparison.summaries))}
    rows = {row.title: row for row in comparison.summary_rows} | rows
    if unknown := [name for name in names if name not in rows]:
        raise BadInput(f"column {unknown[0]!r}: no method of this run has such a score{nearest(unknown[0], rows)}")
    return [rows[name] for name in names]
