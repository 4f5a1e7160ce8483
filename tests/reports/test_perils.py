from __future__ import annotations

import io
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import PIL.Image
import pytest

from nrbench.errors import BadInput
from nrbench.reports.perils import PerilsPlane
from nrbench.reports.plots.perils_plane import caption_text, plot_perils_plane
from nrbench.reports.statistics.method_comparison import Comparison, compare_methods
from nrbench.reports.statistics.summaries import PerilsPoint, perils_points
from nrbench.runs.records import Run

Make = Callable[..., Any]


@pytest.fixture(scope="module")
def comparison(ranked: Run) -> Comparison:
    """Return the comparison of a run with qualities."""
    return compare_methods(ranked)


def _point(comparison: Comparison, method: str) -> PerilsPoint:
    return next(point for point in perils_points(comparison.summaries) if point.method.name == method)


def test_points_are_means_over_textures(comparison: Comparison) -> None:
    """Both coordinates of a point are means over textures, each inside its interval."""
    point = _point(comparison, "good")
    assert point.structure.value == pytest.approx(0.9)
    assert point.randomness.value == pytest.approx(0.69)
    for one in (point.structure, point.randomness):
        assert one.low is not None and one.high is not None and one.value is not None
        assert one.low <= one.value <= one.high


def test_the_smaller_is_taken_before_the_mean(make_cell: Make, make_run: Make) -> None:
    """Tiles out of place on one texture and broken elements on another are two faults; the mean holds both."""
    first = {"regularity": 0.5, "integrity": 1.0, "randomness": 1.0}
    second = {"regularity": 1.0, "integrity": 0.5, "randomness": 1.0}
    run = make_run([make_cell("a", "m", perils=first), make_cell("b", "m", perils=second)])
    assert _point(compare_methods(run), "m").structure.value == pytest.approx(0.5)


def test_without_integrity_regularity_counts_alone(make_cell: Make, make_run: Make) -> None:
    """Where integrity is not measured, the horizontal coordinate is the regularity."""
    run = make_run([make_cell("a", "m", perils={"regularity": 0.8, "randomness": 1.0})])
    assert _point(compare_methods(run), "m").structure.value == pytest.approx(0.8)


def test_a_lost_lattice_has_no_height(comparison: Comparison) -> None:
    """A method that loses every lattice has no vertical coordinate; a method that loses some says how many count."""
    lost, shaky = _point(comparison, "drifter"), _point(comparison, "shaky")
    assert not lost.has_height and lost.structure.n == 3 and "not scored" in lost.words
    assert shaky.has_height and (shaky.randomness.n, shaky.structure.n) == (2, 3)
    assert caption_text(shaky) == "shaky (own) [2 of 3]"


def test_files_are_vector_graphics_and_the_same_again(ranked: Run, comparison: Comparison, tmp_path: Path) -> None:
    """The plane is written as SVG and PDF, without a date, so that equal runs give equal bytes."""
    paths = PerilsPlane().write(ranked, tmp_path)
    assert [path.name for path in paths] == [
        f"{name}.{kind}" for kind in ("svg", "pdf") for name in ("perils", "levels", "cost", "heat-map")
    ]
    first = [path.read_bytes() for path in paths if path.stem == "perils"]
    assert [content[:5] for content in first] == [b"<?xml", b"%PDF-"]
    assert b"<image" not in first[0]
    points = perils_points(comparison.summaries)
    assert first == [plot_perils_plane(kind, points) for kind in ("svg", "pdf")]


def test_the_plane_uses_no_color(comparison: Comparison) -> None:
    """Every color of the picture is a gray, for print in black and white."""
    pixels = np.asarray(
        PIL.Image.open(io.BytesIO(plot_perils_plane("png", perils_points(comparison.summaries)))).convert("RGB")
    )
    assert (np.ptp(pixels.astype(int), axis=2) == 0).all()


def test_no_scores_no_plane(make_cell: Make, make_run: Make, tmp_path: Path) -> None:
    """A run without cells, and a run without qualities, write no picture."""
    assert PerilsPlane().write(make_run([]), tmp_path) == []
    assert PerilsPlane().write(make_run([make_cell()]), tmp_path) == []


def test_width_is_checked() -> None:
    """A width outside the range is an error that states the range."""
    with pytest.raises(BadInput, match="give 3 to 12 inches"):
        PerilsPlane(width=40)
