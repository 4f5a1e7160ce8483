"""Compare scores by level of difficulty, with claims of papers, and with the published verdicts of the report of 2004.

A claim is a sentence of a paper, tested on the scores of a run. The published verdicts are tables 2 and 3 of the
report. Both are expectations: a measured number minus an expected one, and whether its interval lies where the paper
puts it. The textures of a run are analogues of the figures of the report: they were drawn from the descriptions. Rates
over many figures can be compared. A single figure cannot, so the agreement by figure is shown beside the agreement that
chance reaches. Where a suite has several levels of a departure, the first level at which a method fails is found.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from functools import cache
from importlib.resources import files
from typing import Any, ClassVar, cast

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from nrbench.errors import BadInput
from nrbench.plugins.forms import Column
from nrbench.runs.records import Run
from nrbench.streams import stream
from nrbench.suites.plan import PlannedMethod
from nrbench.suites.suite import Claim, Expectation, Series, validated_suite

from .estimates import (
    NO_ESTIMATE,
    Estimate,
    estimate_mean,
    estimate_means,
    estimate_proportion,
    kappa,
    mean_kappa,
    means_over_textures,
    stack_draws,
    success_rate,
)
from .format import format_interval, format_number
from .method_comparison import Comparison, ComparisonOptions
from .summaries import Method
from .verdicts import MARKS, PRESERVED, QUALITY, RANKING, has_quality, tabulate_cells

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
BROKEN = 0.5
"""A method breaks at the first level at which its quality is lower. An output whose integrity is lower counts as lost
beside the report of 2004: most of its elements are broken."""


@dataclass(frozen=True)
class ExpectationResult:
    """What the scores show of one expectation.

    Parameters
    ----------
    words
        A claim's expectation as a sentence; for the report of 2004 a key of :data:`GROUPS`.
    difference
        The measured number minus the expected one, with a 95 % interval over textures.
    relation, margin
        What the difference is if the expectation holds: ``less`` or ``greater`` than 0, or ``equal`` to it within a
        margin.
    method
        The method that the report of 2004 rated.
    published
        Its published success rate over all figures of the group, with Wilson's interval.
    expected, measured
        The published and the measured rate over the figures with a measured verdict, with Wilson's intervals. A figure
        counts as measured preserved if half of its replicates are.
    """

    words: str
    difference: Estimate
    relation: str = "equal"
    margin: float = 0.0
    method: Method | None = None
    published: Estimate = NO_ESTIMATE
    expected: Estimate = NO_ESTIMATE
    measured: Estimate = NO_ESTIMATE

    @property
    def outcome(self) -> str:
        """``held`` if the interval lies as expected, ``failed`` if elsewhere, ``undecided`` if on both sides."""
        if self.difference.ends is None:
            return "undecided"
        low, high = self.difference.ends
        held, failed = {
            "less": (high < 0, low > 0),
            "greater": (low > 0, high < 0),
            "equal": (-self.margin <= low and high <= self.margin, low > self.margin or high < -self.margin),
        }[self.relation]
        return "held" if held else "failed" if failed else "undecided"


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
    series: Sequence[LevelSeries]
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
        parameters=pd.Series([(record.cell.method, dict(record.parameters)) for record in run.cells], dtype=object),
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
        LevelSeries(
            line.name,
            line.levels,
            [_estimate(claim, _select(claim, line, level, cells)) for level in line.levels],
        )
        for line in claim.series
    ]
    return ClaimResult(claim, series, [_test(claim, expected, cells) for expected in claim.expect], column)


def _select(claim: Claim, series: Series, level: float, cells: pd.DataFrame) -> pd.DataFrame:
    """Return the cells of a series at a level; none if its method is not installed."""
    try:
        method = PlannedMethod.parse(series.method_at(level))
    except BadInput:
        return cells.iloc[:0]
    textures = cells["texture"].map(lambda name: claim.uses(series, level, name))
    named = cells["method"].eq(method.label)
    if not named.any():  # an older run has other names
        named = cells["parameters"].map(lambda one: one == (method.name, method.parameters)).astype(bool)
    return cells[textures.astype(bool) & named]


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
    return ExpectationResult(words, difference, expected.relation, expected.margin)


def _subtract(mean: Estimate, value: float) -> Estimate:
    """Return an estimate less a number."""
    known, low, high = (None if end is None else end - value for end in (mean.value, mean.low, mean.high))
    return Estimate(known, low, high, mean.n, mean.of)


def _difference(first: pd.DataFrame, second: pd.DataFrame) -> Estimate:
    """Return the mean of first minus second, paired by texture and replicate: both received the same sample."""
    if first.empty or second.empty:
        return NO_ESTIMATE
    if not set(first["texture"]) & set(second["texture"]):
        first, second = first.assign(texture=first["family"]), second.assign(texture=second["family"])
    both = first.merge(second, on=["texture", "replicate"], suffixes=("", "_second"))
    return means_over_textures(both.assign(value=both["value"] - both["value_second"]), ["value"])["value"]


@cache
def read_published() -> pd.DataFrame:
    """Return the verdicts of the report's tables 2 and 3, in the order of the figures.

    Returns
    -------
    pandas.DataFrame
        One row a ``figure``: its ``description`` as printed, the ``class`` of the texture (brick, woven, tiles, motif
        or damaged), which is ours, made from the description, and for each method ``preserved`` or ``lost``, or None
        where the report did not run it.
    """
    text = files(__package__).joinpath("published_verdicts.csv")
    with text.open(encoding="utf-8") as file:
        table = pd.read_csv(file)
    return table.astype(object).where(table.notna(), None)


@dataclass(frozen=True)
class PublishedEntry:
    """The published and the measured verdict of a method on a figure.

    Parameters
    ----------
    published
        ``preserved`` or ``lost``; None if the report did not run the method.
    measured
        Share of the replicates that preserve the regularity (:attr:`PublishedComparison.rule`), in [0, 1]; None without
        a verdict.
    lattice
        Share of the replicates that preserve the lattice.
    """

    published: str | None
    measured: float | None
    lattice: float | None

    kind: ClassVar[str] = "published"

    @property
    def text(self) -> str:
        """The published mark, then the measured one, or the measured share where replicates disagree."""
        known: dict[float | None, str] = {None: "?", 0: MARKS["lost"], 1: MARKS["preserved"]}
        measured = known.get(self.measured, f"{self.measured or 0:.0%}")
        return f"{MARKS[self.published or 'refused']} {measured}"


@dataclass(frozen=True)
class PublishedComparison:
    """A run beside the report of 2004.

    Parameters
    ----------
    methods
        The methods that the report ran and the run has.
    verdicts
        One row a figure and method: the published verdict, the measured share of preserved replicates, and the share
        whose lattice is preserved, whole elements or not.
    rates
        The published and the measured success rates over groups of figures.
    classes
        One row a class of textures, the figures of odd and of even number, all by their lattices alone, and "all": the
        number of published ``pairs`` with a measured verdict; the ``agreement``, the mean over figures of the share of
        agreeing verdicts, with a bootstrap interval over figures; ``kappa``, Cohen's kappa of measured and published
        verdicts, figure by figure, with such an interval, in which a share of one half or more counts as preserved; and
        ``chance``, mean and 95th percentile of kappa if the published verdicts are paired at random with measured ones
        of figures of the same description. Kappa has no value, and chance is None, if a rater gave a single answer.
    types
        For textures of type II (irregular geometry, regular colors) and III (both irregular), which are analogues of no
        figure: for each method the number that preserve the lattice, and the number with a verdict.
    """

    methods: Sequence[Method]
    verdicts: pd.DataFrame
    rates: Sequence[ExpectationResult]
    classes: pd.DataFrame
    types: Mapping[str, Sequence[tuple[float, int]]]

    sentence: ClassVar[str] = (
        "The textures are analogues, not the report's images: they were drawn from the descriptions of its figures. "
        "They are a fixed list and no sample of a population of textures."
    )
    rule: ClassVar[str] = (
        "As the report counts broken elements, an output is preserved if its lattice is and, where its integrity is "
        f"known, at least {BROKEN:.0%} of its elements are whole."
    )
    titles: ClassVar[Mapping[bool, str]] = {
        True: "Table 2: regular textures", False: "Table 3: near-regular textures"
    }  # fmt: skip

    @property
    def kappa(self) -> Estimate:
        """Kappa over all figures."""
        return cast(Estimate, self.classes["kappa"].iloc[-1])

    @property
    def chance(self) -> tuple[float, float] | None:
        """Kappa of random pairings over all figures: its mean and its 95th percentile."""
        return cast("tuple[float, float] | None", self.classes["chance"].iloc[-1])

    @property
    def agreement(self) -> str:
        """Kappa and its chance as sentences: over all figures, over those of odd and even number, by the lattice."""
        if self.chance is None:
            return "There is no kappa, because one of the two raters gave a single answer throughout."
        value, mean, most = map(format_number, (self.kappa.value, *self.chance))
        interval = format_interval(self.kappa)
        ends = f", 95 % interval over figures {interval}" if interval else ""
        parts = (
            f"{row['class']}: {format_number(row['kappa'].value)} {format_interval(row['kappa'])}".rstrip()
            for row in self.classes.iloc[-4:-1].to_dict("records")
        )
        return (
            f"Kappa of published and measured verdicts: {value}{ends}. If the published verdicts are paired at random "
            f"with those of figures of the same description: {mean} on average, and {most} or less in 95 % of the "
            f"pairings. Kappa of {'; '.join(parts)}. {self.rule}"
        )

    def table(self, regular: bool) -> list[tuple[int, str, str, list[PublishedEntry]]]:
        """Return the rows of table 2 (regular textures, figures 3 to 7) or of table 3 (figures 8 to 45).

        A row is the number of the figure, its description, its class and an entry for each method.
        """
        found: dict[tuple[int, str, str], list[PublishedEntry]] = {}
        for row in self.verdicts[self.verdicts["figure"].le(7) == regular].to_dict("records"):
            figure = (row["figure"], row["description"], row["class"])
            entry = PublishedEntry(*_known(row[name] for name in ("published", *_SHARES)))
            found.setdefault(figure, []).append(entry)
        return [(*figure, entries) for figure, entries in found.items()]

    def footers(self, regular: bool) -> dict[str, list[tuple[str, str]]]:
        """Return the bottom rows of table 2 or 3 by their names: for each method the published and the measured rate.

        The rate of the lattice alone follows. Below the rates of table 3, which are those of textures of type I, stand
        those of types II and III.

        A figure without a verdict does not count. The share of a figure's replicates counts as so much of a figure.
        """
        pairs, alone = [], []
        for column in zip(*(entries for *_, entries in self.table(regular)), strict=True):
            words = [one.published for one in column if one.published]
            shares = [one.measured for one in column if one.measured is not None]
            lattices = [one.lattice for one in column if one.lattice is not None]
            pairs.append((_rate_text(words.count("preserved"), len(words)), _rate_text(sum(shares), len(shares))))
            alone.append(("–", _rate_text(sum(lattices), len(lattices))))
        others = {} if regular else self.types
        return {
            "success rate": pairs or [("–", "–")] * len(self.methods),
            "lattice alone": alone or [("–", "–")] * len(self.methods),
            **{f"type {kind}": [("–", _rate_text(*rate)) for rate in rates] for kind, rates in others.items()},
        }


def _known(values: Iterable[Any]) -> list[Any]:
    return [None if pd.isna(value) else value for value in values]


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
    return run.shared(_compare_with_published, comparison.options)


def _compare_with_published(run: Run, options: ComparisonOptions) -> PublishedComparison | None:
    rows = run.info.get("suite", {}).get("content", {}).get("texture", [])
    textures = {record.cell.texture for record in run.cells}
    names = {row["figure"]: row["name"] for row in rows if row.get("figure") and row["name"] in textures}
    published = read_published()
    known_methods = options.comparison(run).methods
    methods = [found for name in published.columns[3:] if (found := _find_method(name, known_methods)) is not None]
    known = published[published["figure"].isin(list(names))]
    if known.empty or not methods:
        return None
    cells = tabulate_cells(run)
    shares = _measured_shares(cells)
    verdicts = pd.DataFrame(
        {
            **{"figure": row["figure"], "description": row["description"], "class": row["class"]},
            **{"texture": names[row["figure"]], "method": method.name, "lattice_source": method.lattice_source},
            **{"published": row[method.plugin]},
            **shares.get((method.label, names[row["figure"]]), dict.fromkeys(_SHARES)),
        }
        for row in known.to_dict("records")
        for method in methods
    )
    verdicts = verdicts.astype(dict.fromkeys(_SHARES, object)).where(verdicts.notna(), None)
    pairs = verdicts.dropna(subset="published").astype(dict.fromkeys(_SHARES, float))
    pairs["published"] = pairs["published"].eq("preserved").astype(float)
    alone = pairs.assign(measured_share=pairs["lattice_share"])
    parts = {kind: pairs[pairs["class"] == kind] for kind in known["class"].unique()}
    parts |= {name: pairs[pairs["figure"] % 2 == odd] for name, odd in (("odd figures", 1), ("even figures", 0))}
    others = cells[~cells["texture"].isin(list(names.values()))]
    return PublishedComparison(
        methods=methods,
        verdicts=verdicts,
        rates=[
            _compare_rates(group, method, part)
            for group, (first, last, names_of_group) in GROUPS.items()
            for method in methods
            if method.plugin in names_of_group
            and not (part := pairs[pairs["figure"].between(first, last) & pairs["method"].eq(method.name)]).empty
        ],
        classes=pd.DataFrame(
            _class_agreement(kind, part) for kind, part in {**parts, "all, lattice alone": alone, "all": pairs}.items()
        ),
        types=_count_types(run, others, shares, methods),
    )


def _count_types(
    run: Run, cells: pd.DataFrame, shares: Mapping[tuple[str, str], Mapping[str, Any]], methods: Sequence[Method]
) -> dict[str, list[tuple[float, int]]]:
    """Return for each of the types II and III how many textures each method preserves, and how many have a verdict."""
    found = {}
    for kind in ("II", "III"):
        names = sorted(set(cells["texture"]) & {record.texture for record in run.cells if record.cell.kind == kind})
        counted = [[shares.get((one.label, name)) for name in names] for one in methods]
        known = [[share["measured_share"] for share in one if share] for one in counted]
        if any(known):
            found[kind] = [(sum(one), len(one)) for one in known]
    return found


def _find_method(name: str, methods: Sequence[Method]) -> Method | None:
    """Return the column of a method, with default parameters and the report's source of the lattice if it exists."""
    sources = LATTICES.get(name, ())

    def preference(method: Method) -> tuple[bool, int]:
        source = method.lattice_source
        return method.name != name, sources.index(source) if source in sources else len(sources)

    return min((method for method in methods if method.plugin == name), key=preference, default=None)


_SHARES = ("measured_share", "lattice_share")


def _measured_shares(cells: pd.DataFrame) -> dict[tuple[str, str], dict[str, float]]:
    """Return the shares of replicates that are preserved by method and texture; failures and refusals count as lost.

    The report calls its figure 16 not preserved because of single wrong cans. So an output with a preserved lattice
    counts as lost if its integrity is known and below :data:`BROKEN`. The second share counts lattices alone.
    """
    decided = cells[cells["verdict"].isin(["preserved", "lost", "failed", "refused"])]
    lattice = decided["verdict"].eq("preserved")
    broken = decided["integrity.score"].lt(BROKEN) if "integrity.score" in decided else False
    kept = pd.DataFrame({"measured_share": lattice & ~broken, "lattice_share": lattice})
    shares = kept.groupby([decided["label"], decided["texture"]]).mean()
    return cast(dict[tuple[str, str], dict[str, float]], shares.to_dict("index"))


def _compare_rates(group: str, method: Method, pairs: pd.DataFrame) -> ExpectationResult:
    same, of = pairs.dropna(), len(pairs)
    return ExpectationResult(
        words=group,
        method=method,
        published=estimate_proportion(pairs["published"], of),
        expected=estimate_proportion(same["published"], of),
        measured=estimate_proportion(same["measured_share"] >= 0.5, of),
        difference=estimate_mean(same["measured_share"] - same["published"], of),
    )


def _class_agreement(kind: str, pairs: pd.DataFrame) -> dict[str, object]:
    """Return the row of some pairs in :attr:`PublishedComparison.classes`."""
    known, of = pairs.dropna(), pairs["figure"].nunique()
    means = (1 - (known["published"] - known["measured_share"]).abs()).groupby(known["figure"]).mean()
    observed, chance = _compare_cells(known)
    return {
        **{"class": kind, "pairs": len(known), "agreement": estimate_mean(means, of)},
        **{"kappa": observed, "chance": chance},
    }


def _compare_cells(known: pd.DataFrame) -> tuple[Estimate, tuple[float, float] | None]:
    """Return kappa figure by figure, and its mean and 95th percentile under random pairing within a description."""
    published, measured = known["published"].to_numpy() > 0, known["measured_share"].to_numpy() >= 0.5
    of_figure = known["figure"].to_numpy() == known["figure"].unique()[:, np.newaxis]
    observed = mean_kappa(np.einsum("fn,ni,nj->fij", of_figure, *_one_hot(published, measured))[np.newaxis])
    if observed.value is None:
        return observed, None
    rng = stream("bootstrap", "published")
    shuffled = np.tile(published, (_SHUFFLES, 1))
    for group in known.groupby(["description", "method"], sort=False).indices.values():
        shuffled[:, group] = rng.permuted(shuffled[:, group], axis=1)
    values = kappa(np.einsum("bni,nj->bij", *_one_hot(shuffled, measured)))
    values = values[np.isfinite(values)]
    return observed, (float(values.mean()), float(np.quantile(values, 0.95)))


def _one_hot(*verdicts: NDArray[np.bool_]) -> list[NDArray[np.float64]]:
    """Return each array of verdicts with a last axis: 1 in the place of preserved or of lost."""
    return [np.stack([words, ~words], -1).astype(np.float64) for words in verdicts]


_REFERENCES = ("oracle", "copier")


@dataclass(frozen=True)
class LevelSeries:
    """A score at several levels: of a method at each level of a departure, or of a line of a claim's panel.

    Parameters
    ----------
    name
        The label of the method, or the name of the line.
    levels
        The levels; those of a departure from the easiest to the hardest.
    estimates
        Mean score over the textures of each level. In a quality, a failed or refused cell counts 0.
    method
        The method; None for the line of a claim, which may have a method for each level.
    """

    name: str
    levels: Sequence[float]
    estimates: Sequence[Estimate]
    method: Method | None = None

    @property
    def scored(self) -> list[tuple[int, float]]:
        """The levels with a quality, as index and quality."""
        return [(i, one.value) for i, one in enumerate(self.estimates) if one.value is not None]

    @property
    def breaks_at(self) -> float | None:
        """The first level at which the quality is below :data:`BROKEN`; None if there is none."""
        return next((self.levels[i] for i, value in self.scored if value < BROKEN), None)

    @property
    def words(self) -> str:
        """The level at which the method breaks, a dash if there is none."""
        if not self.scored:
            return "not scored"
        return "–" if self.breaks_at is None else f"{self.breaks_at:g}"

    @property
    def count(self) -> str:
        """How many levels have a quality; empty if all or none have."""
        n, of = len(self.scored), len(self.levels)
        return f"{n} of {of} levels scored" if 0 < n < of else ""


@dataclass(frozen=True)
class LevelPanel:
    """One departure with at least two levels.

    Parameters
    ----------
    departure
        Its name.
    levels
        Its levels in the order of the suite, from the easiest to the hardest.
    series
        One for each method: the ranked methods, then the oracle and the copier.
    """

    departure: str
    levels: Sequence[float]
    series: Sequence[LevelSeries]


def compare_levels(run: Run, comparison: Comparison) -> list[LevelPanel]:
    """Return a panel for each departure whose textures have two levels or more; none without a quality.

    Parameters
    ----------
    run
        The run. Its suite gives the departure and the level of each texture.
    comparison
        The comparison of the run, which gives the order of the methods.
    """
    if not has_quality(run):
        return []
    cells = tabulate_cells(run)
    rows = run.info.get("suite", {}).get("content", {}).get("texture", [])
    groups: dict[str, dict[float, list[str]]] = {}
    for row in rows:
        if row.get("departure") and row.get("level") is not None and cells["texture"].eq(row["name"]).any():
            groups.setdefault(row["departure"], {}).setdefault(float(row["level"]), []).append(row["name"])
    methods = [method for method in comparison.methods if not method.reference or method.plugin in _REFERENCES]
    panels = [
        LevelPanel(departure, list(names), [_level_series(method, names, cells) for method in methods])
        for departure, names in groups.items()
        if len(names) > 1
    ]
    return [panel for panel in panels if any(series.scored for series in panel.series)]


def _level_series(method: Method, names: dict[float, list[str]], cells: pd.DataFrame) -> LevelSeries:
    rows = cells[cells["label"] == method.label]
    parts = (rows[rows["texture"].isin(textures)] for textures in names.values())
    means = [estimate_means(stack_draws(part, [RANKING]))[0] for part in parts]
    return LevelSeries(method.label, list(names), means, method)
