from __future__ import annotations

from collections.abc import Callable
from typing import Any

import pytest

from nrbench.reports.plots.forest_plot import panels
from nrbench.reports.statistics.comparison import comparison
from nrbench.reports.statistics.summary import headlines
from nrbench.runs.records import Run

Make = Callable[..., Any]


def test_places_lie_on_the_axis(every_ending: Run) -> None:
    """Every point and interval lies on its axis, low before value before high."""
    for panel in panels(comparison(every_ending).summaries, headlines(every_ending)):
        for strip in panel.strips:
            known = [place for place in (strip.low, strip.value, strip.high) if place is not None]
            assert known == sorted(known)
            assert all(0 <= place <= 100 for place in known)


def test_a_share_uses_the_whole_axis(make_cell: Make, make_run: Make) -> None:
    """A score from 0 to 1 is drawn from 0 to 1, so that 0.9 lies at 90."""
    run = make_run([make_cell("a"), make_cell("b")])
    score = panels(comparison(run).summaries, headlines(run))[1]
    assert (score.name, score.ends, score.strips[0].value) == ("regularity.score", ("0.00", "1.00"), 90)


def test_a_two_sided_score_marks_one(make_cell: Make, make_run: Make) -> None:
    """Where 1 is best, the axis holds 1 and marks it."""
    run = make_run([make_cell(values={"randomness.variation": 0.1})])
    panel = next(p for p in panels(comparison(run).summaries, headlines(run)) if p.name == "randomness.variation")
    assert panel.better == "best at 1"
    assert panel.one is not None
    assert panel.strips[0].value == pytest.approx(panel.one / 10, abs=0.01)


def test_seconds_are_drawn_by_decades(make_cell: Make, make_run: Make) -> None:
    """Costs lie on a logarithmic axis from decade to decade."""
    run = make_run([make_cell(method="a", seconds=0.01), make_cell(method="b", seconds=1.0)])
    panel = panels(comparison(run).summaries, headlines(run))[-1]
    assert panel.ends == ("0.010", "1.00")
    assert [strip.value for strip in panel.strips] == [0, 100]


def test_nothing_known_is_drawn_as_nothing(make_cell: Make, make_run: Make) -> None:
    """A failed method has a line without a point."""
    run = make_run([make_cell(status="crash")])
    assert [panel.strips[0].value for panel in panels(comparison(run).summaries, headlines(run))][1:] == [None] * 5
