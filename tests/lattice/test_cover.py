import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from nrbench.lattice.cover import cells
from nrbench.lattice.geometry import Lattice

SHAPE = (37, 52)


def leaning(length: float, ratio: float, turn: float, angle: float, x: float, y: float) -> Lattice:
    """Return a lattice of two lengths, a direction, an angle and an origin."""
    t2 = length * ratio * math.cos(turn + angle), length * ratio * math.sin(turn + angle)
    return Lattice((length * math.cos(turn), length * math.sin(turn)), t2, (x, y))


LATTICES = st.builds(
    leaning,
    st.floats(5, 60),
    st.floats(0.4, 2.5),
    st.floats(0, 6.3),
    st.floats(0.5, 2.6),
    st.floats(-90, 90),
    st.floats(-90, 90),
)


@given(LATTICES)
def test_the_cells_hold_every_place_of_the_image(lattice: Lattice) -> None:
    """The cell of any place is among them, and each of them holds some place that fine sampling finds, or a sliver."""
    found = cells(lattice, SHAPE)
    y, x = np.mgrid[-0.499:36.499:0.49899, -0.499:51.499:0.49899]  # type: ignore[misc]
    held = {tuple(number) for number in np.floor(lattice.to_cell(np.stack([x, y], -1).reshape(-1, 2))).astype(int)}
    numbers = {tuple(number) for number in found.numbers.tolist()}
    assert held <= numbers and len(numbers) == len(found.numbers)
    slivers = np.array([number not in held for number in map(tuple, found.numbers.tolist())])
    inside = np.clip(found.corners()[slivers], (-0.5, -0.5), (51.5, 36.5))
    assert (np.ptp(inside, axis=1) > 0).all()
    assert not (slivers & found.whole).any()


@given(LATTICES)
def test_a_cell_is_whole_where_its_corners_are_inside(lattice: Lattice) -> None:
    """Whole cells have all four corners in the image, the others have one outside; their areas add up."""
    found = cells(lattice, SHAPE)
    depth = np.minimum(found.corners() + 0.5, (51.5, 36.5) - found.corners()).min((1, 2))
    assert (depth[found.whole] >= -1e-5).all() and (depth[~found.whole] < 1e-5).all()
    assert found.area == pytest.approx(found.whole.sum() * lattice.area) and found.area <= 37 * 52 * (1 + 1e-5)


@given(LATTICES, st.integers(-30, 30), st.integers(-30, 30))
@settings(max_examples=30)
def test_another_point_for_origin_renumbers_the_cells(lattice: Lattice, i: int, j: int) -> None:
    """The same cells are found, numbered from the new origin."""
    x, y = lattice.from_cell((i, j))
    found, again = cells(lattice, SHAPE), cells(Lattice(lattice.t1, lattice.t2, (float(x), float(y))), SHAPE)
    assert found.count == again.count
    ours, theirs = found.numbers - (i, j), again.numbers
    assert ours.tolist() == theirs.tolist()


def test_an_image_cut_to_the_lattice_is_all_whole_cells() -> None:
    """3 x 4 cells of 8 x 6 px fill 24 x 24 px; an origin off by half a pixel cuts the outer ones."""
    lattice = Lattice((8, 0), (0, 6), (-0.5, -0.5))
    assert cells(lattice, (24, 24)).whole.tolist() == [True] * 12
    assert cells(lattice, (24, 24)).area == 24 * 24
    moved = cells(lattice.shifted((0.5, 0.5)), (24, 24))
    assert (len(moved.numbers), moved.count) == (20, 6)


def test_a_cell_larger_than_the_image_holds_it() -> None:
    """An image within one cell meets that cell alone, and none is whole."""
    found = cells(Lattice((100, 0), (30, 100), (-40, -40)), (10, 10))
    assert found.numbers.tolist() == [[0, 0]] and found.count == 0
