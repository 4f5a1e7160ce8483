"""How far a run is."""

from __future__ import annotations

import dataclasses

from nrbench.running.pace import Pace, Step
from nrbench.suites.cell import Cell, Recipe


def make_cells(labels: list[str]) -> list[Cell]:
    """Return cells that differ in their methods."""
    recipe = Recipe("brick", {}, 0, "wall", 0, (64, 64))
    first = Cell("s", "wall", recipe, "m", "1", {}, "m", False, "none", 0, 0, (64, 64), "")
    return [dataclasses.replace(first, label=label) for label in labels]


def test_the_time_left_knows_each_methods_pace() -> None:
    """The cells left count with the mean of their own method, those of an unknown method with the usual mean."""
    cells = make_cells(["fast", "slow", "fast", "slow", "new"])
    pace = Pace(cells)
    assert pace.step(cells[0], "ok", 1.0, 2).remaining == (1 + 3 * 1) / 2
    step = pace.step(cells[1], "ok", 9.0, 2)
    assert step.remaining == (1 + 9 + 5) / 2
    assert step.remaining_text == "about 8 s left"
    last = [pace.step(cell, status, None, 2) for cell, status in zip(cells[2:], ("ok", "error", "ok"), strict=True)][-1]
    assert (last.done, last.cached, last.failed, last.remaining, last.remaining_text) == (5, 3, 1, 0, "")


def test_a_run_of_cached_cells_has_no_pace() -> None:
    """Nothing is estimated before a cell was run."""
    cells = make_cells(["one", "other"])
    assert Pace(cells).step(cells[0], "ok", None, 1).remaining is None


def test_long_times_are_rounded() -> None:
    """Seconds, minutes and hours are named, each without false precision."""
    left = {30.4: "30 s", 400.0: "7 min", 20_000.0: "6 h"}
    for seconds, text in left.items():
        assert Step(1, 9, 0, 0, "t", "m", "own", "ok", seconds).remaining_text == f"about {text} left"
