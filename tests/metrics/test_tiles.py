from collections.abc import Callable

import numpy as np
import pytest

from nrbench.metrics.verdict.reference import Reference, reference_from_model
from nrbench.metrics.verdict.tiles import measure_tiles

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
