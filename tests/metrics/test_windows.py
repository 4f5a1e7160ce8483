"""What registered windows share, tiles in their places, courses of tiles that slid, and the tail of limits."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from nrbench.datasets_procedural.weave import Weave
from nrbench.lattice.geometry import Lattice
from nrbench.metrics.ncc import course_template
from nrbench.metrics.ncc.course_template import CourseTemplate
from nrbench.metrics.verdict.courses import course_gain_excess, course_gains, course_slide_excess, measure_courses
from nrbench.metrics.verdict.exponential_tail import ExponentialTail
from nrbench.metrics.verdict.reference import Reference, reference_from_model
from nrbench.metrics.verdict.tiles import measure_tiles
from nrbench.metrics.verdict.windows import (
    RegisteredWindows,
    find_consensus,
    fit_drift,
    fit_own_lattice,
    scatter_excess,
)

from .conftest import MODELS, Case, case

LATTICE = Lattice((20.0, 3.0), (-4.0, 17.0), (2.0, 1.0))


def make_windows(displacement: np.ndarray, rows: int, columns: int, lattice: Lattice = LATTICE) -> RegisteredWindows:
    """Return windows of 30 px, 15 px apart, with given displacements."""
    y, x = np.meshgrid(15 * np.arange(rows), 15 * np.arange(columns), indexing="ij")
    corners = np.stack([x.ravel(), y.ravel()], -1)
    displacement, structure = lattice.wrap(displacement), np.ones(len(corners))
    return RegisteredWindows(lattice, (30, 30), (rows, columns), corners, displacement, structure)


@settings(max_examples=40)
@given(st.floats(-40, 40), st.floats(-40, 40), st.integers(0, 100))
def test_the_consensus_is_the_common_displacement(x: float, y: float, seed: int) -> None:
    """The consensus is the displacement that most windows share, for any phase and with outliers."""
    rng = np.random.default_rng(seed)
    displacement = np.array([x, y]) + 0.2 * rng.standard_normal((60, 2))
    displacement[:15] += rng.uniform(-10, 10, (15, 2))
    off = LATTICE.wrap(find_consensus(LATTICE.wrap(displacement), LATTICE) - (x, y))
    assert np.hypot(*off) < 0.35


def test_the_consensus_of_two_halves_is_one_of_them() -> None:
    """If two halves are out of step by 0.2 s, the consensus is the displacement of one half, not the mean."""
    displacement = np.repeat([[0.0, 0.0], [4.0, 0.0]], [30, 31], 0)
    phase = find_consensus(displacement, LATTICE)
    assert min(np.hypot(*phase), np.hypot(*(phase - [4, 0]))) < 0.2


@settings(max_examples=15)
@given(st.floats(-0.1, 0.1), st.floats(-0.1, 0.1), st.floats(-0.1, 0.1), st.floats(-0.1, 0.1))
def test_an_affine_drift_over_many_cells_is_unwrapped(a: float, b: float, c: float, d: float) -> None:
    """The affine part is measured even if it amounts to many cells across the image."""
    matrix = np.array([[a, b], [c, d]])
    bare = make_windows(np.zeros((300, 2)), 15, 20)
    drifted = make_windows(bare.centers @ matrix.T + [3.0, -7.0], 15, 20)
    np.testing.assert_allclose(fit_drift(drifted), matrix, atol=2e-3)


def test_one_wrong_window_does_not_displace_a_neighborhood() -> None:
    """One wrong window does not change the median of 3 x 3 windows; a displaced block does."""
    displacement = np.zeros((48, 2))
    displacement[20] = [8, 0]
    assert make_windows(displacement, 6, 8).neighborhoods().max() < 0.01
    block = np.zeros((6, 8, 2))
    block[:4, :4] = [0, 6]
    assert make_windows(block.reshape(-1, 2), 6, 8).neighborhoods().max() * LATTICE.s == pytest.approx(6, abs=0.1)


_SMALL = st.floats(-0.04, 0.04)


def make_drifted(true: Lattice, drift: np.ndarray, rows: int = 14, columns: int = 16) -> RegisteredWindows:
    """Return the windows of an image whose content has drifted."""
    bare = make_windows(np.zeros((rows * columns, 2)), rows, columns, true)
    return make_windows(bare.centers @ drift.T + (3.0, -2.0), rows, columns, true)


@settings(max_examples=25)
@given(_SMALL, _SMALL, _SMALL, _SMALL)
def test_the_lattice_of_a_drifted_image_is_found(a: float, b: float, c: float, d: float) -> None:
    """The least-squares lattice is the true one displaced by the drift: its points map back onto true points."""
    drift = np.array([[a, b], [c, d]])
    windows = make_drifted(LATTICE, drift)
    own = fit_own_lattice(windows, fit_drift(windows))
    assert own is not None and own.followers == 1
    at = own.lattice.points((200, 240))
    back = at - (at @ drift.T + (3.0, -2.0))
    assert np.abs(LATTICE.wrap(back - LATTICE.origin)).max() < 0.02


def test_vectors_and_area_are_those_of_the_stretch() -> None:
    """A stretch of 3 % gives an error of 3 % of the vectors and 6 % of the area. Long vectors are then not exact."""
    long = Lattice((60.0, 0.0), (0.0, 50.0))
    windows = make_drifted(long, np.eye(2) * (1 - 1 / 1.03))
    own = fit_own_lattice(windows, fit_drift(windows))
    assert own is not None
    error = own.error(long, (240, 240))
    assert error is not None and error.relation == "wrong"
    assert error.vector == pytest.approx(1.8, abs=0.02)
    assert error.area_ratio == pytest.approx(1.03**2, abs=1e-3)


def test_scattered_windows_share_no_lattice() -> None:
    """A lattice on which few windows lie is not compared."""
    rng, windows = np.random.default_rng(0), make_drifted(LATTICE, np.zeros((2, 2)))
    torn = RegisteredWindows(
        *list(vars(windows).values())[:4], LATTICE.wrap(rng.uniform(-40, 40, (224, 2))), np.ones(224)
    )
    own = fit_own_lattice(torn, fit_drift(torn))
    assert own is not None and own.followers < 0.5
    assert own.error(LATTICE, (200, 200)) is None


def test_two_windows_have_no_lattice() -> None:
    """Fewer than 3 x 3 windows have no lattice of their own."""
    assert fit_own_lattice(make_drifted(LATTICE, np.zeros((2, 2)), rows=2), np.zeros((2, 2))) is None


def measure(case: Case) -> Reference:
    """Return the reference of a case."""
    return reference_from_model(case.texture, case.lattice.reduced(), case.again)


@pytest.mark.parametrize("name", MODELS)
def test_tiles_of_a_fresh_draw_fit_here_and_not_elsewhere(name: str) -> None:
    """Every tile correlates with its own place, has the full contrast, and fits worse elsewhere."""
    tiles = measure_tiles(case(name).fresh(), measure(case(name)).periodic, np.zeros(2))
    assert tiles.here.min() > 0.6
    assert np.median(tiles.slope) == pytest.approx(1, abs=0.1)
    assert tiles.gain.max() < 0.05


@pytest.mark.parametrize("phase", [(0.0, 0.0), (3.4, -2.7)])
def test_tiles_are_found_to_a_fraction_of_a_pixel(phase: tuple[float, float]) -> None:
    """Offsets of a fresh draw are zero on average. An error of the phase by half a pixel changes them by as much."""
    periodic = measure(case("hexagon")).periodic
    image = case("hexagon").fresh()
    assert np.hypot(*measure_tiles(image, periodic, np.zeros(2)).offsets.mean(0)) < 0.1
    off = measure_tiles(image, periodic, np.array([0.5, -0.3])).offsets.mean(0)
    np.testing.assert_allclose(off, (-0.5, 0.3), atol=0.1)


def test_the_displacement_of_a_tile_is_measured() -> None:
    """The tile with the largest gain has the planted displacement, to 0.15 s; the median displacement is near 0."""
    image, field = case("hexagon").planted("displaced-tile", 0.35, seed=3)
    verdict = case("hexagon").verdict(image)
    tiles = verdict.output.tiles
    planted = np.hypot(*np.moveaxis(field, -1, 0)).max()
    assert np.hypot(*tiles.displacements[tiles.gain.argmax()]) == pytest.approx(planted, abs=0.15 * tiles.lattice.s)
    assert np.median(np.hypot(*tiles.displacements.T)) < 0.5


def test_there_are_four_windows_a_cell() -> None:
    """Windows are half a cell apart, and a quarter of them are at lattice points."""
    tiles = measure_tiles(case("brick").fresh(240), measure(case("brick")).periodic, np.zeros(2))
    assert tiles.whole.mean() == pytest.approx(0.25, abs=0.03)
    at = tiles.lattice.to_cell(tiles.centers)
    np.testing.assert_allclose(2 * at, np.rint(2 * at), atol=1e-9)
    np.testing.assert_allclose(at[tiles.whole], np.rint(at[tiles.whole]), atol=1e-9)


def test_a_cover_reduces_the_contrast() -> None:
    """The lowest slope decreases with the opacity of the cover of a tile."""
    periodic = measure(case("brick")).periodic
    slopes = [
        measure_tiles(case("brick").planted("missing-tile", size)[0], periodic, np.zeros(2)).slope.min()
        for size in (0.0, 0.3, 0.6, 1.0)
    ]
    assert np.all(np.diff(slopes) < -0.05)
    assert slopes[-1] < 0.5


def test_nothing_fits_into_a_tiny_image() -> None:
    """An image smaller than a tile has no tiles."""
    tiles = measure_tiles(case("brick").fresh()[:8, :8], measure(case("brick")).periodic, np.zeros(2))
    assert len(tiles.here) == len(tiles.centers) == 0


@pytest.mark.parametrize("name", MODELS)
def test_courses_of_a_fresh_draw_fit_here(name: str) -> None:
    """No course of a fresh draw has a positive mean gain, and none exceeds the limits."""
    verdict = case(name).verdict(case(name).fresh(256))
    assert course_gains(verdict.output.tiles).max() < 0
    assert verdict.course_excess.max() < 0.3


def test_a_slipped_course_is_detected_in_its_place() -> None:
    """Only tiles within two tiles of the course that slid exceed the limits."""
    one = case("hexagon")
    image, field = one.planted("slipped-course", 0.3, seed=2, side=256)
    verdict = one.verdict(image)
    assert verdict.preserved is False
    bad = verdict.output.tiles.centers[verdict.course_excess > 1]
    rows = np.nonzero(field.any(-1))
    assert len(bad)
    nearest = np.abs(bad[:, 1:] - rows[0]).min(1)
    assert nearest.max() < 2 * one.lattice.s


def test_short_courses_are_left_out() -> None:
    """An image of one tile has no course, so no tile exceeds the limits."""
    one = case("hexagon")
    periodic = measure(one).periodic
    tiny = measure_tiles(one.fresh()[:34, :34], periodic, np.zeros(2))
    whole = measure_tiles(one.fresh(), periodic, np.zeros(2))
    assert len(tiny.here) and not np.isfinite(course_gains(tiny)).any()
    assert course_gain_excess(tiny, [whole]).tolist() == [0.0] * len(tiny.here)


@pytest.mark.parametrize("name", MODELS)
def test_no_course_of_a_fresh_draw_has_slid(name: str) -> None:
    """Every course of a fresh draw is more likely in its place than elsewhere, and none exceeds the limits."""
    verdict = case(name).verdict(case(name).fresh(256))
    courses = verdict.output.courses
    assert max(gain.max() for gain in courses.gain) < 0
    references = [image.courses for image in verdict.references]
    assert course_slide_excess(courses, references, verdict.output.tiles).max() < 0.8


@pytest.mark.parametrize("name", MODELS)
def test_a_course_that_slid_by_little_is_detected(name: str) -> None:
    """If a course slid by 0.15 s, which the windows alone hardly show, regularity is lost."""
    image, _ = case(name).planted("slipped-course", 0.15, seed=2, side=256)
    verdict = case(name).verdict(image)
    assert verdict.preserved is False
    assert "a course of tiles has slid" in verdict.faults
    slide = verdict.output.courses.worst_slide
    assert slide is not None and slide / verdict.reference.lattice.s == pytest.approx(0.15, abs=0.03)


@pytest.mark.parametrize("name", MODELS)
def test_a_course_within_the_tolerance_has_not_slid(name: str) -> None:
    """A course that slid by 0.06 s, less than the tolerance, is no fault, although its exact place is unlikely."""
    image, _ = case(name).planted("slipped-course", 0.06, seed=2, side=256)
    verdict = case(name).verdict(image)
    assert verdict.course_excess.max() <= 1


@pytest.mark.parametrize("seed", [1, 4])
def test_a_course_of_yarns_that_differ_is_detected(seed: int) -> None:
    """At a regular share of 0.4 a slide of 0.15 s is detected in a weave of different yarns, none in a fresh draw."""
    model = Weave(rotation=7.0 * (seed - 1), color=0.55, intensity=0.25, noise=0.05)
    one = Case.of(model, seed)
    slid = one.verdict(one.planted("slipped-course", 0.15, seed=seed, side=256)[0])
    assert slid.course_excess.max() > 1
    fresh = one.verdict(one.fresh(256))
    assert fresh.course_excess.max() < 0.8


def test_a_color_added_everywhere_moves_no_course() -> None:
    """The gains do not change if the same color is added to every pixel."""
    one = case("weave")
    periodic, image = measure(one).periodic, one.fresh(128)
    brighter = image + np.array([0.05, -0.03, 0.1], np.float32)
    here, there = (measure_courses(some, periodic.lattice, periodic) for some in (image, brighter))
    for first, second in zip(here.gain, there.gain, strict=True):
        finite = np.isfinite(first)
        assert np.allclose(first[finite], second[finite], atol=1e-3)


@pytest.mark.parametrize("name", MODELS)
def test_bent_content_is_detected(name: str) -> None:
    """A warp of up to 0.15 s scatters windows more than fresh draws do, and a further fresh draw does not."""
    one = case(name)
    bent = one.verdict(one.planted("warp", 0.15, seed=2, side=256)[0])
    assert "the content is bent" in bent.faults
    fresh = one.verdict(one.fresh(256, 1))
    references = [image.windows for image in fresh.references]
    assert scatter_excess(fresh.output.windows, references) < 0.6


def test_courses_follow_the_lattice_origin() -> None:
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


@pytest.mark.parametrize("count", [50, 500, 5000])
@pytest.mark.parametrize("law", ["exponential", "normal"])
def test_false_alarms_do_not_grow_with_the_number_of_windows(count: int, law: str) -> None:
    """The largest surprisal of an image without defects exceeds x with a probability of about exp(-x) at most."""
    rng, worst = np.random.default_rng(0), []
    for _ in range(300):
        draw = rng.exponential if law == "exponential" else rng.normal
        worst.append(ExponentialTail.fit(draw(size=1000)).surprisal(draw(size=count)).max())
    for x in (2.0, 3.0):
        assert np.mean(np.array(worst) > x) < 2 * np.exp(-x)


def test_surprisal_grows_with_the_value_and_shrinks_with_the_excesses() -> None:
    """Larger values have a larger surprisal. A tail that is estimated from fewer excesses gives a smaller one."""
    tail, thin = (
        ExponentialTail.fit(np.random.default_rng(1).exponential(size=1000), overlap=overlap) for overlap in (1, 20)
    )
    far = np.array([5.0, 9.0, 20.0])
    assert np.all(np.diff(tail.surprisal(far)) > 0)
    assert np.all(thin.surprisal(far) < tail.surprisal(far))


def test_constant_references_have_a_tail() -> None:
    """If all references are equal, the surprisal is finite and still increases with the value."""
    surprisal = ExponentialTail.fit(np.zeros(40)).surprisal(np.array([0.0, 1.0]))
    assert np.isfinite(surprisal).all()
    assert surprisal[0] < surprisal[1]
