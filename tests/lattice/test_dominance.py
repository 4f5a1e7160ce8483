import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from nrbench.api import texture
from nrbench.errors import BadInput
from nrbench.imaging.door import quantize
from nrbench.lattice.detection import Detector, NoLatticeFound, Surface
from nrbench.lattice.dominance import Dominance
from nrbench.lattice.error import lattice_error
from nrbench.lattice.regions import dominance

PERIODIC = {"color": 0.0, "noise": 0.0}
FAST = Dominance(reject="none")


@settings(max_examples=30, deadline=None)
@given(st.integers(1, 60), st.integers(0, 2**32 - 1))
def test_a_region_ends_at_the_nearest_higher_peak(count: int, seed: int) -> None:
    """The radius is the distance to the nearest higher peak, mirror images and lag 0 among them: by brute force."""
    rng = np.random.default_rng(seed)
    lags, values = rng.uniform(-50, 50, (count, 2)), rng.permutation(count) / count
    for i, radius in enumerate(dominance(lags, values)):
        higher = lags[values > values[i]]
        others = np.concatenate([higher, -higher, np.zeros((1, 2))])
        assert radius == pytest.approx(np.hypot(*(others - lags[i]).T).min())


@pytest.mark.parametrize("model", ["squares", "brick", "hexagon", "weave"])
def test_periodic_textures_are_exact(model: str) -> None:
    """Without departures the lattice is exact, within 0.1 px, on an image that is not square."""
    sample = texture(model, (150, 128), 0, **PERIODIC)
    found = Dominance().detect(quantize(sample.image))
    assert sample.lattice is not None
    error = lattice_error(found.lattice, sample.lattice, (128, 128))
    assert error.relation == "exact" and error.vector < 0.1
    assert found.diagnostics["tested_support"] > found.diagnostics["limit"] > 0


@pytest.mark.parametrize("model", ["squares", "brick", "hexagon"])
def test_departures_leave_the_lattice(model: str) -> None:
    """With color, grain and jitter three in four draws at least are exact."""
    exact = 0
    for seed in range(4):
        sample = texture(model, (128, 128), seed, color=0.3, noise=0.1, jitter=0.2)
        assert sample.lattice is not None
        found = FAST.detect(quantize(sample.image)).lattice
        exact += lattice_error(found, sample.lattice, (128, 128)).relation == "exact"
    assert exact >= 3


def test_whole_pixels_stay_near() -> None:
    """Without the sub-pixel fit the vectors are off by a pixel at most."""
    sample = texture("hexagon", (128, 128), 0, **PERIODIC)
    assert sample.lattice is not None
    found = Dominance(subpixel=False, reject="none").detect(quantize(sample.image)).lattice
    assert np.all(found.matrix == np.rint(found.matrix)) and found.is_equivalent(sample.lattice, 1.0)


@pytest.mark.parametrize("angle", [0.0, 0.6, np.pi / 2])
def test_a_grating_has_no_lattice(angle: float) -> None:
    """Stripes in noise repeat along one direction only: refused."""
    y, x = np.indices((128, 128))
    stripes = np.tanh(4 * np.sin(2 * np.pi * (x * np.cos(angle) + y * np.sin(angle)) / 17.3))
    image = 0.5 + 0.15 * stripes + 0.03 * np.random.default_rng(0).standard_normal((128, 128))
    with pytest.raises(NoLatticeFound):
        Dominance().detect(quantize(np.clip(image, 0, 1)[..., np.newaxis].astype(np.float32)))


def test_noise_and_constants_have_no_lattice() -> None:
    """White noise is refused with the best candidate; a constant image for what it is."""
    with pytest.raises(NoLatticeFound, match="no better than chance") as no:
        Dominance().detect(np.random.default_rng(0).random((96, 64, 3)).astype(np.float32))
    assert no.value.best is not None
    with pytest.raises(NoLatticeFound, match="constant"):
        FAST.detect(np.full((64, 64, 3), 0.4, np.float32))


@pytest.mark.parametrize("shape", [(8, 8), (8, 40), (13, 9)])
def test_tiny_images_are_refused_in_words(shape: tuple[int, int]) -> None:
    """The smallest images raise nothing but a refusal."""
    for seed in range(10):
        image = np.random.default_rng(seed).random((*shape, 3)).astype(np.float32)
        with pytest.raises(NoLatticeFound, match=r"no two peaks|chance"):
            Dominance(surrogates=10).detect(image)


def test_it_is_a_detector_that_can_be_drawn_and_repeats() -> None:
    """The plugin has the form, its surface holds as many peaks as multiples, and twice it answers the same."""
    image = quantize(texture("brick", (96, 96), 0, **PERIODIC).image)
    first, second = Dominance().detect(image), Dominance().detect(image)
    surface = first.diagnostics["correlation"]
    assert isinstance(Dominance(), Detector) and isinstance(surface, Surface)
    assert 0 < first.diagnostics["hits"] <= len(surface.peaks) <= first.diagnostics["multiples"]
    assert first.lattice == second.lattice and 0 < first.confidence <= 1
    np.testing.assert_array_equal(first.diagnostics["surrogate_support"], second.diagnostics["surrogate_support"])


@pytest.mark.parametrize(
    ("parameter", "hint"),
    [
        ({"prominence": 1.0}, "below 1"),
        ({"candidates": 1}, "at least 2"),
        ({"tolerance": 0.5}, "between 0 and 0.5"),
        ({"reject": "maybe"}, "none or surrogate"),
        ({"surrogates": 1}, "at least 2"),
        ({"false_alarms": 0.0}, "probability"),
    ],
)
def test_parameters_out_of_range_are_refused(parameter: dict[str, object], hint: str) -> None:
    """Each says which parameter it is, and what to give."""
    with pytest.raises(BadInput, match=hint) as refusal:
        Dominance(**parameter)  # type: ignore[arg-type]
    assert str(refusal.value).startswith(f"dominance: {next(iter(parameter))}")
