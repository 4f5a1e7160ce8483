import numpy as np
import pytest

from nrbench.imaging.convert import Image, quantize
from nrbench.plugins.forms import Refused
from nrbench.spectra.harmonics import Harmonics
from nrbench.synthesizers.fftm_pixel import FftmPixel
from nrbench.synthesizers.masks.texture_mask import TextureMask

from .test_fftm_pixel import mask_of, noise, repeated, soft_tile, synthesize


def seam_ratio(image: Image) -> float:
    """Return the mean step across the output's borders, where it meets itself, over that inside."""
    across = np.abs(image[:, 0] - image[:, -1]).mean() + np.abs(image[0] - image[-1]).mean()
    inside = np.abs(np.diff(image, axis=1)).mean() + np.abs(np.diff(image, axis=0)).mean()
    return float(across / inside)


@pytest.mark.parametrize("neighborhood", [2, 3, 6])
def test_a_tileable_output_meets_itself_without_a_seam(neighborhood: int) -> None:
    """Smooth blobs go on across the borders of a tileable output, and stop at those of another."""
    rng = np.random.default_rng(2)
    tile = soft_tile(15, 15, 1)
    rough = rng.standard_normal((90, 90))
    waves = np.exp(-0.5 * (np.hypot(*np.meshgrid(np.fft.fftfreq(90), np.fft.fftfreq(90))) / 0.06) ** 2)
    blobs = np.fft.ifft2(np.fft.fft2(rough) * waves).real
    sample = quantize(repeated(tile, (90, 90)) * 0.5 + (0.25 + 0.1 * blobs / blobs.std())[..., np.newaxis])
    mask = mask_of(quantize(tile * 0.5 + 0.25))
    ratios = {
        tileable: np.mean(
            [
                seam_ratio(synthesize(FftmPixel(neighborhood, tileable=tileable), sample, (60, 75), mask, k).image)
                for k in range(4)
            ]
        )
        for tileable in (False, True)
    }
    assert ratios[True] < 1.35
    assert ratios[True] < 0.8 * ratios[False]


def test_a_tileable_output_of_a_perfect_texture_is_its_continuation() -> None:
    """Neighborhoods that wrap around change nothing where all is in its place already, down to one tile."""
    tile = noise(13, 15)
    for shape in ((13, 15), (39, 60)):
        made = synthesize(FftmPixel(tileable=True), repeated(tile, (60, 62)), shape, mask_of(tile))
        np.testing.assert_array_equal(quantize(made.image), repeated(tile, shape))


def test_a_size_that_is_no_period_is_refused_with_the_nearest_ones_that_work() -> None:
    """The refusal names sizes; asked for those, the output tiles, though the mask's period is a fraction of a pixel."""
    tile, sample = soft_tile(11, 13), repeated(soft_tile(11, 13), (64, 64), 0.05)
    mask = mask_of(tile, 1.03)
    with pytest.raises(Refused, match="nearest: 68x67"):
        synthesize(FftmPixel(tileable=True), sample, (64, 73), mask)
    made = synthesize(FftmPixel(tileable=True), sample, (67, 68), mask)
    assert seam_ratio(made.extras["mask"]) < 1.1
    assert seam_ratio(mask.draw((64, 73))) > 1.5


def test_stripes_tile_along_themselves_at_any_length() -> None:
    """A mask of one fundamental has a period across its stripes alone."""
    harmonics = Harmonics(
        np.array([[0.1, 0.0]]), np.array([[0.2]]), np.array([[0.0]]), np.array([0.5]),
        np.array([[0.1, 0.0]]), np.array([[1]]), (1,), 1.0,
    )  # fmt: skip
    sample, mask = noise(30, 30, 1), TextureMask(harmonics)
    assert synthesize(FftmPixel(tileable=True), sample, (17, 40), mask).image.shape == (17, 40, 1)
    with pytest.raises(Refused, match="nearest: 40x17"):
        synthesize(FftmPixel(tileable=True), sample, (17, 43), mask)
