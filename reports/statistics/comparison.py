"""Compare the methods of a run: their ranking by quality, the table of textures by methods, and the perils plane.

Every report format prints the one :class:`Comparison` that :func:`compare_methods` builds.
"""

from __future__ import annotations

import itertools
import math
from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from nrbench import plugins
from nrbench.errors import BadInput
from nrbench.plugins.forms import Column
from nrbench.plugins.parameters import nearest
from nrbench.runs.records import CellRecord, Run
from nrbench.runs.store import FAILED

from .estimates import Estimate, estimate_means, mean_of_known, success_rate
from .format import (
    describe_column,
    format_count,
    format_interval,
    format_number,
    format_percent,
    format_successes,
    pluralize,
    round_small,
)
from .significance import (
    ALPHA,
    FEWEST,
    Floats,
    RankTests,
    adjust_holm,
    compare_ranks,
    rank_biserial,
    signed_rank_p_values,
)
from .verdicts import (
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
    count_valid_textures,
    explain_verdict,
    has_quality,
    is_valid_baseline,
    keep_common_textures,
    method_label,
    tabulate_cells,
    verdict,
)

HEADLINES = (RANKING, *PERILS)
HEADLINES_WITHOUT_QUALITY = (SCORE, "randomness.variation", "randomness.repetition", "randomness.distance")
HEADLINE_METRICS = ("quality", "regularity", "integrity", "randomness")
COSTS: Mapping[str, Column] = {
    "seconds": Column("Wall time of the synthesis, including its own lattice detection.", "s", (0, math.inf), "lower"),
    "peak_mib": Column("Peak memory above the idle worker.", "MiB", (0, math.inf), "lower"),
}
RATE = Column("Share of textures whose lattice is preserved.", better="higher")
RATE_MEANING = (
    "With a 95 % bootstrap interval over textures (Wilson's if all textures agree). A texture counts as the mean over "
    "its replicates. Failures and refusals count as not preserved. Undecided cells are left out."
)
MEAN_MEANING = "Mean over textures, with a 95 % bootstrap interval. A texture counts as the mean over its replicates."
LEADING_SIGN = "★"


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
class PatchTerms:
    """How a method that copies patches works: a row of the table of patches (Lin et al. 2004, table 1).

    Parameters
    ----------
    method
        The name of the plugin.
    shape, placement, stitching
        What a patch is, how its place is chosen, and how it is joined to the others, as the plugin says.
    """

    method: str
    shape: str
    placement: str
    stitching: str


def list_patch_terms(run: Run) -> list[PatchTerms]:
    """Return the terms of each plugin of a run that copies patches and is here to say so, in the order of the run."""
    names = dict.fromkeys(record.cell.method for record in run.cells if not record.cell.reference)
    installed = set(plugins.names("synthesizers"))
    classes = {name: plugins.find("synthesizers", name).cls for name in names if name in installed}
    said = {name: [getattr(cls, term, "") for term in plugins.PATCH_TERMS] for name, cls in classes.items()}
    return [PatchTerms(name, *terms) for name, terms in said.items() if all(terms)]


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
    validity, validity_scored
        On how many textures a baseline is valid: of all, and of those with a quality.
    rank
        Position by mean quality, 1 the best; None for a reference, without a quality, and if the method has a quality
        on fewer than half as many textures as the method with the most.
    leading
        Whether it is in the leading group.
    average_rank
        Mean over textures of its rank on each texture, among the ranked methods; None without :class:`RankTests`.
    """

    method: Method
    counts: Mapping[str, int]
    success: Estimate
    success_answered: Estimate
    means: Mapping[str, Estimate]
    validity: BaselineValidity
    validity_scored: BaselineValidity
    rank: int | None = None
    leading: bool = False
    average_rank: float | None = None

    @property
    def all_means(self) -> dict[str, Estimate]:
        """The success rates and the means, by the names of their columns."""
        rates = {"preserved": self.success, "preserved_refusals_left_out": self.success_answered}
        return {**rates, **self.means}


@dataclass(frozen=True)
class PairedDifference:
    """The mean difference of two methods in one score, over the textures that both have."""

    score: str
    first: Method
    second: Method
    estimate: Estimate


@dataclass(frozen=True)
class BaselineDifference:
    """A method beside the method that all are compared with.

    Parameters
    ----------
    method
        The method.
    estimate
        Mean over textures of its quality minus that of the other method.
    effect
        The rank-biserial correlation of the differences, in [-1, 1].
    p
        p-value of Wilcoxon's signed-rank test, adjusted by Holm's method for all methods of the list; None with fewer
        than :data:`~nrbench.reports.statistics.significance.FEWEST` textures, and without tests.
    """

    method: Method
    estimate: Estimate
    effect: float | None
    p: float | None


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
    """

    name: str
    column: Column
    note: str
    estimates: Sequence[Estimate | None]
    rate: bool = False
    variant: bool = False

    @property
    def title(self) -> str:
        """The name, without the metric for the three perils."""
        return self.name.rpartition(".")[2] if self.name in PERILS else self.name

    @property
    def meaning(self) -> str:
        """The description of the column, and how the number is computed."""
        return f"{describe_column(self.column)}\n{self.note}"

    @property
    def values(self) -> list[str]:
        """The values as text; a dash if there is none."""
        text = format_percent if self.rate else format_number
        return [text(estimate.value) if estimate else "–" for estimate in self.shown]

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
    rows: Sequence[TextureRow]
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


@dataclass(frozen=True)
class PerilsPoint:
    """One method with its lattice source in the perils plane.

    Parameters
    ----------
    method
        The method.
    structure
        Mean over textures of the smaller of ``quality.regularity`` and ``quality.integrity``: the horizontal
        coordinate.
    randomness
        Mean of ``quality.randomness`` over textures: the vertical coordinate. It rests only on the textures on which
        randomness is scored. It is not scored where the lattice is lost.
    validity
        On how many of the textures with a quality a baseline is valid.
    """

    method: Method
    structure: Estimate
    randomness: Estimate
    validity: BaselineValidity

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
        return f"{self.method.label}: in place and whole {across}, randomness {height}{valid}"


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
    summaries = _summarize_methods(run, cells)
    draws = _TextureDraws.of(run, cells)
    other = _find_method([one.method for one in summaries], baseline)
    rule, ranks, against = "", None, []
    ranked = _rank_methods(summaries)
    best = next((one.method for one in ranked if one.rank == 1), None)
    fit = [one.method for one in ranked if one.rank]
    if tests and best is not None:
        leading, rule = _leading_group(draws, best, fit)
        ranks = _test_ranks(draws, fit)
        places = dict(zip([one.label for one in fit], ranks.ranks, strict=True)) if ranks else {}
        ranked = [
            replace(one, leading=one.method.label in leading, average_rank=places.get(one.method.label))
            for one in ranked
        ]
        other = other or best
        against = _compare_with(draws, other, [one.method for one in ranked if one.method != other])
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
        summary_rows=_summary_rows(run, ranked),
        notes=notes,
        summaries=ranked,
        differences=_paired_differences(run, methods, draws),
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


def _list_methods(run: Run) -> list[Method]:
    """Return the methods in the order of the suite, reference methods last."""
    methods: dict[tuple[str, str], Method] = {}
    for record in run.cells:
        key = (record.method, record.lattice_source)
        methods.setdefault(key, Method(*key, record.reference, dict(record.parameters)))
    return sorted(methods.values(), key=lambda method: method.reference)


def _texture_rows(run: Run, methods: Sequence[Method], score: str, notes: Mapping[str, int]) -> list[TextureRow]:
    records: dict[str, dict[tuple[str, str], list[CellRecord]]] = {}
    for record in run.cells:
        records.setdefault(record.texture, {}).setdefault((record.method, record.lattice_source), []).append(record)
    return [_texture_row(by_method, methods, score, notes) for by_method in records.values()]


def _texture_row(
    by_method: Mapping[tuple[str, str], list[CellRecord]],
    methods: Sequence[Method],
    score: str,
    notes: Mapping[str, int],
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
        entries=[_entry(by_method.get((method.name, method.lattice_source), []), score, notes) for method in methods],
    )


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


def _summarize_methods(run: Run, cells: pd.DataFrame) -> list[MethodSummary]:
    names, methods = list(describe_scores(run)), _list_methods(run)
    by_texture = cells.groupby(["label", "texture"], sort=False)[names].mean()
    own_cells = dict(iter(cells.groupby("label", sort=False)))
    columns = [column for one in methods for column in by_texture.loc[one.label].to_numpy(np.float64).T]
    estimates = iter(estimate_means(columns))
    summaries = []
    for method in methods:
        own = own_cells[method.label]
        scored = own[own[STRUCTURE].notna()] if STRUCTURE in own else own.iloc[:0]
        summaries.append(
            MethodSummary(
                method=method,
                counts=count_statuses(own["status"]),
                success=success_rate(own),
                success_answered=success_rate(own, leave_refusals_out=True),
                means=dict(zip(names, itertools.islice(estimates, len(names)), strict=True)),
                validity=count_valid_textures(own),
                validity_scored=count_valid_textures(scored),
            )
        )
    return summaries


def _rank_methods(summaries: Sequence[MethodSummary]) -> list[MethodSummary]:
    """Return the summaries by mean quality, best first, then methods without a rank, then references.

    Means over different textures are not comparable. A suite may give each method its own textures; a method that has
    a quality on fewer than half as many textures as the method with the most is therefore listed without a rank.
    """
    known = {
        one.method.label: (mean.value, mean.n)
        for one in summaries
        if not one.method.reference and RANKING in one.means and (mean := one.means[RANKING]).value is not None
    }
    most = max((n for _, n in known.values()), default=0)
    means = {label: value for label, (value, n) in known.items() if value is not None and 2 * n >= most}

    def rank(one: MethodSummary) -> MethodSummary:
        value = means.get(one.method.label)
        return one if value is None else replace(one, rank=1 + sum(other > value for other in means.values()))

    last = len(means) + 1
    return sorted(map(rank, summaries), key=lambda one: (one.method.reference, one.rank or last))


def _leading_group(draws: _TextureDraws, best: Method, ranked: Sequence[Method]) -> tuple[set[str], str]:
    """Return the labels of the leading group, and what the group is.

    A method that shares fewer than half of the best method's textures with it is not in the group: their difference is
    not known.
    """
    gaps = {one.label: draws.differences(best, one)[draws.ranking] for one in ranked if one != best}
    near = {label: gap for label, gap in gaps.items() if 2 * np.isfinite(gap).sum() >= draws.count(best)}
    what = "leading group: the method of the highest mean quality, and the methods"
    if near and all(np.isfinite(gap).sum() >= FEWEST for gap in near.values()):
        p = adjust_holm(np.array([_signed_rank_p(gap) for gap in near.values()]))
        tied = (p >= ALPHA).tolist()
        rule = f"{what} that do not differ from it over textures (Wilcoxon's test with Holm's correction, 5 %)"
    else:
        tied = [one.low is None or one.low <= 0 for one in estimate_means(list(near.values()))]
        rule = f"{what} whose paired difference to it over textures has a 95 % interval that contains 0"
    return {best.label, *itertools.compress(near, tied)}, rule


def _signed_rank_p(differences: Floats) -> float:
    known = differences[np.isfinite(differences)]
    return float(signed_rank_p_values(known[:, None])[0]) if len(known) else 1.0


def _test_ranks(draws: _TextureDraws, ranked: Sequence[Method]) -> RankTests | None:
    """Return the tests over the textures on which every ranked method has a quality; None with too few."""
    values = np.stack([draws.means(one)[draws.ranking] for one in ranked], axis=1)
    complete = values[np.isfinite(values).all(1)]
    return compare_ranks(complete) if len(complete) >= FEWEST and len(ranked) > 1 else None


def _compare_with(draws: _TextureDraws, other: Method, methods: Sequence[Method]) -> list[BaselineDifference]:
    """Return the difference of each method to ``other`` in quality; methods without common textures are left out."""
    gaps = [(one, -draws.differences(other, one)[draws.ranking]) for one in methods]
    known = [(one, gap) for one, gap in gaps if np.isfinite(gap).any()]
    estimates = estimate_means([gap for _, gap in known])
    many = [_signed_rank_p(gap) for _, gap in known if np.isfinite(gap).sum() >= FEWEST]
    adjusted = iter(adjust_holm(np.array(many)).tolist())
    return [
        BaselineDifference(one, estimate, rank_biserial(gap), next(adjusted) if estimate.n >= FEWEST else None)
        for (one, gap), estimate in zip(known, estimates, strict=True)
    ]


@dataclass(frozen=True)
class _TextureDraws:
    """The headline scores of every method, by texture and replicate.

    Parameters
    ----------
    names
        The scores.
    values
        ``(scores, textures, replicates)`` for each label; NaN is no value.
    present
        ``(textures, replicates)`` for each label: whether the run has the cell.
    """

    names: Sequence[str]
    values: Mapping[str, Floats]
    present: Mapping[str, NDArray[np.bool_]]

    @classmethod
    def of(cls, run: Run, cells: pd.DataFrame) -> _TextureDraws:
        """Collect the scores of a run."""
        names = list(headline_columns(run))
        textures, row = np.unique(cells["texture"].to_numpy(object).astype(str), return_inverse=True)
        replicates, column = np.unique(cells["replicate"].to_numpy(np.int64), return_inverse=True)
        scores = cells[names].to_numpy(np.float64)
        values: dict[str, Floats] = {}
        present: dict[str, NDArray[np.bool_]] = {}
        for name, where in cells.groupby("label", sort=False).indices.items():
            label = str(name)
            values[label] = np.full((len(names), len(textures), len(replicates)), np.nan)
            values[label][:, row[where], column[where]] = scores[where].T
            present[label] = np.zeros((len(textures), len(replicates)), bool)
            present[label][row[where], column[where]] = True
        return cls(names, values, present)

    @property
    def ranking(self) -> int:
        """The index of the quality that ranks."""
        return self.names.index(RANKING)

    def means(self, method: Method) -> Floats:
        """Return the mean over replicates of each score on each texture, ``(scores, textures)``."""
        return mean_of_known(self.values[method.label], -1)

    def count(self, method: Method) -> int:
        """Return the number of textures on which a method has the quality that ranks."""
        return int(np.isfinite(self.means(method)[self.ranking]).sum())

    def differences(self, first: Method, second: Method) -> Floats:
        """Return the mean over replicates of first minus second on each texture, ``(scores, textures)``."""
        return mean_of_known(self.values[first.label] - self.values[second.label], -1)

    def common(self, first: Method, second: Method) -> int:
        """Return the number of textures that both methods ran on."""
        return int((self.present[first.label] & self.present[second.label]).any(1).sum())


def count_statuses(status: pd.Series[str]) -> dict[str, int]:
    """Return the number of ``cells``, and of those that are ``ok``, ``refused``, ``missing`` and ``failed``."""
    by_status = {name: int((status == name).sum()) for name in ("ok", "refused", "missing")}
    return {"cells": len(status), **by_status, "failed": int(status.isin(FAILED).sum())}


def _paired_differences(run: Run, methods: Sequence[Method], draws: _TextureDraws) -> list[PairedDifference]:
    """Return the differences of all pairs whose first method is no reference, in every headline."""
    pairs = [(a, b) for a, b in itertools.combinations(methods, 2) if not a.reference]
    gaps = [draws.differences(a, b) for a, b in pairs]
    common = [draws.common(a, b) for a, b in pairs]
    found = []
    for index, name in enumerate(draws.names):
        estimates = estimate_means([gap[index] for gap in gaps], common)
        found += [PairedDifference(name, a, b, one) for (a, b), one in zip(pairs, estimates, strict=True)]
    return found


def _summary_rows(run: Run, summaries: Sequence[MethodSummary]) -> list[SummaryRow]:
    """Return the rows: quality and perils, or without quality the success rate and other scores, then seconds."""
    if not summaries:
        return []
    refused = any(one.counts["refused"] for one in summaries)
    rates = [_row("preserved", RATE, RATE_MEANING, [one.success for one in summaries], rate=True)]
    if refused:
        note = RATE_MEANING.replace("Failures and refusals count", "Refusals are left out. Failures count")
        estimates = [one.success_answered for one in summaries]
        rates.append(_row("preserved (without refusals)", RATE, note, estimates, rate=True, variant=True))
    columns = headline_columns(run)
    means = []
    for name, column in columns.items():
        undecided = " Undecided cells are left out." if name in (SCORE, *HEADLINES) else ""
        means.append(_row(name, column, MEAN_MEANING + undecided, [one.means[name] for one in summaries]))
        if name == RANKING and (refused or any(one.counts["failed"] for one in summaries)):
            estimates = [one.means[QUALITY] for one in summaries]
            note = f"{MEAN_MEANING} Failures, refusals and undecided cells are left out."
            means.append(_row("quality (without failures)", run.columns[QUALITY], note, estimates, variant=True))
    seconds = len(means) - 1 if RANKING in columns else 0
    return [*means[:seconds], *rates, *means[seconds:]]


def other_score_rows(run: Run, summaries: Sequence[MethodSummary]) -> list[SummaryRow]:
    """Return a row of means for each further score that any method has.

    Wall time and peak memory appear once: the columns of the metric ``cost`` that repeat them are left out.
    """
    shown = {*headline_columns(run), PRESERVED, QUALITY, STRUCTURE, *(f"cost.{name}" for name in COSTS)}
    columns = describe_scores(run)
    rows = [
        _row(name, columns[name], MEAN_MEANING, [one.means[name] for one in summaries])
        for name in sort_headlines_first(columns)
        if name not in shown
    ]
    return [row for row in rows if any(row.estimates)]


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


def _row(
    name: str,
    column: Column,
    note: str,
    estimates: Sequence[Estimate | None],
    rate: bool = False,
    variant: bool = False,
) -> SummaryRow:
    known = [estimate if estimate and estimate.n else None for estimate in estimates]
    return SummaryRow(name, column, note, known, rate, variant)


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


def perils_points(summaries: Sequence[MethodSummary]) -> list[PerilsPoint]:
    """Return the point of every method that has a quality, in the order of the summaries."""
    points = [
        PerilsPoint(one.method, one.means[STRUCTURE], one.means[RANDOMNESS], one.validity_scored)
        for one in summaries
        if STRUCTURE in one.means
    ]
    return [point for point in points if point.structure.value is not None]


def perils_table(points: Sequence[PerilsPoint]) -> pd.DataFrame:
    """Return one row a point, with intervals and the number of textures that each coordinate rests on."""
    return pd.DataFrame(
        {
            **{"method": point.method.name, "lattice_source": point.method.lattice_source},
            "reference": point.method.reference,
            **point.structure.columns("structure_value", "structure_"),
            **point.randomness.columns("randomness_value", "randomness_"),
        }
        for point in points
    )
