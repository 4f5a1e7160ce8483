"""Tiles in their places, and courses of tiles that slid."""

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest

from nrbench.datasets_procedural.weave import Weave
from nrbench.imaging.convert import quantize
from nrbench.lattice.geometry import Lattice
from nrbench.metrics.ncc import course_template
from nrbench.metrics.ncc.course_template import CourseTemplate
from nrbench.metrics.verdict.courses import course_gain_excess, course_gains, course_slide_excess, measure_courses
from nrbench.metrics.verdict.reference import Reference, reference_from_model
from nrbench.metrics.verdict.tiles import measure_tiles
from nrbench.metrics.verdict.windows import scatter_excess

from .conftest import MODELS, Case

Cases = Callable[[str], Case]


def measure(case: Case) -> Reference:
    """Return the reference of a case."""
    assert case.texture.lattice is not None
    return reference_from_model(case.texture, case.texture.lattice.reduced(), case.again)


@pytest.mark.parametrize("name", MODELS)
def test_tiles_of_a_fresh_draw_fit_here_and_not_elsewhere(case: Cases, name: str) -> None:
    """Every tile correlates with its own place, has the full contrast, and fits worse elsewhere."""
    tiles = measure_tiles(case(name).fresh(), measure(case(name)).periodic, np.zeros(2))
    assert tiles.here.min() > 0.6
    assert np.median(tiles.slope) == pytest.approx(1, abs=0.1)
    assert tiles.gain.max() < 0.05


@pytest.mark.parametrize("phase", [(0.0, 0.0), (3.4, -2.7)])
def test_tiles_are_found_to_a_fraction_of_a_pixel(case: Cases, phase: tuple[float, float]) -> None:
    """Offsets of a fresh draw are zero on average. An error of the phase by half a pixel changes them by as much."""
    periodic = measure(case("hexagon")).periodic
    image = case("hexagon").fresh()
    assert np.hypot(*measure_tiles(image, periodic, np.zeros(2)).offsets.mean(0)) < 0.1
    off = measure_tiles(image, periodic, np.array([0.5, -0.3])).offsets.mean(0)
    np.testing.assert_allclose(off, (-0.5, 0.3), atol=0.1)


def test_the_displacement_of_a_tile_is_measured(case: Cases) -> None:
    """The tile with the largest gain has the planted displacement, to 0.15 s; the median displacement is near 0."""
    image, field = case("hexagon").planted("displaced-tile", 0.35, seed=3)
    verdict = case("hexagon").verdict(image)
    tiles = verdict.output.tiles
    planted = np.hypot(*np.moveaxis(field, -1, 0)).max()
    assert np.hypot(*tiles.displacements[tiles.gain.argmax()]) == pytest.approx(planted, abs=0.15 * tiles.lattice.s)
    assert np.median(np.hypot(*tiles.displacements.T)) < 0.5


def test_there_are_four_windows_a_cell(case: Cases) -> None:
    """Windows are half a cell apart, and a quarter of them are at lattice points."""
    tiles = measure_tiles(case("brick").fresh(240), measure(case("brick")).periodic, np.zeros(2))
    assert tiles.whole.mean() == pytest.approx(0.25, abs=0.03)
    at = tiles.lattice.to_cell(tiles.centers)
    np.testing.assert_allclose(2 * at, np.rint(2 * at), atol=1e-9)
    np.testing.assert_allclose(at[tiles.whole], np.rint(at[tiles.whole]), atol=1e-9)


def test_a_cover_reduces_the_contrast(case: Cases) -> None:
    """The lowest slope decreases with the opacity of the cover of a tile."""
    periodic = measure(case("brick")).periodic
    slopes = [
        measure_tiles(case("brick").planted("missing-tile", size)[0], periodic, np.zeros(2)).slope.min()
        for size in (0.0, 0.3, 0.6, 1.0)
    ]
    assert np.all(np.diff(slopes) < -0.05)
    assert slopes[-1] < 0.5


def test_nothing_fits_into_a_tiny_image(case: Cases) -> None:
    """An image smaller than a tile has no tiles."""
    tiles = measure_tiles(case("brick").fresh()[:8, :8], measure(case("brick")).periodic, np.zeros(2))
    assert len(tiles.here) == len(tiles.centers) == 0


@pytest.mark.parametrize("name", MODELS)
def test_courses_of_a_fresh_draw_fit_here(case: Cases, name: str) -> None:
    """No course of a fresh draw has a positive mean gain, and none exceeds the limits."""
    verdict = case(name).verdict(case(name).fresh(256))
    assert course_gains(verdict.output.tiles).max() < 0
    assert verdict.course_excess.max() < 0.3


def test_a_slipped_course_is_detected_in_its_place(case: Cases) -> None:
    """Only tiles within two tiles of the course that slid exceed the limits."""
    one = case("hexagon")
    image, field = one.planted("slipped-course", 0.3, seed=2, side=256)
    verdict = one.verdict(image)
    assert verdict.preserved is False
    bad = verdict.output.tiles.centers[verdict.course_excess > 1]
    rows = np.nonzero(field.any(-1))
    assert len(bad)
    nearest = np.abs(bad[:, 1:] - rows[0]).min(1)
    assert nearest.max() < 2 * one.texture.lattice.s  # type: ignore[union-attr]


def test_short_courses_are_left_out(case: Cases) -> None:
    """An image of one tile has no course, so no tile exceeds the limits."""
    one = case("hexagon")
    periodic = measure(one).periodic
    tiny = measure_tiles(one.fresh()[:34, :34], periodic, np.zeros(2))
    whole = measure_tiles(one.fresh(), periodic, np.zeros(2))
    assert len(tiny.here) and not np.isfinite(course_gains(tiny)).any()
    assert course_gain_excess(tiny, [whole]).tolist() == [0.0] * len(tiny.here)


@pytest.mark.parametrize("name", MODELS)
def test_no_course_of_a_fresh_draw_has_slid(case: Cases, name: str) -> None:
    """Every course of a fresh draw is more likely in its place than elsewhere, and none exceeds the limits."""
    verdict = case(name).verdict(case(name).fresh(256))
    courses = verdict.output.courses
    assert max(gain.max() for gain in courses.gain) < 0
    references = [image.courses for image in verdict.references]
    assert course_slide_excess(courses, references, verdict.output.tiles).max() < 0.8


@pytest.mark.parametrize("name", MODELS)
def test_a_course_that_slid_by_little_is_detected(case: Cases, name: str) -> None:
    """If a course slid by 0.15 s, which the windows alone hardly show, regularity is lost."""
    image, _ = case(name).planted("slipped-course", 0.15, seed=2, side=256)
    verdict = case(name).verdict(image)
    assert verdict.preserved is False
    assert "a course of tiles has slid" in verdict.faults
    slide = verdict.output.courses.worst_slide
    assert slide is not None and slide / verdict.reference.lattice.s == pytest.approx(0.15, abs=0.03)


@pytest.mark.parametrize("name", MODELS)
def test_a_course_within_the_tolerance_has_not_slid(case: Cases, name: str) -> None:
    """A course that slid by 0.06 s, less than the tolerance, is no fault, although its exact place is unlikely."""
    image, _ = case(name).planted("slipped-course", 0.06, seed=2, side=256)
    verdict = case(name).verdict(image)
    assert verdict.course_excess.max() <= 1


@pytest.mark.parametrize("seed", [1, 4])
def test_a_course_of_yarns_that_differ_is_detected(seed: int) -> None:
    """At a regular share of 0.4 a slide of 0.15 s is detected in a weave of different yarns, none in a fresh draw."""
    model = Weave(rotation=7.0 * (seed - 1), color=0.55, intensity=0.25, noise=0.05)
    texture = model.render((128, 128), np.random.default_rng(seed))
    one = Case(model, replace(texture, image=quantize(texture.image)))
    slid = one.verdict(one.planted("slipped-course", 0.15, seed=seed, side=256)[0])
    assert slid.course_excess.max() > 1
    fresh = one.verdict(one.fresh(256))
    assert fresh.course_excess.max() < 0.8


def test_a_color_added_everywhere_moves_no_course(case: Cases) -> None:
    """The gains do not change if the same color is added to every pixel."""
    one = case("weave")
    periodic, image = measure(one).periodic, one.fresh(128)
    brighter = image + np.array([0.05, -0.03, 0.1], np.float32)
    here, there = (measure_courses(some, periodic.lattice, periodic) for some in (image, brighter))
    for first, second in zip(here.gain, there.gain, strict=True):
        finite = np.isfinite(first)
        assert np.allclose(first[finite], second[finite], atol=1e-3)


@pytest.mark.parametrize("name", MODELS)
def test_bent_content_is_detected(case: Cases, name: str) -> None:
    """A warp of up to 0.15 s scatters windows more than fresh draws do, and a further fresh draw does not."""
    one = case(name)
    bent = one.verdict(one.planted("warp", 0.15, seed=2, side=256)[0])
    assert "the content is bent" in bent.faults
    fresh = one.verdict(one.fresh(256, 1))
    references = [image.windows for image in fresh.references]
    assert scatter_excess(fresh.output.windows, references) < 0.6


def test_courses_follow_the_lattice_origin(case: Cases) -> None:
    """Moving the origin by a lattice vector renumbers the courses and changes no gain."""
    one = case("brick")
    periodic, image = measure(one).periodic, one.fresh(128)
    lattice = periodic.lattice
    away = lattice.from_cell((2.0, -1.0)) - lattice.from_cell((0.0, 0.0))
    here, there = (
        measure_courses(image, lattice, periodic),
        measure_courses(image, lattice.shifted((away[0], away[1])), periodic),
    )
    for first, second in zip(here.gain, there.gain, strict=True):
        finite = np.isfinite(first)
        assert len(first) == len(second) and np.allclose(first[finite], second[np.isfinite(second)], atol=0.02)


@pytest.mark.parametrize("direction", range(4))
def test_no_sample_of_a_template_is_left_out(direction: int) -> None:
    """If pixels fall on every second sample of an oblique course only, the others use their neighbors' pixels."""
    lattice = Lattice((21.99866, 0.0), (10.99933, 19.0514), (-7.6336, 0.98495))
    template = CourseTemplate.of(
        lattice, np.ones((153, 197, 3), np.float32), np.zeros((153, 197), np.float32), direction
    )
    assert np.allclose(template.mean, 1)


@pytest.mark.parametrize("at_once", [1, 1 << 22])
@pytest.mark.parametrize("half", [0, 1])
def test_products_are_those_with_the_slid_template(half: int, at_once: int, monkeypatch: pytest.MonkeyPatch) -> None:
    """The products equal direct sums with the template rolled by k columns, for any number of rows at a time."""
    monkeypatch.setattr(course_template, "_AT_ONCE", at_once)
    rng, lattice = np.random.default_rng(half), Lattice((9.0, 0.0), (2.0, 8.0))
    image, variance = rng.random((64, 64, 3), np.float32), rng.random((64, 64), np.float32)
    template = CourseTemplate.of(lattice, image, variance, 1)
    middle = template.grid.rows // 2
    halves = rng.random((3, middle, template.grid.columns, 5))
    fit, weight, differences = template.compare_halves(halves, half)
    rows = slice(half * middle, (half + 1) * middle)
    for k in range(template.grid.columns):
        mean, variances = np.roll(template.mean[rows], k, 1), np.roll(template.variance[rows], k, 1)
        count, values, squares = halves[..., 0], halves[..., 1:4], halves[..., 4]
        square = count * (mean**2).sum(-1) - 2 * (values * mean).sum(-1) + squares
        assert np.allclose(fit[:, k], (square / variances + 3 * count * np.log(variances)).sum((1, 2)))
        assert np.allclose(weight[:, k], (count / variances).sum((1, 2)))
        difference = (values - count[..., np.newaxis] * mean) / variances[..., np.newaxis]
        assert np.allclose(differences[..., k], difference.sum((1, 2)).T)
