"""Conversion at the border: what users hold becomes one form, and what cannot be used is refused by name."""

from typing import Any

import numpy as np
import pytest
import scipy

from nrbench.errors import BadInput
from nrbench.imaging.convert import (
    as_image,
    match_ndim,
    quantize,
    smooth_inside,
    to_bytes,
)

GRAY = np.random.default_rng(0).random((9, 12))
REFUSED = {
    "NaN or infinite": np.where(GRAY > 0.9, np.nan, GRAY),
    "scale floats": GRAY * 255,
    "81 transparent pixels, the first at .0, 0.; flatten": np.full((9, 9, 4), 0.97),
    "1 transparent pixels": np.where(np.arange(9 * 12 * 2).reshape(9, 12, 2) == 7, 249, 255).astype(np.uint8),
    "at least 8 px": np.ones((4, 9)),
    "convert it to uint8": np.ones((9, 9), np.int64),
    "is no image": np.ones(9),
}


@pytest.mark.parametrize("hint", REFUSED)
def test_what_cannot_be_used_is_refused(hint: str) -> None:
    """NaN, wrong range, alpha, a tiny side, another dtype or shape: the error says what was found and what to do."""
    with pytest.raises(BadInput, match=f"sample: .*{hint}"):
        as_image(REFUSED[hint], "sample")


@pytest.mark.parametrize("peak", [255, 65535, None])
def test_every_form_is_the_same_image(peak: int | None) -> None:
    """8-bit, 16-bit and float pictures of the same pixels become the same image, one channel kept."""
    eight = to_bytes(GRAY[..., np.newaxis].astype(np.float32))[..., 0]
    held = eight / 255 if peak is None else eight if peak == 255 else eight.astype(np.uint16) * 257
    image = as_image(held)
    assert image.shape == (9, 12, 1) and image.dtype == np.float32
    np.testing.assert_allclose(image[..., 0] * 255, eight, atol=1e-4)
    assert match_ndim(image, held).shape == (9, 12)


@pytest.mark.parametrize("peak", [255, 65535, 1.0])
@pytest.mark.parametrize("channels", [1, 3])
def test_opaque_alpha_is_left_out(peak: float, channels: int) -> None:
    """Alpha that is full everywhere, to 8 bits, changes nothing; the image has the channels of its colors."""
    color = (np.random.default_rng(1).random((9, 12, channels)) * peak).astype(type(peak) if peak == 1 else np.uint16)
    color = color.astype(np.uint8) if peak == 255 else color
    opaque = np.concatenate([color, np.full((9, 12, 1), peak * (1 if peak == 255 else 0.999), color.dtype)], 2)
    np.testing.assert_array_equal(as_image(opaque), as_image(color))


def test_rounding_is_what_the_png_holds() -> None:
    """Rounded to 8 bits an image stays as it is, however often; values outside [0, 1] are clipped."""
    once = quantize(np.array([[[-0.2], [0.5], [1.7]]], np.float32))
    np.testing.assert_array_equal(once, quantize(once))
    assert once.min() == 0 and once.max() == 1


@pytest.mark.parametrize("dtype", [np.float32, np.float64])
def test_fields_are_smoothed_as_scipy_does(dtype: type[np.floating[Any]]) -> None:
    """Where the kernel does not overhang, the smoothed field is that of scipy, to the bit."""
    field = np.random.default_rng(0).standard_normal((90, 41)).astype(dtype)
    kernel = np.array([0.01, 0.3, 0.9, 0.3, 0.01])
    smooth = smooth_inside(field, kernel)
    assert smooth.dtype == dtype
    np.testing.assert_array_equal(smooth, scipy.ndimage.correlate1d(field, kernel, 0)[2:-2])
