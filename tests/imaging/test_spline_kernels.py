"""Compiled splines against scipy's."""

from __future__ import annotations

import numpy as np
import pytest
from scipy import ndimage

from nrbench.imaging.fold_kernels import PAD, spline_coefficients, spline_windows


@pytest.mark.parametrize("shape", [(16, 40, 1), (61, 17, 3)])
def test_coefficients_are_those_of_a_mirrored_cubic_spline(shape: tuple[int, int, int]) -> None:
    """They equal scipy's for the same border, channel by channel, and are mirrored beyond it."""
    image = np.random.default_rng(0).random(shape, np.float32)
    found = spline_coefficients(image)
    inside = found[PAD:-PAD, PAD:-PAD]
    expected = np.stack([ndimage.spline_filter(plane, 3, mode="mirror") for plane in np.moveaxis(image, -1, 0)], -1)
    np.testing.assert_allclose(inside, expected, atol=1e-5)
    np.testing.assert_array_equal(found, np.pad(inside, ((PAD, PAD), (PAD, PAD), (0, 0)), mode="reflect"))


def test_values_between_pixels_are_scipys_up_to_the_border() -> None:
    """At random places, and at the four corners, the values equal scipy's; at whole pixels those of the image."""
    rng = np.random.default_rng(1)
    image = rng.random((30, 23, 3), np.float32)
    middles, around = rng.uniform(6, 16, (7, 2)), rng.uniform(-6, 6, (50, 2))
    places = np.concatenate([(middles[:, np.newaxis] + around).reshape(-1, 2), [[0, 0], [22, 0], [0, 29], [22, 29]]])
    coefficients = spline_coefficients(image)
    found = spline_windows(coefficients, np.ascontiguousarray(places), np.zeros((1, 2)))[:, 0]
    planes = [ndimage.map_coordinates(image[..., c], places.T[::-1], mode="mirror", order=3) for c in range(3)]
    np.testing.assert_allclose(found, np.stack(planes, -1), atol=1e-5)
    assert spline_windows(coefficients, middles, around) == pytest.approx(found[:-4].reshape(7, 50, 3))
    np.testing.assert_allclose(found[-4:], image[[0, 0, 29, 29], [0, 22, 0, 22]], atol=1e-5)
