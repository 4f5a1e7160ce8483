"""Compare the methods of a run: their ranking by quality, which of them differ, and the table of textures by methods.

Every report format prints the one :class:`Comparison` that :func:`compare_methods` builds.
"""

from __future__ import annotations

import itertools
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import pandas as pd
from numpy.typing import NDArray
from scipy.stats import friedmanchisquare, rankdata, wilcoxon

from nrbench.errors import BadInput
from nrbench.plugins.parameters import nearest
from nrbench.runs.records import CellRecord, Run

from .estimates import Estimate, estimate_means
from .format import pluralize
from .summaries import (
    Method,
    MethodSummary,
    SummaryRow,
    headline_columns,
    other_score_rows,
    rank_methods,
    summarize_methods,
    summary_rows,
)
from .verdicts import (
    BOUND_SIGN,
    COMPLETE,
    MARKS,
    PRESERVED,
    QUALITY,
    RANKING,
    SCORE,
    explain_verdict,
    has_quality,
    is_valid_baseline,
    keep_common_textures,
    method_label,
    tabulate_cells,
    verdict,
)

FEWEST = 10
"""The tests need at least so many textures: with fewer, Wilcoxon's test of several pairs can hardly be significant."""
ALPHA = 0.05
"""Significance level."""
Floats = NDArray[np.float64]


@dataclass(frozen=True)
class RankTests:
    """The ranks of methods over textures, and which methods differ.

    Parameters
    ----------
    order
        Indices of the methods from the best average rank to the worst.
    ranks
        Average rank of each method over the textures, in the order of the input; 1 is the best.
    n
        Number of textures.
    friedman
        p-value of Friedman's test that all methods have equal ranks; None for two methods.
    adjusted
        ``(k, k)``: p-values of Wilcoxon's signed-rank test of each pair, adjusted by Holm's method for all pairs.
    different
        ``(k, k)``: the pairs that differ. No pair differs unless Friedman's test says that the methods do.
    cliques
        First and last position in ``order`` of each longest series of neighbors of which no two differ.
    """

    order: tuple[int, ...]
    ranks: tuple[float, ...]
    n: int
    friedman: float | None
    adjusted: Floats
    different: NDArray[np.bool_]
    cliques: tuple[tuple[int, int], ...]


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
        than :data:`FEWEST` textures, and without tests.
    """

    method: Method
    estimate: Estimate
    effect: float | None
    p: float | None


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
    upper_bound
        Whether the quality of a replicate is an upper bound; None without a quality.
    """

    verdict: str
    preserved: int
    score: float | None
    records: Sequence[CellRecord]
    notes: Sequence[int] = ()
    baseline_valid: bool | None = None
    upper_bound: bool | None = None

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
        return share + ("" if self.score is None else f"{BOUND_SIGN if self.upper_bound else ''}{self.score:.2f}")

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
        :data:`FEWEST` of them, and without tests.
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
            return "quality, the worst of regularity, integrity, randomness and appearance; 1 as a fresh draw"
        return "regularity.score, 0 to 1"

    @property
    def has_ranking(self) -> bool:
        """Whether methods are ranked."""
        return any(one.rank for one in self.summaries)

    @property
    def has_bounds(self) -> bool:
        """Whether the quality of any entry is an upper bound."""
        return any(entry.upper_bound for row in self.rows for entry in row.entries if entry)

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
    scored = [one for one in summaries if RANKING in one.means and not one.method.reference and one.means[RANKING].n]
    known = [one.method for one in scored if not one.at_most]
    ties = {one.method.label: find_leading_group(cells, one.method, known)[0] for one in scored if one.at_most}
    ranked = rank_methods(summaries, ties)
    best = next((one.method for one in ranked if one.rank == 1), None)
    fit = [one.method for one in ranked if one.rank]
    if tests and best is not None:
        measured = [method for method in fit if method in known]
        leading, rule = find_leading_group(cells, best, measured) if best in measured else (set[str](), "")
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
    complete = {record.values.get(COMPLETE) for record in records} - {None}
    return Entry(
        verdict=next(iter(verdicts)) if len(verdicts) == 1 else "mixed",
        preserved=verdicts["preserved"],
        score=sum(scores) / len(scores) if scores else None,
        records=records,
        notes=sorted({notes[record.note] for record in records if record.note}),
        baseline_valid=is_valid_baseline(records[0]),
        upper_bound=False in complete if complete else None,
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


def compare_ranks(values: Floats) -> RankTests:
    """Rank methods on each texture, and test whether they differ.

    Parameters
    ----------
    values
        ``(textures, methods)``, without NaN; higher is better. At least 2 methods and 2 textures.

    References
    ----------
    J. Demsar, "Statistical comparisons of classifiers over multiple data sets", JMLR 7, 2006.
    A. Benavoli, G. Corani and F. Mangili, "Should we really use post-hoc tests based on mean-ranks?", JMLR 17, 2016.
    """
    count = values.shape[1]
    ranks = rankdata(-values, axis=1).mean(0)
    order = np.argsort(ranks, kind="stable")
    first, second = np.triu_indices(count, 1)
    p = adjust_holm(signed_rank_p_values(values[:, first] - values[:, second]))
    adjusted = np.ones((count, count))
    adjusted[first, second] = adjusted[second, first] = p
    friedman = None
    if count > 2:
        equal = bool((values == values[:, :1]).all())
        friedman = 1.0 if equal else float(friedmanchisquare(*values.T).pvalue)
    different = (adjusted < ALPHA) & (friedman is None or friedman < ALPHA)
    return RankTests(
        tuple(order.tolist()),
        tuple(ranks.tolist()),
        len(values),
        friedman,
        adjusted,
        different,
        find_cliques(different[np.ix_(order, order)]),
    )


def signed_rank_p_values(differences: Floats) -> Floats:
    """Return the two-sided p-value of Wilcoxon's signed-rank test of each column of paired differences.

    Differences of zero are split evenly between the signs. A column without zeros and ties has the exact distribution,
    if it has at most 50 values; the others have the normal approximation.

    Parameters
    ----------
    differences
        ``(textures, pairs)``, without NaN.
    """
    n, count = differences.shape
    size = np.sort(np.abs(differences), axis=0)
    distinct = (size[0] > 0) & (np.diff(size, axis=0) > 0).all(0) & (n <= 50)
    p = np.ones(count)
    some = np.flatnonzero(size[-1] > 0)
    for exact, columns in ((True, some[distinct[some]]), (False, some[~distinct[some]])):
        if len(columns):
            method: Any = "exact" if exact else "asymptotic"
            tested: Any = wilcoxon(differences[:, columns], None, "zsplit", method=method, axis=0)
            p[columns] = tested.pvalue
    return p


def adjust_holm(p: Floats) -> Floats:
    """Return p-values adjusted for their number by Holm's step-down method, in the order given.

    Examples
    --------
    >>> import numpy as np
    >>> adjust_holm(np.array([0.01, 0.04, 0.03])).tolist()
    [0.03, 0.06, 0.06]
    """
    order = np.argsort(p, kind="stable")
    adjusted = np.empty_like(p)
    adjusted[order] = np.minimum(1.0, np.maximum.accumulate(p[order] * (len(p) - np.arange(len(p)))))
    return adjusted


def find_cliques(different: NDArray[np.bool_]) -> tuple[tuple[int, int], ...]:
    """Return the longest series of at least two neighbors of which no two differ, as first and last index.

    Parameters
    ----------
    different
        ``(k, k)``: which methods differ, in the order of their ranks.
    """
    found: list[tuple[int, int]] = []
    for first in range(len(different)):
        last = first
        while last + 1 < len(different) and not different[first : last + 1, last + 1].any():
            last += 1
        if last > first and (not found or last > found[-1][1]):
            found.append((first, last))
    return tuple(found)


def rank_biserial(differences: Sequence[float] | Floats) -> float | None:
    """Compute the matched-pairs rank-biserial correlation, the effect size of Wilcoxon's test.

    It is the sum of the ranks of positive differences minus that of negative ones, over the sum of all ranks: 1 if the
    first method is better on every texture, -1 if it is worse on every texture, 0 if they are even.

    Parameters
    ----------
    differences
        One a texture. Zeros are left out.

    Returns
    -------
    float or None
        In [-1, 1]; None if all differences are zero or there are none.

    References
    ----------
    D. S. Kerby, "The simple difference formula: an approach to teaching nonparametric correlation", Comprehensive
    Psychology 3, 2014.
    """
    values = np.asarray(differences, np.float64)
    values = values[np.isfinite(values) & (values != 0)]
    if not len(values):
        return None
    ranks = rankdata(np.abs(values))
    return float((ranks * np.sign(values)).sum() / ranks.sum())


def find_leading_group(cells: pd.DataFrame, best: Method, ranked: Sequence[Method]) -> tuple[set[str], str]:
    """Return the labels of the leading group, and what the group is.

    A method that shares fewer than half of the best method's textures with it is not in the group: their difference is
    not known.
    """
    behind = _differences(cells, RANKING, best)
    gaps = {one.label: behind[one.label].dropna().to_numpy() for one in ranked if one != best}
    near = {label: gap for label, gap in gaps.items() if 2 * len(gap) >= behind[best.label].count()}
    what = "leading group: the method of the highest mean quality, and the methods"
    if near and all(len(gap) >= FEWEST for gap in near.values()):
        p = adjust_holm(np.array([_signed_rank_p(gap) for gap in near.values()]))
        tied = (p >= ALPHA).tolist()
        rule = f"{what} that do not differ from it over textures (Wilcoxon's test with Holm's correction, 5 %)"
    else:
        tied = [one.low is None or one.low <= 0 for one in estimate_means(list(near.values()))]
        rule = f"{what} whose paired difference to it over textures has a 95 % interval that contains 0"
    return {best.label, *itertools.compress(near, tied)}, rule


def _differences(cells: pd.DataFrame, score: str, first: Method) -> pd.DataFrame:
    """Return a score of ``first`` minus that of every method, by texture and label: means over paired replicates."""
    scores = cells.pivot(index=["texture", "replicate"], columns="label", values=score)
    return scores.rsub(scores[first.label], axis=0).groupby(level="texture").mean()


def _signed_rank_p(differences: Floats) -> float:
    return float(signed_rank_p_values(differences[:, None])[0])


def rank_by_texture(cells: pd.DataFrame, ranked: Sequence[Method]) -> RankTests | None:
    """Return the tests over the textures on which every ranked method has a quality; None with too few."""
    qualities = cells.pivot_table(RANKING, "texture", "label")[[one.label for one in ranked]].dropna()
    return compare_ranks(qualities.to_numpy()) if len(qualities) >= FEWEST and len(ranked) > 1 else None


def compare_with(cells: pd.DataFrame, other: Method, methods: Sequence[Method]) -> list[BaselineDifference]:
    """Return the difference of each method to ``other`` in quality; methods without common textures are left out."""
    gaps = -_differences(cells, RANKING, other)
    known = [one for one in methods if gaps[one.label].notna().any()]
    estimates = estimate_means([gaps[one.label].to_numpy() for one in known])
    clean = [gaps[one.label].dropna().to_numpy() for one in known]
    many = [_signed_rank_p(gap) for gap in clean if len(gap) >= FEWEST]
    adjusted = iter(adjust_holm(np.array(many)).tolist())
    return [
        BaselineDifference(one, estimate, rank_biserial(gap), next(adjusted) if estimate.n >= FEWEST else None)
        for one, gap, estimate in zip(known, clean, estimates, strict=True)
    ]


def list_differences(run: Run, methods: Sequence[Method], cells: pd.DataFrame) -> list[PairedDifference]:
    """Return the differences of all pairs whose first method is no reference, in every headline."""
    pairs = [(a, b) for a, b in itertools.combinations(methods, 2) if not a.reference]
    textures = {str(label): set(names) for label, names in cells.groupby("label")["texture"]}
    common = [len(textures[a.label] & textures[b.label]) for a, b in pairs]
    found = []
    for name in headline_columns(run):
        gaps = {a.label: _differences(cells, name, a) for a in methods if not a.reference}
        estimates = estimate_means([gaps[a.label][b.label].to_numpy() for a, b in pairs], common)
        found += [PairedDifference(name, a, b, one) for (a, b), one in zip(pairs, estimates, strict=True)]
    return found
