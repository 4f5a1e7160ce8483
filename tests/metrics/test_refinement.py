import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy import ndimage

from nrbench.imaging.mean_tile import Tile
from nrbench.lattice.geometry import Lattice
from nrbench.metrics.ncc.refinement import Cell, refine_displacements
from nrbench.metrics.verdict.reference import Reference, reference_from_model
from nrbench.metrics.verdict.windows import register_windows

from .conftest import MODELS, Case, make_case

LATTICE = Lattice((17.3, 2.6), (-3.1, 14.8), (4.2, 1.7))
RNG = np.random.default_rng(0)
VALUES = np.stack([ndimage.gaussian_filter(RNG.random((60, 70)), 3, mode="wrap") for _ in range(3)], -1)
TILE = Tile((4 * VALUES).astype(np.float32), np.ones((60, 70)), LATTICE)
FLAT = Tile(np.full((1, 1, 1), 0.01, np.float32), np.ones((1, 1)), LATTICE)
CELL = Cell.of(TILE, FLAT, 0.01)
CORNERS = np.array([(0, 0), (13, 5), (40, 31)])


def measure(case: Case) -> Reference:
    """Return the reference of a case."""
    assert case.texture.lattice is not None
    return reference_from_model(case.texture, case.texture.lattice, case.again)


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
    periodic = measure(make_case(name)).periodic
    ideal = periodic.image((150, 150))
    for left, top in ((0, 0), (5, 3), (2, 11)):
        windows = register_windows(np.ascontiguousarray(ideal[top:, left:]), periodic)
        assert np.hypot(*periodic.lattice.wrap(np.add(windows.phase, (left, top)))) < 0.02
        assert np.hypot(*windows.offsets.T).max() < 0.05
