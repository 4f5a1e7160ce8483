import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from nrbench.lattice.geometry import integers_within

CORNER = st.floats(-25, 25)
SIZE = st.floats(0, 30)


@given(st.floats(3, 30), st.floats(0, 0.5), st.floats(1, 3), st.floats(0, 6.3), CORNER, CORNER, SIZE, SIZE)
def test_every_point_in_the_box_is_found_once(
    length: float, lean: float, ratio: float, turn: float, x: float, y: float, w: float, h: float
) -> None:
    """Brute force finds the same integers; what lies outside does so by a rounding of the step."""
    rotation = np.array([[np.cos(turn), np.sin(turn)], [-np.sin(turn), np.cos(turn)]])
    basis = length * np.array([[1, 0], [lean, ratio]]) @ rotation
    low, high = np.array([x, y]), np.array([x + w, y + h])
    found = {tuple(numbers) for numbers in integers_within(basis, low, high).tolist()}
    assert len(found) == len(integers_within(basis, low, high))
    grid = np.array([(i, j) for i in range(-35, 36) for j in range(-35, 36)])
    depth = np.minimum(grid @ basis - low, high - grid @ basis).min(1)
    assert {tuple(numbers) for numbers in grid[depth > 1e-9].tolist()} <= found
    assert found <= {tuple(numbers) for numbers in grid[depth > -1e-4].tolist()}


@pytest.mark.parametrize("turn", [0.0, 0.7, 1.5707963267948966])
def test_a_long_thin_box_costs_its_points_not_its_square(turn: float) -> None:
    """Of a strip 1e6 px long and 2 px high the integers found are about as many as its area holds."""
    basis = 5 * np.array([[np.cos(turn), np.sin(turn)], [-np.sin(turn), np.cos(turn)]])
    found = integers_within(basis, (0, -1), (1e6, 1))
    assert 60_000 < len(found) < 210_000
