"""Compare scores with what papers say: the claims of a suite, and the published verdicts of the report of 2004.

A claim is a sentence of a paper, tested on the scores of a run. The published verdicts are tables 2 and 3 of the
report. The textures of a run are analogues of its figures: they were drawn from the descriptions. Rates over many
figures can be compared. A single figure cannot, so the agreement by figure is shown beside the agreement that chance
reaches.
"""

from __future__ import annotations

import csv
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cache
from importlib.resources import files
from typing import ClassVar

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from nrbench.errors import BadInput
from nrbench.plugins.forms import Column
from nrbench.runs.records import Run
from nrbench.streams import stream
from nrbench.suites.claims import Claim, Expectation, Series
from nrbench.suites.plan import PlannedMethod
from nrbench.suites.suite import validated_suite

from .estimates import (
    NO_ESTIMATE,
    Estimate,
    estimate_mean,
    estimate_proportion,
    kappa,
    mean_kappa,
    means_over_textures,
    paired_differences,
    success_rate,
)
from .format import format_interval, format_number
from .method_comparison import Comparison
from .summaries import Method
from .verdicts import MARKS, PRESERVED, QUALITY, RANKING, tabulate_cells

_WORDS = {"less": "less than", "greater": "greater than", "equal": "equal to"}
GROUPS: Mapping[str, tuple[int, int, tuple[str, ...]]] = {
    "figures 3-7": (3, 7, ("graph-cuts", "tile-set", "regularized-patch", "patch-based")),
    "figures 8-29": (8, 29, ("graph-cuts", "tile-set", "regularized-patch", "patch-based")),
    "figures 8-45": (8, 45, ("graph-cuts", "tile-set")),
    "six figures": (16, 36, ("quilting",)),
}
"""The figures on which the report ran methods: the first, the last, and the methods that ran on all of them. Image
quilting ran on six of the figures 16 to 36."""
LATTICES: Mapping[str, tuple[str, ...]] = {
    "tile-set": ("own", "given"),
    "regularized-patch": ("given", "own"),
}
"""The sources of the lattice as in the report, preferred one first: tile-set found its own, and the user drew that of
the regularized patch-based method."""
_SHUFFLES = 2000


@dataclass(frozen=True)
class ClaimSeries:
    """The means of one series of a claim, one for each level."""

    name: str
    levels: Sequence[float]
    methods: Sequence[str]
    estimates: Sequence[Estimate]


@dataclass(frozen=True)
class ExpectationResult:
    """What the scores show of one expectation.

    Parameters
    ----------
    words
        The expectation as a sentence.
    difference
        The first number minus the second, with a 95 % interval over textures.
    outcome
        ``held``, ``failed`` or ``undecided``.
    """

    words: str
    difference: Estimate
    outcome: str


@dataclass(frozen=True)
class ClaimResult:
    """A claim with its measured scores.

    Parameters
    ----------
    claim
        The claim.
    series, expectations
        Its series and expectations, measured.
    column
        The declaration of its score; None if the run does not have the score.
    """

    claim: Claim
    series: Sequence[ClaimSeries]
    expectations: Sequence[ExpectationResult]
    column: Column | None = None

    @property
    def score_with_unit(self) -> str:
        """The name of the score, and its unit if it has one."""
        return f"{self.claim.score}, {self.column.unit}" if self.column and self.column.unit else self.claim.score

    @property
    def outcome(self) -> str:
        """``failed`` if any expectation failed, ``held`` if all held, else ``undecided``."""
        outcomes = {test.outcome for test in self.expectations}
        return "failed" if "failed" in outcomes else "held" if outcomes == {"held"} else "undecided"


def evaluate_claims(run: Run) -> list[ClaimResult]:
    """Return the claims of a run's suite with what the scores show of them; none if the suite has no claims.

    A claim speaks of textures that no suite lists, so intervals are over a population of textures: Wilson's for
    ``regularity.preserved``, else a bootstrap interval, if nine textures differ. A difference of
    two series, or of two levels, is paired by texture and replicate; by family and replicate if the two have no
    texture in common, for example where the levels are sizes of the output.
    """
    content = run.info.get("suite", {}).get("content", {})
    if not content.get("claim"):
        return []
    suite = validated_suite(content, "suite")
    cells = tabulate_cells(run).assign(
        method=[record.method for record in run.cells],
        family=[record.family or record.texture for record in run.cells],
    )
    return [_evaluate(claim, cells, run.columns.get(claim.score)) for claim in suite.claim]


def _evaluate(claim: Claim, cells: pd.DataFrame, column: Column | None) -> ClaimResult:
    """Measure a claim; failures and refusals have the worst score."""
    name = RANKING if claim.score == QUALITY and RANKING in cells else claim.score
    values = cells[name] if name in cells else pd.Series(float("nan"), cells.index)
    if claim.score == PRESERVED:
        values = values.mask(cells["verdict"].isin(["failed", "refused"]), 0.0)
    cells = cells.assign(value=values)
    series = [
        ClaimSeries(
            line.name,
            line.levels,
            [line.method_at(level) for level in line.levels],
            [_estimate(claim, _select(claim, line, level, cells)) for level in line.levels],
        )
        for line in claim.series
    ]
    return ClaimResult(claim, series, [_test(claim, expected, cells) for expected in claim.expect], column)


def _select(claim: Claim, series: Series, level: float, cells: pd.DataFrame) -> pd.DataFrame:
    """Return the cells of a series at a level; none if its method is not installed."""
    try:
        label = PlannedMethod.parse(series.method_at(level)).label
    except BadInput:
        return cells.iloc[:0]
    textures = cells["texture"].map(lambda name: claim.uses(series, level, name))
    return cells[textures.astype(bool) & cells["method"].eq(label)]


def _estimate(claim: Claim, cells: pd.DataFrame) -> Estimate:
    if cells.empty:
        return NO_ESTIMATE
    return success_rate(cells) if claim.score == PRESERVED else means_over_textures(cells, ["value"])["value"]


def _test(claim: Claim, expected: Expectation, cells: pd.DataFrame) -> ExpectationResult:
    lines = {series.name: series for series in claim.series}
    first = _select(claim, lines[expected.series], expected.at, cells)
    words = f"{expected.series} at {expected.at:g} is {_WORDS[expected.relation]} "
    if expected.value is not None:
        difference = _subtract(_estimate(claim, first), expected.value)
        words += f"{expected.value:g}"
    else:
        name = expected.other or expected.series
        level = expected.at if expected.other_at is None else expected.other_at
        difference = _difference(first, _select(claim, lines[name], level, cells))
        words += f"{name} at {level:g}"
    if expected.relation == "equal":
        words += f", within {expected.margin:g}"
    return ExpectationResult(words, difference, _outcome(expected, difference))


def _subtract(mean: Estimate, value: float) -> Estimate:
    """Return an estimate less a number."""
    known, low, high = (None if end is None else end - value for end in (mean.value, mean.low, mean.high))
    return Estimate(known, low, high, mean.n, mean.of)


def _difference(first: pd.DataFrame, second: pd.DataFrame) -> Estimate:
    if first.empty or second.empty:
        return NO_ESTIMATE
    if not set(first["texture"]) & set(second["texture"]):
        first, second = first.assign(texture=first["family"]), second.assign(texture=second["family"])
    return paired_differences(first, second, ["value"])["value"]


def _outcome(expected: Expectation, difference: Estimate) -> str:
    """Return whether the interval of a difference lies where the expectation puts it, elsewhere, or on both sides."""
    if difference.ends is None:
        return "undecided"
    low, high = difference.ends
    if expected.relation == "equal":
        margin = expected.margin
        held, failed = -margin <= low and high <= margin, low > margin or high < -margin
    else:
        held, failed = (high < 0, low > 0) if expected.relation == "less" else (low > 0, high < 0)
    return "held" if held else "failed" if failed else "undecided"


@dataclass(frozen=True)
class PublishedFigure:
    """One figure of the report (tables 2 and 3).

    Parameters
    ----------
    number, description
        As printed.
    kind
        Class of the texture: brick, woven, tiles, motif or damaged. The class is ours, made from the description.
    verdicts
        ``preserved`` or ``lost`` by method; a method that the report did not run on this figure is absent.
    """

    number: int
    description: str
    kind: str
    verdicts: Mapping[str, str]


@cache
def read_published() -> tuple[PublishedFigure, ...]:
    """Return the verdicts of the report's tables 2 and 3, in the order of the figures."""
    text = files(__package__).joinpath("published_verdicts.csv").read_text("utf-8")
    return tuple(
        PublishedFigure(
            int(row.pop("figure")),
            row.pop("description"),
            row.pop("class"),
            {method: word for method, word in row.items() if word},
        )
        for row in csv.DictReader(text.splitlines())
    )


@dataclass(frozen=True)
class FigureRow:
    """One figure: the published verdict and the measured share of each method.

    Parameters
    ----------
    figure
        The figure.
    texture
        Name of the analogue.
    measured
        Share of the replicates that preserve the lattice, for each method of the comparison; None without a verdict.
    """

    figure: PublishedFigure
    texture: str
    measured: Sequence[float | None]


@dataclass(frozen=True)
class RateRow:
    """The published and the measured success rate of a method over the same figures.

    Parameters
    ----------
    group
        A key of :data:`GROUPS`.
    method
        The method as measured.
    published
        The published rate over all figures of the group, with Wilson's interval.
    same, measured
        The published and the measured rate over the figures with a measured verdict, with Wilson's intervals. A figure
        counts as measured preserved if half of its replicates are.
    difference
        Measured minus published over these figures, with a bootstrap interval over figures.
    """

    group: str
    method: Method
    published: Estimate
    same: Estimate
    measured: Estimate
    difference: Estimate


@dataclass(frozen=True)
class ClassRow:
    """The agreement of measured with published verdicts on one class of textures.

    Parameters
    ----------
    kind
        The class; "all" for all figures.
    pairs
        Number of published verdicts with a measured one.
    agreement
        Mean over figures of the share of agreeing verdicts, with a bootstrap interval over figures.
    """

    kind: str
    pairs: int
    agreement: Estimate


@dataclass(frozen=True)
class PublishedComparison:
    """A run beside the report of 2004.

    Parameters
    ----------
    methods
        The methods that the report ran and the run has.
    figures
        The figures whose analogues the run has cells of.
    verdicts
        One row a figure and method: the published verdict and the measured share of preserved replicates.
    rates, classes
        Rates over groups of figures, and the agreement by class of texture.
    types
        For textures of type II (irregular geometry, regular colors) and III (both irregular), which are analogues of no
        figure: for each method the number that preserve the lattice, and the number with a verdict.
    kappa
        Cohen's kappa of measured and published verdicts, figure by figure, with a bootstrap interval over figures. A
        share of one half or more counts as preserved. It has no value if a rater gave a single answer throughout.
    chance
        Mean and 95th percentile of kappa if the published verdicts are paired at random with measured ones of figures
        of the same description; None if kappa has no value.
    """

    methods: Sequence[Method]
    figures: Sequence[FigureRow]
    verdicts: pd.DataFrame
    rates: Sequence[RateRow]
    classes: Sequence[ClassRow]
    types: Mapping[str, Sequence[tuple[float, int]]]
    kappa: Estimate
    chance: tuple[float, float] | None

    sentence: ClassVar[str] = (
        "The textures are analogues, not the report's images: they were drawn from the descriptions of its figures. "
        "They are a fixed list and no sample of a population of textures."
    )

    @property
    def agreement(self) -> str:
        """Kappa and its chance as a sentence."""
        if self.chance is None:
            return "There is no kappa, because one of the two raters gave a single answer throughout."
        value, mean, most = map(format_number, (self.kappa.value, *self.chance))
        ends = f", 95 % interval over figures {format_interval(self.kappa)}" if self.kappa.ends else ""
        return (
            f"Kappa of published and measured verdicts: {value}{ends}. If the published verdicts are paired at random "
            f"with those of figures of the same description: {mean} on average, and {most} or less in 95 % of the "
            "pairings."
        )

    titles: ClassVar[Mapping[bool, str]] = {
        True: "Table 2: regular textures", False: "Table 3: near-regular textures"
    }  # fmt: skip

    def table(self, regular: bool) -> list[FigureRow]:
        """Return the rows of table 2 (regular textures, figures 3 to 7) or of table 3 (figures 8 to 45)."""
        return [row for row in self.figures if (row.figure.number <= 7) == regular]

    def footers(self, regular: bool) -> dict[str, list[tuple[str, str]]]:
        """Return the bottom rows of table 2 or 3 by their names: for each method the published and the measured rate.

        Below the success rate of table 3, which is that of textures of type I, stand those of types II and III.

        A figure without a verdict does not count. The share of a figure's replicates counts as so much of a figure.
        """
        rows = self.table(regular)
        pairs = []
        for i, method in enumerate(self.methods):
            words = [word for row in rows if (word := row.figure.verdicts.get(method.base))]
            shares = [share for row in rows if (share := row.measured[i]) is not None]
            published = _rate_text(words.count("preserved"), len(words))
            pairs.append((published, _rate_text(sum(shares), len(shares))))
        others = {} if regular else self.types
        return {
            "success rate": pairs,
            **{f"type {kind}": [("–", _rate_text(*rate)) for rate in rates] for kind, rates in others.items()},
        }

    def lines(self, regular: bool) -> list[list[str]]:
        """Return table 2 or 3 as text: the heads, a line for each figure, and the success rates.

        In each place the published mark stands before the measured one.
        """
        lines = [["figure", "description", *(method.label for method in self.methods)]]
        for row in self.table(regular):
            words = [MARKS[row.figure.verdicts.get(method.base, "refused")] for method in self.methods]
            shares = [
                "?" if one is None else MARKS["preserved"] if one == 1 else MARKS["lost"] if one == 0 else f"{one:.0%}"
                for one in row.measured
            ]
            marks = [f"{word} {share}" for word, share in zip(words, shares, strict=True)]
            lines.append([str(row.figure.number), row.figure.description, *marks])
        for name, pairs in self.footers(regular).items():
            lines.append([name, "preserved/total", *(f"{published}, {measured}" for published, measured in pairs)])
        return lines


def _rate_text(preserved: float, total: int) -> str:
    return f"{preserved / total:.0%} ({preserved:.3g}/{total})" if total else "–"


def compare_with_published(run: Run, comparison: Comparison) -> PublishedComparison | None:
    """Compare a run with the report; None if it has no analogue of a figure, or none of the report's methods.

    Parameters
    ----------
    run
        The run. The rows of its suite say which texture is the analogue of which figure.
    comparison
        The comparison of the run, which gives the methods.
    """
    rows = run.info.get("suite", {}).get("content", {}).get("texture", [])
    textures = {record.cell.texture for record in run.cells}
    names = {row["figure"]: row["name"] for row in rows if row.get("figure") and row["name"] in textures}
    ran = dict.fromkeys(method for figure in read_published() for method in figure.verdicts)
    methods = [found for name in ran if (found := _find_method(name, comparison.methods)) is not None]
    known = [figure for figure in read_published() if figure.number in names]
    if not known or not methods:
        return None
    cells = tabulate_cells(run)
    shares = [_measured_shares(cells[cells["label"] == method.label]) for method in methods]
    figures = [
        FigureRow(figure, names[figure.number], [own.get(names[figure.number]) for own in shares]) for figure in known
    ]
    verdicts = _tabulate_verdicts(figures, methods)
    pairs = verdicts.dropna(subset="published").astype({"measured_share": float})
    pairs["published"] = pairs["published"].eq("preserved").astype(float)
    observed, chance = _compare_cells(pairs)
    return PublishedComparison(
        methods=methods,
        figures=figures,
        verdicts=verdicts,
        rates=[
            _compare_rates(group, method, part)
            for group, (first, last, names_of_group) in GROUPS.items()
            for method in methods
            if method.base in names_of_group
            and not (part := pairs[pairs["figure"].between(first, last) & pairs["method"].eq(method.name)]).empty
        ],
        classes=[
            _class_agreement(kind, figures, pairs) for kind in [*dict.fromkeys(figure.kind for figure in known), "all"]
        ],
        types=_count_types(run, cells[~cells["texture"].isin(list(names.values()))], methods),
        kappa=observed,
        chance=chance,
    )


def _count_types(run: Run, cells: pd.DataFrame, methods: Sequence[Method]) -> dict[str, list[tuple[float, int]]]:
    """Return for each of the types II and III how many textures each method preserves, and how many have a verdict."""
    found = {}
    for kind in ("II", "III"):
        own = cells[cells["texture"].isin([record.texture for record in run.cells if record.cell.kind == kind])]
        shares = [_measured_shares(own[own["label"] == method.label]) for method in methods]
        if any(shares):
            found[kind] = [(sum(one.values()), len(one)) for one in shares]
    return found


def _find_method(name: str, methods: Sequence[Method]) -> Method | None:
    """Return the column of a method, with default parameters and the report's source of the lattice if it exists."""
    sources = LATTICES.get(name, ())

    def preference(method: Method) -> tuple[bool, int]:
        source = method.lattice_source
        return method.name != name, sources.index(source) if source in sources else len(sources)

    return min((method for method in methods if method.base == name), key=preference, default=None)


def _measured_shares(cells: pd.DataFrame) -> dict[str, float]:
    """Return the share of preserved replicates by texture; failures and refusals count as lost."""
    decided = cells[cells["verdict"].isin(["preserved", "lost", "failed", "refused"])]
    shares = decided["verdict"].eq("preserved").groupby(decided["texture"]).mean()
    return {str(texture): float(share) for texture, share in shares.items()}


def _tabulate_verdicts(figures: Sequence[FigureRow], methods: Sequence[Method]) -> pd.DataFrame:
    """Return one row a figure and method: the published verdict and the measured share of preserved replicates."""
    rows = [
        {
            **{"figure": row.figure.number, "description": row.figure.description, "class": row.figure.kind},
            **{"texture": row.texture, "method": method.name, "lattice_source": method.lattice_source},
            **{"published": row.figure.verdicts.get(method.base), "measured_share": share},
        }
        for row in figures
        for method, share in zip(methods, row.measured, strict=True)
    ]
    return pd.DataFrame(rows)


def _compare_rates(group: str, method: Method, pairs: pd.DataFrame) -> RateRow:
    same, of = pairs.dropna(), len(pairs)
    return RateRow(
        group=group,
        method=method,
        published=estimate_proportion(pairs["published"], of),
        same=estimate_proportion(same["published"], of),
        measured=estimate_proportion(same["measured_share"] >= 0.5, of),
        difference=estimate_mean(same["measured_share"] - same["published"], of),
    )


def _class_agreement(kind: str, figures: Sequence[FigureRow], pairs: pd.DataFrame) -> ClassRow:
    known = pairs[pairs["class"].eq(kind) | (kind == "all")].dropna()
    means = (1 - (known["published"] - known["measured_share"]).abs()).groupby(known["figure"]).mean()
    of = sum(kind in (row.figure.kind, "all") for row in figures)
    return ClassRow(kind, len(known), estimate_mean(means, of))


def _compare_cells(pairs: pd.DataFrame) -> tuple[Estimate, tuple[float, float] | None]:
    """Return kappa figure by figure, and its mean and 95th percentile under random pairing within a description."""
    known = pairs.dropna()
    published, measured = known["published"].to_numpy() > 0, known["measured_share"].to_numpy() >= 0.5
    of_figure = known["figure"].to_numpy() == known["figure"].unique()[:, np.newaxis]
    observed = mean_kappa(np.einsum("fn,ni,nj->fij", of_figure, *_one_hot(published, measured))[np.newaxis])
    if observed.value is None:
        return observed, None
    rng = stream("bootstrap", "published")
    stratum = known.groupby(["description", "method"], sort=False).ngroup().to_numpy()
    groups = [np.flatnonzero(stratum == i) for i in range(stratum.max() + 1)]
    shuffled = np.empty((_SHUFFLES, len(known)), bool)
    for row in shuffled:
        for group in groups:
            row[group] = published[rng.permutation(group)]
    values = kappa(np.einsum("bni,nj->bij", *_one_hot(shuffled, measured)))
    values = values[np.isfinite(values)]
    return observed, (float(values.mean()), float(np.quantile(values, 0.95)))


def _one_hot(*verdicts: NDArray[np.bool_]) -> list[NDArray[np.float64]]:
    """Return each array of verdicts with a last axis: 1 in the place of preserved or of lost."""
    return [np.stack([words, ~words], -1).astype(np.float64) for words in verdicts]
