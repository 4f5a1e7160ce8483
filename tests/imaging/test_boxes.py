"""Sums over boxes, the largest box in a mask, and the vertex of a parabola."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from nrbench.imaging.convert import box_sums, box_sums_from, integral_image, largest_box
from nrbench.imaging.correlation import find_vertex

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


@given(st.integers(0, 1000), st.integers(1, 9), st.integers(1, 9))
def test_the_borders_of_the_box_are_true(seed: int, rows: int, columns: int) -> None:
    """The box lies inside the mask, and its borders are True unless it has a single row or column left."""
    mask = np.random.default_rng(seed).random((rows, columns)) < 0.8
    y0, y1, x0, x1 = largest_box(mask)
    assert 0 <= y0 < y1 <= rows and 0 <= x0 < x1 <= columns
    box = mask[y0:y1, x0:x1]
    borders = np.concatenate([box[0], box[-1], box[:, 0], box[:, -1]])
    assert borders.all() or min(box.shape) == 1


def test_a_ragged_border_is_cut_off() -> None:
    """Where only the border is ragged, the box is all that lies inside of it."""
    mask = np.ones((20, 30), np.bool_)
    mask[0, 3:9] = mask[18:, 20] = mask[:, 0] = False
    assert largest_box(mask) == (1, 18, 1, 30)


@given(st.floats(-0.5, 0.5), st.floats(0.01, 100), st.floats(-10, 10))
def test_the_vertex_of_a_parabola_is_found(place: float, bend: float, top: float) -> None:
    """Three samples of a parabola tell where its vertex is."""
    before, middle, after = (top - bend * (x - place) ** 2 for x in (-1, 0, 1))
    assert find_vertex(before, middle, after) == pytest.approx(place, abs=1e-6)


def test_three_samples_without_a_maximum() -> None:
    """On a slope and in a valley the offset is 0."""
    before, middle, after = np.array([[0.0, 1.0, 3.0], [2.0, 1.0, 3.0], [3.0, 1.0, 0.0]]).T
    assert find_vertex(before, middle, after).tolist() == [0, 0, 0]
