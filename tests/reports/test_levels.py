from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest

from nrbench.reports.statistics.levels import (
    LevelPanel,
    LevelSeries,
    breaking_points_table,
    compare_levels,
    levels_table,
)
from nrbench.reports.statistics.method_comparison import compare_methods
from nrbench.runs.records import Run

from .conftest import PERILS

Make = Callable[..., Any]


@pytest.fixture(scope="module")
def panel(ranked: Run) -> LevelPanel:
    """Return the panel of a run with three levels of one departure."""
    (panel,) = compare_levels(ranked, compare_methods(ranked))
    return panel


def _series(panel: LevelPanel, method: str) -> LevelSeries:
    return next(one for one in panel.series if one.method.name == method)


def test_a_panel_has_the_methods_the_oracle_and_the_copier(panel: LevelPanel) -> None:
    """Ranked methods come first, then the oracle and the copier; other references have no line."""
    assert (panel.departure, list(panel.levels)) == ("bend", [1.0, 2.0, 4.0])
    names = [one.method.name for one in panel.series]
    assert names == ["close", "good", "refuser", "shaky", "drifter", "oracle", "copier"]


def test_a_method_breaks_at_the_first_level_below_one_half(panel: LevelPanel) -> None:
    """The first level with a quality below 0.5 counts, a refusal is 0, and a good method breaks at no level."""
    assert _series(panel, "refuser").breaks_at == 1
    assert (_series(panel, "good").breaks_at, _series(panel, "good").words) == (None, "–")


def test_levels_keep_the_order_of_the_suite(make_cell: Make, make_run: Make) -> None:
    """Levels go from the first of the suite to the last, also if their numbers fall; unscored levels are counted."""
    shares = (0.5, 0.42, 0.35)
    rows = [{"name": f"t{i}", "departure": "share", "level": level} for i, level in enumerate(shares)]
    qualities = (0.8, None, 0.2)
    cells = [
        make_cell(f"t{i}", perils={} if quality is None else dict.fromkeys(PERILS, quality))
        for i, quality in enumerate(qualities)
    ]
    run = make_run(cells, suite={"content": {"texture": rows}})
    (panel,) = compare_levels(run, compare_methods(run))
    (series,) = panel.series
    assert (list(panel.levels), series.breaks_at, series.count) == ([*shares], 0.35, "2 of 3 levels scored")


def test_one_level_is_no_panel(make_cell: Make, make_run: Make) -> None:
    """A departure at one level has no panel; nor have textures that the run leaves out, nor a run without quality."""
    rows = [{"name": name, "departure": "bend", "level": i} for i, name in enumerate("ab")]
    suite = {"content": {"texture": rows}}
    run = make_run([make_cell("a", perils=dict.fromkeys(PERILS, 1.0))], suite=suite)
    assert compare_levels(run, compare_methods(run)) == []
    run = make_run([make_cell("a"), make_cell("b")], suite=suite)
    assert compare_levels(run, compare_methods(run)) == []


def test_tables_hold_every_level(panel: LevelPanel) -> None:
    """``levels.csv`` has a row a level and method, ``breaking_points.csv`` a row a method."""
    table = levels_table([panel]).set_index(["method", "level"])
    assert len(table) == 3 * len(panel.series)
    assert table.loc[("refuser", 1.0), "quality"] == 0
    points = breaking_points_table([panel]).set_index("method")
    assert points.loc["refuser", "breaks_at"] == 1
    assert np.isnan(points.loc["good", "breaks_at"])
