"""The foot of the comparison: success rates, means and ranks of every column, each with its interval."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from nrbench.runs.records import Run

from ..page.format import counted, interval, number, percent, successes, tip
from .randomness_kept import KEPT
from .statistics import Estimate
from .summary import COSTS, Summary, headlines, headlines_first, known_columns
from .verdicts import PRESERVED, SCORE

RATE_MEANING = (
    "Share of textures whose lattice is preserved, with Wilson's 95 % interval over textures; a texture counts as the "
    "mean over its replicates. Failures and refusals count as not preserved; undecided cells are left out."
)
MEAN_MEANING = "Mean over textures, with a 95 % bootstrap interval; a texture counts as the mean over its replicates."
UNDECIDED = " Undecided cells are left out."
RANK_MEANING = (
    "Mean rank among the methods over textures (1 is best), with a 95 % bootstrap interval. A failure, a refusal, or "
    "no score because the lattice is lost takes the worst rank; reference rows are not ranked."
)


@dataclass(frozen=True)
class FootRow:
    """A line at the foot: one estimate a column.

    Parameters
    ----------
    name, meaning
        What it is called, and what it says.
    estimates
        One a column; None where there is none.
    rate
        Whether it is a success rate.
    """

    name: str
    meaning: str
    estimates: Sequence[Estimate | None]
    rate: bool = False

    @property
    def values(self) -> list[str]:
        """The numbers in words; a dash where there is none."""
        text = percent if self.rate else number
        return [text(estimate.value) if estimate else "–" for estimate in self.estimates]

    @property
    def intervals(self) -> list[str]:
        """The intervals in words; empty where there is none."""
        return [interval(estimate, self.rate) if estimate else "" for estimate in self.estimates]

    @property
    def counts(self) -> list[str]:
        """For a rate, how many textures of those counted; else how many were counted of all."""
        text = successes if self.rate else counted
        return [text(estimate) if estimate else "" for estimate in self.estimates]


def foot(run: Run, summaries: Sequence[Summary]) -> list[FootRow]:
    """Return the lines at the foot of a run's comparison; none where it has no columns."""
    if not summaries:
        return []
    rates = [_row("preserved", RATE_MEANING, [one.success for one in summaries], rate=True)]
    if any(one.counts["refused"] for one in summaries):
        meaning = RATE_MEANING.replace("Failures and refusals count", "Refusals are left out; failures count")
        rates.append(_row("… refusals left out", meaning, [one.success_answered for one in summaries], rate=True))
    means = [
        _row(
            name, f"{tip(column)}\n{MEAN_MEANING}{UNDECIDED * (name == SCORE)}", [one.means[name] for one in summaries]
        )
        for name, column in headlines(run).items()
    ]
    return [*rates, *means, *_rank_rows(run, summaries)]


def others(run: Run, summaries: Sequence[Summary]) -> list[FootRow]:
    """Return a line for the means of each further score that any column has: no headline, and never ranked.

    Wall time and peak memory are shown once, as the cells have them: the metric ``cost`` repeats them.
    """
    shown = {*headlines(run), PRESERVED, KEPT, *(f"cost.{name}" for name in COSTS)}
    columns = known_columns(run)
    rows = [
        _row(name, f"{tip(columns[name])}\n{MEAN_MEANING}", [one.means[name] for one in summaries])
        for name in headlines_first(columns)
        if name not in shown
    ]
    return [row for row in rows if any(row.estimates)]


def _rank_rows(run: Run, summaries: Sequence[Summary]) -> list[FootRow]:
    """Return the ranks by each headline; one method alone is not ranked."""
    if sum(not one.head.reference for one in summaries) < 2:
        return []
    names = [name for name, column in headlines(run).items() if column.better != "none"]
    return [_row(f"rank: {name}", RANK_MEANING, [one.ranks.get(name) for one in summaries]) for name in names]


def _row(name: str, meaning: str, estimates: Sequence[Estimate | None], rate: bool = False) -> FootRow:
    return FootRow(name, meaning, [estimate if estimate and estimate.n else None for estimate in estimates], rate)
