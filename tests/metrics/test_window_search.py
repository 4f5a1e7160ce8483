import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.testing import assert_allclose
from scipy import ndimage

from nrbench.metrics.ncc.window_search import Template, find_peaks

RNG = np.random.default_rng(0)
IMAGE = np.stack([ndimage.gaussian_filter(RNG.standard_normal((60, 70)), 2) for _ in range(3)], -1).astype(np.float32)
WEIGHTS = RNG.uniform(0.2, 2, (60, 70)).astype(np.float32)


def naive(window: np.ndarray, x: int, y: int) -> float:
    """Return the weighted NCC of a window at one offset, term by term."""
    h, w = window.shape[:2]
    patch, weights = IMAGE[y : y + h, x : x + w].astype(float), WEIGHTS[y : y + h, x : x + w, np.newaxis].astype(float)
    a, b = (part - (weights * part).sum((0, 1)) / weights.sum() for part in (window.astype(float), patch))
    return float((weights * a * b).sum() / np.sqrt((weights * a * a).sum() * (weights * b * b).sum()))


def test_surfaces_are_the_weighted_ncc() -> None:
    """The NCC at several offsets agrees with the definition."""
    windows = RNG.standard_normal((3, 20, 25, 3)).astype(np.float32)
    surfaces = Template(IMAGE, WEIGHTS, (20, 25)).surfaces(windows)
    assert surfaces.shape == (3, 41, 46)
    for n, y, x in ((0, 0, 0), (1, 40, 45), (2, 13, 7)):
        assert surfaces[n, y, x] == pytest.approx(naive(windows[n], x, y), abs=1e-4)


@settings(max_examples=10)
@given(st.floats(0.2, 3), st.floats(-0.3, 0.3))
def test_gain_and_offset_of_the_light_do_not_count(gain: float, offset: float) -> None:
    """Brightness and contrast of a window do not change its correlation."""
    template = Template(IMAGE, WEIGHTS, (20, 25))
    window = IMAGE[np.newaxis, 11:31, 17:42]
    assert_allclose(template.surfaces(gain * window + np.float32(offset)), template.surfaces(window), atol=2e-3)


def test_a_window_is_found_where_it_was_cut() -> None:
    """Windows of the template itself have a peak of 1 where they were cut."""
    corners = np.array([(3, 4), (30, 20), (44, 39)])
    windows = np.stack([IMAGE[y : y + 20, x : x + 25] for x, y in corners])
    at, height = find_peaks(Template(IMAGE, WEIGHTS, (20, 25)).surfaces(windows))
    assert_allclose(at, corners, atol=0.1)
    assert_allclose(height, 1, atol=1e-3)


@pytest.mark.parametrize("shift", [(0.3, -0.4), (-0.25, 0.1), (0.5, 0.5)])
def test_peaks_are_sub_pixel(shift: tuple[float, float]) -> None:
    """A displacement by a fraction of a pixel is measured to a tenth of a pixel."""
    shifted = np.stack([ndimage.shift(plane, shift[::-1], order=5) for plane in np.moveaxis(IMAGE, -1, 0)], -1)
    at, _ = find_peaks(Template(IMAGE, WEIGHTS, (20, 25)).surfaces(shifted[np.newaxis, 15:35, 20:45]))
    assert_allclose(at[0], (20 - shift[0], 15 - shift[1]), atol=0.1)


def test_a_mask_bounds_the_search() -> None:
    """The peak is searched for inside the mask only."""
    surfaces = Template(IMAGE, WEIGHTS, (20, 25)).surfaces(IMAGE[np.newaxis, 11:31, 17:42])
    where = np.zeros(surfaces.shape[1:], np.bool_)
    where[30:, :] = True
    at, height = find_peaks(surfaces, where)
    assert at[0, 1] >= 29.5
    assert height[0] < 0.9


def test_flat_windows_and_no_windows_are_no_error() -> None:
    """A window without variance correlates with nothing; no windows give no surfaces."""
    template = Template(IMAGE, WEIGHTS, (20, 25))
    assert (template.surfaces(np.full((1, 20, 25, 3), 0.7, np.float32)) == 0).all()
    assert template.surfaces(np.zeros((0, 20, 25, 3), np.float32)).shape == (0, 41, 46)
