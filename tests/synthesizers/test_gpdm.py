"""Direct patch distribution matching: the distance and its gradient are exact, and the output approaches the sample."""

import numpy as np
import pytest
import scipy
from synthesis_cases import noise, synthesize

from nrbench import texture
from nrbench.imaging.convert import Image, quantize, to_bytes
from nrbench.synthesizers.gpdm import Gpdm, SlicedDistance, draw_filters, to_planes
from nrbench.synthesizers.quilting import Quilting


def measure(image: Image, other: Image, count: int = 64) -> tuple[float, np.ndarray]:
    """Return the sliced Wasserstein distance, and its gradient."""
    planes = to_planes(image), to_planes(other)
    filters = draw_filters(count, image.shape[2], 7, np.random.default_rng(9))
    return SlicedDistance(planes[0].shape, planes[1].shape, 7, count).measure(*planes, filters)


@pytest.mark.parametrize("channels", [1, 3])
def test_the_distance_is_that_of_scipy(channels: int) -> None:
    """For images of two sizes it is the mean Wasserstein distance of the projections of all patches."""
    image, other = noise(30, 26, channels, seed=1), 0.8 * noise(19, 33, channels, seed=2)
    filters = draw_filters(5, channels, 7, np.random.default_rng(9))
    projected = [
        [scipy.signal.correlate(each, kernel.transpose(1, 2, 0), "valid").ravel() for kernel in filters]
        for each in (image, other)
    ]
    expected = np.mean([scipy.stats.wasserstein_distance(*pair) for pair in zip(*projected, strict=True)])
    assert measure(image, other, 5)[0] == pytest.approx(expected, rel=0.01)


def test_the_gradient_is_the_slope_of_the_distance() -> None:
    """A small step against the gradient lowers the distance by the step times the squared length of the gradient."""
    image, other = noise(24, 24, 3, seed=1), noise(24, 24, 3, seed=2) ** 2
    distance, gradient = measure(image, other)
    slope = gradient / (64 * 18 * 18)
    step = 1e-3 / np.abs(slope).max()
    moved = measure(image - np.float32(step) * np.moveaxis(slope, 0, -1), other)[0]
    assert distance - moved == pytest.approx(step * float((slope**2).sum()), rel=0.05)


def test_the_output_is_nearer_to_the_sample_than_that_of_quilting() -> None:
    """By directions that the method did not see, the distance is below that of quilting, and far below the start's."""
    sample = quantize(texture("brick", (64, 64), 3, color=0.3, noise=0.03).image)
    made = measure(synthesize(Gpdm(), sample, (96, 96)).image, sample)[0]
    assert made < np.median(
        [measure(synthesize(Quilting(), sample, (96, 96), None, k).image, sample)[0] for k in range(5)]
    )
    assert made < 0.3 * measure(synthesize(Gpdm(steps=20), sample, (96, 96)).image, sample)[0]


def test_a_flat_sample_gives_a_flat_output_of_8_bits() -> None:
    """The noise of the start vanishes: all pixels have the sample's gray level."""
    sample = quantize(np.full((40, 40, 1), 0.4, np.float32))
    assert (to_bytes(synthesize(Gpdm(), sample, (30, 50)).image) == to_bytes(sample[:1, :1])).all()
