"""Registration of windows by NCC: templates, correlators, searches of offsets and of cells, and refinement."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.testing import assert_allclose
from scipy import ndimage

from nrbench.imaging.mean_tile import Tile
from nrbench.lattice.geometry import Lattice
from nrbench.metrics.ncc.refinement import Cell, refine_displacements
from nrbench.metrics.ncc.window_search import (
    CellSearch,
    Colors,
    Correlator,
    OffsetSearch,
    Template,
    find_peaks,
)
from nrbench.metrics.verdict.reference import Reference, reference_from_model
from nrbench.metrics.verdict.windows import register_windows

from .conftest import MODELS, Case, case

RNG = np.random.default_rng(0)
IMAGE = np.stack([ndimage.gaussian_filter(RNG.standard_normal((60, 70)), 2) for _ in range(3)], -1).astype(np.float32)
WEIGHTS = RNG.uniform(0.2, 2, (60, 70)).astype(np.float32)


def naive(window: np.ndarray, x: int, y: int) -> float:
    """Return the weighted NCC of a window at one offset, term by term."""
    h, w = window.shape[:2]
    patch, weights = IMAGE[y : y + h, x : x + w].astype(float), WEIGHTS[y : y + h, x : x + w, np.newaxis].astype(float)
    a, b = (part - (weights * part).sum((0, 1)) / weights.sum() for part in (window.astype(float), patch))
    return float((weights * a * b).sum() / np.sqrt((weights * a * a).sum() * (weights * b * b).sum()))


def test_surfaces_are_the_weighted_ncc() -> None:
    """The NCC at several offsets agrees with the definition."""
    windows = RNG.standard_normal((3, 20, 25, 3)).astype(np.float32)
    surfaces = Template(IMAGE, WEIGHTS, (20, 25)).surfaces(windows)
    assert surfaces.shape == (3, 41, 46)
    for n, y, x in ((0, 0, 0), (1, 40, 45), (2, 13, 7)):
        assert surfaces[n, y, x] == pytest.approx(naive(windows[n], x, y), abs=1e-4)


@settings(max_examples=10)
@given(st.floats(0.2, 3), st.floats(-0.3, 0.3))
def test_gain_and_offset_of_the_light_do_not_count(gain: float, offset: float) -> None:
    """Brightness and contrast of a window do not change its correlation."""
    template = Template(IMAGE, WEIGHTS, (20, 25))
    window = IMAGE[np.newaxis, 11:31, 17:42]
    assert_allclose(template.surfaces(gain * window + np.float32(offset)), template.surfaces(window), atol=2e-3)


def test_a_window_is_found_where_it_was_cut() -> None:
    """Windows of the template itself have a peak of 1 where they were cut."""
    corners = np.array([(3, 4), (30, 20), (44, 39)])
    windows = np.stack([IMAGE[y : y + 20, x : x + 25] for x, y in corners])
    at, height = find_peaks(Template(IMAGE, WEIGHTS, (20, 25)).surfaces(windows))
    assert_allclose(at, corners, atol=0.1)
    assert_allclose(height, 1, atol=1e-3)


@pytest.mark.parametrize("shift", [(0.3, -0.4), (-0.25, 0.1), (0.5, 0.5)])
def test_peaks_are_sub_pixel(shift: tuple[float, float]) -> None:
    """A displacement by a fraction of a pixel is measured to a tenth of a pixel."""
    shifted = np.stack([ndimage.shift(plane, shift[::-1], order=5) for plane in np.moveaxis(IMAGE, -1, 0)], -1)
    at, _ = find_peaks(Template(IMAGE, WEIGHTS, (20, 25)).surfaces(shifted[np.newaxis, 15:35, 20:45]))
    assert_allclose(at[0], (20 - shift[0], 15 - shift[1]), atol=0.1)


def test_a_mask_bounds_the_search() -> None:
    """The peak is searched for inside the mask only."""
    surfaces = Template(IMAGE, WEIGHTS, (20, 25)).surfaces(IMAGE[np.newaxis, 11:31, 17:42])
    where = np.zeros(surfaces.shape[1:], np.bool_)
    where[30:, :] = True
    at, height = find_peaks(surfaces, where)
    assert at[0, 1] >= 29.5
    assert height[0] < 0.9


def test_flat_windows_and_no_windows_are_no_error() -> None:
    """A window without variance correlates with nothing; no windows give no surfaces."""
    template = Template(IMAGE, WEIGHTS, (20, 25))
    assert (template.surfaces(np.full((1, 20, 25, 3), 0.7, np.float32)) == 0).all()
    assert template.surfaces(np.zeros((0, 20, 25, 3), np.float32)).shape == (0, 41, 46)


def make_correlator(window: tuple[int, int], channels: int, patch: int = 40) -> Correlator:
    """Return the correlator of a random template, for a disk of offsets."""
    rng = np.random.default_rng(window[0])
    image = rng.random((patch, patch, channels), np.float32)
    template = Template(image, rng.random((patch, patch), np.float32) + np.float32(0.2), window)
    y, x = np.indices((patch - window[0] + 1, patch - window[1] + 1))
    return Correlator(template, np.hypot(y - 9, x - 11) < 8, channels)


@pytest.mark.parametrize("channels", [1, 3])
@pytest.mark.parametrize("window", [(12, 9), (17, 20)])
def test_the_product_equals_the_transforms(window: tuple[int, int], channels: int) -> None:
    """NCC and slope by matrix product equal those by FFT, at every chosen offset."""
    correlator = make_correlator(window, channels)
    windows = np.random.default_rng(1).random((5, channels, *window), np.float32)
    assert correlator.small
    ncc, slope = correlator.template.surfaces_and_slopes(np.moveaxis(windows, 1, -1))
    own_ncc, own_slope = correlator.correlate(windows)
    np.testing.assert_allclose(own_ncc, ncc[:, correlator.where], atol=1e-5)
    np.testing.assert_allclose(own_slope, slope[:, correlator.where], atol=1e-5)


def test_large_windows_use_the_transforms() -> None:
    """If the product costs more, FFTs are used, and the largest NCC is where the window was cut."""
    correlator = make_correlator((30, 30), 3, 300)
    correlator = Correlator(correlator.template, np.ones_like(correlator.where), 3)
    assert not correlator.small
    ncc, _ = correlator.correlate(np.moveaxis(correlator.template.image[np.newaxis, 5:35, 7:37], -1, 1))
    assert np.unravel_index(correlator.surfaces(ncc)[0].argmax(), correlator.where.shape) == (5, 7)


def make_search(name: str) -> tuple[OffsetSearch, np.ndarray, np.ndarray]:
    """Return the search for a texture's one-tile windows, a fresh draw, and corners of windows all over it."""
    own = case(name)
    search = measure(own).periodic.tile_searches[0].offset_search
    y, x = np.indices((12, 12)).reshape(2, -1) * 9
    return search, own.fresh(160), np.stack([x, y], -1)


@pytest.mark.parametrize(("name", "sizes"), [*((name, None) for name in MODELS), ("hexagon", (2, 2))])
def test_the_best_offset_is_found_at_a_fraction_of_the_cost(name: str, sizes: tuple[int, int] | None) -> None:
    """The resulting NCC is exact, and nearly always within 0.001 of the highest NCC at any offset."""
    search, image, corners = make_search(name)
    search = replace(search, sizes=sizes or search.sizes)
    planes = search.colors.planes(image)
    at, ncc = search.find(planes, corners)
    every = search._transforms(planes, corners)
    exact = np.full((len(every), *search.where.shape), -1.0)
    exact[:, search.where] = every
    np.testing.assert_allclose(ncc, exact[np.arange(len(at)), at[:, 1], at[:, 0]], atol=1e-4)
    short = every.max(1) - ncc
    assert short.min() > -1e-4
    assert (short < 1e-3).mean() > (0.9 if sizes else 0.8)
    assert short.max() < 0.1


@pytest.mark.parametrize("name", MODELS)
def test_with_all_pixels_the_search_is_exact(name: str) -> None:
    """With single pixels and all axes of color, the maps equal those of the Fourier transforms."""
    search, image, corners = make_search(name)
    colors = replace(search.colors, main=3)
    whole = replace(search, sizes=(1, 1), colors=colors)
    planes = colors.planes(image)
    ncc = np.concatenate(list(whole.maps(planes, corners)))
    np.testing.assert_allclose(ncc, whole._transforms(planes, corners), atol=1e-4)


def test_axes_of_color_are_those_that_vary() -> None:
    """If all colors lie on a line, one axis varies. The axes preserve distances between colors."""
    shape = np.random.default_rng(0).random((20, 30, 1), np.float32)
    image = shape * np.array([0.7, -0.2, 0.4], np.float32) + np.float32(0.3)
    colors = Colors.of(image)
    assert (colors.varies, colors.main) == (1, 1)
    projected = colors.project(image)
    np.testing.assert_allclose(
        np.linalg.norm(projected, axis=-1), np.linalg.norm(image - image.mean((0, 1)), axis=-1), atol=1e-5
    )
    assert np.abs(projected[..., 1:]).max() < 1e-5


def test_blocks_of_pixels_find_the_same_places() -> None:
    """With blocks of 2 x 2 pixels, windows of a fresh draw have the same displacements as with single pixels."""
    own = case("hexagon")
    search = measure(own).periodic.cell_search
    y, x = np.indices((9, 9)).reshape(2, -1) * 14
    planes, corners = search.colors.planes(own.fresh(192)), np.stack([x, y], -1)
    sizes = (CellSearch(search.template, search.inside, search.colors, size) for size in (1, 2))
    fine, coarse = (one.find(planes, corners) for one in sizes)
    away = own.lattice.wrap(fine[0] - coarse[0])
    assert np.hypot(*away.T).max() < 0.5
    assert np.abs(fine[1] - coarse[1]).max() < 0.12


LATTICE = Lattice((17.3, 2.6), (-3.1, 14.8), (4.2, 1.7))
VALUES = np.stack(
    [ndimage.gaussian_filter(plane, 3, mode="wrap") for plane in np.random.default_rng(0).random((3, 60, 70))], -1
)
TILE = Tile((4 * VALUES).astype(np.float32), np.ones((60, 70)), LATTICE)
FLAT = Tile(np.full((1, 1, 1), 0.01, np.float32), np.ones((1, 1)), LATTICE)
CELL = Cell.of(TILE, FLAT, 0.01)
CORNERS = np.array([(0, 0), (13, 5), (40, 31)])


def measure(own: Case) -> Reference:
    """Return the reference of a case."""
    return reference_from_model(own.texture, own.lattice, own.again)


@settings(max_examples=25)
@given(st.floats(-9, 9), st.floats(-9, 9), st.floats(-0.6, 0.6), st.floats(-0.6, 0.6))
def test_displacements_are_exact_at_any_fraction_of_a_pixel(x: float, y: float, dx: float, dy: float) -> None:
    """From a start 0.6 px away the displacement of a periodic image is refined to 0.003 px, with a correlation of 1."""
    image = TILE.unfold((70, 80), (x, y))
    at, ncc = refine_displacements(image, CELL, CORNERS, (34, 36), np.array([(x + dx, y + dy)] * 3))
    np.testing.assert_allclose(at, [(x, y)] * 3, atol=0.003)
    np.testing.assert_allclose(ncc, 1, atol=1e-4)


def test_light_does_not_change_the_displacement() -> None:
    """Brightness and contrast change neither displacement nor correlation. A negative has a correlation of -1."""
    image = TILE.unfold((70, 80), (0.3, -0.4))
    for gain, sign in ((0.3, 1), (-1.0, -1)):
        at, ncc = refine_displacements(gain * image + np.float32(0.2), CELL, CORNERS, (34, 36), np.zeros((3, 2)))
        np.testing.assert_allclose(at, [(0.3, -0.4)] * 3, atol=0.01)
        np.testing.assert_allclose(ncc, sign, atol=1e-3)


def test_windows_without_the_pattern_keep_their_displacement() -> None:
    """Flat windows and noise keep their initial displacement to 1.5 px, the limit of the refinement."""
    rough = np.array([(3.0, 2.0)] * 3)
    at, ncc = refine_displacements(np.full((70, 80, 3), 0.5, np.float32), CELL, CORNERS, (34, 36), rough)
    np.testing.assert_allclose(at, rough, atol=1.5)
    assert np.abs(ncc).max() < 0.01
    at, ncc = refine_displacements(RNG.random((70, 80, 3)).astype(np.float32), CELL, CORNERS, (34, 36), rough)
    assert np.hypot(*(at - rough).T).max() <= 1.5
    assert np.abs(ncc).max() < 0.3


@pytest.mark.parametrize("name", MODELS)
def test_windows_of_the_periodic_image_lie_in_their_places(name: str) -> None:
    """On the model's own periodic image no window is displaced by more than 0.05 px, at any phase of whole pixels."""
    periodic = measure(case(name)).periodic
    ideal = periodic.image((150, 150))
    for left, top in ((0, 0), (5, 3), (2, 11)):
        windows = register_windows(np.ascontiguousarray(ideal[top:, left:]), periodic)
        assert np.hypot(*periodic.lattice.wrap(np.add(windows.phase, (left, top)))) < 0.02
        assert np.hypot(*windows.offsets.T).max() < 0.05
