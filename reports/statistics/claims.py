"""Test the claims of a suite: find whether each sentence of a paper holds on the measured scores."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import pandas as pd

from nrbench.errors import BadInput
from nrbench.plugins.forms import Column
from nrbench.runs.records import Run
from nrbench.suites.claims import Claim, Expectation, Series
from nrbench.suites.plan import PlannedMethod
from nrbench.suites.suite import validated_suite

from .estimates import Estimate, means_over_textures, paired_differences, success_rate
from .verdicts import PRESERVED, QUALITY, RANKING, tabulate_cells

OUTCOMES = ("held", "failed", "undecided")
_WORDS = {"less": "less than", "greater": "greater than", "equal": "equal to"}


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
        One of :data:`OUTCOMES`.
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
        outcomes = {one.outcome for one in self.expectations}
        return "failed" if "failed" in outcomes else "held" if outcomes == {"held"} else "undecided"


def evaluate_claims(run: Run) -> list[ClaimResult]:
    """Return the claims of a run's suite with what the scores show of them; none if the suite has no claims.

    A mean over textures has Wilson's interval for ``regularity.preserved``, else a bootstrap interval. A difference of
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
    return ClaimResult(
        claim,
        [
            ClaimSeries(
                series.name,
                series.levels,
                [series.method_at(level) for level in series.levels],
                [_estimate(claim, _select(claim, series, level, cells)) for level in series.levels],
            )
            for series in claim.series
        ],
        [_test(claim, one, cells) for one in claim.expect],
        column,
    )


def _select(claim: Claim, series: Series, level: float, cells: pd.DataFrame) -> pd.DataFrame:
    """Return the cells of a series at a level; none if its method is not installed."""
    try:
        label = PlannedMethod.parse(series.method_at(level)).label
    except BadInput:
        return cells.iloc[:0]
    textures = cells["texture"].map(lambda name: claim.uses(series, level, name))
    return cells[textures.astype(bool) & cells["method"].eq(label)]


def _scores(claim: Claim, cells: pd.DataFrame) -> pd.DataFrame:
    """Return the cells with the score in the column ``value``; failures and refusals are the worst."""
    name = RANKING if claim.score == QUALITY and RANKING in cells else claim.score
    values = cells[name] if name in cells else pd.Series(float("nan"), cells.index)
    if claim.score == PRESERVED:
        values = values.mask(cells["verdict"].isin(["failed", "refused"]), 0.0)
    return cells.assign(value=values)


def _estimate(claim: Claim, cells: pd.DataFrame) -> Estimate:
    if cells.empty:
        return Estimate(None)
    if claim.score == PRESERVED:
        return success_rate(cells)
    return means_over_textures(_scores(claim, cells), ["value"])["value"]


def _test(claim: Claim, one: Expectation, cells: pd.DataFrame) -> ExpectationResult:
    lines = {series.name: series for series in claim.series}
    first = _select(claim, lines[one.series], one.at, cells)
    begin = f"{one.series} at {one.at:g} is {_WORDS[one.relation]} "
    if one.value is not None:
        mean = _estimate(claim, first)
        difference = _shift(mean, one.value)
        words = f"{begin}{one.value:g}"
    else:
        level = one.at if one.other_at is None else one.other_at
        second = _select(claim, lines[one.other or one.series], level, cells)
        difference = _difference(_scores(claim, first), _scores(claim, second))
        words = f"{begin}{one.other or one.series} at {level:g}"
    if one.relation == "equal":
        words += f", within {one.margin:g}"
    return ExpectationResult(words, difference, _outcome(one, difference))


def _shift(mean: Estimate, value: float) -> Estimate:
    """Return an estimate less a number."""
    if mean.value is None:
        return mean
    low, high = (end - value for end in mean.ends) if mean.ends else (None, None)
    return Estimate(mean.value - value, low, high, mean.n, mean.of)


def _difference(first: pd.DataFrame, second: pd.DataFrame) -> Estimate:
    if first.empty or second.empty:
        return Estimate(None)
    if not set(first["texture"]) & set(second["texture"]):
        first, second = first.assign(texture=first["family"]), second.assign(texture=second["family"])
    return paired_differences(first, second, ["value"])["value"]


def _outcome(one: Expectation, difference: Estimate) -> str:
    """Return whether the interval of a difference lies where the expectation puts it, elsewhere, or on both sides."""
    if difference.ends is None:
        return "undecided"
    low, high = difference.ends
    if one.relation == "equal":
        held, failed = -one.margin <= low and high <= one.margin, low > one.margin or high < -one.margin
    elif one.relation == "less":
        held, failed = high < 0, low > 0
    else:
        held, failed = low > 0, high < 0
    return "held" if held else "failed" if failed else "undecided"


def claims_table(results: Sequence[ClaimResult]) -> pd.DataFrame:
    """Return one row a claim, series and level: the mean with its interval."""
    names = ["claim", "score", "axis", "series", "level", "method", "mean", "low", "high", "n", "of"]
    rows = [
        [
            *(one.claim.name, one.claim.score, one.claim.axis, series.name, level, method),
            *(estimate.value, estimate.low, estimate.high, estimate.n, estimate.of),
        ]
        for one in results
        for series in one.series
        for level, method, estimate in zip(series.levels, series.methods, series.estimates, strict=True)
    ]
    return pd.DataFrame(rows, columns=names)


def claim_tests_table(results: Sequence[ClaimResult]) -> pd.DataFrame:
    """Return one row an expectation: the claim, its quote and outcome, the difference with its interval."""
    names = ["claim", "source", "quote", "claim_outcome", "expectation", "outcome", "difference", "low", "high", "n"]
    rows = [
        [
            *(one.claim.name, one.claim.source, one.claim.quote, one.outcome, test.words, test.outcome),
            *(test.difference.value, test.difference.low, test.difference.high, test.difference.n),
        ]
        for one in results
        for test in one.expectations
    ]
    return pd.DataFrame(rows, columns=names)
