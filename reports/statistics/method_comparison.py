"""Compare the methods of a run: their ranking by quality, which of them differ, and the table of textures by methods.

Every report format prints the one :class:`Comparison` that :func:`compare_methods` builds.
"""

from __future__ import annotations

import itertools
import math
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import ClassVar, TypeVar

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from nrbench import plugins
from nrbench.errors import BadInput
from nrbench.plugins.parameters import SharedParameters, match_pattern, nearest
from nrbench.runs.records import CellRecord, Run

from .estimates import (
    ALPHA,
    FEWEST,
    FEWEST_DIFFERENT,
    FEWEST_DRAWS,
    Estimate,
    PairTests,
    adjust_means,
    compare_pairs,
    estimate_means,
    mean_of_known,
    stack_draws,
)
from .format import pluralize
from .summaries import (
    Method,
    MethodSummary,
    SummaryRow,
    headline_columns,
    other_score_rows,
    summarize_methods,
    summary_rows,
)
from .verdicts import (
    BOUND_SIGN,
    COMPLETE,
    LEADING_SIGN,
    MARKS,
    PRESERVED,
    QUALITY,
    RANKING,
    SCORE,
    explain_verdict,
    has_quality,
    is_valid_baseline,
    keep_listed_textures,
    method_label,
    tabulate_cells,
    verdict,
)

T = TypeVar("T")
Floats = NDArray[np.float64]
_LEADING = (
    "leading group: the method of the highest mean quality, and the methods that are not significantly worse (sign "
    f"flips within textures, all pairs at once, {100 * ALPHA:g} % for the whole table)"
)
_TOO_FEW = f"no leading group: fewer than {FEWEST} textures cannot tell which methods differ"


@dataclass(frozen=True)
class PairedDifference:
    """The mean difference of two methods in one score, over the textures that both have.

    ``p`` is the p-value of :func:`~nrbench.reports.statistics.estimates.compare_pairs`, adjusted for all pairs of
    ranked methods; None for other pairs, for scores of which no way is better, and without tests.
    """

    score: str
    first: Method
    second: Method
    estimate: Estimate
    p: float | None


@dataclass(frozen=True)
class Improvement:
    """A score of a method as published, with a preset, beside that of the same method as it is by default.

    Parameters
    ----------
    score
        The name of the score.
    published, improved
        The two methods, with the same source of the lattice.
    difference
        The mean of improved minus published, with an interval over textures and draws where nine textures differ.
    p
        As in :class:`PairedDifference`.
    """

    score: str
    published: MethodSummary
    improved: MethodSummary
    difference: Estimate
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

    kind: ClassVar[str] = "entry"

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
    run
        The run.
    summaries
        Each method in numbers: its methods from the highest mean quality to the lowest, then reference methods.
    rows
        The textures.
    differences
        Paired differences between methods.
    tests
        Which of the ranked methods differ in quality; None without a ranking, with fewer than
        :data:`~nrbench.reports.statistics.estimates.FEWEST` textures, and without tests.
    baseline
        The method with which :attr:`against` compares the others; None without a ranking or without tests.
    options
        How the methods are compared.
    """

    run: Run
    summaries: Sequence[MethodSummary]
    rows: Sequence[ComparisonRow]
    differences: Sequence[PairedDifference]
    tests: PairTests | None
    baseline: Method | None
    options: ComparisonOptions

    @cached_property
    def methods(self) -> list[Method]:
        """The methods, in the order of the summaries."""
        return [one.method for one in self.summaries]

    @property
    def ranked(self) -> list[Method]:
        """The ranked methods, best first."""
        return [one.method for one in self.summaries if one.rank]

    @property
    def against(self) -> list[PairedDifference]:
        """The difference of each other method to the baseline in quality."""
        return compare_with(self.differences, self.baseline) if self.baseline else []

    @cached_property
    def improvements(self) -> list[Improvement]:
        """Each headline of each method with the parameters of a preset, beside the default, if the run has both.

        The differences speak of the methods, not of this list of textures: their intervals are over a population.
        """
        found = []
        cells = keep_listed_textures(tabulate_cells(self.run))
        p = {(one.score, frozenset((one.first.label, one.second.label))): one.p for one in self.differences}
        usual = [one for one in self.summaries if not one.method.reference and _is_unchanged(one.method)]
        for published in usual:
            own = published.method
            default = (own.plugin, own.lattice_source, "")
            others = [
                one for one in usual if (one.method.plugin, one.method.lattice_source, one.method.preset) == default
            ]
            for improved in others[:1] if own.preset else ():
                for score in headline_columns(self.run):
                    values = _draws(cells, score, [improved.method, own])
                    gap = estimate_means(values[:1] - values[1:], population=True)[0]
                    tested = p.get((score, frozenset((improved.label, own.label))))
                    found.append(Improvement(score, published, improved, gap, tested))
        return found

    @cached_property
    def score(self) -> str:
        """The score beside the marks: ``quality.score`` if the run has it, else ``regularity.score``."""
        return QUALITY if has_quality(self.run) else SCORE

    @property
    def scored(self) -> bool:
        """Whether the run has verdicts or qualities."""
        return PRESERVED in self.run.columns or self.score == QUALITY

    @cached_property
    def summary_rows(self) -> list[SummaryRow]:
        """The numbers that summarize each method."""
        return summary_rows(self.run, self.summaries)

    @cached_property
    def notes(self) -> list[str]:
        """The notes of methods on their cells; number 1 is the first."""
        return _list_notes(self.run)

    @property
    def counts(self) -> dict[str, int]:
        """Cells by status, the most frequent first."""
        return dict(Counter(record.status for record in self.run.cells).most_common())

    @property
    def textures(self) -> int:
        """Number of textures of the run."""
        return len({record.texture for record in self.run.cells})

    @property
    def title(self) -> str:
        """One line: the suite, its hash, and how many cells ended with each status."""
        suite = self.run.info.get("suite", {})
        name = f"{suite.get('name', 'run')} {suite.get('version', '')}".rstrip()
        sizes = f"{pluralize(self.textures, 'texture')}, {pluralize(len(self.run.cells), 'cell')}"
        ended = ", ".join(f"{count} {status}" for status, count in self.counts.items())
        seed = self.run.seed_text
        fresh = f", {seed}" if seed.startswith("fresh") else ""  # the hash implies any other seed
        return f"{name} ({suite.get('hash', 'no hash')}{fresh}): {sizes}" + (f": {ended}" if ended else "")

    @property
    def estimand(self) -> str:
        """What the means estimate, and what their intervals say, in two sentences."""
        textures = self.textures
        mean, interval = f"this fixed list of {pluralize(textures, 'texture')}, over draws", "Intervals: 95 %, "
        if self.options.population:
            mean = f"a population of textures, of which these {textures} are a sample"
            interval += (
                f"by a hierarchical bootstrap over textures and draws, where {FEWEST_DIFFERENT} textures or more differ"
            )
        elif not any(record.replicate for record in self.run.cells):
            interval = "One draw of each carries no interval of a mean"
        else:
            interval += f"over draws, where there are {FEWEST_DRAWS} of them and {FEWEST} textures scatter"
        return f"Estimated: the mean over {mean}. {interval}."

    @property
    def leading_legend(self) -> str:
        """What the sign of the leading group means in this table, or why there is none; empty without tests."""
        if not (self.options.tests and self.has_ranking) or self.summaries[0].at_most:
            return ""
        return _LEADING if self.tests else _TOO_FEW

    @property
    def legend(self) -> list[tuple[str, str]]:
        """The verdicts that occur, each with its mark."""
        verdicts = {entry.verdict for row in self.rows for entry in row.entries if entry}
        return [(mark, name) for name, mark in MARKS.items() if name in verdicts]

    @property
    def leading_sentence(self) -> str:
        """The legend of the leading group, behind its sign if any method has it; empty without a legend."""
        sign = f"{LEADING_SIGN} " if any(one.leading for one in self.summaries) else ""
        return f"{sign}{self.leading_legend}." if self.leading_legend else ""

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


@dataclass(frozen=True, kw_only=True)
class ComparisonOptions(SharedParameters):
    """How the methods of a run are compared. The reports that show the comparison share these parameters.

    Parameters
    ----------
    tests
        Whether to test which methods differ. Without tests there is no leading group.
    baseline
        The method with which the others are compared, by its name or label; by default the best ranked one.
    population
        Whether intervals are over a population of textures, of which the suite is a sample, else over draws of its own.
    """

    tests: bool = True
    baseline: str = ""
    population: bool = False

    def comparison(self, run: Run) -> Comparison:
        """Return the comparison of a run, as :func:`compare_methods`."""
        return compare_methods(run, self.tests, self.baseline, self.population)


def compare_methods(run: Run, tests: bool = True, baseline: str = "", population: bool = False) -> Comparison:
    """Build the comparison of a run, or return the one that was built before; without rows if the run has no cells.

    Parameters
    ----------
    run
        The run.
    tests, baseline, population
        As in :class:`ComparisonOptions`.

    Raises
    ------
    BadInput
        If the run has no such method, or the name stands for several.
    """
    return run.shared(_build_comparison, ComparisonOptions(tests=tests, baseline=baseline, population=population))


def _build_comparison(run: Run, options: ComparisonOptions) -> Comparison:
    cells = keep_listed_textures(tabulate_cells(run))
    summaries = summarize_methods(run, cells, options.population)
    baseline = _find_method([one.method for one in summaries], options.baseline)
    ranked, found = rank_by_quality(cells, summaries)
    fit = [one.method for one in ranked if one.rank] if options.tests else []
    if not fit:
        ranked = [replace(one, leading=False) for one in ranked]
    tested = found is not None and (any(one.leading for one in ranked) or bool(np.isfinite(found.p).any()))
    methods = [one.method for one in ranked]
    differences = list_differences(run, methods, cells, fit, options.population)
    baseline = (baseline or fit[0]) if fit else None
    return Comparison(
        run=run,
        summaries=ranked,
        rows=_texture_rows(run, methods, QUALITY if has_quality(run) else SCORE),
        differences=differences,
        tests=found if fit and tested else None,
        baseline=baseline if baseline and compare_with(differences, baseline) else None,
        options=options,
    )


def _is_unchanged(method: Method) -> bool:
    """Return whether the parameters of a method are those of its preset, or the defaults of its plugin without one."""
    try:
        return method.parameters == plugins.usual_parameters("synthesizers", method.plugin, method.preset)
    except BadInput:  # it is not installed where the run is read
        return False


def _list_notes(run: Run) -> list[str]:
    return list(dict.fromkeys(record.note for record in run.cells if record.note))


def rank_by_quality(
    cells: pd.DataFrame, summaries: Sequence[MethodSummary]
) -> tuple[list[MethodSummary], PairTests | None]:
    """Rank methods by mean quality, and find the leading group.

    A suite may give each method its own textures; a method that has a quality on fewer than half as many textures as
    the method with the most is not ranked. A ranked method that lacks textures has the mean of :func:`adjust_means`,
    and no interval. A method whose mean is an upper bound stands behind the measured methods that are not significantly
    worse. A method that shares fewer than half of the best one's textures is not in the leading group.

    Parameters
    ----------
    cells
        The table of :func:`~nrbench.reports.statistics.verdicts.tabulate_cells`.
    summaries
        The methods.

    Returns
    -------
    list of MethodSummary
        The summaries, best first, then methods without a rank, then references.
    PairTests or None
        Which of the ranked methods differ, in their order; None if there are none.
    """
    counts = {one.method.label: one.means[RANKING].n for one in summaries if RANKING in one.means}
    candidates = [one for one in summaries if not one.method.reference and counts.get(one.method.label)]
    most = max((counts[one.method.label] for one in candidates), default=0)
    fit = [one for one in candidates if 2 * counts[one.method.label] >= most]
    rest = sorted((one for one in summaries if one not in fit), key=lambda one: one.method.reference)
    if not fit:
        return rest, None
    labels = [one.method.label for one in fit]
    values = mean_of_known(_draws(cells, RANKING, [one.method for one in fit]), 2).T
    values = values[np.isfinite(values).any(1)]
    found, means = compare_pairs(values), adjust_means(values)
    fit = [
        one if np.isfinite(column).all() else _with_mean(one, float(mean))
        for one, mean, column in zip(fit, means, values.T, strict=True)
    ]
    bounded = np.array([one.at_most for one in fit])
    means = means.round(12)
    lowest = [min([mean, *means[~bounded & ~found.better[i]]]) if bounded[i] else mean for i, mean in enumerate(means)]
    places = [(-low, bound, -mean) for low, bound, mean in zip(lowest, bounded.tolist(), means, strict=True)]
    order = sorted(range(len(fit)), key=lambda i: places[i])
    best = order[0]
    near = np.isfinite(found.p[best]) & ~found.better[best] & (2 * found.common[best] >= counts[labels[best]])
    near[best] = len(values) >= FEWEST
    near &= ~bounded & ~bounded[best]
    ranked = [
        replace(fit[i], rank=1 + sum(bool(place < places[i]) for place in places), leading=bool(near[i])) for i in order
    ]
    pick = np.ix_(order, order)
    return [*ranked, *rest], PairTests(found.p[pick], found.better[pick], found.common[pick])


def _with_mean(one: MethodSummary, mean: float) -> MethodSummary:
    """Return a summary with another mean quality, without an interval."""
    estimate = replace(one.means[RANKING], value=min(max(mean, 0.0), 1.0), low=None, high=None)
    return replace(one, means={**one.means, RANKING: estimate})


def _find_method(methods: Sequence[Method], name: str) -> Method | None:
    """Return the method of a label or name; None if the name is empty."""
    if not name:
        return None
    found = [one for one in methods if name == one.label] or [one for one in methods if name in (one.name, one.plugin)]
    if len(found) == 1:
        return found[0]
    labels = ", ".join(one.label for one in found or methods)
    what = "is not unique" if found else "is no method of this run"
    raise BadInput(f"baseline {name!r} {what}; give one of: {labels}")


def _texture_rows(run: Run, methods: Sequence[Method], score: str) -> list[ComparisonRow]:
    notes = {note: number for number, note in enumerate(_list_notes(run), 1)}
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


def match_names(kind: str, patterns: Sequence[str], items: Sequence[tuple[tuple[str, ...], T]]) -> list[T]:
    """Return the items one of whose names is a pattern or matches it, each once, in the order of the patterns.

    Parameters
    ----------
    kind
        What the items are, for the error.
    patterns
        Names, or patterns such as ``brick-*``.
    items
        Each with its names.

    Raises
    ------
    BadInput
        If a pattern names no item.
    """
    found: list[T] = []
    for pattern in patterns:
        wanted = match_pattern(pattern, [name for names, _ in items for name in names])
        known = [item for names, item in items if not wanted.isdisjoint(names)]
        if not known:
            listed = ", ".join(names[0] for names, _ in items)
            raise BadInput(f"no {kind} {pattern!r} in this run; give some of: {listed}")
        found += [item for item in known if item not in found]
    return found


def restrict_comparison(comparison: Comparison, methods: Sequence[str], textures: Sequence[str]) -> Comparison:
    """Return the methods and textures of a comparison that patterns name, in the order of the comparison.

    Ranks, means and tests remain those of all methods on all textures.

    Parameters
    ----------
    comparison
        The comparison.
    methods, textures
        Names or patterns; empty for all. A method has its name, and its name with the source of the lattice in
        parentheses.

    Raises
    ------
    BadInput
        If a pattern names nothing.
    """
    of_methods = [((one.label, one.name), i) for i, one in enumerate(comparison.methods)]
    of_rows = [((row.texture,), row) for row in comparison.rows]
    columns = sorted(match_names("method", methods or "*", of_methods))
    rows = match_names("texture", textures or "*", of_rows)
    return replace(
        comparison,
        summaries=[comparison.summaries[i] for i in columns],
        rows=[replace(row, entries=[row.entries[i] for i in columns]) for row in comparison.rows if row in rows],
    )


def compare_with(differences: Sequence[PairedDifference], other: Method) -> list[PairedDifference]:
    """Return the difference of each method to ``other`` in quality, from those of all pairs."""
    found = [one for one in differences if one.score == RANKING and one.estimate.n]
    turned = [
        replace(one, first=one.second, second=other, estimate=-one.estimate) for one in found if one.first == other
    ]
    return [*turned, *(one for one in found if one.second == other)]


def _draws(cells: pd.DataFrame, score: str, methods: Sequence[Method]) -> Floats:
    """Return a score as ``(methods, textures, draws)``."""
    labels = [one.label for one in methods]
    wide = cells.pivot(index=["texture", "replicate"], columns="label", values=score)
    return stack_draws(wide.reset_index(), labels)


def list_differences(
    run: Run, methods: Sequence[Method], cells: pd.DataFrame, tested: Sequence[Method] = (), population: bool = False
) -> list[PairedDifference]:
    """Return the differences of all pairs whose first method is no reference, in every headline.

    The methods ``tested`` have p-values.
    """
    pairs = [(i, j) for i, j in itertools.combinations(range(len(methods)), 2) if not methods[i].reference]
    textures = [set(cells.loc[cells["label"] == one.label, "texture"]) for one in methods]
    common = [len(textures[i] & textures[j]) for i, j in pairs]
    places = {methods.index(one): k for k, one in enumerate(tested)}
    found = []
    for name, column in headline_columns(run).items():
        values = _draws(cells, name, methods)
        gaps = values[[i for i, _ in pairs]] - values[[j for _, j in pairs]]
        estimates = estimate_means(gaps, common, population)
        p = compare_pairs(mean_of_known(values[list(places)], 2).T).p if places and column.better != "none" else None
        for (i, j), estimate in zip(pairs, estimates, strict=True):
            known = p is not None and i in places and j in places
            value = float(p[places[i], places[j]]) if p is not None and known else math.nan
            found.append(PairedDifference(name, methods[i], methods[j], estimate, None if math.isnan(value) else value))
    return found
