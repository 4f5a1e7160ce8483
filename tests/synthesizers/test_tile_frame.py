import math

import numpy as np
import pytest
from hypothesis import assume, given, settings
from hypothesis import strategies as st
from turned_lattices import turned

from nrbench.lattice.geometry import Integers, Lattice, Points
from nrbench.plugins.forms import Refused
from nrbench.synthesizers.lattice_places.equal_places import pixel_grid
from nrbench.synthesizers.representative_tile import (
    TileFrame,
    count_rectangle_cells,
    find_free_rectangle,
    find_tile_frame,
    find_upright_rectangle,
)

SHAPE = (128, 150, 3)


def pixels_of(frame: TileFrame) -> Points:
    """Return the pixels (x, y) of the scaled image."""
    return pixel_grid(*frame.shape[::-1]).astype(np.float64)


@settings(max_examples=40)
@given(st.floats(8, 40), st.floats(0, 180), st.floats(0.7, 1.4), st.floats(1.05, 2.1), st.sampled_from([0.02, 0.1]))
def test_periods_are_lattice_vectors_at_nearly_a_right_angle(
    length: float, degrees: float, ratio: float, angle: float, tolerance: float
) -> None:
    """Whatever the lattice: it is refused, or the tile's sides are its vectors, nearly at right angles."""
    other = ratio * length
    lattice = turned(Lattice((length, 0), (other * math.cos(angle), other * math.sin(angle))), degrees)
    try:
        frame = find_tile_frame(lattice, SHAPE, tolerance)
    except Refused as refusal:
        assert "less than two periods" in refusal.reason or "larger than the sample" in refusal.reason
        return
    assert np.abs(lattice.wrap(frame.periods)).max() < 1e-6 * length
    assert abs(np.linalg.det(frame.periods)) == pytest.approx(frame.cells * lattice.area)
    lengths = np.hypot(*frame.periods.T)
    skew = abs(frame.periods[0] @ frame.periods[1]) / lengths.max()
    assert skew <= 2.1 * tolerance * lattice.s + 1e-6
    assert frame.size == (int(lengths[1] + 0.05), int(lengths[0] + 0.05))
    assert abs(frame.periods[0, 0]) >= abs(frame.periods[0, 1]) - 2 * tolerance * lattice.s - 1e-6
    assert (np.abs(frame.periods).sum(0) <= (150.05, 128.05)).all()


def test_the_scaled_image_covers_the_sample_and_no_more() -> None:
    """Its pixels lie on the sample up to its last row and column; slanted, the corners of its box lie outside."""
    upright = find_tile_frame(Lattice((21.37, 0), (0, 18.81)), SHAPE, 0.1)
    at = upright.to_sample(pixels_of(upright))
    assert upright.first == (0, 0) and upright.holds(pixels_of(upright), SHAPE).all()
    assert (np.array([149, 127]) - at[-1, -1] < upright.steps.max()).all()
    slanted = find_tile_frame(Lattice((20, 6), (-6, 20)), SHAPE, 0.1)
    inside = slanted.holds(pixels_of(slanted), SHAPE)
    assert inside.sum() == pytest.approx(149 * 127 / abs(np.linalg.det(slanted.steps)), rel=0.01) and not inside.all()


def test_a_period_just_under_a_whole_number_is_that_number() -> None:
    """29.97 px are 30, not 29; 29.9 px are 29: what is measured no better does not shrink a tile by a pixel."""
    for period, pixels in ((29.97, 30), (29.9, 29), (30.0, 30), (30.9, 30)):
        assert find_tile_frame(Lattice((period, 0), (0, 20)), SHAPE, 0.1).size == (20, pixels)


ENTRY = st.integers(-15, 15)
BASIS = st.tuples(ENTRY, ENTRY, ENTRY, ENTRY).filter(lambda e: abs(e[0] * e[3] - e[1] * e[2]) > 0)
HEXAGON = Lattice((20.0, 0.0), (10.0, 10 * math.sqrt(3)))


def size(rectangle: Integers, lattice: Lattice) -> list[float]:
    """Return the lengths, px, of the two lattice vectors."""
    return [float(length) for length in np.hypot(*(rectangle @ lattice.matrix).T)]


@given(BASIS)
def test_a_whole_numbered_lattice_has_its_exact_rectangle(basis: tuple[int, int, int, int]) -> None:
    """Its width is the determinant over the gcd of the y components, its height likewise."""
    p, q, r, s = basis
    det = abs(p * s - q * r)
    lattice = Lattice((p, q), (r, s))
    found = find_upright_rectangle(lattice, 0, 500)
    expected = [[det / math.gcd(q, s), 0], [0, det / math.gcd(p, r)]]
    np.testing.assert_allclose(found @ lattice.matrix, expected, atol=1e-6)
    assert count_rectangle_cells(found) == pytest.approx(math.prod(size(found, lattice)) / det)


@given(st.floats(3, 30), st.floats(3, 30), st.floats(-30, 30), st.floats(0, 90), st.floats(0.05, 1.4))
def test_the_rectangle_is_the_smallest_within_tolerance(
    a: float, b: float, lean: float, angle: float, tolerance: float
) -> None:
    """Brute force over the vectors near each axis finds no shorter side; the residual keeps the tolerance."""
    lattice = turned(Lattice((a, 0), (lean, b)), angle)
    assume(lattice.s > 2.9)
    found = find_upright_rectangle(lattice, tolerance, 60)
    grid = np.array([(i, j) for i in range(-25, 26) for j in range(-25, 26) if (i, j) != (0, 0)])
    shortest = []
    for axis in (0, 1):
        vectors = grid @ lattice.reduced().matrix
        side, off = vectors[:, axis], np.abs(vectors[:, 1 - axis])
        sides = side[(off <= tolerance - 1e-6) & (side > 0) & (side <= 60 - 1e-6)]
        shortest.append(sides.min(initial=np.inf))
    assert found is not None or max(shortest) == np.inf
    if found is not None:
        (width, across), (down, height) = found @ lattice.matrix
        assert width <= shortest[0] + 1e-6 and height <= shortest[1] + 1e-6
        assert max(abs(across), abs(down)) <= tolerance + 1e-5 and max(width, height) <= 60 + 1e-6
        assert count_rectangle_cells(found) > 0


@given(st.integers(-3, 3), st.integers(-3, 3), st.floats(0, 90))
def test_the_rectangle_does_not_depend_on_the_basis(i: int, j: int, angle: float) -> None:
    """Another basis and origin give the same sides, by other integers for the same vectors."""
    lattice = turned(HEXAGON, angle)
    other = Lattice.from_basis(np.array([[1, i], [0, 1]]) @ [[1, 0], [j, 1]] @ lattice.matrix, (3.0, 9.0))
    for search in (find_upright_rectangle, find_free_rectangle):
        ours, theirs = search(lattice, 0.7, 300), search(other, 0.7, 300)
        assert (ours is None) == (theirs is None)
        if ours is not None and theirs is not None:
            assert count_rectangle_cells(ours) == count_rectangle_cells(theirs)
            assert sorted(size(ours, lattice)) == pytest.approx(sorted(size(theirs, other)))


def test_known_rectangles() -> None:
    """A brick lattice's is one brick by two courses; a hexagonal one's is s by the square root of 3 times s."""
    bond = Lattice((27.3, 0.0), (13.65, 12.2))
    brick, hexagon = find_upright_rectangle(bond, 0, 200), find_upright_rectangle(HEXAGON, 0, 200)
    assert brick is not None and size(brick, bond) == pytest.approx([27.3, 24.4]) and count_rectangle_cells(brick) == 2
    assert hexagon is not None and size(hexagon, HEXAGON) == pytest.approx([20, 20 * math.sqrt(3)])


@pytest.mark.parametrize("angle", [0.0, 11.0, 45.0, 77.0])
def test_a_free_rectangle_turns_with_the_lattice(angle: float) -> None:
    """Of a rhombic lattice it is two cells, exactly, in any direction; of a square one it is the cell."""
    bond, grid = (turned(Lattice((a, 0.0), t2), angle) for a, t2 in ((27.3, (13.65, 12.2)), (20.0, (0.0, 20.0))))
    rhombic, square = find_free_rectangle(bond, 0, 200), find_free_rectangle(grid, 0, 200)
    assert rhombic is not None and sorted(size(rhombic, bond)) == pytest.approx([24.4, 27.3])
    assert square is not None and size(square, grid) == pytest.approx([20, 20])
    assert count_rectangle_cells(rhombic) == 2 and count_rectangle_cells(square) == 1
    sides = rhombic @ bond.matrix
    assert abs(sides[0] @ sides[1]) < 1e-6


@given(BASIS)
@settings(max_examples=30)
def test_the_free_rectangle_is_no_larger_than_the_upright_one(basis: tuple[int, int, int, int]) -> None:
    """The upright rectangle is one of those that are compared."""
    lattice = Lattice(basis[:2], basis[2:])
    assume(lattice.s > 2)
    free, upright = find_free_rectangle(lattice, 0, 250), find_upright_rectangle(lattice, 0, 250)
    assume(upright is not None)
    assert math.prod(size(free, lattice)) <= math.prod(size(upright, lattice)) * (1 + 1e-6)


def test_where_there_is_none_none_is_returned() -> None:
    """A hexagonal lattice turned by 7 degrees has no upright rectangle but a free one; an odd one has neither."""
    assert find_upright_rectangle(turned(HEXAGON, 7), 0, 1024) is None
    assert find_free_rectangle(turned(HEXAGON, 7), 0, 1024) is not None
    assert find_free_rectangle(Lattice((20.0, 0.0), (math.pi, 23.0)), 0, 300) is None
    assert find_upright_rectangle(HEXAGON, 0, 30) is None
