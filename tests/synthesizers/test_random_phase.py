import numpy as np
import pytest

from nrbench.errors import BadInput
from nrbench.imaging.convert import Image, quantize
from nrbench.plugins.forms import Task
from nrbench.running.output_checks import checked_synthesis
from nrbench.synthesizers.random_phase import RandomPhase, _periodic


def sample(shape: tuple[int, int] = (96, 96)) -> Image:
    """Return smooth colored noise, its channels correlated, far from black and white; it wraps."""
    white = np.fft.rfft2(np.random.default_rng(0).standard_normal((3, *shape)))
    y, x = np.fft.fftfreq(shape[0])[:, np.newaxis], np.fft.rfftfreq(shape[1])
    smooth = np.fft.irfft2(white * np.exp(-800 * (x**2 + y**2)), shape)
    colors = np.array([[1, 0.2, 0], [0.8, 0.5, 0], [0.3, 0.1, 0.6]])
    mixed = np.tensordot(colors, smooth / smooth.std(), 1)
    return quantize(np.moveaxis(0.5 + 0.06 * mixed, 0, -1).astype(np.float32))


def made(shape: tuple[int, int], seed: int = 0) -> Image:
    """Run the method, and check its result."""
    task = Task(sample(), shape, None, np.random.default_rng(seed))
    return checked_synthesis(RandomPhase().synthesize(task), sample(), shape).image


def covariance(image: Image) -> np.ndarray:
    """Return the 3 x 3 covariance of the colors."""
    return np.cov(image.reshape(-1, 3).T)


def test_at_the_samples_size_the_spectrum_is_the_samples() -> None:
    """The moduli of all frequencies, and the phases between channels, are those of the periodic component."""
    planes = [np.moveaxis(image.astype(np.float64), -1, 0) for image in (sample(), made((96, 96)))]
    own, other = np.fft.rfft2(_periodic(planes[0])), np.fft.rfft2(planes[1])
    strong = np.abs(own) > 3
    np.testing.assert_allclose(np.abs(other[strong]), np.abs(own[strong]), rtol=0.1)
    between, kept = own[0] * own[1].conj(), other[0] * other[1].conj()
    strong = np.abs(between) > 20
    assert np.abs(np.angle(kept / between)[strong]).max() < 0.2


@pytest.mark.parametrize("shape", [(300, 280), (300, 50), (96, 96)])
def test_colors_and_their_covariance_are_kept(shape: tuple[int, int]) -> None:
    """Over draws, mean and covariance of the colors are the sample's, at any output size."""
    draws = [made(shape, seed) for seed in range(12)]
    np.testing.assert_allclose(np.mean([d.mean((0, 1)) for d in draws], 0), sample().mean((0, 1)), atol=0.02)
    expected = covariance(sample())
    found = np.mean([covariance(draw) for draw in draws], 0)
    assert np.abs(found - expected).max() < 0.25 * expected.max()


def test_jumps_across_the_borders_are_taken_out() -> None:
    """Of a ramp across the picture the periodic component keeps under a tenth of the jump, and the mean."""
    ramp = np.broadcast_to(np.arange(64) / 6.4, (1, 64, 64))
    periodic = _periodic(ramp)
    assert np.abs(periodic[..., 0] - periodic[..., -1]).max() < 1
    assert periodic.mean() == pytest.approx(ramp.mean())


@pytest.mark.parametrize("fade", [-0.1, 0.6])
def test_a_fade_beyond_half_is_refused(fade: float) -> None:
    """It must leave a middle."""
    with pytest.raises(BadInput, match="fade"):
        RandomPhase(fade)
