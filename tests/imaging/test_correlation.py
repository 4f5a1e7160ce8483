import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from nrbench.imaging.correlation import half_autocorrelation


def picture(height: int, width: int, channels: int, seed: int = 0) -> np.ndarray:
    """Return a smooth random image plus noise, in [0, 1]."""
    rng = np.random.default_rng(seed)
    y, x = np.indices((height, width))
    waves = np.sin(x / rng.uniform(2, 5) + rng.uniform(0, 6)) * np.cos(y / rng.uniform(2, 5)) + 0.01 * x
    image = 0.5 + 0.1 * waves[..., np.newaxis] * rng.uniform(0.2, 1, channels)
    return np.clip(image + 0.05 * rng.standard_normal((height, width, channels)), 0, 1).astype(np.float32)


def autocorrelation(image: np.ndarray) -> np.ndarray:
    """Return the normalized autocorrelation at all lags, ``(2H-1, 2W-1)``: both halves."""
    right = half_autocorrelation(image)
    return np.concatenate([right[::-1, :0:-1], right], 1)


def direct(image: np.ndarray, dx: int, dy: int) -> float:
    """Return one lag by the definition: covariances over products of deviations, summed over channels."""
    height, width = image.shape[:2]
    wide = image.astype(np.float64)
    one = wide[max(-dy, 0) : height - max(dy, 0), max(-dx, 0) : width - max(dx, 0)]
    other = wide[max(dy, 0) : height - max(-dy, 0), max(dx, 0) : width - max(-dx, 0)]
    one, other = one - one.mean((0, 1)), other - other.mean((0, 1))
    deviations = np.sqrt((one**2).sum((0, 1)) * (other**2).sum((0, 1)))
    return float((one * other).sum() / deviations.sum())


@settings(max_examples=30)
@given(st.integers(9, 40), st.integers(9, 40), st.sampled_from([1, 3]), st.data())
def test_every_lag_is_that_of_the_definition(height: int, width: int, channels: int, data: st.DataObject) -> None:
    """Any lag of any image with four rows and columns of overlap agrees with the sums written out."""
    image = picture(height, width, channels)
    dx, dy = data.draw(st.integers(5 - width, width - 5)), data.draw(st.integers(5 - height, height - 5))
    gamma = autocorrelation(image)
    assert gamma.shape == (2 * height - 1, 2 * width - 1)
    assert gamma[height - 1 + dy, width - 1 + dx] == pytest.approx(direct(image, dx, dy), abs=1e-4)


@given(st.floats(0.1, 0.9), st.floats(0.05, 0.5))
@settings(max_examples=20)
def test_brightness_and_contrast_do_not_matter(offset: float, gain: float) -> None:
    """An image made darker and flatter has the same correlation."""
    image = picture(30, 40, 3)
    other = (image * gain + offset * (1 - gain)).astype(np.float32)
    inner = np.s_[15:44, :20]
    np.testing.assert_allclose(half_autocorrelation(other)[inner], half_autocorrelation(image)[inner], atol=2e-4)


def test_flat_overlaps_correlate_to_zero() -> None:
    """Where an overlap holds no structure there is nothing to correlate, and no division by zero."""
    image = np.full((32, 32, 3), 0.25, np.float32)
    assert not autocorrelation(image).any()
    image[12:20, 12:20] = 0.75
    gamma = autocorrelation(image)
    assert np.isfinite(gamma).all() and gamma[0, 0] == 0 and gamma[31, 31] == pytest.approx(1)
