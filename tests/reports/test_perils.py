from __future__ import annotations

import io
import math
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import PIL.Image
import pytest
from hypothesis import given
from hypothesis import strategies as st

from nrbench.errors import BadInput
from nrbench.reports.perils import PerilsPlane, caption_text, overlap, place_captions, plot_perils_plane, wrap_caption
from nrbench.reports.statistics.comparison import (
    Comparison,
    Method,
    PerilsPoint,
    compare_methods,
    perils_points,
    perils_table,
)
from nrbench.reports.statistics.estimates import Estimate
from nrbench.reports.statistics.verdicts import RANDOMNESS_KEPT, WALLPAPER, BaselineValidity, randomness_kept
from nrbench.runs.records import CellRecord, Run

Make = Callable[..., Any]


@pytest.mark.parametrize(
    ("variation", "repetition", "distance", "expected"),
    [
        *[(1, 0, 0, 1), (0.5, 0, 0, 0.5), (2, 0, 0, 0.5), (1, 1, 0, 0.5), (1, 3, 0, 0.25), (0, 0, 0, 0)],
        *[(1, -0.2, -0.1, 1), (0.8, 1, 0, 0.5), (1, 0, WALLPAPER / 2, 0.5), (1, 0, 1, 0), (0.4, 0, WALLPAPER / 2, 0.4)],
    ],
)
def test_randomness_kept_is_the_worst_departure(
    variation: float, repetition: float, distance: float, expected: float
) -> None:
    """Variation counts on both sides, repetition and distance on one side only; the worst of the three is kept."""
    assert randomness_kept(variation, repetition, distance) == pytest.approx(expected)


@given(st.floats(0, 1e9), st.floats(-1e9, 1e9), st.floats(-1e9, 1e9))
def test_randomness_kept_lies_between_zero_and_one(variation: float, repetition: float, distance: float) -> None:
    """The randomness kept is in [0, 1] for all scores, and more repetition or distance never helps."""
    value = float(randomness_kept(variation, repetition, distance))
    worse = (
        float(randomness_kept(variation, abs(repetition) + 1, distance)),
        float(randomness_kept(variation, repetition, abs(distance) + 1)),
    )
    assert all(0 <= one <= value <= 1 for one in worse)


def test_randomness_kept_of_an_unknown_score_is_unknown() -> None:
    """The randomness kept is unknown if one of its scores is unknown."""
    nan = np.nan
    assert np.isnan(randomness_kept([nan, 0.1, 1.0, nan], [0.0, nan, 0.0, nan], [0.0, 0.0, nan, nan])).all()


def test_wallpaper_lies_as_far_as_normal_departures_say() -> None:
    """The distance of wallpaper is that of no departures to normal departures, in any number of dimensions."""
    rng = np.random.default_rng(0)
    for size in (1, 3, 40):
        one, other = rng.standard_normal((2, 40_000, size))
        apart = np.linalg.norm(one - other, axis=1).mean()
        assert 2 * np.linalg.norm(one, axis=1).mean() / apart - 1 == pytest.approx(WALLPAPER, abs=0.02)


def _cell(
    make_cell: Make, texture: str, method: str, score: float, v: float | None, r: float | None, **more: Any
) -> Any:
    values = {"randomness.variation": v, "randomness.repetition": r, "randomness.distance": None if v is None else 0.0}
    return make_cell(texture, method, "own", score=score, preserved=score > 0.5, values=values, **more)


@pytest.fixture(scope="module")
def cornered(makers: tuple[Make, Make]) -> Run:
    """Return a run with a copier, a method that loses some lattices, one that loses all, and two references."""
    make_cell, make_run = makers
    cells: list[CellRecord] = []
    for i, texture in enumerate("abc"):
        cells += [
            _cell(make_cell, texture, "copier", 1.0 - 0.01 * i, 0.9, 1.0 + 0.1 * i),
            _cell(make_cell, texture, "shaky", 0.95 if i else 0.1, 0.8 if i else None, 0.5 if i else None),
            _cell(make_cell, texture, "drifter", 0.1 + 0.1 * i, None, None),
            _cell(make_cell, texture, "oracle", 1.0, 1.0 + 0.01 * i, 0.0, reference=True),
            _cell(make_cell, texture, "tiling", 1.0, 0.02, 30.0, reference=True),
        ]
    run: Run = make_run(cells)
    return run


@pytest.fixture(scope="module")
def comparison(cornered: Run) -> Comparison:
    """Return the comparison of that run."""
    return compare_methods(cornered)


def _point(comparison: Comparison, method: str) -> PerilsPoint:
    return next(point for point in perils_points(comparison.summaries) if point.method.name == method)


def test_points_are_means_over_textures(comparison: Comparison) -> None:
    """Both coordinates of a point are means over textures, each inside its interval."""
    point = _point(comparison, "copier")
    assert point.regularity.value == pytest.approx(0.99)
    assert point.randomness.value == pytest.approx(np.mean([1 / 2, 1 / 2.1, 1 / 2.2]))
    for one in (point.regularity, point.randomness):
        assert one.low is not None and one.high is not None and one.value is not None
        assert one.low <= one.value <= one.high


def test_the_worst_is_taken_before_the_mean(make_cell: Make, make_run: Make) -> None:
    """Too little variation on one texture and copies on another are two faults; they do not cancel in the mean."""
    run = make_run([_cell(make_cell, "a", "m", 1.0, 0.5, 0.0), _cell(make_cell, "b", "m", 1.0, 1.0, 1.0)])
    assert _point(compare_methods(run), "m").randomness.value == pytest.approx(0.5)


def test_a_lost_lattice_has_no_height(comparison: Comparison) -> None:
    """A method that loses every lattice has no vertical coordinate; a method that loses some says how many count."""
    lost, shaky = _point(comparison, "drifter"), _point(comparison, "shaky")
    assert not lost.has_height and lost.regularity.n == 3 and "not scored" in lost.words
    assert shaky.has_height and (shaky.randomness.n, shaky.regularity.n) == (2, 3)
    assert caption_text([shaky]) == "shaky (own) [2 of 3]"


def test_references_are_marked_and_not_ranked(comparison: Comparison) -> None:
    """Reference methods are points of the plane; no rank of the randomness kept exists."""
    table = perils_table(perils_points(comparison.summaries)).set_index("method")
    assert table["reference"].to_dict() == {
        "copier": False, "shaky": False, "drifter": False, "oracle": True, "tiling": True,
    }  # fmt: skip
    assert all(RANDOMNESS_KEPT not in one.ranks for one in comparison.summaries)


def test_paired_differences_hold_the_randomness_kept(comparison: Comparison) -> None:
    """The paired differences hold the randomness kept of two methods, over the textures that both have."""
    differences = [one for one in comparison.differences if one.score == RANDOMNESS_KEPT]
    pair = next(one for one in differences if (one.first.name, one.second.name) == ("copier", "shaky"))
    assert pair.estimate.n == 2


def test_files_are_vector_graphics_and_the_same_again(cornered: Run, comparison: Comparison, tmp_path: Path) -> None:
    """The plane is written as SVG and PDF, without a date, so that equal runs give equal bytes."""
    first = [path.read_bytes() for path in PerilsPlane().write(cornered, tmp_path)]
    assert [content[:5] for content in first] == [b"<?xml", b"%PDF-"]
    assert b"<image" not in first[0]
    points = perils_points(comparison.summaries)
    assert first == [plot_perils_plane(points, kind) for kind in ("svg", "pdf")]


def test_the_plane_uses_no_color(comparison: Comparison) -> None:
    """Every color of the picture is a gray, for print in black and white."""
    pixels = np.asarray(
        PIL.Image.open(io.BytesIO(plot_perils_plane(perils_points(comparison.summaries), "png"))).convert("RGB")
    )
    assert (np.ptp(pixels.astype(int), axis=2) == 0).all()


def test_no_scores_no_plane(make_run: Make, tmp_path: Path) -> None:
    """A run without cells writes no picture."""
    assert PerilsPlane().write(make_run([]), tmp_path) == []


def test_width_is_checked() -> None:
    """A width outside the range is an error that states the range."""
    with pytest.raises(BadInput, match="give 3 to 12 inches"):
        PerilsPlane(width=40)


@pytest.mark.parametrize("seed", range(2))
def test_captions_cover_nothing(seed: int) -> None:
    """Fourteen captions of a crowd never cover each other, at most touch a point, and stay inside."""
    rng = np.random.default_rng(seed)
    anchors = np.array([280.0, 120.0]) + rng.uniform(-20, 20, (14, 2))
    sizes = np.column_stack([rng.uniform(30, 90, 14), np.full(14, 10.0)])
    points = np.concatenate([anchors - 3, anchors + 3], 1)
    frame = np.array([0.0, 0.0, 320.0, 240.0])
    boxes = place_captions(anchors, sizes, points, frame)
    covered = overlap(boxes, boxes)
    np.fill_diagonal(covered, 0)
    assert covered.max() == 0
    assert overlap(boxes, points).max() < 0.07
    assert (boxes[:, :2] >= frame[:2] - 1e-6).all() and (boxes[:, 2:] <= frame[2:] + 1e-6).all()


def test_captions_break_between_parameters() -> None:
    """A long name is broken after a colon or comma, before sources, and never inside them."""
    assert wrap_caption("lattice-only:block=12,overlap=4 (given, own)").splitlines() == [
        "lattice-only:block=12,", "overlap=4 (given, own)",
    ]  # fmt: skip


def test_a_crowd_is_drawn_in_time() -> None:
    """Twenty methods at one point are drawn, with captions far from the point."""
    none = BaselineValidity(0, 0)
    one = Estimate(0.98, 0.97, 0.99, 9, 9)
    crowd = [
        PerilsPoint(Method(f"m{i}", "own", False, {}), one, Estimate(0.4 + i / 1e4, 0.3, 0.5, 9, 9), none)
        for i in range(20)
    ]
    assert len(plot_perils_plane(crowd, "svg")) > 10_000
    assert math.isfinite(sum(point.randomness.value or 0 for point in crowd))
