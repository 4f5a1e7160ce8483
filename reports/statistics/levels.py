"""Find where each method breaks: its quality at each level of each departure of a suite."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import pandas as pd

from nrbench.runs.records import Run

from .estimates import Estimate, estimate_means, stack_draws
from .method_comparison import Comparison
from .summaries import Method
from .verdicts import RANKING, has_quality, tabulate_cells

BROKEN = 0.5
"""A method breaks at the first level at which its quality is lower."""
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
    methods = [method for method in comparison.methods if not method.reference or method.base in _REFERENCES]
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
