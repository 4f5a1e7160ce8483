"""Lattices that close on a torus."""

import numpy as np
import pytest

from nrbench.calling.tileable import MOST_STRAIN, close_lattice, closing_strain, nearest_closing_shape
from nrbench.lattice.geometry import Lattice

LATTICES = {
    "square": Lattice((31.3, 0), (0, 31.3)),
    "running bond": Lattice((27.3, 0), (13.65, 12.2), (5, 3)),
    "turned hexagon": Lattice((25, 7.6), (5.9, 25.4)),
}


@pytest.mark.parametrize("name", LATTICES)
def test_the_sides_of_the_output_are_vectors_of_the_closed_lattice(name: str) -> None:
    """The sides are whole numbers of vectors, and no vector changes by more than the strain of both sides."""
    lattice = LATTICES[name]
    shape = nearest_closing_shape(lattice, (230, 260), MOST_STRAIN)
    closed = close_lattice(lattice, shape)
    steps = np.diag(shape[::-1]) @ np.linalg.inv(closed.matrix)
    np.testing.assert_allclose(steps, np.rint(steps), atol=1e-9)
    moved = np.hypot(*(closed.matrix - lattice.matrix).T) / np.hypot(*lattice.matrix.T)
    assert moved.max() <= 1.5 * closing_strain(lattice, shape) <= 1.5 * MOST_STRAIN


def test_the_nearest_size_that_closes_is_the_nearest() -> None:
    """No size between the wanted one and the returned one closes."""
    lattice = LATTICES["running bond"]
    height, width = nearest_closing_shape(lattice, (230, 260), 0.01)
    for side in range(min(width, 260), max(width, 260) + 1):
        assert (closing_strain(lattice, (height, side)) <= 0.01) == (side == width)


def test_an_output_smaller_than_a_period_does_not_close() -> None:
    """Both sides are then next to the same vector, or to none."""
    assert close_lattice(LATTICES["square"], (9, 9)) is None
