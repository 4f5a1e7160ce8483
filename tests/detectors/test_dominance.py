import numpy as np
import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st

from nrbench import texture
from nrbench.detectors.autocorrelation.vector_pair_kernels import count_hits
from nrbench.detectors.dominance import Dominance, dominance_radii
from nrbench.imaging.convert import quantize
from nrbench.lattice.geometry import Lattice
from nrbench.lattice.relation import lattice_error

PERIODIC = {"color": 0.0, "noise": 0.0}
FAST = Dominance(reject="none")


@settings(max_examples=30)
@given(st.integers(1, 60), st.integers(0, 2**32 - 1))
def test_a_region_ends_at_the_nearest_higher_peak(count: int, seed: int) -> None:
    """The radius is the distance to the nearest higher peak, mirror images and lag 0 included, by brute force."""
    rng = np.random.default_rng(seed)
    lags, values = rng.uniform(-50, 50, (count, 2)), rng.permutation(count) / count
    for i, radius in enumerate(dominance_radii(lags, values)):
        higher = lags[values > values[i]]
        others = np.concatenate([higher, -higher, np.zeros((1, 2))])
        assert radius == pytest.approx(np.hypot(*(others - lags[i]).T).min())


@pytest.mark.parametrize("model", ["squares", "brick", "hexagon", "weave"])
def test_periodic_textures_are_exact(model: str) -> None:
    """Without departures the lattice is exact, within 0.1 px, on an image that is not square."""
    sample = texture(model, (128, 112), 0, **PERIODIC)
    found = Dominance(surrogates=12).detect(quantize(sample.image))
    error = lattice_error(found.lattice, sample.lattice, (128, 128))
    assert error.relation == "exact" and error.vector < 0.1
    assert found.diagnostics["tested_support"] > found.diagnostics["limit"] > 0


@pytest.mark.parametrize("model", ["squares", "brick", "hexagon"])
def test_departures_leave_the_lattice(model: str) -> None:
    """With color, noise and jitter at least three in four draws are exact."""
    exact = 0
    for seed in range(4):
        sample = texture(model, (128, 128), seed, color=0.3, noise=0.1, jitter=0.2)
        found = FAST.detect(quantize(sample.image)).lattice
        exact += lattice_error(found, sample.lattice, (128, 128)).relation == "exact"
    assert exact >= 3


@pytest.mark.parametrize("model", ["brick", "weave"])
@pytest.mark.parametrize("seed", range(3))
def test_strong_color_makes_no_supercell(model: str, seed: int) -> None:
    """If tiles differ strongly in color, the cell is still the smallest that explains the peaks, with confidence."""
    sample = texture(model, (128, 128), seed, color=0.6, noise=0.1)
    found = FAST.detect(quantize(sample.image))
    assert lattice_error(found.lattice, sample.lattice, (128, 128)).relation == "exact" and found.confidence > 0.5


def test_peaks_on_ridges_count() -> None:
    """Rows that are far more prominent than the joints within them do not hide the lattice."""
    y, x = np.indices((192, 192))
    row = y // 16
    joints = (x + 20 * (row % 2)) % 40 < 3
    image = 0.5 + 0.3 * (y % 16 < 6) - 0.1 * joints + 0.03 * np.random.default_rng(0).standard_normal(y.shape)
    found = FAST.detect(quantize(np.clip(image, 0, 1)[..., np.newaxis].astype(np.float32)))
    assert found.lattice.is_equivalent(Lattice((40.0, 0.0), (20.0, 16.0)), 0.3) and found.confidence > 0.5


def test_few_hits_give_little_confidence() -> None:
    """A lattice returned for white noise has a confidence below 0.05."""
    found = FAST.detect(np.random.default_rng(0).random((128, 128, 3)).astype(np.float32))
    assert found.confidence < 0.05


@settings(max_examples=20)
@example(6, 6, 0.9, 2.7357683850810064, 33554433)  # two reduced bases whose vectors are equally long
@given(st.floats(6, 30), st.floats(6, 30), st.floats(0.9, 2.2), st.floats(0, 3), st.integers(0, 2**32 - 1))
def test_hits_and_points_are_counted(a: float, b: float, angle: float, turn: float, seed: int) -> None:
    """The kernel's points and hits equal those counted with the lattice's points and wrapped peaks."""
    lattice = Lattice(
        (a * np.cos(turn), a * np.sin(turn)), (b * np.cos(turn + angle), b * np.sin(turn + angle))
    ).reduced()
    rng, reach = np.random.default_rng(seed), np.array([60.3, 47.7])
    peaks = rng.uniform((0, -48), (60, 48), (400, 2))
    row = count_hits(peaks, np.ones(400, np.int64), lattice.matrix, reach, 0.15, 10**6)[0]
    every = lattice.from_cell(lattice.cell_numbers((-61, -48), (61, 48)))
    points = ((np.abs(every) <= reach).all(1).sum() - 1) // 2
    hits = np.hypot(*lattice.wrap(peaks[(np.abs(peaks) <= reach).all(1)][:points]).T) <= max(0.15 * lattice.s, 1)
    assert row[4] == points and row[5] == row[6] == hits.sum()
    assert Lattice(tuple(row[:2]), tuple(row[2:4])).is_equivalent(lattice)


def test_whole_pixels_stay_near() -> None:
    """Without the sub-pixel fit the vectors are off by a pixel at most."""
    sample = texture("hexagon", (128, 128), 0, **PERIODIC)
    found = Dominance(subpixel=False, reject="none").detect(quantize(sample.image)).lattice
    assert np.all(found.matrix == np.rint(found.matrix)) and found.is_equivalent(sample.lattice, 1.0)
