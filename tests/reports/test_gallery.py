from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from nrbench.lattice.geometry import Lattice
from nrbench.reports.page.gallery import TextureDraw, build_gallery, score_lines, score_shade
from nrbench.reports.page.pictures import PagePicture, PictureStore
from nrbench.reports.statistics.method_comparison import compare_methods
from nrbench.runs.records import Run

Make = Callable[..., Any]


def _gallery(run: Run, tmp_path: Path) -> list[list[TextureDraw]]:
    return build_gallery(run, compare_methods(run), PictureStore(tmp_path))


def test_every_cell_has_a_figure(every_ending: Run, tmp_path: Path) -> None:
    """A failed cell has its figure too, without a picture."""
    figures = [figure for draws in _gallery(every_ending, tmp_path) for draw in draws for figure in draw.figures]
    assert sorted(one.record.key for one in figures) == sorted(record.key for record in every_ending.cells)
    assert all((one.output is not None) == (one.record.status == "ok") for one in figures)


def test_equal_lattices_are_drawn_once(make_cell: Make, make_run: Make, tmp_path: Path) -> None:
    """Methods that used the same lattice share a drawing, whatever its basis; the true one is not drawn again."""
    wrong, same = Lattice((9.9, 0.0), (0.0, 7.0)), Lattice((9.9, 7.0), (9.9, 0.0), (3.0, 3.0))
    cells = [make_cell(method=name, lattice_used=used) for name, used in (("a", wrong), ("b", same), ("c", None))]
    run = make_run([*cells, make_cell(method="d")])
    draw = _gallery(run, tmp_path)[0][0]
    assert [labels for labels, _ in draw.used] == [["a (own)", "b (own)"]]
    assert draw.truth is not None
    assert list(draw.agreeing) == ["d (own)"]


def test_missing_scores_show_the_reason(every_ending: Run) -> None:
    """A score without a value shows the reason."""
    record = next(record for record in every_ending.cells if record.texture == "weave")
    (line,) = score_lines(every_ending, record, ["randomness.variation"])
    assert (line.text, line.reason) == ("–", "not scored")


@pytest.mark.parametrize(("score", "expected"), [(None, None), (0.0, 0), (1.0, 10), (0.94, 9), (-1.0, 0), (7.0, 10)])
def test_shades_follow_the_score(score: float | None, expected: int | None) -> None:
    """Eleven shades from 0 to 1; what lies outside takes the last one."""
    assert score_shade(score) == expected


@pytest.mark.parametrize(("width", "scale"), [(8, 24), (100, 2), (191, 2), (192, 1), (384, 1), (768, 0.5)])
def test_small_pictures_are_magnified_by_whole_factors(width: int, scale: float) -> None:
    """Small pictures are magnified by whole factors, so that moire cannot look like a defect."""
    assert PagePicture("", width, width).scale == scale
