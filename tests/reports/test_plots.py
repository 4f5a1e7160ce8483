"""Plots: marks, captions, the grid of pictures, the perils plane, the forest plot."""

import io
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import PIL.Image
import pytest
from hypothesis import given
from hypothesis import strategies as st

from nrbench.errors import BadInput
from nrbench.reports.figure import PictureGrid, plot_pictures
from nrbench.reports.page.gallery import score_lines
from nrbench.reports.page.pictures import PictureStore, find_marks, worst_place
from nrbench.reports.page.plots import (
    caption_text,
    method_styles,
    plot_cost,
    plot_heat_map,
    plot_perils_plane,
    plot_ranks,
    spread,
    timed_methods,
)
from nrbench.reports.perils import PerilsPlane
from nrbench.reports.statistics.method_comparison import Comparison, compare_methods
from nrbench.reports.statistics.summaries import Method, PerilsPoint, perils_points
from nrbench.runs.records import Run

from .conftest import Make


@given(st.lists(st.tuples(st.floats(0, 100), st.floats(4, 12)), min_size=1, max_size=16))
def test_captions_keep_the_order_and_do_not_overlap(captions: list[tuple[float, float]]) -> None:
    """Captions have the order of their points, and lie at least their gaps apart, between the limits."""
    points, heights = (np.array(values) for values in zip(*captions, strict=True))
    gaps = (heights[:-1] + heights[1:]) / 2
    places = spread(np.sort(points)[::-1], gaps, (-20.0, 220.0))
    assert (np.diff(places) <= -gaps + 1e-6).all()
    assert places.max() <= 220 + 1e-6 and places.min() >= -20 - 1e-6


def _layers() -> tuple[np.ndarray, np.ndarray]:
    """Return an output and a gray copy of it with an orange square of 10 px at (40, 20)."""
    output = np.random.default_rng(0).integers(0, 255, (64, 80, 3), dtype=np.uint8)
    layer = np.repeat((output.mean(-1, keepdims=True) / 2 + 127).astype(np.uint8), 3, 2)
    layer[20:30, 40:50] = (230, 120, 10)
    return output, layer


def test_marks_are_what_a_metric_drew() -> None:
    """The marks are the colored square, over a gray copy and over the output itself."""
    output, layer = _layers()
    expected = np.zeros((64, 80), bool)
    expected[20:30, 40:50] = True
    assert np.array_equal(find_marks(layer, output), expected)
    assert np.array_equal(find_marks(np.where(expected[..., None], layer, output), output), expected)


def test_source_maps_are_colored_by_place(tmp_path: Path) -> None:
    """Pixels that come from one place have one color, those of other places another; a broken file has no map."""
    places = np.zeros((32, 32, 2), np.float32)
    places[:, 16:] = (20, 20)
    np.savez(tmp_path / "source.npz", source=places)
    (tmp_path / "bad.npz").write_bytes(b"no archive")
    store = PictureStore(tmp_path / "report")
    picture = store.source_map(tmp_path / "source.npz")
    assert picture is not None and (picture.width, picture.height) == (32, 32)
    assert store.source_map(tmp_path / "bad.npz") is None
    assert store.source_map(tmp_path / "absent.npz") is None


def test_the_worst_place_has_the_marks() -> None:
    """The magnified square holds the marks; an output that is marked all over has no worst place."""
    output, layer = _layers()
    x, y = worst_place(output, [None, layer], 16) or (0, 0)
    assert x <= 40 and x + 16 >= 50 and y <= 20 and y + 16 >= 30
    assert worst_place(output, [np.full_like(output, (250, 100, 0))], 16) is None
    assert worst_place(output, [output], 16) is None


def test_the_grid_shows_what_was_chosen(ranked: Run, tmp_path: Path) -> None:
    """The grid is a PDF with embedded fonts and a PNG of the given width, the same at every call."""
    comparison = compare_methods(ranked)
    report = PictureGrid(textures=(comparison.rows[0].texture,), methods=("good", "oracle"), width=3.3)
    pdf, png = report.write(ranked, tmp_path)
    content = pdf.read_bytes()
    assert b"/FontFile2" in content and b"/Type3" not in content
    with PIL.Image.open(png) as image:
        assert image.width == pytest.approx(3.3 * 160, abs=2)
        assert image.height < image.width
    assert report.write(ranked, tmp_path)[0].read_bytes() == content
    assert len(PictureGrid().write(ranked, tmp_path)) == 2


@pytest.mark.parametrize("wrong", [{"textures": ("nowhere*",)}, {"methods": ("nobody",)}])
def test_unknown_choices_name_the_known_ones(ranked: Run, tmp_path: Path, wrong: dict[str, Any]) -> None:
    """A texture or method that the run lacks is an error that lists those it has."""
    with pytest.raises(BadInput, match=r"give some of: \w+"):
        PictureGrid(**wrong).write(ranked, tmp_path)
    with pytest.raises(BadInput, match="give 2 to 12 inches"):
        PictureGrid(width=40.0)


@pytest.fixture
def long_run(make_cell: Make, make_run: Make) -> Run:
    """Return a run of three methods on 12 textures."""
    rng = np.random.default_rng(0)
    return make_run([
        make_cell(f"t{i}", name, perils=float(rng.uniform(0.6, 0.8) - worse))
        for i in range(12)
        for name, worse in (("a", 0.0), ("b", 0.01), ("c", 0.5))
    ])  # fmt: skip


def test_plots_are_the_same_again_and_embed_fonts(long_run: Run) -> None:
    """Each plot has the same bytes at every call; the PDF embeds TrueType fonts."""
    comparison = compare_methods(long_run)
    for plot in (plot_ranks, plot_heat_map):
        assert plot("svg", comparison) == plot("svg", comparison)
    timed = timed_methods(comparison)
    assert plot_cost("svg", timed) == plot_cost("svg", timed)
    for pdf in (plot_ranks("pdf", comparison), plot_heat_map("pdf", comparison), plot_cost("pdf", timed)):
        assert b"/FontFile2" in pdf and b"/Type3" not in pdf


@pytest.fixture(scope="module")
def comparison(ranked: Run) -> Comparison:
    """Return the comparison of a run with qualities."""
    return compare_methods(ranked)


def _point(comparison: Comparison, method: str) -> PerilsPoint:
    return next(point for point in perils_points(comparison.summaries) if point.method.name == method)


def test_points_are_means_over_textures(comparison: Comparison, make_cell: Make, make_run: Make) -> None:
    """Both coordinates of a point are means over textures, each inside its interval over draws."""
    point = _point(comparison, "good")
    assert point.structure.value == pytest.approx(0.9)
    assert point.randomness.value == pytest.approx(0.69)
    assert point.structure.ends is None
    cells = [make_cell(f"t{i}", "m", replicate=j, perils=0.5 + 0.01 * i + 0.02 * j) for i in range(20) for j in (0, 1)]
    point = _point(compare_methods(make_run(cells)), "m")
    for one in (point.structure, point.randomness):
        assert one.low <= one.value <= one.high


def test_the_smallest_is_taken_before_the_mean(make_cell: Make, make_run: Make) -> None:
    """Tiles out of place, broken elements and other colors on three textures are three faults; the mean holds all."""
    names = ("regularity", "integrity", "appearance")
    whole = dict.fromkeys([*names, "randomness"], 1.0)
    run = make_run([make_cell(name, "m", perils={**whole, name: 0.5}) for name in names])
    assert _point(compare_methods(run), "m").structure.value == pytest.approx(0.5)


def test_what_is_not_measured_does_not_count(make_cell: Make, make_run: Make) -> None:
    """Where integrity and appearance are not measured, the horizontal coordinate is the regularity."""
    run = make_run([make_cell("a", "m", perils={"regularity": 0.8, "randomness": 1.0})])
    assert _point(compare_methods(run), "m").structure.value == pytest.approx(0.8)


def test_a_lost_lattice_has_no_height(comparison: Comparison) -> None:
    """A method that loses every lattice has no vertical coordinate; a method that loses some says how many count."""
    lost, shaky = _point(comparison, "drifter"), _point(comparison, "shaky")
    assert not lost.has_height and lost.structure.n == 3 and "not scored" in lost.words
    assert shaky.has_height and (shaky.randomness.n, shaky.structure.n) == (2, 3)
    assert caption_text(shaky) == "shaky (own) [2 of 3]"


def test_a_point_says_which_silence_it_is(make_cell: Make, make_run: Make) -> None:
    """An upper bound is named with the peril that cannot be told; no peril is no upper bound; 0 hides nothing."""
    measured = dict.fromkeys(("regularity", "randomness", "appearance"), 0.8)
    absent = {"quality.integrity": "not applicable: joined ones look whole"}
    told = {"quality.score": 0.8, "quality.complete": True, **{f"quality.{name}": 0.8 for name in measured}}
    cells = [
        make_cell("a", "silent", perils={**measured, "integrity": None}),
        make_cell("a", "alike", perils=measured, values={**told, "quality.integrity": None}, reasons=absent),
        make_cell("a", "lost", preserved=False, perils={"regularity": 0.0, "integrity": None, "randomness": None}),
    ]
    cells[1] = replace(cells[1], values={**cells[1].values, "quality.integrity": None, "quality.complete": True})
    run = make_run(cells)
    comparison = compare_methods(run)
    words = {name: _point(comparison, name).words for name in ("silent", "alike", "lost")}
    assert words["silent"].endswith("; integrity: cannot tell on 1 output; the quality is an upper bound")
    assert words["alike"].endswith("; integrity: no peril on 1 output")
    assert "cannot tell" not in words["lost"] and "no peril" not in words["lost"]
    assert _point(comparison, "silent").at_most and not _point(comparison, "alike").at_most
    (row,) = (row for row in comparison.summary_rows if row.name == "quality.integrity")
    assert [row.numbers[f"{name} (own)"].text for name in ("silent", "alike", "lost")] == ["–", "no peril", "–"]
    lines = {line.name: line.text for line in score_lines(run, run.cells[1], ["quality.integrity", "quality.score"])}
    assert lines == {"quality.integrity": "no peril", "quality.score": "0.80"}
    files = [plot_perils_plane("svg", [_point(comparison, name)]) for name in ("silent", "alike")]
    assert files[0] != files[1]


def test_files_are_vector_graphics_and_the_same_again(ranked: Run, comparison: Comparison, tmp_path: Path) -> None:
    """The plane is written as SVG and PDF, without a date, so that equal runs give equal bytes."""
    paths = PerilsPlane().write(ranked, tmp_path)
    assert [path.name for path in paths] == [
        f"{name}.{kind}" for name in ("perils", "levels", "cost", "heat-map") for kind in ("svg", "pdf")
    ]
    first = [path.read_bytes() for path in paths if path.stem == "perils"]
    assert [content[:5] for content in first] == [b"<?xml", b"%PDF-"]
    assert b"<image" not in first[0]
    points = perils_points(comparison.summaries)
    assert first == [plot_perils_plane(kind, points) for kind in ("svg", "pdf")]


def test_methods_have_colors_and_shapes_of_their_own(comparison: Comparison) -> None:
    """64 methods differ in color or shape, eight of them in both; references are gray, in every plot of a run alike."""
    methods = [Method(f"m{i}", "own", reference=False, parameters={}, plugin="m", preset="") for i in range(64)]
    styles = [(style["color"], style["marker"]) for style in method_styles(methods)]
    assert len(set(styles)) == 64
    assert len({color for color, _ in styles[:8]}) == len({marker for _, marker in styles[:8]}) == 8
    colored = _colored_pixels(plot_perils_plane("png", perils_points(comparison.summaries)))
    references = [one for one in comparison.summaries if one.method.reference]
    assert colored.any() and not _colored_pixels(plot_perils_plane("png", perils_points(references))).any()


def _colored_pixels(png: bytes) -> np.ndarray:
    pixels = np.asarray(PIL.Image.open(io.BytesIO(png)).convert("RGB"))
    return np.ptp(pixels.astype(int), axis=2) > 0


def test_no_name_is_cut(make_cell: Make, make_run: Make) -> None:
    """Long names of methods and textures end within each figure: its outermost pixels are white."""
    long = "regularized-patch:detector=consensus,blending=multiband"
    cells = [make_cell(texture, name) for texture in ("hexagonal-pavement-of-old-stones",) for name in ("a", long)]
    comparison = compare_methods(make_run(cells))
    figures = {
        "narrow grid": plot_pictures("png", comparison, comparison.rows, comparison.methods, 0, 3.3, True),
        "wide grid": plot_pictures("png", comparison, comparison.rows, [*comparison.methods] * 4, 0, 7.0, True),
        "heat map": plot_heat_map("png", comparison),
    }
    for name, png in figures.items():
        pixels = np.asarray(PIL.Image.open(io.BytesIO(png)).convert("L"))
        edges = (pixels[0], pixels[-1], pixels[:, 0], pixels[:, -1])
        assert min(edge.min() for edge in edges) == 255, name
