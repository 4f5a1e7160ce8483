"""A run in Python: its tables, its plot, and what a notebook shows."""

from __future__ import annotations

from pathlib import Path

import pytest

from nrbench.errors import BadInput
from nrbench.runs.records import Run

from .conftest import HOSTILE, PERILS, MakeCell, MakeRun


@pytest.fixture
def ranked(make_cell: MakeCell, make_run: MakeRun) -> Run:
    """Return a run of two methods with known qualities."""
    cells = [
        make_cell(f"t{i}", method, perils=dict.fromkeys(PERILS, quality))
        for i in range(3)
        for method, quality in (("rsgf", 0.75), (HOSTILE, 0.25))
    ]
    return make_run(cells)


def test_a_run_has_its_tables(ranked: Run) -> None:
    """The summary has one row a method with the mean quality; the comparison has one row a texture."""
    summary, comparison = ranked.summary(), ranked.comparison()
    assert summary.loc[("rsgf", "own"), "quality"] == pytest.approx(0.75)
    assert list(comparison.index) == ["t0", "t1", "t2"]
    assert comparison.loc["t1", "rsgf (own) verdict"] == "preserved"


def test_a_notebook_shows_the_methods(ranked: Run) -> None:
    """The HTML is a table with both methods, in which no name is markup."""
    shown = ranked._repr_html_()
    assert "<table" in shown and "rsgf" in shown and "0.75" in shown
    assert "<img" not in shown and "&lt;img" in shown


def test_a_plot_is_shown_and_saved(ranked: Run, tmp_path: Path) -> None:
    """A notebook gets SVG; the ending of a path chooses the kind of file; another one is refused."""
    plot = ranked.plot(width=4)
    assert plot._repr_svg_().lstrip().startswith("<?xml") and "svg" in plot._repr_svg_()
    assert plot.save(tmp_path / "plane.pdf").read_bytes().startswith(b"%PDF")
    with pytest.raises(BadInput, match=r"end the name in \.svg"):
        plot.save(tmp_path / "plane.gif")


def test_a_run_without_quality_has_no_plot(make_cell: MakeCell, make_run: MakeRun) -> None:
    """The message says why there is nothing to plot."""
    with pytest.raises(BadInput, match="no method has a quality"):
        make_run([make_cell()]).plot()._repr_svg_()
