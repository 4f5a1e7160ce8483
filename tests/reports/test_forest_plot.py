from __future__ import annotations

from collections.abc import Callable
from typing import Any

import pytest

from nrbench.reports.page.forest_plot import forest_axes
from nrbench.reports.statistics.comparison import Comparison, compare_methods

Make = Callable[..., Any]


def test_points_lie_on_the_axis(every_comparison: Comparison) -> None:
    """Every point and interval lies on its axis, low before value before high."""
    for axis in forest_axes(every_comparison.summary_rows):
        for point in axis.points:
            known = [place for place in (point.low, point.value, point.high) if place is not None]
            assert known == sorted(known)
            assert all(0 <= place <= 100 for place in known)


def test_a_share_uses_the_whole_axis(make_cell: Make, make_run: Make) -> None:
    """A score from 0 to 1 is drawn from 0 to 1, so that 0.9 lies at 90."""
    run = make_run([make_cell("a"), make_cell("b")])
    score = forest_axes(compare_methods(run).summary_rows)[1]
    assert (score.name, score.ends, score.points[0].value) == ("regularity.score", ("0.00", "1.00"), 90)


def test_a_two_sided_score_marks_one(make_cell: Make, make_run: Make) -> None:
    """The axis of a score that is best at 1 contains 1 and marks it."""
    run = make_run([make_cell(values={"randomness.variation": 0.1})])
    axis = next(p for p in forest_axes(compare_methods(run).summary_rows) if p.name == "randomness.variation")
    assert axis.better == "best at 1"
    assert axis.one is not None
    assert axis.points[0].value == pytest.approx(axis.one / 10, abs=0.01)


def test_seconds_are_drawn_by_decades(make_cell: Make, make_run: Make) -> None:
    """Costs lie on a logarithmic axis from decade to decade."""
    run = make_run([make_cell(method="a", seconds=0.01), make_cell(method="b", seconds=1.0)])
    axis = forest_axes(compare_methods(run).summary_rows)[-1]
    assert axis.ends == ("0.010", "1.00")
    assert [point.value for point in axis.points] == [0, 100]


def test_nothing_known_is_drawn_as_nothing(make_cell: Make, make_run: Make) -> None:
    """A failed method has no point."""
    run = make_run([make_cell(status="crash")])
    assert [axis.points[0].value for axis in forest_axes(compare_methods(run).summary_rows)][1:] == [None] * 5
