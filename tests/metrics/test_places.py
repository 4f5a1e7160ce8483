import numpy as np

from nrbench.metrics.ncc.window_search import Places, cut_planes, smoothed
from nrbench.metrics.verdict.reference import reference_from_model

from .conftest import make_case


def test_pixels_taken_two_by_two_find_the_same_places() -> None:
    """At half the resolution, at every offset, windows of a fresh draw are found where all of their pixels put them."""
    case = make_case("hexagon")
    assert case.texture.lattice is not None
    places = reference_from_model(case.texture, case.texture.lattice, case.again).periodic.places
    y, x = np.indices((9, 9)).reshape(2, -1) * 14
    planes, corners = places.colors.planes(case.fresh(192)), np.stack([x, y], -1)
    sizes = (Places(places.template, places.inside, places.colors, size) for size in (1, 2))
    fine, coarse = (one.find(planes, corners) for one in sizes)
    away = case.texture.lattice.wrap(fine[0] - coarse[0])
    assert np.hypot(*away.T).max() < 0.5
    assert np.abs(fine[1] - coarse[1]).max() < 0.12


def test_windows_of_means_are_means_over_blocks() -> None:
    """Every other running mean of a window is the mean over a block of it; what is left over is cut off."""
    image = np.random.default_rng(0).random((3, 9, 12), np.float32)
    found = cut_planes(smoothed(image, 2), np.array([(1, 2)]), (7, 10), 2)
    blocks = image[:, 2:8, 1:11].reshape(3, 3, 2, 5, 2).mean((2, 4))
    np.testing.assert_allclose(found[0], blocks, atol=1e-6)
    np.testing.assert_array_equal(smoothed(image, 1), image)
