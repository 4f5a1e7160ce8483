"""Claims about stochastic textures."""

from __future__ import annotations

from typing import Any, get_args, get_type_hints

import numpy as np
import pytest
from scipy import fft

from nrbench.datasets_procedural.noise import Noise
from nrbench.errors import BadInput
from nrbench.imaging.convert import gray

SPECTRA = get_args(get_type_hints(Noise)["spectrum"])


def _power(noise: Noise, side: int = 256) -> tuple[np.ndarray[Any, Any], np.ndarray[Any, Any]]:
    """Return the mean power by frequency in cycles a px, (fx, fy), of eight draws."""
    draws = [gray(noise.render((side, side), np.random.default_rng(seed)).image) for seed in range(8)]
    window = np.outer(np.hanning(side), np.hanning(side))
    power = np.mean([np.abs(fft.fft2((draw - draw.mean()) * window)) ** 2 for draw in draws], 0)
    return power, np.stack(np.meshgrid(fft.fftfreq(side), fft.fftfreq(side)), -1)


@pytest.mark.parametrize("spectrum", SPECTRA)
def test_truth(spectrum: Any) -> None:
    """Noise says of itself that it is stochastic: no lattice, no regular part, one color as its ideal image."""
    texture = Noise(spectrum=spectrum).render((40, 50), np.random.default_rng(0))
    assert texture.kind == "stochastic" and texture.lattice is None and texture.lattices == ()
    assert texture.regular_share == 0.0 and texture.ideal is not None
    assert texture.ideal.shape == texture.image.shape == (40, 50, 3) and np.ptp(texture.ideal, (0, 1)).max() == 0


@pytest.mark.parametrize("spectrum", SPECTRA)
def test_statistics_agree_between_sizes(spectrum: Any) -> None:
    """Mean and contrast over draws are those stated, at any size, and hardly a value is clipped."""
    noise = Noise(spectrum=spectrum, contrast=0.12)
    for side, draws in ((48, 60), (200, 8)):
        images = np.stack([noise.render((side, side), np.random.default_rng(seed)).image for seed in range(draws)])
        ideal = noise.render((8, 8), np.random.default_rng(0)).ideal
        assert ideal is not None
        np.testing.assert_allclose(images.mean((0, 1, 2)), ideal[0, 0], atol=0.03)
        assert gray(images.reshape(-1, side, 3)).std() == pytest.approx(0.12 * 0.98 / 1.1, rel=0.25)
        assert ((images <= 0) | (images >= 1)).mean() < 0.002


def test_spectra() -> None:
    """Power falls as 1 / f (pink) or 1 / f^2 (brown), is level (white), or stands on a ring (blobs)."""
    for spectrum, slope in (("white", 0.0), ("pink", -1.0), ("brown", -2.0)):
        power, f = _power(Noise(spectrum=spectrum, scale=40))  # type: ignore[arg-type]
        radius = np.hypot(*np.moveaxis(f, -1, 0))
        low, high = (power[(radius > r) & (radius < 1.3 * r)].mean() for r in (0.04, 0.16))
        assert np.log(high / low) / np.log(4) == pytest.approx(slope, abs=0.15)
    power, f = _power(Noise(spectrum="blobs", scale=16))
    assert np.average(np.hypot(*np.moveaxis(f, -1, 0)), weights=power) == pytest.approx(1 / 16, rel=0.15)


def test_grass_is_turned() -> None:
    """Stretched blots are four times as long as broad, and turn with the rotation."""
    for rotation, axis in ((0.0, 0), (90.0, 1)):
        power, f = _power(Noise(spectrum="grass", scale=10, rotation=rotation))
        spread = np.sqrt([np.average(f[..., k] ** 2, weights=power) for k in (0, 1)])
        assert spread[axis] > 2.5 * spread[1 - axis]


def test_draws() -> None:
    """Equal streams give equal bytes, other streams and `again` independent textures of any shape."""
    noise = Noise()
    first, same, other = (noise.render((64, 64), np.random.default_rng(seed)) for seed in (1, 1, 2))
    again = noise.again(first, (64, 80), np.random.default_rng(1))
    np.testing.assert_array_equal(first.image, same.image)
    assert again.image.shape == (64, 80, 3)
    assert abs(np.corrcoef(first.image.ravel(), other.image.ravel())[0, 1]) < 0.2


@pytest.mark.parametrize(
    ("parameters", "message"),
    [
        ({"spectrum": "loud"}, "give one of: white, pink"),
        ({"scale": 0.0}, "scale is 0.0 px; give at least 3"),
        ({"contrast": 0.5}, "give a standard deviation from 0 to 0.3"),
        ({"rotation": np.nan}, "give degrees"),
    ],
)
def test_bad_parameters(parameters: dict[str, Any], message: str) -> None:
    """What cannot be drawn is refused with what to give."""
    with pytest.raises(BadInput, match=message):
        Noise(**parameters)
