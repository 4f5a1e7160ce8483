"""The consensus detector finds the lattice of an image of any size, depth and color."""

import tracemalloc
from typing import Any

import numpy as np
import pytest
from scipy import ndimage

from nrbench import detect_lattice, texture
from nrbench.detectors.candidate_search.self_similarity_map import SIDE, _blur, make_view, view_factors
from nrbench.imaging.convert import Image, quantize, to_bytes
from nrbench.lattice.relation import lattice_error
from nrbench.plugins.forms import Texture

MODELS: dict[str, dict[str, Any]] = {
    "squares": {"period": 23.7},
    "hexagon": {"period": 23.3},
    "brick": {"width": 23.0, "height": 24.0, "bond": "stack"},
    "weave": {"warp": 12.1, "weft": 12.2},
}


def is_exact(found: Any, drawn: Texture, tolerance: float = 0.5) -> bool:
    """Return whether the detected lattice of an array is the true one."""
    error = lattice_error(detect_lattice(found).lattice, drawn.lattice, drawn.image.shape[:2], tolerance)
    return error.relation == "exact"


@pytest.mark.parametrize("model", MODELS)
@pytest.mark.parametrize(
    ("shape", "seed", "color"), [((48, 48), 3, 0.0), ((48, 48), 3, 0.2), ((60, 1000), 1, 0.3), ((1000, 60), 1, 0.3)]
)
def test_two_periods_are_enough(model: str, shape: tuple[int, int], seed: int, color: float) -> None:
    """A sample that shows two to three periods, of 48 x 48 px or a strip of 60 px either way up, has the true one."""
    drawn = texture(model, shape, seed, **MODELS[model], color=color, noise=color / 10)
    assert is_exact(to_bytes(drawn.image), drawn)


@pytest.mark.parametrize("model", ["brick", "hexagon"])
def test_depth_and_alpha_change_nothing(model: str) -> None:
    """8 bits, 16 bits and floats, with opaque alpha or without, have the same lattice; gray has nearly the same."""
    drawn = texture(model, (96, 96), 2, **MODELS[model], color=0.3)
    eight = to_bytes(drawn.image)
    sixteen = eight.astype(np.uint16) * 257
    lattice = detect_lattice(eight).lattice
    opaque = np.dstack([eight, np.full(eight.shape[:2], 255, np.uint8)])
    for form in (sixteen, eight / 255, opaque, np.dstack([sixteen, np.full(eight.shape[:2], 65535, np.uint16)])):
        assert detect_lattice(form).lattice.is_equivalent(lattice, 1e-3)
    gray = eight.mean(2).astype(np.uint8)
    for form in (gray, gray[..., np.newaxis], np.dstack([gray, np.full_like(gray, 255)])):
        assert is_exact(form, drawn)


def at_equal_luminance(image: Image, direction: tuple[float, float, float]) -> Image:
    """Return an image whose colors vary along one direction of the color space only."""
    plane = image.mean(2, keepdims=True) - image.mean()
    return quantize(0.5 + 0.4 * plane / np.abs(plane).max() * np.array(direction, np.float32))


@pytest.mark.parametrize("detector", ["consensus", "gncc", "dominance"])
@pytest.mark.parametrize("model", ["squares", "hexagon", "brick"])
@pytest.mark.parametrize("direction", [(1.0, -0.509, 0.0), (1.0, -1.0, 0.0)], ids=["luma", "mean"])
def test_color_at_equal_luminance(detector: str, model: str, direction: tuple[float, float, float]) -> None:
    """A texture that only its hues show, at equal luma or equal mean, has the true lattice, whatever the detector."""
    drawn = texture(model, (96, 112), 1, **MODELS[model], color=0.2)
    image = at_equal_luminance(drawn.image, direction)
    weights = (0.299, 0.587, 0.114) if direction[1] > -1 else (1 / 3,) * 3
    assert np.ptp(image @ np.array(weights, np.float32)) < 0.01 < np.ptp(image[..., 0])
    error = lattice_error(detect_lattice(image, detector).lattice, drawn.lattice, (96, 112))
    assert error.relation == "exact"


def test_views_need_little_memory() -> None:
    """The views of a large image need less than a quarter of its memory at a time."""
    image = np.zeros((3000, 4000, 3), np.float32)
    tracemalloc.start()
    try:
        sizes = [make_view(image, factor, SIDE).shape[:2] for factor in view_factors((3000, 4000))]
        peak = tracemalloc.get_traced_memory()[1]
    finally:
        tracemalloc.stop()
    assert sizes == [(640, 640), (640, 640), (640, 640), (375, 500)] and peak < image.nbytes / 4


@pytest.mark.parametrize("deviation", [3.0, 40.0, 111.0])
def test_a_product_of_cosine_transforms_is_a_filter(deviation: float) -> None:
    """Means under a Gaussian window are those of scipy, which mirrors the values at the borders."""
    power = np.zeros((300, 340), np.float32)
    power[40:60, 300:] = 1
    expected = ndimage.gaussian_filter(power, deviation, truncate=2)
    np.testing.assert_allclose(_blur(power, deviation), expected, atol=1e-6)
