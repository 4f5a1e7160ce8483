import numpy as np
import pytest

from nrbench.errors import BadInput
from nrbench.imaging.convert import Image, quantize
from nrbench.plugins.forms import Refused, Synthesis, Task
from nrbench.synthesizers.scatter import Scatter


def noise(channels: int) -> Image:
    """Return noise of 8 bits."""
    return quantize(np.random.default_rng(0).random((60, 70, channels), np.float32))


def scatter(sample: Image, shape: tuple[int, int], seed: int = 1, method: Scatter | None = None) -> Synthesis:
    """Run the method."""
    return (method or Scatter()).synthesize(Task(sample, shape, None, np.random.default_rng(seed)))


@pytest.mark.parametrize("shape", [(256, 256), (1, 300), (9, 5)])
@pytest.mark.parametrize("channels", [1, 3])
def test_any_shape_and_channels_copy_what_the_map_says(shape: tuple[int, int], channels: int) -> None:
    """The output has the task's shape, and pixels of weight 1 are the sample's."""
    sample = noise(channels)
    made = scatter(sample, shape)
    assert made.image.shape == (*shape, channels)
    assert made.source is not None
    x, y, weight = np.moveaxis(made.source, -1, 0)
    copied = weight == 1
    assert copied.mean() > 0.7
    np.testing.assert_array_equal(made.image[copied], sample[y[copied].astype(int), x[copied].astype(int)])


def test_the_patches_come_from_anywhere() -> None:
    """Over many blocks every part of the sample is used, and patches seldom recur."""
    made = scatter(noise(1), (640, 640))
    assert made.source is not None
    middles = made.source[16::32, 16::32, :2].reshape(-1, 2)
    assert len(np.unique(middles, axis=0)) > 250
    assert made.source[..., 0].min() <= 4
    assert made.source[..., 0].max() >= 65


def test_a_sample_smaller_than_a_block_is_refused_with_a_way_out() -> None:
    """The refusal says what would fit."""
    with pytest.raises(Refused, match="block \\+ 2 border <= 30"):
        scatter(noise(1)[:30], (64, 64))


def test_a_border_over_half_a_block_is_refused() -> None:
    """The error names the range."""
    with pytest.raises(BadInput, match="from 1 to half a block"):
        Scatter(block=20, border=11)
