import numpy as np

from nrbench.imaging.registration import cut_windows
from nrbench.metrics.places import Places, binned, smoothed
from nrbench.metrics.yardstick import model_yardstick

from .conftest import make_case


def test_pixels_taken_two_by_two_find_the_same_places() -> None:
    """At half the resolution, at every offset, windows of a fresh draw are found where all of their pixels put them."""
    case = make_case("hexagon")
    assert case.texture.lattice is not None
    places = model_yardstick(case.texture, case.texture.lattice, case.again).periodic.places
    window = places.template.window
    y, x = np.indices((9, 9)).reshape(2, -1) * 14
    windows = cut_windows(case.fresh(192), np.stack([x, y], -1), window)
    fine, coarse = (Places(places.template, places.inside, size).find(windows) for size in (1, 2))
    away = case.texture.lattice.wrap(fine[0] - coarse[0])
    assert np.hypot(*away.T).max() < 0.5
    assert np.abs(fine[1] - coarse[1]).max() < 0.12


def test_binning_is_smoothing_at_every_other_pixel() -> None:
    """Means over blocks are the running means at the blocks' first pixels; what is left over is cut off."""
    image = np.random.default_rng(0).random((9, 12, 3), np.float32)
    np.testing.assert_allclose(binned(image[np.newaxis], 2)[0], smoothed(image, 2)[::2, ::2], atol=1e-6)
    np.testing.assert_array_equal(binned(image[np.newaxis], 1)[0], image)
    np.testing.assert_array_equal(smoothed(image, 1), image)
