import math

import numpy as np
import pytest

from nrbench.imaging.convert import quantize
from nrbench.synthesizers.patchwork.patchwork import Patchwork


def two_patches(shape: tuple[int, int], seed: int = 0, channels: int = 3) -> Patchwork:
    """Return an output of a copy of the sample and, from column 9 on, another one."""
    rng = np.random.default_rng(seed)
    sample = quantize(rng.random((20, 30, channels), np.float32))
    work = Patchwork(sample, np.rint(sample * 255).astype(np.int32), shape)
    work.lay_patch((0, shape[0], 0, 9), (1, 2))
    work.lay_patch((0, shape[0], 9, shape[1]), (4, 5))
    return work


def blended(work: Patchwork, sigma: float) -> tuple[np.ndarray, np.ndarray]:
    """Return, by definition, what the patches around each pixel weigh, and the mean of what they show there."""
    reach, (height, width) = math.ceil(2 * sigma), work.shape
    image, share = np.zeros((*work.shape, work.sample.shape[2])), np.zeros(work.shape)
    for y, x in np.ndindex(work.shape):
        weights: dict[tuple[int, int], float] = {}
        for j, i in np.ndindex(2 * reach + 1, 2 * reach + 1):
            v, u = y + j - reach, x + i - reach
            if 0 <= v < height and 0 <= u < width:
                column, row = work.origin[v, u] + (x - u, y - v)
                if 0 <= row < work.sample.shape[0] and 0 <= column < work.sample.shape[1]:
                    weight = math.exp(-((j - reach) ** 2 + (i - reach) ** 2) / (2 * sigma**2))
                    weights[row, column] = weights.get((row, column), 0.0) + weight
        image[y, x] = sum(weight * work.sample[place] for place, weight in weights.items()) / sum(weights.values())
        share[y, x] = max(weights.values()) / sum(weights.values())
    return image, share


@pytest.mark.parametrize("sigma", [0.4, 1.0, 1.7])
@pytest.mark.parametrize("channels", [1, 3])
def test_seams_are_blended_as_defined(sigma: float, channels: int) -> None:
    """Image and weights equal those computed pixel by pixel from the definition."""
    work = two_patches((12, 20), channels=channels)
    image, source = work.feathered(sigma)
    expected, share = blended(work, sigma)
    np.testing.assert_allclose(image, expected, atol=1e-6)
    np.testing.assert_allclose(source[..., 2], share, atol=1e-6)


def test_pixels_far_from_seams_are_copies() -> None:
    """Beyond the reach of the Gaussian pixels equal their sources, and next to the seam they do not."""
    work = two_patches((12, 20))
    image, source = work.feathered(1.0)
    x, y, weight = np.moveaxis(source, -1, 0)
    copies = weight == 1
    np.testing.assert_array_equal(copies, np.tile(np.abs(np.arange(20) - 8.5) > 2, (12, 1)))
    np.testing.assert_array_equal(image[copies], work.sample[y.astype(int), x.astype(int)][copies])
    assert (image != work.result()[0]).any(-1)[:, 8:10].all()


def test_the_source_is_the_patch_of_the_largest_weight() -> None:
    """On either side of a straight seam the source map names the patch of that side."""
    work = two_patches((12, 20))
    np.testing.assert_array_equal(work.feathered(1.5)[1][..., :2], work.origin)


def test_without_a_width_nothing_is_blended() -> None:
    """At width 0 every pixel is a copy."""
    work = two_patches((12, 20))
    for feathered, plain in zip(work.feathered(0.0), work.result(), strict=True):
        np.testing.assert_array_equal(feathered, plain)
