import numpy as np
import pytest

from nrbench.metrics.ncc.window_search import Bank, Template


def bank(window: tuple[int, int], channels: int, patch: int = 40) -> Bank:
    """Return a bank of a random template, looked at in a disk of offsets."""
    rng = np.random.default_rng(window[0])
    image = rng.random((patch, patch, channels), np.float32)
    template = Template(image, rng.random((patch, patch), np.float32) + np.float32(0.2), window)
    y, x = np.indices((patch - window[0] + 1, patch - window[1] + 1))
    return Bank(template, np.hypot(y - 9, x - 11) < 8, channels)


@pytest.mark.parametrize("channels", [1, 3])
@pytest.mark.parametrize("window", [(12, 9), (17, 20)])
def test_the_product_equals_the_transforms(window: tuple[int, int], channels: int) -> None:
    """NCC and slope by matrix product are those by FFT, at every offset that was asked for."""
    one = bank(window, channels)
    windows = np.random.default_rng(1).random((5, channels, *window), np.float32)
    assert one.small
    ncc, slope = one.template.surfaces_and_slopes(np.moveaxis(windows, 1, -1))
    found = one.compare(windows)
    np.testing.assert_allclose(found[0], ncc[:, one.where], atol=1e-5)
    np.testing.assert_allclose(found[1], slope[:, one.where], atol=1e-5)


def test_colors_of_a_template_may_lie_on_one_axis() -> None:
    """Where the template varies along the first axis alone one product stands for all, and the answer is the same."""
    one = bank((12, 9), 1)
    image = np.concatenate([one.template.image, np.zeros((40, 40, 2), np.float32)], -1)
    two = Bank(Template(image, one.template.weights, one.template.window), one.where, 1)
    windows = np.random.default_rng(1).random((5, 3, 12, 9), np.float32)
    ncc, slope = two.template.surfaces_and_slopes(np.moveaxis(windows, 1, -1))
    np.testing.assert_allclose(two.compare(windows)[0], ncc[:, one.where], atol=1e-5)
    np.testing.assert_allclose(two.compare(windows)[1], slope[:, one.where], atol=1e-5)


def test_a_large_window_goes_by_the_transforms() -> None:
    """Where the product would cost more the answer is the same, and the maps say -1 outside."""
    one = bank((30, 30), 3, 300)
    one = Bank(one.template, np.ones_like(one.where), 3)
    assert not one.small
    ncc, _ = one.compare(np.moveaxis(one.template.image[np.newaxis, 5:35, 7:37], -1, 1))
    assert np.unravel_index(one.surfaces(ncc)[0].argmax(), one.where.shape) == (5, 7)


def test_flat_windows_show_nothing() -> None:
    """A window without variance has NCC and slope 0, never infinite."""
    one = bank((12, 9), 3)
    ncc, slope = one.compare(np.full((2, 3, 12, 9), 0.5, np.float32))
    assert np.abs(ncc).max() == 0 and np.abs(slope).max() == 0
    assert set(np.unique(one.surfaces(ncc))) == {-1.0, 0.0}
