import numpy as np
import pytest

from nrbench.metrics.ncc.window_search import Correlator, Template


def make_correlator(window: tuple[int, int], channels: int, patch: int = 40) -> Correlator:
    """Return the correlator of a random template, for a disk of offsets."""
    rng = np.random.default_rng(window[0])
    image = rng.random((patch, patch, channels), np.float32)
    template = Template(image, rng.random((patch, patch), np.float32) + np.float32(0.2), window)
    y, x = np.indices((patch - window[0] + 1, patch - window[1] + 1))
    return Correlator(template, np.hypot(y - 9, x - 11) < 8, channels)


@pytest.mark.parametrize("channels", [1, 3])
@pytest.mark.parametrize("window", [(12, 9), (17, 20)])
def test_the_product_equals_the_transforms(window: tuple[int, int], channels: int) -> None:
    """NCC and slope by matrix product equal those by FFT, at every chosen offset."""
    correlator = make_correlator(window, channels)
    windows = np.random.default_rng(1).random((5, channels, *window), np.float32)
    assert correlator.small
    ncc, slope = correlator.template.surfaces_and_slopes(np.moveaxis(windows, 1, -1))
    own_ncc, own_slope = correlator.correlate(windows)
    np.testing.assert_allclose(own_ncc, ncc[:, correlator.where], atol=1e-5)
    np.testing.assert_allclose(own_slope, slope[:, correlator.where], atol=1e-5)


def test_colors_of_a_template_may_lie_on_one_axis() -> None:
    """If the template varies along the first axis only, one product is enough, and the result is the same."""
    correlator = make_correlator((12, 9), 1)
    image = np.concatenate([correlator.template.image, np.zeros((40, 40, 2), np.float32)], -1)
    other = Correlator(Template(image, correlator.template.weights, correlator.template.window), correlator.where, 1)
    windows = np.random.default_rng(1).random((5, 3, 12, 9), np.float32)
    ncc, slope = other.template.surfaces_and_slopes(np.moveaxis(windows, 1, -1))
    np.testing.assert_allclose(other.correlate(windows)[0], ncc[:, correlator.where], atol=1e-5)
    np.testing.assert_allclose(other.correlate(windows)[1], slope[:, correlator.where], atol=1e-5)


def test_large_windows_use_the_transforms() -> None:
    """If the product costs more, FFTs are used, and the largest NCC is where the window was cut."""
    correlator = make_correlator((30, 30), 3, 300)
    correlator = Correlator(correlator.template, np.ones_like(correlator.where), 3)
    assert not correlator.small
    ncc, _ = correlator.correlate(np.moveaxis(correlator.template.image[np.newaxis, 5:35, 7:37], -1, 1))
    assert np.unravel_index(correlator.surfaces(ncc)[0].argmax(), correlator.where.shape) == (5, 7)


def test_flat_windows_have_no_correlation() -> None:
    """A window without variance has an NCC and a slope of 0."""
    correlator = make_correlator((12, 9), 3)
    ncc, slope = correlator.correlate(np.full((2, 3, 12, 9), 0.5, np.float32))
    assert np.abs(ncc).max() == 0 and np.abs(slope).max() == 0
    assert set(np.unique(correlator.surfaces(ncc))) == {-1.0, 0.0}
