import numpy as np
import pytest

from nrbench.imaging.box_sums import box_sums, box_sums_from, integral_image

VALUES = np.random.default_rng(0).integers(0, 256, (7, 9, 3)).astype(np.float32)


@pytest.mark.parametrize("size", [(1, 1), (2, 3), (7, 9), (0, 4), (3, 0)])
def test_every_box_is_summed_exactly(size: tuple[int, int]) -> None:
    """Whole numbers' sums are those of the pixels, channel by channel, to the bit; an empty box holds nothing."""
    rows, columns = size
    found = box_sums_from(integral_image(VALUES), size)
    assert found.shape == (8 - rows, 10 - columns, 3)
    for y, x in np.ndindex(found.shape[:2]):
        np.testing.assert_array_equal(found[y, x], VALUES[y : y + rows, x : x + columns].sum((0, 1)))
    np.testing.assert_array_equal(box_sums(VALUES[..., 1], size), found[..., 1])
