from __future__ import annotations

from collections.abc import Callable
from typing import Any

import pytest

from nrbench.reports.page.forest_plot import forest_axes
from nrbench.reports.statistics.method_comparison import compare_methods

Make = Callable[..., Any]


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
