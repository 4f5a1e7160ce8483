import numpy as np
import pytest
from numpy.typing import NDArray

from nrbench.running.output_checks import is_picture


@pytest.mark.parametrize(
    ("extra", "picture"),
    [
        (np.full((5, 7, 3), 0.5, np.float32), True),
        (np.zeros((5, 7, 1)), True),
        (np.zeros((5, 7, 2)), False),
        (np.full((5, 7, 3), 1.5), False),
        (np.full((5, 7, 3), np.nan), False),
        (np.zeros((5, 7, 3), np.int64), False),
        (np.zeros((0, 7, 3)), False),
        (np.zeros((5, 7)), False),
    ],
)
def test_pictures_among_extras(extra: NDArray[np.generic], picture: bool) -> None:
    """Only floats in [0, 1] of one or three channels are written as pictures; displacements and tables are not."""
    assert is_picture(extra) is picture
