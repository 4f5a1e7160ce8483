import numpy as np
import pytest

from nrbench.detectors.autocorrelation.surrogates import phase_randomized, upper_limit


def test_the_spectrum_is_kept_and_the_channels_with_it() -> None:
    """Mean power over many surrogates is the image's, and so are the covariances between channels."""
    rng = np.random.default_rng(0)
    fields = rng.standard_normal((48, 64, 2))
    image = (fields @ [[0.1, 0.05, 0.0], [0.0, 0.1, -0.08]]).astype(np.float32)
    surrogates = np.stack(list(phase_randomized(image, rng, 40)))
    assert surrogates.shape == (40, 48, 64, 3)
    covariances = np.mean([np.cov(one.reshape(-1, 3).T) for one in surrogates], 0)
    # Of the torus that holds the image once and three times nothing, a quarter is seen.
    np.testing.assert_allclose(4 * covariances, np.cov(image.reshape(-1, 3).T), atol=1e-3)


def test_surrogates_differ_and_repeat_with_their_stream() -> None:
    """Two surrogates of one image differ; the same stream gives the same ones."""
    image = np.random.default_rng(0).random((20, 30, 1)).astype(np.float32)
    first, second = phase_randomized(image, np.random.default_rng(1), 2)
    again, _ = phase_randomized(image, np.random.default_rng(1), 2)
    assert not np.allclose(first, second)
    np.testing.assert_array_equal(first, again)


def test_a_commensurate_lattice_does_not_survive() -> None:
    """A wave that fits the image exactly loses its constant phase."""
    wave = np.broadcast_to(np.sin(2 * np.pi * np.arange(64) / 8)[:, np.newaxis], (64, 64, 1)).astype(np.float32)
    surrogate = next(iter(phase_randomized(wave, np.random.default_rng(0), 1)))
    phases = np.angle((surrogate[..., 0] * np.exp(-2j * np.pi * np.arange(64) / 8)).reshape(64, 8, 8).mean(2))
    assert phases.std() > 0.2


def test_the_limit_is_exceeded_as_often_as_said() -> None:
    """Of maxima over many normal values, 1 % exceed the limit fitted to others."""
    rng = np.random.default_rng(0)
    limit = upper_limit(rng.standard_normal((3000, 300)).max(1), 0.01)
    assert (rng.standard_normal((20000, 300)).max(1) > limit).mean() == pytest.approx(0.01, abs=0.006)
