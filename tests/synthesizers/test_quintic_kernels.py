import numpy as np
import pytest
from scipy import ndimage

from nrbench.synthesizers.sampling.quintic_kernels import PAD, quintic_at


@pytest.mark.parametrize("channels", [1, 3])
def test_it_is_the_spline_of_scipy(channels: int) -> None:
    """At any points, far outside as well, values are those of scipy's spline of order 5, mirrored at the border."""
    rng = np.random.default_rng(0)
    image = rng.random((11, 17, channels))
    planes = [ndimage.spline_filter(plane, 5, mode="mirror") for plane in np.moveaxis(image, 2, 0)]
    padded = np.pad(np.stack(planes, -1), ((PAD, PAD), (PAD, PAD), (0, 0)), "reflect")
    points = np.concatenate([rng.uniform(-40, 60, (500, 2)), rng.integers(-2, 20, (50, 2))])
    expected = [
        ndimage.map_coordinates(plane, points.T[::-1], order=5, mode="mirror", prefilter=False) for plane in planes
    ]
    np.testing.assert_allclose(quintic_at(padded, points), np.stack(expected, -1), atol=2e-6)


def test_it_goes_through_the_pixels() -> None:
    """At whole pixels, the outermost included, the values are the image's."""
    image = np.random.default_rng(1).random((9, 8, 1))
    padded = np.pad(
        ndimage.spline_filter(image[..., 0], 5, mode="mirror")[..., np.newaxis],
        ((PAD, PAD), (PAD, PAD), (0, 0)),
        "reflect",
    )
    y, x = np.indices((9, 8))
    found = quintic_at(padded, np.stack([x, y], -1).reshape(-1, 2).astype(np.float64))
    np.testing.assert_allclose(found.reshape(9, 8), image[..., 0], atol=1e-6)
