import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from nrbench.imaging.largest_box import largest_box


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
