import numpy as np
import pytest

from nrbench import texture
from nrbench.detectors.autocorrelation.surrogates import SIDE, crop_for_test
from nrbench.detectors.ssdn import Ssdn, find_period, inner_relief, shift_ssdn, ssdn
from nrbench.imaging.convert import quantize
from nrbench.lattice.geometry import Lattice
from nrbench.lattice.relation import lattice_error
from nrbench.plugins.forms import NoLatticeFound

PERIODIC = {"color": 0.0, "noise": 0.0}
PAPER = Ssdn(**Ssdn.presets["paper"])


@pytest.mark.parametrize("model", ["squares", "windows", "card"])
def test_periodic_rectangular_lattices_are_exact(model: str) -> None:
    """Without departures the lattice is exact, within 0.1 px, on an image that is not square."""
    sample = texture(model, (150, 128), 0, **PERIODIC)
    found = Ssdn().detect(quantize(sample.image))
    error = lattice_error(found.lattice, sample.lattice, (128, 128))
    assert error.relation == "exact" and error.vector < 0.1


@pytest.mark.parametrize("model", ["brick", "weave", "hexagon"])
def test_other_lattices_are_refused_and_say_why(model: str) -> None:
    """The rectangular period of a centered lattice holds two cells: refused, with the rectangle as the best."""
    sample = texture(model, (128, 128), 0, **PERIODIC)
    with pytest.raises(NoLatticeFound, match="only rectangular lattices along the axes") as refusal:
        Ssdn().detect(quantize(sample.image))
    assert refusal.value.best is not None and refusal.value.best.lattice.kind in ("rectangular", "square")


@pytest.mark.parametrize("departure", [{"color": 0.3}, {"noise": 0.1}, {"jitter": 0.2}])
def test_the_rows_of_a_wall_are_no_supercell(departure: dict[str, float]) -> None:
    """A stacked wall, which repeats fairly well along its rows, has one cell in each rectangle and is exact."""
    sample = texture("brick", (160, 160), 2, bond="stack", **departure)
    found = Ssdn(reject="none").detect(quantize(sample.image))
    assert lattice_error(found.lattice, sample.lattice, (160, 160)).relation == "exact"
    assert found.diagnostics["inner"] < 0.5


def test_the_inner_peak_is_measured_from_its_pass() -> None:
    """On a rectangle with a ridge, a bump of a quarter of the corner's height above the pass counts a quarter."""
    tile = np.zeros((20, 30), np.int32)
    tile[0], tile[0, 0], tile[0, 15] = 800, 1000, 850
    inside = np.ones(tile.shape, np.bool_)
    inside[0, 0] = False
    for planted, relief in (({}, 0.25), ({(10, 15): 900}, 0.9), ({(0, 15): 1000}, 1.0), ({(10, 15): 0}, 0.25)):
        changed = tile.copy()
        for place, height in planted.items():
            changed[place] = height
        assert inner_relief(changed, inside) == pytest.approx(relief)


def test_the_papers_choice_tiles_a_weave_by_two_cells() -> None:
    """With primitive off the rectangle of a centered lattice is returned: a supercell of two cells."""
    sample = texture("weave", (128, 128), 0, **PERIODIC)
    found = Ssdn(primitive=False, reject="none").detect(quantize(sample.image)).lattice
    assert lattice_error(found, sample.lattice, (128, 128)).label == "supercell 2"


def test_the_papers_period_is_the_last_minimum_over_its_number() -> None:
    """Without sub-pixel minima the period is x_n / n, x_n whole: equation 3."""
    found = PAPER.detect(quantize(texture("squares", (160, 160), 0, **PERIODIC).image))
    marks = found.diagnostics["ssdn_x"].marks
    assert all(mark == round(mark) for mark in marks)
    assert found.lattice.matrix.max(0)[0] == pytest.approx(marks[-1] / len(marks))


def test_a_period_needs_all_its_multiples() -> None:
    """A peak half way that reaches half the height is ignored; one of nearly full height is the period."""
    lags = np.arange(200)
    for half, period in ((0.3, 40.0), (0.97, 20.0)):
        curve = np.maximum(0, np.cos(2 * np.pi * lags / 20)) ** 8 * np.where((lags // 10) % 4 % 3 == 0, 1, half)
        found = find_period(curve, 0.7, True)
        assert found is not None and found.length == pytest.approx(period, abs=0.1)


def test_large_images_are_tested_by_their_middle() -> None:
    """The crop is SIDE px a side if the lattice is fine, and ten periods if it is coarse."""
    image = np.zeros((2000, 300, 1), np.float32)
    assert crop_for_test(image, Lattice((20.0, 0.0), (0.0, 30.0))).shape == (SIDE, 300, 1)
    assert crop_for_test(image, Lattice((20.0, 0.0), (0.0, 90.0))).shape == (900, 300, 1)


@pytest.mark.parametrize("axis", [0, 1])
def test_the_curve_is_the_papers(axis: int) -> None:
    """At each lag g is the mean squared difference of the overlapping parts, summed over channels, by brute force."""
    image = np.random.default_rng(0).random((23, 17, 3)).astype(np.float32)
    turned = np.moveaxis(image, axis, 0)
    n = len(turned)
    expected = [ssdn(turned[: n - k], turned[k:]) for k in range(n)]
    np.testing.assert_allclose(shift_ssdn(image, axis)[0], expected, atol=1e-6)


def test_unrelated_parts_reach_the_expected_level() -> None:
    """For white noise g is that of unrelated parts at every lag but 0, where it is 0."""
    g, unrelated = shift_ssdn(np.random.default_rng(0).random((64, 64, 3)).astype(np.float32), 1)
    assert g[0] < 1e-9 and np.abs(g[1:48] / unrelated[1:48] - 1).max() < 0.1
